"""Derivatives along arcs of a graph of modes in the loop are those in Python."""

from __future__ import annotations

import numpy as np
import pytest

import zeno_orbits as zo
from tests.loop.agreement import needs_compiler
from zeno_orbits.arrays import Vector
from zeno_orbits.simulation import (
    Execution,
    GraphShifts,
    SimulationSettings,
    ZenoExtrapolation,
    carried_in_python,
    simulate,
)

pytestmark = needs_compiler

ROUNDING = 1e-11
"""Of a state or of its largest change, if start and parameters change by their own sizes."""
CHATTER = SimulationSettings(completion=ZenoExtrapolation())


def _rows(shifts: GraphShifts, motion: Execution) -> Vector:
    return np.array(
        [
            np.vstack([one.time, one.state, one.rate])
            for _, before, after in shifts.along(motion)
            for one in (before, after)
        ]
    )


@pytest.mark.parametrize(
    ("name", "until"),
    [("relay", 0.05), ("kneed_walker", 0.5), ("clapper", 8.0), ("limited_pendulum", 1.0)],
)
def test_every_event_moves_as_in_python(name: str, until: float) -> None:
    problem = zo.load_problem(name)
    graph = problem.graph_dynamics(problem.values())
    motion = simulate(
        graph, np.array(problem.state_vector(problem.starts[0])), until=until, settings=CHATTER
    )
    assert motion.events
    chosen = tuple(range(min(4, graph.p.size)))
    by_loop = GraphShifts(graph=graph, chosen=chosen, tolerance=CHATTER.tolerance)
    in_python = GraphShifts(
        graph=graph, chosen=chosen, tolerance=CHATTER.tolerance, carry=carried_in_python
    )
    found, expected = _rows(by_loop, motion), _rows(in_python, motion)
    assert len(found) == 2 * len(motion.events)
    states = np.max([np.abs(arc.end_state) for arc in motion.arcs], axis=0)
    changes = np.append(states, np.abs(graph.p[list(chosen)]))
    largest = np.max(np.abs(expected) * changes, axis=(0, 2))
    off = np.max(np.abs(found - expected) * changes, axis=(0, 2))
    fastest = max((abs(one.approach_rate) for one in motion.impacts), default=0.0)
    assert np.all(off <= ROUNDING * np.maximum(largest, [until, fastest, *states]))
