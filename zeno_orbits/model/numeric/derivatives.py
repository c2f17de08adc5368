"""Exact derivatives of a system at fixed numbers, by states and parameters.

Columns of every matrix here count states first, then the chosen parameters. Theory (24) to (27).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from zeno_orbits.arrays import Vector


class FlowDifferential(Protocol):
    """The variational equation of a flow: ``V' = J(y) V + F(y) Q`` along ``y' = f(y, q)``."""

    def step(self, y: Vector, size: float, v: Vector, q: Vector) -> tuple[Vector, float]:
        """Return ``V`` after a step of DOP853 from ``y``, ``(n_y, m)``, and its relative error.

        Args:
            y: State before the step, ``(n_y,)``.
            size: Its size.
            v: Perturbations of the state before it, ``(n_y, m)``.
            q: Perturbations of the flow's parameters, ``(n_q, m)``.
        """
        ...

    def linear(self, states: Vector) -> Vector:
        """Return ``(J, F)`` side by side at the stages of a step, ``(s, n_y, n_y + n_q)``."""
        ...


class Differentials(Protocol):
    """Derivatives of a system by its state and ``k`` chosen parameters."""

    @property
    def free(self) -> FlowDifferential:
        """Of the flow off the stop."""
        ...

    @property
    def locked(self) -> FlowDifferential:
        """Of the flow on the stop."""
        ...

    def flight(self, speed: float) -> FlowDifferential:
        """Of a rescaled flight; the speed is one more parameter, the last."""
        ...

    def contact(self, x: Vector) -> Vector:
        """Of gap, its rate and acceleration, multiplier and its rate, ``(5, n_x + k)``."""
        ...

    def holonomic(self, x: Vector) -> Vector:
        """Of the holonomic rows, ``(2 n_eta, n_x + k)``."""
        ...

    def reset(self, x: Vector, approach_rate: float) -> Vector:
        """Of the reset map by state, approach rate and parameters, ``(n_x, n_x + 1 + k)``."""
        ...

    def speed_after(self, approach_rate: float) -> Vector:
        """Of the gap rate after an impact by that before it, and by parameters, ``(1 + k,)``."""
        ...

    def resting(self, x: Vector) -> Vector:
        """Of the state moved onto the stop, its gap acceleration and its locked flow, as rows."""
        ...

    @property
    def restitution(self) -> Vector:
        """Of the restitution by the parameters alone, ``(k,)``."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Differentiation:
    """The derivatives of a system and the functions that they are derivatives of.

    Attributes:
        by: From the places of the chosen parameters in ``p`` to the derivatives.
        parts: The functions; if one of them is replaced, these derivatives are wrong.
    """

    by: Callable[[tuple[int, ...]], Differentials]
    parts: tuple[object, ...]
