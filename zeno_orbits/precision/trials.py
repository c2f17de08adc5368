"""Work-precision study: trials of integrators, Zeno approximations, meshes and reduced models.

The reference solution is computed at the tightest tolerance by two integrators. Their difference
bounds its error. Errors are computed by `landmark.apart`. Times are medians of processor time.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from zeno_orbits.errors import SimulationError, ZenoOrbitsError, counted
from zeno_orbits.integrators import (
    ENGINES,
    Automatic,
    Engine,
    SciPy,
    SteppingEngine,
    engine_named,
)
from zeno_orbits.loop import program_of
from zeno_orbits.model import HybridDynamics, ParameterValues, Problem, bind
from zeno_orbits.precision.accuracy import at_tolerance
from zeno_orbits.precision.landmark import apart, landmarks
from zeno_orbits.precision.reference import Truth, true_landmarks
from zeno_orbits.precision.work_precision import TimedSetting, WorkPrecision
from zeno_orbits.simulation import (
    Completion,
    Execution,
    FixedImpacts,
    SimulationSettings,
    Truncation,
    simulate,
)
from zeno_orbits.work import Checked, Progress, silent


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkPrecisionSettings(Checked):
    """Extent of the measurements.

    Attributes:
        until: Length of the execution [s]. By default it is at least ``least``, and includes the
            first release after a Zeno point, the first Zeno point, or else the first impact.
        least: Shortest length if ``until`` is not given [s]. It is at most a thousand
            characteristic times of the problem.
        repeats: Number of runs of each setting.
        tolerances: Tolerances of the integrators.
        slow_from: Smallest tolerance at which SciPy's methods are tried. Below it, minutes would
            not be sufficient.
        cuts: Thresholds of the paper's rule, as gap rates.
        impacts: Numbers of resolved impacts from which the Zeno limit is extrapolated.
        meshes: Mesh tolerances of the solver for a periodic orbit. Empty without an orbit.
    """

    until: float | None = None
    least: float = 6.0
    repeats: int = 5
    tolerances: tuple[float, ...] = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
    slow_from: float = 1e-8
    cuts: tuple[float, ...] = (1.0, 1e-1, 1e-2, 1e-3, 1e-4)
    impacts: tuple[int, ...] = (1, 2, 3, 4, 6, 8)
    meshes: tuple[float, ...] = (1e-2, 1e-4, 1e-6, 3e-8)

    @classmethod
    def quick(cls) -> WorkPrecisionSettings:
        """Return settings for a quick study, which takes seconds instead of a minute."""
        return cls(
            least=3.0,
            repeats=1,
            tolerances=(1e-4, 1e-8),
            cuts=(1e-1, 1e-3),
            impacts=(2, 4),
            meshes=(),
        )


QUICK = WorkPrecisionSettings.quick()


def measure_work_precision(
    problem: Problem,
    values: ParameterValues,
    state: Sequence[float],
    *,
    settings: WorkPrecisionSettings | None = None,
    on_progress: Progress = silent,
) -> WorkPrecision:
    """Measure the computing time against the accuracy for a problem.

    Args:
        problem: The problem.
        values: Its parameter values.
        state: Initial state, ``(n_x,)``.
        settings: Extent of the measurements.
        on_progress: Called with the name of the current measurement and the completed fraction.

    Raises:
        SimulationError: If the problem cannot be simulated that long.
    """
    settings = settings or WorkPrecisionSettings()
    dynamics = problem.dynamics(values)
    until, seen = _window(dynamics, state, settings)
    settings = replace(settings, until=until)
    on_progress("computing the truth", 0.0)
    truth = true_landmarks(dynamics, state, until)
    plans = [
        *_plans(dynamics, state, settings),
        *_interpreted(problem, values, state, settings),
        *_reduced(problem, values, state, settings),
    ]
    trials: list[TimedSetting] = []
    for k, plan in enumerate(plans):
        on_progress(f"{plan.sweep}: {plan.name}, {plan.value:.0e}", (k + 1) / (len(plans) + 1))
        trials.append(_tried(plan, truth, settings))
    trials += _meshes(problem, values, settings, on_progress)
    return WorkPrecision(
        problem=problem.name,
        work=f"{until:g} s from {_named(problem, state)}; {seen}",
        truth=truth.how,
        truth_error=truth.error,
        trials=tuple(trials),
        compared=truth.marks[0].label,
    )


_LONGER = 7
"""Number of times that a window without a Zeno point is doubled, to search for a Zeno point."""
_MOST_TIMES = 1000.0
"""Largest number of characteristic times in the shortest window.

A micro relay has a million characteristic times per second.
"""
_AFTER = 1.1
"""Ratio of the length of a window to the time of its last event, so that rounding cannot decide."""


def _window(
    dynamics: HybridDynamics, state: Sequence[float], settings: WorkPrecisionSettings
) -> tuple[float, str]:
    """Return the length of the execution, and a description of its events.

    The best settings for smooth flight are not relevant for impacts. So a window without a Zeno
    point grows until it contains a Zeno point, if possible.
    """
    if settings.until is not None:
        return settings.until, _events_in(simulate(dynamics, state, until=settings.until))
    least = min(settings.least, _MOST_TIMES * dynamics.own.time)
    found = simulate(dynamics, state, until=least)
    for doubled in range(1, _LONGER + 1):
        if _released(found):
            break
        try:
            found = simulate(dynamics, state, until=least * 2**doubled)
        except SimulationError as error:
            found = error.execution or found
            break
    points = [point.time for point in found.zeno_points[:1]]
    impacts = [impact.time for impact in found.impacts[:1]]
    held = _released(found)[:1] or points or impacts
    until = max([least, *(_AFTER * time for time in held)])
    # The length was computed and not typed by a user, so three digits are enough.
    until = float(f"{until:.3g}")
    return until, _events_in(simulate(dynamics, state, until=until))


def _released(execution: Execution) -> list[float]:
    """Return the times of releases after a Zeno point [s]."""
    points = execution.zeno_points
    return [one.time for one in execution.releases if points and one.time > points[0].time]


def _events_in(execution: Execution) -> str:
    counts = (
        (len(execution.impacts), "impact"),
        (len(execution.zeno_points), "Zeno point"),
        (len(execution.releases), "release"),
    )
    words = [counted(number, noun) for number, noun in counts if number]
    return ", ".join(words) or "no impact in it"


class _Plan(NamedTuple):
    """A planned trial: its simulation, and the entries of the reference state that it computes."""

    sweep: str
    name: str
    value: float
    simulation: SimulationSettings
    dynamics: HybridDynamics
    state: Sequence[float]
    entries: Sequence[int]


def engines() -> dict[str, Engine]:
    """Return the integrators by name."""
    from scipy.integrate import DOP853, LSODA
    from scipy.integrate import Radau as SciPyRadau

    return {name: engine_named(name) for name in ENGINES} | {
        "SciPy DOP853": SciPy(method=DOP853),
        "SciPy LSODA": SciPy(method=LSODA),
        "SciPy Radau": SciPy(method=SciPyRadau),
    }


def _plans(
    dynamics: HybridDynamics, state: Sequence[float], settings: WorkPrecisionSettings
) -> Iterator[_Plan]:
    own = dynamics, state, range(len(state))
    for name, engine in engines().items():
        for tolerance in settings.tolerances:
            if not isinstance(engine, SciPy) or tolerance >= settings.slow_from:
                yield _Plan("engine", name, tolerance, _settings(engine, tolerance), *own)
    tight = _settings(Automatic(), min(settings.tolerances))
    closures: list[tuple[str, str, float, Completion]] = [
        *(("cut", "plastic below", delta, Truncation(delta=delta)) for delta in settings.cuts),
        *(("impacts", "limit after", n, FixedImpacts(n_impacts=n)) for n in settings.impacts),
    ]
    for sweep, name, value, completion in closures:
        yield _Plan(sweep, name, value, replace(tight, completion=completion), *own)


def _interpreted(
    problem: Problem,
    values: ParameterValues,
    state: Sequence[float],
    settings: WorkPrecisionSettings,
) -> Iterator[_Plan]:
    """Plan additional runs of our integrators in interpreted Python, the reference implementation.

    The result is empty if the problem is not compiled.
    """
    compiled = problem.compiled()
    if program_of(compiled) is None:
        return
    dynamics = bind(compiled.interpreted(), values.vector)
    for name, engine in engines().items():
        if isinstance(engine, SteppingEngine):
            for tolerance in settings.tolerances:
                yield _Plan(
                    "engine",
                    f"{name}, interpreted",
                    tolerance,
                    _settings(engine, tolerance),
                    *(dynamics, state, range(len(state))),
                )


def _reduced(
    problem: Problem,
    values: ParameterValues,
    state: Sequence[float],
    settings: WorkPrecisionSettings,
) -> Iterator[_Plan]:
    """Plan the reduced models of a problem. The reference is still the full problem."""
    for reduced in problem.ladder()[1:]:
        shared = reduced.shared(values)
        dynamics = reduced.dynamics(shared)
        entries = [problem.state_names.index(name) for name in reduced.state_names]
        word, own = reduced.name.partition("@")[2], [state[entry] for entry in entries]
        for tolerance in settings.tolerances:
            simulation = _settings(Automatic(), tolerance)
            yield _Plan("fidelity", word, tolerance, simulation, dynamics, own, entries)


def _tried(plan: _Plan, truth: Truth, settings: WorkPrecisionSettings) -> TimedSetting:
    """Run a plan once as a warm-up, then for timing, and compare it with the reference."""
    trial = TimedSetting(
        sweep=plan.sweep, name=plan.name, value=plan.value, seconds=math.inf, error=math.inf
    )
    until = settings.until or settings.least
    try:
        execution, first = _timed(plan, until)
        repeats = settings.repeats if first < _LONG else 0
        times = [_timed(plan, until)[1] for _ in range(repeats)] or [first]
    except (ZenoOrbitsError, ArithmeticError, ValueError) as error:
        # Third-party integrators raise their own errors.
        return replace(trial, trouble=str(error))
    entries = list(plan.entries)
    known = [replace(mark, state=mark.state[entries]) for mark in truth.marks]
    return replace(
        trial,
        seconds=statistics.median(times),
        error=apart(landmarks(execution), known, truth.scale[entries]),
        n_impacts=len(execution.impacts),
        speed=_cut_speed(execution) if plan.sweep == "cut" else math.nan,
    )


def _cut_speed(execution: Execution) -> float:
    """Return the geometric mean of the gap rates at which impact sequences were truncated."""
    speeds = [point.last_speed for point in execution.zeno_points if point.last_speed > 0.0]
    return math.exp(statistics.fmean(map(math.log, speeds))) if speeds else math.nan


_LONG = 2.0
"""Duration beyond which a run is not repeated [s], because the warm-up is then negligible."""

_MOST_STEPS = 10_000
"""Largest number of steps per second, or per ten characteristic times if these are shorter.

A setting that needs more steps is abandoned. Good settings take 1000 steps.
"""


def _timed(plan: _Plan, until: float) -> tuple[Execution, float]:
    spans = until / min(10.0 * plan.dynamics.own.time, 1.0)
    limited = replace(plan.simulation, most_steps=round(_MOST_STEPS * max(spans, 1.0)))
    started = time.process_time()
    execution = simulate(plan.dynamics, plan.state, until=until, settings=limited)
    return execution, time.process_time() - started


def _meshes(
    problem: Problem,
    values: ParameterValues,
    settings: WorkPrecisionSettings,
    on_progress: Progress,
) -> Iterator[TimedSetting]:
    """Solve for the periodic orbit on successively finer meshes, and compare with a simulation."""
    if not settings.meshes:
        return
    from zeno_orbits.search import SearchSettings, TranscriptionSettings, orbit_at_gains

    for tolerance in settings.meshes:
        on_progress(f"mesh: {tolerance:.0e}", 0.99)
        transcription = TranscriptionSettings(mesh_tolerance=tolerance)
        looked = SearchSettings(transcription=transcription, agreement=math.inf, rounds=1)
        result = orbit_at_gains(problem, values, settings=looked)
        found = result.orbit is not None
        yield TimedSetting(
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
