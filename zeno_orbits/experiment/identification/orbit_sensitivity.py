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
from zeno_orbits.model import N_STAGES, FlowDifferential, HybridDynamics
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
"""CubicColumns in a step of the integrator: between them the derivatives are cubic."""


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
        (times, (moved @ whole).reshape(len(times), -1), (slopes @ whole).reshape(len(times), -1))
        for times, moved, slopes in _along(
            perturbations, derivative.execution, derivative.period.value
        )
    ]
    times, values, slopes = (np.concatenate(rows) for rows in zip(*pieces, strict=True))
    return OrbitSlope(
        period=by_period,
        release=start,
        states=CubicColumns(times=times, values=values, slopes=slopes),
        conditioning=float(np.linalg.cond(matrix)) if d else 1.0,
    )


_Piece = tuple[Vector, Vector, Vector]
"""Times since the release, derivatives of the state at these times, and their slopes in time."""


def _along(perturbations: Perturbations, execution: Execution, period: float) -> Iterator[_Piece]:
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
        yield _piece(perturbations, arc, here)
        here = perturbations.struck(impact, perturbations.flown(arc, here))
        bounces = perturbations.joined(bounces, impact, here)
    yield _piece(perturbations, arcs[-1], perturbations.limit(bounces, zeno.state))


def _piece(perturbations: Perturbations, arc: Arc, begin: EventShift) -> _Piece:
    """Return how the state moves along an arc whose start moves as told."""
    dynamics, differentials = perturbations.dynamics, perturbations.differentials
    n_x, tolerance = perturbations.n_x, perturbations.tolerance
    own, by = (
        (dynamics.locked, differentials.locked)
        if arc.mode is Mode.LOCKED
        else (dynamics.free, differentials.free)
    )
    flow, differential, v, q = own, by, begin.state, perturbations.parameters
    speed = np.zeros_like(begin.time)
    if arc.flow_state_at(arc.duration).size > n_x:
        # A rescaled flight: its unit of time is a parameter that moves, too.
        flow, differential = dynamics.flight(arc.time_unit), differentials.flight(arc.time_unit)
        v = np.concatenate([v, np.zeros((2, begin.time.size))])
        q, speed = np.concatenate([q, begin.rate[None, :]]), begin.rate
    steps = courses(flow, differential, arc, tolerance, v, q, parts=_PARTS)
    course = [(0.0, v), *steps]
    offsets = np.array([offset for offset, _ in course])
    states = np.array([arc.flow_state_at(offset)[:n_x] for offset in offsets])
    rates = np.array([own.rate(x).copy() for x in states])
    later = begin.time + offsets[:, None] * speed
    moved = np.array([shift[:n_x] for _, shift in course]) - rates[:, :, None] * later[:, None]
    slopes = _slopes(by, states, moved, perturbations.parameters)
    return arc.start_time + offsets * arc.time_unit, moved, slopes


def _slopes(by: FlowDifferential, states: Vector, moved: Vector, q: Vector) -> Vector:
    """Return the rates of perturbations, ``J v + F q``, at the states of an arc."""
    # The derivatives come for all stages of a step at once.
    n = len(states)
    padded = np.concatenate([states, np.repeat(states[-1:], -n % N_STAGES, axis=0)])
    linear = [by.linear(rows).copy() for rows in padded.reshape(-1, N_STAGES, states.shape[1])]
    every = np.concatenate([moved, np.broadcast_to(q, (n, *q.shape))], axis=1)
    return np.concatenate(linear)[:n] @ every
