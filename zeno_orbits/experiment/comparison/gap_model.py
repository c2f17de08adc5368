"""The gap over a cycle: the orbit's own, flight by flight, and a recording's.

Source: theory (6.9).
"""

from __future__ import annotations

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
    """A flight of the orbit between two contacts. The first flight begins at the release.

    Attributes:
        start: Time since the release [s].
        end: Time of the impact that ends the flight [s].
        rate: Gap rate before that impact.
    """

    start: float
    end: float
    rate: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GapModel:
    """The orbit's own gap, stretched to the period of the record.

    Attributes:
        nodes: Gap over time from release to release, and its rate.
        flights: Its flights, the hops among them.
        restitution: Restitution of the orbit's first impact.
        zeno_time: [s].
        period: [s].
    """

    nodes: CubicColumns
    flights: tuple[Flight, ...]
    restitution: float
    zeno_time: float
    period: float


def gap_model(table: OrbitTable, problem: Problem, period: float) -> GapModel:
    """Return an orbit's gap, stretched to a period.

    Args:
        table: The orbit, with the gap among its signals.
        problem: Its problem.
        period: Period of the recording [s].
    """
    dynamics = problem.dynamics(table.p)
    column = [table.measured.names.index(GAP)]
    stretch = period / table.period
    starts = [0.0, *(impact.time for impact in table.impacts)]
    flights = tuple(
        Flight(
            start=start * stretch,
            end=impact.time * stretch,
            rate=impact.approach_rate / stretch,
        )
        for start, impact in zip(starts, table.impacts, strict=False)
    )
    nodes = CubicColumns(
        times=table.nodes.times * stretch,
        values=table.nodes.values[:, column],
        slopes=table.nodes.slopes[:, column] / stretch,
    )
    return GapModel(
        nodes=nodes,
        flights=flights,
        restitution=dynamics.restitution_of(-table.impacts[0].approach_rate),
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
