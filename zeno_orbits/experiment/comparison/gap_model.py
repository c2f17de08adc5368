"""The gap over a cycle: the orbit's own, flight by flight, and a recording's.

Source: theory (56).

The stop as a recorded gap shows it: the level at which the gap rests, and the noise there.

Source: theory (56).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.orbit_table import GAP, Nodes, gap_coordinates, measurement, table_of
from zeno_orbits.experiment.recordings.recording import Recording
from zeno_orbits.model.problem import Problem
from zeno_orbits.orbits.orbit import ZenoOrbit

_AT_ONCE = 1 << 18


@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """A flight of the orbit from one touch of the stop to the next; the first from the release.

    Attributes:
        start: Time since the release [s].
        end: Of the impact that ends it [s].
        rate: Gap rate before that.
        acceleration: Of the gap there.
    """

    start: float
    end: float
    rate: float
    acceleration: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GapModel:
    """The orbit's own gap, stretched to the period of the record.

    Attributes:
        nodes: Gap over time from release to release, and its rate.
        flights: Its flights, the hops among them.
        restitution: Of the orbit.
        zeno_time: [s].
        period: [s].
    """

    nodes: Nodes
    flights: tuple[Flight, ...]
    restitution: float
    zeno_time: float
    period: float

    def flight(self, number: int, since: Vector) -> tuple[Vector, Vector]:
        """Return gap and rate of a flight, followed through the stop as if it were not there.

        Args:
            number: Of the flight; without such a one all is zero.
            since: Times since its start [s].
        """
        if number >= len(self.flights):
            return np.zeros_like(since), np.zeros_like(since)
        one = self.flights[number]
        length = one.end - one.start
        inside, slope = self.nodes.with_slopes(
            one.start + np.clip(since, 0.0, length * (1.0 - 1e-9))
        )
        beyond = np.maximum(since - length, 0.0)
        gap = inside[:, 0] + beyond * (one.rate + beyond * one.acceleration / 2)
        return gap, slope[:, 0] + beyond * one.acceleration

    def opening(self, times: Vector) -> tuple[Vector, Vector]:
        """Return gap and rate after the release; before it they are zero."""
        inside, slope = self.nodes.with_slopes(np.clip(times, 0.0, self.flights[0].end / 2))
        after = times > 0.0
        return np.where(after, inside[:, 0], 0.0), np.where(after, slope[:, 0], 0.0)

    def tail(self, hop: int) -> tuple[float, float]:
        """Return the length of a hop, and by what its tail differs from a geometric series.

        Args:
            hop: Its number from 1.
        """
        e = self.restitution
        if hop >= len(self.flights) or e == 0.0:
            return math.nan, 1.0
        one = self.flights[hop]
        length = one.end - one.start
        return length, (self.zeno_time - one.end) * (1 - e) / (length * e)


def gap_model(orbit: ZenoOrbit, problem: Problem, period: float) -> GapModel:
    """Return an orbit's gap, stretched to a period.

    Raises:
        SimulationError: If the orbit does not return.
    """
    table = table_of(orbit, problem, (GAP,))
    dynamics = problem.dynamics(table.p)
    cycle, stretch = table.cycle, period / table.period
    starts = [cycle.start.time, *(impact.time for impact in cycle.impacts)]
    flights = tuple(
        Flight(
            start=(start - cycle.start.time) * stretch,
            end=(impact.time - cycle.start.time) * stretch,
            rate=impact.approach_rate / stretch,
            acceleration=dynamics.gap_acceleration(impact.state_minus) / stretch**2,
        )
        for start, impact in zip(starts, cycle.impacts, strict=False)
    )
    nodes = Nodes(
        times=table.nodes.times * stretch,
        values=table.nodes.values,
        slopes=table.nodes.slopes / stretch,
    )
    return GapModel(
        nodes=nodes,
        flights=flights,
        restitution=dynamics.restitution,
        zeno_time=table.zeno_time * stretch,
        period=period,
    )


def recorded_gap(orbit: ZenoOrbit, problem: Problem, recording: Recording) -> Vector | None:
    """Return the gap at every time of a recording, or nothing if a coordinate of it is missing."""
    needed = gap_coordinates(problem)
    if not needed or any(name not in recording.names for name in needed):
        return None
    p = np.asarray(orbit.values(problem).vector, dtype=np.float64)
    gap = measurement(problem, (GAP,))
    found = np.empty(len(recording.time))
    for at in range(0, len(found), _AT_ONCE):
        piece = slice(at, at + _AT_ONCE)
        states = np.zeros((len(found[piece]), len(problem.state_names)))
        for name in needed:
            column = problem.state_names.index(name)
            states[:, column] = recording.signal(name).values[piece]
        found[piece] = gap.values(states, p)[:, 0]
    return found


_BAND = 5.0
"""A gap within so many standard deviations of the noise counts as closed."""
_FINEST = 1e-4
"""The same for a record without noise, in parts of the range of the gap."""
_LOW = 0.2
"""The level of the stop is looked for in this part of the range above the lowest gap."""
_RESTING = 0.05
"""Part of the samples that rest at the stop at least, for a level to be seen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop:
    """The stop as a recorded gap shows it.

    Attributes:
        level: Gap at rest; what it is off zero is an offset of the instruments.
        noise: Standard deviation of the gap there.
        band: A gap this near to the level counts as closed.
    """

    level: float
    noise: float
    band: float


def stop_level(gap: Vector) -> Stop | None:
    """Return the level at which a gap rests, or nothing if it rests nowhere.

    Args:
        gap: The gap in order of time, NaN where it was not taken.
    """
    seen = gap[np.isfinite(gap)]
    if len(seen) < 50:
        return None
    low, high = (float(v) for v in np.quantile(seen, [0.002, 0.998]))
    extent = high - low
    if not extent > 0.0:
        return None
    candidates = np.sort(seen[(seen < low + _LOW * extent)])
    needed = max(int(_RESTING * len(seen)), 10)
    if len(candidates) <= needed:
        return None
    widths = candidates[needed:] - candidates[:-needed]
    at = int(np.argmin(widths))
    core = candidates[at : at + needed + 1]
    level, width = float(np.median(core)), float(widths[at])
    noise = _noise(gap, seen, level, width, extent)
    for _ in range(3):
        inside = seen[np.abs(seen - level) < _BAND * noise]
        if len(inside) > needed:
            level = float(np.mean(inside[np.abs(inside - level) < 2.5 * noise]))
    return Stop(level=level, noise=noise, band=max(_BAND * noise, _FINEST * extent))


def _noise(gap: Vector, seen: Vector, level: float, width: float, extent: float) -> float:
    """Return the scatter of neighbours near a level: whatever moves slowly besides is no noise."""
    near = np.abs(gap - level) < max(3 * width, _FINEST * extent)
    triples = near[:-2] & near[1:-1] & near[2:]
    second = (gap[1:-1] - (gap[:-2] + gap[2:]) / 2)[triples]
    noise = 1.4826 * float(np.median(np.abs(second))) / math.sqrt(1.5) if len(second) else 0.0
    steps = np.abs(np.diff(seen))
    quantum = float(np.min(steps[steps > 1e-9 * extent], initial=math.inf))
    if math.isfinite(quantum) and np.mean(steps <= 1e-9 * extent) > 0.2:
        # An encoder: its values repeat, and their scatter hides in the last digit.
        noise = max(noise, quantum / math.sqrt(12.0))
    return max(noise, width / 8)


def refined_stop(
    time: Vector,
    gap: Vector,
    stop: Stop,
    rests: Sequence[tuple[float, float]],
    release: float,
    period: float,
) -> Stop:
    """Return the stop as the early half of every rest shows it, far from where the gap opens.

    Args:
        time: Increasing, ``(n_t,)`` [s].
        gap: ``(n_t,)``.
        stop: A first value.
        rests: When each cycle is seen to rest with it, from and to, since its release [s].
        release: A time of the orbit's release in the record [s].
        period: [s].
    """
    if not rests:
        return stop
    start, end = (float(np.median(times)) for times in zip(*rests, strict=True))
    since = np.mod(time - release, period)
    early = (since > start + 0.1 * (end - start)) & (since < start + 0.5 * (end - start))
    resting = gap[early & (np.abs(gap - stop.level) < 2 * stop.band)]
    if len(resting) < 10:
        return stop
    level, noise = float(np.mean(resting)), max(float(np.std(resting)), 0.3 * stop.noise)
    finest = stop.band if stop.band > _BAND * stop.noise else 0.0
    return Stop(level=level, noise=noise, band=max(_BAND * noise, finest))
