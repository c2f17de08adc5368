"""A block against a wall under sampled ground motion, by Runge and Kutta's method of order four.

Between two samples the ground acceleration is a line. The steps are short and of equal length
between two samples. An impact is a root of the angle in the length of its step. Impacts slower than
``SLOW`` are replaced by the sum of their geometric series. The block rests until the ground lifts
it, at a time in closed form.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

SLOW = 1e-11
"""Speed of an impact from which on the acceleration is constant [rad/s]."""


Moved = Callable[[float, float, float, float], tuple[float, float]]
"""From time, angle, rate and length of a step to angle and rate after it."""


@dataclass(slots=True)
class Rocking:
    """Times of impacts, ends of bouncing and lifts."""

    impacts: list[float] = field(default_factory=list)
    zeno_points: list[float] = field(default_factory=list)
    lifts: list[float] = field(default_factory=list)


def rocking_by_hand(
    times: np.ndarray,
    ground: np.ndarray,
    *,
    radius: float,
    slenderness: float,
    gravity: float,
    restitution: float,
    longest: float,
) -> Rocking:
    """Return the events of a block that starts at rest on its base.

    Args:
        times: Times of the samples, the last one the end.
        ground: Ground acceleration at these times.
        radius: Half of the diagonal [m].
        slenderness: Angle between the diagonal and the vertical [rad].
        gravity: Gravity [m/s^2].
        restitution: Coefficient of restitution.
        longest: Longest step [s].
    """
    square = 3.0 * gravity / (4.0 * radius)
    found = Rocking()
    angle, rate, rests = 0.0, 0.0, True
    lift_at = -gravity * math.tan(slenderness)

    for begin, end, low, high in zip(times[:-1], times[1:], ground[:-1], ground[1:], strict=True):
        slope = (high - low) / (end - begin)

        def bent(t: float, q: float, a: float = low, b: float = begin, s: float = slope) -> float:
            lean = slenderness - q
            return -square * (math.sin(lean) + (a + s * (t - b)) / gravity * math.cos(lean))

        def moved(t: float, q: float, v: float, h: float) -> tuple[float, float]:
            a1 = bent(t, q)
            a2 = bent(t + h / 2, q + h / 2 * v)
            a3 = bent(t + h / 2, q + h / 2 * v + h * h / 4 * a1)
            a4 = bent(t + h, q + h * v + h * h / 2 * a2)
            return q + h * v + h * h / 6 * (a1 + a2 + a3), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)

        n = math.ceil((end - begin) / longest)
        marks = np.linspace(begin, end, n + 1)
        t = float(begin)
        while t < end:
            if rests:
                lifted = t if bent(t, 0.0) > 0.0 else _crossing(t, end, low, begin, slope, lift_at)
                if lifted is None:
                    break
                found.lifts.append(lifted)
                t, angle, rate, rests = lifted, 0.0, 0.0, False
                if t >= end:
                    break
            mark = float(marks[np.searchsorted(marks, t, side="right")])
            h = mark - t
            after, speed = moved(t, angle, rate, h)
            if after > 0.0:
                t, angle, rate = mark, after, speed
                continue
            h = _landing(moved, t, angle, rate, h)
            _, speed = moved(t, angle, rate, h)
            t, angle, rate = t + h, 0.0, -restitution * speed
            found.impacts.append(t)
            if rate < SLOW:
                tail = 2.0 * rate / -bent(t, 0.0) / (1.0 - restitution)
                t += tail
                found.zeno_points.append(t)
                rate, rests = 0.0, True
    return found


def _crossing(
    t: float, end: float, low: float, begin: float, slope: float, level: float
) -> float | None:
    """Return the time at which a falling line reaches a level before the end, or nothing."""
    if slope >= 0.0:
        return None
    at = begin + (level - low) / slope
    return at if t <= at < end else None


def _landing(moved: Moved, t: float, q: float, v: float, h: float) -> float:
    """Return the length of the step at whose end the angle falls through zero."""
    low, high = (0.0, h) if q > 0.0 else (1e-9 * h, h)
    for _ in range(200):
        middle = (low + high) / 2
        if moved(t, q, v, middle)[0] > 0.0:
            low = middle
        else:
            high = middle
        if high - low <= 1e-16 * max(1.0, t):
            break
    return high
