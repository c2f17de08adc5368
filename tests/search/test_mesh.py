"""Collocation and graded meshes against polynomials, layers and a stiff linear problem."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from zeno_orbits.arrays import Array
from zeno_orbits.integrators import Collocation, radau_scheme
from zeno_orbits.search.program.mesh import graded_mesh, stage_fractions

ROUNDING = 1e-13


@pytest.mark.parametrize("n", range(1, 8))
def test_every_stage_integrates_polynomials_exactly(n: int) -> None:
    scheme = radau_scheme(n)
    for power in range(n):
        integrals = scheme.matrix @ scheme.nodes**power
        assert integrals == pytest.approx(scheme.nodes ** (power + 1) / (power + 1), abs=ROUNDING)


@pytest.mark.parametrize("n", range(1, 8))
def test_the_end_integrates_polynomials_of_almost_twice_the_degree(n: int) -> None:
    scheme = radau_scheme(n)
    for power in range(2 * n - 1):
        exact = 1 / (power + 1)
        assert scheme.weights @ scheme.nodes**power == pytest.approx(exact, abs=ROUNDING)
    power = 2 * n - 1
    assert abs(scheme.weights @ scheme.nodes**power - 1 / (power + 1)) > 1e-8


@pytest.mark.parametrize("n", range(1, 8))
def test_the_last_stage_is_the_end_of_the_interval(n: int) -> None:
    scheme = radau_scheme(n)
    assert scheme.n_stages == n
    assert scheme.nodes[-1] == pytest.approx(1.0, abs=1e-15)
    assert np.all(np.diff(scheme.nodes) > 0)
    assert scheme.nodes[0] > 0
    assert scheme.weights.sum() == pytest.approx(1.0, abs=ROUNDING)


def _stability(scheme: Collocation, z: complex) -> complex:
    """Return the factor by which one step multiplies the solution of ``y' = z y``."""
    ones = np.ones(scheme.n_stages)
    return complex(np.linalg.solve(np.eye(scheme.n_stages) - z * scheme.matrix, ones)[-1])


def _layer(scheme: Collocation, rate: float, n_steps: int) -> float:
    """Return ``y(1)`` for ``y' = -rate (y - cos t) - sin t``, ``y(0) = 2``.

    The solution is ``cos t + exp(-rate t)``.
    """
    size, y = 1 / n_steps, 2.0
    for k in range(n_steps):
        at = (k + scheme.nodes) * size
        forcing = rate * np.cos(at) - np.sin(at)
        left = np.eye(scheme.n_stages) + size * rate * scheme.matrix
        y = float(np.linalg.solve(left, y + size * scheme.matrix @ forcing)[-1])
    return y


@pytest.mark.parametrize(("n", "steps"), [(1, 64), (2, 16), (3, 8), (4, 4)])
def test_the_order_is_one_less_than_twice_the_stages(n: int, steps: int) -> None:
    exact = math.cos(1.0) + math.exp(-5.0)
    coarse = abs(_layer(radau_scheme(n), 5.0, steps) - exact)
    fine = abs(_layer(radau_scheme(n), 5.0, 2 * steps) - exact)
    assert fine > 100 * ROUNDING
    assert math.log2(coarse / fine) == pytest.approx(2 * n - 1, abs=0.3)


@pytest.mark.parametrize("n", [2, 3, 6])
def test_a_layer_that_no_step_resolves_dies_at_once(n: int) -> None:
    # The step is 1e5 widths of the layer; the scheme's factor there is about n^2 / 1e5.
    assert abs(_stability(radau_scheme(n), -1e5)) < 2 * n**2 / 1e5
    assert _layer(radau_scheme(n), 1e6, 10) == pytest.approx(math.cos(1.0), abs=1e-6)


@pytest.mark.parametrize("y", [0.1, 1.0, 10.0, 100.0])
def test_oscillations_never_grow(y: float) -> None:
    assert abs(_stability(radau_scheme(6), 1j * y)) <= 1 + ROUNDING


# Meshes.

ONE = np.ones(1)


def _between(mesh: Array, width: float, scheme: Collocation) -> float:
    """Return the largest error of the polynomials for ``exp(-t / width)``, on a fine grid."""
    worst = 0.0
    points = np.concatenate([[0.0], scheme.nodes])
    fine = np.linspace(0, 1, 41)
    for left, right in pairwise(mesh):
        values = np.exp(-(left + (right - left) * points) / width)
        polynomial = np.polynomial.Polynomial.fit(points, values, len(points) - 1)
        exact = np.exp(-(left + (right - left) * fine) / width)
        worst = max(worst, float(np.max(np.abs(polynomial(fine) - exact))))
    return worst


@pytest.mark.parametrize("width", [3e-2, 1e-2, 1e-3])
@pytest.mark.parametrize("tolerance", [1e-5, 1e-8])
def test_a_mesh_is_fine_in_a_layer_and_coarse_outside(width: float, tolerance: float) -> None:
    scheme = radau_scheme(5)
    mesh = graded_mesh(
        lambda t: np.exp(-t / width)[:, None], scheme, scale=ONE, tolerance=tolerance
    )
    sizes = np.diff(mesh)
    assert mesh[0] == 0.0
    assert mesh[-1] == 1.0
    assert np.all(sizes > 0)
    # Looser and looser away from the layer, apart from where halving must stay on its grid.
    assert np.all(sizes[1:] >= sizes[:-1] / 2)
    assert sizes[-1] >= 0.25
    assert sizes[0] <= 6 * width
    # The test looks between the stages only; elsewhere the polynomial may miss a little more.
    assert _between(mesh, width, scheme) <= 3 * tolerance


def test_a_tighter_tolerance_gives_a_finer_mesh() -> None:
    def sized(tolerance: float) -> int:
        mesh = graded_mesh(
            lambda t: np.exp(-t / 0.01)[:, None],
            radau_scheme(4),
            scale=ONE,
            tolerance=tolerance,
        )
        return len(mesh)

    assert sized(1e-3) < sized(1e-6) < sized(1e-9)


@pytest.mark.parametrize("n", [2, 4, 6])
def test_a_polynomial_of_the_degree_of_the_stages_needs_one_interval(n: int) -> None:
    mesh = graded_mesh(
        lambda t: np.array([(t - 0.3) ** n, np.ones_like(t)]).T,
        radau_scheme(n),
        scale=np.ones(2),
        tolerance=ROUNDING,
    )
    assert mesh.tolist() == [0.0, 1.0]


def test_a_state_counts_in_units_of_its_scale() -> None:
    def mesh(scale: float) -> Array:
        return graded_mesh(
            lambda t: 1e3 * np.exp(-t / 0.02)[:, None],
            radau_scheme(4),
            scale=np.array([scale]),
            tolerance=1e-6,
        )

    assert len(mesh(1e3)) < len(mesh(1.0))
    alone = graded_mesh(
        lambda t: np.exp(-t / 0.02)[:, None], radau_scheme(4), scale=ONE, tolerance=1e-6
    )
    assert mesh(1e3).tolist() == alone.tolist()


def test_a_jump_ends_at_the_deepest_interval() -> None:
    mesh = graded_mesh(
        lambda t: (t > 1 / 3).astype(float)[:, None],
        radau_scheme(3),
        scale=ONE,
        tolerance=1e-6,
        deepest=5,
    )
    assert np.min(np.diff(mesh)) == 2.0**-5


def test_fewest_even_intervals_are_kept() -> None:
    mesh = graded_mesh(lambda t: t[:, None], radau_scheme(3), scale=ONE, tolerance=1e-9, fewest=4)
    assert mesh.tolist() == [0.0, 0.25, 0.5, 0.75, 1.0]


def test_stages_lie_in_their_intervals_and_end_them() -> None:
    mesh, scheme = np.array([0.0, 0.25, 1.0]), radau_scheme(3)
    fractions = stage_fractions(mesh, scheme)
    assert fractions.shape == (6,)
    assert fractions[2::3] == pytest.approx(mesh[1:], abs=1e-15)
    assert fractions[:3] == pytest.approx(0.25 * scheme.nodes)
    assert fractions[3:] == pytest.approx(0.25 + 0.75 * scheme.nodes)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("tolerance", "scale", "n"), [(0.01, 1.0, 8), (0.01, 4.0, 4), (1 / 64, 1.0, 4)]
)
def test_a_parabola_is_halved_until_its_chords_are_near_enough(
    sign: float, tolerance: float, scale: float, n: int
) -> None:
    # Half way the chord of x^2 over an interval h misses it by h^2 / 4, from whichever side; the
    # second state never does.
    mesh = graded_mesh(
        lambda t: np.array([sign * t**2, np.full_like(t, 3.0)]).T,
        radau_scheme(1),
        scale=np.array([scale, 1e-9]),
        tolerance=tolerance,
    )
    assert mesh.tolist() == [k / n for k in range(n + 1)]


def test_a_trajectory_is_seen_at_the_points_of_the_polynomial_and_half_way_between_them() -> None:
    scheme, seen = radau_scheme(3), set[float]()

    def trajectory(t: Array) -> Array:
        seen.update(t.tolist())
        return np.zeros((len(t), 1))

    mesh = graded_mesh(trajectory, scheme, scale=ONE, tolerance=0.0)
    assert mesh.tolist() == [0.0, 1.0]
    points = [0.0, *scheme.nodes.tolist()]
    half_way = [(one + two) / 2 for one, two in pairwise(points)]
    assert sorted(seen) == pytest.approx(sorted([*points, *half_way]), abs=1e-15)


def test_a_jump_is_halved_fourteen_times_if_nothing_else_is_said() -> None:
    mesh = graded_mesh(
        lambda t: (t > 1 / 3).astype(float)[:, None], radau_scheme(1), scale=ONE, tolerance=1e-6
    )
    assert np.min(np.diff(mesh)) == 2.0**-14


def test_a_trajectory_of_rounding_gets_no_more_intervals_than_it_may() -> None:
    # Noise of 1e-6 cannot be followed to 1e-9: the tolerance is raised to that of the noise.
    def noisy(at: Array) -> Array:
        return (np.exp(at) + 1e-6 * np.sin(1e9 * at))[:, None]

    scheme = radau_scheme(3)
    mesh = graded_mesh(noisy, scheme, scale=ONE, tolerance=1e-9, most=20)
    unlimited = graded_mesh(noisy, scheme, scale=ONE, tolerance=1e-9, deepest=8)
    assert len(unlimited) == 2**8 + 1
    assert 2 <= len(mesh) <= 21


def test_a_trajectory_that_is_not_finite_gets_the_even_mesh() -> None:
    mesh = graded_mesh(
        lambda t: np.full((len(t), 1), np.nan),
        radau_scheme(3),
        scale=ONE,
        tolerance=1e-9,
        fewest=3,
        most=9,
    )
    assert mesh.tolist() == pytest.approx([0.0, 1 / 3, 2 / 3, 1.0])
