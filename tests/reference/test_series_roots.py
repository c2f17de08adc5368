"""The first root of a polynomial on [0, 1], isolated without samples."""

from itertools import pairwise
from math import comb

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.reference.many_digits.series_roots import first_root
from zeno_orbits.errors import InputError

ROUNDING = 2.0**-52


def _bernstein(coefficients: np.ndarray) -> np.ndarray:
    """Return a polynomial of ascending powers in Bernstein's basis on `[0, 1]`."""
    n = len(coefficients) - 1
    rows = [[comb(j, k) / comb(n, k) for k in range(n + 1)] for j in range(n + 1)]
    return np.array(rows) @ coefficients


def _first_root(coefficients: np.ndarray) -> float | None:
    return first_root(_bernstein(coefficients))


def _with_roots(*roots: float, degree: int = 0) -> np.ndarray:
    """Return a polynomial with the roots, positive at 0, of any higher degree without others."""
    coefficients = np.array([1.0])
    for root in roots:
        coefficients = np.convolve(coefficients, [1.0, -1.0 / root])
    for _ in range(max(degree - len(roots), 0)):
        coefficients = np.convolve(coefficients, [1.0, 0.05])
    return coefficients


@pytest.mark.parametrize("degree", [1, 5, 20, 52])
def test_a_single_root_is_found_to_rounding(degree: int) -> None:
    for root in (1e-9, 0.013, 0.5, 0.999):
        found = _first_root(_with_roots(root, degree=degree))
        assert found == pytest.approx(root, rel=4 * (degree + 1) * ROUNDING)


def test_without_a_root_there_is_none() -> None:
    assert _first_root(np.array([1.0, 0.5, 2.0])) is None
    assert _first_root(_with_roots(1.0001, 2.0)) is None
    # 1 - u + 0.26 u^2 is positive, though its coefficients change sign.
    assert _first_root(np.array([1.0, -1.0, 0.26])) is None


def test_of_several_roots_the_first_counts() -> None:
    assert _first_root(_with_roots(0.2, 0.3, 0.9)) == pytest.approx(0.2, rel=1e-14)
    assert _first_root(_with_roots(0.7, 0.300001, 0.3, 0.9)) == pytest.approx(0.3, rel=1e-9)


def test_a_dip_below_zero_between_any_two_samples_is_seen() -> None:
    found = _first_root(_with_roots(0.61803, 0.61803 + 1e-6))
    assert found == pytest.approx(0.61803, abs=1e-9)


def test_a_polynomial_that_starts_below_zero_has_left_already() -> None:
    assert _first_root(np.array([-1e-30, 1.0])) == 0.0
    assert _first_root(np.array([0.0, 1.0])) == 0.0


def test_a_rise_from_nearly_zero_and_a_fall_to_nearly_zero_are_no_roots() -> None:
    assert _first_root(np.array([1e-18, 1.0, 0.3])) is None
    assert _first_root(np.array([1.0 + 1e-15, -1.0])) is None


def test_two_roots_that_meet_are_told() -> None:
    # 3 (u - 1/3)^2 + 1e-16: rounding decides whether it has roots.
    with pytest.raises(InputError, match=r"simple roots, but two meet near 0\.333333"):
        _first_root(np.array([1.0 / 3.0 + 1e-16, -2.0, 3.0]))


def test_coefficients_that_are_not_finite_are_refused() -> None:
    with pytest.raises(InputError, match="must be finite"):
        first_root(np.array([1.0, np.nan]))


@example(roots=[0.5, 0.75], degree=0)  # a root where the interval is halved
@example(roots=[0.25, 0.5, 0.75], degree=3)
@given(st.lists(st.floats(0.05, 3.0), min_size=1, max_size=6), st.integers(0, 30))
def test_the_root_is_the_smallest_in_the_interval(roots: list[float], degree: int) -> None:
    roots = sorted(roots)
    if any(b - a < 0.02 for a, b in pairwise(roots)):
        return
    inside = [root for root in roots if root < 0.999]
    if any(0.999 <= root <= 1.001 for root in roots):
        return
    found = _first_root(_with_roots(*roots, degree=degree))
    if inside:
        # Six roots 0.02 apart magnify rounding by up to (1 / 0.02)^5.
        assert found == pytest.approx(inside[0], abs=1e-6)
    else:
        assert found is None
