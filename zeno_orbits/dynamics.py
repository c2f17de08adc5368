"""A completed system at fixed numbers: the flows, guards and resets that a simulator needs.

Both models of a scene end here, the compiled CasADi one and a hand-written one, so a checker
cannot tell which of them it integrates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.runge_kutta import error_norm, explicit_attempt

Vector = NDArray[np.float64]
Scalar = Callable[[Vector], float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerance:
    """Local error allowed in one step: ``absolute + relative * |y|``, entry by entry."""

    relative: float = 1e-12
    absolute: float = 1e-13


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


@dataclass(frozen=True, slots=True, kw_only=True)
class PlainFlow:
    """A guarded flow made of two plain functions."""

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
        return after, float(error_norm(fifth_squared, third_squared, abs(size), len(y), np))


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

    def on_stop(self, x: Vector) -> Vector:
        """Return the state moved onto the stop, gap and gap rate zero, along the impulse.

        The velocity part is the plastic reset; the position part only takes away rounding.
        """
        projected = x.copy()
        direction = self.impulse_direction(projected)
        n_q = self.n_q
        projected[:n_q] -= self.gap(projected) * direction[n_q : 2 * n_q]
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
