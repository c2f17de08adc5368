"""Flows with a guard: the input of an integrator, and the conversion of plain functions."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators.collocation import Collocation
from zeno_orbits.integrators.dop853_step import error_norm, explicit_attempt, overflow
from zeno_orbits.work import Checked


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerance(Checked):
    """Local error allowed in one step: ``absolute + relative * |y|``, entry by entry.

    Attributes:
        relative: Relative tolerance.
        absolute: Absolute tolerance, in the entry's own unit.
    """

    relative: float = 1e-12
    absolute: float = 1e-13

    def times(self, size: float) -> Tolerance:
        """Return it for entries of another size than 1: the absolute part times the size."""
        return self if size == 1.0 else replace(self, absolute=size * self.absolute)


class StageGuess(NamedTuple):
    """A guess of the stages of a step: the polynomial of another step, continued.

    Attributes:
        coefficients: Coefficients of that polynomial, powers 1 up, ``(n_stages, n_y)``.
        start: Start of the step, in units of the other step.
        ratio: Size of the step in these units.
    """

    coefficients: Vector
    start: float
    ratio: float


FIRST_ITERATIONS = 3
"""Number of Newton iterations at the begin of every implicit step. Few steps need more."""


class Corrected(NamedTuple):
    """An implicit step after its first iterations of Newton's method.

    Attributes:
        stages: Stage increments, ``(n_stages, n_y)``.
        coefficients: Coefficients of the polynomial through them, powers 1 up, ``(n_stages, n_y)``.
        after: State at the end, ``(n_y,)``.
        before: Size of the last correction but one, in units of the tolerance.
        last: Size of the last.
        error: Error of the step, in units of the tolerance.
    """

    stages: Vector
    coefficients: Vector
    after: Vector
    before: float
    last: float
    error: float


class NewtonPieces(Protocol):
    """Newton's iteration for one implicit step of a flow."""

    @property
    def scheme(self) -> Collocation:
        """The collocation scheme."""
        ...

    def begin(
        self, y: Vector, size: float, tolerance: Tolerance, guess: StageGuess | None
    ) -> Corrected:
        """Factorize the matrices of a step and return the result of its first iterations.

        Args:
            y: State before the step, ``(n_y,)``.
            size: Size of the step.
            tolerance: Unit of corrections and error.
            guess: Initial guess of the stage increments, by default zero.
        """
        ...

    def correct(self, stages: Vector) -> tuple[Vector, float]:
        """Return the stage increments after another iteration and the size of its correction."""
        ...

    def error(self, stages: Vector) -> float:
        """Return the error of the step, in units of the tolerance."""
        ...


class FlowWithEvent(Protocol):
    """One mode: a vector field and the guard whose fall through zero ends it."""

    def rate(self, y: Vector) -> Vector:
        """Return ``dy/dt``."""
        ...

    def rates(self, states: Vector) -> Vector:
        """Return ``dy/dt`` at states ``(n, n_y)``, one row each."""
        ...

    def guard(self, y: Vector) -> tuple[float, float]:
        """Return the guard and its time derivative along the flow."""
        ...

    def guards(self, states: Vector) -> Vector:
        """Return the guard at states ``(n, n_y)``, ``(n,)``."""
        ...

    def guard_rates(self, states: Vector) -> Vector:
        """Return the time derivative of the guard at states ``(n, n_y)``, ``(n,)``."""
        ...

    @property
    def is_bounded(self) -> bool:
        """True if the guard varies otherwise than the state, and its bounds in a box are known."""
        ...

    @property
    def is_carried(self) -> bool:
        """True if the guard is a state, in addition to its formula."""
        ...

    def guard_bounds(self, lower: Vector, upper: Vector, /) -> Sequence[float]:
        """Return bounds of the guard and of two derivatives over a box of states.

        Args:
            lower: Lower ends of the states, ``(n_y,)``.
            upper: Upper ends.

        Returns:
            Least and largest guard, least and largest rate, least and largest second derivative.
        """
        ...

    def attempt(self, y: Vector, size: float, tolerance: Tolerance) -> tuple[Vector, float]:
        """Return the state and the error of a DOP853 step. The error is in units of the tolerance.

        Args:
            y: State before the step, ``(n_y,)``.
            size: Size of the step, in the flow's own time.
            tolerance: Unit of the error.
        """
        ...

    def longest(self, y: Vector, /) -> float:
        """Return the largest step from a state that cannot pass a pulse of a table unseen."""
        ...

    def jacobian(self, y: Vector) -> Vector:
        """Return the derivative of the rate, ``(n_y, n_y)``."""
        ...

    def newton(self, scheme: Collocation) -> NewtonPieces:
        """Return the iteration for an implicit step of a collocation scheme."""
        ...


def flow_eigenvalues(flow: FlowWithEvent, y: Vector) -> NDArray[np.complex128]:
    """Return the eigenvalues of the Jacobian of a flow, ``(n_y,)`` [1/time].

    They are zero if the Jacobian is not finite, so the rates are then unknown. Explicit steps from
    such a state, if it is finite, end soon.
    """
    jacobian = flow.jacobian(y)
    known = jacobian if np.all(np.isfinite(jacobian)) else np.zeros_like(jacobian)
    return np.linalg.eigvals(known).astype(np.complex128)


@dataclass(frozen=True, slots=True, kw_only=True)
class PlainFlow:
    """A guarded flow made of two plain functions.

    Attributes:
        field: Function from a state ``y`` to ``dy/dt``.
        guard_and_rate: Function from ``y`` to the guard and its time derivative along the flow.
    """

    field: Callable[[Vector], Vector]
    guard_and_rate: Callable[[Vector], tuple[float, float]]

    def rate(self, y: Vector) -> Vector:
        """Return ``dy/dt``."""
        return self.field(y)

    def rates(self, states: Vector) -> Vector:
        """Return ``dy/dt`` at states ``(n, n_y)``, one row each."""
        return np.array([self.field(y) for y in states])

    def guard(self, y: Vector) -> tuple[float, float]:
        """Return the guard and its time derivative along the flow."""
        return self.guard_and_rate(y)

    def guards(self, states: Vector) -> Vector:
        """Return the guard at states ``(n, n_y)``, ``(n,)``."""
        return np.array([self.guard_and_rate(y)[0] for y in states])

    def guard_rates(self, states: Vector) -> Vector:
        """Return the time derivative of the guard at states ``(n, n_y)``, ``(n,)``."""
        return np.array([self.guard_and_rate(y)[1] for y in states])

    @property
    def is_bounded(self) -> bool:
        """False, because plain functions lack formulas."""
        return False

    @property
    def is_carried(self) -> bool:
        """False, because plain functions lack formulas."""
        return False

    def guard_bounds(self, _lower: Vector, _upper: Vector) -> Sequence[float]:
        """Return no bounds."""
        return (-math.inf, math.inf) * 3

    def attempt(self, y: Vector, size: float, tolerance: Tolerance) -> tuple[Vector, float]:
        """Return the state and the error of a DOP853 step, in units of the tolerance."""
        after, fifth, third = explicit_attempt(self.field, y, size)
        scale = tolerance.absolute + tolerance.relative * np.maximum(np.abs(y), np.abs(after))
        fifth_squared = float(np.sum((fifth / scale) ** 2))
        third_squared = float(np.sum((third / scale) ** 2))
        error = error_norm(fifth_squared, third_squared, abs(size), len(y), np)
        return after, float(error + overflow(np.sum(after), np))

    def longest(self, _y: Vector) -> float:
        """Return infinity, because plain functions lack tables."""
        return math.inf

    def jacobian(self, y: Vector) -> Vector:
        """Return the derivative of the rate by central differences, ``(n_y, n_y)``."""
        columns: list[Vector] = []
        for k in range(len(y)):
            shift = np.zeros(len(y))
            shift[k] = _DIFFERENCE * max(1.0, abs(y[k]))
            rise = self.field(y + shift) - self.field(y - shift)
            columns.append(rise / (2 * shift[k]))
        return np.stack(columns, axis=1)

    def newton(self, scheme: Collocation) -> PlainNewton:
        """Return the iteration for an implicit step of a collocation scheme."""
        return PlainNewton(self, scheme)


_DIFFERENCE = 6e-6
"""Relative displacement of a central difference: its square and rounding balance."""


class PlainNewton:
    """Newton's iteration in NumPy, for flows without symbols."""

    def __init__(self, flow: PlainFlow, scheme: Collocation) -> None:
        self._field = flow.field
        self._jacobian = flow.jacobian
        self.scheme = scheme

    def begin(
        self, y: Vector, size: float, tolerance: Tolerance, guess: StageGuess | None
    ) -> Corrected:
        """Factorize the matrices of a step and return the result of its first iterations."""
        self._y, self._size, self._tolerance = y, size, tolerance
        with np.errstate(all="ignore"):
            # If a step overflows, its NaN rejects it.
            self._slope = self._field(y)
            jacobian, eye = self._jacobian(y), np.eye(len(y))
            self._inverses = [
                np.linalg.inv(mu / size * eye - jacobian) for mu in self.scheme.spectrum.values
            ]
            stages, before = np.zeros((self.scheme.n_stages, len(y))), 0.0
            if guess is not None:
                stages = self.scheme.continued(*guess)
            for _ in range(FIRST_ITERATIONS - 1):
                stages, before = self.correct(stages)
            stages, last = self.correct(stages)
            coefficients, error = self.scheme.coefficients(stages), self.error(stages)
            return Corrected(stages, coefficients, y + stages[-1], before, last, error)

    def correct(self, stages: Vector) -> tuple[Vector, float]:
        """Return the stage increments after another iteration and the size of its correction."""
        with np.errstate(all="ignore"):
            rates = np.array([self._field(self._y + stage) for stage in stages])
            residual = rates - self.scheme.inverse @ stages / self._size
            correction = np.zeros_like(stages)
            for mu, column, row, inverse in zip(
                self.scheme.spectrum.values,
                self.scheme.spectrum.columns,
                self.scheme.spectrum.rows,
                self._inverses,
                strict=True,
            ):
                part = np.outer(column, inverse @ (row @ residual))
                correction += part.real if mu.imag == 0.0 else 2 * part.real
            return stages + correction, self._norm(correction)

    def error(self, stages: Vector) -> float:
        """Return the error of the step, in units of the tolerance."""
        gamma, weights = self.scheme.embedded
        with np.errstate(all="ignore"):
            raw = self._slope + weights @ stages / (gamma * self._size)
            error = self._norm((self._inverses[0] @ raw).real)
            return error + float(overflow(np.sum(self._y + stages[-1]), np))

    def _norm(self, change: Vector) -> float:
        tolerance = self._tolerance
        scale = tolerance.absolute + tolerance.relative * np.abs(self._y)
        return float(np.sqrt(np.mean((change / scale) ** 2)))
