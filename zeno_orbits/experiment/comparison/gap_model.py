"""The gap over a cycle: the orbit's own, flight by flight, and a recording's.

Source: theory (56).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.orbit_table import (
    GAP,
    CubicColumns,
    OrbitTable,
    gap_coordinates,
    measurement,
)
from zeno_orbits.experiment.recordings.recording import Recording
from zeno_orbits.model import Problem

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

    nodes: CubicColumns
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


def gap_model(table: OrbitTable, problem: Problem, period: float) -> GapModel:
    """Return an orbit's gap, stretched to a period.

    Args:
        table: The orbit; the gap is among its signals.
        problem: Its problem.
        period: Of the recording [s].
    """
    dynamics = problem.dynamics(table.p)
    column = [table.measured.names.index(GAP)]
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
    nodes = CubicColumns(
        times=table.nodes.times * stretch,
        values=table.nodes.values[:, column],
        slopes=table.nodes.slopes[:, column] / stretch,
    )
    return GapModel(
        nodes=nodes,
        flights=flights,
        restitution=dynamics.restitution,
        zeno_time=table.zeno_time * stretch,
        period=period,
    )


def recorded_gap(table: OrbitTable, problem: Problem, recording: Recording) -> Vector | None:
    """Return the gap at every time of a recording, or nothing if a coordinate of it is missing.

    Args:
        table: The orbit, at whose parameters the gap is computed.
        problem: Its problem.
        recording: The recording.
    """
    needed = gap_coordinates(problem)
    if not needed or any(name not in recording.names for name in needed):
        return None
    gap = measurement(problem, (GAP,))
    found = np.empty(len(recording.time))
    for at in range(0, len(found), _AT_ONCE):
        piece = slice(at, at + _AT_ONCE)
        states = np.zeros((len(found[piece]), len(problem.state_names)))
        for name in needed:
            column = problem.state_names.index(name)
            states[:, column] = recording.signal(name).values[piece]
        found[piece] = gap.values(states, table.p)[:, 0]
    return found
