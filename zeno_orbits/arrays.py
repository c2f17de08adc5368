"""Types of arrays, and what linear algebra NumPy lacks.

``scipy.linalg`` has the null space too, but takes a tenth of a second to import.
"""

from __future__ import annotations

from collections.abc import Callable

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


def eigenvalues(matrix: Array) -> tuple[complex, ...]:
    """Return the eigenvalues of a square matrix, the largest in modulus first."""
    values = sorted(np.linalg.eigvals(matrix), key=abs, reverse=True)
    return tuple(complex(value) for value in values)
