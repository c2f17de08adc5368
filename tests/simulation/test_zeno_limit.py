"""The closed end of an impact sequence: its weights, its limit and the honesty of its error."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import islice, pairwise

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.reference import closed_forms
from tests.reference.closed_forms import FORCED
from tests.support.mechanisms import forced_oscillator, oscillator_state
from zeno_orbits.arrays import Vector
from zeno_orbits.model import CharacteristicScales, ContactProjection, HybridDynamics, load_problem
from zeno_orbits.simulation import (
    SimulationSettings,
    TailEstimate,
    ZenoExtrapolation,
    estimate_tail,
    extrapolate,
    limit_weights,
    simulate,
    spread_nodes,
    tail_time,
)
from zeno_orbits.simulation.zeno.zeno_limit import (
    N_NODES,
    NODE_RATIO,
    combine,
    limit_slopes,
    tail_from,
)

ROUNDING = 1e-13


def _ball(restitution: float) -> HybridDynamics:
    problem = load_problem("bouncing_ball")
    values = problem.values(parameters={"restitution": restitution})
    return problem.dynamics(values)


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


@pytest.mark.parametrize("n_nodes", [1, 2, 3, 4, 5])
def test_the_limit_weights_are_exact_on_polynomials_without_linear_term(n_nodes: int) -> None:
    coefficients = np.random.default_rng(n_nodes).normal(size=n_nodes + 1)
    coefficients[1] = 0.0
    speeds = [2.0 * 0.4**k for k in range(n_nodes)]
    values = [np.polynomial.polynomial.polyval(w, coefficients) for w in speeds]
    limit = sum(a * value for a, value in zip(limit_weights(speeds), values, strict=True))
    # Weights of nodes with the ratio 0.4 add up to less than 10 in size.
    assert limit == pytest.approx(coefficients[0], abs=100 * ROUNDING)


@pytest.mark.parametrize("n_nodes", [1, 2, 3, 4, 5])
def test_a_linear_term_is_not_removed(n_nodes: int) -> None:
    # alpha_k w_k is Lagrange's weight at zero over the sum of all 1 / w_j; those weights sum to 1.
    speeds = [2.0 * 0.4**k for k in range(n_nodes)]
    limit = sum(a * w for a, w in zip(limit_weights(speeds), speeds, strict=True))
    assert limit == pytest.approx(1 / sum(1 / w for w in speeds), rel=100 * ROUNDING)


def test_two_nodes_do_not_remove_a_cubic_term() -> None:
    # The weights at 1 and 1/2 are -1/3 and 4/3, so that w^3 gives -1/3 + 4/24.
    speeds = [1.0, 0.5]
    assert limit_weights(speeds) == pytest.approx([-1 / 3, 4 / 3], rel=ROUNDING)
    limit = sum(a * w**3 for a, w in zip(limit_weights(speeds), speeds, strict=True))
    assert limit == pytest.approx(-1 / 6, rel=ROUNDING)


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


@pytest.mark.parametrize(("n_nodes", "order"), [(1, 2), (2, 3), (3, 4), (4, 5)])
def test_every_node_gives_one_order_more(n_nodes: int, order: int) -> None:
    # The tail of one impact has no term linear in the speed. n nodes remove w^2, ..., w^n, so
    # that w^(n + 1) is left.
    dynamics = forced_oscillator(FORCED, FORCED.restitution)
    exact = FORCED.zeno_time()
    estimates = _oscillator_estimates(9)
    coarse = extrapolate(dynamics, estimates[5 - n_nodes : 5]).time - exact
    fine = extrapolate(dynamics, estimates[7 - n_nodes : 7]).time - exact
    measured = math.log(abs(coarse / fine)) / math.log(estimates[4].speed / estimates[6].speed)
    # Speeds of 0.1 still add a tenth or two of the next order.
    assert measured == pytest.approx(order, abs=0.35)


# Which impacts the extrapolation uses.

FALLING = st.lists(
    st.floats(min_value=1e-12, max_value=100.0), min_size=1, max_size=60, unique=True
).map(lambda speeds: sorted(speeds, reverse=True))


@given(speeds=FALLING)
def test_the_last_impact_is_a_node_and_faster_ones_are_far_apart(speeds: list[float]) -> None:
    nodes = spread_nodes(speeds)
    assert nodes[-1] == len(speeds) - 1
    assert nodes == sorted(set(nodes))
    assert len(nodes) <= N_NODES
    for fast, slow in pairwise(nodes):
        assert speeds[slow] <= NODE_RATIO * speeds[fast]


@given(speeds=FALLING)
def test_every_node_is_the_nearest_that_is_far_enough(speeds: list[float]) -> None:
    nodes = spread_nodes(speeds)
    for fast, slow in pairwise(nodes):
        assert all(speeds[slow] > NODE_RATIO * speeds[k] for k in range(fast + 1, slow))
    if len(nodes) < N_NODES:
        assert speeds[nodes[0]] > NODE_RATIO * speeds[0] or nodes[0] == 0


def test_impacts_that_fall_fast_are_all_nodes() -> None:
    assert spread_nodes([0.2**k for k in range(4)]) == [0, 1, 2, 3]
    assert spread_nodes([0.2**k for k in range(9)]) == [4, 5, 6, 7, 8]


def test_impacts_that_hardly_fall_give_nodes_far_apart() -> None:
    restitution, n = 0.99, 600
    speeds = [restitution**k for k in range(n)]
    nodes = spread_nodes(speeds)
    assert len(nodes) == N_NODES
    for fast, slow in pairwise(nodes):
        ratio = speeds[slow] / speeds[fast]
        # One impact later would still be too near.
        assert NODE_RATIO * restitution <= ratio <= NODE_RATIO
    # Neighbours would have given weights of size 100^4.
    assert sum(map(abs, limit_weights([speeds[k] for k in nodes]))) < 10


def test_an_impact_without_speed_is_its_own_node() -> None:
    assert spread_nodes([0.0]) == [0]
    assert spread_nodes([1.0, 0.1, 0.0]) == [2]


def test_the_zeno_time_at_a_restitution_near_one_is_as_good_as_its_error_says() -> None:
    dynamics = _ball(0.99)
    exact = closed_forms.ball_zeno_time(1.0, 9.81, 0.99)
    limit = extrapolate(dynamics, _ball_estimates(dynamics, 400))
    # 400 sums of about 90 s and weights below 10.
    assert limit.time == pytest.approx(exact, rel=400 * 10 * ROUNDING)
    assert limit.error < 1e-10


def test_the_error_estimate_is_not_deceived_by_the_layer_of_the_current() -> None:
    # Here the flights become shorter than L/R in the middle of the sequence. The difference from
    # the same extrapolation without its fastest node would claim 2e-12 for an error of 5e-9.
    problem = load_problem("motor_pendulum")
    machine = {
        "L1": 0.2192,
        "lc1": 0.0691,
        "m1": 0.2519,
        "I1": 0.000724,
        "lc2": 0.2086,
        "m2": 0.1272,
        "I2": 0.00059,
        "R": 3.881,
        "L": 0.0015425,
        "restitution": 0.1978,
    }
    values = problem.values(gains={"Kp": 6.2946, "Kd": -0.61543}, parameters=machine)
    dynamics = problem.dynamics(values)
    start = simulate(dynamics, problem.state_vector(problem.starts[0]), until=30.0).releases[-1]
    deep = SimulationSettings(completion=ZenoExtrapolation(tolerance=1e-14, resolved=1e-8))
    period = simulate(dynamics, start.state, until=10.0, releases=1, settings=deep)
    truth = period.zeno_points[0]
    estimates: list[TailEstimate] = []
    for impact in period.impacts:
        speed = -dynamics.restitution * impact.approach_rate
        estimate = estimate_tail(dynamics, impact.time, impact.state_plus, speed)
        assert estimate is not None
        estimates.append(estimate)
        limit = extrapolate(dynamics, estimates)
        error = np.max(np.abs(limit.state - truth.state) / (1 + np.abs(truth.state)))
        # Before the sequence is geometric at all, the estimate is large and says no more than that.
        assert limit.error > 1.0 or error <= limit.error + 10 * ROUNDING
    assert limit.error < 1e-12


@pytest.mark.parametrize("speeds", [(0.3,), (1.0, 0.2), (1.0, 0.3, 0.1, 0.02, 0.004)])
def test_the_slopes_of_the_weights_are_those_of_differences(speeds: tuple[float, ...]) -> None:
    def weights(logarithms: Vector) -> Vector:
        return np.array(limit_weights(list(np.exp(logarithms))), dtype=float)

    at, step = np.log(speeds), 1e-5
    for j, one in enumerate(np.eye(len(speeds))):
        measured = (weights(at + step * one) - weights(at - step * one)) / (2 * step)
        # Of second order: 1e-10 of the third derivative.
        assert limit_slopes(speeds)[:, j] == pytest.approx(measured, abs=1e-8)


def test_the_slopes_of_the_weights_do_not_know_the_unit_of_speed() -> None:
    speeds = np.array([1.0, 0.3, 0.1, 0.02])
    tiny = limit_slopes((1e-290 * speeds).tolist())
    assert tiny == pytest.approx(limit_slopes(speeds.tolist()), rel=1e-13)
    # A change of unit changes no weight, and weights always add up to one.
    assert tiny.sum(axis=1) == pytest.approx(np.zeros(4), abs=1e-12)
    assert tiny.sum(axis=0) == pytest.approx(np.zeros(4), abs=1e-12)


def _extrapolated(nodes: list[TailEstimate]) -> tuple[float, np.ndarray]:
    """Return time and state at speed zero of polynomials without a linear term."""
    w = np.array([node.speed for node in nodes]) / nodes[0].speed
    powers = [0, *range(2, len(nodes) + 1)]
    matrix = np.stack([w**k for k in powers], axis=1)
    values = np.array([[node.time, *node.state] for node in nodes])
    first = np.linalg.solve(matrix, values)[0]
    return float(first[0]), first[1:]


@pytest.mark.parametrize(("restitution", "apart"), [(0.2, 1), (0.5, 1), (0.8, 4), (0.9, 7)])
def test_the_error_is_the_difference_from_what_was_known_a_node_earlier(
    restitution: float, apart: int
) -> None:
    # Limits that differ at every impact: a cubic in the speed, which few nodes do not tell.
    count = 4 * apart + 3
    speeds = [3.0 * restitution**k for k in range(count)]
    estimates = [
        TailEstimate(
            impact_time=0.0,
            resting=np.zeros(2),
            speed=w,
            time=2.0 + 0.3 * w**2 + math.sin(w) * w**2,
            state=np.array([5.0 + 0.2 * w**2 * math.cos(w), -0.5 + w**2 / (1 + w)]),
            gap_acceleration=-1.0,
        )
        for w in speeds
    ]
    now = _extrapolated(estimates[::-1][: 4 * apart + 1 : apart])
    before = _extrapolated(estimates[::-1][apart : 5 * apart + 1 : apart])
    found = combine(estimates)
    assert found.time == pytest.approx(now[0], rel=1e-10)
    assert found.state == pytest.approx(now[1], rel=1e-10)
    expected = max(
        abs(now[0] - before[0]) / (1 + now[0]),
        *(np.abs(now[1] - before[1]) / (1 + np.abs(now[1]))),
    )
    assert found.error == pytest.approx(expected, rel=1e-3)


def test_a_tail_leads_along_the_locked_flow_for_as_long_as_it_lasts() -> None:
    resting = ContactProjection(
        state=np.array([0.0, 2.0]), gap_acceleration=-4.0, rate=np.array([0.0, -3.0])
    )
    estimate = tail_from(resting, 0.75, 7.0, 0.5)
    assert estimate is not None
    # 2 times 0.5 over 4 times a quarter: a second.
    assert (estimate.impact_time, estimate.time, estimate.speed) == (7.0, 8.0, 0.5)
    assert estimate.resting is resting.state
    assert estimate.state.tolist() == [0.0, -1.0]
    assert estimate.gap_acceleration == -4.0
    for acceleration in (0.0, 0.5):
        assert tail_from(replace(resting, gap_acceleration=acceleration), 0.75, 7.0, 0.5) is None


def _told(speed: float, time: float, *state: float) -> TailEstimate:
    return TailEstimate(
        impact_time=0.0,
        resting=np.zeros(len(state)),
        speed=speed,
        time=time,
        state=np.array(state),
        gap_acceleration=-1.0,
    )


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("largest", [0, 1, 2])
def test_the_error_is_the_largest_of_time_and_states_each_in_its_own_size(
    sign: float, way: float, largest: int
) -> None:
    sizes = np.array([2.0, 0.5, 4.0])
    own = CharacteristicScales(time=2.0, sizes=(0.5, 4.0))
    first = sign * np.array([6.0, 1.0, 12.0])
    change = way * 0.003 * sizes
    change[largest] *= 2
    a, b = _told(1.0, *first), _told(0.5, *(first + change))
    found = combine([a, b], own)
    # The weights are -1/3 and 4/3.
    limit = first + 4 / 3 * change
    assert found.time == pytest.approx(limit[0], rel=1e-14)
    assert found.state == pytest.approx(limit[1:], rel=1e-14)
    errors = np.abs(4 / 3 * change) / (sizes + np.abs(limit))
    assert np.argmax(errors) == largest
    assert found.error == pytest.approx(np.max(errors), rel=1e-9)


def test_a_limit_told_by_one_impact_has_no_error_only_if_that_was_plastic() -> None:
    plastic = _told(0.0, 1.0, 2.0)
    fast, slow = _told(1.0, 5.0, 6.0), _told(0.9, 5.0, 6.0)
    for told in ([plastic], [fast, plastic], [fast, slow, plastic]):
        found = combine(told)
        assert (found.time, found.state.tolist(), found.error) == (1.0, [2.0], 0.0)
    for told in ([fast], [fast, slow]):
        assert combine(told).error == math.inf


def test_a_first_impact_that_is_just_fast_enough_is_a_node() -> None:
    assert spread_nodes([1.0, 0.9, 0.5]) == [0, 2]
    assert spread_nodes([1.0, 0.9, 0.51]) == [2]
    assert spread_nodes([8.0, 4.0, 2.0, 1.9, 1.0]) == [0, 1, 2, 4]
    assert spread_nodes([0.5, 0.25, 0.125]) == [0, 1, 2]
