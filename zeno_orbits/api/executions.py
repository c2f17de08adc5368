"""Executions of a problem, with or without an estimate of their error."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from zeno_orbits.api.inputs import Named, Numbers, front_door, known_problem
from zeno_orbits.errors import InputError, SimulationError, any_number, finite_number, shown
from zeno_orbits.model import Problem, require_start
from zeno_orbits.work import Progress, silent

if TYPE_CHECKING:
    from zeno_orbits.arrays import Vector
    from zeno_orbits.experiment import Recording
    from zeno_orbits.model import GraphDynamics, HybridDynamics
    from zeno_orbits.precision import ExecutionWithError
    from zeno_orbits.simulation import Event, Execution, SimulationSettings


@front_door
def simulate(
    problem: Named,
    *,
    until: float = 10.0,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    start: Numbers | None = None,
    settings: SimulationSettings | None = None,
    on_progress: Progress = silent,
) -> Execution:
    """Return a completed execution: through every impact, Zeno point, contact phase and release.

    Args:
        problem: The problem, its name or its file.
        until: End time [s].
        gains: Gains that differ from their defaults.
        parameters: Parameters that differ from their defaults.
        start: State name to initial value, 0 for the others. The default is the problem's first
            start.
        settings: Integrator and accuracy.
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If a name is unknown, a value is out of range, or the start lies inside the
            stop.
        SimulationError: If the execution cannot be continued. The error holds its time and reason.
    """
    from zeno_orbits.simulation import simulator

    dynamics, state = _system(problem, None, gains, parameters, start)
    horizon = finite_number("until", until)
    return simulator.simulate(
        dynamics, state, until=horizon, settings=settings, on_progress=on_progress
    )


@front_door
def simulate_with_error(
    problem: Named | HybridDynamics,
    state: Sequence[float] | Vector | None = None,
    *,
    until: float = 10.0,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    start: Numbers | None = None,
    settings: SimulationSettings | None = None,
    on_progress: Progress = silent,
) -> ExecutionWithError:
    """Return a completed execution with an estimate of its error.

    A second run at a hundred times the tolerance gives the estimate.

    Args:
        problem: The problem, its name or its file, or the dynamics of a problem.
        state: Initial state, ``(n_x,)``. Dynamics need it. A problem takes ``start`` by default.
        until: End time [s].
        gains: Gains that differ from their defaults.
        parameters: Parameters that differ from their defaults.
        start: State name to initial value, 0 for the others. The default is the problem's first
            start.
        settings: Integrator and accuracy.
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If a name is unknown, a value is out of range, or the start lies inside the
            stop.
        SimulationError: If the execution cannot be continued.
    """
    from zeno_orbits.precision import accuracy as rooms

    dynamics, state = _system(problem, state, gains, parameters, start)
    return rooms.execution_with_error(
        dynamics, state, until=until, settings=settings, on_progress=on_progress
    )


@front_door
def simulate_to_accuracy(
    problem: Named | HybridDynamics,
    state: Sequence[float] | Vector | None = None,
    *,
    accuracy: float,
    until: float = 10.0,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    start: Numbers | None = None,
    settings: SimulationSettings | None = None,
    on_progress: Progress = silent,
) -> ExecutionWithError:
    """Return a completed execution to a given accuracy, with an estimate of its error.

    Args:
        problem: The problem, its name or its file, or the dynamics of a problem.
        state: Initial state, ``(n_x,)``. Dynamics need it. A problem takes ``start`` by default.
        accuracy: Largest relative error of every event and of the end.
        until: End time [s].
        gains: Gains that differ from their defaults.
        parameters: Parameters that differ from their defaults.
        start: State name to initial value, 0 for the others. The default is the problem's first
            start.
        settings: Integrator and limits. The accuracy determines the tolerances.
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If a name is unknown, a value is out of range, or double precision cannot reach
            the accuracy.
        SimulationError: If the estimate stays above the accuracy.
    """
    from zeno_orbits.precision import accuracy as rooms

    dynamics, state = _system(problem, state, gains, parameters, start)
    return rooms.execution_to_accuracy(
        dynamics,
        state,
        until=until,
        accuracy=accuracy,
        settings=settings,
        on_progress=on_progress,
    )


@front_door
def sample_execution(
    problem: Named,
    execution: Execution,
    *,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    rate: float = 500.0,
    noise: float = 0.0,
    seed: int = 0,
) -> Recording:
    """Return samples of an execution as a recording.

    Args:
        problem: The problem, its name or its file.
        execution: The execution.
        gains: Gains of the execution that differ from their defaults.
        parameters: Parameters of the execution that differ from their defaults.
        rate: Samples per second [Hz].
        noise: Standard deviation of the noise, relative to the range of each state.
        seed: Random seed of the noise.

    Raises:
        InputError: If a name is unknown, or there are too many samples.
    """
    from zeno_orbits.experiment import Sampling, sampled

    known = known_problem(problem)
    known.values(gains=gains, parameters=parameters)
    return sampled(known, execution, Sampling(rate=rate, noise=noise, seed=seed))


def require_samples(until: float, *, rate: float, noise: float, seed: int) -> None:
    """Raise an error for samples that cannot be written, before the simulation.

    Args:
        until: End time [s].
        rate: Samples per second [Hz].
        noise: Standard deviation of the noise, relative to the range of each state.
        seed: Random seed of the noise.

    Raises:
        InputError: If a value is out of range, or there are too many samples.
    """
    from zeno_orbits.experiment import Sampling

    sampling = Sampling(rate=rate, noise=noise, seed=seed)
    if until > 0.0:
        sampling.count(until)


def engine_choice(
    problem: Named,
    execution: Execution,
    *,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
) -> str:
    """Return the steps that the automatic integrator chooses for an execution, with the reason.

    Args:
        problem: The problem, its name or its file.
        execution: The execution.
        gains: Gains of the execution that differ from their defaults.
        parameters: Parameters of the execution that differ from their defaults.
    """
    from zeno_orbits.precision import why_engine

    known = known_problem(problem)
    values = known.values(gains=gains, parameters=parameters)
    longest = max(arc.end_time - arc.start_time for arc in execution.arcs)
    return why_engine(known.first_system(values), execution.arcs[0].start_state, longest)


def unfinished(error: SimulationError, engine: str | None = None) -> ExecutionWithError:
    """Return the execution before an error that ended it, with unknown errors.

    Args:
        error: The error, with its execution.
        engine: Name of the integrator.
    """
    from zeno_orbits.api.settings import simulation_settings
    from zeno_orbits.precision import ExecutionWithError

    return ExecutionWithError(
        execution=error.execution,
        settings=simulation_settings(engine),
        error=inf,
        zeno_errors=(inf,) * len(error.execution.zeno_points),
    )


def _number(error: float) -> float | None:
    """Return an error for JSON, with None for infinity."""
    return error if isfinite(error) else None


def execution_json(problem: Problem, assured: ExecutionWithError) -> dict[str, Any]:
    """Return an execution and its events as plain data.

    Args:
        problem: The problem.
        assured: The execution with its estimated error.
    """
    from zeno_orbits.simulation import EventKind, Impact, SwitchEvent, ZenoPoint

    execution, errors = assured.execution, iter(assured.zeno_errors)

    def named(state: Any) -> dict[str, float]:
        return dict(zip(problem.state_names, map(float, state), strict=True))

    def row(event: Event) -> dict[str, Any]:
        kind = event.kind
        found: dict[str, Any] = {"event": kind.label.lower().replace(" ", "_"), "time": event.time}
        if isinstance(event, Impact | SwitchEvent):
            found["state_minus"], found["state_plus"] = named(event.before), named(event.after)
        else:
            found["state"] = named(event.state)
        if isinstance(event, Impact):
            found["approach_rate"] = event.approach_rate
        if isinstance(event, ZenoPoint):
            found["error"], found["limit_error"] = _number(next(errors)), event.limit_error
        if event.what:
            found["switch" if kind is EventKind.SWITCH else "stop"] = event.what
        return found

    return {
        "problem": problem.name,
        "end_time": execution.end_time,
        "end_mode": execution.arcs[-1].mode.value,
        "end_state": named(execution.end_state),
        "error": _number(assured.error),
        "events": list(map(row, execution.events)),
    }


def _system(
    problem: Named | HybridDynamics,
    state: Sequence[float] | Vector | None,
    gains: Numbers | None,
    parameters: Numbers | None,
    start: Numbers | None,
) -> tuple[HybridDynamics | GraphDynamics, Sequence[float] | Vector]:
    """Return the dynamics and the initial state that the arguments name.

    Raises:
        InputError: If a name is unknown, or the arguments exclude each other.
    """
    if not isinstance(problem, str | Path | Problem):
        if state is None or gains or parameters or start:
            wanted = "needs `state` and takes neither gains, parameters nor start"
            raise InputError(f"Argument `problem`: the dynamics of a problem {wanted}.")
        return problem, _vector(state)
    if state is not None and start is not None:
        raise InputError("Arguments `state` and `start` exclude each other: leave out one.")
    known = known_problem(problem)
    values = known.values(gains=gains, parameters=parameters)
    begin = known.initial_state(start, values) if state is None else _vector(state)
    made = known.system(values)
    if start is not None:
        import numpy as np

        require_start(made, np.array(begin), _CONTACT, subject="Argument `start`")
    return made, begin


_CONTACT = 1e-6
"""Relative gap that is left to the simulator, whose settings decide on smaller ones."""


def _vector(state: Any) -> list[float]:
    """Return a state as a list of floats.

    Raises:
        InputError: If the state is not a sequence of floats or integers.
    """
    try:
        entries = list(state)
    except TypeError:
        wanted = f"must be a sequence of numbers, but it is {shown(state)}"
        raise InputError(f"Argument `state` {wanted}.") from None
    return [any_number("state", entry) for entry in entries]
