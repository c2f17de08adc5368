"""The self-similar sequence that ends where the stop lets go, against a ball whose weight fades."""

from __future__ import annotations

import math

import pytest

from tests.reference.closed_forms import FadingBall
from zeno_orbits.continuation.separatrix import separatrix


def critical_speed(ball: FadingBall) -> float:
    """Return the speed above which the impacts of a ball do not accumulate, by bisection."""
    low, high = 0.0, 0.375 * ball.g**2 / ball.b
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if ball.zeno_time(middle) < math.inf else (low, middle)
    return low


@pytest.mark.parametrize("restitution", [0.05, 0.2, 0.417, 0.8])
def test_the_ratio_parts_balls_that_stay_from_balls_that_are_let_go(restitution: float) -> None:
    ball = FadingBall(g=2.0, b=0.7, restitution=restitution)
    # The closed form follows some 30 impacts; each doubles a rounding error at most twice.
    wanted = separatrix(restitution).ratio * ball.g**2 / ball.b
    assert critical_speed(ball) == pytest.approx(wanted, rel=1e-11)


@pytest.mark.parametrize("restitution", [0.2, 0.417, 0.8])
def test_what_is_left_of_the_lock_falls_with_the_exponent(restitution: float) -> None:
    law = separatrix(restitution)
    ball = FadingBall(g=1.0, b=1.0, restitution=restitution)
    distance = 1e-5

    def left(part: float) -> float:
        return 1.0 - ball.zeno_time(law.ratio * (1 - part))

    # By one factor of the repulsion nearer, the sequence has exactly one impact more: no log wave.
    # The next order of the law is the distance itself.
    fall = left(distance / law.repulsion) / left(distance)
    assert fall == pytest.approx(law.shrinking, rel=30 * distance)
    assert law.repulsion**-law.exponent == pytest.approx(law.shrinking, rel=1e-12)


def test_the_exponent_is_three_fifths_where_flights_are_averaged() -> None:
    # Theory (2.8): w a^(-1/3) + const a^(5/3) is kept, so a distance grows as a^(-5/3).
    assert separatrix(0.9999).exponent == pytest.approx(0.6, abs=1e-6)
    assert separatrix(0.9999).ratio == pytest.approx(0.3 * 1e-4, rel=1e-3)
