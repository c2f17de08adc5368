"""Attractors at many parameter values of a problem: one chunk of a map."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.maps.approach import Approach
from zeno_orbits.maps.attempt import Accuracy
from zeno_orbits.maps.attractors import Attractor, AttractorClass
from zeno_orbits.maps.crossings import Follower
from zeno_orbits.maps.event_point import EventPoint, known_event_orbit
from zeno_orbits.maps.known import KnownOrbit, distinct_orbits, known_orbit
from zeno_orbits.maps.point import Point
from zeno_orbits.maps.sure_point import sure_attractor
from zeno_orbits.model import (
    GraphDynamics,
    HybridDynamics,
    ParameterValues,
    Problem,
    Start,
    graph_of,
    own_time,
)
from zeno_orbits.simulation import OSCILLATIONS, WAITING, bounds_of, turns_in
from zeno_orbits.work import Progress, silent

_BOUNCY, _LONGEST = 0.5, 10.0
"""Restitution above which slow decay of impacts increases the time limit, and largest factor."""


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
    limits = _limits(problem, bounds)
    found: list[Attractor] = []
    system: tuple[ParameterValues, HybridDynamics | GraphDynamics] | None = None
    for values, state in motions:
        try:
            if system is None or system[0] is not values:
                system = values, problem.system(values)
        except InputError as error:
            # A derived value may be outside of its range.
            found.append(Attractor(fate=AttractorClass.FAILED, detail=str(error)))
        else:
            exact = accuracy or Accuracy()
            found.append(_settled(problem, system[1], state, until, limits, exact, known)[0])
        on_progress("classifying motions", len(found) / len(motions))
    return tuple(found)


def approach_from(
    problem: Problem,
    system: HybridDynamics | GraphDynamics,
    state: Vector,
    *,
    until: float,
    accuracy: Accuracy,
    known: Sequence[KnownOrbit],
) -> tuple[Attractor, Approach | None]:
    """Return the attractor of a motion, and its approach if the attractor has a period.

    Args:
        problem: The problem.
        system: Its system.
        state: Initial state, ``(n_x,)``.
        until: Longest simulated time [s].
        accuracy: Accuracy of the simulation.
        known: Orbits of this system with which the motion is compared.
    """
    return _settled(problem, system, state, until, _limits(problem, None), accuracy, known)


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
    system, exact = problem.system(values), accuracy or Accuracy()
    limits = _limits(problem, None)
    found: list[KnownOrbit] = []
    for attractor in attractors:
        if isinstance(system, GraphDynamics):
            orbit = known_event_orbit(system, attractor, exact)
        else:
            follower = Follower(dynamics=system, bounds=limits)
            orbit = known_orbit(follower, problem.state_units, attractor, exact)
        if orbit is not None:
            found.append(orbit)
    return distinct_orbits(found)


def _settled(
    problem: Problem,
    system: HybridDynamics | GraphDynamics,
    start: Vector,
    until: float,
    limits: Vector,
    accuracy: Accuracy,
    known: Sequence[KnownOrbit],
) -> tuple[Attractor, Approach | None]:
    """Return the attractor of one motion, and its approach."""
    units = problem.state_units
    motion: Callable[[Accuracy], Point | EventPoint]
    if isinstance(system, GraphDynamics):
        first = system.first
        motion = partial(EventPoint, system, units, start, until, bounds=limits, known=known)
    else:
        first = system
        usual = first.own.states(len(start))
        follower = Follower(dynamics=first, bounds=limits)
        motion = partial(Point, follower, units, start, until, usual=usual, known=known)
    found, way = sure_attractor(motion, accuracy)
    turns = turns_in(first, start, found.period)
    return _in_words(problem, replace(found, turns=turns)), way


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
    return max(view.restitution for view in graph_of(problem.system(values)).open_views)


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
    n_q = problem.first_system(problem.values()).n_q
    return bounds_of(problem.state_names, problem.state_units, n_q, declared)
