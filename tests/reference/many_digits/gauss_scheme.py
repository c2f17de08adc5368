r"""Gauss's collocation as matrices, in numbers of any length [HairerWanner1996]_, IV.5."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from flint import arb, arb_mat, ctx

from zeno_orbits.arrays import Array

Real = Any
"""A number of many digits, a ball of radius zero."""

_SPARE_BITS = 64
"""Bits that the nodes are computed with beyond those of the numbers."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GaussScheme:
    """The collocation at Gauss's nodes on ``[0, 1]``, in the length of numbers it was made in.

    Attributes:
        nodes: Stage positions, ``(s,)``.
        matrix: ``a``, and ``b`` as its last row, ``(s + 1, s)``.
        coarse: The same in doubles.
        bernstein: From values at the nodes to coefficients in Bernstein's basis, ``(s, s)``.
        tails: From values at the nodes to the last two Legendre coefficients, ``(2, s)``.
    """

    nodes: list[Real]
    matrix: Any
    coarse: Array
    bernstein: Any
    tails: Any


@lru_cache
def gauss_scheme(s: int, bits: int) -> GaussScheme:
    r"""Return the scheme of `s` stages in numbers of a length.

    With Legendre's polynomials :math:`P_k` on ``[-1, 1]`` and :math:`\int_{-1}^{x} P_k =
    (P_{k+1}(x) - P_{k-1}(x)) / (2 k + 1)`.
    """
    with ctx.workprec(bits + _SPARE_BITS):
        pairs = [arb.legendre_p_root(s, k, weight=True) for k in range(s)][::-1]
        values = [_legendre(x, s) for x, _ in [*pairs, (arb(1), 0)]]
        modes = [
            [(2 * k + 1) * w * p[k] / 2 for (_, w), p in zip(pairs, values, strict=False)]
            for k in range(s)
        ]
        integrals = [
            [(p[1] + 1) / 2, *((p[k + 1] - p[k - 1]) / (4 * k + 2) for k in range(1, s))]
            for p in values
        ]
        matrix = _matrix(integrals) * _matrix(modes)
        nodes = [(1 + x) / 2 for x, _ in pairs]
        basis = [
            [math.comb(s - 1, k) * x**k * (1 - x) ** (s - 1 - k) for k in range(s)] for x in nodes
        ]
        return GaussScheme(
            nodes=[x.mid() for x in nodes],
            matrix=matrix.mid(),
            coarse=double_rows(matrix),
            bernstein=_matrix(basis).inv().mid(),
            tails=_matrix(modes[-2:]).mid(),
        )


def _legendre(x: Real, n: int) -> list[Real]:
    found = [arb(1), x]
    for k in range(1, n):
        found.append(((2 * k + 1) * x * found[k] - k * found[k - 1]) / (k + 1))
    return found


def _matrix(rows: Sequence[Sequence[Real]]) -> Any:
    return ball_rows(len(rows), [x for row in rows for x in row])


def ball_rows(n_rows: int, entries: Iterable[Real]) -> Any:
    """Return the matrix of some rows with these entries, row by row."""
    listed = list(entries)
    return arb_mat(n_rows, len(listed) // n_rows, listed)


def double_rows(matrix: Any) -> Array:
    """Return a matrix in doubles."""
    return np.array([[float(x) for x in row] for row in matrix.table()])
