r"""Exact derivatives of a system, with respect to states and chosen parameters.

Along :math:`\dot y = f(y, q)` a perturbation satisfies the variational equation

.. math:: \dot V = \frac{\partial f}{\partial y}\,V + \frac{\partial f}{\partial q}\,Q

(theory (4.2)). Columns of every matrix here count states first, then the chosen parameters.
Theory (4.2) to (4.5).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import casadi as ca

from zeno_orbits.arrays import Vector


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinearFormula:
    """The variational equation of a mode: the entries of ``(J, F)`` that do not vanish.

    Attributes:
        entries: ``(y, p) -> entries``, ``(n,)``.
        rows: Row of each entry, in order, ``(n,)``.
        columns: Column of each entry, first the states and then the parameters, ``(n,)``.
        blocks: Sets of mutually dependent states, in an order in which each set follows the sets it
            depends on.
    """

    entries: ca.Function
    rows: tuple[int, ...]
    columns: tuple[int, ...]
    blocks: tuple[tuple[int, ...], ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class DerivativeFormulas:
    """Derivatives of a system with respect to its states and chosen parameters, as formulas.

    Attributes:
        chosen: Indices of the parameters in ``p``.
        n_x: Number of states.
        linear: Variational equations of the free and the constrained mode and of a rescaled flight,
            whose speed is an additional last parameter.
        contact: ``(x, p) -> (5, n_x + k)``, as `Differentials.contact`. The next four entries are
            analogous.
        holonomic: ``(x, p) -> (2 n_eta, n_x + k)``.
        reset: ``(x, p, approach rate) -> (n_x, n_x + 1 + k)``.
        rebound: ``(p, approach rate) -> (1, 1 + k)``.
        resting: ``(x, p) -> (2 n_x + 1, n_x + k)``.
        restitution: ``(x, p) -> (1, k)``.
    """

    chosen: tuple[int, ...]
    n_x: int
    linear: tuple[LinearFormula, LinearFormula, LinearFormula]
    contact: ca.Function
    holonomic: ca.Function
    reset: ca.Function
    rebound: ca.Function
    resting: ca.Function
    restitution: ca.Function


class FlowDifferential(Protocol):
    """The variational equation of a flow: ``V' = J(y) V + F(y) Q`` along ``y' = f(y, q)``."""

    def linear(self, states: Vector) -> Vector:
        """Return ``(J, F)`` side by side at every state, ``(s, n_y, n_y + n_q)``.

        Args:
            states: ``(s, n_y)``.
        """
        ...


class Differentials(Protocol):
    """Derivatives of a system with respect to its state and ``k`` parameters, at given values."""

    @property
    def formulas(self) -> DerivativeFormulas:
        """The same as formulas."""
        ...

    @property
    def free(self) -> FlowDifferential:
        """Of the flow off the stop."""
        ...

    @property
    def locked(self) -> FlowDifferential:
        """Of the flow on the stop."""
        ...

    def flight(self, speed: float) -> FlowDifferential:
        """Return the derivatives of a rescaled flight, with its speed as the last parameter."""
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
        """Of the state moved onto the stop, its gap acceleration and constrained flow, as rows."""
        ...

    @property
    def restitution(self) -> Vector:
        """Of the restitution by the parameters alone, ``(k,)``."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Differentiation:
    """The derivatives of a system and the differentiated functions.

    Attributes:
        by: Function from the indices of the chosen parameters in ``p`` to the derivatives.
        parts: The functions. If any of them is replaced, these derivatives are wrong.
    """

    by: Callable[[tuple[int, ...]], Differentials]
    parts: tuple[object, ...]
