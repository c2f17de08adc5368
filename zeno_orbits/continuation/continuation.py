r"""Families of Zeno periodic orbits in a gain or a parameter, stable or not.

From one orbit the family is followed both ways until it ends, and every point at which it changes
its character is located and named. Numbers that the problem derives from others, as the motor
pendulum's calibrated constants, are held at their values at the start: what is followed is one
machine of which one number changes. Source: [Keller1977]_, theory (37) to (40).

Families of orbits that strike the stop once a turn and never rest on it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.assembly import Grown, as_family
from zeno_orbits.continuation.branch import Branch, Tell
from zeno_orbits.continuation.corrector import Metric, first_point
from zeno_orbits.continuation.families import Continuation, Kind
from zeno_orbits.continuation.parallel import Crew, Direction, Dispatch, Doubling
from zeno_orbits.continuation.return_maps import ImpactReturns
from zeno_orbits.continuation.setup import (
    ContinuationSettings,
    Course,
    Root,
    Track,
    check_box,
    line_in,
    plane_of,
    root_of,
)
from zeno_orbits.continuation.two_parameters.boundary_set import curves_through
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model.problem import ParameterValues, Problem
from zeno_orbits.orbits.orbit import ZenoOrbit, versions
from zeno_orbits.orbits.shape import ONE_ZENO
from zeno_orbits.search import close_orbit, find_orbit
from zeno_orbits.simulation.simulator import simulate
from zeno_orbits.work.progress import Progress, silent
from zeno_orbits.work.serialization import plain


def _silent(stage: str, part: float | None) -> None:
    """Tell nobody."""


def continue_orbit(
    problem: Problem,
    orbit: ZenoOrbit,
    parameter: str,
    box: tuple[float, float],
    *,
    settings: ContinuationSettings | None = None,
    tell: Tell = _silent,
    crew: Crew | None = None,
) -> Continuation:
    """Return the family of an orbit in a gain or a parameter, and what branches off it.

    Args:
        problem: The problem.
        orbit: An orbit of it; its parameter must lie in the box.
        parameter: Name of a gain or a parameter.
        box: Range in which to follow it, lower end first.
        settings: How.
        tell: Called with what happens.
        crew: Workers; by default this process does it all.

    Raises:
        InputError: If a name or a range does not fit, or the orbit is of another problem.
        SimulationError: If the orbit does not close.
        WorkError: If the work cannot be finished.
    """
    settings = settings or ContinuationSettings()
    root = root_of(problem, orbit, parameter, box, settings)
    return continuation_on(root, settings=settings, tell=tell, crew=crew)


def continue_orbit_in_two(
    problem: Problem,
    orbit: ZenoOrbit,
    names: tuple[str, str],
    boxes: tuple[tuple[float, float], tuple[float, float]],
    *,
    kinds: tuple[Kind, ...],
    settings: ContinuationSettings | None = None,
    tell: Tell = _silent,
    crew: Crew | None = None,
) -> Continuation:
    """Return the family of an orbit in the first of two parameters, and its points in both.

    Args:
        problem: The problem.
        orbit: An orbit of it; both parameters must lie in their boxes.
        names: Names of two gains or parameters.
        boxes: Their ranges.
        kinds: Which kinds of special points to follow.
        settings: How.
        tell: Called with what happens.
        crew: Workers; by default this process does it all.

    Raises:
        InputError: If a name or a range does not fit, or the orbit is of another problem.
        SimulationError: If the orbit does not close.
        WorkError: If the work cannot be finished.
    """
    settings = settings or ContinuationSettings()
    plane = plane_of(problem, orbit, names, boxes)
    root = root_of(problem, orbit, names[0], boxes[0], settings)
    own = {"second": names[1], "box": list(boxes[1]), "kinds": [kind.name for kind in kinds]}
    dispatch = _dispatch(root, settings, tell, crew, own)
    grown = _grown_from(root, dispatch)
    return Continuation(
        families=tuple(one.family for one in grown),
        boundaries=curves_through(dispatch, plane, grown, kinds),
        versions=versions(),
    )


def continuation_on(
    root: Root,
    *,
    settings: ContinuationSettings,
    tell: Tell = _silent,
    crew: Crew | None = None,
) -> Continuation:
    """Return the family through a state of a section, and what branches off it.

    Args:
        root: Where it begins.
        settings: How.
        tell: Called with what happens.
        crew: Workers; by default this process does it all.

    Raises:
        InputError: If the crew has another problem, or its checkpoint is another's.
        SimulationError: If there is no fixed point near.
        WorkError: If the work cannot be finished.
    """
    grown = _grown_from(root, _dispatch(root, settings, tell, crew, {}))
    return Continuation(families=tuple(one.family for one in grown), versions=versions())


def _dispatch(
    root: Root,
    settings: ContinuationSettings,
    tell: Tell,
    crew: Crew | None,
    own: dict[str, Any],
) -> Dispatch:
    """Return who follows a family, with all that its result depends on."""
    course, problem = root.track.course, root.track.problem
    identity = {
        "problem": problem.name,
        "gains": plain(course.values.gains),
        "parameters": plain(course.values.parameters),
        "in": course.parameter,
        "range": list(course.box),
        "section": plain(course.section),
        "start": [*root.x.tolist(), root.s],
        "settings": plain(settings, "settings"),
        "versions": versions(),
        **own,
    }
    dispatch = Dispatch(problem=problem, settings=settings, tell=tell, crew=crew)
    return dispatch.claimed(identity)


def _grown_from(root: Root, dispatch: Dispatch) -> list[Grown]:
    """Return the family through a state, and those that flips throw off."""
    found = [_both_ways(root, dispatch)]
    latest = list(found)
    for generation in range(dispatch.settings.doublings):
        thrown = [
            (one.track.doubled(), Doubling(course=one.track.course, flip=located))
            for one in latest
            for located in one.special
            if located.kind is Kind.FLIP
        ]
        stage = f"branches-{generation + 1}"
        branches = dispatch.done(stage, "branches", [(piece,) for _, piece in thrown])
        latest = list[Grown]()
        for (doubled, piece), (branch,) in zip(thrown, branches, strict=True):
            flip = Branch(points=(), special=(), ending=Kind.FLIP, end=piece.flip)
            if branch is not None:
                latest.append(as_family(doubled, flip, branch))
        found += latest
    return found


def start_orbit(problem: Problem, values: ParameterValues, *, tell: Progress = silent) -> ZenoOrbit:
    """Return the orbit at given numbers that a motion settles to.

    By simulation alone, and where that does not close one, by the search.

    Raises:
        OrbitNotFoundError: If there is none.
    """
    try:
        closing = close_orbit(problem, values, on_progress=tell, shape=ONE_ZENO)
    except InputError:
        # A rough simulation may drift off a holonomic row; the search is no worse for it.
        closing = None
    if closing is not None and closing.orbit is not None:
        return closing.orbit
    return find_orbit(problem, values, shape=ONE_ZENO).unwrap()


def _both_ways(root: Root, dispatch: Dispatch) -> Grown:
    track = root.track
    ways = tuple(
        Direction(
            course=track.course,
            start=first_point(track.returns, track.metric, root.x, root.s, rising=rising),
        )
        for rising in (True, False)
    )
    ((forward, *backward),) = dispatch.done("directions", "directions", [ways])
    closed = Branch(points=(), special=(), ending=Kind.CLOSED)
    return as_family(track, backward[0] if backward else closed, forward)


_MOST_IMPACTS = 400
_SETTLED = 1e-3
_PATIENCE = 100.0
"""Longest flight [s]."""
_LONGER = 4.0


def continue_impacts(
    problem: Problem,
    values: ParameterValues,
    state: tuple[float, ...],
    parameter: str,
    box: tuple[float, float],
    *,
    settings: ContinuationSettings,
    tell: Tell,
    crew: Crew | None = None,
) -> Continuation:
    """Return the family of the orbit with one impact a turn that a motion settles to.

    Args:
        problem: The problem.
        values: Its numbers at the start.
        state: Where the motion starts, ``(n_x,)``.
        parameter: Name of a gain or a parameter.
        box: Range in which to follow it, lower end first.
        settings: How.
        tell: Called with what happens.
        crew: Workers; by default this process does it all.

    Raises:
        InputError: If a name or a range does not fit.
        SimulationError: If the impacts do not settle.
        WorkError: If the work cannot be finished.
    """
    p = np.array(values.vector)
    line = line_in(problem, p, parameter)
    value = values.number(parameter)
    check_box(problem, parameter, box, value)
    returns = ImpactReturns(compiled=problem.compiled(), line=line, settings=settings.simulation)
    x, flight, scale = _settled(returns, np.array(state), value)
    course = Course(
        values=values,
        parameter=parameter,
        box=box,
        section=ImpactReturns,
        metric=Metric(scale=scale, unit=box[1] - box[0], horizon=_LONGER * flight),
        simulation=settings.simulation,
    )
    root = Root(track=Track(problem=problem, course=course), x=x, s=value)
    return continuation_on(root, settings=settings, tell=tell, crew=crew)


def _settled(returns: ImpactReturns, state: Vector, s: float) -> tuple[Vector, float, Vector]:
    """Return a state after an impact that nearly repeats, the flight's length, and sizes.

    Raises:
        SimulationError: If none does.
    """
    dynamics, x = returns.dynamics(s), state
    before: Vector | None = None
    for _ in range(_MOST_IMPACTS):
        run = simulate(dynamics, x, until=_PATIENCE, settings=returns.settings, releases=1)
        if not run.impacts:
            break
        impact = run.impacts[0]
        x = impact.state_plus
        sizes = np.max(np.abs(run.arcs[0].flow_states[:, : x.size]), axis=0)
        largest = float(np.max(sizes))
        scale = np.where(sizes > _SETTLED * largest, sizes, largest)
        if before is not None and float(np.max(np.abs(x - before) / scale)) < _SETTLED:
            return x, impact.time, scale
        before = x
    raise SimulationError(
        "The impacts do not settle to one a turn", time=_PATIENCE, state=tuple(x.tolist())
    )
