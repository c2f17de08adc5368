"""The beginning of a fit: the orbit at the start, laid over the recording, and the observations."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError, ZenoOrbitsError
from zeno_orbits.experiment.comparison.alignment import Alignment
from zeno_orbits.experiment.comparison.comparison import compare_recording
from zeno_orbits.experiment.comparison.event_comparison import Unlaid, event_remarks, lay_events
from zeno_orbits.experiment.comparison.event_reference import orbit_sequences, shared_event_signals
from zeno_orbits.experiment.comparison.folding import Folded, folded
from zeno_orbits.experiment.comparison.overlay import shared_signals
from zeno_orbits.experiment.identification.contact_rows import (
    NO_CONTACTS,
    ContactRows,
    contact_rows,
)
from zeno_orbits.experiment.identification.event_predictions import (
    EventPeriod,
    EventPredictions,
    event_period,
)
from zeno_orbits.experiment.identification.instruments import corrected
from zeno_orbits.experiment.identification.predictions import OrbitPredictions, Predictions
from zeno_orbits.experiment.identification.unknowns import Unknowns
from zeno_orbits.experiment.orbit_table import (
    OrbitTable,
    PeriodTable,
    measurable,
    measurement,
    tabulate_orbit,
)
from zeno_orbits.experiment.recordings.contacts import contact_channels, contact_names
from zeno_orbits.experiment.recordings.periodicity import Periodicity
from zeno_orbits.experiment.recordings.recording import Recording
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import EventOrbit, ZenoOrbit
from zeno_orbits.search import event_orbit_of, orbit_by_shooting, orbit_of, settled_return
from zeno_orbits.work import Progress

_LEAST_CYCLES = 2.0
_EVEN = 1000
"""Phases at which an orbit is compared in size and mean with a recording."""


class UnfittableError(ZenoOrbitsError):
    """A recording gives no parameters: it shows no such orbit, or none comes near it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prepared:
    """The beginning of a fit.

    Attributes:
        orbits: Predictions of orbits at unknowns.
        samples: The recording, folded.
        contacts: The edges of its contact channels.
        found: Period of the recording.
        where: Place of the orbit at the start in it.
        time: Times of the recording [s].
        remarks: Remarks on the recording.
        restitution: The restitution that its contacts show, or NaN.
        orbit_of: Function that returns the orbit of a table of `orbits` at its parameter values.
    """

    orbits: OrbitPredictions[Any]
    samples: Folded
    contacts: ContactRows
    found: Periodicity
    where: Alignment
    time: Vector
    remarks: tuple[str, ...]
    restitution: float
    orbit_of: Callable[[Any, ParameterValues], ZenoOrbit | EventOrbit]


def prepared(
    problem: Problem,
    begin: ParameterValues,
    unknowns: Unknowns,
    recording: Recording,
    on_progress: Progress,
) -> Prepared:
    """Return the beginning of a fit.

    Args:
        problem: The problem.
        begin: All initial parameter values.
        unknowns: The unknowns.
        recording: The recording.
        on_progress: Called with each stage.

    Raises:
        InputError: If the recording of a machine with several stops or switches has neither a
            signal of the problem nor a contact channel, or a channel is invalid.
        UnfittableError: If no orbit exists at the start, or the recording does not resemble it.
    """
    own = _prepared_events if problem.has_graph else _prepared_cycle
    return own(problem, begin, unknowns, recording, on_progress)


def _prepared_cycle(
    problem: Problem,
    begin: ParameterValues,
    unknowns: Unknowns,
    recording: Recording,
    on_progress: Progress,
) -> Prepared:
    """Return the beginning of a fit of a machine with one stop."""
    on_progress("looking for the orbit at the start", None)
    closing = orbit_by_shooting(problem, begin)
    if closing.orbit is None:
        raise refusal(f"an orbit to fit is missing at the start: {closing.detail.rstrip('.')}")
    on_progress("laying the recording over it", None)
    names, begun = shared_signals(problem, recording), closing.orbit
    unknowns, likely = _likely(
        unknowns, recording, names, lambda: tabulate_orbit(begun, problem, names)
    )
    instruments, errors = unknowns.instruments(names), unknowns.start
    first = compare_recording(begun, problem, likely)
    laid = first.overlay
    if first.reasons or laid is None:
        raise refusal("; ".join(first.reasons))
    _require_cycles(laid.found)
    contacts = first.contacts
    known = contacts is not None and contacts.restitution.known

    def orbit(table: OrbitTable, values: ParameterValues) -> ZenoOrbit:
        return orbit_of(table.cycle, problem, values)

    return Prepared(
        orbits=Predictions(problem, unknowns, measurement(problem, laid.names), laid.table.cycle),
        samples=folded(laid.time, instruments.read(laid.values.T, errors).T, laid.where),
        contacts=NO_CONTACTS,
        found=replace(laid.found, period=laid.where.period, error=laid.where.period_error),
        where=laid.where,
        time=laid.time,
        remarks=tuple(first.remarks),
        restitution=contacts.restitution.value if contacts is not None and known else math.nan,
        orbit_of=orbit,
    )


def _prepared_events(
    problem: Problem,
    begin: ParameterValues,
    unknowns: Unknowns,
    recording: Recording,
    on_progress: Progress,
) -> Prepared:
    """Return the beginning of a fit of a machine with several stops or switches."""
    stops = problem.graph_dynamics(begin).stop_names
    channels = contact_channels(recording, stops)
    names = shared_event_signals(problem, recording)
    titles = dict(zip(stops, contact_names(stops), strict=True))
    _require_channels(problem, recording, names, channels, titles)
    on_progress("looking for the orbit at the start", None)
    changing = [problem.names[place] for place in unknowns.places]
    try:
        first = settled_return(problem, begin, changing=changing)
    except (SimulationError, InputError) as error:
        missing = "an orbit to fit is missing at the start"
        raise refusal(f"{missing}: {str(error).rstrip('.')}") from error
    on_progress("laying the recording over it", None)
    start = event_orbit_of(problem, begin, first)
    for stop in channels:
        if not orbit_sequences(start, stop):
            raise refusal(f"the orbit at the start does not strike `{stop}`, the recording does")
    signals = measurement(problem, names)
    unknowns, likely = _likely(
        unknowns,
        recording,
        names,
        lambda: event_period(problem.graph_dynamics(begin), first, signals),
    )
    laid = lay_events(start, problem, likely, names, channels, partly=True)
    if isinstance(laid, Unlaid):
        raise refusal(laid.reason)
    reasons = (*laid.against, *laid.unlike) or laid.unresolved
    if reasons:
        raise refusal("; ".join(reasons))
    _require_cycles(laid.found)
    period, place, time = laid.period, laid.place.start, recording.time
    where = Alignment(
        release=place.value,
        error=place.error,
        period=period.value,
        period_error=period.error,
        phase_error=math.hypot(place.error, period.error * laid.found.n_cycles / 2) / period.value,
        likeness=(),
        time_suspicion="",
        backward=False,
    )
    values = [recording.signal(name).values for name in names]
    rows = np.stack(values) if values else np.zeros((0, len(time)))

    def orbit(table: EventPeriod, values: ParameterValues) -> EventOrbit:
        return event_orbit_of(problem, values, table.found)

    return Prepared(
        orbits=EventPredictions(problem, unknowns, signals, first),
        samples=folded(time, rows, where),
        contacts=contact_rows(laid.seen, place.value, period.value, period.error),
        found=replace(laid.found, period=period.value, error=period.error),
        where=where,
        time=time,
        remarks=event_remarks(recording, problem, names, tuple(titles.values())),
        restitution=math.nan,
        orbit_of=orbit,
    )


def _require_channels(
    problem: Problem,
    recording: Recording,
    names: Sequence[str],
    channels: Mapping[str, Vector],
    titles: Mapping[str, str],
) -> None:
    """Refuse a recording without a signal or contact of the problem.

    Args:
        problem: The problem.
        recording: The recording.
        names: Names of its signals.
        channels: Its contact channels by their stops.
        titles: Names of the contact channels of all stops.

    Raises:
        InputError: If nothing is recorded, or a contact channel is constant.
    """
    if not names and not channels:
        listed = ", ".join((*measurable(problem), *titles.values()))
        has = ", ".join(recording.names) or "none"
        wanted = f"must have a signal or a contact channel of the problem ({listed})"
        raise InputError(f"Argument `recording` {wanted}, but it has {has}.")
    for stop, channel in channels.items():
        values = channel[np.isfinite(channel)]
        if not len(values) or np.ptp(values) == 0.0:
            lacks = f"has a contact channel `{titles[stop]}` that never changes"
            raise InputError(f"Argument `recording` {lacks}: leave it out.")


def _likely(
    unknowns: Unknowns,
    recording: Recording,
    names: Sequence[str],
    tabulated: Callable[[], PeriodTable],
) -> tuple[Unknowns, Recording]:
    """Return unknowns near the orbit at the start, and the recording without such errors.

    Args:
        unknowns: The unknowns.
        recording: The recording.
        names: Names of its signals.
        tabulated: Function that returns the orbit at the start, called if a channel has an error.

    Raises:
        InputError: If an unknown names a channel that is not recorded.
    """
    instruments = unknowns.instruments(names)
    if not instruments.has_channel_errors:
        return unknowns, recording
    table = tabulated()
    near = unknowns.near(names, _last_periods(recording, names, table.period), _even(table))
    return near, corrected(recording, names, instruments, near.start)


def _last_periods(recording: Recording, names: Sequence[str], period: float) -> Vector:
    """Return the signals of a recording over its last whole periods, ``(n, n_s)``."""
    time = recording.time
    span = float(time[-1] - time[0])
    begin = time[-1] - max(math.floor(span / period), 1) * period
    first = int(np.count_nonzero(time < begin))
    return np.stack([recording.signal(name).values[first:] for name in names], axis=1)


def _even(table: PeriodTable) -> Vector:
    """Return the signals of an orbit at even phases, ``(n, n_s)``."""
    return table.at(np.arange(_EVEN) / _EVEN)


def _require_cycles(found: Periodicity) -> None:
    if found.n_cycles < _LEAST_CYCLES:
        raise refusal(f"{found.n_cycles:.4g} periods were recorded, and two are needed")


def refusal(reason: str) -> UnfittableError:
    """Return the error of a recording that gives no parameters."""
    return UnfittableError(f"No parameters were found: {reason}.")
