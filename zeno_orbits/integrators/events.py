"""Location of the event in a step: the point at which the guard of a flow crosses zero.

The ends of steps alone would miss a crossing and return between them, and a root finder that starts
on the guard would report its own start. So the guard is first checked with its cubic Hermite
interpolant and then on the dense output. Every root is refined with true steps. `guard_net` finds
crossings that these samples miss.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators.engine import Step, fast_dataclass

Guard = tuple[float, float]
"""A guard and its time derivative."""

FRACTIONS = tuple(k / 8 for k in range(1, 8))
"""Fractions of a step at which the guard is evaluated, if its values at the ends do not suffice."""

HALVINGS = 50
"""A rise that is shorter than the step by more than this power of two is ignored."""

TINY = 4 * float(np.finfo(np.float64).eps)
"""A bracket narrower than this part of its first width holds its root to rounding."""


def inner_coefficients(size: Any, before: Any, after: Any) -> tuple[Any, Any]:
    """Return the second and third Bernstein coefficient of a guard's cubic interpolant in a step.

    The interpolant lies in the hull of its four coefficients, of which the guards at the ends are
    the first and the last, and it has no more roots than they have changes of sign.

    Args:
        size: Step size, or sizes of many steps, ``(n,)``.
        before: Guard and its rate at the start, ``(2, n)`` for many steps.
        after: Guard and its rate at the end.
    """
    return before[0] + size / 3 * before[1], after[0] - size / 3 * after[1]


def is_cubic(middle: Any, size: Any, before: Any, after: Any) -> Any:
    """Return True if the cubic interpolant of a guard is accurate in the middle of a step.

    Args:
        middle: The guard at the midpoint, or the guards of many steps, ``(n,)``.
        size: As for `inner_coefficients`.
        before: As for `inner_coefficients`.
        after: As for `inner_coefficients`.
    """
    expected = (before[0] + after[0]) / 2 + size * (before[1] - after[1]) / 8
    return abs(middle - expected) < CUBIC * (abs(before[0]) + abs(after[0]))


CUBIC = 0.1
"""Part of a guard's size by which the middle of a step may differ from its cubic interpolant."""


class Guarded(Protocol):
    """An object with a guard."""

    def guard(self, y: Vector) -> tuple[float, float]:
        """Return the guard and its time derivative along the flow."""
        ...


def first_fall(
    flow: Guarded, step: Step, before: Guard, after: Guard, *, on_guard: bool
) -> float | None:
    """Return the offset in the step at which the guard first falls through zero, if it does.

    Args:
        flow: The flow with the guard.
        step: The step.
        before: Guard and its rate at the start of the step.
        after: Guard and its rate at the end.
        on_guard: The step starts on the guard itself: the root there does not count.

    Returns:
        The offset, in ``(0, size]``, or ``None``.
    """
    size = step.size
    second, third = inner_coefficients(size, before, after)
    started = before[0] > 0.0 or (on_guard and before[0] == 0.0 and before[1] > 0.0)
    # A rate that changes sign may hide a dip, but not one to zero where the cubic falls by less
    # than half.
    dips = before[1] < 0.0 < after[1] and not (
        second > before[0] / 2 > 0.0 and third > after[0] / 2 > 0.0
    )
    if started and second > 0.0 and third > 0.0 and after[0] > 0.0 and not dips:
        return None

    def dense(offset: float) -> Guard:
        return after if offset == size else flow.guard(step.state_at(offset))

    falls_once = before[0] > 0.0 > after[0] and (second > 0.0 or third < 0.0)
    if not on_guard and falls_once:
        middle = dense(size / 2)
        if is_cubic(middle[0], size, before, after):
            return polished(flow, step, _halved_root(dense, size, before, middle, after))
    left, left_pair = 0.0, before
    armed = not on_guard
    for offset in (*(size * fraction for fraction in FRACTIONS), size):
        pair = dense(offset)
        if armed and pair[0] < 0.0:
            return polished(flow, step, root(dense, left, offset, left_pair, pair))
        if armed and left_pair[1] < 0.0 < pair[1]:
            falling, rising = (left_pair[1], None), (pair[1], None)
            lowest = root(lambda at: (dense(at)[1], None), left, offset, falling, rising)
            low_pair = dense(lowest)
            if low_pair[0] < 0.0:
                return polished(flow, step, root(dense, left, lowest, left_pair, low_pair))
        armed = armed or pair[0] > 0.0
        left, left_pair = offset, pair
    if armed or after[0] >= 0.0:
        return None
    return _short_rise(flow, step, dense)


def _short_rise(flow: Guarded, step: Step, dense: Callable[[float], Guard]) -> float | None:
    """Return the fall after a rise from the guard that is far shorter than the step, if any."""
    right, right_pair = step.size, dense(step.size)
    for _ in range(HALVINGS):
        left = right / 2
        left_pair = dense(left)
        if left_pair[0] > 0.0:
            return polished(flow, step, root(dense, left, right, left_pair, right_pair))
        right, right_pair = left, left_pair
    return None


def polished(flow: Guarded, step: Step, offset: float) -> float:
    """Return a root of the dense output, moved to the root of true steps by Newton's method.

    Args:
        flow: The flow with its guard.
        step: The step that contains the root.
        offset: Root of the dense output, counted from the start of the step [s].
    """
    for _ in range(4):
        value, rate = flow.guard(step.end_at(offset))
        change = -value / rate if rate < 0.0 else 0.0
        moved = min(max(offset + change, 0.0), step.size)
        if abs(moved - offset) > POLISH * step.size:
            # A guard that falls so slowly that dense output and steps disagree: graze, not fall.
            return _slow_root(flow, step, offset)
        if abs(moved - offset) <= DOUBLES * step.size:
            # Newton's method squares the remaining error.
            return moved
        offset = moved
    return offset


DOUBLES = 1e-9
"""After a last change below this part of the step, Newton's method leaves less than rounding."""

POLISH = 1e-3
"""Newton's method moves a root of the dense output by no more than this part of the step."""


def _slow_root(flow: Guarded, step: Step, offset: float) -> float:
    """Return the root of true steps near one of the dense output, if they differ in sign there."""

    def true(at: float) -> Guard:
        return flow.guard(step.end_at(at))

    width = POLISH * step.size
    while width < step.size:
        left, right = max(offset - width, 0.0), min(offset + width, step.size)
        low, high = true(left), true(right)
        if low[0] > 0.0 > high[0]:
            return root(true, left, right, low, high)
        width *= 4
    return offset


def _halved_root(
    dense: Callable[[float], Guard], size: float, before: Guard, middle: Guard, after: Guard
) -> float:
    """Return the root of a step in which the guard falls once, in the half that has it."""
    if middle[0] > 0.0:
        return root(dense, size / 2, size, middle, after)
    return root(dense, 0.0, size / 2, before, middle)


Pair = tuple[float, float | None]
"""A function and its derivative, where it is known."""


def root(
    function: Callable[[float], Pair], left: float, right: float, low: Pair, high: Pair
) -> float:
    """Return a root between two offsets at which a function differs in sign, to rounding.

    Newton's method is used if the rate is known, while it stays in the bracket and its steps at
    least halve. Otherwise bisection is used.

    Args:
        function: The function.
        left: One offset.
        right: The other.
        low: The function at the left offset.
        high: The function at the right offset.
    """
    if low[0] == 0.0 or left == right:
        return left
    if high[0] == 0.0:
        return right
    accuracy = TINY * (right - left)
    close = DOUBLES * (right - left)
    at, last = _cubic_root(left, right, low, high), right - left
    while right - left > accuracy:
        value, rate = function(at)
        if value == 0.0:
            return at
        if (value > 0.0) == (low[0] > 0.0):
            left = at
        else:
            right = at
        change = -value / rate if rate else math.inf
        if abs(change) <= close:
            return min(max(at + change, left), right)
        if left < at + change < right and abs(change) < last / 2:
            at, last = at + change, abs(change)
        else:
            at, last = (left + right) / 2, (right - left) / 2
            if at in {left, right}:
                break
    return (left + right) / 2


def _cubic_root(left: float, right: float, low: Pair, high: Pair) -> float:
    """Return the first guess of a root: the root of the cubic interpolant, or else of the chord."""
    # The quotient first: scaled gaps of a flight that goes far reach 1e300.
    drop = 1.0 - high[0] / low[0]
    at = 1.0 / drop if drop else math.inf
    if low[1] is not None and high[1] is not None:
        # In units of the value at the left, on [0, 1]: 1 + b x + c x^2 + d x^3.
        b, end = low[1] / low[0] * (right - left), high[1] / low[0] * (right - left)
        c, d = -3.0 * drop - 2.0 * b - end, 2.0 * drop + b + end
        for _ in range(CUBIC_STEPS):
            rate = b + at * (2.0 * c + at * 3.0 * d)
            moved = at - (1.0 + at * (b + at * (c + at * d))) / rate if rate < 0.0 else math.nan
            if not 0.0 < moved < 1.0:
                break
            at = moved
    return left + at * (right - left)


CUBIC_STEPS = 4


@fast_dataclass
class SteppedTrajectory:
    """The steps of a leg. The last step may extend beyond the end of the leg.

    Attributes:
        steps: The steps, at least one.
        duration: Time at which the leg ends.
        end: State there, ``(n_y,)``.
    """

    steps: Sequence[Step]
    duration: float
    end: Vector

    @property
    def times(self) -> Vector:
        """Starts of the steps, and the end, ``(m,)``."""
        return np.array([*(step.start for step in self.steps), self.duration])

    @property
    def states(self) -> Vector:
        """State at each of these times, ``(m, n_y)``."""
        return np.array([*(step.before for step in self.steps), self.end])

    def state_at(self, offset: float) -> Vector:
        """Return the state at a time from the start."""
        if offset >= self.duration:
            return self.end
        at = bisect_right(self.steps, offset, key=lambda step: step.start)
        step = self.steps[max(at - 1, 0)]
        return step.state_at(min(max(offset - step.start, 0.0), step.size))

    def states_at(self, offsets: Vector) -> Vector:
        """Return the states at times from the start, ``(n, n_y)``."""
        return np.array([self.state_at(offset) for offset in offsets.tolist()])
