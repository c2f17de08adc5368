"""The explicit engine: DOP853 steps taken by the flow itself, compiled where it can be.

A state inside a step comes from a shorter step of the same order from the same start, so event
times and dense output lose nothing against the steps. Source: [HairerNorsettWanner1993]_.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import StepSizeError
from zeno_orbits.integrators.engine import FAR, Leg, Passage
from zeno_orbits.integrators.events import follow_steps
from zeno_orbits.integrators.flow import GuardedFlow, Tolerance

_SAFETY = 0.9
_SHRINK, _GROW = 0.2, 8.0
_EXPONENT = -1 / 8


@dataclass(frozen=True, slots=True, kw_only=True)
class RungeKutta:
    """DOP853 with the usual step control.

    Attributes:
        largest_step: No step is longer than this, in the time of the flow.
    """

    largest_step: float = math.inf

    def follow(self, leg: Leg) -> Passage:
        """Follow a flow until its guard falls through zero or the time is over.

        Raises:
            StepSizeError: If the step size falls to rounding level.
        """
        return follow_steps(self.steps(leg.flow, leg.y, leg.tolerance, leg.horizon), leg)

    def steps(
        self, flow: GuardedFlow, y: Vector, tolerance: Tolerance, horizon: float = FAR
    ) -> Iterator[ExplicitStep]:
        """Yield steps from ``y`` on, without end.

        Args:
            flow: The flow.
            y: State at the start, ``(n_y,)``.
            tolerance: Local error of a step.
            horizon: No step is longer.

        Raises:
            StepSizeError: If the step size falls to rounding level.
        """
        time = 0.0
        largest = min(self.largest_step, horizon)
        size = min(first_size(flow, y, tolerance), largest)
        refused = False
        while True:
            after, error = flow.attempt(y, size, tolerance)
            if not error <= 1.0:
                # A flow that blows up returns NaN; a shorter step may still be finite.
                factor = _SAFETY * error**_EXPONENT if math.isfinite(error) else _SHRINK
                size *= max(_SHRINK, factor)
                refused = True
                if size <= 4 * math.ulp(time) or size < 1e-300:
                    raise StepSizeError(
                        "The step size fell to rounding level: the flow is too stiff or singular",
                        time=time,
                        state=tuple(y.tolist()),
                    )
                continue
            yield ExplicitStep(flow, tolerance, time, size, y, after)
            time += size
            y = after
            growth = _GROW if error == 0.0 else _SAFETY * error**_EXPONENT
            size *= min(1.0 if refused else _GROW, max(_SHRINK, growth))
            size = min(size, largest)
            refused = False


@dataclass(frozen=True, slots=True)
class ExplicitStep:
    """A step that knows its flow: the state inside is another, shorter step from the start."""

    flow: GuardedFlow
    tolerance: Tolerance
    start: float
    size: float
    before: Vector
    after: Vector

    def state_at(self, offset: float) -> Vector:
        """Return the state ``offset`` after the start of the step."""
        if offset == self.size:
            return self.after
        return self.flow.attempt(self.before, offset, self.tolerance)[0]

    def end_at(self, offset: float) -> Vector:
        """Return the same: nothing is interpolated."""
        return self.state_at(offset)


def first_size(flow: GuardedFlow, y: Vector, tolerance: Tolerance) -> float:
    """Return a first step from the sizes of state and slope ([HairerNorsettWanner1993]_, II.4).

    Args:
        flow: The flow.
        y: State at the start, ``(n_y,)``.
        tolerance: Local error of a step.

    Raises:
        StepSizeError: If the flow is not finite at its start.
    """
    # A few plain numbers: as arrays they would cost as much as two steps.
    slope, state = flow.rate(y).tolist(), y.tolist()
    if not all(map(math.isfinite, slope)):
        raise StepSizeError("The flow is not finite at its start", time=0.0, state=tuple(state))
    floor = tolerance.absolute / tolerance.relative
    ratio = max(abs(s) / (floor + abs(x)) for s, x in zip(slope, state, strict=True))
    return 0.01 / ratio if ratio > 1e-5 else 1e-3
