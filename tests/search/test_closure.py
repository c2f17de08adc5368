"""The fewest impacts that tell a Zeno point."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.reference.closed_forms import FORCED
from tests.reference.reference_orbit import RELEASE
from tests.support.mechanisms import forced_oscillator, oscillator_state
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.model.problem import Problem
from zeno_orbits.orbits.cycle import Cycle, cycles
from zeno_orbits.search.transcription.closure import closure_of
from zeno_orbits.simulation.simulator import simulate
from zeno_orbits.simulation.zeno_limit import estimate_tail, extrapolate

ACCURACY = 1e-11


@pytest.fixture(name="oscillator", scope="module")
def _oscillator() -> HybridDynamics:
    return forced_oscillator(FORCED, FORCED.restitution)


@pytest.fixture(name="turn", scope="module")
def _turn(oscillator: HybridDynamics) -> Cycle:
    start = oscillator_state(0.0, FORCED.stop, 0.0)
    return cycles(simulate(oscillator, start, until=2.5 * math.tau))[0]


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5, 1e-7, 1e-9, 1e-11])
def test_a_closure_has_the_fewest_impacts_for_its_tolerance(
    oscillator: HybridDynamics, turn: Cycle, tolerance: float
) -> None:
    closure = closure_of(turn.impacts, oscillator, tolerance)
    assert closure.error <= tolerance
    for n in range(1, closure.n_impacts):
        fewer = closure_of(turn.impacts[:n], oscillator, tolerance)
        assert fewer.error > tolerance
    assert closure.nodes[-1] == closure.n_impacts - 1
    assert list(closure.nodes) == sorted(set(closure.nodes))


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-6, 1e-8, 1e-10])
def test_the_error_of_a_closure_bounds_the_true_one(
    oscillator: HybridDynamics, turn: Cycle, tolerance: float
) -> None:
    closure = closure_of(turn.impacts, oscillator, tolerance)
    estimates = []
    for k in closure.nodes:
        impact = turn.impacts[k]
        speed = -oscillator.restitution * impact.approach_rate
        estimate = estimate_tail(oscillator, impact.time, impact.state_plus, speed)
        assert estimate is not None
        estimates.append(estimate)
    limit = extrapolate(oscillator, estimates)
    exact = FORCED.zeno_time()
    assert abs(limit.time - exact) <= closure.error * (1 + exact) + ACCURACY
    point = np.array(oscillator_state(exact, FORCED.stop, 0.0))
    assert np.all(np.abs(limit.state - point) <= closure.error * (1 + np.abs(point)) + ACCURACY)


def test_a_tolerance_that_nothing_reaches_takes_all_impacts(
    oscillator: HybridDynamics, turn: Cycle
) -> None:
    closure = closure_of(turn.impacts, oscillator, 0.0)
    assert closure.n_impacts == len(turn.impacts)


def test_a_plastic_impact_closes_alone(problem: Problem) -> None:
    values = problem.values(parameters={"restitution": 0.0})
    plastic = problem.dynamics(values)
    run = simulate(plastic, RELEASE, until=6.0)
    cycle = cycles(run)[-1]
    assert cycle.rescaled_flights == ()
    closure = closure_of(cycle.impacts, plastic, 1e-12)
    assert closure.n_impacts == 1
    assert closure.nodes == (0,)
    assert closure.error == 0.0
