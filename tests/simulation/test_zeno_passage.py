"""A Zeno passage without its impacts: against closed forms, and honest about its error."""

from __future__ import annotations

import math
from dataclasses import replace

import mpmath
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.reference import closed_forms
from tests.reference.closed_forms import FadingBall, SlidingBead, StoppedOscillator
from tests.support.cases import fast
from tests.support.mechanisms import (
    GRAVITY,
    bead_on_disc,
    fading_ball,
    falling_away,
    forced_oscillator,
    oscillator_state,
)
from tests.support.units import Units, dimension_of, in_units
from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import RungeKutta, Tolerance
from zeno_orbits.model import HybridDynamics, load_problem
from zeno_orbits.simulation import (
    Execution,
    SimulationSettings,
    ZenoExtrapolation,
    ZenoLimit,
    ZenoPassage,
    ZenoPoint,
    simulate,
)
from zeno_orbits.simulation.zeno.impact_curve import CurveEnd, ImpactCurve
from zeno_orbits.simulation.zeno.rescaled_flight import Flight, rescaled_flights
from zeno_orbits.simulation.zeno.zeno_passage import pass_through

FINE = Tolerance(relative=1e-14, absolute=1e-15)
TOLERANCE = 1e-12
GOAL = 1e-10
"""Largest error of a passage at ``e <= 0.999`` that this project promises."""
PLENTY = 2000
WEIGHT = 10.0
ANGLE, TURN = 0.2, 0.5
NEAR_ZENO = (1.2, 0.0, 1.7, 0.0, -0.46)
"""Of the motor pendulum, on its stop near the Zeno point of its orbit."""


class _Counted:
    """A flight that counts its flights."""

    def __init__(self, dynamics: HybridDynamics) -> None:
        self.flight = rescaled_flights(dynamics, RungeKutta(), FINE)
        self.n = 0

    def __call__(self, state_plus: Vector, speed: float) -> tuple[float, Vector, float] | None:
        self.n += 1
        return self.flight(state_plus, speed)


def _pass(
    dynamics: HybridDynamics,
    state: tuple[float, ...] | Vector,
    speed: float,
    *,
    tolerance: float = TOLERANCE,
    flight: Flight | None = None,
    most_flights: int = PLENTY,
) -> ZenoLimit | None:
    return pass_through(
        dynamics,
        flight or _Counted(dynamics),
        0.0,
        np.array(state, dtype=np.float64),
        speed,
        tolerance,
        most_flights=most_flights,
    )


def _pendulum(restitution: float) -> HybridDynamics:
    problem = load_problem("motor_pendulum")
    values = problem.values(parameters={"restitution": restitution})
    return problem.dynamics(values)


def _speed(passage_time: float, pull: float, restitution: float) -> float:
    """Return the speed whose tail lasts so long under a constant pull."""
    return passage_time * (1 - restitution) * pull / 2


def _on_disc(angle: float, turn: float) -> tuple[float, ...]:
    sine, cosine = math.sin(angle), math.cos(angle)
    return sine, cosine, turn * cosine, -turn * sine


# Closed forms.


@pytest.mark.parametrize("restitution", [0.5, 0.9, 0.99, 0.999, 0.9999])
def test_a_ball_comes_to_rest_when_the_closed_form_says(restitution: float) -> None:
    dynamics = fading_ball(WEIGHT, 0.0, restitution)
    speed = _speed(0.7, WEIGHT, restitution)
    # Half of the speed is lost in ln(2) / (1 - e) impacts: the piece must be worth it.
    limit = _pass(dynamics, (0.0, 0.0, 0.0, 1.0), speed)
    if restitution < 0.95:
        assert limit is None
        return
    assert limit is not None
    assert abs(limit.time - 0.7) <= limit.error
    assert limit.state == pytest.approx([0.0, 0.7, 0.0, 1.0], abs=limit.error)


@pytest.mark.parametrize("restitution", [0.96, 0.99, 0.999, 0.9999])
@pytest.mark.parametrize("fading", fast(2, [-3.0, 3.0, 6.0]))
def test_a_ball_whose_weight_changes_rests_when_its_closed_flights_add_up(
    restitution: float, fading: float
) -> None:
    speed = _speed(0.3, WEIGHT, restitution)
    truth = FadingBall(g=WEIGHT, b=fading, restitution=restitution).zeno_time(speed)
    # The weight changes by a third or more on the way, so the tail of one impact is far off.
    assert abs(truth - 0.3) > 0.005
    limit = _pass(fading_ball(WEIGHT, fading, restitution), (0.0, 0.0, 0.0, 1.0), speed)
    assert limit is not None
    assert abs(limit.time - truth) <= limit.error < max(GOAL, 1e-13 / (1 - restitution))
    assert limit.state == pytest.approx([0.0, truth, 0.0, 1.0], abs=2 * limit.error)


@pytest.mark.slow
def test_the_bead_in_floats_and_in_thirty_digits_agree() -> None:
    speed = _speed(0.1, 2 * GRAVITY, 0.98)
    bead = SlidingBead(g=GRAVITY, restitution=0.98)
    time, state = bead.zeno_point(ANGLE, TURN, speed)
    with mpmath.workdps(30):
        long_time, long_state = bead.zeno_point(ANGLE, mpmath.mpf(TURN), speed)
    # 1800 impacts add 1800 roundings, in no common direction.
    assert abs(time - long_time) < 1e-14
    assert max(abs(a - b) for a, b in zip(state, long_state, strict=True)) < 2e-14


@pytest.mark.parametrize("restitution", [0.98, 0.99, 0.999])
def test_a_bead_on_a_curved_stop_rests_where_its_parabolas_lead(restitution: float) -> None:
    speed = _speed(0.1, 2 * GRAVITY, restitution)
    truth, point = SlidingBead(g=GRAVITY, restitution=restitution).zeno_point(ANGLE, TURN, speed)
    limit = _pass(bead_on_disc(restitution), _on_disc(ANGLE, TURN), speed)
    assert limit is not None
    assert abs(limit.time - truth) <= limit.error < GOAL
    assert np.all(np.abs(limit.state - point) <= limit.error * (1 + np.abs(point)))


@pytest.mark.parametrize("restitution", [0.98, 0.99])
def test_a_forced_oscillator_rests_where_its_power_series_lead(restitution: float) -> None:
    oscillator = StoppedOscillator(damping=1.9, stop=-0.8, restitution=restitution)
    start = -1.0
    speed = _speed(0.5, math.cos(start) - oscillator.stop, restitution)
    time, w = start, speed
    while w > closed_forms.END * speed:
        duration, approach = oscillator.short_flight(time, w)
        time, w = time + duration, restitution * approach
    state = oscillator_state(start, oscillator.stop, -speed)
    limit = _pass(forced_oscillator(oscillator, restitution), state, speed)
    assert limit is not None
    truth = np.array(oscillator_state(time, oscillator.stop, 0.0))
    assert abs(start + limit.time - time) <= limit.error < GOAL
    assert np.all(np.abs(limit.state - truth) <= limit.error * (1 + np.abs(truth)))


@pytest.mark.parametrize("speed", [1e-4, 1e-3, 3e-3])
def test_the_motor_pendulum_rests_where_its_impacts_lead(speed: float) -> None:
    dynamics = _pendulum(0.99)
    start = np.array(NEAR_ZENO)
    state = start + speed * dynamics.impulse_direction(start)
    by_impacts = _simulated(dynamics, state, ZenoExtrapolation()).zeno_points[0]
    limit = _pass(dynamics, start, speed)
    assert limit is not None
    assert abs(limit.time - by_impacts.time) <= limit.error < GOAL
    assert np.all(np.abs(limit.state - by_impacts.state) <= limit.error * (1 + np.abs(start)))


@pytest.mark.parametrize("speed", [1e-4, 3e-3])
def test_the_path_passes_through_the_impacts_that_were_left_out(speed: float) -> None:
    dynamics = _pendulum(0.99)
    start = np.array(NEAR_ZENO)
    state = start + speed * dynamics.impulse_direction(start)
    limit = _pass(dynamics, start, speed)
    assert limit is not None
    path = limit.path
    assert path[0].before == pytest.approx(start, abs=1e-15)
    assert path[-1].after == pytest.approx(limit.state, abs=1e-11)
    for step in path:
        assert step.state_at(0.0).tolist() == step.before.tolist()
        assert step.state_at(step.size).tolist() == step.after.tolist()
    for impact in _simulated(dynamics, state, ZenoExtrapolation()).impacts[:-5:20]:
        step = next(step for step in path if impact.time <= step.start + step.size)
        resting = dynamics.on_stop(impact.state_plus)
        # Between nodes the polynomial has its own order, not the higher one of its end.
        assert step.state_at(impact.time - step.start) == pytest.approx(resting, abs=1e-6)


# Cost.


@pytest.mark.parametrize("passage_time", [0.05, 0.3])
def test_the_number_of_flights_does_not_grow_as_restitution_nears_one(passage_time: float) -> None:
    counts = []
    for restitution in (0.99, 0.999, 0.9999, 0.99999):
        dynamics = fading_ball(WEIGHT, 3.0, restitution)
        flight = _Counted(dynamics)
        speed = _speed(passage_time, WEIGHT, restitution)
        assert _pass(dynamics, (0.0, 0.0, 0.0, 1.0), speed, flight=flight) is not None
        counts.append(flight.n)
    assert max(counts) <= 100
    assert counts == sorted(counts, reverse=True)


def test_a_curved_stop_costs_no_more_as_restitution_nears_one() -> None:
    # A move onto the disc that is not exact would be divided by the fall of the speed, and count.
    for restitution in (0.999, 0.9999, 0.99999):
        dynamics = bead_on_disc(restitution)
        flight = _Counted(dynamics)
        speed = _speed(0.1, 2 * GRAVITY, restitution)
        assert _pass(dynamics, _on_disc(ANGLE, TURN), speed, flight=flight) is not None
        assert flight.n <= 150


def test_no_more_flights_are_made_than_allowed() -> None:
    dynamics = _pendulum(0.999)
    flight = _Counted(dynamics)
    assert _pass(dynamics, NEAR_ZENO, 1e-3, flight=flight, most_flights=60) is None
    assert flight.n <= 60


# Error estimate.


@pytest.mark.slow
@settings(max_examples=20)
@given(
    passage_time=st.floats(0.01, 1.2),
    fading=st.floats(-8.0, 5.0),
    exponent=st.floats(1.5, 3.5),
    digits=st.floats(2.0, 12.0),
)
@example(passage_time=1.1875, fading=4.5, exponent=3.25, digits=2.0)
@example(passage_time=1.05, fading=4.96, exponent=3.42, digits=2.0)
def test_the_error_estimate_bounds_the_true_error_at_any_tolerance(
    passage_time: float, fading: float, exponent: float, digits: float
) -> None:
    restitution = 1 - 10**-exponent
    speed = _speed(passage_time, WEIGHT, restitution)
    dynamics = fading_ball(WEIGHT, fading, restitution)
    limit = _pass(dynamics, (0.0, 0.0, 0.0, 1.0), speed, tolerance=10**-digits)
    if limit is not None:
        truth = FadingBall(g=WEIGHT, b=fading, restitution=restitution).zeno_time(speed)
        assert abs(limit.time - truth) <= limit.error * (1 + truth)


@pytest.fixture(name="zeno_point", scope="module")
def _zeno_point() -> ZenoPoint:
    """The Zeno point behind a layer of the current, by all of its impacts."""
    dynamics, start = _pendulum(0.99), np.array(NEAR_ZENO)
    state = start + 3e-3 * dynamics.impulse_direction(start)
    return _simulated(dynamics, state, ZenoExtrapolation()).zeno_points[0]


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5, 1e-7, 1e-9, 1e-11])
def test_the_error_estimate_bounds_the_true_error_in_a_layer_of_the_current(
    tolerance: float, zeno_point: ZenoPoint
) -> None:
    truth = zeno_point
    limit = _pass(_pendulum(0.99), np.array(NEAR_ZENO), 3e-3, tolerance=tolerance)
    assert limit is not None
    assert limit.error <= 10 * tolerance
    assert np.all(np.abs(limit.state - truth.state) <= limit.error * (1 + np.abs(truth.state)))


@pytest.mark.parametrize("roughness", [1e-9, 1e-6])
def test_flights_that_are_less_accurate_than_they_should_be_are_noticed(roughness: float) -> None:
    restitution = 0.99
    dynamics = fading_ball(WEIGHT, 3.0, restitution)
    exact = rescaled_flights(dynamics, RungeKutta(), FINE)
    random = np.random.default_rng(0)

    def rough(state_plus: Vector, speed: float) -> tuple[float, Vector, float] | None:
        landing = exact(state_plus, speed)
        assert landing is not None
        duration, state_minus, rate = landing
        return duration, state_minus, rate * (1 + roughness * random.uniform(-1, 1))

    speed = _speed(0.3, WEIGHT, restitution)
    limit = _pass(dynamics, (0.0, 0.0, 0.0, 1.0), speed, flight=rough)
    truth = FadingBall(g=WEIGHT, b=3.0, restitution=restitution).zeno_time(speed)
    assert limit is None or abs(limit.time - truth) <= limit.error


# Where there is nothing to find.


def test_a_stop_that_repels_has_no_passage() -> None:
    assert _pass(falling_away(1.0), (0.0, 0.0), 1e-3) is None


# With the averaged law dw/dt = -(1 - e) a / 2 - b w / (3 a), where a = g - b t is the weight, w
# reaches zero before a does if the tail under a constant weight would last less than 3 g / (5 b).
FADING = 5.0
CRITICAL = 3 * WEIGHT / (5 * FADING)


@pytest.mark.parametrize("restitution", [0.97, 0.99, 0.999])
@pytest.mark.parametrize("part", fast(2, [1.02, 1.2, 2.0]))
def test_a_stop_that_lets_go_before_the_speed_is_zero_has_no_passage(
    restitution: float, part: float
) -> None:
    speed = _speed(part * CRITICAL, WEIGHT, restitution)
    assert FadingBall(g=WEIGHT, b=FADING, restitution=restitution).zeno_time(speed) == math.inf
    assert _pass(fading_ball(WEIGHT, FADING, restitution), (0.0, 0.0, 0.0, 1.0), speed) is None


@pytest.mark.parametrize("restitution", [0.97, 0.99, 0.999])
@pytest.mark.parametrize("part", fast(2, [0.7, 0.9, 0.95, 0.98, 0.999]))
def test_where_the_stop_hardly_holds_the_passage_is_right_or_not_given(
    restitution: float, part: float
) -> None:
    speed = _speed(part * CRITICAL, WEIGHT, restitution)
    truth = FadingBall(g=WEIGHT, b=FADING, restitution=restitution).zeno_time(speed)
    limit = _pass(fading_ball(WEIGHT, FADING, restitution), (0.0, 0.0, 0.0, 1.0), speed)
    assert limit is None or abs(limit.time - truth) <= limit.error * (1 + truth)
    if part == 0.7:
        assert limit is not None


def test_a_bead_that_leaves_its_disc_has_no_passage() -> None:
    restitution = 0.99
    speed = _speed(1.0, 2 * GRAVITY, restitution)
    assert _pass(bead_on_disc(restitution), _on_disc(ANGLE, TURN), speed) is None


def test_a_flight_that_does_not_come_back_ends_the_passage() -> None:
    dynamics = fading_ball(WEIGHT, 0.0, 0.99)
    assert _pass(dynamics, (0.0, 0.0, 0.0, 1.0), 0.01, flight=lambda _state, _speed: None) is None


def test_speeds_that_do_not_fall_end_the_passage() -> None:
    dynamics = fading_ball(WEIGHT, 0.0, 0.99)

    def gaining(state_plus: Vector, speed: float) -> tuple[float, Vector, float]:
        return 2 * speed / WEIGHT, state_plus, -speed / 0.99

    assert _pass(dynamics, (0.0, 0.0, 0.0, 1.0), 0.01, flight=gaining) is None


# Settling.


@pytest.mark.parametrize("units", [Units(), Units(length=1e3, time=1e3), Units(time=1e-6)])
def test_the_states_on_the_stop_are_those_without_gap_and_gap_rate_in_any_units(
    units: Units,
) -> None:
    pendulum = in_units(load_problem("motor_pendulum"), units)
    dynamics = pendulum.dynamics(pendulum.values())
    sizes = np.array([units.factor(dimension_of(unit)) for unit in pendulum.state_units])
    x = np.array(NEAR_ZENO) * sizes / dynamics.own.states(len(sizes))
    basis = ImpactCurve(dynamics, _Counted(dynamics), PLENTY).tangents(np.append(x, 0.0))
    assert basis.shape == (5, 3)
    assert basis.T @ basis == pytest.approx(np.eye(3), abs=1e-12)
    # The gap is the second angle.
    assert basis[[1, 3]] == pytest.approx(np.zeros((2, 3)), abs=1e-6)


def test_neighbouring_curves_approach_at_the_largest_rate_of_their_states() -> None:
    derivative = np.vstack([np.diag([-0.3, 0.1]), np.zeros(2)])
    end = CurveEnd(
        z=np.zeros(3), w=1.0, basis=np.eye(2), slope=np.zeros(3), fall=1.0, derivative=derivative
    )
    assert end.fastest == pytest.approx(0.3)
    alone = replace(end, z=np.zeros(1), basis=np.zeros((0, 0)), derivative=np.zeros((1, 0)))
    assert alone.fastest == 0.0


# The completion of a simulation.


@pytest.mark.parametrize("units", [Units(length=1e3, time=1e3), Units(length=1e-6, time=1e-6)])
def test_a_passage_is_the_same_in_far_units(units: Units) -> None:
    def zeno(units: Units) -> list[float]:
        pendulum = in_units(load_problem("motor_pendulum"), units)
        dynamics = pendulum.dynamics(pendulum.values(parameters={"restitution": 0.999}))
        sizes = np.array([units.factor(dimension_of(unit)) for unit in pendulum.state_units])
        start = np.add(NEAR_ZENO, (0.0, 0.0, 0.0, 0.003, 0.0)) * sizes
        rule = SimulationSettings(completion=ZenoPassage())
        run = simulate(dynamics, start, until=units.time, settings=rule)
        point = run.zeno_points[0]
        return [point.time / units.time, *(point.state / sizes)]

    assert zeno(units) == pytest.approx(zeno(Units()), rel=1e-9, abs=1e-11)


def _simulated(
    dynamics: HybridDynamics, state: Vector, completion: ZenoExtrapolation | ZenoPassage
) -> Execution:
    return simulate(
        dynamics,
        state,
        until=3.0,
        releases=1,
        settings=SimulationSettings(completion=completion),
    )


def test_a_simulation_passes_through_with_few_impacts_and_releases_at_the_same_state() -> None:
    dynamics = _pendulum(0.99)
    start = np.array(NEAR_ZENO)
    state = start + 3e-3 * dynamics.impulse_direction(start)
    by_impacts = _simulated(dynamics, state, ZenoExtrapolation())
    passed = _simulated(dynamics, state, ZenoPassage())
    assert len(passed.impacts) < 60 < 600 < len(by_impacts.impacts)
    # The constrained flow damps and stretches by no more than a few units.
    assert passed.releases[0].time == pytest.approx(by_impacts.releases[0].time, abs=1e-11)
    assert passed.releases[0].state == pytest.approx(by_impacts.releases[0].state, abs=1e-10)
    assert passed.zeno_points[0].last_speed > 1e-3


@pytest.mark.parametrize("speed", [0.1, 0.5])
def test_a_simulation_without_a_zeno_point_follows_every_impact(speed: float) -> None:
    dynamics = _pendulum(0.99)
    start = np.array(NEAR_ZENO)
    state = start + speed * dynamics.impulse_direction(start)
    executions = [
        _simulated(dynamics, state, rule) for rule in (ZenoExtrapolation(), ZenoPassage())
    ]
    times = [[impact.time for impact in execution.impacts] for execution in executions]
    assert times[0] == times[1]
    assert [len(execution.zeno_points) for execution in executions] == [0, 0]


def test_a_sequence_of_few_impacts_is_completed_as_ever() -> None:
    dynamics = _pendulum(0.5)
    start = np.array(NEAR_ZENO)
    state = start + 0.1 * dynamics.impulse_direction(start)
    executions = [
        _simulated(dynamics, state, rule) for rule in (ZenoExtrapolation(), ZenoPassage())
    ]
    points = [execution.zeno_points[0] for execution in executions]
    assert points[0].time == points[1].time
    assert points[0].state.tolist() == points[1].state.tolist()


def test_a_plastic_impact_is_completed_at_once() -> None:
    dynamics = _pendulum(0.0)
    start = np.array(NEAR_ZENO)
    state = start + 0.1 * dynamics.impulse_direction(start)
    assert len(_simulated(dynamics, state, ZenoPassage()).impacts) == 1
