"""Where the guard of a flow falls through zero inside a step.

Ends of steps alone would miss a fall and return between them, and a root finder that starts on
the guard would report its own start. So the guard is looked at through its cubic Hermite
interpolant first, and every root is then found on true states.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import brentq

from zeno_orbits.dynamics import GuardedFlow
from zeno_orbits.engines.protocol import Step

_FRACTIONS = np.arange(1, 8) / 8
_BASIS = np.stack(
    [
        (1 + 2 * _FRACTIONS) * (1 - _FRACTIONS) ** 2,
        _FRACTIONS * (1 - _FRACTIONS) ** 2,
        _FRACTIONS**2 * (3 - 2 * _FRACTIONS),
        _FRACTIONS**2 * (_FRACTIONS - 1),
    ],
    axis=1,
)
"""Cubic Hermite basis at the interior fractions, ``(7, 4)``."""

_HALVINGS = 50
"""A rise shorter than the step by more than this power of two is no rise."""


def first_fall(
    flow: GuardedFlow,
    step: Step,
    before: tuple[float, float],
    after: tuple[float, float],
    *,
    on_guard: bool,
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
    samples = _BASIS @ np.array([before[0], size * before[1], after[0], size * after[1]])
    interior_minimum = before[1] < 0.0 < after[1]
    if after[0] > 0.0 and float(np.min(samples)) > 0.0 and not interior_minimum:
        return None

    def guard(offset: float) -> float:
        return flow.guard(step.state_at(offset))[0]

    def guard_rate(offset: float) -> float:
        return flow.guard(step.state_at(offset))[1]

    offsets = [*(float(size * fraction) for fraction in _FRACTIONS), size]
    left, left_pair = 0.0, before
    armed = not on_guard
    for offset in offsets:
        pair = after if offset == size else flow.guard(step.state_at(offset))
        if armed and pair[0] < 0.0:
            return _root(guard, left, offset)
        if armed and left_pair[1] < 0.0 < pair[1]:
            lowest = _root(guard_rate, left, offset)
            if guard(lowest) < 0.0:
                return _root(guard, left, lowest)
        armed = armed or pair[0] > 0.0
        left, left_pair = offset, pair
    return None if armed or after[0] >= 0.0 else _short_rise(guard, size)


def _short_rise(guard: Callable[[float], float], size: float) -> float | None:
    """Return the fall after a rise from the guard that is far shorter than the step, if any."""
    right = size
    for _ in range(_HALVINGS):
        left = right / 2
        if guard(left) > 0.0:
            return _root(guard, left, right)
        right = left
    return None


def _root(function: Callable[[float], float], left: float, right: float) -> float:
    """Return a root in a bracket whose ends are known to differ in sign, to rounding."""
    if function(left) == 0.0:
        return left
    tiny = 4 * np.finfo(np.float64).eps
    return float(brentq(function, left, right, xtol=tiny * (right - left), rtol=tiny))
