"""A recording beside an orbit: is it such an orbit, and by how much do they differ.

Source: theory (54) to (57).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, counted
from zeno_orbits.experiment.comparison.alignment import Alignment
from zeno_orbits.experiment.comparison.contact_events import CycleEvents, cycle_events
from zeno_orbits.experiment.comparison.deviations import Deviations, deviations
from zeno_orbits.experiment.comparison.estimate import Estimate
from zeno_orbits.experiment.comparison.gap_model import gap_model, recorded_gap
from zeno_orbits.experiment.comparison.metrics import Metric, contact_metrics, metric
from zeno_orbits.experiment.comparison.overlay import Overlay, lay_over, shared_signals
from zeno_orbits.experiment.comparison.signal_metrics import (
    portrait_metrics,
    recorded_portraits_of,
    signal_metrics,
)
from zeno_orbits.experiment.comparison.stop_level import Stop, refined_stop, stop_level
from zeno_orbits.experiment.orbit_table import GAP
from zeno_orbits.experiment.recordings.periodicity import Periodicity
from zeno_orbits.experiment.recordings.recording import Recording
from zeno_orbits.model import Problem
from zeno_orbits.orbits import ZenoOrbit
from zeno_orbits.work import Columns, Displayed

__all__ = ["Comparison", "Metric", "compare"]


_SEEN = 0.5
"""Part of the cycles that must show a locked phase and an impact."""
_LOCKED_SAMPLES = 12
"""Samples of the orbit's locked phase from which on one must be seen."""
_FEWEST_CYCLES = 6
_STRAY = 0.1
"""Part of the variance that does not repeat and is not said: harmonics leave some of jumps."""
_SETTLING = 3.0
"""Cycles whose deviation is larger by this factor than that of later ones have not settled."""
_CLIPPED = 0.01
"""Part of the samples that sit at an extreme in a signal that is cut off there."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Contacts:
    """Contacts as a recorded gap shows them.

    Attributes:
        stop: The stop.
        events: Of each cycle.
    """

    stop: Stop
    events: tuple[CycleEvents, ...]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Comparison(Displayed):
    """A recording beside an orbit.

    Attributes:
        orbit: The orbit.
        problem: Its problem.
        recording: The recording, whole.
        signals: Names of the signals that both have.
        overlay: The orbit laid over the recording, if that repeats.
        contacts: The stop and what each cycle shows of it, if the gap rests on a stop.
        deviations: By phase, if both are of one kind.
        reasons: Why the recording shows no such orbit; empty if it does.
        remarks: Further findings.
    """

    orbit: ZenoOrbit
    problem: Problem
    recording: Recording
    signals: tuple[str, ...]
    overlay: Overlay | None = None
    contacts: Contacts | None = None
    deviations: Deviations | None = None
    reasons: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """Return one line: whether the recording shows the orbit, and why not."""
        found = f"agrees={self.agrees}, signals={', '.join(self.signals)}"
        return (
            f"<Comparison with {self.orbit.problem}: {found} {' '.join(self.reasons)}".strip() + ">"
        )

    def _columns(self) -> Columns:
        """Return the numbers of the recording beside those of the orbit."""
        names = ("name", "unit", "orbit", "data", "error")
        return {name: [getattr(metric, name) for metric in self.metrics] for name in names}

    @property
    def period(self) -> Periodicity | None:
        """Periodicity of the recording, if it repeats."""
        return None if self.overlay is None else self.overlay.found

    @property
    def where(self) -> Alignment | None:
        """Position of the orbit in the recording, if that repeats."""
        return None if self.overlay is None else self.overlay.where

    @cached_property
    def metrics(self) -> tuple[Metric, ...]:
        """The numbers of the recording beside those of the orbit."""
        if self.overlay is None:
            return ()
        found, table = self.overlay.found, self.overlay.table
        period = Estimate(value=found.period, error=found.error)
        if self.overlay.holds:
            where = self.overlay.where
            period = Estimate(value=where.period, error=where.period_error)
        metrics = [metric("period", "s", table.period, period)]
        if self.contacts is not None and self.contacts.events:
            stop, events = self.contacts.stop, self.contacts.events
            unit = self.problem.gap_unit
            metrics += contact_metrics(table, events, self.overlay.where, stop, unit)
        if self.deviations is not None:
            metrics += signal_metrics(self.problem, self.deviations, self.signals)
            portraits = recorded_portraits_of(self.problem, self.signals)
            metrics += portrait_metrics(self.deviations, portraits)
        return tuple(metrics)

    @property
    def agrees(self) -> bool:
        """True if the recording shows such an orbit, however far its numbers are off."""
        return not self.reasons

    def metric(self, name: str) -> Metric:
        """Return a number by its name.

        Raises:
            InputError: If no metric has this name.
        """
        for one in self.metrics:
            if one.name == name:
                return one
        known = ", ".join(one.name for one in self.metrics)
        raise InputError(f"Argument `metric` must be one of {known}, but it is `{name}`.")

    def as_json(self) -> dict[str, Any]:
        """Return the comparison as plain data; what is not known is null."""
        source = self.recording.source
        return {
            "agrees": self.agrees,
            "reasons": list(self.reasons),
            "remarks": list(self.remarks),
            "problem": self.orbit.problem,
            "source": None if source is None else source.value,
            "signals": list(self.signals),
            "cycles": None if self.period is None else self.period.n_cycles,
            "release_time": None if self.where is None else _plain(self.where.release),
            "metrics": {
                one.name: {
                    "unit": one.unit,
                    "orbit": _plain(one.orbit),
                    "data": _plain(one.data),
                    "difference": _plain(one.data - one.orbit),
                    "standard_error": _plain(one.error),
                }
                for one in self.metrics
            },
        }


def compare(orbit: ZenoOrbit, problem: Problem, recording: Recording) -> Comparison:
    """Return a recording beside an orbit.

    Args:
        orbit: The orbit.
        problem: Its problem.
        recording: The recording; signals named like states, motors or outputs of the problem count.

    Raises:
        InputError: If no signal is the problem's, or one has a unit of another kind.
        SimulationError: If the orbit does not return.
    """
    names = shared_signals(problem, recording)
    remarks = _oddities(recording, problem, names)
    begun = Comparison(orbit=orbit, problem=problem, recording=recording, signals=names)
    overlay = lay_over(orbit, problem, recording, names, (*_more_signals(problem, names), GAP))
    if overlay is None:
        whole = recording.time[-1] - recording.time[0]
        reason = f"no period is seen in {whole:.4g} s; the orbit's is {orbit.period:.4g} s"
        return replace(begun, reasons=(reason,), remarks=tuple(remarks))
    found, reasons = overlay.found, overlay.reasons()
    if found.n_cycles < 3.0:
        remarks.append(f"only {found.n_cycles:.1f} cycles were recorded: errors are rough")
    if not overlay.holds:
        # Numbers of signals that are mistaken for others would mislead.
        said, why = tuple(remarks), tuple(reasons)
        return replace(begun, overlay=overlay, reasons=why, remarks=said)
    gap = recorded_gap(overlay.table, problem, recording)
    contacts = None if gap is None else _contacts(overlay, problem, gap)
    if gap is None:
        missing = "coordinates that the gap depends on were not recorded"
        remarks.append(f"impacts, locked phase and release cannot be determined: {missing}")
    else:
        unlike, unresolved = _contact_findings(contacts, overlay)
        reasons, remarks = reasons + unlike, remarks + unresolved
    if found.repeats < 1.0 - _STRAY:
        remarks.append(
            f"{100 * (1 - found.repeats):.2g} % of the signals' variance does not repeat"
        )
    deviation = deviations(overlay.table, recording.time, overlay.values, overlay.where)
    remarks += _settling(deviation, recording.time, overlay.where)
    return replace(
        begun,
        overlay=overlay,
        contacts=contacts,
        deviations=deviation,
        reasons=tuple(reasons),
        remarks=tuple(remarks),
    )


def _more_signals(problem: Problem, names: Sequence[str]) -> tuple[str, ...]:
    """Return what portraits need beside the recorded signals."""
    seconds = [one.signals[1] for one in recorded_portraits_of(problem, names)]
    return tuple(dict.fromkeys(second for second in seconds if second not in names))


def _contacts(overlay: Overlay, problem: Problem, gap: Vector) -> Contacts | None:
    """Return the stop and what each cycle shows of it, or nothing if the gap is never at rest."""
    stop = stop_level(gap)
    if stop is None:
        return None
    time, where = overlay.time, overlay.where
    model = gap_model(overlay.table, problem, where.period)
    events = cycle_events(time, gap, stop, model, where.release)
    rests = [one.rest for one in events if one.rested]
    stop = refined_stop(time, gap, stop, rests, where)
    return Contacts(stop=stop, events=cycle_events(time, gap, stop, model, where.release))


def _oddities(recording: Recording, problem: Problem, names: Sequence[str]) -> list[str]:
    remarks: list[str] = []
    others = [name for name in recording.names if name not in names]
    if others:
        remarks.append(f"not signals of the problem, left out: {', '.join(others)}")
    if recording.problem and recording.problem.partition("@")[0] != problem.name.partition("@")[0]:
        remarks.append(
            f"the recording names the problem `{recording.problem}`, not `{problem.name}`"
        )
    if recording.source is None:
        remarks.append("the recording does not say whether it was measured or simulated")
    for name in names:
        row = recording.signal(name).values
        row = row[np.isfinite(row)]
        for extreme in (float(row.max()), float(row.min())):
            share = float(np.mean(np.abs(row - extreme) <= 1e-9 * max(float(np.ptp(row)), 1e-300)))
            if _CLIPPED < share < 0.2 and len(np.unique(row[:2000])) > 200:
                what = f"{100 * share:.2g} % of its values are {extreme:.6g}"
                remarks.append(f"`{name}` looks cut off: {what}")
    return remarks


def _settling(found: Deviations, time: Vector, where: Alignment) -> list[str]:
    """Return a remark if the first cycles are farther from the mean than the others are."""
    sizes = found.sizes_in_turn()
    if len(sizes) < _FEWEST_CYCLES:
        return []
    usual = float(np.nanmedian(sizes[len(sizes) // 2 :]))
    strange = np.flatnonzero(sizes > _SETTLING * usual)
    if not len(strange) or strange[0] > 1 or strange[-1] > len(sizes) // 2:
        return []
    begin = where.release + where.period * math.floor((time[0] - where.release) / where.period)
    until = begin + (int(strange[-1]) + 1) * where.period
    return [f"the motion is still settling at first; skip that part with --from {until:.4g}"]


def _contact_findings(contacts: Contacts | None, overlay: Overlay) -> tuple[list[str], list[str]]:
    """Return why the contacts are not the orbit's, and what the samples are too few to tell."""
    table = overlay.table
    step = float(np.median(np.diff(overlay.time)))
    resolved = table.period - table.zeno_time > _LOCKED_SAMPLES * step
    if contacts is None:
        if resolved:
            return ["no locked phase is seen: the gap is never at rest"], []
        return [], ["locked phases are too short for the sampling: not resolved"]
    events, reasons, remarks = contacts.events, list[str](), list[str]()
    rested, closed = sum(one.rested for one in events), sum(one.closed for one in events)
    if rested < _SEEN * len(events):
        unseen = f"in {len(events) - rested} of {counted(len(events), 'cycle')}"
        if resolved:
            reasons.append(f"no locked phase is seen {unseen}")
        else:
            remarks.append(f"locked phases are too short for the sampling {unseen}: not resolved")
    if closed < _SEEN * len(events):
        cycles = counted(len(events), "cycle")
        reasons.append(f"no impact is seen in {len(events) - closed} of {cycles}")
    struck = [one for one in events if one.closed]
    for what, numbers in (
        ("impacts", [one.first_impact for one in struck]),
        ("flights between impacts", [one.restitution for one in struck]),
    ):
        unknown = sum(not number.known for number in numbers)
        if struck and unknown > (1.0 - _SEEN) * len(struck):
            cycles = counted(unknown, "cycle")
            remarks.append(f"{what} are too short for the sampling in {cycles}: not resolved")
            break
    return reasons, remarks


def _plain(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
