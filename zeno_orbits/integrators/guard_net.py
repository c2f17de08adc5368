"""Zero crossings of a guard that samples miss: every piece of a step is excluded or searched.

Step control is based on the state. A guard whose formula varies faster, as over a narrow spot of a
magnet or a bump of the ground, may cross zero and return between all samples. So a step is accepted
only if bounds of the guard over a box that contains its states exclude another crossing. Otherwise
the step is halved, down to pieces in which the guard is monotone. So the roots are isolated and not
guessed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators.engine import BoxedStep
from zeno_orbits.integrators.events import Guard, Guarded, polished, root

MOST_PIECES = 4096
"""Pieces of a step that are looked at before the samples alone decide."""

NARROWEST = 2.0**-34
"""Smallest piece relative to its step. It is not halved again, because bisection at a graze would
not end."""

AGREE = 1e-4
"""Largest relative difference of a guard that is a state from its formula in the middle of a step.

A larger difference means that the step does not resolve the guard. The step then ends before, at a
point where both agree."""

NEAR_START = 2.0**-6
"""Part of a step, from its start on the guard, in which the samples alone decide."""


class BoundedGuard(Guarded, Protocol):
    """A guard whose bounds over a box of states may be known, as for every guarded flow."""

    @property
    def is_bounded(self) -> bool:
        """True if the guard varies otherwise than the state, and its bounds are known."""
        ...

    @property
    def is_carried(self) -> bool:
        """True if the guard is a state, in addition to its formula."""
        ...

    def guard_bounds(self, lower: Vector, upper: Vector, /) -> Sequence[float]:
        """Return bounds of the guard and of two derivatives over a box of states."""
        ...


class Place(NamedTuple):
    """A point inside a step.

    Attributes:
        offset: Time since the start of the step.
        value: Guard at the point.
        rate: Rate of the guard at the point.
        state: State at the point, ``(n_y,)``.
    """

    offset: float
    value: float
    rate: float
    state: Vector


def first_of_all(
    flow: BoundedGuard,
    step: BoxedStep,
    before: Guard,
    after: Guard,
    fall: float | None,
    *,
    on_guard: bool,
    rounding: float,
    is_low: bool = False,
    returns: bool = False,
) -> float | None:
    """Return the offset in a step of the first zero of a guard, also between samples.

    Args:
        flow: The flow with the guard and its bounds.
        step: The step.
        before: Guard and its rate at the start.
        after: Guard and its rate at the end.
        fall: The fall that samples found, if any.
        on_guard: The step starts on the guard itself: the root there does not count.
        rounding: A guard of this size is zero but for rounding.
        is_low: The formula of a guard that is a state is rounding, and denies nothing.
        returns: The guard may rise from its root and fall more than once in the step.
    """
    rises = returns and before[1] * step.size > rounding
    if not flow.is_bounded or (on_guard and after[0] <= rounding and not rises):
        return fall
    start = Place(0.0, *before, step.before)
    end = Place(step.size, *after, step.after)
    if fall is not None:
        state = step.state_at(fall)
        # A root to rounding: the guard is not below zero before it.
        end = Place(fall, 0.0, flow.guard(state)[1], state)
    return _searched(
        flow,
        step,
        start,
        end,
        fall,
        on_guard=on_guard,
        rounding=rounding,
        may_deny=flow.is_carried and not is_low,
    )


def _searched(
    flow: BoundedGuard,
    step: BoxedStep,
    left: Place,
    end: Place,
    fall: float | None,
    *,
    on_guard: bool,
    rounding: float,
    may_deny: bool,
) -> float | None:
    """Return the first crossing between two points of a step, or the crossing found by samples."""
    waiting, count = [end], 0
    while waiting and count < MOST_PIECES:
        count += 1
        right = waiting[-1]
        width = right.offset - left.offset
        starts = on_guard and left.offset == 0.0
        # A guard that rises from its zero and is negative further on has fallen in between.
        rises = starts and left.rate * step.size > rounding
        changes = right.value < 0.0 < left.value and not rises
        bounds = flow.guard_bounds(*step.box(left.offset, right.offset, left.state, right.state))
        if changes and _rates(bounds, width, left, right)[1] < 0.0:
            return _root_between(flow, step, left, right)
        excluded = right.value >= 0.0 and _is_excluded(bounds, width, left, right)
        near = NEAR_START**2 if rises else NEAR_START
        is_near = starts and width <= near * step.size and not (rises and right.value < 0.0)
        if excluded or is_near:
            left = waiting.pop()
            continue
        is_zero = max(left.value, right.value) <= rounding and not rises
        if width <= NARROWEST * step.size or is_zero:
            if changes:
                return _root_between(flow, step, left, right)
            left = waiting.pop()
            continue
        offset = (left.offset + right.offset) / 2
        state = step.state_at(offset)
        middle = Place(offset, *flow.guard(state), state)
        if may_deny and _is_denied(flow, middle, width):
            return left.offset
        if starts and middle.value <= 0.0 and not rises:
            left = waiting.pop()
        elif middle.value < 0.0:
            waiting = [middle]
        else:
            waiting.append(middle)
    return fall


def _is_denied(flow: BoundedGuard, place: Place, width: float) -> bool:
    """Return True if a guard that is a state differs from its formula, as over a bump unseen."""
    low, high, slow, fast, *_ = flow.guard_bounds(place.state, place.state)
    off = AGREE * (abs(place.value) + abs(place.rate) * width)
    off_rate = AGREE * (abs(place.rate) + abs(place.value) / width)
    return not (
        low - off <= place.value <= high + off and slow - off_rate <= place.rate <= fast + off_rate
    )


def _root_between(flow: BoundedGuard, step: BoxedStep, left: Place, right: Place) -> float:
    def dense(offset: float) -> Guard:
        return flow.guard(step.state_at(offset))

    low, high = (left.value, left.rate), (right.value, right.rate)
    return polished(flow, step, root(dense, left.offset, right.offset, low, high))


def _rates(bounds: Sequence[float], width: float, left: Place, right: Place) -> tuple[float, float]:
    """Return bounds of a guard's rate in a piece, from the rate's and its derivative's bounds."""
    _, _, slowest, fastest, bend, most_bend = bounds
    falling, rising = min(bend * width, 0.0), max(most_bend * width, 0.0)
    return (
        max(slowest, left.rate + falling, right.rate - rising),
        min(fastest, left.rate + rising, right.rate - falling),
    )


def _is_excluded(bounds: Sequence[float], width: float, left: Place, right: Place) -> bool:
    """Return True if a guard that is nonnegative at both ends of a piece stays nonnegative."""
    if bounds[0] > 0.0:
        return True
    slowest, fastest = _rates(bounds, width, left, right)
    if slowest >= 0.0 or fastest <= 0.0:
        return True
    # The guard lies above the tangents of its least and of its largest rate.
    at = (right.value - left.value - fastest * width) / (slowest - fastest)
    if left.value + slowest * at > 0.0:
        return True
    # It lies above the parabola through both ends with its largest second derivative.
    bend = bounds[5]
    at = width / 2 - (right.value - left.value) / (bend * width) if bend > 0.0 else 0.0
    if not 0.0 < at < width:
        return True
    chord = left.value + (right.value - left.value) * at / width
    return chord - bend / 2 * at * (width - at) > 0.0
