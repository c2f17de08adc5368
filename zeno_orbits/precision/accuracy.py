"""Settings for a required accuracy, and error estimates of executions.

The settings are the cheapest that reached an accuracy in `zeno-orbits work-precision`. They are
checked: an execution is computed twice, at different tolerances. The difference is its reported
error.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, PenetrationError, SimulationError
from zeno_orbits.integrators import PAYS, Tolerance, flow_eigenvalues, rates_of, staying_rate
from zeno_orbits.model import UNIT_SCALES, CharacteristicScales, GraphDynamics, HybridDynamics
from zeno_orbits.orbits import relaxed_tolerance
from zeno_orbits.precision.landmark import ROUNDING, execution_distance, sizes
from zeno_orbits.simulation import (
    Execution,
    Impact,
    Release,
    SimulationSettings,
    SwitchEvent,
    Truncation,
    ZenoPassage,
    ZenoPoint,
    simulate,
)
from zeno_orbits.work import Progress, portion, silent

FINEST, COARSEST = 1e-12, 1e-2
"""Range of accuracies that can be requested."""

_SHARE = 0.1
"""Tolerance in units of the accuracy: errors over ten periods stay below ten tolerances."""

_TIGHTEST = 1e-14
_STEP = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ExecutionWithError:
    """An execution with an estimate of its error.

    Attributes:
        execution: The execution.
        settings: Settings of the run.
        error: Estimated error. It is the ``execution_distance`` from an execution at a looser
            tolerance. This is the error of the looser execution, so it is larger than the actual
            error. If the estimated error of the Zeno limits, rounding or the tolerance is larger,
            the error is the largest of these values. It is infinite if the looser execution has
            other events or fails.
        zeno_errors: Estimated error of every Zeno point alone, which includes the flights before it
            and its limit. Errors of time and state are relative to ``1 + |t|`` and ``1 + |x|``,
            where 1 is the characteristic scale.
    """

    execution: Execution
    settings: SimulationSettings
    error: float
    zeno_errors: tuple[float, ...]


def settings_for(accuracy: float, settings: SimulationSettings | None = None) -> SimulationSettings:
    """Return the cheapest settings that reached an accuracy in measurements.

    Args:
        accuracy: Largest relative error over about ten periods.
        settings: All other settings: integrator, limits.

    Raises:
        InputError: If double precision cannot reach the accuracy, or the value is not an accuracy.
    """
    if not FINEST <= accuracy <= COARSEST:
        wanted = f"must lie in [{FINEST:g}, {COARSEST:g}]"
        raise InputError(f"Argument `accuracy` {wanted}, but it is {accuracy:g}.")
    return at_tolerance(_SHARE * accuracy, settings)


def at_tolerance(
    tolerance: float, settings: SimulationSettings | None = None
) -> SimulationSettings:
    """Return settings at a tolerance, with the corresponding tolerance of the Zeno limit.

    Args:
        tolerance: Relative error of a step.
        settings: All other settings: integrator, limits.
    """
    return replace(
        settings or SimulationSettings(),
        tolerance=Tolerance(relative=tolerance, absolute=_SHARE * tolerance),
        completion=ZenoPassage(tolerance=max(tolerance, 1e-12)),
    )


def execution_to_accuracy(
    dynamics: HybridDynamics | GraphDynamics,
    state: Sequence[float] | Vector,
    *,
    until: float,
    accuracy: float,
    settings: SimulationSettings | None = None,
    on_progress: Progress = silent,
) -> ExecutionWithError:
    """Return the completed execution to a required accuracy, with an estimate of its error.

    Args:
        dynamics: The system at fixed parameter values.
        state: Initial state, ``(n_x,)``.
        until: End time [s].
        accuracy: Largest relative error of every event and of the end (see ``execution_distance``).
        settings: Integrator and limits. Tolerance and completion are derived from the accuracy.
        on_progress: Called with the simulated fraction of the time of each run.

    Raises:
        InputError: If the accuracy is outside the range of double precision.
        SimulationError: If the estimate remains above the accuracy, because the motion amplifies
            rounding errors.
    """
    chosen = settings_for(accuracy, settings)
    tolerances = [_STEP * chosen.tolerance.relative]
    while tolerances[-1] > 2 * _TIGHTEST:
        tolerances.append(tolerances[-1] / _STEP)
    previous: Execution | None = None
    best = math.inf
    for number, tolerance in enumerate(tolerances):
        tried = at_tolerance(tolerance, chosen)
        # Usually there are two runs. Each further run gets half of the remaining progress.
        progress = portion(on_progress, 1.0 - 0.5**number, 1.0 - 0.5 ** (number + 1))
        try:
            found = simulate(dynamics, state, until=until, settings=tried, on_progress=progress)
        except PenetrationError:
            # A coarse run may penetrate the stop, but the finest run may not.
            if tolerance == tolerances[-1]:
                raise
            continue
        if previous is not None:
            assured = _beside(previous, found, tried, dynamics.own)
            if assured.error <= accuracy:
                return assured
            best = min(best, assured.error)
        previous = found
    reached = (
        f"the best estimate is {best:.1e}"
        if best < math.inf
        else "no two runs have the same events"
    )
    raise SimulationError(
        f"The accuracy {accuracy:.0e} is out of reach: {reached}",
        time=until,
        state=tuple(float(value) for value in state),
    )


def execution_with_error(
    dynamics: HybridDynamics | GraphDynamics,
    state: Sequence[float] | Vector,
    *,
    until: float,
    settings: SimulationSettings | None = None,
    on_progress: Progress = silent,
) -> ExecutionWithError:
    """Return the completed execution with given settings, and an estimate of its error.

    Args:
        dynamics: The system at fixed parameter values.
        state: Initial state, ``(n_x,)``.
        until: End time [s].
        settings: Accuracy. A second run has a hundred times its tolerance. If the settings truncate
            impact sequences, the second run has the same tolerance and computes their limit.
        on_progress: Called with the simulated fraction of the time of each run.

    Raises:
        InputError: If the state is not admissible or the horizon is not a positive number.
        SimulationError: If the execution cannot be continued. The second run may end early.
    """
    fine = settings or SimulationSettings()
    first, second = portion(on_progress, 0.0, 0.7), portion(on_progress, 0.7, 1.0)
    found = simulate(dynamics, state, until=until, settings=fine, on_progress=first)
    is_cut = isinstance(fine.completion, Truncation)
    other = replace(fine, completion=ZenoPassage()) if is_cut else relaxed_tolerance(fine)
    try:
        looser = simulate(
            dynamics,
            state,
            until=until,
            settings=other,
            on_progress=second,
        )
    except SimulationError:
        looser = None
    return _beside(looser, found, fine, dynamics.own)


def _beside(
    looser: Execution | None,
    found: Execution,
    settings: SimulationSettings,
    own: CharacteristicScales,
) -> ExecutionWithError:
    """Return an execution with its error, estimated from a looser execution."""
    # Two runs that take the same steps share their errors, so no run is better than its tolerance.
    least = max(ROUNDING * (1 + len(found.events)), settings.tolerance.relative)
    error = math.inf if looser is None else execution_distance(looser, found, own)
    return ExecutionWithError(
        execution=found,
        settings=settings,
        error=max(error, _limit_error(found, own), least),
        zeno_errors=tuple(max(error, least) for error in errors_of_zeno_points(looser, found, own)),
    )


def errors_of_zeno_points(
    looser: Execution | None, found: Execution, own: CharacteristicScales = UNIT_SCALES
) -> Iterator[float]:
    """Yield the error of every Zeno point, infinite after the first event that differs.

    Args:
        looser: A run at a looser tolerance, or ``None`` if it failed.
        found: The run.
        own: Characteristic scales of the problem.
    """
    others = () if looser is None else _holds(looser)
    alike = True
    for one, other in zip_longest(_holds(found), others):
        alike = alike and type(one) is type(other)
        if not isinstance(one, ZenoPoint):
            continue
        if alike and isinstance(other, ZenoPoint):
            times = abs(one.time - other.time) / (own.time + abs(one.time))
            usual = own.states(len(one.state)) + np.abs(one.state)
            states = np.abs(one.state - other.state) / usual
            yield max(times, float(np.max(states))) + one.limit_error
        else:
            yield math.inf


def _holds(execution: Execution) -> tuple[ZenoPoint | Release | SwitchEvent, ...]:
    """Return all events except impacts, because a looser run may resolve fewer impacts."""
    return tuple(event for event in execution.events if not isinstance(event, Impact))


def why_engine(dynamics: HybridDynamics, state: Sequence[float] | Vector, leg: float) -> str:
    """Return a sentence on the method of the default integrator for a problem, with its reason.

    Args:
        dynamics: The system at fixed parameter values.
        state: Initial state, ``(n_x,)``.
        leg: Time without an event [s]. A mode that decays much sooner is a transient.
    """
    values = flow_eigenvalues(dynamics.free, np.array(state, dtype=np.float64))
    fastest, _ = rates_of(values)
    if fastest <= 0.0:
        return "explicit steps (DOP853): nothing decays."
    lasting = staying_rate(values, leg)
    rates = f"the fastest mode decays at {fastest:.3g} 1/s, the others change at {lasting:.3g} 1/s"
    if fastest > PAYS * lasting:
        steps = "implicit steps (Radau IIA, order 13) after each fast transient"
        return f"{steps}, explicit ones (DOP853) within; {rates}."
    return f"explicit steps (DOP853); {rates}."


def _limit_error(execution: Execution, own: CharacteristicScales) -> float:
    """Return the largest estimated error of the Zeno limits, relative to the states.

    Two runs that complete after the same impact share most of this error, so their difference does
    not contain it.
    """
    scale = sizes(execution, own)
    shares = [
        point.limit_error * float(np.max((own.states(len(scale)) + np.abs(point.state)) / scale))
        for point in execution.zeno_points
    ]
    return max(shares, default=0.0)
