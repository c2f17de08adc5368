"""Comparison of a recording with an orbit of events, by the contact channels of its stops.

The channels give the period, the times of first contacts and releases, and the lengths of bounces.
States and outputs of the recording place the orbit in time, must move like the orbit, and must not
contradict the channels.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.experiment.comparison.estimate import Estimate
from zeno_orbits.experiment.comparison.event_alignment import LIKE, EventPlace, placed_events
from zeno_orbits.experiment.comparison.event_contacts import SeenEvents
from zeno_orbits.experiment.comparison.event_reference import (
    EventTable,
    event_table,
    orbit_sequences,
    shared_event_signals,
)
from zeno_orbits.experiment.comparison.event_signals import SignalFit, contradictions, signal_fits
from zeno_orbits.experiment.comparison.metrics import (
    Metric,
    metric,
    metric_columns,
    named_metric,
    plain_number,
)
from zeno_orbits.experiment.comparison.verdict import ComparisonVerdict, beyond_chance
from zeno_orbits.experiment.recordings.contacts import contact_channels, contact_names
from zeno_orbits.experiment.recordings.periodicity import Periodicity, periodicity
from zeno_orbits.experiment.recordings.recording import Recording
from zeno_orbits.model import Problem
from zeno_orbits.orbits import EventOrbit
from zeno_orbits.work import Columns, TableRepr

_REPEATS = 0.4
"""Least part of the variance of all signals that repeats."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class EventComparison(TableRepr):
    """Comparison of a recording with an orbit of a machine with several stops or switches.

    Attributes:
        orbit: The orbit.
        problem: Its problem.
        recording: The recording.
        signals: Names of the recorded states and outputs.
        cycles: Number of periods in the recording, or NaN.
        metrics: Values of the recording and of the orbit.
        reasons: Reasons why the recording does not show such an orbit, most serious first.
        unresolved: Reasons why the recording is inconclusive.
        remarks: Further findings.
    """

    orbit: EventOrbit
    problem: Problem
    recording: Recording
    signals: tuple[str, ...]
    cycles: float = math.nan
    metrics: tuple[Metric, ...] = ()
    reasons: tuple[str, ...] = ()
    unresolved: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """Return one line: the verdict and the reasons."""
        found = f"verdict={self.verdict.value} {' '.join((*self.reasons, *self.unresolved))}"
        return f"<EventComparison with {self.orbit.problem}: {found.strip()}>"

    def _columns(self) -> Columns:
        """Return the values of the recording next to the values of the orbit."""
        return metric_columns(self.metrics)

    @property
    def verdict(self) -> ComparisonVerdict:
        """Verdict on the recording."""
        if self.reasons:
            return ComparisonVerdict.NO_ORBIT
        if self.unresolved:
            return ComparisonVerdict.UNDECIDED
        return ComparisonVerdict.OTHER_VALUES if self.differences else ComparisonVerdict.THIS_ORBIT

    @cached_property
    def differences(self) -> tuple[Metric, ...]:
        """The quantities that differ from the orbit's by more than their errors."""
        return beyond_chance(self.metrics, self._size)

    def _size(self, one: Metric) -> float:
        """Return the size of a quantity: of times the period, of signals their range."""
        signal = one.name.partition(" of ")[2]
        if signal:
            ends = [other.orbit for other in self.metrics if other.name.endswith(f" of {signal}")]
            return max(ends) - min(ends)
        return self.orbit.period if one.unit == "s" else max(abs(one.orbit), 1.0)

    @property
    def agrees(self) -> bool:
        """True if the recording shows this orbit, or one of the machine with other values."""
        return self.verdict.shows_orbit

    def metric(self, name: str) -> Metric:
        """Return a quantity by its name.

        Raises:
            InputError: If no quantity has this name.
        """
        return named_metric(self.metrics, name)

    def as_json(self) -> dict[str, Any]:
        """Return the comparison as plain data, with null for unknown values."""
        source = self.recording.source
        return {
            "agrees": self.agrees,
            "verdict": self.verdict.value,
            "reasons": list(self.reasons),
            "unresolved": list(self.unresolved),
            "differences": [one.name for one in self.differences],
            "remarks": list(self.remarks),
            "problem": self.orbit.problem,
            "source": None if source is None else source.value,
            "signals": list(self.signals),
            "cycles": plain_number(self.cycles),
            "metrics": {one.name: one.as_json() for one in self.metrics},
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaidEvents:
    """An orbit of events in its place in a recording.

    Attributes:
        names: Names of the recorded states and outputs.
        found: Periodicity of all signals and channels.
        seen: The contacts of the channels.
        table: The orbit by phase.
        period: The period, from the edges of the channels if they show it.
        place: Position of the orbit.
        fits: The signals as multiples of the orbit's.
        against: Reasons of the contacts why the recording does not show such an orbit.
        unlike: Reasons of the signals.
        unresolved: Reasons why the contacts are inconclusive.
    """

    names: tuple[str, ...]
    found: Periodicity
    seen: SeenEvents
    table: EventTable
    period: Estimate
    place: EventPlace
    fits: tuple[SignalFit, ...]
    against: tuple[str, ...]
    unlike: tuple[str, ...]
    unresolved: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Unlaid:
    """An orbit without a place in a recording.

    Attributes:
        reason: The reason.
        cycles: Number of periods in the recording, or NaN.
    """

    reason: str
    cycles: float = math.nan


def compare_events(orbit: EventOrbit, problem: Problem, recording: Recording) -> EventComparison:
    """Compare a recording with an orbit of a machine with several stops or switches.

    Args:
        orbit: The orbit.
        problem: Its problem.
        recording: The recording. Contact channels, states and outputs count.

    Raises:
        InputError: If a contact channel is invalid, the recording lacks contact channels, or a
            signal has a unit of another kind.
        SimulationError: If the orbit cannot be simulated.
    """
    stops = problem.graph_dynamics(orbit.values(problem)).stop_names
    channels = contact_channels(recording, stops)
    names = shared_event_signals(problem, recording)
    struck = [stop for stop in stops if orbit_sequences(orbit, stop)]
    begun = EventComparison(
        orbit=orbit,
        problem=problem,
        recording=recording,
        signals=names,
        remarks=event_remarks(recording, problem, names, contact_names(stops)),
    )
    if not channels:
        listed = ", ".join(contact_names(stops))
        raise InputError(f"Argument `recording` must have a contact channel ({listed}).")
    laid = lay_events(orbit, problem, recording, names, channels)
    if isinstance(laid, Unlaid):
        return replace(begun, cycles=laid.cycles, reasons=(laid.reason,))
    unresolved = laid.unresolved
    missing = [stop for stop in struck if stop not in channels]
    if missing:
        listed = ", ".join(f"`{stop}`" for stop in missing)
        unresolved = (*unresolved, f"contacts cannot be seen on {listed}: no channel was recorded")
    quantities = not laid.against and not unresolved
    return replace(
        begun,
        cycles=laid.found.n_cycles,
        metrics=(
            metric("period", "s", orbit.period, laid.period),
            *laid.seen.metrics(laid.table, laid.place.start, laid.period, quantities=quantities),
            *(one for fit in laid.fits for one in fit.metrics()),
        ),
        reasons=(*laid.against, *laid.unlike),
        unresolved=unresolved,
    )


def lay_events(
    orbit: EventOrbit,
    problem: Problem,
    recording: Recording,
    names: Sequence[str],
    channels: Mapping[str, Vector],
    *,
    partly: bool = False,
) -> LaidEvents | Unlaid:
    """Return an orbit in its place in a recording, or the reason why it has none.

    Args:
        orbit: The orbit.
        problem: Its problem.
        recording: The recording.
        names: Names of the recorded states and outputs.
        channels: Contact channels by the name of their stop.
        partly: Whether it is enough to resolve the first bounce of a sequence.

    Raises:
        SimulationError: If the orbit cannot be simulated.
    """
    whole = np.stack([*(recording.signal(name).values for name in names), *channels.values()])
    found = periodicity(recording.time, whole)
    if found is None or found.n_cycles < 1.0:
        span = recording.time[-1] - recording.time[0]
        return Unlaid(
            reason=f"no period is seen in {span:.4g} s, and the orbit's is {orbit.period:.4g} s"
        )
    if found.repeats < _REPEATS:
        return Unlaid(
            reason=f"only {100 * found.repeats:.0f} % of the signals' variance repeats",
            cycles=found.n_cycles,
        )
    struck = {stop: own for stop in channels if (own := orbit_sequences(orbit, stop))}
    seen = SeenEvents.of(recording.time, channels, struck, orbit.period, found.period)
    against, unresolved = seen.findings(partly=partly)
    table = event_table(orbit, problem, names)
    period = seen.period if seen.period.known else Estimate(value=found.period, error=found.error)
    place = placed_events(
        table, recording, names, tuple(channels), seen, period.value, found.average
    )
    fits = signal_fits(table, found, float(recording.time[0]), place)
    unlike = (
        *(
            f"`{name}` moves differently: its correlation with the orbit is {likeness:.2f}"
            for name, likeness in place.likeness.items()
            if likeness < LIKE
        ),
        *(fit.objection for fit in fits if fit.objection),
        *contradictions(table, recording, names, seen, channels),
    )
    return LaidEvents(
        names=tuple(names),
        found=found,
        seen=seen,
        table=table,
        period=period,
        place=place,
        fits=fits,
        against=against,
        unlike=unlike,
        unresolved=unresolved,
    )


def event_remarks(
    recording: Recording, problem: Problem, names: Sequence[str], channels: Sequence[str]
) -> tuple[str, ...]:
    """Return remarks on what of a recording is left out, and on its origin.

    Args:
        recording: The recording.
        problem: The problem.
        names: Names of the recorded states and outputs.
        channels: Names of the contact channels of the problem.
    """
    found: list[str] = []
    others = [name for name in recording.names if name not in (*names, *channels)]
    if others:
        found.append(f"not signals of the problem, left out: {', '.join(others)}")
    if recording.problem and recording.problem != problem.name:
        found.append(f"the recording names the problem `{recording.problem}`, not `{problem.name}`")
    if recording.source is None:
        found.append("missing entry `source` of the recording (measured or simulated)")
    return tuple(found)
