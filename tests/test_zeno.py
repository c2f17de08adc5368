"""The closed end of an impact sequence: its weights, its limit and the honesty of its error."""

from __future__ import annotations

import math
from itertools import islice

import casadi as ca
import numpy as np
import pytest

from tests import closed_forms
from tests.closed_forms import FORCED
from tests.scenes import forced_oscillator, oscillator_state
from zeno_orbits.compiled import bind, compile_problem
from zeno_orbits.dynamics import HybridDynamics
from zeno_orbits.problem import load_problem
from zeno_orbits.zeno import TailEstimate, estimate_tail, extrapolate, limit_weights, tail_time

ROUNDING = 1e-13


def _ball(restitution: float) -> HybridDynamics:
    problem = load_problem("bouncing_ball")
    setting = problem.setting(parameters={"restitution": restitution})
    return bind(compile_problem(problem), setting.values())


def _ball_estimates(dynamics: HybridDynamics, n: int) -> list[TailEstimate]:
    estimates = []
    for k in range(n):
        speed = closed_forms.ball_impact_speed(1.0, 9.81, dynamics.restitution, k + 1)
        time = closed_forms.ball_impact_time(1.0, 9.81, dynamics.restitution, k)
        estimate = estimate_tail(dynamics, time, np.array([0.0, speed]), speed)
        assert estimate is not None
        estimates.append(estimate)
    return estimates


def _oscillator_estimates(n: int) -> list[TailEstimate]:
    dynamics = forced_oscillator(FORCED, FORCED.restitution)
    estimates = []
    for time, approach in islice(FORCED.impacts(), n):
        speed = FORCED.restitution * approach
        state = np.array(oscillator_state(time, FORCED.stop, -speed))
        estimate = estimate_tail(dynamics, time, state, speed)
        assert estimate is not None
        estimates.append(estimate)
    return estimates


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_the_limit_weights_sum_to_one(n: int) -> None:
    assert sum(limit_weights([0.3**k for k in range(n)])) == pytest.approx(1.0, abs=ROUNDING)


@pytest.mark.parametrize("degree", [0, 1, 2, 3, 4])
def test_the_limit_weights_are_exact_on_polynomials(degree: int) -> None:
    coefficients = np.random.default_rng(degree).normal(size=degree + 1)
    speeds = [2.0 * 0.4**k for k in range(degree + 1)]
    values = [np.polynomial.polynomial.polyval(w, coefficients) for w in speeds]
    limit = sum(a * value for a, value in zip(limit_weights(speeds), values, strict=True))
    # Weights of nodes with the ratio 0.4 add up to less than 10 in size.
    assert limit == pytest.approx(coefficients[0], abs=100 * ROUNDING)


def test_one_node_more_than_the_degree_is_needed() -> None:
    speeds = [1.0, 0.5]
    limit = sum(a * w**2 for a, w in zip(limit_weights(speeds), speeds, strict=True))
    assert abs(limit) > 0.1


def test_the_limit_weights_work_on_symbols() -> None:
    speeds = ca.SX.sym("w", 3)
    weights = ca.vertcat(*limit_weights(ca.vertsplit(speeds)))
    numbers = [1.0, 0.3, 0.1]
    symbolic = ca.Function("weights", [speeds], [weights])(numbers)
    assert np.array(symbolic).ravel() == pytest.approx(np.array(limit_weights(numbers)))


def test_the_tail_of_a_ball_is_exact() -> None:
    restitution, speed, g = 0.7, 2.0, 9.81
    bounces = sum(2 * speed * restitution**k / g for k in range(200))
    assert tail_time(speed, -g, restitution) == pytest.approx(bounces, rel=ROUNDING)


def test_every_impact_of_a_ball_tells_its_zeno_time() -> None:
    dynamics = _ball(0.6)
    exact = closed_forms.ball_zeno_time(1.0, 9.81, 0.6)
    for estimate in _ball_estimates(dynamics, 6):
        assert estimate.time == pytest.approx(exact, rel=ROUNDING)


def test_a_stop_that_repels_has_no_tail() -> None:
    dynamics = forced_oscillator(FORCED, FORCED.restitution)
    repelled = np.array(oscillator_state(math.pi, FORCED.stop, 0.0))
    assert estimate_tail(dynamics, 0.0, repelled, 0.1) is None


def test_one_estimate_alone_claims_no_accuracy() -> None:
    estimates = _ball_estimates(_ball(0.5), 1)
    assert extrapolate(_ball(0.5), estimates).error == math.inf


def test_the_error_estimate_bounds_the_true_error_on_the_ball() -> None:
    dynamics = _ball(0.5)
    exact = closed_forms.ball_zeno_time(1.0, 9.81, 0.5)
    for n in range(2, 8):
        limit = extrapolate(dynamics, _ball_estimates(dynamics, n))
        assert abs(limit.time - exact) <= limit.error * (1 + exact) + ROUNDING
        assert limit.state.tolist() == [0.0, 0.0]


def test_the_error_estimate_bounds_the_true_error_where_the_acceleration_changes() -> None:
    dynamics = forced_oscillator(FORCED, FORCED.restitution)
    exact = FORCED.zeno_time()
    point = np.array(oscillator_state(exact, FORCED.stop, 0.0))
    estimates = _oscillator_estimates(12)
    for n in range(2, 13):
        limit = extrapolate(dynamics, estimates[:n])
        assert abs(limit.time - exact) <= limit.error * (1 + exact) + ROUNDING
        bound = limit.error * (1 + np.abs(point)) + ROUNDING
        assert np.all(np.abs(limit.state - point) <= bound)


@pytest.mark.parametrize(("n_nodes", "order"), [(1, 2), (2, 2), (3, 3), (4, 4)])
def test_more_nodes_give_a_higher_order(n_nodes: int, order: int) -> None:
    # The tail of one impact already has no term linear in the speed, so that two nodes, which
    # remove such a term, are of its order still.
    dynamics = forced_oscillator(FORCED, FORCED.restitution)
    exact = FORCED.zeno_time()
    estimates = _oscillator_estimates(9)
    coarse = extrapolate(dynamics, estimates[5 - n_nodes : 5]).time - exact
    fine = extrapolate(dynamics, estimates[7 - n_nodes : 7]).time - exact
    measured = math.log(abs(coarse / fine)) / math.log(estimates[4].speed / estimates[6].speed)
    # Speeds of 0.1 still add a tenth or two of the next order.
    assert measured == pytest.approx(order, abs=0.35)
