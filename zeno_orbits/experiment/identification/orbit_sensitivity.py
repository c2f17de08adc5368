r"""Derivatives of a whole periodic orbit with respect to parameters, at equal times since release.

The release state of the orbit satisfies :math:`y = P(y, p)` in section coordinates, so

.. math:: \frac{dy}{dp} = \Bigl(1 - \frac{\partial P}{\partial y}\Bigr)^{-1}
    \frac{\partial P}{\partial p}

The derivative of the motion with respect to its initial state and `p` is propagated along the arcs
and through every impact and the Zeno point. It gives :math:`dx(t)/dp` at all times (theory (6.11)).
At an event that moves by :math:`\delta t` an equal time means :math:`\delta x - f\,\delta t`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.orbit_table import CubicColumns
from zeno_orbits.model import HybridDynamics
from zeno_orbits.orbits import return_derivative, section_jacobian
from zeno_orbits.simulation import EventDerivatives, Execution, Mode, SimulationSettings

_PARTS = 3
"""Nodes in a step of the integrator: between them the derivatives are cubic."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OrbitSlope:
    """Derivatives of a periodic orbit with respect to chosen parameters.

    Attributes:
        period: Derivative of the period, ``(k,)``.
        release: Derivative of the release state, ``(n_x, k)``.
        states: Derivatives of the states over time from the release, column by column, ``n_x k``.
    """

    period: Vector
    release: Vector
    states: CubicColumns

    def at(self, times: Vector) -> Vector:
        """Return the derivatives of the states at times since the release, ``(n, n_x, k)``."""
        return self.states.at(times).reshape(len(times), *self.release.shape)


def orbit_slope(
    dynamics: HybridDynamics,
    release: Vector,
    *,
    scale: Vector,
    period: float,
    chosen: tuple[int, ...],
    settings: SimulationSettings,
) -> OrbitSlope:
    """Return the derivatives of a periodic orbit with respect to chosen parameters.

    Args:
        dynamics: The system at the orbit's parameter values, with formulas.
        release: The orbit's release state, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.
        period: Period of the orbit [s].
        chosen: Indices of the parameters in ``p``.
        settings: Accuracy of the simulation.

    Raises:
        SimulationError: If the orbit is not periodic in simulation, or not differentiable.
    """
    derivative = return_derivative(
        dynamics, release, horizon=2 * period, settings=settings, parameters=chosen
    )
    section = section_jacobian(dynamics, derivative, scale)
    d, k = len(section.jacobian), len(chosen)
    matrix = np.eye(d) - section.jacobian
    coordinates = np.linalg.solve(matrix, section.by_parameters) if d else np.zeros((0, k))
    start = section.lift @ np.concatenate([coordinates, np.eye(k)])
    by_period = derivative.period.by_state @ start + derivative.period.by_parameters
    whole = np.concatenate([start, np.eye(k)])
    pieces = [
        (times, (moved @ whole).reshape(len(times), -1), (slopes @ whole).reshape(len(times), -1))
        for times, moved, slopes in _along(
            EventDerivatives(dynamics, chosen, settings.tolerance),
            derivative.execution,
            derivative.period.value,
        )
    ]
    times, values, slopes = (np.concatenate(rows) for rows in zip(*pieces, strict=True))
    return OrbitSlope(
        period=by_period,
        release=start,
        states=CubicColumns(times=times, values=values, slopes=slopes),
    )


_Piece = tuple[Vector, Vector, Vector]
"""Times since the release, derivatives of the state at these times, and their slopes in time."""


def _along(derivatives: EventDerivatives, execution: Execution, period: float) -> Iterator[_Piece]:
    """Yield the state derivatives at equal times, from the release to the next release."""
    # A start that locks by rounding is released at once.
    first = int(execution.arcs[0].mode is Mode.LOCKED)
    for passage in derivatives.passages(execution, first=first):
        if passage.arc.start_time >= period:
            return
        piece = derivatives.at_equal_times(passage, parts=_PARTS)
        if piece is not None:
            yield piece
