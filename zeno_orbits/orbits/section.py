r"""Sections of a return map, their charts, and their motion with a parameter.

A section is the set where some functions of the state vanish, :math:`G(x, p) = 0`: the release
states, or the states just after an impact. Source: theory (2.4), (4.5), (3.5).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from zeno_orbits.arrays import Vector, null_space
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model import GAP, GAP_RATE, MULTIPLIER, Differentials, HybridDynamics

RELEASE_ROWS = (GAP, GAP_RATE, MULTIPLIER)
"""Conditions of a release, theory (2.4)."""
IMPACT_ROWS = (GAP,)
"""Conditions of a state just after an impact."""
REST_ROWS = (GAP, GAP_RATE)
"""Conditions of a state just after a plastic impact."""

_RANK = 1e-9
"""Relative singular value below which conditions depend on each other."""
_MOST_CORRECTIONS = 20
_EXACT = 4e-16
_OFF = 1e-9
_CHART_CORRECTIONS = 12
"""Largest number of Newton steps with the gradient at the centre.

Each step reduces the error by a factor of the displacement's size.
"""
_LOST = 1e100
"""Size of a condition beyond which a root is not expected."""
_CHART_EXACT = 1e-15
"""Correction in scaled states after which the next correction is rounding."""
_DIFFERENCE = 1e-6
"""Displacement in scaled states for a system without formulas."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A straight line in the parameter space of a problem, ``p(s) = origin + s direction``.

    Attributes:
        origin: ``p`` at ``s = 0``, ``(n_p,)``.
        direction: Its derivative, ``(n_p,)``.
    """

    origin: Vector
    direction: Vector

    @property
    def moving(self) -> tuple[int, ...]:
        """Indices in ``p`` of the parameters that change along the line."""
        return tuple(int(k) for k in np.flatnonzero(self.direction))

    @property
    def slopes(self) -> Vector:
        """Derivatives of the changing parameters with respect to ``s``."""
        return self.direction[list(self.moving)]

    def at(self, s: float) -> Vector:
        """Return ``p(s)``."""
        return self.origin + s * self.direction


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    r"""A chart of a section around one of its points.

    With the scale `S` and the tangent `Z`, coordinates are :math:`y = Z^\top S^{-1} (x - x_0)`.

    Attributes:
        rows: Rows of the contact that vanish on the section.
        centre: The point `x_0`, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.
        tangent: Orthonormal directions in the section, in scaled states, ``(n_x, d)``.
        normal: Pseudo-inverse of the scaled gradient of the conditions, ``(n_x, n_conditions)``.
        drift: Derivative of the state at fixed coordinates with respect to the parameters of the
            chart, ``(n_x, k)``.
    """

    rows: tuple[int, ...]
    centre: Vector
    scale: Vector
    tangent: Vector
    normal: Vector
    drift: Vector

    @property
    def dimension(self) -> int:
        """Number of section coordinates."""
        return self.tangent.shape[1]

    @property
    def lift(self) -> Vector:
        """Derivative of the state in the coordinates, then the parameters, ``(n_x, d + k)``."""
        return np.concatenate([self.scale[:, None] * self.tangent, self.drift], axis=1)

    def coordinates(self, x: Vector) -> Vector:
        """Return the section coordinates of a state, ``(d,)``."""
        return self.components(x - self.centre)

    def components(self, change: Vector) -> Vector:
        """Return the coordinates of a difference of states, ``(n_x,)`` or ``(n_x, m)``."""
        return self.tangent.T @ (change.T / self.scale).T

    def state(self, dynamics: HybridDynamics, coordinates: Vector) -> Vector:
        """Return the state at section coordinates, ``(n_x,)``.

        Raises:
            SimulationError: If the conditions do not have a root this far from the centre.
        """
        return self.root(partial(conditions, dynamics, self.rows), coordinates)

    def root(
        self,
        conditions_at: Callable[[Vector], Vector],
        coordinates: Vector,
        gradient_at: Callable[[Vector], Vector] | None = None,
    ) -> Vector:
        """Return the state at section coordinates where given conditions vanish, ``(n_x,)``.

        Args:
            conditions_at: Conditions of the section at a state, ``(n_conditions,)``.
            coordinates: The coordinates, ``(d,)``.
            gradient_at: Their gradient at a state, ``(n_conditions, n_x)``. The default is that at
                the centre, with which Newton's method converges nearby.

        Raises:
            SimulationError: If the conditions do not have a root this far from the centre.
        """
        x = self.centre + self.scale * (self.tangent @ coordinates)
        for _ in range(_CHART_CORRECTIONS):
            values = conditions_at(x)
            if not np.all(np.abs(values) < _LOST):
                state = tuple(self.centre.tolist())
                raise SimulationError(
                    "Newton's method diverges from the section", time=0.0, state=state
                )
            if gradient_at is not None:
                along = gradient_at(x) * self.scale @ self.normal
                values = np.linalg.pinv(along, rcond=_RANK) @ values
            correction = self.normal @ values
            x = x - self.scale * correction
            if np.max(np.abs(correction)) < _CHART_EXACT:
                break
        return x


def section_around(
    dynamics: HybridDynamics,
    rows: tuple[int, ...],
    centre: Vector,
    scale: Vector,
    *,
    parameters: tuple[int, ...] = (),
) -> Section:
    """Return a chart of a section around one of its states.

    Args:
        dynamics: The system. With ``parameters`` it must have formulas.
        rows: Rows of the contact that vanish on the section.
        centre: The state, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.
        parameters: Indices in ``p`` of the parameters with which the section moves, ``(k,)``.
    """
    gradient = _scaled_gradient(dynamics, rows, centre, scale)
    section = replace(section_of(gradient, centre, scale), rows=rows)
    if not parameters:
        return section
    slopes = conditions_gradient(dynamics, parameters, rows, centre)[:, centre.size :]
    return replace(section, drift=-scale[:, None] * (section.normal @ slopes))


def section_of(gradient: Vector, centre: Vector, scale: Vector) -> Section:
    """Return a chart of the set where some conditions vanish, around one of its states.

    Args:
        gradient: Gradient of the conditions in the scaled states, ``(n_conditions, n_x)``.
        centre: The state, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.
    """
    sizes = _row_sizes(gradient)
    return Section(
        rows=(),
        centre=centre,
        scale=scale,
        tangent=null_space(gradient / sizes, rcond=_RANK),
        normal=_pseudo_inverse(gradient, sizes),
        drift=np.zeros((centre.size, 0)),
    )


def project_to_section(
    dynamics: HybridDynamics, rows: tuple[int, ...], x: Vector, scale: Vector
) -> Vector:
    """Return the state of the section nearest to a state, in scaled states, ``(n_x,)``.

    Args:
        dynamics: The system.
        rows: Rows of the contact that vanish on the section.
        x: The state, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.

    Raises:
        SimulationError: If Newton's method does not reach the section.
    """
    size = np.inf
    for _ in range(_MOST_CORRECTIONS):
        gradient = conditions_gradient(dynamics, (), rows, x) * scale
        inverse = _pseudo_inverse(gradient, _row_sizes(gradient))
        correction = inverse @ conditions(dynamics, rows, x)
        x = x - scale * correction
        size = float(np.max(np.abs(correction)))
        if size <= _EXACT:
            return x
    if not size <= _OFF:
        raise SimulationError("A section cannot be placed here", time=0.0, state=tuple(x.tolist()))
    return x


def _row_sizes(gradient: Vector) -> Vector:
    """Return the size of each row, ``(n, 1)``, because conditions have different units.

    Args:
        gradient: Gradient of the conditions with respect to the scaled states, ``(n, n_x)``.
    """
    sizes = np.linalg.norm(gradient, axis=1, keepdims=True)
    return np.where(sizes > 0.0, sizes, 1.0)


def _pseudo_inverse(gradient: Vector, sizes: Vector) -> Vector:
    """Return the pseudo-inverse of a gradient with rows of given sizes, ``(n_x, n)``."""
    inverse = np.linalg.pinv(gradient / sizes, rcond=_RANK)
    return np.asarray(inverse / sizes[:, 0], dtype=np.float64)


def differentials_of(dynamics: HybridDynamics, chosen: tuple[int, ...]) -> Differentials:
    """Return the derivatives of a system with respect to its states and chosen parameters.

    Raises:
        InputError: If the system does not have formulas.
    """
    if dynamics.differentiation is None:
        raise InputError("Argument `dynamics` must have formulas, but it has plain functions.")
    return dynamics.differentiation.by(chosen)


def conditions(dynamics: HybridDynamics, rows: tuple[int, ...], x: Vector) -> Vector:
    """Return the conditions of a section: rows of the contact, then holonomic constraints.

    They vanish on the section.

    Args:
        dynamics: The system.
        rows: Rows of the contact.
        x: A state, ``(n_x,)``.
    """
    contact = {GAP: dynamics.gap, GAP_RATE: dynamics.gap_rate, MULTIPLIER: dynamics.multiplier}
    return np.concatenate([[contact[row](x) for row in rows], dynamics.holonomic(x)])


def conditions_gradient(
    dynamics: HybridDynamics, chosen: tuple[int, ...], rows: tuple[int, ...], x: Vector
) -> Vector:
    """Return the gradient of the conditions in states and parameters, ``(n, n_x + k)``.

    Args:
        dynamics: The system.
        chosen: Indices in ``p`` of the parameters, ``(k,)``.
        rows: Rows of the contact that vanish on the section.
        x: A state, ``(n_x,)``.

    Raises:
        InputError: If the system does not have formulas.
    """
    differentials = differentials_of(dynamics, chosen)
    return np.concatenate([differentials.contact(x)[list(rows)], differentials.holonomic(x)])


def _scaled_gradient(
    dynamics: HybridDynamics, rows: tuple[int, ...], x: Vector, scale: Vector
) -> Vector:
    """Return the gradient of the conditions in the scaled states, ``(n, n_x)``."""
    if dynamics.differentiation is not None:
        return conditions_gradient(dynamics, (), rows, x) * scale
    columns: list[Vector] = []
    for k in range(len(x)):
        shift = np.zeros(len(x))
        shift[k] = _DIFFERENCE * scale[k]
        rise = conditions(dynamics, rows, x + shift) - conditions(dynamics, rows, x - shift)
        columns.append(rise / (2 * _DIFFERENCE))
    return np.stack(columns, axis=1)


def coordinates_of(tangent: Vector) -> list[int]:
    """Return the indices of the states that determine a point of a section best.

    Args:
        tangent: Directions in the section, in scaled states, ``(n_x, d)``.
    """
    chosen: list[int] = []
    rest = tangent.copy()
    for _ in range(tangent.shape[1]):
        # The state that changes most while the chosen states do not.
        sizes = np.linalg.norm(rest, axis=1)
        chosen.append(int(np.argmax(sizes)))
        along = rest[chosen[-1]] / sizes[chosen[-1]]
        rest = rest - np.outer(rest @ along, along)
    return sorted(chosen)
