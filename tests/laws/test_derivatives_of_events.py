"""Events and the state at a given time move with start and parameters as simulations show."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import product

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.cases import fast
from zeno_orbits.arrays import Vector
from zeno_orbits.model import GraphDynamics
from zeno_orbits.simulation import (
    EventDerivatives,
    Mode,
    SimulationSettings,
    ZenoExtrapolation,
    event_name,
    simulate,
    state_after,
    state_before,
)

SETTINGS = SimulationSettings(completion=ZenoExtrapolation())
STEP = 2e-4
"""Of a start in units of its states' sizes, and of parameters in theirs."""
OF_DIFFERENCES = 1e-8
"""Sixth order at this step: 1e-16 of truncation, 1e-12 of integration over 2e-4."""

MACHINES = {
    "bouncing_ball": 1.2,
    "falling_pendulum": 1.0,
    "motor_pendulum": 2.0,
    "vibrating_table": 1.0,
    "relay": 0.05,
    "hopper": 1.0,
    "kneed_walker": 0.7,
    "clapper": 8.0,
    "limited_pendulum": 1.0,
    "sampled_pendulum": 1.0,
    "impact_oscillator": 6.0,
    "motor_valve": 0.3,
}
"""Bundled problems with one stop, several stops, kinks, switches and clocks; their horizons [s]."""


def _sixth_order(f: Callable[[float], Vector]) -> Vector:
    """Return the derivative of a function of a number at zero."""
    one, two, three = ((f(k * STEP) - f(-k * STEP)) / (2 * k * STEP) for k in (1, 2, 3))
    return (15 * one - 6 * two + three) / 10


def _in_flight(graph: GraphDynamics, x: Vector, until: float) -> Vector:
    """Return a state inside the longest arc of a motion along which every stop is open."""
    run = simulate(graph, x, until=until, settings=SETTINGS)
    free = [arc for arc in run.arcs if arc.mode is Mode.FREE and arc.trajectory is not None]
    arc = max(free, key=lambda one: one.end_time - one.start_time)
    return arc.flow_states_at(np.array([0.4 * arc.duration]))[0, : x.size]


def _turned(graph: GraphDynamics, x: Vector, angle: float) -> Vector:
    """Return a state whose clock is turned, if the machine has one."""
    names = list(graph.state_names)
    if "cosine" not in names:
        return x
    places = [names.index("cosine"), names.index("sine")]
    turn = complex(*x[places]) * complex(math.cos(angle), math.sin(angle))
    moved = x.copy()
    moved[places] = turn.real, turn.imag
    return moved


@pytest.mark.parametrize(("name", "way"), fast(12, list(product(MACHINES, range(2)))))
def test_events_and_the_end_move_as_differences_of_simulations_show(name: str, way: int) -> None:
    problem, until = zo.load_problem(name), MACHINES[name]
    graph = problem.graph_dynamics(problem.values())
    values = graph.p
    x = _in_flight(graph, np.array(problem.state_vector(problem.starts[0])), until)
    run = simulate(graph, x, until=until, settings=SETTINGS)
    names = [event_name(event) for event in run.events]
    assert names
    chosen = tuple(np.flatnonzero(values).tolist())
    random = np.random.default_rng(way)
    sizes = np.max([np.abs(arc.end_state) for arc in run.arcs], axis=0)
    is_clock = [state in ("cosine", "sine") for state in graph.state_names]
    by_start = np.where(is_clock, 0.0, random.normal(size=x.size) * sizes)
    by_values = random.normal(size=len(chosen)) * values[list(chosen)]

    def moved(part: float) -> Vector:
        other = values.copy()
        other[list(chosen)] += part * by_values
        start = _turned(graph, x + part * by_start, part)
        there = simulate(graph.at(other), start, until=1.1 * until, settings=SETTINGS)
        events = there.events[: len(names)]
        assert [event_name(event) for event in events] == names
        rows = [[e.time, *state_before(e), *state_after(e)] for e in events]
        return np.array([*rows, [until, *there.state_at(until), *there.state_at(until)]])

    # A clock turns along its circle.
    quarter = np.where(is_clock, _turned(graph, x, math.pi / 2), 0.0)
    direction = np.concatenate([by_start + quarter, by_values])
    derivatives = EventDerivatives(graph, chosen, SETTINGS.tolerance)
    passages = list(derivatives.passages(run))
    shifts = [pair for passage in passages for _, *pair in passage.crossings]
    shifts.append([passages[-1].end, passages[-1].end])
    found = np.array(
        [
            np.concatenate([before.time[None], before.state, after.state]) @ direction
            for before, after in shifts
        ]
    )
    expected = _sixth_order(moved)
    scale = 1 + np.max(np.abs(expected), axis=0)
    assert np.max(np.abs(found - expected) / scale) < OF_DIFFERENCES
