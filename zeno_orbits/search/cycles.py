"""Periods of a machine with one stop: closed near a start, as an orbit, and within their limits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model import GraphDynamics, ParameterValues, Problem
from zeno_orbits.orbits import (
    Cycle,
    EventReturn,
    EventSequence,
    Orbit,
    OrbitImpact,
    OrbitPhase,
    Phase,
    SectionMode,
    closed_return,
    cycle_of,
    events_of_shape,
    new_orbit,
)
from zeno_orbits.simulation import Arc, SimulationSettings


def closed_cycle(
    graph: GraphDynamics,
    x: Vector,
    *,
    shape: EventSequence,
    period: float,
    settings: SimulationSettings,
) -> Cycle:
    """Return the period of a shape that repeats, near the start of a period.

    Args:
        graph: The graph of modes of a machine with the stop `stop`.
        x: A state near the start of a period, ``(n_x,)``.
        shape: The shape.
        period: Approximate period [s].
        settings: Accuracy.

    Raises:
        SimulationError: If Newton's method does not converge, or leads to another shape.
    """
    events = events_of_shape(shape)
    kind, _, stop = events[-1].partition(" ")
    released, thrown = (stop, "") if kind == "release" else ("", stop)
    found = closed_return(
        graph,
        x,
        section=events[-1],
        n_returns=events.count(events[-1]),
        guess=period,
        settings=settings,
        by_returns=True,
        mode=SectionMode(closed=(), sides=(), stop=thrown, released=released),
    )
    return cycle_of_return(graph, found, shape, settings)


def cycle_of_return(
    graph: GraphDynamics,
    found: EventReturn,
    shape: EventSequence,
    settings: SimulationSettings,
) -> Cycle:
    """Return the phases of a periodic return.

    Args:
        graph: The graph of modes of a machine with the stop `stop`.
        found: The return.
        shape: Its shape.
        settings: Accuracy.

    Raises:
        SimulationError: If the return has another shape.
    """
    return cycle_of(graph.first, found.start, shape, horizon=2 * found.period, settings=settings)


def orbit_of(cycle: Cycle, problem: Problem, values: ParameterValues) -> Orbit:
    """Convert a period that repeats to an orbit without a certificate.

    Args:
        cycle: The period.
        problem: Problem of the period.
        values: Values of the problem's gains and parameters.
    """
    start = cycle.start.time

    def phase_of(phase: Phase) -> OrbitPhase:
        return OrbitPhase(
            kind=phase.kind,
            start_time=phase.start.time - start,
            start_state=named(problem, phase.start.state),
            impacts=tuple(
                OrbitImpact(time=i.time - start, state_minus=named(problem, i.state_minus))
                for i in phase.impacts
            ),
            zeno_time=None if phase.zeno is None else phase.zeno.time - start,
            zeno_state=None if phase.zeno is None else named(problem, phase.zeno.state),
        )

    phases = tuple(map(phase_of, cycle.phases))
    return new_orbit(problem, values, period=cycle.period, phases=phases)


def beyond_limits(problem: Problem, arcs: Sequence[Arc]) -> str:
    """Return a clause on the first declared limit of a state that a period exceeds, or none.

    Args:
        problem: The problem, with its `escapes`.
        arcs: The arcs of a period.
    """
    for name, escape in problem.escapes.items():
        place = problem.state_names.index(name)
        size = max(float(np.max(np.abs(arc.flow_states[:, place]))) for arc in arcs)
        if size > escape.beyond:
            passed = f"`{name}` reaches {size:.4g}, beyond {escape.beyond:.4g}"
            return f"{escape.phrase[0].upper()}{escape.phrase[1:]}: {passed}"
    return ""


def named(problem: Problem, state: Vector) -> dict[str, float]:
    """Return a mapping of state name to value."""
    return dict(zip(problem.state_names, map(float, state), strict=True))
