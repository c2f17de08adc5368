"""Attractors at many parameter values of a problem: one chunk of a map."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import groupby

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.maps.approach import SAME_PERIOD, Accuracy, Approach
from zeno_orbits.maps.attractors import Attractor, AttractorClass
from zeno_orbits.maps.known import KnownOrbit, distinct_orbits, known_orbit
from zeno_orbits.maps.point import Point
from zeno_orbits.model import (
    GraphDynamics,
    ParameterValues,
    Problem,
    Start,
    own_time,
)
from zeno_orbits.simulation import OSCILLATIONS, WAITING, bounds_of, turns_in
from zeno_orbits.work import Progress, silent

_BOUNCY, _LONGEST = 0.5, 10.0
"""Restitution above which slow decay of impacts increases the time limit, and largest factor."""
_WANDERS = 10
"""Number of returns before the approach to an orbit from which small errors may decide."""
_FINER = 1e-2
"""Local error of the last simulation, in units of the orbit's local error."""
_DEPENDS = "its attractor depends on the smallest errors"


def attractors_at(
    problem: Problem,
    settings: Sequence[ParameterValues],
    *,
    start: Start | None = None,
    until: float | None = None,
    bounds: Mapping[str, float] | None = None,
    accuracy: Accuracy | None = None,
    on_progress: Progress = silent,
) -> tuple[Attractor, ...]:
    """Classify the attractor of the motion from one state, at every setting.

    The result at a setting does not depend on the other settings.

    Args:
        problem: The problem.
        settings: Values of its gains and parameters at each point.
        start: Initial state of all motions. The default is the problem's first initial state.
            Formulas among its entries are evaluated at every point.
        until: Longest simulated time [s]. The default is the `usual_time`.
        bounds: Largest modulus of coordinates by name. Beyond it a motion diverges. The default is
            the limit that the problem declares, or 20 pi for other coordinates.
        accuracy: Accuracy of the simulations.
        on_progress: Called with the finished part of the points after every increase.

    Raises:
        InputError: If a name is unknown or a value is out of its range.
    """
    if until is not None and not (math.isfinite(until) and until > 0.0):
        raise InputError(
            f"Argument `until` must be a finite, positive number of seconds, but it is {until}."
        )
    if not settings:
        return ()
    begin = problem.starts[0] if start is None else start
    motions = [(values, np.array(problem.state_vector(begin, values))) for values in settings]
    time = usual_time(problem, settings, motions[0][1]) if until is None else until
    return attractors_from(
        problem, motions, until=time, bounds=bounds, accuracy=accuracy, on_progress=on_progress
    )


def attractors_from(
    problem: Problem,
    motions: Sequence[tuple[ParameterValues, Vector]],
    *,
    until: float,
    bounds: Mapping[str, float] | None = None,
    accuracy: Accuracy | None = None,
    known: Sequence[KnownOrbit] = (),
    on_progress: Progress = silent,
) -> tuple[Attractor, ...]:
    """Classify the attractors of motions, each with its own initial state and values.

    The result of a motion does not depend on the other motions.

    Args:
        problem: The problem.
        motions: Values and initial state ``(n_x,)`` of each motion.
        until: Longest simulated time [s].
        bounds: As in `attractors_at`.
        accuracy: Accuracy of the simulations.
        known: Orbits at these values with which motions are compared.
        on_progress: Called with the finished part of the motions after every increase.

    Raises:
        InputError: If a bound is unknown or not positive.
    """
    limits, exact = _limits(problem, bounds), accuracy or Accuracy()
    found: list[Attractor] = []
    for _, alike in groupby(motions, key=lambda motion: id(motion[0])):
        values, states = zip(*alike, strict=True)
        try:
            graph = problem.graph_dynamics(values[0])
        except InputError as error:
            # A derived value may be outside of its range.
            failed = Attractor(fate=AttractorClass.FAILED, detail=str(error))
            found += [failed] * len(states)
            on_progress("classifying motions", len(found) / len(motions))
            continue
        for state in states:
            found.append(_settled(problem, graph, state, until, limits, exact, known)[0])
            on_progress("classifying motions", len(found) / len(motions))
    return tuple(found)


def approach_from(
    problem: Problem,
    graph: GraphDynamics,
    state: Vector,
    *,
    until: float,
    accuracy: Accuracy,
    known: Sequence[KnownOrbit],
) -> tuple[Attractor, Approach | None]:
    """Return the attractor of a motion, and its approach if the attractor has a period.

    Args:
        problem: The problem.
        graph: Its graph of modes.
        state: Initial state, ``(n_x,)``.
        until: Longest simulated time [s].
        accuracy: Accuracy of the simulation.
        known: Orbits of this machine with which the motion is compared.
    """
    return _settled(problem, graph, state, until, _limits(problem, None), accuracy, known)


def known_orbits(
    problem: Problem,
    values: ParameterValues,
    attractors: Sequence[Attractor],
    accuracy: Accuracy | None = None,
) -> tuple[KnownOrbit, ...]:
    """Return the distinct stable orbits among some attractors, for comparison with motions.

    Args:
        problem: The problem.
        values: Values of its gains and parameters.
        attractors: The attractors at these values.
        accuracy: Accuracy of the simulations.

    Raises:
        InputError: If the problem rejects the values.
    """
    graph, starts = problem.graph_dynamics(values), _starts(problem)
    units, exact = problem.state_units, accuracy or Accuracy()
    found = [known_orbit(graph, units, one, starts, exact) for one in attractors]
    return distinct_orbits([orbit for orbit in found if orbit is not None])


def _starts(problem: Problem) -> tuple[str, ...]:
    """Return the events at which periods start, for orbits that are told without their events."""
    return () if problem.has_graph else ("release stop", "impact stop")


def _settled(
    problem: Problem,
    graph: GraphDynamics,
    start: Vector,
    until: float,
    limits: Vector,
    accuracy: Accuracy,
    known: Sequence[KnownOrbit],
) -> tuple[Attractor, Approach | None]:
    """Return the attractor of one motion, and its approach."""
    starts = _starts(problem)
    motion = partial(
        Point,
        graph,
        problem.state_units,
        start,
        until,
        bounds=limits,
        known=known,
        starts=starts,
    )
    found, way = _sure_attractor(lambda accuracy: motion(accuracy=accuracy), accuracy)
    if starts and found.sequence:
        found = replace(found, sequence=(), returns=found.sequence.count(starts[0]))
    turns = turns_in(graph.first, start, found.period)
    return _in_words(problem, replace(found, turns=turns)), way


def _sure_attractor(
    motion: Callable[[Accuracy], Point], accuracy: Accuracy
) -> tuple[Attractor, Approach | None]:
    """Return the attractor of a motion. After a long transient, two accuracies have to agree.

    Args:
        motion: Function of an accuracy that returns the motion from its start.
        accuracy: The usual accuracy.

    Returns:
        The attractor, and the approach of the motion if the attractor has a period.
    """
    left = [
        replace(accuracy, motion=error, orbit=min(error, accuracy.orbit))
        for error in (accuracy.orbit, _FINER * accuracy.orbit)
        if error < accuracy.motion
    ]
    before: tuple[Attractor, Approach] | None = None
    while True:
        point = motion(accuracy)
        answer = point.attractor()
        way = point.way if math.isfinite(answer.period) else None
        if before is None:
            if way is None or not (way.captured >= _WANDERS or way.doubtful):
                return answer, way
        elif way is not None and _agree(*before, answer, way):
            return answer, way
        if way is None or not left:
            return Attractor(
                fate=AttractorClass.UNSETTLED, trend=answer.trend, detail=_DEPENDS
            ), None
        # A doubtful orbit says nothing.
        before, accuracy = None if way.doubtful else (answer, way), left.pop(0)


def _agree(first: Attractor, way: Approach, again: Attractor, way_again: Approach) -> bool:
    """Return True if a motion approaches the same orbit in the same way at two accuracies.

    Args:
        first: Attractor at the first accuracy.
        way: Approach to this attractor.
        again: Attractor at the higher accuracy.
        way_again: Approach to this attractor.
    """
    alike = (first.fate, first.returns) == (again.fate, again.returns)
    same = abs(first.period - again.period) <= SAME_PERIOD * first.period
    return alike and same and way.is_shared_by(way_again)


def usual_time(
    problem: Problem, settings: Sequence[ParameterValues], start: Sequence[float] | Vector
) -> float:
    """Return the default time limit of motions, from the characteristic time of the problem [s].

    The limit is a fixed number of periods of the slowest clock or oscillation, rounded to one
    digit. Without a clock and for `e` above 0.5, impacts decay more slowly, and the limit is larger
    by the factor `ln 0.5 / ln e`, at most by a fixed factor, which also applies to `e = 1`.

    Args:
        problem: The problem.
        settings: Values of its gains and parameters, at least one setting.
        start: Initial state of the motions, ``(n_x,)``.
    """
    state = np.array(start)
    firsts = [problem.first_system(values) for values in settings]
    slowest = max(own_time(first, state) for first in firsts)
    if problem.clock:
        return float(f"{WAITING * slowest:.0e}")
    bounciest = max(_restitution(problem, values) for values in settings)
    longer = 1.0 if bounciest <= _BOUNCY else _LONGEST
    if _BOUNCY < bounciest < 1.0:
        longer = min(math.log(_BOUNCY) / math.log(bounciest), _LONGEST)
    return float(f"{longer * OSCILLATIONS * slowest:.0e}")


def _restitution(problem: Problem, values: ParameterValues) -> float:
    """Return the largest restitution of all stops."""
    return max(view.restitution for view in problem.graph_dynamics(values).open_views)


def _in_words(problem: Problem, found: Attractor) -> Attractor:
    """Return an attractor with the problem's own description of a divergence."""
    if found.escaped not in problem.escapes:
        return found
    return replace(found, detail=problem.escapes[found.escaped].phrase)


def _limits(problem: Problem, bounds: Mapping[str, float] | None) -> Vector:
    declared = {name: escape.beyond for name, escape in problem.escapes.items()}
    declared |= dict(bounds or {})
    problem.state_vector(declared)
    for name, bound in declared.items():
        if not bound > 0.0:
            raise InputError(f"Argument `bounds` must be positive, but `{name}` has {bound:g}.")
    n_q = problem.compiled_graph().n_q
    return bounds_of(problem.state_names, problem.state_units, n_q, declared)
