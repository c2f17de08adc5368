"""Single steps as values: the explicit one knows its flow, the implicit one its polynomial.

A state inside an explicit step comes from a shorter step of the same order from the same start, so
event times and dense output lose nothing against the steps. Dense output of an implicit step is
its collocation polynomial; an event time is finished on a step that ends there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import StepSizeError
from zeno_orbits.integrators.collocation import Collocation
from zeno_orbits.integrators.flow import (
    FIRST_ITERATIONS,
    Corrected,
    GuardedFlow,
    NewtonPieces,
    StageGuess,
    Tolerance,
)

MOST_ITERATIONS = 12
NEWTON_SHARE = 0.01
"""Part of the tolerance that the iteration may leave."""

NEWTON_FLOOR = 1e-3
"""A correction below this part of the tolerance ends the iteration however it got there."""


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
    for count in range(FIRST_ITERATIONS, MOST_ITERATIONS + 1):
        if not math.isfinite(norm):
            return None
        rate = norm / last if last > 0.0 else 1.0
        if norm <= NEWTON_FLOOR or norm * rate <= NEWTON_SHARE * (1.0 - rate):
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
        raise not_finite(y)
    floor = tolerance.absolute / tolerance.relative
    ratio = max(abs(s) / (floor + abs(x)) for s, x in zip(slope, state, strict=True))
    return 0.01 / ratio if ratio > 1e-5 else 1e-3


def too_small(reason: str, time: float, y: Vector) -> StepSizeError:
    """Return the error of a step size that fell to rounding level.

    Args:
        reason: What may be wrong with the flow.
        time: When.
        y: State there, ``(n_y,)``.
    """
    return StepSizeError(
        f"The step size fell to rounding level: {reason}", time=time, state=tuple(y.tolist())
    )


def not_finite(y: Vector) -> StepSizeError:
    """Return the error of a flow that is not finite at its start."""
    return StepSizeError("The flow is not finite at its start", time=0.0, state=tuple(y.tolist()))
