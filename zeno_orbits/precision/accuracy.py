"""Settings for a wanted accuracy, and error estimates of executions.

The settings are the cheapest that `zeno-orbits trade` measured to reach an accuracy. They are
checked: an execution is computed twice, at tolerances some way apart, and the difference is its
reported error.
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
from zeno_orbits.model import USUAL, HybridDynamics, OwnScale
from zeno_orbits.orbits import at_looser_tolerance
from zeno_orbits.precision.landmark import ROUNDING, difference, sizes
from zeno_orbits.simulation import (
    Execution,
    Impact,
    Release,
    SimulationSettings,
    ZenoPassage,
    ZenoPoint,
    simulate,
)
from zeno_orbits.work import Progress, portion, silent

FINEST, COARSEST = 1e-12, 1e-2
"""Accuracies that can be asked for."""

_SHARE = 0.1
"""Tolerance in units of the accuracy: errors over ten periods stay below ten tolerances."""

_TIGHTEST = 1e-14
_STEP = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Assured:
    """An execution with an estimate of its error.

    Attributes:
        execution: The execution.
        settings: Settings of the run.
        error: Its ``difference`` from one of a looser tolerance, the error of that and so more than
            its own; what its Zeno limits expect, rounding, or the tolerance itself where that is
            more. Infinite if the looser one goes another way or does not come through.
        zeno_errors: The same of every Zeno point alone, flights before it and limit together: of
            time and state, relative to ``1 + |t|`` and ``1 + |x|`` (1: own sizes).
    """

    execution: Execution
    settings: SimulationSettings
    error: float
    zeno_errors: tuple[float, ...]


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
    return at_tolerance(_SHARE * accuracy, settings)


def at_tolerance(
    tolerance: float, settings: SimulationSettings | None = None
) -> SimulationSettings:
    """Return settings at a tolerance, the Zeno limit's included.

    Args:
        tolerance: Relative error of a step.
        settings: Everything else: engine, limits.
    """
    return replace(
        settings or SimulationSettings(),
        tolerance=Tolerance(relative=tolerance, absolute=_SHARE * tolerance),
        completion=ZenoPassage(tolerance=max(tolerance, 1e-12)),
    )


def simulate_to(
    dynamics: HybridDynamics,
    state: Sequence[float] | Vector,
    *,
    until: float,
    accuracy: float,
    settings: SimulationSettings | None = None,
    on_progress: Progress = silent,
) -> Assured:
    """Return the completed execution to a wanted accuracy, with an estimate of its error.

    Args:
        dynamics: The system at fixed numbers.
        state: Initial state, ``(n_x,)``.
        until: When to stop [s].
        accuracy: Largest relative error of every event and of the end (see ``difference``).
        settings: Engine and limits; tolerance and completion follow the accuracy.
        on_progress: Called with the part of the time that each run has simulated.

    Raises:
        InputError: If the accuracy is out of reach from the start.
        SimulationError: If the estimate stays above it: the motion magnifies rounding.
    """
    chosen = settings_for(accuracy, settings)
    tolerances = [_STEP * chosen.tolerance.relative]
    while tolerances[-1] > 2 * _TIGHTEST:
        tolerances.append(tolerances[-1] / _STEP)
    previous: Execution | None = None
    best = math.inf
    for number, tolerance in enumerate(tolerances):
        tried = at_tolerance(tolerance, chosen)
        # Two runs are the rule; each further one gets half of what was left.
        progress = portion(on_progress, 1.0 - 0.5**number, 1.0 - 0.5 ** (number + 1))
        try:
            found = simulate(dynamics, state, until=until, settings=tried, on_progress=progress)
        except PenetrationError:
            # So coarse a run may go through the stop; the finest one may not.
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


def simulate_with_error(
    dynamics: HybridDynamics,
    state: Sequence[float] | Vector,
    *,
    until: float,
    settings: SimulationSettings | None = None,
    on_progress: Progress = silent,
) -> Assured:
    """Return the completed execution with given settings, and an estimate of its error.

    Args:
        dynamics: The system at fixed numbers.
        state: Initial state, ``(n_x,)``.
        until: When to stop [s].
        settings: Accuracy; a second run has a hundred times its tolerance.
        on_progress: Called with the part of the time that each run has simulated.

    Raises:
        InputError: If the state is not admissible or the horizon is not a positive number.
        SimulationError: If the execution cannot be continued; that of the second run may end early.
    """
    fine = settings or SimulationSettings()
    first, second = portion(on_progress, 0.0, 0.7), portion(on_progress, 0.7, 1.0)
    found = simulate(dynamics, state, until=until, settings=fine, on_progress=first)
    try:
        looser = simulate(
            dynamics,
            state,
            until=until,
            settings=at_looser_tolerance(fine),
            on_progress=second,
        )
    except SimulationError:
        looser = None
    return _beside(looser, found, fine, dynamics.own)


def _beside(
    looser: Execution | None, found: Execution, settings: SimulationSettings, own: OwnScale
) -> Assured:
    """Return an execution with the error that a looser one shows."""
    # Two runs that take the same steps share their errors, so no run is better than its tolerance.
    least = max(ROUNDING * (1 + len(found.events)), settings.tolerance.relative)
    error = math.inf if looser is None else difference(looser, found, own)
    return Assured(
        execution=found,
        settings=settings,
        error=max(error, _limit_error(found, own), least),
        zeno_errors=tuple(max(error, least) for error in errors_of_zeno_points(looser, found, own)),
    )


def errors_of_zeno_points(
    looser: Execution | None, found: Execution, own: OwnScale = USUAL
) -> Iterator[float]:
    """Yield the error of every Zeno point; infinity from where a looser run goes another way on.

    Args:
        looser: A run at a looser tolerance; None if it did not come through.
        found: The run.
        own: Sizes of the problem's numbers.
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


def _holds(execution: Execution) -> tuple[ZenoPoint | Release, ...]:
    """Return the events but for the impacts, of which a looser run may resolve fewer."""
    return tuple(event for event in execution.events if not isinstance(event, Impact))


def why_engine(dynamics: HybridDynamics, state: Sequence[float] | Vector, leg: float) -> str:
    """Return in one sentence how the default engine will go about a problem, and why.

    Args:
        dynamics: The system at fixed numbers.
        state: Where it starts, ``(n_x,)``.
        leg: How long it goes without an event [s]; what decays much sooner does not last.
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


def _limit_error(execution: Execution, own: OwnScale) -> float:
    """Return the largest error that the Zeno points themselves expect, relative to the states.

    Two runs that complete after the same impact share most of it, and so do not show it.
    """
    scale = sizes(execution, own)
    shares = [
        point.limit_error * float(np.max((own.states(len(scale)) + np.abs(point.state)) / scale))
        for point in execution.zeno_points
    ]
    return max(shares, default=0.0)
