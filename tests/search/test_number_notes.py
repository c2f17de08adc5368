"""What a search says of its numbers: a mistaken unit, an end of a range."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.search import at_ends, far_from_own, free_gains

R = SimpleNamespace(name="R", unit="ohm", default=2.0, lower=0.0, upper=10.0)
E = SimpleNamespace(name="e", unit="1", default=-1e-4, lower=-1.0, upper=1.0)
PROBLEM: Any = SimpleNamespace(quantities=(R, E), quantity=lambda name: {"R": R, "e": E}[name])


def _values(r: float = 2.0, e: float = -1e-4) -> ParameterValues:
    return ParameterValues(gains={"R": r}, parameters={"e": e})


def test_all_gains_are_free_but_those_that_are_held(problem: Problem) -> None:
    ranges = {gain.name: (gain.lower, gain.upper) for gain in problem.gains}
    assert list(ranges) == ["Kp", "Kd"]
    assert free_gains(problem) == ranges
    assert free_gains(problem, ["Kp"]) == {"Kd": ranges["Kd"]}


@pytest.mark.parametrize(
    ("given", "times"),
    [(200.0, "100"), (-200.0, "100"), (0.02, "0.01"), (2e4, "1e+04")],
)
def test_a_number_a_hundred_times_off_is_asked_for_its_unit(given: float, times: str) -> None:
    (told,) = far_from_own(PROBLEM, _values(r=given))
    assert told.startswith(f"`R` is {given:g} ohm, {times} times the problem's own 2 ohm:")


@pytest.mark.parametrize("given", [199.0, -199.0, 0.0201, 2.0, 0.0])
def test_a_number_less_than_a_hundred_times_off_is_not(given: float) -> None:
    assert far_from_own(PROBLEM, _values(r=given)) == []


def test_a_number_without_a_unit_is_told_without_one_and_every_number_is_looked_at() -> None:
    first, second = far_from_own(PROBLEM, _values(r=0.01, e=0.5))
    assert first.startswith("`R` is 0.01 ohm")
    assert second.startswith("`e` is 0.5, 5000 times the problem's own -0.0001: ")


def test_nothing_is_far_from_an_own_number_of_zero() -> None:
    zero: Any = SimpleNamespace(quantities=(SimpleNamespace(name="R", unit="ohm", default=0.0), E))
    assert len(far_from_own(zero, _values(r=50.0, e=1.0))) == 1


@pytest.mark.parametrize(
    ("value", "end"),
    [
        (0.0, "lower"),
        (1e-5, "lower"),
        (1.5e-5, ""),
        (0.5, ""),
        (1.0 - 1.5e-5, ""),
        # A solver of interior points stopped 2e-6 of the range before its end.
        (1.0 - 2e-6, "upper"),
    ],
)
def test_a_number_is_at_an_end_within_the_reach_of_a_solver(value: float, end: str) -> None:
    told = at_ends(PROBLEM, _values(r=value), {"R": (0.0, 1.0)}, {})
    assert len(told) == bool(end)
    assert all(f"is the {end} end of" in one for one in told)


def test_the_part_is_one_of_the_range() -> None:
    free = {"R": (2.0, 102.0)}
    assert at_ends(PROBLEM, _values(r=2.0009), free, {})
    assert not at_ends(PROBLEM, _values(r=2.0011), free, {})


@pytest.mark.parametrize(
    ("free", "whose"),
    [
        ((0.0, 5.0), "`R` = 0 is the lower end of the problem's own range 0:5"),
        ((2.0, 5.0), "`R` = 2 is the lower end of its range 2:5"),
        ((2.0, 10.0), "`R` = 10 is the upper end of the problem's own range 2:10"),
        ((0.0, 9.0), "`R` = 9 is the upper end of its range 0:9"),
    ],
)
def test_an_end_is_one_of_the_problem_or_of_the_search(
    free: tuple[float, float], whose: str
) -> None:
    value = free["upper" in whose]
    (told,) = at_ends(PROBLEM, _values(r=value), {"R": free}, {"e": value})
    assert told.startswith(f"{whose}: ")


def test_what_is_asked_for_is_passed_over_and_the_next_number_told() -> None:
    free = {"R": (2.0, 5.0), "e": (0.0, 0.5)}
    (told,) = at_ends(PROBLEM, _values(r=2.0, e=0.5), free, {"R": 2.0, "e": 0.6})
    assert told.startswith("`e` = 0.5 is the upper end")
