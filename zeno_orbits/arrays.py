"""Types of arrays, and what linear algebra NumPy lacks.

``scipy.linalg`` has the null space too, but takes a tenth of a second to import.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Array = NDArray[np.float64]
Rows = NDArray[np.intp]
Scalar = Callable[[Vector], float]


def null_space(matrix: Array, rcond: float | None = None) -> Array:
    r"""Return an orthonormal basis of the vectors that a matrix sends to zero.

    With :math:`A = U \Sigma V^\top` they are the rows of :math:`V^\top` whose singular value is at
    most ``rcond`` times the largest one, or that lack a singular value.

    Args:
        matrix: `A`, ``(m, n)``.
        rcond: Relative size of a singular value that counts as zero; by default rounding,
            ``eps max(m, n)``.

    Returns:
        The basis, ``(n, n - rank)``.
    """
    _, sizes, rows = np.linalg.svd(matrix, full_matrices=True)
    if rcond is None:
        rcond = float(np.finfo(np.float64).eps) * max(matrix.shape)
    rank = int(np.sum(sizes > rcond * np.max(sizes, initial=0.0)))
    return np.asarray(rows[rank:].T, dtype=np.float64)


ROUNDED = 1e-9
"""Relative singular value of a derivative that is rounding."""


def eigenvalues(matrix: Array) -> tuple[complex, ...]:
    r"""Return the eigenvalues of a square matrix, the largest in modulus first.

    Eigenvalues below rounding are zero. Their number is that of the directions that powers of the
    matrix send to zero. The eigenvalues of a rounded Jordan block would be roots of the rounding.
    """
    values = sorted(np.linalg.eigvals(matrix), key=lambda value: (-abs(value), -value.imag))
    rest = matrix
    while rest.size:
        zero = ROUNDED * max(1.0, float(np.linalg.norm(matrix, 2)))
        _, sizes, rows = np.linalg.svd(rest)
        keeps = rows[sizes > zero]
        if len(keeps) == len(rest):
            break
        rest = keeps @ rest @ keeps.T
    known = len(rest)
    return tuple(complex(value) if k < known else 0j for k, value in enumerate(values))


def eigenvalue_errors(values: Sequence[complex], others: Sequence[complex]) -> tuple[float, ...]:
    """Return the distance of each eigenvalue from those of a rougher computation.

    Eigenvalues that are all below rounding have the error of rounding.

    Args:
        values: The eigenvalues, the largest first.
        others: The eigenvalues of the rougher computation.
    """
    least = ROUNDED if values and values[0] == 0.0 else 0.0
    away = [min((abs(other - value) for other in others), default=math.inf) for value in values]
    return tuple(max(least, distance) for distance in away)
