r"""Sections that a return map lives on, and how they move with a parameter.

A section is where some functions of the state vanish, :math:`G(x, s) = 0`: the release set, or the
states just after an impact. Both are needed to follow orbits, one with a Zeno point, one without.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zeno_orbits.differentials import GAP, GAP_RATE, MULTIPLIER
from zeno_orbits.dynamics import HybridDynamics, Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.linear_algebra import null_space
from zeno_orbits.monodromy import differentials_of
from zeno_orbits.shape import OrbitShape

RELEASE_ROWS = (GAP, GAP_RATE, MULTIPLIER)
"""Conditions of a release, theory (12)."""
IMPACT_ROWS = (GAP,)
"""Conditions of a state just after an impact."""
REST_ROWS = (GAP, GAP_RATE)
"""Conditions of a state just after a plastic impact."""

_MOST_CORRECTIONS = 20
_EXACT = 4e-16
_OFF = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A straight line in the space of a scene's numbers, ``p(s) = origin + s direction``.

    Attributes:
        origin: ``p`` at ``s = 0``, ``(n_p,)``.
        direction: Its derivative, ``(n_p,)``.
    """

    origin: Vector
    direction: Vector

    @property
    def moving(self) -> tuple[int, ...]:
        """Places in ``p`` of the numbers that change along it."""
        return tuple(int(k) for k in np.flatnonzero(self.direction))

    @property
    def slopes(self) -> Vector:
        """How fast those change."""
        return self.direction[list(self.moving)]

    def at(self, s: float) -> Vector:
        """Return ``p(s)``."""
        return self.origin + s * self.direction


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    r"""The section around one of its states.

    Attributes:
        tangent: Orthonormal directions in it, in scaled states, ``(n_x, d)``.
        lift: Derivative of the state on the section by coordinates, then by `s`, ``(n_x, d + 1)``.
        scale: Size of each state, ``(n_x,)``.
    """

    tangent: Vector
    lift: Vector
    scale: Vector

    def coordinates(self, change: Vector) -> Vector:
        """Return section coordinates of a difference of states, ``(d,)`` or ``(d, m)``."""
        return self.tangent.T @ (change.T / self.scale).T


def rows_of(shape: OrbitShape, restitution: float) -> tuple[int, ...]:
    """Return the conditions of where a period of a shape starts (theory (44))."""
    if shape.starts_at_release:
        return RELEASE_ROWS
    return REST_ROWS if restitution == 0.0 else IMPACT_ROWS


def frame(
    dynamics: HybridDynamics, line: Line, rows: tuple[int, ...], x: Vector, scale: Vector
) -> Frame:
    """Return the section around a state that lies on it.

    Args:
        dynamics: The system at ``p(s)``.
        line: The line.
        rows: Rows of the contact that vanish on the section.
        x: The state, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.
    """
    gradient = conditions_gradient(dynamics, line.moving, rows, x)
    by_state, by_parameter = gradient[:, : x.size] * scale, gradient[:, x.size :] @ line.slopes
    tangent = null_space(by_state, rcond=1e-9)
    drift = -np.linalg.pinv(by_state, rcond=1e-9) @ by_parameter
    lift = scale[:, None] * np.concatenate([tangent, drift[:, None]], axis=1)
    return Frame(tangent=tangent, lift=lift, scale=scale)


def projected(dynamics: HybridDynamics, rows: tuple[int, ...], x: Vector, scale: Vector) -> Vector:
    """Return the state of the section nearest to a state, in scaled states, ``(n_x,)``.

    Raises:
        SimulationError: If Newton's method does not reach the section.
    """
    size = np.inf
    for _ in range(_MOST_CORRECTIONS):
        gradient = conditions_gradient(dynamics, (), rows, x) * scale
        correction = np.linalg.pinv(gradient, rcond=1e-9) @ conditions(dynamics, rows, x)
        x = x - scale * correction
        size = float(np.max(np.abs(correction)))
        if size <= _EXACT:
            return x
    if not size <= _OFF:
        raise SimulationError("There is no section here", time=0.0, state=tuple(x.tolist()))
    return x


def conditions(dynamics: HybridDynamics, rows: tuple[int, ...], x: Vector) -> Vector:
    """Return what vanishes on a section: rows of the contact, and the holonomic constraints."""
    contact = {GAP: dynamics.gap, GAP_RATE: dynamics.gap_rate, MULTIPLIER: dynamics.multiplier}
    return np.concatenate([[contact[row](x) for row in rows], dynamics.holonomic(x)])


def conditions_gradient(
    dynamics: HybridDynamics, chosen: tuple[int, ...], rows: tuple[int, ...], x: Vector
) -> Vector:
    """Return its derivative by states and chosen parameters, ``(n, n_x + k)``.

    Raises:
        InputError: If the system has no formulas.
    """
    differentials = differentials_of(dynamics, chosen)
    return np.concatenate([differentials.contact(x)[list(rows)], differentials.holonomic(x)])
