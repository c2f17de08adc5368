"""The completed system: reset map, multiplier and constrained flow against their laws."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

from tests.support.mechanisms import (
    GRAVITY,
    PENDULUM_LENGTH,
    PENDULUM_MASS,
    TILT,
    bead_on_disc,
    cartesian_pendulum,
    numeric,
    on_circle,
    polar_pendulum,
)
from zeno_orbits.arrays import Vector
from zeno_orbits.model import HybridDynamics, load_problem
from zeno_orbits.simulation import simulate

RESTITUTION = 0.35
ROUNDING = 1e-12
"""A few hundred operations on numbers up to about 100."""


def _motor_pendulum() -> HybridDynamics:
    problem = load_problem("motor_pendulum")
    values = problem.values(parameters={"restitution": RESTITUTION})
    return problem.dynamics(values)


@pytest.fixture(name="pendulum", scope="module")
def _pendulum() -> HybridDynamics:
    return _motor_pendulum()


@pytest.fixture(name="cartesian", scope="module")
def _cartesian() -> HybridDynamics:
    return numeric(cartesian_pendulum(), restitution=RESTITUTION)


@pytest.fixture(name="polar", scope="module")
def _polar() -> HybridDynamics:
    return numeric(polar_pendulum(lambda q: q), restitution=RESTITUTION)


def _approaching(n_x: int, gap_rate_entry: int, seed: int) -> list[Vector]:
    states = np.random.default_rng(seed).normal(size=(30, n_x))
    states[:, gap_rate_entry] = -np.abs(states[:, gap_rate_entry])
    return list(states)


def test_an_impact_turns_the_gap_rate_round_and_keeps_a_fraction(pendulum: HybridDynamics) -> None:
    for x in _approaching(5, 3, seed=2):
        rate = pendulum.gap_rate(x)
        after = pendulum.reset_map(x, rate)
        assert pendulum.gap_rate(after) == pytest.approx(-RESTITUTION * rate, abs=ROUNDING)


def test_an_impact_leaves_the_configuration_and_the_current_alone(
    pendulum: HybridDynamics,
) -> None:
    for x in _approaching(5, 3, seed=3):
        after = pendulum.reset_map(x, pendulum.gap_rate(x))
        assert after[[0, 1, 4]].tolist() == x[[0, 1, 4]].tolist()


def test_an_impact_takes_the_energy_of_the_lost_gap_rate(pendulum: HybridDynamics) -> None:
    for x in _approaching(5, 3, seed=4):
        rate = pendulum.gap_rate(x)
        change = pendulum.energy(pendulum.reset_map(x, rate)) - pendulum.energy(x)
        law = -(1 - RESTITUTION**2) / 2 * pendulum.normal_inertia(x) * rate**2
        assert change == pytest.approx(law, abs=ROUNDING)


def test_an_impact_keeps_the_momentum_along_the_stop(pendulum: HybridDynamics) -> None:
    # The stop is theta2 = 0, so the momentum of theta1 is the one along it: dT / d(dtheta1).
    p = load_problem("motor_pendulum").values().parameters
    b = p["I2"] + p["m2"] * p["lc2"] ** 2
    c = p["m2"] * p["L1"] * p["lc2"]
    a = p["I1"] + p["m1"] * p["lc1"] ** 2 + p["m2"] * p["L1"] ** 2 + p["J_rotor"]
    for x in _approaching(5, 3, seed=5):
        after = pendulum.reset_map(x, pendulum.gap_rate(x))
        cosine = math.cos(x[1])
        row = np.array([a + b + 2 * c * cosine, b + c * cosine])
        assert row @ after[2:4] == pytest.approx(row @ x[2:4], abs=ROUNDING)


def test_the_locked_flow_keeps_the_gap_rate(pendulum: HybridDynamics) -> None:
    bead = bead_on_disc(RESTITUTION)
    step = 1e-5
    for dynamics, n_x in ((pendulum, 5), (bead, 4)):
        for x in np.random.default_rng(6).normal(size=(30, n_x)):
            slope = dynamics.locked.rate(x)
            ahead = dynamics.gap_rate(x + step * slope)
            behind = dynamics.gap_rate(x - step * slope)
            # The gap rate is at most quadratic in the state: a central difference is exact, and
            # its rounding is that of numbers of size 10 divided by the step.
            assert abs(ahead - behind) / (2 * step) < 100 * 2.0**-52 / step * max(
                1.0, float(np.max(np.abs(slope)))
            )


def test_the_free_flow_has_the_gap_acceleration_of_finite_differences() -> None:
    bead = bead_on_disc(RESTITUTION)
    step = 1e-5
    for x in np.random.default_rng(7).normal(size=(30, 4)):
        slope = bead.free.rate(x)
        ahead, behind = bead.gap_rate(x + step * slope), bead.gap_rate(x - step * slope)
        # Quadratic again: only rounding is left.
        assert (ahead - behind) / (2 * step) == pytest.approx(bead.gap_acceleration(x), abs=1e-8)


def test_the_multiplier_rate_is_the_derivative_along_the_locked_flow(
    pendulum: HybridDynamics,
) -> None:
    for dynamics, n_x in ((pendulum, 5), (bead_on_disc(RESTITUTION), 4)):
        for x in np.random.default_rng(8).normal(size=(30, n_x)):
            slope = dynamics.locked.rate(x)
            size = 1.0 + float(np.max(np.abs(slope)))
            step = 1e-5 / size
            ahead = dynamics.multiplier(x + step * slope)
            behind = dynamics.multiplier(x - step * slope)
            # Truncation (step * slope)^2 = 1e-10 and rounding 1e-16 / 1e-5, both times the slope,
            # with room for third derivatives of size 100 where the bead is near the centre.
            assert (ahead - behind) / (2 * step) == pytest.approx(
                dynamics.multiplier_rate(x), rel=1e-6, abs=1e-8 * size
            )


def test_a_bead_is_carried_by_what_its_weight_leaves_after_the_turn() -> None:
    bead = bead_on_disc(RESTITUTION)
    for x in np.random.default_rng(9).normal(size=(30, 4)):
        radius_squared = x[0] ** 2 + x[1] ** 2
        law = (GRAVITY * x[1] - x[2] ** 2 - x[3] ** 2) / (2 * radius_squared)
        assert bead.multiplier(x) == pytest.approx(law, rel=ROUNDING, abs=ROUNDING)


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.4, 2.9])
def test_a_pendulum_on_a_circle_accelerates_like_one_in_its_angle(
    cartesian: HybridDynamics, polar: HybridDynamics, angle: float
) -> None:
    rate = -1.7
    spin = polar.free.rate(np.array([angle, rate]))[1]
    length, sine, cosine = PENDULUM_LENGTH, math.sin(angle), math.cos(angle)
    expected = [
        length * (spin * cosine - rate**2 * sine),
        length * (spin * sine + rate**2 * cosine),
    ]
    x = np.array(on_circle(angle, rate))
    assert cartesian.free.rate(x)[2:] == pytest.approx(np.array(expected), abs=ROUNDING)


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.2])
def test_the_constrained_maps_agree_with_the_angle_under_the_same_gap(
    cartesian: HybridDynamics, angle: float
) -> None:
    same_gap = numeric(
        polar_pendulum(lambda q: PENDULUM_LENGTH * ca.sin(q)), restitution=RESTITUTION
    )
    rate = -1.7
    x, y = np.array(on_circle(angle, rate)), np.array([angle, rate])
    for name in (
        "gap",
        "gap_rate",
        "gap_acceleration",
        "multiplier",
        "multiplier_rate",
        "normal_inertia",
        "energy",
    ):
        in_plane, in_angle = getattr(cartesian, name)(x), getattr(same_gap, name)(y)
        assert in_plane == pytest.approx(in_angle, rel=ROUNDING, abs=ROUNDING), name


def test_the_force_of_the_stop_becomes_a_torque_by_the_length(
    cartesian: HybridDynamics, polar: HybridDynamics
) -> None:
    force = cartesian.multiplier(np.array(on_circle(0.0, 0.0)))
    torque = polar.multiplier(np.array([0.0, 0.0]))
    assert force == pytest.approx(PENDULUM_MASS * GRAVITY * math.sin(TILT), rel=ROUNDING)
    assert torque == pytest.approx(PENDULUM_LENGTH * force, rel=ROUNDING)


def test_an_impact_on_the_circle_is_an_impact_in_the_angle(
    cartesian: HybridDynamics, polar: HybridDynamics
) -> None:
    x, y = np.array(on_circle(0.0, -2.0)), np.array([0.0, -2.0])
    after = polar.reset_map(y, polar.gap_rate(y))
    expected = np.array(on_circle(after[0], after[1]))
    assert cartesian.reset_map(x, cartesian.gap_rate(x)) == pytest.approx(expected, abs=ROUNDING)


def test_an_impact_and_both_flows_keep_the_circle(cartesian: HybridDynamics) -> None:
    step = 1e-5
    x = np.array(on_circle(0.0, -2.0))
    after = cartesian.reset_map(x, cartesian.gap_rate(x))
    assert np.max(np.abs(cartesian.holonomic(after))) < ROUNDING
    for flow in (cartesian.free, cartesian.locked):
        start = x if flow is cartesian.free else np.array(on_circle(0.0, 0.0))
        slope = flow.rate(start)
        ahead = cartesian.holonomic(start + step * slope)
        behind = cartesian.holonomic(start - step * slope)
        # Quadratic in the state, so that only rounding is left.
        assert np.max(np.abs(ahead - behind)) / (2 * step) < 1e-9


def test_the_locked_pendulum_on_the_circle_stays_where_it_is(cartesian: HybridDynamics) -> None:
    x = np.array(on_circle(0.0, 0.0))
    assert np.max(np.abs(cartesian.locked.rate(x))) < ROUNDING


def test_both_pendulums_reach_the_same_zeno_point(
    cartesian: HybridDynamics, polar: HybridDynamics
) -> None:
    angle, until = 0.8, 3.0
    on_plane = simulate(cartesian, on_circle(angle, 0.0), until=until)
    in_angle = simulate(polar, (angle, 0.0), until=until)
    zeno, same = on_plane.zeno_points[0], in_angle.zeno_points[0]
    accuracy = 1e-11  # what the default settings aim at
    assert zeno.time == pytest.approx(same.time, abs=accuracy)
    assert len(on_plane.zeno_points) == len(in_angle.zeno_points) == 1
    assert np.max(np.abs(cartesian.holonomic(on_plane.end_state))) < accuracy
    for left, right in zip(on_plane.impacts, in_angle.impacts, strict=False):
        assert left.time == pytest.approx(right.time, abs=accuracy)
        assert left.approach_rate == pytest.approx(
            PENDULUM_LENGTH * right.approach_rate, abs=accuracy
        )


def test_a_state_off_the_circle_is_refused(cartesian: HybridDynamics) -> None:
    off = (PENDULUM_LENGTH + 1e-3, 0.0, 0.0, 0.0)
    with pytest.raises(ValueError, match="`state` must keep the holonomic constraints"):
        simulate(cartesian, off, until=1.0)
