"""Where the guard of a flow falls through zero inside a step.

Ends of steps alone would miss a fall and return between them, and a root finder that starts on
the guard would report its own start. So the guard is looked at through its cubic Hermite
interpolant first, then on the dense output, and every root is finished on true steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from zeno_orbits.dynamics import GuardedFlow, Vector
from zeno_orbits.engines.protocol import Step

Guard = tuple[float, float]
"""A guard and its time derivative."""

_FRACTIONS = tuple(k / 8 for k in range(1, 8))
_HALVINGS = 50
"""A rise shorter than the step by more than this power of two is no rise."""

_TINY = 4 * float(np.finfo(np.float64).eps)


def first_fall(
    flow: GuardedFlow, step: Step, before: Guard, after: Guard, *, on_guard: bool
) -> float | None:
    """Return the offset in the step at which the guard first falls through zero, if it does.

    Args:
        flow: The flow, for its guard.
        step: The step.
        before: Guard and its rate at the start of the step.
        after: Guard and its rate at the end.
        on_guard: The step starts on the guard itself: the root there does not count.

    Returns:
        The offset, in ``(0, size]``, or ``None``.
    """
    size = step.size
    # The cubic interpolant lies in the hull of its four Bernstein coefficients, and has no more
    # roots than they have changes of sign.
    second, third = before[0] + size / 3 * before[1], after[0] - size / 3 * after[1]
    started = before[0] > 0.0 or (on_guard and before[0] == 0.0 and before[1] > 0.0)
    dips = before[1] < 0.0 < after[1]
    if started and second > 0.0 and third > 0.0 and after[0] > 0.0 and not dips:
        return None

    def dense(offset: float) -> Guard:
        return after if offset == size else flow.guard(step.state_at(offset))

    falls_once = before[0] > 0.0 > after[0] and (second > 0.0 or third < 0.0)
    if not on_guard and falls_once and _is_cubic(dense(size / 2)[0], size, before, after):
        return _polished(flow, step, _root(dense, 0.0, size))
    left, left_pair = 0.0, before
    armed = not on_guard
    for offset in (*(size * fraction for fraction in _FRACTIONS), size):
        pair = dense(offset)
        if armed and pair[0] < 0.0:
            return _polished(flow, step, _root(dense, left, offset))
        if armed and left_pair[1] < 0.0 < pair[1]:
            lowest = _root(lambda at: (dense(at)[1], None), left, offset)
            if dense(lowest)[0] < 0.0:
                return _polished(flow, step, _root(dense, left, lowest))
        armed = armed or pair[0] > 0.0
        left, left_pair = offset, pair
    if armed or after[0] >= 0.0:
        return None
    return _short_rise(flow, step, dense)


def _is_cubic(middle: float, size: float, before: Guard, after: Guard) -> bool:
    """Tell whether the cubic interpolant of a guard tells its value in the middle of a step."""
    expected = (before[0] + after[0]) / 2 + size * (before[1] - after[1]) / 8
    return abs(middle - expected) < _CUBIC * (abs(before[0]) + abs(after[0]))


_CUBIC = 0.1
"""Part of a guard's size by which the middle of a step may differ from its cubic interpolant."""


def _short_rise(flow: GuardedFlow, step: Step, dense: Callable[[float], Guard]) -> float | None:
    """Return the fall after a rise from the guard that is far shorter than the step, if any."""
    right = step.size
    for _ in range(_HALVINGS):
        left = right / 2
        if dense(left)[0] > 0.0:
            return _polished(flow, step, _root(dense, left, right))
        right = left
    return None


def _polished(flow: GuardedFlow, step: Step, offset: float) -> float:
    """Return a root of the dense output, moved to the root of true steps by Newton's method."""
    for _ in range(4):
        value, rate = flow.guard(step.end_at(offset))
        change = -value / rate if rate < 0.0 else 0.0
        moved = min(max(offset + change, 0.0), step.size)
        if abs(moved - offset) > _POLISH * step.size:
            # A guard that falls so slowly that dense output and steps disagree: graze, not fall.
            return _root(lambda at: flow.guard(step.end_at(at)), *_bracket(flow, step, offset))
        if abs(moved - offset) <= _TINY * step.size:
            return moved
        offset = moved
    return offset


_POLISH = 1e-3
"""Newton's method moves a root of the dense output by no more than this part of the step."""


def _bracket(flow: GuardedFlow, step: Step, offset: float) -> tuple[float, float]:
    """Return two offsets around a root of the dense output where true steps differ in sign."""
    width = _POLISH * step.size
    while width < step.size:
        left, right = max(offset - width, 0.0), min(offset + width, step.size)
        if flow.guard(step.end_at(left))[0] > 0.0 > flow.guard(step.end_at(right))[0]:
            return left, right
        width *= 4
    return offset, offset


def _root(
    function: Callable[[float], tuple[float, float | None]], left: float, right: float
) -> float:
    """Return a root between two offsets at which a function differs in sign, to rounding.

    Newton's method where the rate is known, while it stays in the bracket and its steps at least
    halve; bisection elsewhere.
    """
    low, high = function(left)[0], function(right)[0]
    if low == 0.0 or left == right:
        return left
    if high == 0.0:
        return right
    accuracy = _TINY * (right - left)
    # The quotient first: scaled gaps of a flight that goes far reach 1e300.
    at, last = left - low / (high - low) * (right - left), right - left
    while right - left > accuracy:
        value, rate = function(at)
        if value == 0.0:
            return at
        if (value > 0.0) == (low > 0.0):
            left = at
        else:
            right = at
        change = -value / rate if rate else math.inf
        if abs(change) <= accuracy:
            return min(max(at + change, left), right)
        if left < at + change < right and abs(change) < last / 2:
            at, last = at + change, abs(change)
        else:
            at, last = (left + right) / 2, (right - left) / 2
            if at in {left, right}:
                break
    return (left + right) / 2


def end_state(step: Step, offset: float) -> Vector:
    """Return the state at an offset to the accuracy of the step's end."""
    return step.after if offset == step.size else step.end_at(offset)
