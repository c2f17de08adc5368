r"""Derivatives of a whole periodic orbit by parameters, at equal times since its release.

The release state of the orbit obeys :math:`y = P(y, p)` in section coordinates, so

.. math:: \frac{dy}{dp} = \Bigl(1 - \frac{\partial P}{\partial y}\Bigr)^{-1}
    \frac{\partial P}{\partial p}

and with the derivative of the motion by its start and by `p`, carried along the arcs and through
every impact and the Zeno point, :math:`dx(t)/dp` follows at all times (theory (58)). At an event
that moves by :math:`\delta t` an equal time means :math:`\delta x - f\,\delta t`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.orbit_table import CubicColumns
from zeno_orbits.model import N_STAGES, Differentials, HybridDynamics
from zeno_orbits.orbits import differentials_of, return_derivative, section_derivative
from zeno_orbits.simulation import (
    Arc,
    Bounce,
    Ending,
    EventShift,
    Execution,
    Impact,
    Mode,
    Perturbations,
    SimulationSettings,
    ZenoPoint,
    courses,
)

_PARTS = 3
"""Nodes in a step of the integrator: between them the derivatives are cubic."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OrbitSlope:
    """Derivatives of a periodic orbit by chosen parameters.

    Attributes:
        period: Of the period, ``(k,)``.
        release: Of the release state, ``(n_x, k)``.
        states: Of the states over time from the release, column by column, ``n_x k`` of them.
        conditioning: Condition number of ``1 - dP/dy``; it grows where the family folds.
    """

    period: Vector
    release: Vector
    states: CubicColumns
    conditioning: float

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
    """Return the derivatives of a periodic orbit by chosen parameters.

    Args:
        dynamics: The system at the orbit's numbers; it must have formulas.
        release: The orbit's release state, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.
        period: Of the orbit [s].
        chosen: Places in ``p`` of the parameters.
        settings: Accuracy.

    Raises:
        SimulationError: If the orbit does not return, or is not differentiable.
    """
    derivative = return_derivative(
        dynamics, release, horizon=2 * period, settings=settings, parameters=chosen
    )
    section = section_derivative(dynamics, derivative, scale)
    d, k = len(section.jacobian), len(chosen)
    matrix = np.eye(d) - section.jacobian
    coordinates = np.linalg.solve(matrix, section.by_parameters) if d else np.zeros((0, k))
    start = section.lift @ np.concatenate([coordinates, np.eye(k)])
    by_period = derivative.period.by_state @ start + derivative.period.by_parameters
    perturbations = Perturbations(
        dynamics=dynamics,
        differentials=differentials_of(dynamics, chosen),
        n_parameters=k,
        tolerance=settings.tolerance,
    )
    whole = np.concatenate([start, np.eye(k)])
    pieces = [
        (time, v @ whole, slope @ whole)
        for time, v, slope in _along(perturbations, derivative.execution, derivative.period.value)
    ]
    times, values, slopes = zip(*pieces, strict=True)
    return OrbitSlope(
        period=by_period,
        release=start,
        states=CubicColumns(
            times=np.array(times),
            values=np.array([value.ravel() for value in values]),
            slopes=np.array([slope.ravel() for slope in slopes]),
        ),
        conditioning=float(np.linalg.cond(matrix)) if d else 1.0,
    )


_Node = tuple[float, Vector, Vector]
"""Time since the release, derivative of the state at that time, and its slope in time."""


def _along(perturbations: Perturbations, execution: Execution, period: float) -> Iterator[_Node]:
    """Yield how the state moves at equal times, from the release to the next one."""
    arcs = [arc for arc in execution.arcs if arc.start_time < period]
    if arcs[0].mode is Mode.LOCKED:
        # A start that locks by rounding is released at once.
        arcs.pop(0)
    flights = [arc for arc in arcs if arc.ending is Ending.IMPACT]
    impacts = [event for event in execution.events if isinstance(event, Impact)]
    zeno = next(event for event in execution.events if isinstance(event, ZenoPoint))
    here = perturbations.at_start()
    bounces: list[Bounce] = []
    for arc, impact in zip(flights, impacts, strict=False):
        yield from _in_flight(perturbations, arc, here)
        here = perturbations.struck(impact, perturbations.flown(arc, here))
        bounces = perturbations.joined(bounces, impact, here)
    limit = perturbations.limit(bounces, zeno.state)
    yield from _locked(perturbations, arcs[-1], limit)


def _in_flight(perturbations: Perturbations, arc: Arc, here: EventShift) -> Iterator[_Node]:
    n_x, free = perturbations.n_x, perturbations.dynamics.free
    differentials, end = perturbations.differentials, arc.flow_state_at(arc.duration)
    speed = np.zeros_like(here.time)
    if end.size == n_x:
        flow, differential, v, q = free, differentials.free, here.state, perturbations.parameters
    else:
        flow = perturbations.dynamics.flight(arc.time_unit)
        differential = differentials.flight(arc.time_unit)
        v = np.concatenate([here.state, np.zeros((2, here.time.size))])
        q = np.concatenate([perturbations.parameters, here.rate[None, :]])
        speed = here.rate
    course = [
        (0.0, v),
        *courses(flow, differential, arc, perturbations.tolerance, v, q, parts=_PARTS),
    ]
    for offset, shift in course:
        x = arc.flow_state_at(offset)[:n_x]
        moved = shift[:n_x] - free.rate(x)[:, None] * (here.time + offset * speed)
        slope = _slope(differentials, Mode.FREE, x, moved, perturbations.parameters)
        yield arc.start_time + offset * arc.time_unit, moved, slope


def _locked(perturbations: Perturbations, arc: Arc, zeno: EventShift) -> Iterator[_Node]:
    flow, differentials = perturbations.dynamics.locked, perturbations.differentials
    v, q = zeno.state, perturbations.parameters
    course = [
        (0.0, v),
        *courses(flow, differentials.locked, arc, perturbations.tolerance, v, q, parts=_PARTS),
    ]
    for offset, shift in course:
        x = arc.flow_state_at(offset)
        moved = shift - flow.rate(x)[:, None] * zeno.time
        yield arc.start_time + offset, moved, _slope(differentials, Mode.LOCKED, x, moved, q)


def _slope(differentials: Differentials, mode: Mode, x: Vector, v: Vector, q: Vector) -> Vector:
    """Return the rate of a perturbation, ``J v + F q``."""
    flow = differentials.locked if mode is Mode.LOCKED else differentials.free
    # The derivative comes for all stages of a step at once.
    linear = flow.linear(np.tile(x, (N_STAGES, 1)))[0]
    return np.asarray(linear @ np.concatenate([v, q]), dtype=np.float64)
