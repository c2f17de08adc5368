"""Balls: intervals, sizes, exact numbers, and their matrices.

A ball of python-flint contains a real number with certainty: every operation rounds outward.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from fractions import Fraction
from typing import Any

from flint import arb, arb_mat, fmpz

Ball = Any
"""A ball of python-flint, real or complex. The library does not declare a type for annotations."""
Matrix = Any
"""A matrix of real balls."""

ZERO, ONE = arb(0), arb(1)
UNIT = arb(0.5, 0.5)
"""The interval [0, 1]. Its product with a ball is the hull of zero and the ball."""


def symmetric(x: Ball) -> Ball:
    """Return the smallest interval around zero that contains a ball."""
    return arb(0, x.abs_upper())


def joined(low: Ball, high: Ball) -> Ball:
    """Return the interval from the lower end of a ball to the upper end of another ball."""
    return low.union(high)


def size(x: Ball) -> float:
    """Return an upper bound of the absolute values of a ball, as a double."""
    return math.nextafter(float(x.abs_upper()), math.inf)


def middle(x: Ball) -> Ball:
    """Return the midpoint of a ball, rounded to the nearest double, as an exact ball."""
    return arb(float(x.mid()))


def on_grid(x: Ball) -> Ball:
    """Return the multiple of ``2^-190`` nearest to the midpoint of a ball, as an exact ball.

    Numbers of a certificate have a fixed unit. A midpoint near zero would have bits far below it.
    """
    mantissa, exponent = x.mid().man_exp()
    below = -_GRID_BITS - int(exponent)
    if below <= 0:
        return x.mid()
    whole = (int(mantissa) + (1 << (below - 1))) >> below
    return arb(fmpz(whole)) * arb(2) ** -_GRID_BITS


_GRID_BITS = 190


def half_width(x: Ball) -> Ball:
    """Return the radius of a ball as an exact ball."""
    return x.rad()


def scaled(x: Ball, factor: float) -> Ball:
    """Return a ball with the same midpoint and a multiple of the radius."""
    return x.mid() + arb(0, x.rad() * factor)


def within(inner: Ball, outer: Ball) -> bool:
    """Return True if a ball lies in the interior of another ball, or both are the same number.

    The result is False if a ball is not finite.
    """
    if not (inner.is_finite() and outer.is_finite()):
        return False
    if outer.is_exact():
        return inner.is_exact() and inner == outer
    return outer.contains_interior(inner)


def matrix(rows: Sequence[Sequence[Any]], n_columns: int) -> Matrix:
    """Return the matrix of given rows, whose length may be zero.

    Args:
        rows: The rows.
        n_columns: Length of the rows.
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
    """Apply a function to every entry of a matrix."""
    return arb_mat(m.nrows(), m.ncols(), [function(x) for x in m.entries()])


def all_finite(balls: Iterable[Ball]) -> bool:
    """Return True if all balls are finite."""
    return all(x.is_finite() for x in balls)


def exact_fraction(x: Ball) -> Fraction:
    """Return an exact number as a fraction."""
    mantissa, exponent = x.man_exp()
    return Fraction(int(mantissa)) * Fraction(2) ** int(exponent)


def fraction_text(x: Fraction) -> str:
    """Return an integer divided by a power of two in the format of `exact_text`."""
    exponent = x.denominator.bit_length() - 1
    return f"{x.numerator:#x}p{-exponent:+d}"


def exact_text(x: Ball) -> str:
    """Return an exact number as the text ``-?0x<mantissa>p<+|-><exponent>``.

    Raises:
        ValueError: If the ball is not an exact number.
    """
    if not x.is_exact():
        raise ValueError(f"Argument `x` must be exact, but it is {x}.")
    mantissa, exponent = x.man_exp()
    return f"{int(mantissa):#x}p{int(exponent):+d}"
