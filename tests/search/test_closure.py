"""Impacts that a program resolves before a Zeno point, and the error of the limit."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.reference.closed_forms import FORCED
from tests.reference.reference_orbit import RELEASE
from tests.support.mechanisms import forced_oscillator, oscillator_state
from zeno_orbits.model import HybridDynamics, Problem
from zeno_orbits.search.program.closure import closure_of
from zeno_orbits.simulation import Impact, estimate_tail, extrapolate, simulate

ACCURACY = 1e-11


@pytest.fixture(name="oscillator", scope="module")
def _oscillator() -> HybridDynamics:
    return forced_oscillator(FORCED, FORCED.restitution)


@pytest.fixture(name="impacts", scope="module")
def _impacts(oscillator: HybridDynamics) -> tuple[Impact, ...]:
    """The impacts of one period."""
    start = oscillator_state(0.0, FORCED.stop, 0.0)
    run = simulate(oscillator, start, until=2.5 * math.tau)
    return tuple(one for one in run.impacts if one.time < run.zeno_points[0].time)


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5, 1e-7, 1e-9, 1e-11])
def test_a_closure_has_the_fewest_impacts_for_its_tolerance(
    oscillator: HybridDynamics, impacts: tuple[Impact, ...], tolerance: float
) -> None:
    closure = closure_of(impacts, oscillator, tolerance)
    assert closure.error <= tolerance
    for n in range(1, closure.n_impacts):
        fewer = closure_of(impacts[:n], oscillator, tolerance)
        assert fewer.error > tolerance
    assert closure.nodes[-1] == closure.n_impacts - 1
    assert list(closure.nodes) == sorted(set(closure.nodes))


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-6, 1e-8, 1e-10])
def test_the_error_of_a_closure_bounds_the_true_one(
    oscillator: HybridDynamics, impacts: tuple[Impact, ...], tolerance: float
) -> None:
    closure = closure_of(impacts, oscillator, tolerance)
    estimates = []
    for k in closure.nodes:
        impact = impacts[k]
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
    oscillator: HybridDynamics, impacts: tuple[Impact, ...]
) -> None:
    closure = closure_of(impacts, oscillator, 0.0)
    assert closure.n_impacts == len(impacts)


def test_a_plastic_impact_closes_alone(problem: Problem) -> None:
    values = problem.values(parameters={"restitution": 0.0})
    plastic = problem.dynamics(values)
    run = simulate(plastic, RELEASE, until=6.0)
    closure = closure_of(run.impacts[-1:], plastic, 1e-12)
    assert closure.n_impacts == 1
    assert closure.nodes == (0,)
    assert closure.error == 0.0
