"""Balls in exact integers: a midpoint and a radius in units of ``2^-bits``, rounded outward."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import isqrt
from typing import Any, cast

from zeno_orbits.errors import InputError

_NUMBER = re.compile(r"(-?)0x([0-9a-f]+)p([+-]?[0-9]{1,5})")


Vector = list["Ball"]
Matrix = list[list["Ball"]]


class NotProved(Exception):  # noqa: N818
    """An inequality or an inclusion that was to be shown does not hold in balls."""


@dataclass(frozen=True, slots=True)
class Ball:
    """All reals within ``r`` of ``m``, both in units of ``2^-bits``."""

    m: int
    r: int
    bits: int

    def __add__(self, other: Ball) -> Ball:
        return Ball(self.m + other.m, self.r + other.r, self.bits)

    def __sub__(self, other: Ball) -> Ball:
        return Ball(self.m - other.m, self.r + other.r, self.bits)

    def __neg__(self) -> Ball:
        return Ball(-self.m, self.r, self.bits)

    def __mul__(self, other: Ball) -> Ball:
        return dot((self,), (other,))

    def __truediv__(self, other: Ball) -> Ball:
        return Ball(*quotient(self.m << self.bits, self.r << self.bits, other), self.bits)

    @property
    def low(self) -> int:
        """Lower end."""
        return self.m - self.r

    @property
    def high(self) -> int:
        """Upper end."""
        return self.m + self.r

    @property
    def size(self) -> int:
        """Upper bound of the absolute value."""
        return abs(self.m) + self.r

    def fraction(self, part: int) -> Ball:
        """Return the ball divided by a positive whole number."""
        return Ball(self.m // part, -(-self.r // part) + 1 if self.m or self.r else 0, self.bits)

    def with_zero(self) -> Ball:
        """Return the hull of the ball and zero."""
        return between(min(0, self.low), max(0, self.high), self.bits)

    def shown(self) -> str:
        """Return the ball as text."""
        return f"{scaled(self.m, self.bits):.17g} +- {scaled(self.r, self.bits):.2g}"


def scaled(units: int, bits: int) -> float:
    """Return about how much a number of units is."""
    excess = max(0, units.bit_length() - 64)
    return float(units >> excess) * 2.0 ** (excess - bits)


def between(low: int, high: int, bits: int) -> Ball:
    """Return a ball that holds all from ``low`` to ``high``, in units."""
    return Ball((low + high) >> 1, (high - low + 1) >> 1, bits)


def rounded(m: int, r: int, bits: int) -> tuple[int, int]:
    """Return midpoint and radius in units, from units of ``2^(-2 bits)``."""
    middle = m >> bits
    return middle, -(-r >> bits) + (middle << bits != m)


def quotient(m: int, r: int, by: Ball) -> tuple[int, int]:
    """Return midpoint and radius of ``(m, r) / by``, the first in units of ``2^(-2 bits)``."""
    least = abs(by.m) - by.r
    if least <= 0:
        raise NotProved(f"a divisor may be zero: {by.shown()}")
    middle = m // by.m
    return middle, -(-(r + abs(m - middle * by.m) + abs(middle) * by.r) // least)


def dot(a: Sequence[Ball], b: Sequence[Ball]) -> Ball:
    """Return the scalar product of two vectors, rounded once."""
    m = sum(x.m * y.m for x, y in zip(a, b, strict=True))
    r = sum(abs(x.m) * y.r + x.r * y.size for x, y in zip(a, b, strict=True))
    return Ball(*rounded(m, r, a[0].bits), a[0].bits)


def times(a: Matrix, b: Matrix) -> Matrix:
    """Return the product of two matrices; one without columns stays so."""
    columns = list(zip(*b, strict=True))
    return [[dot(row, column) for column in columns] for row in a]


def added(a: Matrix, b: Matrix) -> Matrix:
    """Return the sum of two matrices."""
    return [[x + y for x, y in zip(p, q, strict=True)] for p, q in zip(a, b, strict=True)]


def middles(a: Matrix) -> Matrix:
    """Return the midpoints of a matrix."""
    return [[Ball(x.m, 0, x.bits) for x in row] for row in a]


def identity(n: int, bits: int) -> Matrix:
    """Return the identity matrix, exactly."""
    return [[Ball(int(i == j) << bits, 0, bits) for j in range(n)] for i in range(n)]


def require(holds: bool, failure: str) -> None:
    """Refuse what does not hold."""
    if not holds:
        raise NotProved(failure)


def solved(matrix: Matrix, right: Matrix) -> Matrix:
    """Return a set that holds all solutions of ``matrix X = right``; it proves there is one."""
    rows = [[*left, *entries] for left, entries in zip(matrix, right, strict=True)]
    for k in range(len(rows)):
        best = max(range(k, len(rows)), key=lambda i: abs(rows[i][k].m) - rows[i][k].r)
        rows[k], rows[best] = rows[best], rows[k]
        rows[k] = [entry / rows[k][k] for entry in rows[k]]
        for i, row in enumerate(rows):
            if i != k and row[k].size:
                rows[i] = [x - row[k] * y for x, y in zip(row, rows[k], strict=True)]
    return [row[len(rows) :] for row in rows]


def modulus(re_part: Ball, im_part: Ball) -> int:
    """Return an upper bound of the absolute value of a complex number, in units."""
    return isqrt(re_part.size**2 + im_part.size**2) + 1


def number(text: Any, bits: int, *, exact: bool = True) -> Ball:
    """Return a number of a certificate.

    Args:
        text: The number as text.
        bits: The unit is ``2^-bits``.
        exact: Refuse a number that is no whole of units; else it is rounded down to one, which is
            sound where the rounded number takes the place of the number everywhere.
    """
    found = _NUMBER.fullmatch(text) if isinstance(text, str) else None
    if found is None:
        raise InputError(f"The certificate has {str(text)[:40]!r} where a number must be.")
    mantissa, shift = int(found[1] + found[2], 16), int(found[3]) + bits
    units = mantissa << shift if shift >= 0 else mantissa >> -shift
    if exact and shift < 0 and units << -shift != mantissa:
        raise InputError(f"The certificate's {text[:40]!r} must be a multiple of 2^-{bits}.")
    return Ball(units, 0, bits)


def entries(data: Any, *names: str) -> list[Any]:
    """Return the entries of an object of a certificate, which has these and no others."""
    if not isinstance(data, dict) or set(cast("dict[str, Any]", data)) != set(names):
        raise InputError(f"The certificate must have an object with {', '.join(names)} here.")
    return [cast("dict[str, Any]", data)[name] for name in names]


def vector(data: Any, n: int, bits: int, *, exact: bool = True) -> Vector:
    """Return a list of numbers of a certificate, ``(n,)``."""
    if not isinstance(data, list) or len(cast("list[Any]", data)) != n:
        raise InputError(f"The certificate must have a list of {n} here.")
    return [number(text, bits, exact=exact) for text in cast("list[Any]", data)]


def matrix(data: Any, n: int, columns: int, bits: int) -> Matrix:
    """Return a list of rows of numbers rounded down to units, ``(n, columns)``."""
    if not isinstance(data, list) or len(cast("list[Any]", data)) != n:
        raise InputError(f"The certificate must have a matrix of {n} rows here.")
    return [vector(row, columns, bits, exact=False) for row in cast("list[Any]", data)]


def around_zero(bounds: Vector) -> Vector:
    """Return balls around zero of given radii."""
    if any(bound.m < 0 for bound in bounds):
        raise InputError("The certificate has a radius below zero.")
    return [Ball(0, bound.m, bound.bits) for bound in bounds]
