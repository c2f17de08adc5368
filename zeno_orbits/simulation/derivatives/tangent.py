"""Derivatives of the events of an execution with respect to its start and its parameters.

The compiled loop propagates derivatives along its recorded arcs. Other arcs, and arcs that the loop
cannot differentiate, use the formulas of `sensitivity` in Python.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.loop import Record, TangentProgram, Track, binding, program_of, tangent_of
from zeno_orbits.simulation.derivatives.sensitivity import (
    ArcShifts,
    SaltationDerivative,
    VariationalEquation,
)
from zeno_orbits.simulation.derivatives.state_transition import courses, trusted
from zeno_orbits.simulation.execution import Arc, Execution, Mode
from zeno_orbits.simulation.recorded import LoopTrajectory, record_of


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EventMotions:
    """Derivatives of an execution.

    Attributes:
        shifts: Derivatives of the arcs. Arcs without derivatives are missing.
    """

    shifts: dict[int, ArcShifts]

    def of(self, arc: Arc) -> ArcShifts:
        """Return the derivatives of the ends of an arc.

        Raises:
            SimulationError: If the arc cannot be differentiated because the stop was touched
                without an impact.
        """
        try:
            return self.shifts[id(arc)]
        except KeyError:
            raise SimulationError(
                "The derivative of the motion is undefined: the stop is touched without an impact",
                time=arc.end_time,
                state=tuple(arc.end_state.tolist()),
            ) from None


def motion_of(
    perturbations: VariationalEquation,
    execution: Execution,
    start: SaltationDerivative,
    *,
    first: int = 0,
) -> EventMotions:
    """Return the derivatives of the ends of the arcs of an execution.

    Args:
        perturbations: The equations of perturbations.
        execution: The execution.
        start: Derivatives of the start of its first arc that counts.
        first: Index of that arc.
    """
    compiled = _compiled(perturbations, execution)
    if compiled is None:
        shifts = perturbations.along(execution, start, first)
    else:
        program, track = compiled
        rows = np.concatenate([[start.time, start.rate], start.state])
        shifts = [
            ArcShifts(start=_shift(one[0]), end=_shift(one[1]), after=_shift(one[2]))
            for one in program.follow(track, first, rows)[first:]
        ]
    return EventMotions(shifts=dict(zip(map(id, execution.arcs[first:]), shifts, strict=False)))


def _shift(rows: Vector) -> SaltationDerivative:
    return SaltationDerivative(time=rows[0], rate=rows[1], state=rows[2:])


def course_of(
    perturbations: VariationalEquation,
    execution: Execution,
    place: int,
    start: SaltationDerivative,
    *,
    parts: int,
) -> tuple[Vector, Vector]:
    """Return the derivatives of the state along an arc, at equal times of the flow.

    Args:
        perturbations: The equations of perturbations.
        execution: The execution.
        place: Index of the arc.
        start: Derivatives of the start of the arc.
        parts: Number of evenly spaced outputs per step.

    Returns:
        Times since the start of the arc in the flow's own time, ``(n,)``, and the derivatives of
        the flow's state there, ``(n, n_y, m)``.
    """
    arc = execution.arcs[place]
    v, q = start.state, perturbations.parameters
    is_flight = arc.flow_state_at(arc.duration).size > perturbations.n_x
    if is_flight:
        # The unit of time of the flight is also a parameter that moves.
        v = np.concatenate([v, np.zeros((2, start.time.size))])
        q = np.concatenate([q, start.rate[None, :]])
    compiled = _compiled(perturbations, execution)
    if compiled is None:
        return course_of_arc(perturbations, arc, arc.mode, v, q, parts=parts)
    program, track = compiled
    times, rows = program.course(track, place, v, q, parts)
    return np.append(0.0, times), np.concatenate([v[None], rows])


def carried_by_loop(
    perturbations: VariationalEquation, arc: Arc, mode: Mode, v: Vector, q: Vector
) -> Vector:
    """Return what `carried_in_python` returns, by the loop if it recorded the steps of the arc.

    Args:
        perturbations: The equations of perturbations.
        arc: The arc.
        mode: Mode of its flow.
        v: Perturbations at its start, ``(n_y, m)``.
        q: Perturbations of the flow's parameters, ``(n_q, m)``.
    """
    return course_of_arc(perturbations, arc, mode, v, q)[1][-1]


def course_of_arc(
    perturbations: VariationalEquation,
    arc: Arc,
    mode: Mode,
    v: Vector,
    q: Vector,
    *,
    parts: int = 1,
) -> tuple[Vector, Vector]:
    """Return the perturbations along an arc at equal parts of every step.

    Args:
        perturbations: The equations of perturbations.
        arc: The arc.
        mode: Mode of its flow.
        v: Perturbations at its start, ``(n_y, m)``.
        q: Perturbations of the flow's parameters, ``(n_q, m)``.
        parts: Number of outputs per step.

    Returns:
        Times since the start of the arc in the flow's own time, ``(n,)``, and the perturbations
        there, ``(n, n_y, m)``. The start is the first of them.
    """
    way = arc.trajectory
    if isinstance(way, LoopTrajectory):
        kind = binding.LOCKED if mode is Mode.LOCKED else binding.FREE
        if len(v) > perturbations.n_x:
            kind = binding.FLIGHT
        compiled = _tracked(perturbations, way.record(kind, arc.time_unit, perturbations.n_x))
        if compiled is not None:
            program, track = compiled
            times, rows = program.course(track, 0, v, q, parts)
            return np.append(0.0, times), np.concatenate([v[None], rows])
    flow, differential = perturbations.flow_of(arc, mode, len(v))
    steps = list(courses(flow, differential, arc, perturbations.tolerance, v, q, parts=parts))
    return np.array([0.0, *(time for time, _ in steps)]), np.array([v, *(row for _, row in steps)])


def _compiled(
    perturbations: VariationalEquation, execution: Execution
) -> tuple[TangentProgram, Track] | None:
    """Return the derivatives of an execution that the loop recorded, if it has them."""
    return _tracked(perturbations, record_of(execution))


def _tracked(
    perturbations: VariationalEquation, record: Record | None
) -> tuple[TangentProgram, Track] | None:
    """Return the derivatives of the arcs of a record, if the loop has them."""
    formulas = perturbations.dynamics.formulas
    program = None if record is None or formulas is None else program_of(formulas.system)
    if record is None or formulas is None or program is None:
        return None
    found = tangent_of(program, perturbations.differentials.formulas)
    if found is None:
        return None
    track = Track(
        record=record,
        p=formulas.values,
        restitution=perturbations.dynamics.restitution,
        by_parameters=perturbations.differentials.restitution,
        trusted=trusted(perturbations.tolerance),
    )
    return found, track
