"""Attractors at many parameter values of a problem: one chunk of a map."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.maps.attempt import Accuracy
from zeno_orbits.maps.attractors import Attractor, Fate
from zeno_orbits.maps.crossings import Follower
from zeno_orbits.maps.known import KnownOrbit, distinct_orbits, known_orbit
from zeno_orbits.maps.point import Point
from zeno_orbits.maps.sure_point import sure_attractor
from zeno_orbits.model import HybridDynamics, ParameterValues, Problem, own_time
from zeno_orbits.simulation import OSCILLATIONS, WAITING, bounds_of, turns_in
from zeno_orbits.work import Progress, silent

_BOUNCY, _LONGEST = 0.5, 10.0
"""Restitution above which slow decay of impacts increases the time limit, and largest factor."""


def attractors_at(
    problem: Problem,
    settings: Sequence[ParameterValues],
    *,
    start: Mapping[str, float] | None = None,
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
            f"Argument `until` must be a positive number of seconds, but it is {until}."
        )
    if not settings:
        return ()
    state = np.array(problem.initial_state(start))
    time = usual_time(problem, settings, state) if until is None else until
    motions = [(values, state) for values in settings]
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
    system: tuple[ParameterValues, HybridDynamics] | None = None
    for values, state in motions:
        try:
            if system is None or system[0] is not values:
                system = values, problem.dynamics(values)
        except InputError as error:
            # A derived value may be outside of its range.
            found.append(Attractor(fate=Fate.FAILED, detail=str(error)))
        else:
            exact = accuracy or Accuracy()
            found.append(_attractor(problem, system[1], state, until, limits, exact, known))
        on_progress("classifying motions", len(found) / len(motions))
    return tuple(found)


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
    follower = Follower(dynamics=problem.dynamics(values), bounds=_limits(problem, None))
    exact = accuracy or Accuracy()
    found: list[KnownOrbit] = []
    for attractor in attractors:
        orbit = known_orbit(follower, problem.state_units, attractor, exact)
        if orbit is not None:
            found.append(orbit)
    return distinct_orbits(found)


def _attractor(
    problem: Problem,
    dynamics: HybridDynamics,
    start: Vector,
    until: float,
    limits: Vector,
    accuracy: Accuracy,
    known: Sequence[KnownOrbit],
) -> Attractor:
    """Return the attractor of one motion."""
    usual = dynamics.own.states(len(start))
    follower = Follower(dynamics=dynamics, bounds=limits)
    motion = partial(Point, follower, problem.state_units, start, until, usual=usual, known=known)
    found = sure_attractor(motion, accuracy)
    turns = turns_in(dynamics, start, found.period)
    return _in_words(problem, replace(found, turns=turns))


def usual_time(
    problem: Problem, settings: Sequence[ParameterValues], start: Sequence[float] | Vector
) -> float:
    """Return the default time limit of motions, from the characteristic time of the problem [s].

    The limit is a fixed number of periods of the slowest clock or oscillation, rounded to one
    digit. Without a clock and for `e` above 0.5, impacts decay more slowly, and the limit is larger
    by the factor `ln 0.5 / ln e`.

    Args:
        problem: The problem.
        settings: Values of its gains and parameters, at least one setting.
        start: Initial state of the motions, ``(n_x,)``.
    """
    state = np.array(start)
    slowest = max(own_time(problem.dynamics(values), state) for values in settings)
    if problem.compiled().clock:
        return float(f"{WAITING * slowest:.0e}")
    bounciest = max(values.parameters["restitution"] for values in settings)
    longer = math.log(_BOUNCY) / math.log(bounciest) if bounciest > _BOUNCY else 1.0
    return float(f"{min(longer, _LONGEST) * OSCILLATIONS * slowest:.0e}")


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
    return bounds_of(problem.state_names, problem.state_units, problem.compiled().n_q, declared)
