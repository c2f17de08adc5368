"""What all engines that step share: watch the guard over their steps, and keep them."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from zeno_orbits.dynamics import Vector
from zeno_orbits.engines.crossing import end_state, first_fall
from zeno_orbits.engines.protocol import Leg, Outcome, Passage, Step
from zeno_orbits.errors import StepSizeError

_LEAVES = 1e-6
"""A guard that was never positive and is below minus this part of its change has been left."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SteppedTrajectory:
    """The steps of a leg; the last may reach beyond its end.

    Attributes:
        steps: The steps, at least one.
        duration: Where the leg ends.
        end: State there, ``(n_y,)``.
    """

    steps: tuple[Step, ...]
    duration: float
    end: Vector

    @property
    def times(self) -> Vector:
        """Where the steps start, and the end, ``(m,)``."""
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


def follow_steps(steps: Iterator[Step], leg: Leg) -> Passage:
    """Take steps until the guard of a leg falls or its time is over."""
    flow, on_guard = leg.flow, leg.on_guard
    before = flow.guard(leg.y)
    largest = 0.0
    taken: list[Step] = []
    for step in steps:
        taken.append(step)
        leg.watch(1, step.start, step.after)
        after = flow.guard(step.after)
        fall = first_fall(flow, step, before, after, on_guard=on_guard)
        end = step.size if fall is None else fall
        if step.start + end >= leg.horizon:
            state = end_state(step, leg.horizon - step.start)
            return _passage(Outcome.HORIZON, taken, leg.horizon, state)
        if fall is not None:
            return _passage(Outcome.FALL, taken, step.start + fall, end_state(step, fall))
        if on_guard:
            largest = max(largest, abs(before[1]) * step.size, abs(after[1]) * step.size)
            if after[0] < -max(_LEAVES * largest, leg.contact):
                return _passage(Outcome.LEFT, taken, step.start, step.before)
            on_guard = after[0] <= 0.0
        before = after
    raise StepSizeError(
        "The engine stopped before the guard", time=before[0], state=tuple(leg.y.tolist())
    )


def _passage(outcome: Outcome, steps: list[Step], duration: float, state: Vector) -> Passage:
    trajectory = SteppedTrajectory(steps=tuple(steps), duration=duration, end=state)
    return Passage(outcome=outcome, duration=duration, state=state, trajectory=trajectory)
