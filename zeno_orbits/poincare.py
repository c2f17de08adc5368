r"""The return map of a completed system on its release section, and its multipliers.

The section is the set of release states, :math:`h = \dot h = \lambda = 0`, of dimension
:math:`n_x - 3` without holonomic constraints. Source: [OrAmes2009]_, theory (18).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zeno_orbits.dynamics import HybridDynamics, Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.execution import Execution
from zeno_orbits.linear_algebra import null_space
from zeno_orbits.simulate import SimulationSettings, simulate


@dataclass(frozen=True, slots=True, kw_only=True)
class ReleaseSection:
    """A chart of the release section around one of its points.

    Attributes:
        centre: The point, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.
        tangent: Orthonormal directions in the section, in scaled states, ``(n_x, n_section)``.
        normal: Pseudo-inverse of the scaled gradient of the conditions, ``(n_x, n_conditions)``.
    """

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
        """Return the release state at section coordinates, ``(n_x,)``."""
        x = self.centre + self.scale * (self.tangent @ coordinates)
        for _ in range(_CORRECTIONS):
            correction = self.normal @ _conditions(dynamics, x)
            x = x - self.scale * correction
            if np.max(np.abs(correction)) < _EXACT:
                break
        return x


_CORRECTIONS = 12
"""Newton steps at most, with the gradient at the centre; each gains what the displacement is."""

_EXACT = 1e-15
"""Correction in scaled states after which the next one is rounding."""

_DIFFERENCE = 2e-5
"""Displacement in scaled section coordinates: its cube and the integration error balance."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Multipliers:
    """Floquet multipliers of the return map.

    Attributes:
        values: The multipliers, the largest first.
        error: Estimated error of the largest.
        jacobian: Derivative of the return map in section coordinates.
    """

    values: tuple[complex, ...]
    error: float
    jacobian: Vector

    @property
    def spectral_radius(self) -> float:
        """Largest modulus; below one the orbit attracts."""
        return max((abs(value) for value in self.values), default=0.0)


def release_section(dynamics: HybridDynamics, centre: Vector, scale: Vector) -> ReleaseSection:
    """Return a chart of the release section around a release state."""
    step = 1e-6
    columns: list[Vector] = []
    for k in range(len(centre)):
        shift = np.zeros(len(centre))
        shift[k] = step * scale[k]
        rise = _conditions(dynamics, centre + shift) - _conditions(dynamics, centre - shift)
        columns.append(rise / (2 * step))
    gradient = np.stack(columns, axis=1)
    return ReleaseSection(
        centre=centre,
        scale=scale,
        tangent=null_space(gradient, rcond=1e-9),
        normal=np.asarray(np.linalg.pinv(gradient, rcond=1e-9), dtype=np.float64),
    )


def to_next_release(
    dynamics: HybridDynamics, x: Vector, *, horizon: float, settings: SimulationSettings
) -> Execution:
    """Return the execution from a release until the next one, or to the horizon without any.

    Args:
        dynamics: The system.
        x: A release state, on the stop, ``(n_x,)``.
        horizon: Longest time to wait [s].
        settings: Accuracy.

    Raises:
        SimulationError: If the execution cannot be continued so far.
    """
    execution = simulate(dynamics, x, until=horizon, releases=1, settings=settings)
    if execution.releases and not execution.returns(horizon):
        # The start was locked by a rounding error and released at once: the next one is meant.
        execution = simulate(dynamics, x, until=horizon, releases=2, settings=settings)
    return execution


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
        SimulationError: If there is no release within the horizon.
    """
    execution = to_next_release(dynamics, dynamics.on_stop(x), horizon=horizon, settings=settings)
    later = execution.returns(horizon)
    if not later:
        raise SimulationError("There is no next release", time=horizon, state=tuple(x.tolist()))
    return later[0].time, later[0].state


def floquet_multipliers(
    dynamics: HybridDynamics,
    x: Vector,
    *,
    scale: Vector,
    period: float,
    settings: SimulationSettings,
    noise: float = 0.0,
) -> Multipliers:
    """Return the multipliers of an orbit by differences of the return map.

    Central differences at two displacements are combined to fourth order; the change that this
    makes, and what the noise of a return makes of it, estimate the error.

    Args:
        dynamics: The system.
        x: Release state of the orbit, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.
        period: Period of the orbit [s].
        settings: Accuracy.
        noise: Error of a returned state, relative to ``scale``, if it is known.

    Raises:
        SimulationError: If a displaced state does not return.
    """
    section = release_section(dynamics, x, scale)

    def image(direction: int, distance: float) -> Vector:
        coordinates = np.zeros(section.dimension)
        coordinates[direction] = distance
        start = section.state(dynamics, coordinates)
        _, end = poincare_map(dynamics, start, horizon=2 * period, settings=settings)
        return section.coordinates(end)

    def differences(distance: float) -> Vector:
        columns = [
            (image(k, distance) - image(k, -distance)) / (2 * distance)
            for k in range(section.dimension)
        ]
        return np.stack(columns, axis=1) if columns else np.zeros((0, 0))

    near, far = differences(_DIFFERENCE), differences(2 * _DIFFERENCE)
    jacobian = (4 * near - far) / 3
    values = sorted(np.linalg.eigvals(jacobian), key=abs, reverse=True)
    rough = sorted(np.linalg.eigvals(near), key=abs, reverse=True)
    change = max((abs(a - b) for a, b in zip(values, rough, strict=True)), default=0.0)
    error = change + noise / _DIFFERENCE
    return Multipliers(
        values=tuple(complex(value) for value in values), error=float(error), jacobian=jacobian
    )


def _conditions(dynamics: HybridDynamics, x: Vector) -> Vector:
    contact = [dynamics.gap(x), dynamics.gap_rate(x), dynamics.multiplier(x)]
    return np.concatenate([contact, dynamics.holonomic(x)])
