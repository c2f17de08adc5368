"""Balls in exact integers: a midpoint and a radius in units of ``2^-bits``, rounded outward.

Vectors and matrices are NumPy arrays of balls.
"""

from __future__ import annotations

import re
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, cast

import numpy as np

from zeno_orbits.errors import InputError, shortened
from zeno_orbits.work import enclosing_decimal

Array = Any
"""Balls in a NumPy array."""

_NUMBER = re.compile(r"(-?)0x([0-9a-f]{1,1000})p([+-]?[0-9]{1,4})")
_LARGEST = 512
"""Largest number of bits before the binary point of a number in a certificate."""


class NotProved(Exception):  # noqa: N818
    """A required inequality or inclusion does not hold in balls."""


@dataclass(frozen=True, slots=True)
class Ball:
    """All real numbers within ``r`` of ``m``, in units of ``2^-bits``.

    The operands of its operations may also be integers.
    """

    m: int
    r: int
    bits: int

    def _ball(self, other: Ball | int) -> Ball:
        return other if isinstance(other, Ball) else Ball(int(other) << self.bits, 0, self.bits)

    def __neg__(self) -> Ball:
        return Ball(-self.m, self.r, self.bits)

    def __add__(self, other: Ball | int) -> Ball:
        other = self._ball(other)
        return Ball(self.m + other.m, self.r + other.r, self.bits)

    def __sub__(self, other: Ball | int) -> Ball:
        return self + -self._ball(other)

    def __rsub__(self, other: Ball | int) -> Ball:
        return -self + other

    def __mul__(self, other: Ball | int) -> Ball:
        other = self._ball(other)
        m, r = self.m * other.m, abs(self.m) * other.r + self.r * other.size
        return Ball(*rounded(m, r, self.bits), self.bits)

    def __truediv__(self, other: Ball | int) -> Ball:
        return Ball(
            *quotient(self.m << self.bits, self.r << self.bits, self._ball(other)), self.bits
        )

    def __rtruediv__(self, other: Ball | int) -> Ball:
        return self._ball(other) / self

    __radd__, __rmul__ = __add__, __mul__

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

    def with_zero(self) -> Ball:
        """Return the hull of the ball and zero."""
        return between(min(0, self.low), max(0, self.high), self.bits)

    def ends(self) -> tuple[Fraction, Fraction]:
        """Return the ends as exact numbers."""
        return Fraction(self.low, 1 << self.bits), Fraction(self.high, 1 << self.bits)

    def shown(self) -> str:
        """Return a decimal interval that contains the ball."""
        return enclosing_decimal(*self.ends())


def between(low: int, high: int, bits: int) -> Ball:
    """Return a ball that contains the interval between two ends.

    Args:
        low: Lower end, in units.
        high: Upper end, in units.
        bits: The unit is ``2^-bits``.
    """
    return Ball((low + high) >> 1, (high - low + 1) >> 1, bits)


def rounded(m: int, r: int, bits: int) -> tuple[int, int]:
    """Return midpoint and radius in units of ``2^-bits``.

    Args:
        m: Midpoint in units of ``2^(-2 bits)``.
        r: Radius in the same.
        bits: The unit is ``2^-bits``.
    """
    middle = m >> bits
    return middle, -(-r >> bits) + (middle << bits != m)


def quotient(m: int, r: int, by: Ball) -> tuple[int, int]:
    """Return midpoint and radius of a quotient in units.

    Args:
        m: Midpoint of the dividend, in units of ``2^(-2 bits)``.
        r: Its radius in the same.
        by: The divisor.
    """
    least = abs(by.m) - by.r
    if least <= 0:
        raise NotProved(f"a divisor may be zero: {by.shown()}")
    middle = m // by.m
    return middle, -(-(r + abs(m - middle * by.m) + abs(middle) * by.r) // least)


def require(holds: bool, failure: str) -> None:
    """Raise `NotProved` unless a condition holds."""
    if not holds:
        raise NotProved(failure)


@contextmanager
def fitting_together() -> Generator[None]:
    """Raise an input error for data that do not have the structure of a certificate."""
    try:
        yield
    except InputError:
        raise
    except NotProved as failure:
        raise InputError(f"The certificate's problem cannot be proved: {failure}.") from None
    except (LookupError, TypeError, ValueError, ArithmeticError, AttributeError) as error:
        what = "an entry is missing or has the wrong type"
        raise InputError(f"The certificate is invalid: {what}.") from error
    except (RecursionError, MemoryError) as error:
        what = "its entries are nested too deeply, or too large"
        raise InputError(f"The certificate is invalid: {what}.") from error


sizes: Any = np.frompyfunc(lambda x: x.size, 1, 1)
"""Upper bounds of absolute values, in units."""
middles: Any = np.frompyfunc(lambda x: Ball(x.m, 0, x.bits), 1, 1)
around_zero: Any = np.frompyfunc(lambda x: Ball(0, x.size, x.bits), 1, 1)
"""Balls around zero with given bounds of the absolute value."""
with_zero: Any = np.frompyfunc(Ball.with_zero, 1, 1)
"""Hulls of balls and zero."""
exactly: Any = np.frompyfunc(lambda x, bits: Ball(int(x) << bits, 0, bits), 2, 1)


def linear_solution(matrix: Array, right: Array) -> Array:
    """Return an enclosure of all solutions of ``matrix X = right``, which also proves existence."""
    rows = np.concatenate([matrix, right], axis=1)
    for k in range(len(rows)):
        best = max(range(k, len(rows)), key=lambda i: abs(rows[i, k].m) - rows[i, k].r)
        rows[[k, best]] = rows[[best, k]]
        rows[k] = rows[k] / rows[k, k]
        for i in range(len(rows)):
            if i != k:
                rows[i] = rows[i] - rows[k] * rows[i, k]
    return rows[:, len(rows) :]


def number(text: Any, bits: int, *, exact: bool = True) -> Ball:
    """Return a number of a certificate.

    Args:
        text: The number as text.
        bits: The unit is ``2^-bits``.
        exact: True rejects a number that is not an integer multiple of the unit. False rounds it
            down, which is sound if the rounded number replaces the number everywhere.
    """
    found = _NUMBER.fullmatch(text) if isinstance(text, str) else None
    if found is None:
        raise InputError(f"The certificate has {str(text)[:40]!r} in place of a number.")
    mantissa, shift = int(found[1] + found[2], 16), int(found[3]) + bits
    if mantissa.bit_length() + int(found[3]) > _LARGEST:
        raise InputError(f"The certificate has a number of 2^{_LARGEST} or more.")
    units = mantissa << shift if shift >= 0 else mantissa >> -shift
    if exact and shift < 0 and units << -shift != mantissa:
        raise InputError(f"The certificate's {text[:40]!r} must be a multiple of 2^-{bits}.")
    return Ball(units, 0, bits)


def numbers(data: Any, shape: tuple[int, ...], bits: int, *, exact: bool = True) -> Array:
    """Return a list of numbers, or a nested list, of a certificate.

    Args:
        data: The list.
        shape: Length of the list, then of the lists in it.
        bits: The unit is ``2^-bits``.
        exact: As for one number.
    """
    if not shape:
        return number(data, bits, exact=exact)
    if not isinstance(data, list) or len(cast("list[Any]", data)) != shape[0]:
        raise InputError(f"The certificate must have a list of {shape[0]} here.")
    found = [numbers(part, shape[1:], bits, exact=exact) for part in cast("list[Any]", data)]
    return np.array(found, dtype=object).reshape(shape)


def radii(data: Any, shape: tuple[int, ...], bits: int, *, exact: bool = True) -> Array:
    """Return balls around zero with the radii of a certificate.

    Args:
        data: The radii.
        shape: Length of the list, then of the lists in it.
        bits: The unit is ``2^-bits``.
        exact: As for one number.
    """
    found = numbers(data, shape, bits, exact=exact)
    if any(x.m < 0 for x in found.ravel()):
        raise InputError("The certificate has a radius below zero.")
    return around_zero(found)


def entries(data: Any, *names: str) -> list[Any]:
    """Return the entries of an object of a certificate, which must have exactly these names."""
    if not isinstance(data, dict):
        raise InputError(f"The certificate must have an object with {', '.join(names)} here.")
    given = list(cast("dict[str, Any]", data))
    missing = [name for name in names if name not in given]
    if missing:
        raise InputError(f"The certificate lacks the entries {', '.join(missing)}.")
    if len(given) > len(names):
        extra = shortened(", ".join(name for name in given if name not in names))
        raise InputError(f"The certificate has unknown entries: {extra}. Remove them.")
    return [cast("dict[str, Any]", data)[name] for name in names]
