"""Single steps as values: an explicit step holds its flow, an implicit step its polynomial.

A state inside an explicit step is computed by a shorter step of the same order from the same start,
so event times and dense output are as accurate as the steps. Dense output of an implicit step is
its collocation polynomial. An event time is refined by a step that ends there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import StepSizeError
from zeno_orbits.integrators.collocation import Collocation
from zeno_orbits.integrators.flow import (
    FIRST_ITERATIONS,
    Corrected,
    FlowWithEvent,
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
    """A step that holds its flow. A state inside is computed by a shorter step from the start."""

    flow: FlowWithEvent
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

    def box(self, left: float, right: float, low: Vector, high: Vector) -> Box:
        """Return bounds of the states between two offsets, at which they are given."""
        return hermite_box(self.flow, right - left, low, high)


@dataclass(frozen=True, slots=True, kw_only=True)
class RadauStep:
    """One step, with the polynomial through its stages."""

    flow: FlowWithEvent
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
        """Return the state after a step with the same start that ends at ``offset``."""
        if offset == self.size:
            return self.after
        if offset <= 0.0:
            return self.before
        guess = StageGuess(self.coefficients, 0.0, offset / self.size)
        pieces = self.flow.newton(self.scheme)
        found = solved(pieces, self.before, offset, self.tolerance, guess)
        return self.state_at(offset) if found is None else found.after

    def box(self, left: float, right: float, _low: Vector, _high: Vector) -> Box:
        """Return bounds of the collocation polynomial between two offsets."""
        series = np.vstack([self.before, self.coefficients])
        return polynomial_box(series, left / self.size, right / self.size)


Box = tuple[Vector, Vector]
"""Lower and upper ends of states, each ``(n_y,)``."""

SLACK = 0.125
"""Part of its width by which the box of a cubic is widened: that is not the flow itself."""


ROUNDED = 2.0**-49
"""Part of an end of a box by which that is moved outwards: eight roundings."""


def hermite_box(flow: FlowWithEvent, width: float, low: Vector, high: Vector) -> Box:
    """Return bounds of the states of a flow between two of them, from the cubic through both.

    The cubic lies in the hull of its Bernstein coefficients.

    Args:
        flow: The flow.
        width: Time between the states.
        low: The first state, ``(n_y,)``.
        high: The second.
    """
    third = width / 3
    hull = np.array([low, low + third * flow.rate(low), high - third * flow.rate(high), high])
    lower, upper = hull.min(axis=0), hull.max(axis=0)
    slack = SLACK * (upper - lower)
    return _rounded(lower - slack, upper + slack)


def polynomial_box(series: Vector, left: float, right: float) -> Box:
    """Return bounds of polynomials between two points, from their Bernstein coefficients.

    Args:
        series: Coefficients, one row per power from zero, ``(n, n_y)``.
        left: The left point.
        right: The right point.
    """
    bernstein, binomials, exponents = _bernstein(len(series))
    if left == 0.0 and right == 1.0:
        hull = bernstein @ series
    else:
        powers = (right - left) ** np.arange(len(series))
        hull = (bernstein * powers) @ (binomials * left**exponents) @ series
    return _rounded(hull.min(axis=0), hull.max(axis=0))


def _rounded(lower: Vector, upper: Vector) -> Box:
    """Return a box widened by the rounding of its ends and of formulas in it."""
    return lower - ROUNDED * np.abs(lower), upper + ROUNDED * np.abs(upper)


@cache
def _bernstein(n: int) -> tuple[Vector, Vector, Vector]:
    """Return the matrix from powers on ``[0, 1]`` to Bernstein coefficients, ``(n, n)``.

    Then the binomials ``j over k`` that shift a polynomial, row ``k`` and column ``j``, and the
    exponents that go with them, ``j - k``.
    """
    shift = np.array([[float(math.comb(j, k)) for j in range(n)] for k in range(n)])
    places = np.arange(n)
    return (shift / shift[:, -1:]).T, shift, np.maximum(places - places[:, None], 0)


def solved(
    pieces: NewtonPieces, y: Vector, size: float, tolerance: Tolerance, guess: StageGuess | None
) -> Corrected | None:
    """Return a step with its solved stages, or ``None`` if Newton's method fails.

    Args:
        pieces: The iteration.
        y: State before the step, ``(n_y,)``.
        size: Size of the step.
        tolerance: Scale of the iteration's convergence test.
        guess: Initial guess of the stage increments, by default zero.
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


def cut(flow: FlowWithEvent, y: Vector, size: float) -> tuple[float, float]:
    """Return the size that a step would have, 0 if it is not cut, and its size up to a span's end.

    Args:
        flow: The flow.
        y: State at the start, ``(n_y,)``.
        size: Size of the step so far.
    """
    longest = flow.longest(y)
    return (size, longest) if longest < size else (0.0, size)


def first_size(flow: FlowWithEvent, y: Vector, tolerance: Tolerance) -> float:
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
        reason: Possible fault of the flow.
        time: Time of the failure.
        y: State at that time, ``(n_y,)``.
    """
    return StepSizeError(
        f"The step size fell to rounding level: {reason}", time=time, state=tuple(y.tolist())
    )


def not_finite(y: Vector) -> StepSizeError:
    """Return the error of a flow that is not finite at its start."""
    return StepSizeError("The flow is not finite at its start", time=0.0, state=tuple(y.tolist()))
