"""The fall of a guard inside a step: found where it is, and never at the start of the step."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from zeno_orbits.integrators import ExplicitStep, PlainFlow, Tolerance
from zeno_orbits.integrators.events import first_fall

LOCATED = 1e-14
"""A bracketing root finder stops a few roundings from the root; steps here have size 1 to 3."""


def _fall(
    guard: Callable[[float], float],
    guard_rate: Callable[[float], float],
    size: float,
    *,
    on_guard: bool = False,
    start: float = 0.0,
) -> float | None:
    """Return the first fall of a guard that is a function of time, in one step of a clock."""
    flow = PlainFlow(
        field=lambda y: np.ones_like(y),
        guard_and_rate=lambda y: (guard(float(y[0])), guard_rate(float(y[0]))),
    )
    before, after = np.array([start]), np.array([start + size])
    step = ExplicitStep(
        flow=flow, tolerance=Tolerance(), start=0.0, size=size, before=before, after=after
    )
    return first_fall(flow, step, flow.guard(before), flow.guard(after), on_guard=on_guard)


def test_a_plain_fall_is_found_where_it_is() -> None:
    assert _fall(lambda t: 0.3 - t, lambda _: -1.0, 1.0) == pytest.approx(0.3, abs=LOCATED)


def test_a_guard_that_stays_positive_gives_none() -> None:
    assert _fall(lambda t: 1.0 + t, lambda _: 1.0, 1.0) is None
    assert _fall(lambda t: 0.1 + (t - 0.5) ** 2, lambda t: 2 * (t - 0.5), 1.0) is None


def test_a_shallow_dip_costs_no_look_inside_the_step() -> None:
    asked: list[float] = []

    def guard(t: float) -> float:
        asked.append(t)
        return 1.0 + 0.1 * (t - 0.5) ** 2

    assert _fall(guard, lambda t: 0.2 * (t - 0.5), 1.0) is None
    # The two ends, which whoever takes the step has anyway.
    assert asked == [0.0, 1.0]


def test_the_guard_at_the_start_is_not_a_root() -> None:
    flight = _fall(lambda t: t * (0.7 - t), lambda t: 0.7 - 2 * t, 1.0, on_guard=True)
    assert flight == pytest.approx(0.7, abs=LOCATED)


def test_a_step_that_leaves_the_guard_upwards_has_no_fall() -> None:
    assert _fall(lambda t: t**3, lambda t: 3 * t**2, 1.0, on_guard=True) is None


@pytest.mark.parametrize("width", [0.3, 1e-2, 1e-5])
def test_a_dip_inside_one_step_is_found_at_its_first_root(width: float) -> None:
    # Negative only for |t - 0.53| < width, between the points that a coarse look would see.
    found = _fall(lambda t: (t - 0.53) ** 2 - width**2, lambda t: 2 * (t - 0.53), 1.0)
    # Near a shallow dip the rounding of the guard counts, divided by its slope there.
    assert found == pytest.approx(0.53 - width, abs=LOCATED + 2.0**-52 / width)


def test_a_guard_that_touches_zero_without_falling_gives_none() -> None:
    assert _fall(lambda t: (t - 0.5) ** 2, lambda t: 2 * (t - 0.5), 1.0) is None


def test_a_dip_right_after_the_start_counts_when_the_start_is_off_the_guard() -> None:
    found = _fall(lambda t: 1e-6 - t + t**2, lambda t: 2 * t - 1, 2.0)
    assert found == pytest.approx((1 - math.sqrt(1 - 4e-6)) / 2, abs=LOCATED)


def test_of_two_falls_in_one_step_the_first_counts() -> None:
    found = _fall(
        lambda t: math.cos(2 * math.pi * t) + 0.5,
        lambda t: -2 * math.pi * math.sin(2 * math.pi * t),
        1.4,
    )
    assert found == pytest.approx(1 / 3, abs=LOCATED)


def test_a_fall_at_the_very_end_of_the_step_is_found_now_or_at_the_next_step() -> None:
    ends_on_it = _fall(lambda t: 1.0 - t, lambda _: -1.0, 1.0)
    continues = _fall(lambda t: 1.0 - t, lambda _: -1.0, 1.0, start=1.0)
    assert 1.0 in (ends_on_it, None if continues is None else 1.0 + continues)


def test_a_start_on_the_guard_that_falls_at_once_has_no_root() -> None:
    assert _fall(lambda t: -t, lambda _: -1.0, 1.0, on_guard=True) is None


def test_a_fall_among_scaled_gaps_near_the_end_of_the_doubles_is_found() -> None:
    # A flight of 1 s after an impact at 1e-127: value times step size is beyond 1e308.
    far = 1e127
    found = _fall(lambda t: 1e254 * (0.3 - t / far), lambda _: -1e254 / far, far)
    assert found == pytest.approx(0.3 * far, rel=LOCATED)


def test_a_start_on_the_guard_that_rounding_puts_above_it_is_no_root_either() -> None:
    def guard(t: float) -> float:
        return 1e-17 - t

    assert _fall(guard, lambda _: -1.0, 1.0, on_guard=True) is None
    assert _fall(guard, lambda _: -1.0, 1.0) == pytest.approx(1e-17, abs=LOCATED)
