"""One trial of a transient, prepared for a fit: samples, weights, masks, horizons and the start."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, not_known
from zeno_orbits.experiment.orbit_table import Measurement, measurable, measurement
from zeno_orbits.experiment.recordings.recording import Recording
from zeno_orbits.experiment.transients.event_record import EventSeries, event_series
from zeno_orbits.experiment.transients.seen_impacts import (
    all_impacts,
    beside_impacts,
    impacts_in_gap,
    needed_states,
    noise_of,
    recorded_gaps,
)
from zeno_orbits.model import GraphDynamics, ParameterValues, Problem
from zeno_orbits.simulation import EventKind

CLOCK, OFFSET, RATE = "clock", "offset", "clock_rate"
"""Names of the phase of the clock of the machine, of the time offset, and of the rate of the clock
of a second file among the free initial values."""
_LEAST = 8
"""Samples of a trial, at least."""
_FEW = 25
"""Samples from which initial values are extrapolated, at most."""
_MOST_SAMPLES = 200_000
_EQUAL = 8
"""Horizons of a trial without a seen impact."""
_EVENT_ERROR = 2e-3
"""First guess of the error of event times, relative to the longest interval between them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FreeStart:
    """An initial value that a fit determines.

    Attributes:
        name: Name of the state, `clock` or `offset`.
        direction: Change of the initial state per unit, ``(n_x,)``. It is zero for the offset.
        scale: Size of a change.
        reach: Bound of the change, in units of the scale.
    """

    name: str
    direction: Vector
    scale: float
    reach: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrialData:
    """A trial.

    Attributes:
        label: Name of the trial in messages.
        origin: Recorded time of the initial state [s].
        time: Times of the samples since the origin, ``(n,)`` [s].
        measured: The recorded signals.
        values: Samples, ``(n, n_s)``.
        seen: Mask of the samples that count, ``(n, n_s)``.
        noise: Standard deviation of the noise of the channels, ``(n_s,)``.
        series: Event times, since the origin.
        event_errors: Standard error of each series [s].
        impacts: Times of the impacts that the gap shows, by stop, since the origin.
        every_impact: The same with the impacts between slow flights.
        start: Initial state at the start of the fit, ``(n_x,)``.
        free: The free initial values.
        horizons: End times of the stages of the fit, the last one whole [s].
        remarks: Remarks on the trial.
        shift: Time offset of the simulation at the start of the fit [s].
        jumping: Mask of the channels that may jump at impacts, ``(n_s,)``.
        twin: Index of the trial whose motion this one is, on another clock, or ``None``.
    """

    label: str
    origin: float
    time: Vector
    measured: Measurement
    values: Vector
    seen: NDArray[np.bool_]
    noise: Vector
    series: tuple[EventSeries, ...]
    event_errors: tuple[float, ...]
    impacts: Mapping[str, Vector]
    every_impact: Mapping[str, Vector]
    start: Vector
    free: tuple[FreeStart, ...]
    horizons: tuple[float, ...]
    remarks: tuple[str, ...]
    shift: float = 0.0
    jumping: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    twin: int | None = None

    def without(self, impacts: Vector) -> TrialData:
        """Return the trial without the samples of jumping channels beside further impacts.

        Args:
            impacts: Times of impacts since the origin, in order [s].
        """
        if not len(self.time):
            return self
        step = float(np.median(np.diff(self.time)))
        beside = beside_impacts(self.time, impacts, step)
        return replace(self, seen=self.seen & ~(beside[:, None] & self.jumping[None, :]))

    @property
    def n_events(self) -> int:
        """Number of event times."""
        return sum(len(one.times) for one in self.series)

    @property
    def end(self) -> float:
        """Time of the last sample or event [s]."""
        times = [one.times[-1] for one in self.series if len(one.times)]
        return float(max([*self.time[-1:].tolist(), *times]))


def prepared_trial(
    problem: Problem,
    values: ParameterValues,
    recording: Recording,
    *,
    label: str,
    start: Mapping[str, float],
    free: Collection[str],
) -> TrialData:
    """Return a trial.

    Args:
        problem: The problem.
        values: Parameter values at the start of the fit.
        recording: The recording of the trial.
        label: Name of the trial in messages.
        start: Known initial values.
        free: Further initial values to determine: states, `clock`, `offset`.

    Raises:
        InputError: If the recording holds nothing of the problem, or a name is unknown.
    """
    graph = problem.graph_dynamics(values)
    _require_names(problem, start, free)
    known = measurable(problem)
    names = tuple(name for name in recording.names if name in known)
    series = event_series(recording, graph.stop_names)
    if not names and not any(len(one.times) for one in series):
        titles = ", ".join((*known, "impact", "release"))
        raise InputError(f"Argument `recording`: no signal of the problem (known: {titles}).")
    if len(recording.time) > _MOST_SAMPLES and names:
        wanted = f"has {len(recording.time)} samples and a transient at most {_MOST_SAMPLES}"
        raise InputError(f"Argument `recording` {wanted}: crop it with --t-start and --t-end.")
    begin = np.array(problem.initial_state(start or None, values), dtype=np.float64)
    clock = list(problem.clock)
    if clock and not begin[clock].any():
        begin[clock] = np.array(problem.initial_state(None, values))[clock]
    if not names:
        return _of_events(problem, graph, begin, series, label, free)
    return _of_samples(problem, graph, begin, recording, names, series, label, start, free)


def _require_names(problem: Problem, start: Mapping[str, float], free: Collection[str]) -> None:
    for name in start:
        if name not in problem.state_names:
            raise InputError(f"Argument `start`: {not_known(name, problem.state_names)}")
    for name in free:
        known = (*problem.state_names, CLOCK, OFFSET)
        if name not in known:
            raise InputError(f"Argument `initial`: {not_known(name, known)}")
        if name == CLOCK and not problem.clock:
            raise InputError("Argument `initial`: the problem lacks a clock.")


def _of_events(
    problem: Problem,
    graph: GraphDynamics,
    begin: Vector,
    series: Sequence[EventSeries],
    label: str,
    free: Collection[str],
) -> TrialData:
    """Return a trial of event times alone. Its origin is the recorded time 0."""
    n_x = len(begin)
    times = np.concatenate([one.times for one in series])
    span = float(np.ptp(times)) or 1.0
    size = np.asarray(graph.own.states(n_x), dtype=np.float64)
    found = [_state(problem, name, begin, size) for name in free if name not in (CLOCK, OFFSET)]
    found.append(FreeStart(name=OFFSET, direction=np.zeros(n_x), scale=span, reach=4.0))
    if CLOCK in free:
        found.append(_clock(problem, begin))
    ends = sorted({*np.concatenate([one.times for one in series]).tolist()})
    horizons = (ends[min(3, len(ends) - 1)], ends[len(ends) // 2])
    return TrialData(
        label=label,
        origin=0.0,
        time=np.zeros(0),
        measured=measurement(problem, ()),
        values=np.zeros((0, 0)),
        seen=np.zeros((0, 0), dtype=np.bool_),
        noise=np.zeros(0),
        series=tuple(series),
        event_errors=tuple(_error_of(one) for one in series),
        impacts={},
        every_impact={},
        start=begin,
        free=tuple(found),
        horizons=(*horizons, math.inf),
        remarks=(),
    )


def _state(problem: Problem, name: str, begin: Vector, size: Vector) -> FreeStart:
    k = problem.state_names.index(name)
    direction = np.zeros(len(begin))
    direction[k] = 1.0
    scale = abs(begin[k]) or float(size[k])
    return FreeStart(name=name, direction=direction, scale=scale, reach=0.95)


def _clock(problem: Problem, begin: Vector) -> FreeStart:
    cosine, sine = problem.clock[:2]
    direction = np.zeros(len(begin))
    direction[cosine], direction[sine] = -begin[sine], begin[cosine]
    return FreeStart(name=CLOCK, direction=direction, scale=1.0, reach=1.0)


def _error_of(one: EventSeries) -> float:
    longest = float(np.max(np.diff(one.times))) if len(one.times) > 1 else 1.0
    return max(one.error, _EVENT_ERROR * longest)


def _of_samples(
    problem: Problem,
    graph: GraphDynamics,
    begin: Vector,
    recording: Recording,
    names: tuple[str, ...],
    series: Sequence[EventSeries],
    label: str,
    start: Mapping[str, float],
    free: Collection[str],
) -> TrialData:
    """Return a trial of samples, with event times if the columns have them."""
    time, names, values = _samples(recording, names, label)
    origin = float(time[0])
    time = time - origin
    states = {
        problem.state_names.index(name): values[:, k]
        for k, name in enumerate(names)
        if name in problem.state_names
    }
    gaps = recorded_gaps(graph, begin, states)
    impacts = {stop: impacts_in_gap(time, row) for stop, row in gaps.items()}
    series = tuple(_since(one, origin) for one in series)
    heard = [one.times for one in series if one.kind is EventKind.IMPACT]
    every = np.sort(np.concatenate([*impacts.values(), *heard, np.zeros(0)]))
    measured = measurement(problem, names)
    step = float(np.median(np.diff(time)))
    seen = np.isfinite(values)
    jumping = _jumping(problem, graph, measured, begin, graph.p)
    for own in (*impacts.values(), *heard):
        seen &= ~(beside_impacts(time, own, step)[:, None] & jumping[None, :])
    moving = np.nanmax(values, axis=0) > np.nanmin(values, axis=0)
    if not moving.any() and not any(len(one.times) for one in series):
        raise InputError(f"Argument `recording`: no signal of {label} changes.")
    seen &= moving[None, :]
    noise = np.where(moving, [noise_of(row) for row in values.T], 1.0)
    first = float(every[0]) if len(every) else float(time[-1])
    at_start, frees = _extrapolated(problem, graph, begin, time, states, first, start, free)
    still = [
        f"{label}: `{name}` never changes and does not count"
        for name, moves in zip(names, moving.tolist(), strict=True)
        if not moves
    ]
    known = {*start, *(one.name for one in frees), *(problem.state_names[k] for k in states)}
    return TrialData(
        label=label,
        origin=origin,
        time=time,
        measured=measured,
        values=values,
        seen=seen,
        noise=noise,
        series=series,
        event_errors=tuple(_error_of(one) for one in series),
        impacts=impacts,
        every_impact={stop: all_impacts(time, row) for stop, row in gaps.items()},
        start=at_start,
        free=frees,
        horizons=_horizons(time, every),
        jumping=jumping,
        remarks=(*still, *_taken(problem, label, at_start, known)),
    )


def _samples(
    recording: Recording, names: Sequence[str], label: str
) -> tuple[Vector, tuple[str, ...], Vector]:
    """Return the times with a sample, the channels with samples, and their values, ``(n, n_s)``.

    Raises:
        InputError: If there are too few.
    """
    names = tuple(name for name in names if np.isfinite(recording.signal(name).values).any())
    if not names:
        raise InputError(f"Argument `recording`: all samples of {label} are missing.")
    values = np.stack([recording.signal(name).values for name in names], axis=1)
    rows = np.isfinite(values).any(axis=1)
    if np.count_nonzero(rows) < _LEAST:
        raise InputError(f"Argument `recording`: {label} has fewer than {_LEAST} samples.")
    return recording.time[rows], names, values[rows]


def _taken(problem: Problem, label: str, start: Vector, known: Collection[str]) -> Iterator[str]:
    """Yield a remark for every initial value that is neither given nor recorded nor determined."""
    for k, name in enumerate(problem.state_names):
        if k not in problem.clock and name not in known and start[k] != 0.0:
            yield f"{label}: the initial value of `{name}` is taken as {start[k]:.6g}"


def _since(one: EventSeries, origin: float) -> EventSeries:
    return replace(one, times=one.times - origin)


def _jumping(
    problem: Problem, graph: GraphDynamics, measured: Measurement, x: Vector, p: Vector
) -> NDArray[np.bool_]:
    """Return the mask of the channels that depend on velocities or currents, which may jump."""
    inside = x[None, :] + 0.1 + 0.01 * np.arange(len(x))
    slopes = measured.derivatives(inside, p)[0][:, : len(x)]
    fast = [k for k in range(graph.n_q, len(x)) if k not in problem.clock]
    return np.asarray(np.any(slopes[:, fast] != 0.0, axis=1), dtype=np.bool_)


def _extrapolated(
    problem: Problem,
    graph: GraphDynamics,
    begin: Vector,
    time: Vector,
    states: Mapping[int, Vector],
    first: float,
    start: Mapping[str, float],
    free: Collection[str],
) -> tuple[Vector, tuple[FreeStart, ...]]:
    """Return the initial state and its free values, from the first samples of recorded states."""
    x, n_q, found = begin.copy(), graph.n_q, list[FreeStart]()
    rows = slice(0, int(np.clip(np.searchsorted(time, 0.6 * first), 4, _FEW)))
    for k, name in enumerate(problem.state_names):
        if k in problem.clock:
            continue
        coordinate = k - n_q if n_q <= k < 2 * n_q and k not in states else k
        row = states.get(coordinate)
        scale = abs(begin[k]) or 1.0
        reach = 1.0
        if row is not None:
            value, slope = _line(time[rows], row[rows])
            size = float(np.nanmax(row) - np.nanmin(row)) or 1.0
            is_rate = coordinate != k
            steps = np.abs(np.diff(row)) / np.diff(time)
            scale = float(np.nanquantile(steps, 0.98)) or 1.0 if is_rate else size
            reach = 1.0 if is_rate else 0.3
            if name not in start:
                x[k] = slope if is_rate else value
        known = name in start
        if name in free or (row is not None and not known):
            direction = np.zeros(len(x))
            direction[k] = 1.0
            found.append(FreeStart(name=name, direction=direction, scale=scale, reach=reach))
    if CLOCK in free:
        found.append(_clock(problem, x))
    if OFFSET in free:
        span = float(time[-1])
        found.append(FreeStart(name=OFFSET, direction=np.zeros(len(x)), scale=span, reach=0.3))
    x, held = _on_stops(graph, x, states)
    return x, tuple(one for one in found if not held & set(np.flatnonzero(one.direction).tolist()))


def _on_stops(
    graph: GraphDynamics, x: Vector, states: Mapping[int, Vector]
) -> tuple[Vector, set[int]]:
    """Return the start moved onto stops that it touches, and the states that are held there."""
    held: set[int] = set()
    if not graph.stop_names:
        return x, held
    for view in graph.open_views:
        gap = float(view.gap(x))
        # The gap counts in the units of its coordinates up to their transmission.
        rows = [states[k] for k in needed_states(view.gap, x) if k in states]
        noise = max((noise_of(row) for row in rows), default=0.0)
        size = max((float(np.nanmax(row) - np.nanmin(row)) for row in rows), default=1.0)
        if gap > max(6.0 * noise, 1e-9 * size):
            continue
        resting = view.on_stop(x)
        moved = set(np.flatnonzero(np.abs(resting - x) > 0.0).tolist())
        held |= moved | {k + graph.n_q for k in moved if k < graph.n_q}
        held |= {k - graph.n_q for k in moved if graph.n_q <= k < 2 * graph.n_q}
        x = resting
    return x, held


def _line(time: Vector, row: Vector) -> tuple[float, float]:
    """Return the value and the slope at time 0 of a parabola through samples."""
    known = np.isfinite(row)
    if known.sum() < 3:
        return (float(row[known][0]) if known.any() else 0.0), 0.0
    order = 2 if known.sum() >= 6 else 1
    fitted = np.polyfit(time[known], row[known], order)
    return float(fitted[-1]), float(fitted[-2])


def _horizons(time: Vector, impacts: Vector) -> tuple[float, ...]:
    """Return the ends of the stages: before the first impact, inside each flight, and the end."""
    end = float(time[-1])
    if not len(impacts):
        return (*(end * k / _EQUAL for k in range(1, _EQUAL)), math.inf)
    edges = [*impacts.tolist(), end]
    found = [0.97 * edges[0]]
    found += [a + 0.6 * (b - a) for a, b in itertools.pairwise(edges)]
    last = found[-1]
    found += [part * end for part in (0.6, 0.8) if part * end > last]
    step = float(np.median(np.diff(time)))
    kept: list[float] = []
    for one in sorted(found):
        if one > 8 * step and one < 0.95 * end and (not kept or one > kept[-1] + 0.05 * end):
            kept.append(one)
    return (*kept, math.inf)
