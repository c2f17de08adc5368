"""Printed intervals contain those that are printed: read back as exact fractions."""

from __future__ import annotations

import random
from fractions import Fraction

import pytest

from zeno_orbits.work import (
    decimal_above,
    decimal_below,
    decimal_between,
    enclosed_decimal,
    enclosing_decimal,
    enclosing_disc,
    exact_decimal,
)


def _read(text: str) -> tuple[Fraction, Fraction]:
    """Return the ends of a printed interval."""
    middle, radius = (Fraction(part) for part in text.split(" +- "))
    return middle - radius, middle + radius


def _random_ball(chance: random.Random) -> tuple[Fraction, Fraction]:
    scale = Fraction(2) ** chance.randint(-1000, 1000)
    middle = Fraction(chance.randint(-(2**90), 2**90)) * scale
    width = Fraction(chance.randint(0, 2**60)) * Fraction(2) ** chance.randint(-400, 90)
    return middle, middle + width * scale * chance.choice([0, 1, 1, 1])


NUMBERS = pytest.mark.parametrize(
    "count", [1000, pytest.param(10_000, marks=pytest.mark.slow)], ids=lambda count: f"{count}"
)


@NUMBERS
def test_no_random_ball_is_outside_of_what_is_printed(count: int) -> None:
    chance, wide = random.Random(1), 0
    for _ in range(count):
        low, high = _random_ball(chance)
        a, b = _read(enclosing_decimal(low, high))
        assert a <= low <= high <= b
        # Two digits cost at most a tenth, and the midpoint's rounding a twentieth.
        wide += low < high and (b - a) > (high - low) * Fraction(6, 5)
    assert wide == 0


@pytest.mark.slow
def test_each_of_10_000_printed_hypotheses_is_part_of_its_ball() -> None:
    chance, narrow = random.Random(3), 0
    for _ in range(10_000):
        low, high = _random_ball(chance)
        a, b = _read(enclosed_decimal(low, high))
        assert low <= a <= b <= high
        narrow += (b - a) < (high - low) * Fraction(97, 100)
    assert narrow == 0


@pytest.mark.slow
def test_none_of_10_000_random_discs_is_outside_of_what_is_printed() -> None:
    chance = random.Random(2)
    for _ in range(10_000):
        (x, _), (y, other) = _random_ball(chance), _random_ball(chance)
        r = other - y
        text = enclosing_disc(x, y, r)
        middle, radius = text.rsplit(" +- ", 1)
        re, _, im = middle.replace(" - ", " + -").removesuffix(" i").partition(" + ")
        a, b = Fraction(re) - x, Fraction(im or 0) - y
        room = Fraction(radius) - r
        assert room >= 0
        assert a * a + b * b <= room * room


@NUMBERS
def test_no_one_sided_bound_is_on_the_wrong_side(count: int) -> None:
    chance = random.Random(3)
    for _ in range(count):
        x, digits = _random_ball(chance)[0], chance.randint(1, 20)
        assert Fraction(decimal_below(x, digits)) <= x <= Fraction(decimal_above(x, digits))


@pytest.mark.parametrize(
    ("low", "high", "text"),
    [
        (Fraction(0), Fraction(0), "0 +- 0"),
        (Fraction(5, 2), Fraction(5, 2), "2.5 +- 0"),
        (Fraction(-1, 1000), Fraction(1, 1000), "0 +- 0.0010"),
        (Fraction(1, 3), Fraction(1, 3), "0.33333333333333333333 +- 1e-20"),
        (Fraction(10**30), Fraction(3 * 10**30), "2.0e30 +- 1.0e30"),
        (Fraction(1500), Fraction(1500), "1500 +- 0"),
        (Fraction(1000), Fraction(1500), "1.25e3 +- 2.5e2"),
        (Fraction(1, 10**30), Fraction(3, 10**30), "2.0e-30 +- 1.0e-30"),
        (Fraction(-995, 10**6), Fraction(1004, 10**6), "0 +- 0.0011"),
        (Fraction(19999, 10**4), Fraction(20001, 10**4), "2.00000 +- 0.00010"),
    ],
)
def test_special_intervals_are_printed_as(low: Fraction, high: Fraction, text: str) -> None:
    assert enclosing_decimal(low, high) == text
    a, b = _read(text)
    assert a <= low <= high <= b


def test_the_period_of_a_shaken_problem_contains_two_pi() -> None:
    # Fifty digits of 2 pi [DLMF 3.12.1], cut off.
    turn = Fraction("6.28318530717958647692528676655900576839433879875021")
    tight = Fraction(1, 10**21)
    text = enclosing_decimal(turn - tight, turn + tight)
    assert text == "6.2831853071795864769253 +- 1.1e-21"
    a, b = _read(text)
    assert a <= turn - tight < turn + tight <= b


def test_a_double_has_all_its_digits() -> None:
    assert exact_decimal(Fraction(0.1)) == (
        "0.1000000000000000055511151231257827021181583404541015625"
    )
    assert Fraction(exact_decimal(Fraction(-2.5e-8))) == Fraction(-2.5e-8)
    with pytest.raises(ValueError, match="binary fraction"):
        exact_decimal(Fraction(1, 3))


def test_an_interval_that_is_none_is_refused() -> None:
    with pytest.raises(ValueError, match="must not be below"):
        enclosing_decimal(Fraction(1), Fraction(0))


def test_a_decimal_between_two_intervals_contains_one_and_lies_in_the_other() -> None:
    chance = random.Random(4)
    for number in range(400):
        low, high = _random_ball(chance)
        room = (high - low + Fraction(1, 10**9)) / Fraction(10) ** (number % 12)
        a, b = _read(decimal_between(low, high, low - room, high + room))
        assert low - room <= a <= low <= high <= b <= high + room
    with pytest.raises(ValueError, match="must contain"):
        decimal_between(Fraction(0), Fraction(1), Fraction(0), Fraction(2))
