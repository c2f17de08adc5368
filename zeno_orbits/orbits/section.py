r"""Sections that a return map lives on, and how they move with a parameter.

A section is where some functions of the state vanish, :math:`G(x, s) = 0`: the release set, or the
states just after an impact. Both are needed to follow orbits, one with a Zeno point, one without.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector, null_space
from zeno_orbits.errors import SimulationError
from zeno_orbits.model.numeric.derivatives import GAP, GAP_RATE, MULTIPLIER
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.orbits.monodromy import differentials_of
from zeno_orbits.orbits.shape import OrbitShape

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
    """A straight line in the space of a problem's numbers, ``p(s) = origin + s direction``.

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


@dataclass(frozen=True, slots=True, kw_only=True)
class ReleaseSection:
    """A chart of a section, mostly that of the releases, around one of its points.

    Attributes:
        rows: Rows of the contact that vanish on it.
        centre: The point, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.
        tangent: Orthonormal directions in the section, in scaled states, ``(n_x, n_section)``.
        normal: Pseudo-inverse of the scaled gradient of the conditions, ``(n_x, n_conditions)``.
    """

    rows: tuple[int, ...]
    centre: Vector
    scale: Vector
    tangent: Vector
    normal: Vector

    @property
    def dimension(self) -> int:
        """Number of section coordinates."""
        return self.tangent.shape[1]

    def coordinates(self, x: Vector) -> Vector:
        """Return the section coordinates of a state, ``(n_section,)``."""
        return self.tangent.T @ ((x - self.centre) / self.scale)

    def state(self, dynamics: HybridDynamics, coordinates: Vector) -> Vector:
        """Return the state at section coordinates, ``(n_x,)``.

        Raises:
            SimulationError: If there is none: so far from the centre the conditions have no root.
        """
        x = self.centre + self.scale * (self.tangent @ coordinates)
        for _ in range(_CHART_CORRECTIONS):
            values = conditions(dynamics, self.rows, x)
            if not np.all(np.abs(values) < _LOST):
                state = tuple(self.centre.tolist())
                raise SimulationError("The section is lost", time=0.0, state=state)
            correction = self.normal @ values
            x = x - self.scale * correction
            if np.max(np.abs(correction)) < _CHART_EXACT:
                break
        return x


_CHART_CORRECTIONS = 12
"""Newton steps at most, with the gradient at the centre; each gains what the displacement is."""

_LOST = 1e100
"""A condition that has grown so far will not be met any more."""

_CHART_EXACT = 1e-15
"""Correction in scaled states after which the next one is rounding."""


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


def release_section(dynamics: HybridDynamics, centre: Vector, scale: Vector) -> ReleaseSection:
    """Return a chart of the release section around a release state."""
    return section_around(dynamics, RELEASE_ROWS, centre, scale)


def section_around(
    dynamics: HybridDynamics, rows: tuple[int, ...], centre: Vector, scale: Vector
) -> ReleaseSection:
    """Return a chart of a section around one of its states.

    Args:
        dynamics: The system.
        rows: Rows of the contact that vanish on it.
        centre: The state, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.
    """
    gradient = conditions_slope(dynamics, rows, centre, scale)
    return ReleaseSection(
        rows=rows,
        centre=centre,
        scale=scale,
        tangent=null_space(gradient, rcond=1e-9),
        normal=np.asarray(np.linalg.pinv(gradient, rcond=1e-9), dtype=np.float64),
    )


def conditions_slope(
    dynamics: HybridDynamics, rows: tuple[int, ...], x: Vector, scale: Vector
) -> Vector:
    """Return the derivative of the conditions of a section by scaled states, ``(n, n_x)``."""
    if dynamics.differentiation is not None:
        return conditions_gradient(dynamics, (), rows, x) * scale
    step = 1e-6
    columns: list[Vector] = []
    for k in range(len(x)):
        shift = np.zeros(len(x))
        shift[k] = step * scale[k]
        ahead = conditions(dynamics, rows, x + shift)
        rise = ahead - conditions(dynamics, rows, x - shift)
        columns.append(rise / (2 * step))
    return np.stack(columns, axis=1)
