"""Step-by-step integration of a flow until its guard crosses zero, shared by all step engines."""

from __future__ import annotations

from collections.abc import Iterator

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import StepSizeError
from zeno_orbits.integrators.engine import BoxedStep, Segment, SegmentResult, Step, Termination
from zeno_orbits.integrators.events import Guard, SteppedTrajectory, first_fall
from zeno_orbits.integrators.guard_net import first_of_all

LEAVES = 1e-6
"""A guard that was never positive and is below minus this part of its change has been left."""


def follow_steps(steps: Iterator[BoxedStep], leg: Segment) -> SegmentResult:
    """Take steps until the guard of a leg falls or its time is over."""
    flow, on_guard = leg.flow, leg.on_guard
    before = flow.guard(leg.y)
    largest = 0.0
    taken: list[Step] = []
    for step in steps:
        taken.append(step)
        leg.watch(1, step.start, step.after)
        after = flow.guard(step.after)
        fall = _fall(leg, step, before, after, on_guard=on_guard)
        end = step.size if fall is None else fall
        is_late = fall is not None and step.start + fall >= leg.horizon - leg.late
        if step.start + end >= leg.horizon or is_late:
            state = end_state(step, leg.horizon - step.start)
            return _passage(Termination.HORIZON, taken, leg.horizon, state)
        if fall is not None:
            return _passage(Termination.FALL, taken, step.start + fall, end_state(step, fall))
        if on_guard:
            largest = max(largest, abs(before[1]) * step.size, abs(after[1]) * step.size)
            if after[0] < -max(LEAVES * largest, leg.rounding):
                return _passage(Termination.LEFT, taken, step.start, step.before)
            on_guard = after[0] <= leg.rounding
        before = after
    raise StepSizeError(
        "The engine stopped before the guard", time=before[0], state=tuple(leg.y.tolist())
    )


def _fall(
    leg: Segment, step: BoxedStep, before: Guard, after: Guard, *, on_guard: bool
) -> float | None:
    """Return the offset in a step at which the guard of a leg first falls, if it does."""
    fall = first_fall(leg.flow, step, before, after, on_guard=on_guard)
    if fall is not None and on_guard and _is_rounding(leg, step, fall):
        fall = None
    found = first_of_all(
        leg.flow,
        step,
        before,
        after,
        fall,
        on_guard=on_guard,
        rounding=leg.rounding,
        is_low=leg.is_low,
        returns=leg.returns,
    )
    if found is None and leg.returns and on_guard and _is_back(leg, step, before, after):
        return step.size
    return found


def _is_back(leg: Segment, step: BoxedStep, before: Guard, after: Guard) -> bool:
    """Return True if a guard that rose from its root falls to zero just where the step ends."""
    rises = before[1] * step.size > leg.rounding
    return rises and abs(after[0]) <= leg.rounding and after[1] < 0.0


def _is_rounding(leg: Segment, step: Step, fall: float) -> bool:
    """Return True if the guard, from its root at the start, has not risen above rounding."""
    _, rate = leg.flow.guard(end_state(step, fall))
    return abs(rate) * (step.start + fall) < leg.rounding


def _passage(
    outcome: Termination, steps: list[Step], duration: float, state: Vector
) -> SegmentResult:
    trajectory = SteppedTrajectory(steps=tuple(steps), duration=duration, end=state)
    return SegmentResult(outcome=outcome, duration=duration, state=state, trajectory=trajectory)


def end_state(step: Step, offset: float) -> Vector:
    """Return the state at an offset to the accuracy of the step's end."""
    return step.after if offset == step.size else step.end_at(offset)
