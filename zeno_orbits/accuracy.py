"""A wanted accuracy into settings, and how far two executions are apart.

The settings are the cheapest that `zeno-orbits trade` measured to reach an accuracy, and nobody has
to believe them: an execution of a wanted accuracy is computed twice, ten times apart in tolerance,
and the difference is reported.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import pairwise

import numpy as np

from zeno_orbits.completion import ZenoPassage
from zeno_orbits.dynamics import HybridDynamics, Tolerance, Vector
from zeno_orbits.engines.automatic import PAYS, decay_rates
from zeno_orbits.errors import InputError, PenetrationError, SimulationError
from zeno_orbits.execution import Event, Execution, Impact, ZenoPoint
from zeno_orbits.simulate import SimulationSettings, simulate

FINEST, COARSEST = 1e-12, 1e-2
"""Accuracies that can be asked for."""

ROUNDING = 4e-15
"""Differences below this, times the number of events, are rounding: two runs may share it."""

_SHARE = 0.1
"""Tolerance in units of the accuracy: errors over ten periods stay below ten tolerances."""

_TIGHTEST = 1e-14
_STEP = 10.0

_NOTHING = 1e-12
"""A state that is never larger is zero to rounding, and no unit of its own error."""


class Kind(Enum):
    """What a landmark is."""

    IMPACT = "impact"
    ZENO = "Zeno point"
    RELEASE = "release"
    END = "end"


@dataclass(frozen=True, slots=True, kw_only=True)
class Landmark:
    """A point of an execution that another one has, too.

    Attributes:
        kind: What it is.
        time: When [s].
        state: Where, ``(n_x,)``; before the impact, where it is one.
    """

    kind: Kind
    time: float
    state: Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class Assured:
    """An execution with an estimate of its error.

    Attributes:
        execution: The execution.
        settings: What it was computed with.
        error: Its ``difference`` from one of ten times the tolerance, the error of that and so more
            than its own, or its Zeno points' own estimate where that is more.
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
    on_progress: Callable[[float], None] | None = None,
) -> Assured:
    """Return the completed execution to a wanted accuracy, with an estimate of its error.

    Args:
        dynamics: The system at fixed numbers.
        state: Initial state, ``(n_x,)``.
        until: When to stop [s].
        accuracy: Largest relative error of every event and of the end (see ``difference``).
        settings: Engine and limits; tolerance and completion follow the accuracy.
        on_progress: Called with the time reached.

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
    for tolerance in tolerances:
        tried = at_tolerance(tolerance, chosen)
        try:
            found = simulate(dynamics, state, until=until, settings=tried, on_progress=on_progress)
        except PenetrationError:
            # So coarse a run may go through the stop; the finest one may not.
            if tolerance == tolerances[-1]:
                raise
            continue
        if previous is not None:
            rounding = ROUNDING * (1 + len(found.events))
            error = max(difference(previous, found), _limit_error(found), rounding)
            if error <= accuracy:
                return Assured(execution=found, settings=tried, error=error)
            best = min(best, error)
        previous = found
    reached = f"the best estimate is {best:.1e}" if best < math.inf else "no two runs go one way"
    raise SimulationError(
        f"The accuracy {accuracy:.0e} is out of reach: {reached}",
        time=until,
        state=tuple(float(value) for value in state),
    )


def difference(first: Execution, second: Execution) -> float:
    """Return how far two executions are apart: the largest relative difference of what they have.

    That is every event and the end. Times are relative to the last event's, states to their largest
    value. Near a Zeno point one may resolve more impacts than the other. An event so late that the
    other one lacks it is held against the end of that: an end so near an impact is before it or
    after it, and no accuracy says which.

    Args:
        first: One execution.
        second: Another one to the same time.

    Returns:
        Infinity if they go different ways.
    """
    pairs = list(_pairs(_stretches(first), _stretches(second)))
    last = max((event.time for event in second.events), default=0.0)
    return _largest(pairs, sizes(second), last or second.end_time)


def landmarks(execution: Execution) -> tuple[Landmark, ...]:
    """Return what executions of different completions are judged by: releases, if there are any.

    Without a release, Zeno points; without these, impacts; without these, the end. So the paper's
    rule, whose Zeno instants mean little, is judged by what comes later.
    """
    for events in (execution.releases, execution.zeno_points, execution.impacts):
        if events:
            return tuple(_landmark(event) for event in events)
    return (_end(execution),)


def apart(first: Sequence[Landmark], second: Sequence[Landmark], scale: Vector) -> float:
    """Return the largest relative difference of two executions' landmarks.

    Args:
        first: Of one execution.
        second: Of the other; the time of the last one is the unit of the times.
        scale: Size of each state, ``(n_x,)`` (see ``sizes``).

    Returns:
        Infinity if one has a landmark that the other lacks.
    """
    if [mark.kind for mark in first] != [mark.kind for mark in second]:
        return math.inf
    return _largest(list(zip(first, second, strict=True)), scale, second[-1].time or 1.0)


def sizes(execution: Execution) -> Vector:
    """Return the largest value of each state at the ends of arcs, ``(n_x,)``; 1 for no value."""
    return sizes_of([x for arc in execution.arcs for x in (arc.start_state, arc.end_state)])


def sizes_of(states: Sequence[Sequence[float] | Vector]) -> Vector:
    """Return the largest value of each state among some, ``(n_x,)``; 1 for no value."""
    largest = np.max(np.abs(np.array(states, dtype=np.float64)), axis=0)
    return np.where(largest > _NOTHING, largest, 1.0)


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


def _limit_error(execution: Execution) -> float:
    """Return the largest error that the Zeno points themselves expect, relative to the states.

    Two runs that complete after the same impact share most of it, and so do not show it.
    """
    scale = sizes(execution)
    shares = [
        point.error * float(np.max((1.0 + np.abs(point.state)) / scale))
        for point in execution.zeno_points
    ]
    return max(shares, default=0.0)


def _landmark(event: Event) -> Landmark:
    if isinstance(event, Impact):
        return Landmark(kind=Kind.IMPACT, time=event.time, state=event.state_minus)
    kind = Kind.ZENO if isinstance(event, ZenoPoint) else Kind.RELEASE
    return Landmark(kind=kind, time=event.time, state=event.state)


def _end(execution: Execution) -> Landmark:
    return Landmark(kind=Kind.END, time=execution.end_time, state=execution.end_state)


def _stretches(execution: Execution) -> list[list[Landmark]]:
    """Return the landmarks in stretches: some impacts, then a Zeno point, a release or the end."""
    marks = [*map(_landmark, execution.events), _end(execution)]
    cuts = [k for k, mark in enumerate(marks, start=1) if mark.kind is not Kind.IMPACT]
    return [marks[start:stop] for start, stop in pairwise([0, *cuts])]


def _pairs(
    first: Sequence[Sequence[Landmark]], second: Sequence[Sequence[Landmark]]
) -> Iterator[tuple[Landmark, Landmark]]:
    """Yield what corresponds to each other."""
    for (*some, mark), (*others, other) in zip(first, second, strict=False):
        yield from zip(some, others, strict=False)
        if mark.kind is other.kind is Kind.END and len(some) != len(others):
            # One more impact before the end of one than before the end of the other.
            n = min(len(some), len(others))
            yield [*some, mark][n], [*others, other][n]
        else:
            yield mark, other


def _largest(pairs: Sequence[tuple[Landmark, Landmark]], scale: Vector, unit: float) -> float:
    """Return the largest relative difference within pairs; infinity if a pair is none."""
    if any(a.kind is not b.kind and Kind.END not in (a.kind, b.kind) for a, b in pairs):
        return math.inf
    times = [abs(a.time - b.time) / unit for a, b in pairs]
    states = [float(np.max(np.abs(a.state - b.state) / scale)) for a, b in pairs]
    # NumPy's maximum keeps NaN, which Python's may lose.
    return float(np.max([*times, *states]))
