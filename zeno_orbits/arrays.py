"""Types of arrays, and what linear algebra NumPy lacks.

``scipy.linalg`` has the null space too, but takes a tenth of a second to import.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.errors import InputError, shown

Vector = NDArray[np.float64]
Array = NDArray[np.float64]
Rows = NDArray[np.intp]
Scalar = Callable[[Vector], float]


def finite_vector(argument: str, value: Any, *, of: Sequence[str] | None = None) -> Vector:
    """Return a list of finite numbers as an array, ``(n,)``.

    Args:
        argument: Name of the argument, for the message.
        value: The numbers: a sequence or an array.
        of: Name of each number. The default is any number of numbers.

    Raises:
        InputError: If the value is something else, or a number is missing.
    """
    try:
        found = np.asarray(value)
    except (TypeError, ValueError, RuntimeError, NotImplementedError):
        found = np.array(None)
    listed = found.ndim == 1 and (found.size == 0 or found.dtype.kind in "fiu")
    numbers = found.astype(np.float64) if listed else np.array([math.nan])
    if not np.all(np.isfinite(numbers)) or (of is not None and numbers.size != len(of)):
        wanted = "finite numbers" if of is None else f"{len(of)} finite numbers"
        names = "" if of is None else f" ({', '.join(of) or 'none'})"
        message = f"Argument `{argument}` must be a list of {wanted}{names}, but it is"
        raise InputError(f"{message} {shown(value)}.")
    return numbers


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

    Eigenvalues below rounding are zero. Their number is the number of directions that powers of the
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


def spectral_radius(values: Iterable[complex]) -> float:
    """Return the largest modulus of eigenvalues, 0 without one."""
    return float(max(map(abs, values), default=0.0))


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
