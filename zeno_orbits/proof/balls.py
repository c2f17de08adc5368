"""Balls: intervals, sizes, exact numbers, and matrices of them.

A ball of python-flint holds a real number for certain: what is done with balls is rounded outward.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from flint import arb, arb_mat

Ball = Any
"""A ball of python-flint, real or complex; it has no types to name."""
Matrix = Any
"""A matrix of real balls."""

ZERO, ONE = arb(0), arb(1)
UNIT = arb(0.5, 0.5)
"""The interval [0, 1]: times a ball, the hull of zero and the ball."""


def symmetric(x: Ball) -> Ball:
    """Return the least interval around zero that holds a ball."""
    return arb(0, x.abs_upper())


def joined(low: Ball, high: Ball) -> Ball:
    """Return the interval between the ends of two balls."""
    return low.union(high)


def size(x: Ball) -> float:
    """Return a double that no number of a ball exceeds in size."""
    return math.nextafter(float(x.abs_upper()), math.inf)


def middle(x: Ball) -> Ball:
    """Return the midpoint of a ball as the nearest double, exact."""
    return arb(float(x.mid()))


def half_width(x: Ball) -> Ball:
    """Return the radius of a ball, exact."""
    return x.rad()


def scaled(x: Ball, factor: float) -> Ball:
    """Return a ball of the same midpoint and a radius that is a multiple."""
    return x.mid() + arb(0, x.rad() * factor)


def within(inner: Ball, outer: Ball) -> bool:
    """Return True if a ball lies in the interior of another, or both are the same number.

    A ball that is not finite lies nowhere and holds nothing.
    """
    if not (inner.is_finite() and outer.is_finite()):
        return False
    if outer.is_exact():
        return inner.is_exact() and inner == outer
    return outer.contains_interior(inner)


def matrix(rows: Sequence[Sequence[Any]], n_columns: int) -> Matrix:
    """Return the matrix of some rows; it may have no columns.

    Args:
        rows: The rows.
        n_columns: Their length.
    """
    return arb_mat(len(rows), n_columns, [x for row in rows for x in row])


def identity(n: int) -> Matrix:
    """Return the identity, ``(n, n)``."""
    return arb_mat(n, n, [ONE if k % (n + 1) == 0 else ZERO for k in range(n * n)])


def column(x: Sequence[Ball]) -> Matrix:
    """Return a vector as a matrix of one column."""
    return arb_mat(len(x), 1, list(x))


def product(m: Matrix, x: Sequence[Ball]) -> list[Ball]:
    """Return a matrix times a vector."""
    return (m * column(x)).entries() if len(x) else [ZERO] * m.nrows()


def mapped(m: Matrix, function: Any) -> Matrix:
    """Return the matrix of a function of every entry."""
    return arb_mat(m.nrows(), m.ncols(), [function(x) for x in m.entries()])


def all_finite(balls: Iterable[Ball]) -> bool:
    """Return True if all balls are finite."""
    return all(x.is_finite() for x in balls)


def exact_text(x: Ball) -> str:
    """Return an exact number as the text ``-?0x<mantissa>p<+|-><exponent>``.

    Raises:
        ValueError: If the ball is not an exact number.
    """
    if not x.is_exact():
        raise ValueError(f"Argument `x` must be exact, but it is {x}.")
    mantissa, exponent = x.man_exp()
    return f"{int(mantissa):#x}p{int(exponent):+d}"
