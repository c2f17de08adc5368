"""The null space against SciPy's, and against what a null space is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg

from zeno_orbits.arrays import null_space

EPS = float(np.finfo(np.float64).eps)


@pytest.mark.parametrize(("shape", "rank"), [((3, 5), 3), ((2, 5), 1), ((4, 4), 2), ((5, 3), 3)])
def test_the_basis_spans_what_the_matrix_sends_to_zero(shape: tuple[int, int], rank: int) -> None:
    random = np.random.default_rng(1)
    matrix = random.normal(size=(shape[0], rank)) @ random.normal(size=(rank, shape[1]))
    basis = null_space(matrix)
    assert basis.shape == (shape[1], shape[1] - rank)
    rounding = 20 * EPS * np.linalg.norm(matrix)
    assert np.linalg.norm(matrix @ basis) <= rounding
    assert np.linalg.norm(basis.T @ basis - np.eye(basis.shape[1])) <= 20 * EPS
    # Two bases of one space differ by a rotation only, so their projectors agree.
    theirs = linalg.null_space(matrix)
    sizes = np.linalg.svd(matrix, compute_uv=False)[:rank]
    rounding = 50 * EPS * sizes[0] / sizes[-1]
    assert np.linalg.norm(basis @ basis.T - theirs @ theirs.T) <= rounding


def test_a_small_singular_value_counts_as_zero_below_the_given_size_only() -> None:
    matrix = np.diag([1.0, 1e-6, 0.0])
    assert null_space(matrix).shape == (3, 1)
    assert null_space(matrix, rcond=1e-5).shape == (3, 2)
    assert null_space(matrix, rcond=1e-7).shape == (3, 1)


def test_a_matrix_without_rows_or_of_zeros_sends_everything_to_zero() -> None:
    assert null_space(np.zeros((0, 3))).shape == (3, 3)
    assert null_space(np.zeros((2, 3))).shape == (3, 3)
