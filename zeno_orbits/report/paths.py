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
_HALVINGS = 6
"""How often an interval between two steps is halved at most."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ArcPath:
    """An arc as a curve.

    Attributes:
        kind: ``free``, ``locked``, or ``tail`` for the end of an impact sequence.
        times: Times [s], ``(m,)``.
        states: States there, ``(m, n_x)``.
    """

    kind: str
    times: Vector
    states: Vector


def paths_of(execution: Execution, *, least: int = 12) -> list[ArcPath]:
    """Return every arc as a curve; tails too short to see are left out.

    Args:
        execution: The execution.
        least: Points on each arc, at least.
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
        paths.append(ArcPath(kind=kind, times=times, states=states))
    return paths


def _smooth(arc: Arc, ranges: Vector, least: int) -> tuple[Vector, Vector]:
    """Return times and states at every step, and between steps wherever a chord would be seen."""
    times, states = arc.sampled(least)
    units = np.where(ranges > 0.0, ranges, 1.0)
    open_ends = np.arange(len(times) - 1)
    for _ in range(_HALVINGS):
        middles = (times[open_ends] + times[open_ends + 1]) / 2
        there = np.array([arc.state_at(time) for time in middles.tolist()])
        off = np.abs(there - (states[open_ends] + states[open_ends + 1]) / 2) / units
        bent = np.max(off, axis=1) > _BEND
        if not np.any(bent):
            break
        places = open_ends[bent] + 1
        times = np.insert(times, places, middles[bent])
        states = np.insert(states, places, there[bent], axis=0)
        # An inserted point stands behind those inserted before it; both its sides are open.
        inserted = places + np.arange(len(places))
        open_ends = np.sort(np.concatenate([inserted - 1, inserted]))
    return times, states


def drawn_phases_of(execution: Execution) -> list[tuple[Mode, float, float]]:
    """Return mode, start and end of every phase; a Zeno tail belongs to the flights before it."""
    starts = [execution.arcs[0]]
    starts += [arc for last, arc in pairwise(execution.arcs) if arc.mode is not last.mode]
    times = [*(arc.start_time for arc in starts), execution.end_time]
    return [(arc.mode, *ends) for arc, ends in zip(starts, pairwise(times), strict=True)]


def shown_states(problem: Problem) -> list[int]:
    """Return which states are drawn over time: each coordinate, its velocity, then currents."""
    n_q = problem.model(problem.symbols()).n_q
    behind = range(2 * n_q, len(problem.state_names))
    rows = [row for k in range(n_q) for row in (k, n_q + k)]
    return [*rows, *(row for row in behind if problem.state_units[row] != "1")]
