"""A wanted accuracy into settings, and how far two executions are apart.

The settings are the cheapest that `zeno-orbits trade` measured to reach an accuracy, and nobody has
to believe them: an execution of a wanted accuracy is computed twice, ten times apart in tolerance,
and the difference is reported.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.completion import ZenoPassage
from zeno_orbits.dynamics import HybridDynamics, Tolerance, Vector
from zeno_orbits.engines.automatic import PAYS, decay_rates
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.execution import Execution
from zeno_orbits.simulate import SimulationSettings, simulate

FINEST, COARSEST = 1e-12, 1e-2
"""Accuracies that can be asked for."""

_SHARE = 0.1
"""Tolerance in units of the accuracy: errors over ten periods stay below ten tolerances."""

_TIGHTEST = 1e-14
_STEP = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Landmark:
    """A point of an execution that another one has, too.

    Attributes:
        time: When [s].
        state: Where, ``(n_x,)``.
    """

    time: float
    state: Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class Assured:
    """An execution with an estimate of its error.

    Attributes:
        execution: The execution.
        settings: What it was computed with.
        error: Its difference from one of ten times the tolerance: the error of that, and so more
            than its own. Relative: times to the horizon, states to their size.
    """

    execution: Execution
    settings: SimulationSettings
    error: float


def settings_for(accuracy: float, settings: SimulationSettings | None = None) -> SimulationSettings:
    """Return the cheapest settings that were measured to reach an accuracy.

    Args:
        accuracy: Largest relative error over some ten periods.
        settings: Everything else: engine, limits.

    Raises:
        InputError: If double precision cannot give it, or it is no accuracy at all.
    """
    if not FINEST <= accuracy <= COARSEST:
        wanted = f"must lie in [{FINEST:g}, {COARSEST:g}]"
        raise InputError(f"Argument `accuracy` {wanted}, but it is {accuracy:g}.")
    return _at_tolerance(settings or SimulationSettings(), _SHARE * accuracy)


def simulate_to(
    dynamics: HybridDynamics,
    state: Sequence[float] | Vector,
    *,
    until: float,
    accuracy: float,
    settings: SimulationSettings | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> Assured:
    """Return the completed execution to a wanted accuracy, with an estimate of its error.

    Args:
        dynamics: The system at fixed numbers.
        state: Initial state, ``(n_x,)``.
        until: When to stop [s].
        accuracy: Largest relative error of the landmarks (see ``landmarks``).
        settings: Engine and limits; tolerance and completion follow the accuracy.
        on_progress: Called with the time reached.

    Raises:
        InputError: If the accuracy is out of reach from the start.
        SimulationError: If the estimate stays above it: the motion magnifies rounding.
    """
    chosen = settings_for(accuracy, settings)
    coarse = _at_tolerance(chosen, _STEP * chosen.tolerance.relative)
    previous = simulate(dynamics, state, until=until, settings=coarse, on_progress=on_progress)
    error = math.inf
    while chosen.tolerance.relative >= _TIGHTEST:
        execution = simulate(dynamics, state, until=until, settings=chosen, on_progress=on_progress)
        error = apart(landmarks(previous), landmarks(execution), until)
        if error <= accuracy:
            return Assured(execution=execution, settings=chosen, error=error)
        previous = execution
        chosen = _at_tolerance(chosen, chosen.tolerance.relative / _STEP)
    raise SimulationError(
        f"The accuracy {accuracy:.0e} is out of reach: the best estimate is {error:.1e}",
        time=until,
        state=tuple(float(value) for value in state),
    )


def landmarks(execution: Execution) -> tuple[Landmark, ...]:
    """Return what an execution is judged by: its releases, and the end if that is no impact's.

    Without a release, its Zeno points; without these, its impacts. So the paper's rule, whose Zeno
    instants mean little, is judged by what comes later.
    """
    events = execution.releases or execution.zeno_points
    if events:
        return tuple(Landmark(time=event.time, state=event.state) for event in events)
    impacts = tuple(Landmark(time=i.time, state=i.state_minus) for i in execution.impacts)
    return impacts or (Landmark(time=execution.end_time, state=execution.end_state),)


def apart(first: Sequence[Landmark], second: Sequence[Landmark], horizon: float) -> float:
    """Return the largest relative difference of two executions' landmarks.

    Args:
        first: Of one execution.
        second: Of the other.
        horizon: Unit of the times [s].

    Returns:
        Infinity if one has a landmark that the other lacks.
    """
    if len(first) != len(second):
        return math.inf
    states = np.abs(np.array([mark.state for mark in second]))
    sizes = np.max(states, axis=0)
    scale = np.where(sizes > 0.0, sizes, 1.0)
    return max(
        max(abs(a.time - b.time) / horizon, float(np.max(np.abs(a.state - b.state) / scale)))
        for a, b in zip(first, second, strict=True)
    )


def why_engine(dynamics: HybridDynamics, state: Sequence[float] | Vector) -> str:
    """Return in one sentence how the default engine will go about a scene, and why.

    Args:
        dynamics: The system at fixed numbers.
        state: Where it starts, ``(n_x,)``.
    """
    fastest, slower = decay_rates(dynamics.free, np.array(state, dtype=np.float64))
    if fastest <= 0.0:
        return "explicit steps (DOP853): nothing decays."
    rates = f"the fastest decay is {fastest:.3g} 1/s, the next rate {slower:.3g} 1/s"
    if fastest > PAYS * slower:
        return f"explicit steps (DOP853) in layers, then implicit (Radau IIA, order 13): {rates}."
    return f"explicit steps (DOP853): {rates}."


def _at_tolerance(settings: SimulationSettings, tolerance: float) -> SimulationSettings:
    return replace(
        settings,
        tolerance=Tolerance(relative=tolerance, absolute=_SHARE * tolerance),
        completion=ZenoPassage(tolerance=max(tolerance, 1e-12)),
    )
