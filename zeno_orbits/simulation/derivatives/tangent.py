"""Derivatives by the compiled loop, along arcs that it recorded.

Other arcs, and arcs that the loop cannot differentiate, use the formulas of `state_transition` and
`passages` in Python.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.loop import (
    LoopRecord,
    TangentProgram,
    Track,
    View,
    binding,
    program_of,
    tangent_of,
)
from zeno_orbits.simulation.derivatives.sensitivity import SaltationDerivative, VariationalEquation
from zeno_orbits.simulation.derivatives.state_transition import courses, trusted
from zeno_orbits.simulation.execution import Arc, Execution, Mode
from zeno_orbits.simulation.recorded import LoopTrajectory, recorded_run

_KIND, _TIME, _STOP = 0, 1, 5
_END, _ENDING, _HEIGHT, _VIEW = 2, 5, binding.ARC_WIDTH - 2, binding.ARC_WIDTH - 1
"""Columns of the record: of an event, and of an arc."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ArcShifts:
    """Derivatives of the ends of an arc, by the loop.

    Attributes:
        start: Derivatives of the start: after an impact, at a Zeno point or a release.
        end: Derivatives of the end, before an impact.
        after: Derivatives after an impact or a release at the end.
    """

    start: SaltationDerivative
    end: SaltationDerivative
    after: SaltationDerivative


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedArcs:
    """Successive arcs that the loop recorded in one view.

    Attributes:
        view: The view.
        record: Their record.
        joins: Whether its first event is the impact before the first arc.
    """

    view: View
    record: LoopRecord
    joins: bool

    def followed(
        self, perturbations: VariationalEquation, start: SaltationDerivative
    ) -> list[ArcShifts]:
        """Return the derivatives of the ends of the arcs, up to the first without a derivative.

        Args:
            perturbations: The derivatives of the view.
            start: Derivatives of the start of the first arc.
        """
        compiled = _tracked(perturbations, self.record)
        if compiled is None:
            return []
        program, track = compiled
        rows = np.concatenate([[start.time, start.rate], start.state])
        return [
            ArcShifts(start=_shift(one[0]), end=_shift(one[1]), after=_shift(one[2]))
            for one in program.follow(track, rows, joins=self.joins)
        ]


def recorded_arcs(
    execution: Execution, place: int, event: int, *, joins: bool
) -> RecordedArcs | None:
    """Return successive arcs of one view, or ``None`` if the loop did not record the first.

    All their events occur at the stop of the view. They end with a release at the latest.

    Args:
        execution: The execution.
        place: Index of the first arc.
        event: Index of the first event after its start.
        joins: Whether the event before it is the first impact of a sequence that goes on.
    """
    run = recorded_run(execution)
    if run is None:
        return None
    record = run.record
    arcs, events = record.arcs[place:], record.events[event:]
    if arcs[0, _ENDING] == binding.SWITCH or arcs[0, _HEIGHT] > 0.0:
        # A flight goes on after a kink.
        return None
    view = run.views[int(arcs[0, _VIEW])]
    n = _first(arcs[:, _VIEW] != arcs[0, _VIEW])
    n = min(n, 1 + _first(arcs[:n, _ENDING] == binding.RELEASE))
    n = min(n, _first(arcs[:n, _ENDING] == binding.SWITCH))
    foreign = _first((events[:, _KIND] == binding.SWITCH) | (events[:, _STOP] != view.stop))
    passed = np.searchsorted(events[:, _TIME], arcs[:n, _END], side="right")
    n = int(np.searchsorted(passed, foreign, side="right"))
    leaves = n < len(arcs) and arcs[n, _VIEW] != arcs[0, _VIEW]
    if leaves and arcs[n - 1, _ENDING] != binding.RELEASE:
        # An impact may open other stops.
        n -= 1
    if n <= 0:
        return None
    rows = record.events[event - joins : event + int(passed[n - 1])]
    return RecordedArcs(view=view, record=replace(record, arcs=arcs[:n], events=rows), joins=joins)


def _first(which: NDArray[np.bool_]) -> int:
    """Return the first index that is chosen, or the number of all if none is."""
    return int(np.argmax(which)) if which.any() else len(which)


def _shift(rows: Vector) -> SaltationDerivative:
    return SaltationDerivative(time=rows[0], rate=rows[1], state=rows[2:])


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
    if isinstance(way, LoopTrajectory) and not perturbations.in_python:
        kind = binding.LOCKED if mode is Mode.LOCKED else binding.FREE
        if len(v) > perturbations.n_x:
            kind = binding.FLIGHT
        compiled = _tracked(perturbations, way.record(kind, arc.time_unit, perturbations.n_x))
        if compiled is not None:
            program, track = compiled
            times, rows = program.course(track, v, q, parts)
            return np.append(0.0, times), np.concatenate([v[None], rows])
    flow, differential = perturbations.flow_of(arc, mode, len(v))
    steps = list(courses(flow, differential, arc, perturbations.tolerance, v, q, parts=parts))
    return np.array([0.0, *(time for time, _ in steps)]), np.array([v, *(row for _, row in steps)])


def _tracked(
    perturbations: VariationalEquation, record: LoopRecord
) -> tuple[TangentProgram, Track] | None:
    """Return the derivatives of the arcs of a record, if the loop has them."""
    formulas = perturbations.dynamics.formulas
    program = None if formulas is None else program_of(formulas.system)
    if formulas is None or program is None:
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
