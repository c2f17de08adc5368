r"""The return map of a completed system on a section, and its multipliers.

The section is the set of release states, :math:`h = \dot h = \lambda = 0`. Without holonomic
constraints its dimension is :math:`n_x - 3`. For an orbit without a release, it is the set of
states just after an impact. Source: [OrAmes2009]_, theory (3.3), (3.6).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector, eigenvalue_errors, eigenvalues
from zeno_orbits.errors import SimulationError
from zeno_orbits.model import HybridDynamics
from zeno_orbits.orbits.looser_run import relaxed_settings
from zeno_orbits.orbits.monodromy import ReturnDerivative, Sensitivity, period_derivative
from zeno_orbits.orbits.period import cycle_of, first_return, place_on_section, to_next_release
from zeno_orbits.orbits.section import RELEASE_ROWS, Section, rows_of, section_around
from zeno_orbits.orbits.shape import ONE_ZENO, EventSequence
from zeno_orbits.simulation import SimulationSettings
from zeno_orbits.work import ByValue

_DIFFERENCE = 2e-5
"""Displacement in scaled section coordinates, at which its cube equals the integration error."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Multipliers(ByValue):
    """Floquet multipliers of the return map.

    Attributes:
        values: The multipliers, the largest first.
        errors: Estimated error of each multiplier.
        jacobian: Derivative of the return map in section coordinates, ``(d, d)``.
        section: The chart of the section, or ``None`` if the multipliers are unknown.
        event: Name of the event of the section.
    """

    values: tuple[complex, ...]
    errors: tuple[float, ...]
    jacobian: Vector
    section: Section | None = None
    event: str = ""

    @classmethod
    def unknown(cls) -> Multipliers:
        """Return the multipliers of an orbit that does not return."""
        return cls(values=(), errors=(math.inf,), jacobian=np.zeros((0, 0)))

    @property
    def error(self) -> float:
        """Largest error of a multiplier. Infinite if the multipliers are unknown."""
        return max(self.errors, default=0.0)

    @property
    def spectral_radius(self) -> float:
        """Largest modulus. If it is below one, the orbit is stable."""
        return max((abs(value) for value in self.values), default=0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class SectionDerivative:
    r"""The derivative of the return map in section coordinates `y`.

    The chart moves with the section if the parameters change. So a release state at fixed
    coordinates remains a release state.

    Attributes:
        jacobian: Derivative with respect to the coordinates, ``(d, d)``.
        by_parameters: Derivative with respect to the chosen parameters at fixed coordinates,
            ``(d, k)``.
        lift: Derivative of the release state with respect to the coordinates, then the parameters,
            ``(n_x, d + k)``.
    """

    jacobian: Vector
    by_parameters: Vector
    lift: Vector

    def of(self, number: Sensitivity) -> Vector:
        """Return the gradient of a scalar in the coordinates, then the parameters, ``(d + k,)``."""
        gradient = number.by_state @ self.lift
        d = len(self.jacobian)
        return np.concatenate([gradient[:d], gradient[d:] + number.by_parameters])


def section_jacobian(
    dynamics: HybridDynamics, derivative: ReturnDerivative, scale: Vector
) -> SectionDerivative:
    r"""Return the derivative of the return map in a chart around the start of a return.

    .. math:: \frac{\partial (\phi \circ P \circ \phi^{-1})}{\partial y} =
        Z^\top S^{-1} \frac{\partial P}{\partial x} S Z

    with the tangent `Z` and the scale `S` (theory (4.5)).

    Args:
        dynamics: The system.
        derivative: Derivative of the return with respect to the state.
        scale: Size of each state, ``(n_x,)``.
    """
    section = section_around(
        dynamics, RELEASE_ROWS, derivative.start, scale, parameters=derivative.parameters
    )
    d, lift = section.dimension, section.lift
    moved = derivative.by_state @ lift
    moved[:, d:] += derivative.by_parameters
    coordinates = section.components(moved)
    return SectionDerivative(
        jacobian=coordinates[:, :d], by_parameters=coordinates[:, d:], lift=lift
    )


def poincare_map(
    dynamics: HybridDynamics, x: Vector, *, horizon: float, settings: SimulationSettings
) -> tuple[float, Vector]:
    """Return the time and state of the next release after a release.

    Args:
        dynamics: The system.
        x: A release state, ``(n_x,)``.
        horizon: Longest time to wait [s].
        settings: Accuracy.

    Raises:
        SimulationError: If a release does not occur within the horizon.
    """
    execution = to_next_release(dynamics, dynamics.on_stop(x), horizon=horizon, settings=settings)
    later = first_return(execution)
    if later is None:
        raise SimulationError("No release follows", time=horizon, state=tuple(x.tolist()))
    return later.time, later.state


def orbit_multipliers(
    dynamics: HybridDynamics,
    x: Vector,
    *,
    scale: Vector,
    period: float,
    settings: SimulationSettings,
    noise: float = 0.0,
    shape: EventSequence = ONE_ZENO,
) -> Multipliers:
    """Return the multipliers of an orbit.

    For a system with formulas, the derivatives are exact. The error estimate is their change at
    looser tolerances, one period later: an orbit that is not closed has a larger error. For a
    system without formulas, differences of the return map are used.

    Args:
        dynamics: The system.
        x: State at the start of the orbit's period, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.
        period: Period of the orbit [s].
        settings: Accuracy.
        noise: Error of a returned state, relative to ``scale``, if it is known. It is only used
            with differences.
        shape: The orbit's shape.

    Raises:
        SimulationError: If the state or a slightly displaced state does not return.
    """
    if dynamics.differentiation is None:
        near, far = _differences(dynamics, x, shape, scale=scale, period=period, settings=settings)
        jacobian, section = (4 * near - far) / 3, _section(dynamics, shape, x, scale)
        others, least = eigenvalues(near), noise / _DIFFERENCE
    else:
        jacobian, section, end = _exact_return(dynamics, x, shape, scale, period, settings)
        others, least = (), _LEAST * settings.tolerance.relative
        rough = relaxed_settings(settings, resolved=_FEWER)
        with suppress(SimulationError):
            others = eigenvalues(_exact_return(dynamics, end, shape, scale, period, rough)[0])
    values = eigenvalues(jacobian)
    return Multipliers(
        values=values,
        errors=estimated_errors(values, others, least),
        jacobian=jacobian,
        section=section,
        event=event_of(shape),
    )


def _exact_return(
    dynamics: HybridDynamics,
    x: Vector,
    shape: EventSequence,
    scale: Vector,
    period: float,
    settings: SimulationSettings,
) -> tuple[Vector, Section, Vector]:
    """Return the derivative of a return in the chart of its section, the chart, and its end."""
    found = period_derivative(dynamics, x, shape, horizon=2 * period, settings=settings)
    section = _section(dynamics, shape, found.start, scale)
    return section.components(found.by_state @ section.lift), section, found.end


def estimated_errors(
    values: Sequence[complex], others: Sequence[complex], least: float
) -> tuple[float, ...]:
    r"""Return the estimated errors of the multipliers of an orbit.

    If a period ends `d` away from its start, the orbit is :math:`d / |1 - \mu|` away to first
    order, and the change of the multipliers over the period is multiplied accordingly.

    Args:
        values: The multipliers, the largest first.
        others: Multipliers of a rougher computation that starts at the end of the period.
        least: Least error, because two computations may agree by chance.
    """
    nearest = min([1.0, *(abs(1.0 - value) for value in values)])
    farther = _SAFE / max(nearest, _AT_FOLD)
    return tuple(farther * error + least for error in eigenvalue_errors(values, others))


def event_of(shape: EventSequence) -> str:
    """Return the name of the event at which a period of a shape starts."""
    return "release" if shape.starts_at_release else "impact"


def poincare_jacobian(
    dynamics: HybridDynamics,
    x: Vector,
    *,
    scale: Vector,
    period: float,
    settings: SimulationSettings,
    shape: EventSequence = ONE_ZENO,
) -> Vector:
    r"""Return the derivative of the return map in section coordinates around a state, ``(d, d)``.

    Args:
        dynamics: The system. Without formulas, differences are used.
        x: A state of the section, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.
        period: Approximate time of the return [s].
        settings: Accuracy.
        shape: Phases of a return.

    Raises:
        SimulationError: If the state or a slightly displaced state does not return.
    """
    if dynamics.differentiation is None:
        near, far = _differences(dynamics, x, shape, scale=scale, period=period, settings=settings)
        return (4 * near - far) / 3
    return _exact_return(dynamics, x, shape, scale, period, settings)[0]


_FEWER = 10.0
"""Factor on the speed below which impacts may be omitted, in the second computation."""

_SAFE = 2.0
"""Factor on an error that is known to first order."""
_AT_FOLD = 1e-6
"""Distance of a multiplier from 1 below which an orbit is at a fold."""

_LEAST = 10.0
"""Least error estimate in units of the tolerance, because two runs may agree by chance."""


def _section(dynamics: HybridDynamics, shape: EventSequence, x: Vector, scale: Vector) -> Section:
    """Return the chart around the state at the start of a period of a shape."""
    return section_around(dynamics, rows_of(shape, dynamics.restitution), x, scale)


def _differences(
    dynamics: HybridDynamics,
    x: Vector,
    shape: EventSequence,
    *,
    scale: Vector,
    period: float,
    settings: SimulationSettings,
) -> tuple[Vector, Vector]:
    """Return the derivative of the return map by central differences, for two displacements.

    The second displacement is twice the first. Their extrapolation is accurate to fourth order.
    """
    section = _section(dynamics, shape, x, scale)

    def image(direction: int, distance: float) -> Vector:
        coordinates = np.zeros(section.dimension)
        coordinates[direction] = distance
        start = place_on_section(dynamics, shape, section.state(dynamics, coordinates))
        cycle = cycle_of(dynamics, start, shape, horizon=2 * period, settings=settings)
        return section.coordinates(cycle.end.state)

    def differences(distance: float) -> Vector:
        columns = [
            (image(k, distance) - image(k, -distance)) / (2 * distance)
            for k in range(section.dimension)
        ]
        return np.stack(columns, axis=1) if columns else np.zeros((0, 0))

    return differences(_DIFFERENCE), differences(2 * _DIFFERENCE)
