"""Lagrangian mechanics: the derived equations of motion against equations written by hand."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from tests.support.mechanisms import evaluated
from zeno_orbits import HybridLagrangian

ROUNDING = 1e-13
"""Both sides are a few dozen operations on numbers of size 1 to 10."""


@pytest.fixture(name="q")
def _q() -> ca.SX:
    return ca.SX.sym("q", 2)


@pytest.fixture(name="v")
def _v() -> ca.SX:
    return ca.SX.sym("v", 2)


def test_a_pendulum_on_a_cart_has_the_equations_of_the_textbook(q: ca.SX, v: ca.SX) -> None:
    cart, bob, length, g, friction = 2.0, 0.5, 0.8, 9.81, 0.3
    mechanism = HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=(cart + bob) / 2 * v[0] ** 2
        + bob * length * ca.cos(q[1]) * v[0] * v[1]
        + bob * length**2 / 2 * v[1] ** 2,
        potential=-bob * g * length * ca.cos(q[1]),
        gap=1 - q[0],
        passive_force=ca.vertcat(-friction * v[0], 0),
    )
    for point in np.random.default_rng(1).normal(size=(20, 4)):
        values = {"q": point[:2], "v": point[2:]}
        cosine, sine, rate = np.cos(point[1]), np.sin(point[1]), point[3]
        coupling = bob * length * cosine
        mass = [[cart + bob, coupling], [coupling, bob * length**2]]
        bias = [
            -bob * length * sine * rate**2 + friction * point[2],
            bob * g * length * sine,
        ]
        assert evaluated(mechanism.mass_matrix, values, q=q, v=v) == pytest.approx(
            np.array(mass), abs=ROUNDING
        )
        assert evaluated(mechanism.bias, values, q=q, v=v)[:, 0] == pytest.approx(
            np.array(bias), abs=100 * ROUNDING
        )


def test_polar_coordinates_bring_the_centrifugal_and_the_coriolis_force(q: ca.SX, v: ca.SX) -> None:
    mass = 1.7
    mechanism = HybridLagrangian.from_energies(
        q=q, v=v, kinetic=mass / 2 * (v[0] ** 2 + (q[0] * v[1]) ** 2), potential=ca.SX(0), gap=q[0]
    )
    radius, rate, turn = 1.3, -0.4, 2.1
    values = {"q": (radius, 0.2), "v": (rate, turn)}
    expected = [-mass * radius * turn**2, 2 * mass * radius * rate * turn]
    assert evaluated(mechanism.bias, values, q=q, v=v)[:, 0] == pytest.approx(
        np.array(expected), abs=ROUNDING
    )


def test_the_kinetic_energy_comes_back_from_the_mass_matrix(q: ca.SX, v: ca.SX) -> None:
    kinetic = (2 + ca.sin(q[0])) * v[0] ** 2 + ca.cos(q[1]) * v[0] * v[1] + v[1] ** 2
    mechanism = HybridLagrangian.from_energies(
        q=q, v=v, kinetic=kinetic, potential=ca.SX(0), gap=q[0]
    )
    values = {"q": (0.3, -1.1), "v": (0.9, 2.0)}
    difference = evaluated(mechanism.kinetic - kinetic, values, q=q, v=v)
    assert abs(difference[0, 0]) < ROUNDING


def test_without_friction_and_constraints_those_fields_are_zero_and_empty(
    q: ca.SX, v: ca.SX
) -> None:
    mechanism = HybridLagrangian.from_energies(
        q=q, v=v, kinetic=ca.sumsqr(v) / 2, potential=ca.SX(0), gap=q[0]
    )
    assert mechanism.passive_force.is_zero()
    assert mechanism.holonomic.numel() == 0


def test_a_gap_that_depends_on_the_velocity_is_refused(q: ca.SX, v: ca.SX) -> None:
    with pytest.raises(ValueError, match="`gap` must depend on the configuration only"):
        HybridLagrangian.from_energies(
            q=q, v=v, kinetic=ca.sumsqr(v) / 2, potential=ca.SX(0), gap=q[0] + v[0]
        )


def test_a_potential_that_depends_on_the_velocity_is_refused(q: ca.SX, v: ca.SX) -> None:
    with pytest.raises(ValueError, match="`potential` must depend on the configuration only"):
        HybridLagrangian.from_energies(
            q=q, v=v, kinetic=ca.sumsqr(v) / 2, potential=q[0] * v[1], gap=q[0]
        )


def test_a_constraint_that_depends_on_the_velocity_is_refused(q: ca.SX, v: ca.SX) -> None:
    with pytest.raises(ValueError, match="`holonomic` must depend on the configuration only"):
        HybridLagrangian.from_energies(
            q=q, v=v, kinetic=ca.sumsqr(v) / 2, potential=ca.SX(0), gap=q[0], holonomic=v[1] - q[0]
        )


def test_a_constant_gap_is_refused(q: ca.SX, v: ca.SX) -> None:
    with pytest.raises(ValueError, match="`gap` must depend on the configuration, but it is const"):
        HybridLagrangian.from_energies(
            q=q, v=v, kinetic=ca.sumsqr(v) / 2, potential=ca.SX(0), gap=ca.SX(1)
        )


def test_a_kinetic_energy_of_third_degree_is_refused(q: ca.SX, v: ca.SX) -> None:
    with pytest.raises(ValueError, match="`kinetic` must be quadratic in the velocity"):
        HybridLagrangian.from_energies(
            q=q, v=v, kinetic=ca.sumsqr(v) / 2 + v[0] ** 3, potential=ca.SX(0), gap=q[0]
        )


def test_a_kinetic_energy_with_a_linear_term_is_refused(q: ca.SX, v: ca.SX) -> None:
    turn = 2.0
    seen_from_turntable = ((v[0] - turn * q[1]) ** 2 + (v[1] + turn * q[0]) ** 2) / 2
    with pytest.raises(ValueError, match="`kinetic` must be quadratic in the velocity"):
        HybridLagrangian.from_energies(
            q=q, v=v, kinetic=seen_from_turntable, potential=ca.SX(0), gap=q[0]
        )


def test_a_velocity_of_the_wrong_length_is_refused(q: ca.SX) -> None:
    v = ca.SX.sym("v", 3)
    with pytest.raises(
        ValueError, match="`v` must have 2 entries, one per coordinate, but it has 3"
    ):
        HybridLagrangian.from_energies(
            q=q, v=v, kinetic=ca.sumsqr(v) / 2, potential=ca.SX(0), gap=q[0]
        )


def test_a_force_of_the_wrong_length_is_refused(q: ca.SX, v: ca.SX) -> None:
    with pytest.raises(ValueError, match="`passive_force` must have 2 entries"):
        HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.sumsqr(v) / 2,
            potential=ca.SX(0),
            gap=q[0],
            passive_force=-v[0],
        )


def test_an_asymmetry_that_random_points_near_one_miss_is_refused() -> None:
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)

    def given(off: ca.SX) -> HybridLagrangian:
        mass = ca.SX.eye(2) * 2
        mass[0, 1] = off
        return HybridLagrangian.from_matrices(
            q=q, v=v, mass_matrix=mass, coriolis=ca.SX(2, 2), gravity=ca.SX(2, 1), gap=q[0]
        )

    # Zero for positive coordinates, at which formulas without kinks are told apart.
    with pytest.raises(ValueError, match="`mass_matrix` is not symmetric"):
        given(ca.fmax(-q[0], 0))
    # A formula that is finite nowhere near 1 is not taken for zero.
    with pytest.raises(ValueError, match="finite at none of 4 states"):
        given(ca.sqrt(q[0] - 20))


def test_a_spike_between_random_points_is_the_declared_limit_of_the_check() -> None:
    # docs/limits.md: it is not zero, and no random point is within its width.
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    mass = ca.SX.eye(2) * 2
    mass[0, 1] = ca.exp(-1e8 * (q[0] - 1.234567) ** 2)
    HybridLagrangian.from_matrices(
        q=q, v=v, mass_matrix=mass, coriolis=ca.SX(2, 2), gravity=ca.SX(2, 1), gap=q[0]
    )


SCALES = (1e-15, 1e-12, 1.0, 1e12)
"""Masses written as numbers, from those of a microchip to those of an asteroid [kg]."""


def _by_christoffel(mass: ca.SX, q: ca.SX, v: ca.SX) -> ca.SX:
    coriolis = ca.SX(2, 2)
    for i in range(2):
        for j in range(2):
            slopes = ca.jacobian(mass[i, j], q) + ca.jacobian(mass[i, :], q[j]).T
            coriolis[i, j] = ca.mtimes(slopes - ca.jacobian(mass[j, :], q[i]).T, v) / 2
    return coriolis


@pytest.mark.parametrize("size", SCALES)
def test_matrices_of_any_unit_are_held_against_their_own_size(
    q: ca.SX, v: ca.SX, size: float
) -> None:
    one = size * (2 + ca.cos(q[1]))
    mass = ca.blockcat([[2 * one, one], [one, ca.SX(3 * size)]])
    coriolis = _by_christoffel(mass, q, v)

    def given(mass: ca.SX, coriolis: ca.SX) -> HybridLagrangian:
        gravity = ca.SX(2, 1)
        return HybridLagrangian.from_matrices(
            q=q, v=v, mass_matrix=mass, coriolis=coriolis, gravity=gravity, gap=q[0]
        )

    given(mass, coriolis)
    with pytest.raises(ValueError, match="`coriolis` is not consistent"):
        given(mass, (1 + 1e-6) * coriolis)
    mass[1, 0] *= 1 + 1e-6
    with pytest.raises(ValueError, match="`mass_matrix` is not symmetric"):
        given(mass, coriolis)


def test_a_heavy_part_does_not_hide_a_light_one(q: ca.SX, v: ca.SX) -> None:
    heavy, light = 1e3 * (2 + ca.cos(q[0])), 1e-12 * (2 + ca.sin(q[1]))
    mass = ca.diag(ca.vertcat(heavy, light))
    potential = 1e3 * q[0] ** 2 + 1e-6 * ca.cos(q[1])
    coriolis = ca.diag(ca.vertcat(*(ca.jtimes(one, q, v) / 2 for one in (heavy, light))))

    def given(coriolis: ca.SX, weight: ca.SX) -> HybridLagrangian:
        return HybridLagrangian.from_matrices(
            q=q,
            v=v,
            mass_matrix=mass,
            coriolis=coriolis,
            gravity=weight,
            gap=q[0],
            potential=potential,
        )

    weight = ca.gradient(potential, q)
    given(coriolis, weight)
    with pytest.raises(ValueError, match="coordinate 2 differs"):
        given(coriolis, weight * ca.DM([1.0, 1.01]))
    with pytest.raises(ValueError, match="`coriolis` is not consistent"):
        given(coriolis * ca.DM([[1.0, 1.0], [1.0, 1.01]]), weight)
