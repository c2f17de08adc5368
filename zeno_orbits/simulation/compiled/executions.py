"""Executions by the compiled loop, whose reference is the plain simulator in Python."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.integrators import RungeKutta, Step, Tolerance, not_finite, too_small
from zeno_orbits.loop import Detail, LoopRun, RunSettings, binding, program_of
from zeno_orbits.model import CharacteristicScales, require_start
from zeno_orbits.simulation.compiled.steps import loop_steps
from zeno_orbits.simulation.execution import Event, Execution
from zeno_orbits.simulation.interruptions import (
    does_not_accumulate,
    does_not_close,
    enters_by_reset,
    grows_without_end,
    leaves_set,
    runs_away,
    too_many_steps,
)
from zeno_orbits.simulation.pieces import Piece
from zeno_orbits.simulation.recorded import RecordedExecution, RecordedRun, events_of
from zeno_orbits.simulation.settings import SimulationSettings, SimulationTask
from zeno_orbits.simulation.zeno.completion import (
    FINEST,
    FixedImpacts,
    PlasticAfter,
    Truncation,
    ZenoExtrapolation,
    ZenoPassage,
)
from zeno_orbits.simulation.zeno.rescaled_flight import Flight, rescaled_flights
from zeno_orbits.simulation.zeno.zeno_limit import ZenoLimit
from zeno_orbits.simulation.zeno.zeno_passage import pass_through
from zeno_orbits.work import silent

_STEPS, _EVENTS = 256, 12
"""Rows of the records of a piece: about a sequence of impacts to its release."""

COMPLETIONS: dict[type, int] = {
    ZenoExtrapolation: binding.EXTRAPOLATION,
    ZenoPassage: binding.PASSAGE,
    Truncation: binding.TRUNCATION,
    FixedImpacts: binding.FIXED_IMPACTS,
    PlasticAfter: binding.PLASTIC_AFTER,
}


def serves(task: SimulationTask) -> bool:
    """Return True if the loop can carry out a task: formulas, steps and completion are its own."""
    return (
        task.dynamics.formulas is not None
        and loop_steps(task.settings.engine) is not None
        and type(task.settings.completion) in COMPLETIONS
        and program_of(task.dynamics.formulas.system) is not None
    )


def by_loop(task: SimulationTask) -> Execution:
    """Return the completed execution, carried out by the loop.

    Args:
        task: Simulation task for which `serves` is true.

    Raises:
        InputError: If the state is not admissible.
        SimulationError: If the execution cannot be continued.
    """
    run = _begun(task)
    paths: dict[float, tuple[Step, ...]] = {}
    reports = task.on_progress is not silent
    try:
        task.on_progress("simulating", 0.0)
        while True:
            # With three rows of arcs it comes back after each.
            status = run.resume(arcs=3) if reports else run.resume()
            if status == binding.CURVE:
                limit = curve_limit(task, run)
                if limit is not None:
                    paths[limit.time] = limit.path
                run.answer(None if limit is None else (limit.time, limit.error, limit.state))
            elif status in (binding.FULL, binding.DONE):
                reached = task.until if status == binding.DONE else run.now()[0]
                task.on_progress("simulating", reached / task.until)
            if status == binding.DONE:
                return _execution(task, run, paths)
            if status not in (binding.FULL, binding.CURVE):
                error = interruption(task, status, run.detail())
                record = run.record()
                error.execution = _execution(task, run, paths) if len(record.arcs) else None
                raise error
    finally:
        run.close()


def pieces_by_loop(task: SimulationTask) -> Iterator[Piece]:
    """Yield the completed execution in pieces, carried out by the loop.

    Args:
        task: Simulation task for which `serves` is true.

    Raises:
        InputError: If the state is not admissible.
        SimulationError: If the execution cannot be continued, after the piece before that.
    """
    run, n_x = _begun(task), len(task.dynamics.state_names)
    # A run that ends at a release is not left before that.
    events = _EVENTS if task.most_releases == math.inf else _STEPS
    try:
        status = binding.FULL
        while status in (binding.FULL, binding.CURVE):
            status = run.resume(steps=_STEPS, polynomials=64, arcs=32, events=events)
            if status == binding.CURVE:
                limit = curve_limit(task, run)
                run.answer(None if limit is None else (limit.time, limit.error, limit.state))
            record = run.taken()
            time, mode, state = run.now()
            if status == binding.DONE and len(record.arcs):
                # The run itself stores only the start of its last arc.
                last = record.arcs[-1]
                mode, time = int(last[0]), float(last[2])
                state = last[binding.ARC_WIDTH + n_x :][:n_x]
            yield Piece(
                events=events_of(record.events, n_x),
                states=record.steps[:, 2 : 2 + n_x],
                time=time,
                state=state,
                locked=mode == binding.LOCKED,
            )
        if status != binding.DONE:
            raise interruption(task, status, run.detail())
    finally:
        run.close()


def releases_by_loop(task: SimulationTask, states: Vector) -> Iterator[list[Event]]:
    """Yield the releases of executions from several states, each until it ends or is interrupted.

    A release comes after the first impact since the previous release and the Zeno point.

    Args:
        task: Simulation task for which `serves` is true. Its own state is not used.
        states: States that continue an earlier execution, ``(n, n_x)``.
    """
    run, n_x = _begun(task, records=False), len(task.dynamics.state_names)
    try:
        for k, state in enumerate(states):
            if k:
                run.restart(state)
            status = binding.FULL
            while status in (binding.FULL, binding.CURVE):
                status = run.resume(steps=0, polynomials=0, arcs=0, events=_STEPS)
                if status == binding.CURVE:
                    limit = curve_limit(task, run)
                    run.answer(None if limit is None else (limit.time, limit.error, limit.state))
            rows = run.record().events
            yield events_of(rows[_at_releases(rows[:, 0].tolist())], n_x)
    finally:
        run.close()


def _at_releases(kinds: list[float]) -> list[int]:
    """Return the rows of all events but the later impacts of each sequence."""
    found = list[int]()
    struck = False
    for k, kind in enumerate(kinds):
        if kind != binding.IMPACT or not struck:
            found.append(k)
        struck = kind == binding.IMPACT or (struck and kind != binding.RELEASE)
    return found


def _begun(task: SimulationTask, *, records: bool = True) -> LoopRun:
    """Return a run of the loop at its start.

    Args:
        task: The simulation task.
        records: Whether steps and arcs are recorded.

    Raises:
        InputError: If the state is not admissible.
    """
    dynamics, formulas = task.dynamics, task.dynamics.formulas
    program = None if formulas is None else program_of(formulas.system)
    if formulas is None or program is None:
        raise ValueError("Argument `task` must have formulas that the compiled loop supports.")
    if not task.goes_on:
        require_start(dynamics, task.state, task.settings.contact)
    settings = _filled_settings(task)
    settings.records = int(records)
    return LoopRun(program, settings, formulas.values, task.state)


def _execution(
    task: SimulationTask, run: LoopRun, paths: dict[float, tuple[Step, ...]]
) -> RecordedExecution:
    tolerance = task.settings.tolerance.times(task.dynamics.own.least)
    return RecordedExecution.of(
        RecordedRun(dynamics=task.dynamics, tolerance=tolerance, record=run.record(), paths=paths)
    )


def run_settings(task: SimulationTask, **others: Any) -> RunSettings:
    """Return accuracy and limits in the loop's format, with some of the values replaced."""
    settings = replace(shared_settings(*_shared_by(task)), **_own_limits(task))
    return replace(settings, **others) if others else settings


def _filled_settings(task: SimulationTask) -> binding.SettingsType:
    """Return the same in memory of its own. Most tasks share all but their limits with others."""
    shared = _shared_memory(*_shared_by(task))
    place = type(shared).from_buffer_copy(shared)
    for name, value in _own_limits(task).items():
        setattr(place, name, value)
    return place


def _own_limits(task: SimulationTask) -> dict[str, float]:
    return {
        "until": task.until,
        "most_releases": task.most_releases,
        "most_landings": task.most_impacts,
    }


def _shared_by(
    task: SimulationTask,
) -> tuple[SimulationSettings, CharacteristicScales, float, int, int]:
    """Return what the settings of a task depend on, apart from its limits."""
    dynamics, chosen = task.dynamics, task.settings
    if isinstance(chosen.far, list):
        chosen = replace(chosen, far=tuple(chosen.far))
    sizes = (len(dynamics.state_names), dynamics.n_q)
    return chosen, dynamics.own, dynamics.restitution, *sizes


@lru_cache(maxsize=64)
def _shared_memory(
    chosen: SimulationSettings, own: CharacteristicScales, restitution: float, n_x: int, n_q: int
) -> binding.SettingsType:
    return shared_settings(chosen, own, restitution, n_x, n_q).filled()


def shared_settings(
    chosen: SimulationSettings, own: CharacteristicScales, restitution: float, n_x: int, n_q: int
) -> RunSettings:
    """Return accuracy and limits of all tasks on systems with some scales and a restitution.

    Args:
        chosen: Settings of the simulation.
        own: Characteristic scales of the systems.
        restitution: Coefficient of restitution.
        n_x: Number of states.
        n_q: Number of coordinates.
    """
    rule = chosen.completion
    tolerance = chosen.tolerance.times(own.least)
    steps = loop_steps(chosen.engine)
    if steps is None:
        raise ValueError("Argument `task` must have an engine that the compiled loop supports.")
    extrapolates = isinstance(rule, ZenoExtrapolation | ZenoPassage)
    return RunSettings(
        until=math.inf,
        relative=tolerance.relative,
        absolute=tolerance.absolute,
        contact=chosen.contact,
        restitution=restitution,
        time=own.time,
        gap=own.gap,
        gap_rate=own.gap_rate,
        gap_acceleration=own.gap_acceleration,
        multiplier=own.multiplier,
        sizes=own.states(n_x).tolist(),
        weights=own.weights(n_x),
        flight_weights=own.flight_weights(n_x),
        reach=np.broadcast_to(np.asarray(chosen.far, dtype=np.float64), n_q).tolist(),
        **steps._asdict(),
        completion=COMPLETIONS[type(rule)],
        limit_tolerance=rule.tolerance if extrapolates else 0.0,
        resolved=rule.resolved if extrapolates else 0.0,
        delta=rule.delta if isinstance(rule, Truncation) else 0.0,
        n_fixed=rule.n_impacts if isinstance(rule, FixedImpacts | PlasticAfter) else 0,
        most_releases=math.inf,
        most_landings=math.inf,
        most_steps=chosen.most_steps,
        most_impacts=chosen.most_impacts,
    )


def curve_limit(task: SimulationTask, run: LoopRun) -> ZenoLimit | None:
    """Return the Zeno point at the end of the curve of the impacts, if it can be followed there.

    Args:
        task: The simulation task, with the system whose impacts they are.
        run: The run, whose last status is ``CURVE``.
    """
    asked, rule = run.detail(), task.settings.completion
    if not isinstance(rule, ZenoPassage):
        return None
    return pass_through(
        task.dynamics,
        _flights(task, rule, run),
        asked.time,
        asked.state,
        asked.number,
        rule.tolerance,
        most_flights=int(asked.steps),
    )


def _flights(task: SimulationTask, rule: ZenoPassage, run: LoopRun) -> Flight:
    """Return single flights, carried out by the loop if their steps are its own."""
    finest: Tolerance = FINEST.times(task.dynamics.own.least)
    if type(rule.engine) is not RungeKutta or rule.engine.largest_step < math.inf:
        return rescaled_flights(task.dynamics, rule.engine, finest)

    def flight(state_plus: Vector, speed: float) -> tuple[float, Vector, float] | None:
        return run.flight(state_plus, speed, finest.relative, finest.absolute)

    return flight


def interruption(task: SimulationTask, status: int, told: Detail) -> SimulationError:
    """Return the error that a status stands for.

    Args:
        task: The simulation task.
        status: The status.
        told: Its details.
    """
    settings, names = task.settings, task.dynamics.state_names
    made: dict[int, Callable[[], SimulationError]] = {
        binding.TOO_STIFF: lambda: too_small(
            "the flow is too stiff or singular", told.time, told.state
        ),
        binding.SINGULAR: lambda: too_small("the flow is singular", told.time, told.state),
        binding.NOT_FINITE: lambda: not_finite(told.state),
        binding.LEFT: lambda: leaves_set(told.time, told.state),
        binding.MANY_STEPS: lambda: too_many_steps(settings.most_steps, told.time, told.state),
        binding.MANY_IMPACTS: lambda: does_not_accumulate(
            settings.most_impacts, told.time, told.state
        ),
        binding.BEYOND: lambda: runs_away(names[told.index], told.time, told.state),
        binding.GROWS: lambda: grows_without_end(
            names[told.index], int(told.steps), told.number, told.time, told.state
        ),
        binding.NOT_CLOSING: lambda: does_not_close(told.number, told.time, told.state),
        binding.INTO_STOP: lambda: enters_by_reset(told.time, told.state),
    }
    return made[status]()
