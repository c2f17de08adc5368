"""The stiff engine: Radau IIA of order 13, whose steps do not know how fast a layer decays.

Dense output is the collocation polynomial; an event time is finished on a step that ends there.
Source: [HairerWanner1996]_, IV.8 for the iteration and the step control, theory (23).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import StepSizeError
from zeno_orbits.integrators.collocation import Collocation, radau
from zeno_orbits.integrators.dop853 import first_size
from zeno_orbits.integrators.engine import FAR, Leg, Passage
from zeno_orbits.integrators.events import follow_steps
from zeno_orbits.integrators.flow import (
    FIRST_ITERATIONS,
    Corrected,
    GuardedFlow,
    NewtonPieces,
    StageGuess,
    Tolerance,
)

_SAFETY = 0.9
_SHRINK, _GROW = 0.1, 6.0
_UNSOLVED = 0.3
"""Factor of the step size after an iteration that did not converge."""

_MOST_ITERATIONS = 12
_NEWTON_SHARE = 0.01
"""Part of the tolerance that the iteration may leave."""

_FLOOR = 1e-3
"""A correction below this part of the tolerance ends the iteration however it got there."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Radau:
    """Radau IIA with simplified Newton iterations.

    Attributes:
        scheme: The collocation scheme, of an odd number of stages.
        largest_step: No step is longer than this, in the time of the flow.
    """

    scheme: Collocation = field(default_factory=lambda: radau(7))
    largest_step: float = math.inf

    def follow(self, leg: Leg) -> Passage:
        """Follow a flow until its guard falls through zero or the time is over.

        Raises:
            StepSizeError: If the step size falls to rounding level.
        """
        return follow_steps(self.steps(leg.flow, leg.y, leg.tolerance, leg.horizon), leg)

    def steps(
        self,
        flow: GuardedFlow,
        y: Vector,
        tolerance: Tolerance,
        horizon: float = FAR,
        *,
        time: float = 0.0,
        size: float | None = None,
    ) -> Iterator[RadauStep]:
        """Yield steps from ``y`` on, without end.

        Args:
            flow: The flow.
            y: State at the start, ``(n_y,)``.
            tolerance: Local error of a step.
            horizon: No step is longer.
            time: Time at the start.
            size: First step to try; one is guessed by default.

        Raises:
            StepSizeError: If the step size falls to rounding level.
        """
        pieces = flow.newton(self.scheme)
        largest = min(self.largest_step, horizon)
        size = min(size or first_size(flow, y, tolerance), largest)
        exponent = -1.0 / (self.scheme.n_stages + 1)
        last: RadauStep | None = None
        refused = False
        while True:
            guess = None if last is None else StageGuess(last.coefficients, 1.0, size / last.size)
            found = solved(pieces, y, size, tolerance, guess)
            error = math.inf if found is None else found.error
            factor = _SAFETY * max(error, 1e-300) ** exponent if error < math.inf else _UNSOLVED
            if found is None or not error <= 1.0:
                size *= max(_SHRINK, min(factor, 0.5 if last is None else 1.0))
                refused = True
                if not size > 4 * math.ulp(time) or size < 1e-300:
                    raise StepSizeError(
                        "The step size fell to rounding level: the flow is singular",
                        time=time,
                        state=tuple(y.tolist()),
                    )
                continue
            last = RadauStep(
                flow=flow,
                scheme=self.scheme,
                tolerance=tolerance,
                start=time,
                size=size,
                before=y,
                after=found.after,
                coefficients=found.coefficients,
            )
            yield last
            time += size
            y = last.after
            size = min(size * min(1.0 if refused else _GROW, factor), largest)
            refused = False


def solved(
    pieces: NewtonPieces, y: Vector, size: float, tolerance: Tolerance, guess: StageGuess | None
) -> Corrected | None:
    """Return a step with its stages solved for, or nothing if Newton's method fails.

    Args:
        pieces: The iteration.
        y: State before the step, ``(n_y,)``.
        size: Its size.
        tolerance: What the iteration is measured by.
        guess: What the stage increments start from; zero by default.
    """
    found = pieces.begin(y, size, tolerance, guess)
    stages, norm, last = found.stages, found.last, found.before
    for count in range(FIRST_ITERATIONS, _MOST_ITERATIONS + 1):
        if not math.isfinite(norm):
            return None
        rate = norm / last if last > 0.0 else 1.0
        if norm <= _FLOOR or norm * rate <= _NEWTON_SHARE * (1.0 - rate):
            if count == FIRST_ITERATIONS:
                return found
            return found._replace(
                stages=stages,
                coefficients=pieces.scheme.coefficients(stages),
                after=y + stages[-1],
                error=pieces.error(stages),
            )
        if rate >= 2.0:
            return None
        last = norm
        stages, norm = pieces.correct(stages)
    return None


@dataclass(frozen=True, slots=True, kw_only=True)
class RadauStep:
    """One step, with the polynomial through its stages."""

    flow: GuardedFlow
    scheme: Collocation
    tolerance: Tolerance
    start: float
    size: float
    before: Vector
    after: Vector
    coefficients: Vector

    def state_at(self, offset: float) -> Vector:
        """Return the collocation polynomial ``offset`` after the start of the step."""
        if offset == self.size:
            return self.after
        return self.before + self.scheme.increment(self.coefficients, offset / self.size)

    def end_at(self, offset: float) -> Vector:
        """Return the state after a step that ends ``offset`` after the start of this one."""
        if offset == self.size:
            return self.after
        if offset <= 0.0:
            return self.before
        guess = StageGuess(self.coefficients, 0.0, offset / self.size)
        pieces = self.flow.newton(self.scheme)
        found = solved(pieces, self.before, offset, self.tolerance, guess)
        return self.state_at(offset) if found is None else found.after
