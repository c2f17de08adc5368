"""Completed executions, event by event: flights, impacts, Zeno point, contact phase, release.

A flight after an impact is integrated in the scaled variables of theory (2.6), so
slow impacts are neither missed nor invented. Source: [OrAmes2011]_ for the completion.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError, StepLimitError, any_number
from zeno_orbits.loop import UnknownOperationError, loop_library
from zeno_orbits.model import GraphDynamics, GraphMode, HybridDynamics
from zeno_orbits.simulation.arc_follower import ArcStart
from zeno_orbits.simulation.compiled.executions import by_loop, pieces_by_loop, serves
from zeno_orbits.simulation.compiled.legs import LegFollower
from zeno_orbits.simulation.execution import Arc, Execution
from zeno_orbits.simulation.pieces import Piece
from zeno_orbits.simulation.reference_run import ReferenceRun
from zeno_orbits.simulation.settings import SimulationSettings, SimulationTask
from zeno_orbits.simulation.zeno.completion import require_completion
from zeno_orbits.work import Progress, silent

_USUAL = SimulationSettings()


def simulate(
    dynamics: HybridDynamics | GraphDynamics,
    state: Sequence[float] | Vector,
    *,
    until: float,
    releases: int | None = None,
    impacts: int | None = None,
    settings: SimulationSettings | None = None,
    on_progress: Progress = silent,
    past: str = "",
) -> Execution:
    """Return the completed execution from an admissible state, locked or free.

    Args:
        dynamics: The system at fixed parameter values, or the graph of modes of a machine with
            several stops or switches.
        state: Initial state, ``(n_x,)``, at time 0.
        until: End time [s].
        releases: Number of releases after which to stop, by default unlimited.
        impacts: Number of impacts that end a flight, after which to stop, by default unlimited.
        settings: Accuracy. The defaults aim at an error of 1e-11 per period.
        on_progress: Called with the simulated part of the time.
        past: Name of a declared switch that has just occurred at the start, where its guard is zero
            and may fall.

    Raises:
        InputError: If the state is not admissible or the horizon is not a positive number, or if
            the completion ends sequences of impacts by force and every stop is elastic.
        SimulationError: If the execution cannot be continued. The error contains time, cause and
            the execution so far.
    """
    if not 0.0 < any_number("until", until) < math.inf:
        raise InputError(
            f"Argument `until` must be a finite, positive number of seconds, but it is {until}."
        )
    task = SimulationTask(
        dynamics=dynamics,
        state=np.array(state, dtype=np.float64),
        until=until,
        most_releases=math.inf if releases is None else releases,
        most_impacts=math.inf if impacts is None else impacts,
        settings=settings or _USUAL,
        on_progress=on_progress,
        past=past,
    )
    require_completion(task.settings.completion, lambda: _restitutions(dynamics))
    return by_loop(task) or by_reference(task, plain=False)


def _restitutions(dynamics: HybridDynamics | GraphDynamics) -> list[float]:
    """Return the restitution of every stop."""
    return [view.restitution for view in dynamics.as_graph().open_views]


def simulated_at_most(
    dynamics: HybridDynamics | GraphDynamics,
    state: Sequence[float] | Vector,
    *,
    until: float,
    most_steps: int,
    settings: SimulationSettings,
    past: str = "",
) -> tuple[Execution, bool]:
    """Return the execution until a time or a number of steps, and whether the steps ended it.

    Args:
        dynamics: As for `simulate`.
        state: As for `simulate`.
        until: End time [s].
        most_steps: Largest number of steps. Those of the settings may be fewer.
        settings: Accuracy.
        past: As for `simulate`.

    Raises:
        InputError: As for `simulate`.
        SimulationError: If the execution cannot be continued, or lacks an event in these steps.
    """
    fewer = replace(settings, most_steps=min(most_steps, settings.most_steps))
    try:
        return simulate(dynamics, state, until=until, settings=fewer, past=past), False
    except StepLimitError as error:
        if error.execution is None:
            raise
        return error.execution, True


def simulator_in_use() -> str:
    """Return the name of the simulator of this process, for the identity of work that is kept.

    The loop and the reference agree to rounding, not in every digit (`docs/compiled_code.md`).
    """
    return "Python" if loop_library() is None else "loop"


def by_reference(task: SimulationTask, *, plain: bool = True) -> Execution:
    """Return the completed execution, followed in Python: the reference of the compiled loop.

    Args:
        task: The simulation task.
        plain: Whether steps are taken in Python too, otherwise by compiled code where possible.

    Raises:
        InputError: If the state is not admissible.
        SimulationError: If the execution cannot be continued.
    """
    run = ReferenceRun.of(task, None if plain else LegFollower(task.settings.engine))
    start = run.admitted(task.state, checked=not task.goes_on)
    try:
        while start is not None:
            start = run.after_phase(start)
            task.report(run.reached)
    except SimulationError as error:
        error.execution = run.execution() if run.has_flown else None
        raise
    return run.execution()


def pieces(task: SimulationTask) -> Iterator[Piece]:
    """Yield the completed execution in pieces, for callers that may stop early.

    Args:
        task: The simulation task.

    Raises:
        InputError: If the state is not admissible.
        SimulationError: If the execution cannot be continued, after the piece before that.
    """
    reached = -math.inf
    if serves(task):
        try:
            for piece in pieces_by_loop(task):
                yield piece
                reached = piece.time
        except UnknownOperationError:
            # Of a mode that the motion has come to.
            pass
        else:
            return
    for piece in pieces_by_reference(task):
        if piece.time > reached:
            later = [event for event in piece.events if event.time > reached]
            yield replace(piece, events=later)


def pieces_by_reference(task: SimulationTask) -> Iterator[Piece]:
    """Yield the completed execution phase by phase, followed in Python.

    Args:
        task: The simulation task.

    Raises:
        InputError: If the state is not admissible.
        SimulationError: If the execution cannot be continued, after the piece before that.
    """
    run, n_x = ReferenceRun.of(task), len(task.graph.state_names)
    start = run.admitted(task.state, checked=not task.goes_on)
    interruption: SimulationError | None = None
    while start is not None and interruption is None:
        before = start
        try:
            start = run.after_phase(start)
        except SimulationError as error:
            interruption = error
        yield _piece(run, start, before, n_x)
        run.arcs, run.events = run.arcs[-1:], []
    if interruption is not None:
        raise interruption


def _starts(graph: GraphDynamics, arcs: Sequence[Arc]) -> list[tuple[float, GraphMode]]:
    return [(arc.start_time, arc.mode_in(graph)) for arc in arcs]


def _piece(run: ReferenceRun, start: ArcStart | None, before: ArcStart, n_x: int) -> Piece:
    """Return the piece of a run in a phase, with the present state.

    Args:
        run: The run, with the arcs and events of the phase.
        start: Start of the next phase, if there is a next phase.
        before: Start of the phase.
        n_x: Number of states.
    """
    ways = [arc.trajectory for arc in run.arcs if arc.trajectory is not None]
    states = [state[:n_x] for way in ways for state in way.states[1:]]
    last = run.arcs[-1] if run.arcs else None
    now = start or before
    ended = start is None and last is not None
    mode = run.mode_at(now)
    if ended and last is not None:
        mode = last.mode_in(run.graph)
    return Piece(
        events=list(run.events),
        states=np.reshape(states, (-1, n_x)),
        time=last.end_time if ended and last is not None else now.time,
        state=last.end_state if ended and last is not None else now.state,
        mode=mode,
        starts=partial(_starts, run.graph, tuple(run.arcs)),
    )
