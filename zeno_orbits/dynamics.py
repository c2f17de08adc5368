"""A completed system at fixed numbers: the flows, guards and resets that a simulator needs.

Both models of a scene end here, the compiled CasADi one and a hand-written one, so a checker
cannot tell which of them it integrates.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.collocation import Collocation
from zeno_orbits.differentials import Differentiation
from zeno_orbits.errors import InputError
from zeno_orbits.runge_kutta import error_norm, explicit_attempt, overflow

Vector = NDArray[np.float64]
Scalar = Callable[[Vector], float]

_BEYOND = ": the drive's correction is as large as what it corrects; take the full scene."


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerance:
    """Local error allowed in one step: ``absolute + relative * |y|``, entry by entry.

    Attributes:
        relative: Part of an entry.
        absolute: In the entry's own unit.
    """

    relative: float = 1e-12
    absolute: float = 1e-13


class StageGuess(NamedTuple):
    """Where the stages of a step may start from: the polynomial of another step, continued.

    Attributes:
        coefficients: Of that polynomial, powers 1 up, ``(n_stages, n_y)``.
        start: Where the step starts, in units of the other one.
        ratio: Its size in these units.
    """

    coefficients: Vector
    start: float
    ratio: float


FIRST_ITERATIONS = 3
"""Newton's iterations that every implicit step begins with; few steps need another."""


class Corrected(NamedTuple):
    """An implicit step after its first iterations of Newton's method.

    Attributes:
        stages: Stage increments, ``(n_stages, n_y)``.
        coefficients: Of the polynomial through them, powers 1 up, ``(n_stages, n_y)``.
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
        """Factorize for a step and return what its first iterations give.

        Args:
            y: State before the step, ``(n_y,)``.
            size: Its size.
            tolerance: Unit of corrections and error.
            guess: What the stage increments start from; zero by default.
        """
        ...

    def correct(self, stages: Vector) -> tuple[Vector, float]:
        """Return the stage increments after one more iteration and the size of its correction."""
        ...

    def error(self, stages: Vector) -> float:
        """Return the error of the step, in units of the tolerance."""
        ...


class GuardedFlow(Protocol):
    """One mode: a vector field and the guard whose fall through zero ends it."""

    def rate(self, y: Vector) -> Vector:
        """Return ``dy/dt``."""
        ...

    def guard(self, y: Vector) -> tuple[float, float]:
        """Return the guard and its time derivative along the flow."""
        ...

    def attempt(self, y: Vector, size: float, tolerance: Tolerance) -> tuple[Vector, float]:
        """Return the state after one step of DOP853 and its error, in units of the tolerance."""
        ...

    def jacobian(self, y: Vector) -> Vector:
        """Return the derivative of the rate, ``(n_y, n_y)``."""
        ...

    def newton(self, scheme: Collocation) -> NewtonPieces:
        """Return the iteration for an implicit step of a collocation scheme."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class PlainFlow:
    """A guarded flow made of two plain functions.

    Attributes:
        field: From a state ``y`` to ``dy/dt``.
        guard_and_rate: From ``y`` to the guard and its time derivative along the flow.
    """

    field: Callable[[Vector], Vector]
    guard_and_rate: Callable[[Vector], tuple[float, float]]

    def rate(self, y: Vector) -> Vector:
        """Return ``dy/dt``."""
        return self.field(y)

    def guard(self, y: Vector) -> tuple[float, float]:
        """Return the guard and its time derivative along the flow."""
        return self.guard_and_rate(y)

    def attempt(self, y: Vector, size: float, tolerance: Tolerance) -> tuple[Vector, float]:
        """Return the state after one step of DOP853 and its error, in units of the tolerance."""
        after, fifth, third = explicit_attempt(self.field, y, size)
        scale = tolerance.absolute + tolerance.relative * np.maximum(np.abs(y), np.abs(after))
        fifth_squared = float(np.sum((fifth / scale) ** 2))
        third_squared = float(np.sum((third / scale) ** 2))
        error = error_norm(fifth_squared, third_squared, abs(size), len(y), np)
        return after, float(error + overflow(np.sum(after), np))

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
    """Newton's iteration in NumPy, for flows that have no symbols."""

    def __init__(self, flow: PlainFlow, scheme: Collocation) -> None:
        self._field = flow.field
        self._jacobian = flow.jacobian
        self.scheme = scheme

    def begin(
        self, y: Vector, size: float, tolerance: Tolerance, guess: StageGuess | None
    ) -> Corrected:
        """Factorize for a step and return what its first iterations give."""
        self._y, self._size, self._tolerance = y, size, tolerance
        with np.errstate(all="ignore"):
            # What overflows is refused by its NaN.
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
        """Return the stage increments after one more iteration and the size of its correction."""
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Resting:
    r"""A state moved onto the stop, and what happens there.

    Attributes:
        state: Gap and gap rate zero, ``(n_x,)``.
        gap_acceleration: :math:`\ddot h` of the free flow there.
        rate: :math:`\dot x` of the locked flow there, ``(n_x,)``.
    """

    state: Vector
    gap_acceleration: float
    rate: Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class FusedResting:
    """All that an impact asks of the stop in one evaluation, and the functions that it stands for.

    Attributes:
        evaluate: From a state to its rest.
        parts: What it is made of, as ``HybridDynamics.resting_parts`` lists it.
    """

    evaluate: Callable[[Vector], Resting]
    parts: tuple[object, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class HybridDynamics:
    r"""A completed hybrid system as numeric functions of the state ``x``, ``(n_x,)``.

    Attributes:
        state_names: Name of each state.
        restitution: :math:`e`.
        free: Flow off the stop; its guard is the gap.
        locked: Flow on the stop; its guard is the multiplier.
        flight: From the speed `w` after an impact to the rescaled flow of
            ``(x, h / w^2, (dh/dt) / w)`` in the scaled time ``t / w``; its guard is ``h / w^2``
            (theory (14)). It stays accurate down to ``w = 0``.
        gap: :math:`h(x)`.
        gap_rate: :math:`\dot h(x)`.
        gap_acceleration: :math:`\ddot h(x)` of the free flow.
        multiplier: :math:`\lambda(x)`.
        multiplier_rate: :math:`\dot\lambda(x)` along the locked flow.
        reset_map: State after an impact, from the state before it and its gap rate.
        impulse_direction: :math:`W J^\top / (J W J^\top)` in the velocity entries, ``(n_x,)``.
        normal_inertia: :math:`1 / (J W J^\top)`.
        energy: Mechanical and magnetic energy [J].
        holonomic: :math:`(\eta, \dot\eta)`, ``(2 n_eta,)``; zero on admissible states.
        n_q: Number of coordinates; ``x`` begins with them, then as many velocities.
        fused_resting: The method `resting` in one evaluation, if there is such a thing. It serves
            as long as the functions that it stands for are this system's own.
        differentiation: Its derivatives, if it has formulas. They serve as long, too.
    """

    state_names: tuple[str, ...]
    n_q: int
    restitution: float
    free: GuardedFlow
    locked: GuardedFlow
    flight: Callable[[float], GuardedFlow]
    gap: Scalar
    gap_rate: Scalar
    gap_acceleration: Scalar
    multiplier: Scalar
    multiplier_rate: Scalar
    reset_map: Callable[[Vector, float], Vector]
    impulse_direction: Callable[[Vector], Vector]
    normal_inertia: Scalar
    energy: Scalar
    holonomic: Callable[[Vector], Vector]
    fused_resting: FusedResting | None = None
    differentiation: Differentiation | None = None

    def __post_init__(self) -> None:
        """Refuse a restitution that is none, as a corrected drive beyond its reach has."""
        if self.fused_resting is not None and self.fused_resting.parts != self.resting_parts:
            # A part was replaced, by a wrong one in a test for instance: the whole is no longer it.
            object.__setattr__(self, "fused_resting", None)
        derivable = self.differentiation
        if derivable is not None and derivable.parts != self.derivable_parts:
            object.__setattr__(self, "differentiation", None)
        if not 0.0 <= self.restitution < 1.0:
            message = f"must lie in [0, 1) at these numbers, but it is {self.restitution:g}"
            reason = "." if not math.isnan(self.restitution) else _BEYOND
            raise InputError(f"Argument `restitution` {message}{reason}")

    @property
    def resting_parts(self) -> tuple[object, ...]:
        """The functions that `resting` is made of."""
        return (self.gap, self.gap_rate, self.gap_acceleration, self.impulse_direction, self.locked)

    @property
    def derivable_parts(self) -> tuple[object, ...]:
        """Everything that derivatives are derivatives of."""
        contact = (self.multiplier, self.multiplier_rate, self.holonomic)
        return (
            *self.resting_parts,
            *contact,
            self.free,
            self.flight,
            self.reset_map,
            self.restitution,
        )

    def resting(self, x: Vector) -> Resting:
        """Return the state moved onto the stop, as by `on_stop`, and what happens there."""
        if self.fused_resting is not None:
            return self.fused_resting.evaluate(x)
        state = self.on_stop(x)
        return Resting(
            state=state,
            gap_acceleration=self.gap_acceleration(state),
            rate=self.locked.rate(state),
        )

    def on_stop(self, x: Vector) -> Vector:
        """Return the state moved onto the stop, gap and gap rate zero, along the impulse.

        The velocity part is the plastic reset; the position part only takes away rounding.
        """
        if self.fused_resting is not None:
            return self.fused_resting.evaluate(x).state
        projected = x.copy()
        gap, direction = self.gap(projected), self.impulse_direction(projected)
        if gap != 0.0:
            n_q = self.n_q
            projected[:n_q] -= gap * direction[n_q : 2 * n_q]
            direction = self.impulse_direction(projected)
        projected -= self.gap_rate(projected) * direction
        return projected


def plain_flight(
    free_flow: Callable[[Vector], Vector], gap_acceleration: Scalar
) -> Callable[[float], GuardedFlow]:
    """Return the rescaled flights of a system given by plain functions."""

    def flight(speed: float) -> GuardedFlow:
        def field(y: Vector) -> Vector:
            x = y[:-2]
            return np.concatenate([speed * free_flow(x), [y[-1], gap_acceleration(x)]])

        return PlainFlow(field=field, guard_and_rate=lambda y: (float(y[-2]), float(y[-1])))

    return flight
