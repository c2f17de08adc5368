"""The beginning of a fit: the orbit at the start, laid over the recording, and the observations."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError, ZenoOrbitsError
from zeno_orbits.experiment.comparison.alignment import Alignment
from zeno_orbits.experiment.comparison.comparison import compare_recording
from zeno_orbits.experiment.comparison.folding import Folded, folded, folded_together
from zeno_orbits.experiment.comparison.instruments import corrected
from zeno_orbits.experiment.comparison.overlay import shared_signals
from zeno_orbits.experiment.identification.contact_rows import (
    NO_CONTACTS,
    ContactRows,
    contact_rows,
)
from zeno_orbits.experiment.identification.event_period import event_period
from zeno_orbits.experiment.identification.predictions import Predictions
from zeno_orbits.experiment.identification.unknowns import Unknowns
from zeno_orbits.experiment.orbit_table import PeriodTable, measurement
from zeno_orbits.experiment.recordings.contacts import contact_names
from zeno_orbits.experiment.recordings.periodicity import Periodicity
from zeno_orbits.experiment.recordings.recording import Recording
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import EventReturn, Orbit
from zeno_orbits.search import event_orbit_of, settled_return
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
    """

    orbits: Predictions
    samples: Folded
    contacts: ContactRows
    found: Periodicity
    where: Alignment
    time: Vector
    remarks: tuple[str, ...]
    restitution: float


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
        InputError: If the recording has neither a signal of the problem nor a contact channel, or a
            channel is invalid.
        UnfittableError: If no orbit exists at the start, or the recording does not resemble it.
    """
    own = _prepared_events if problem.has_graph else _prepared_cycle
    return own(problem, begin, unknowns, recording, on_progress)


def prepared_together(first: Prepared, second: Prepared) -> Prepared:
    """Return the beginning of a fit of two files of one orbit, each on its own clock.

    Args:
        first: The beginning for the first file, whose clock tells the period.
        second: The beginning for the second file, from the unknowns of the first one.
    """
    return replace(
        first,
        orbits=first.orbits.of_both(second.orbits),
        samples=folded_together(first.samples, second.samples),
    )


def _prepared_cycle(
    problem: Problem,
    begin: ParameterValues,
    unknowns: Unknowns,
    recording: Recording,
    on_progress: Progress,
) -> Prepared:
    """Return the beginning of a fit of a machine with one stop."""
    on_progress("looking for the orbit at the start", None)
    first, begun = _settled(problem, begin)
    on_progress("laying the recording over it", None)
    names = shared_signals(problem, recording)
    signals = measurement(problem, names)
    unknowns, likely = _likely(
        unknowns,
        recording,
        names,
        lambda: event_period(problem.graph_dynamics(begin), first, signals),
    )
    instruments, errors = unknowns.instruments(names), unknowns.start
    compared = compare_recording(begun, problem, likely)
    laid = compared.overlay
    if compared.reasons or laid is None:
        raise refusal("; ".join(compared.reasons or compared.unresolved))
    _require_cycles(laid.found)
    contacts = compared.contacts
    known = contacts is not None and contacts.restitution.known

    return Prepared(
        orbits=Predictions(problem, unknowns, measurement(problem, laid.names), first),
        samples=folded(laid.time, instruments.read(laid.values.T, errors).T, laid.where),
        contacts=NO_CONTACTS,
        found=replace(laid.found, period=laid.where.period, error=laid.where.period_error),
        where=laid.where,
        time=laid.time,
        remarks=tuple(compared.remarks),
        restitution=contacts.restitution.value if contacts is not None and known else math.nan,
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
    names = shared_signals(problem, recording, contact_names(stops))
    on_progress("looking for the orbit at the start", None)
    changing = [problem.names[place] for place in unknowns.places]
    first, start = _settled(problem, begin, changing)
    on_progress("laying the recording over it", None)
    signals = measurement(problem, names)
    unknowns, likely = _likely(
        unknowns,
        recording,
        names,
        lambda: event_period(problem.graph_dynamics(begin), first, signals),
    )
    compared = compare_recording(start, problem, likely)
    laid = compared.overlay
    if compared.reasons or laid is None:
        raise refusal("; ".join(compared.reasons or compared.unresolved))
    against, unresolved = laid.seen.findings(partly=True)
    if against or unresolved:
        raise refusal("; ".join(against or unresolved))
    _require_cycles(laid.found)
    period = compared.metrics[0]
    where = replace(laid.where, period=period.data, period_error=period.error)

    instruments, errors = unknowns.instruments(names), unknowns.start
    return Prepared(
        orbits=Predictions(problem, unknowns, signals, first),
        samples=folded(laid.time, instruments.read(laid.values.T, errors).T, where),
        contacts=contact_rows(laid.seen, where.release, where.period, where.period_error),
        found=replace(laid.found, period=where.period, error=where.period_error),
        where=where,
        time=laid.time,
        remarks=compared.remarks,
        restitution=math.nan,
    )


def _settled(
    problem: Problem, begin: ParameterValues, changing: Sequence[str] = ()
) -> tuple[EventReturn, Orbit]:
    """Return the orbit at the start of a fit, as a return and as an orbit."""
    try:
        found = settled_return(problem, begin, changing=changing)
    except (SimulationError, InputError) as error:
        missing = "an orbit to fit is missing at the start"
        raise refusal(f"{missing}: {str(error).rstrip('.')}") from error
    return found, event_orbit_of(problem, begin, found)


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
