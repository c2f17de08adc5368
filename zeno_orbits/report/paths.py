"""An execution as curves to draw: each arc sampled where it bends, and its phases."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model import Problem
from zeno_orbits.simulation import Arc, Ending, Execution, Mode

_SEEN = 0.004
"""A tail shorter than this part of the motion is too short to see."""
_BEND = 1e-4
"""Distance of a curve from its chord that cannot be seen, in ranges of the execution."""
_ROUNDS = 7
"""How often an interval between two steps is cut into three at most."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ArcPath:
    """An arc as a curve.

    Attributes:
        kind: ``free``, ``locked``, or ``tail`` for the end of an impact sequence.
        times: Times [s], ``(m,)``.
        states: States there, ``(m, n_x)``.
        closed: Names of the closed stops, empty for a machine with one unnamed stop.
    """

    kind: str
    times: Vector
    states: Vector
    closed: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawnPhase:
    """A stretch of an execution in which the same stops are closed.

    Attributes:
        mode: Off all stops, or on a stop.
        closed: Names of the closed stops, empty for a machine with one unnamed stop.
        start: When it starts [s].
        end: When it ends [s].
    """

    mode: Mode
    closed: tuple[str, ...]
    start: float
    end: float


def drawn_paths(execution: Execution, *, least: int = 8) -> list[ArcPath]:
    """Return every arc as a curve. Tails too short to be visible are omitted.

    Args:
        execution: The execution.
        least: Smallest number of points on each arc.
    """
    corners = [states for arc in execution.arcs for states in (arc.start_state, arc.end_state)]
    flows = [arc.flow_states[:, : len(corners[0])] for arc in execution.arcs]
    ranges = np.ptp(np.concatenate([corners, *flows]), axis=0)
    shortest = _SEEN * (execution.end_time - execution.arcs[0].start_time)
    paths: list[ArcPath] = []
    for arc in execution.arcs:
        is_tail = arc.ending is Ending.ZENO
        if is_tail and arc.end_time - arc.start_time <= shortest:
            continue
        times, states = _smooth(arc, ranges, 2 if is_tail else least)
        kind = "tail" if is_tail else arc.mode.value
        paths.append(ArcPath(kind=kind, times=times, states=states, closed=arc.closed))
    return paths


def _smooth(arc: Arc, ranges: Vector, least: int) -> tuple[Vector, Vector]:
    """Return times and states at every step, and between steps wherever a chord would be seen."""
    times, states = arc.sampled(least)
    units = np.where(ranges > 0.0, ranges, 1.0)
    left = np.arange(len(times) - 1)
    for _ in range(_ROUNDS):
        # At both thirds: where a curve turns from left to right, it crosses its chord once.
        step, rise = (times[left + 1] - times[left]) / 3, (states[left + 1] - states[left]) / 3
        new = np.stack([times[left] + k * step for k in (1, 2)], axis=1)
        there = arc.states_at(new.ravel()).reshape(len(left), 2, -1)
        chord = np.stack([states[left] + k * rise for k in (1, 2)], axis=1)
        bent = np.max(np.abs(there - chord) / units, axis=(1, 2)) > _BEND
        if not np.any(bent):
            break
        left = left[bent]
        places = np.repeat(left + 1, 2)
        times = np.insert(times, places, new[bent].ravel())
        states = np.insert(states, places, there[bent].reshape(len(places), -1), axis=0)
        # Two points were inserted in each previous interval, which became three intervals.
        left = (left[:, None] + 2 * np.arange(len(left))[:, None] + np.arange(3)).ravel()
    return times, states


def drawn_phases_of(execution: Execution) -> list[DrawnPhase]:
    """Return every phase. A Zeno tail belongs to the preceding flights."""
    arcs = execution.arcs
    starts = [arcs[0]]
    starts += [
        arc for last, arc in pairwise(arcs) if (arc.mode, arc.closed) != (last.mode, last.closed)
    ]
    times = [*(arc.start_time for arc in starts), execution.end_time]
    return [
        DrawnPhase(mode=arc.mode, closed=arc.closed, start=start, end=end)
        for arc, (start, end) in zip(starts, pairwise(times), strict=True)
    ]


def stops_of(execution: Execution) -> tuple[str, ...]:
    """Return the names of the stops that an execution meets, in alphabetical order.

    A machine with one stop and no switch has a stop without a name.
    """
    closed = {name for arc in execution.arcs for name in arc.closed}
    met = (*execution.impacts, *execution.zeno_points, *execution.releases)
    return tuple(sorted((closed | {event.stop for event in met}) - {""}))


def switches_of(execution: Execution) -> tuple[str, ...]:
    """Return the names of the switches that occur in an execution, in alphabetical order."""
    return tuple(sorted({event.name for event in execution.switches}))


def shown_states(problem: Problem) -> list[int]:
    """Return the states drawn over time: each coordinate and its velocity, then currents."""
    n_q = problem.model(problem.symbols()).n_q
    behind = range(2 * n_q, len(problem.state_names))
    rows = [row for k in range(n_q) for row in (k, n_q + k)]
    return [*rows, *(row for row in behind if problem.state_units[row] != "1")]
