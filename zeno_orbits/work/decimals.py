"""Exact numbers as decimals, rounded outward for conclusions and inward for hypotheses.

All arithmetic uses Python's integers and fractions, without conversion to doubles. A printed number
is an exact decimal, so `fractions.Fraction` reads it back without rounding.
"""

from __future__ import annotations

from fractions import Fraction

_EXACT = 20
"""Largest number of significant digits with which an exact number is printed in full."""
_LONGEST = 1000
"""Largest number of significant digits of a midpoint. Beyond it, the radius is enlarged."""
_POSITIONAL = range(-5, 16)
"""Range of decimal exponents for numbers that are printed without an exponent."""


def enclosing_decimal(low: Fraction, high: Fraction) -> str:
    """Return an interval as ``midpoint +- radius`` that contains it.

    The radius has two digits and is rounded up. The midpoint ends at the last digit of the radius.
    The radius includes the rounding error of the midpoint.

    Args:
        low: Lower end.
        high: Upper end, not below the lower end.
    """
    middle, place = (low + high) / 2, _place(low, high)
    if place is None:
        return f"{_exact_text(low)} +- 0"
    while True:
        unit = _power(place)
        m = round(middle / unit)
        r = _ceiling(max(high - m * unit, m * unit - low) / unit)
        if r < 100:
            return f"{_text(m, place)} +- {_text(r, place)}"
        place += 1


def enclosed_decimal(low: Fraction, high: Fraction) -> str:
    """Return an interval as ``midpoint +- radius`` that lies in it.

    The radius has about three digits and is rounded down. The midpoint ends at the last digit of
    the radius.

    Args:
        low: Lower end.
        high: Upper end, not below the lower end. If both are equal, they are binary fractions.
    """
    if low == high:
        return f"{exact_decimal(low)} +- 0"
    place = _exponent((high - low) / 2) - 2
    unit = _power(place)
    m = round((low + high) / 2 / unit)
    r = min(high - m * unit, m * unit - low) // unit
    return f"{_text(m, place)} +- {_text(r, place)}"


def decimal_between(low: Fraction, high: Fraction, lowest: Fraction, highest: Fraction) -> str:
    """Return an interval as ``midpoint +- radius`` that contains one interval inside another.

    It has as few digits as the space between both intervals allows, and at least two.

    Args:
        low: Lower end of the inner interval.
        high: Its upper end, not below the lower end.
        lowest: Lower end of the outer interval, below `low`.
        highest: Its upper end, above `high`.
    """
    if not lowest < low <= high < highest:
        raise ValueError("Argument `lowest` and `highest` must contain the inner interval.")
    place = _place(low, high)
    if place is None:
        return f"{_exact_text(low)} +- 0"
    while True:
        unit = _power(place)
        m = round((low + high) / 2 / unit)
        r = _ceiling(max(high - m * unit, m * unit - low) / unit)
        if lowest <= (m - r) * unit and (m + r) * unit <= highest:
            return f"{_text(m, place)} +- {_text(r, place)}"
        place -= 1


def enclosing_disc(re: Fraction, im: Fraction, radius: Fraction) -> str:
    """Return a disc of the complex plane as ``re + im i +- radius`` that contains it.

    Args:
        re: Real part of the centre.
        im: Imaginary part of the centre.
        radius: Radius of the disc.
    """
    place = _place(min(re, im) - radius, max(re, im) + radius) if not radius else None
    place = _exponent(radius) - 1 if radius else place
    if place is None:
        return f"{_complex_text(_exact_text(re), _exact_text(im))} +- 0"
    while True:
        unit = _power(place)
        x, y = round(re / unit), round(im / unit)
        # A shift of the centre by (a, b) moves every point by at most |a| + |b|.
        r = _ceiling((radius + abs(re - x * unit) + abs(im - y * unit)) / unit)
        if r < 100:
            return f"{_complex_text(_text(x, place), _text(y, place))} +- {_text(r, place)}"
        place += 1


def decimal_above(x: Fraction, digits: int = 2) -> str:
    """Return a number rounded up to a decimal of a given number of significant digits.

    Args:
        x: The number.
        digits: Number of significant digits.
    """
    if not x:
        return "0"
    place = _exponent(x) - digits + 1
    return _text(_ceiling(x / _power(place)), place)


def decimal_below(x: Fraction, digits: int = 2) -> str:
    """Return a number rounded down to a decimal of a given number of significant digits.

    Args:
        x: The number.
        digits: Number of significant digits.
    """
    above = decimal_above(-x, digits)
    return above[1:] if above.startswith("-") else "0" if above == "0" else f"-{above}"


def exact_decimal(x: Fraction) -> str:
    """Return all digits of an integer divided by a power of two.

    Args:
        x: The number.
    """
    shift = x.denominator.bit_length() - 1
    if x.denominator != 1 << shift:
        raise ValueError(f"Argument `x` must be a binary fraction, but it is {x}.")
    return _text(x.numerator * 5**shift, -shift)


def _place(low: Fraction, high: Fraction) -> int | None:
    """Return the decimal exponent of a half width's second digit, or None for an exact number."""
    size = max(abs(low), abs(high))
    if low > high:
        raise ValueError("Argument `high` must not be below `low`.")
    if low < high:
        return max(_exponent((high - low) / 2) - 1, _exponent(size) - _LONGEST)
    if not low:
        return None
    place = _exponent(low) - _EXACT + 1
    return None if (low / _power(place)).denominator == 1 else place


def _exact_text(x: Fraction) -> str:
    if not x:
        return "0"
    place = _exponent(x) - _EXACT + 1
    while place < 0 and (x / _power(place + 1)).denominator == 1:
        place += 1
    return _text(int(x / _power(place)), place)


def _complex_text(re: str, im: str) -> str:
    if im == "0":
        return re
    return f"{re} - {im[1:]} i" if im.startswith("-") else f"{re} + {im} i"


def _ceiling(x: Fraction) -> int:
    return -(-x.numerator // x.denominator)


def _power(exponent: int) -> Fraction:
    return Fraction(10) ** exponent


def _exponent(x: Fraction) -> int:
    """Return ``k`` with ``10^k <= |x| < 10^(k + 1)``."""
    # The bit lengths determine it up to one. The comparison is exact.
    bits = abs(x.numerator).bit_length() - x.denominator.bit_length()
    k = bits * 30103 // 100000 - 2
    while _power(k + 1) <= abs(x):
        k += 1
    return k


def _text(units: int, place: int) -> str:
    """Return ``units 10^place`` exactly, with all digits up to a negative exponent."""
    if not units:
        return "0"
    sign, digits = "-" if units < 0 else "", str(abs(units))
    exponent = len(digits) - 1 + place
    if place > 0 or exponent not in _POSITIONAL:
        behind = f".{digits[1:]}" if digits[1:] else ""
        return f"{sign}{digits[0]}{behind}e{exponent}"
    if not place:
        return sign + digits
    digits = digits.rjust(1 - place, "0")
    return f"{sign}{digits[:place]}.{digits[place:]}"
