"""Measurements of work and precision: trials of engines, closures, meshes and reduced models.

The truth is computed in many digits, with an estimate of its own error. Errors are those of
`landmark.apart`; times are medians of processor time, which other work on the machine shakes less.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.integrators import (
    Automatic,
    Engine,
    SciPy,
    SteppingEngine,
    Taylor,
    decay_rates,
    engine_named,
    installed_engines,
)
from zeno_orbits.model import HybridDynamics, ParameterValues, Problem, bind
from zeno_orbits.precision.accuracy import at_tolerance
from zeno_orbits.precision.landmark import apart, landmarks
from zeno_orbits.precision.reference import Truth, true_landmarks
from zeno_orbits.precision.work_precision import Trial, WorkPrecision
from zeno_orbits.simulation import (
    Completion,
    Execution,
    FixedImpacts,
    SimulationSettings,
    Truncation,
    simulate,
)
from zeno_orbits.work import Progress, silent


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkPrecisionSettings:
    """Extent of the measurements.

    Attributes:
        until: Length of the execution [s].
        repeats: Runs of each setting.
        tolerances: Of the engines.
        slow_from: SciPy's methods are not tried below this tolerance: minutes would not do.
        cuts: Thresholds of the paper's rule, as gap rates.
        impacts: Numbers of impacts before the extrapolation.
        meshes: Mesh tolerances of the solve for a periodic orbit; none where there is no orbit.
    """

    until: float = 6.0
    repeats: int = 5
    tolerances: tuple[float, ...] = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
    slow_from: float = 1e-8
    cuts: tuple[float, ...] = (1.0, 1e-1, 1e-2, 1e-3, 1e-4)
    impacts: tuple[int, ...] = (1, 2, 3, 4, 6, 8)
    meshes: tuple[float, ...] = (1e-2, 1e-4, 1e-6, 3e-8)


QUICK = WorkPrecisionSettings(
    until=3.0, repeats=1, tolerances=(1e-4, 1e-8), cuts=(1e-1, 1e-3), impacts=(2, 4), meshes=()
)
"""A first look: seconds instead of a minute."""


def trade(
    problem: Problem,
    values: ParameterValues,
    state: Sequence[float],
    *,
    settings: WorkPrecisionSettings | None = None,
    on_progress: Progress = silent,
) -> WorkPrecision:
    """Return what accuracy costs in a problem.

    Args:
        problem: The problem.
        values: Its numbers.
        state: Initial state, ``(n_x,)``.
        settings: Extent of the measurements.
        on_progress: Called with what is being measured and the part that is done.

    Raises:
        SimulationError: If the problem cannot be followed so far.
    """
    settings = settings or WorkPrecisionSettings()
    dynamics = problem.dynamics(values)
    on_progress("computing the truth", 0.0)
    truth = true_landmarks(problem, values, dynamics, state, settings.until)
    plans = [
        *_plans(dynamics, state, settings),
        *_interpreted(problem, values, state, settings),
        *_reduced(problem, values, state, settings),
    ]
    trials: list[Trial] = []
    for k, plan in enumerate(plans):
        on_progress(f"{plan.sweep}: {plan.name}, {plan.value:.0e}", (k + 1) / (len(plans) + 1))
        trials.append(_tried(plan, truth, settings))
    trials += _meshes(problem, values, settings, on_progress)
    return WorkPrecision(
        problem=problem.name,
        work=f"{settings.until:g} s from {_named(problem, state)}",
        truth=truth.how,
        truth_error=truth.error,
        trials=tuple(trials),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Plan:
    """A trial to be made: how it runs, and which entries of the truth's state it knows."""

    sweep: str
    name: str
    value: float
    dynamics: HybridDynamics
    state: Sequence[float]
    entries: Sequence[int]
    simulation: SimulationSettings


def engines() -> dict[str, Engine]:
    """Return name to engine, for all that are installed."""
    from scipy.integrate import DOP853, LSODA
    from scipy.integrate import Radau as SciPyRadau

    return {name: engine_named(name) for name in installed_engines()} | {
        "SciPy DOP853": SciPy(method=DOP853),
        "SciPy LSODA": SciPy(method=LSODA),
        "SciPy Radau": SciPy(method=SciPyRadau),
    }


def _plans(
    dynamics: HybridDynamics, state: Sequence[float], settings: WorkPrecisionSettings
) -> Iterator[_Plan]:
    def plan(sweep: str, name: str, value: float, simulation: SimulationSettings) -> _Plan:
        return _Plan(
            sweep=sweep,
            name=name,
            value=value,
            dynamics=dynamics,
            state=state,
            entries=range(len(state)),
            simulation=simulation,
        )

    for name, engine in engines().items():
        for tolerance in settings.tolerances:
            if not isinstance(engine, SciPy) or tolerance >= settings.slow_from:
                yield plan("engine", name, tolerance, _settings(engine, tolerance))
    tight = _settings(Automatic(), min(settings.tolerances))
    closures: list[tuple[str, str, float, Completion]] = [
        *(("cut", "plastic below", delta, Truncation(delta=delta)) for delta in settings.cuts),
        *(("impacts", "limit after", n, FixedImpacts(n_impacts=n)) for n in settings.impacts),
    ]
    for sweep, name, value, completion in closures:
        yield plan(sweep, name, value, replace(tight, completion=completion))


def _interpreted(
    problem: Problem,
    values: ParameterValues,
    state: Sequence[float],
    settings: WorkPrecisionSettings,
) -> Iterator[_Plan]:
    """Plan the engines of compiled steps once more, interpreted; none where nothing is compiled."""
    compiled = problem.compiled()
    # What is measured must be compiled before, not in the middle of it.
    if not compiled.build(values.vector):
        return
    dynamics = bind(compiled.interpreted(), values.vector)
    for name, engine in engines().items():
        if isinstance(engine, SteppingEngine):
            for tolerance in settings.tolerances:
                yield _Plan(
                    sweep="engine",
                    name=f"{name}, interpreted",
                    value=tolerance,
                    dynamics=dynamics,
                    state=state,
                    entries=range(len(state)),
                    simulation=_settings(engine, tolerance),
                )


def _reduced(
    problem: Problem,
    values: ParameterValues,
    state: Sequence[float],
    settings: WorkPrecisionSettings,
) -> Iterator[_Plan]:
    """Plan the reduced models of a problem; the truth stays that of the full one."""
    for reduced in problem.ladder()[1:]:
        shared = reduced.shared(values)
        reduced.compiled().build(shared.vector)
        dynamics = reduced.dynamics(shared)
        entries = [problem.state_names.index(name) for name in reduced.state_names]
        for tolerance in settings.tolerances:
            yield _Plan(
                sweep="fidelity",
                name=reduced.name.partition("@")[2],
                value=tolerance,
                dynamics=dynamics,
                state=[state[entry] for entry in entries],
                entries=entries,
                simulation=_settings(Automatic(), tolerance),
            )


def _tried(plan: _Plan, truth: Truth, settings: WorkPrecisionSettings) -> Trial:
    """Run a plan, once to warm up and then for its time, and compare it with the truth."""
    trial = Trial(
        sweep=plan.sweep, name=plan.name, value=plan.value, seconds=math.inf, error=math.inf
    )
    if isinstance(plan.simulation.engine, Taylor) and _is_too_stiff(plan, settings.until):
        return replace(trial, trouble="left out: its steps are explicit, and the problem is stiff")
    try:
        execution, first = _timed(plan, settings.until)
        repeats = settings.repeats if first < _LONG else 0
        times = [_timed(plan, settings.until)[1] for _ in range(repeats)] or [first]
    except (ZenoOrbitsError, ArithmeticError, ValueError) as error:
        # Foreign integrators raise their own errors.
        return replace(trial, trouble=str(error))
    entries = list(plan.entries)
    known = [replace(mark, state=mark.state[entries]) for mark in truth.marks]
    return replace(
        trial,
        seconds=statistics.median(times),
        error=apart(landmarks(execution), known, truth.scale[entries]),
        n_impacts=len(execution.impacts),
    )


_MOST_DECAYS = 1e5
"""Fastest decay times horizon up to which a Taylor series takes less than a minute or so."""


def _is_too_stiff(plan: _Plan, until: float) -> bool:
    """Return True if Taylor series, explicit as they are, would take minutes."""
    fastest, _ = decay_rates(plan.dynamics.free, np.array(plan.state, dtype=np.float64))
    return fastest * until > _MOST_DECAYS


_LONG = 2.0
"""A run longer than this is not repeated [s]: nothing that warms up matters then."""

_MOST_STEPS = 10_000
"""Steps for every second of motion after which a setting is given up; good ones take 1000."""


def _timed(plan: _Plan, until: float) -> tuple[Execution, float]:
    limited = replace(plan.simulation, most_steps=round(_MOST_STEPS * max(until, 1.0)))
    started = time.process_time()
    execution = simulate(plan.dynamics, plan.state, until=until, settings=limited)
    return execution, time.process_time() - started


def _meshes(
    problem: Problem,
    values: ParameterValues,
    settings: WorkPrecisionSettings,
    on_progress: Progress,
) -> Iterator[Trial]:
    """Solve for the periodic orbit on finer and finer meshes, each compared with a simulation."""
    if not settings.meshes:
        return
    from zeno_orbits.search import SearchSettings, TranscriptionSettings, find_orbit

    for tolerance in settings.meshes:
        on_progress(f"mesh: {tolerance:.0e}", 0.99)
        transcription = TranscriptionSettings(mesh_tolerance=tolerance)
        looked = SearchSettings(transcription=transcription, agreement=math.inf, rounds=1)
        result = find_orbit(problem, values, settings=looked)
        found = result.orbit is not None
        yield Trial(
            sweep="mesh",
            name=f"{result.n_unknowns} unknowns" if found else "no orbit",
            value=tolerance,
            seconds=result.solve_time if found else math.inf,
            error=result.agreement if found else math.inf,
            n_impacts=0 if result.orbit is None else len(result.orbit.impacts),
            trouble="" if found else f"{result.status.value} {result.detail}".strip(),
        )
        if not found:
            return


def _settings(engine: Engine, tolerance: float) -> SimulationSettings:
    return at_tolerance(tolerance, SimulationSettings(engine=engine))


def _named(problem: Problem, state: Sequence[float]) -> str:
    pairs = zip(problem.state_names, state, strict=True)
    return ", ".join(f"{name} = {value:.6g}" for name, value in pairs if value) or "rest"
