r"""Families of Zeno periodic orbits in a gain or a parameter, stable or not.

From one orbit the family is followed both ways until it ends, and every point at which it changes
its character is located and named. Numbers that the scene derives from others, as the motor
pendulum's calibrated constants, are held at their values at the start: what is followed is one
machine of which one number changes. Source: [Keller1977]_, theory (37) to (40).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from zeno_orbits.branches import Branch, Tell
from zeno_orbits.closing import close_orbit
from zeno_orbits.corrector import BranchPoint, first_point
from zeno_orbits.dispatch import Crew, Dispatch
from zeno_orbits.dynamics import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.families import (
    Boundary,
    Continuation,
    Kind,
    whole_curve,
)
from zeno_orbits.growth import Grown, as_family
from zeno_orbits.orbit import ZenoOrbit, versions
from zeno_orbits.pieces import Direction, Doubling, Half
from zeno_orbits.plain import plain
from zeno_orbits.plane import Plane
from zeno_orbits.problem import Problem, Setting
from zeno_orbits.search import find_orbit
from zeno_orbits.shape import ONE_ZENO
from zeno_orbits.singular_points import Located
from zeno_orbits.tracks import (
    ContinuationSettings,
    Track,
    check_box,
    line_in,
    numbers,
    track_of,
)


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
        problem: The scene.
        orbit: An orbit of it; its parameter must lie in the box.
        parameter: Name of a gain or a parameter.
        box: Range in which to follow it, lower end first.
        settings: How.
        tell: Called with what happens.
        crew: Workers; by default this process does it all.

    Raises:
        InputError: If a name or a range does not fit, or the orbit is of another scene.
        SimulationError: If the orbit does not close.
        WorkError: If the work cannot be finished.
    """
    settings = settings or ContinuationSettings()
    track = track_of(problem, orbit, parameter, box, settings)
    x = np.array(problem.state_vector(orbit.release_state))
    s = float(numbers(problem, orbit)[problem.names.index(parameter)])
    return continuation_on(track, x, s, settings=settings, tell=tell, crew=crew)


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
        problem: The scene.
        orbit: An orbit of it; both parameters must lie in their boxes.
        names: Names of two gains or parameters.
        boxes: Their ranges.
        kinds: Which kinds of special points to follow.
        settings: How.
        tell: Called with what happens.
        crew: Workers; by default this process does it all.

    Raises:
        InputError: If a name or a range does not fit, or the orbit is of another scene.
        SimulationError: If the orbit does not close.
        WorkError: If the work cannot be finished.
    """
    settings = settings or ContinuationSettings()
    if names[0] == names[1]:
        raise InputError(f"Argument `second` must differ from `in`, but both are `{names[0]}`.")
    p = numbers(problem, orbit)
    line_in(problem, p, names[1])
    second = problem.names.index(names[1])
    check_box(problem, names[1], boxes[1], float(p[second]))
    track = track_of(problem, orbit, names[0], boxes[0], settings)
    x = np.array(problem.state_vector(orbit.release_state))
    first = problem.names.index(names[0])
    own = {"second": names[1], "box": list(boxes[1]), "kinds": [kind.name for kind in kinds]}
    dispatch = _dispatch(track, x, float(p[first]), settings, tell, crew, own)
    grown = _grown_from(track, x, float(p[first]), dispatch)
    plane = Plane(
        names=names,
        places=(first, second),
        box=np.array(boxes),
        p=p,
        restitution=problem.names.index("restitution"),
    )
    found = [
        _Candidate(grown=one, located=located, leading=leading)
        for one in grown
        for located, leading in (*((s, ()) for s in one.special), *one.ends)
        if located.kind in kinds
    ]
    return Continuation(
        families=tuple(one.family for one in grown),
        boundaries=tuple(_curves(dispatch, plane, found)),
        versions=versions(),
    )


@dataclass(frozen=True, kw_only=True)
class _Candidate:
    """A special point that may be on a curve of its own.

    Attributes:
        grown: Its family.
        located: The point.
        leading: The last points of the family before an end.
    """

    grown: Grown
    located: Located
    leading: tuple[BranchPoint, ...]


def _curves(dispatch: Dispatch, plane: Plane, found: Sequence[_Candidate]) -> list[Boundary]:
    """Return the curves through special points, each once.

    A curve may come back through another point of its kind. So points of a kind take turns, and
    what is on a curve already is left out, whoever follows it.
    """
    curves: dict[int, Boundary] = {}
    waiting, turn = dict(enumerate(found)), 0
    while waiting:
        turn += 1
        chosen: dict[int, tuple[Half, Half]] = {}
        for k, one in list(waiting.items()):
            metric, kind = one.grown.track.metric, one.located.kind
            value = (one.located.z[-1] * metric.unit, float(plane.p[plane.places[1]]))
            if _known(tuple(curves.values()), plane, kind, value):
                del waiting[k]
            elif kind not in [found[other].located.kind for other in chosen]:
                up = Half(
                    course=one.grown.track.course,
                    plane=plane,
                    found=one.located,
                    value=value,
                    leading=one.leading,
                    upwards=True,
                )
                chosen[k] = (up, replace(up, upwards=False))
        results = dispatch.done(f"curves-{turn}", "half curves", list(chosen.values()))
        for k, halves in zip(chosen, results, strict=True):
            second = halves[1] if len(halves) > 1 else None
            curves[k] = whole_curve(found[k].located.kind, plane.names, halves[0], second)
            del waiting[k]
    return [curves[k] for k in sorted(curves)]


_SAME = 1e-6
"""Part of a range by which two points on one boundary may differ."""


def _known(
    boundaries: Sequence[Boundary], plane: Plane, kind: Kind, value: tuple[float, float]
) -> bool:
    """Tell whether a boundary runs through a point already: a curve may come back to its line."""
    for boundary in boundaries:
        if boundary.kind is not kind:
            continue
        x, y = np.array(boundary.x), np.array(boundary.y)
        for k in np.flatnonzero((y[:-1] - value[1]) * (y[1:] - value[1]) <= 0.0):
            part = (value[1] - y[k]) / (y[k + 1] - y[k]) if y[k + 1] != y[k] else 0.0
            near = abs(x[k] + part * (x[k + 1] - x[k]) - value[0])
            bend = 0.1 * abs(x[k + 1] - x[k]) + _SAME * plane.units[0]
            if near <= bend:
                return True
    return False


def continuation_on(
    track: Track,
    x: Vector,
    s: float,
    *,
    settings: ContinuationSettings,
    tell: Tell = _silent,
    crew: Crew | None = None,
) -> Continuation:
    """Return the family through a state of a section, and what branches off it.

    Args:
        track: What it is followed on.
        x: A state near a fixed point of the return map, ``(n_x,)``.
        s: The parameter there.
        settings: How.
        tell: Called with what happens.
        crew: Workers; by default this process does it all.

    Raises:
        InputError: If the crew has another scene, or its checkpoint is another's.
        SimulationError: If there is no fixed point near.
        WorkError: If the work cannot be finished.
    """
    grown = _grown_from(track, x, s, _dispatch(track, x, s, settings, tell, crew, {}))
    return Continuation(families=tuple(one.family for one in grown), versions=versions())


def _dispatch(
    track: Track,
    x: Vector,
    s: float,
    settings: ContinuationSettings,
    tell: Tell,
    crew: Crew | None,
    own: dict[str, Any],
) -> Dispatch:
    """Return who follows a family, with all that its result depends on."""
    identity = {
        "problem": track.problem.name,
        "gains": plain(track.course.setting.gains),
        "parameters": plain(track.course.setting.parameters),
        "in": track.course.parameter,
        "range": list(track.course.box),
        "section": plain(track.course.section),
        "start": [*x.tolist(), s],
        "settings": plain(settings, "settings"),
        "versions": versions(),
        **own,
    }
    dispatch = Dispatch(problem=track.problem, settings=settings, tell=tell, crew=crew)
    return dispatch.claimed(identity)


def _grown_from(track: Track, x: Vector, s: float, dispatch: Dispatch) -> list[Grown]:
    """Return the family through a state, and those that flips throw off."""
    found = [_both_ways(track, x, s, dispatch)]
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
            root = Branch(points=(), special=(), ending=Kind.FLIP, end=piece.flip)
            if branch is not None:
                latest.append(as_family(doubled, root, branch))
        found += latest
    return found


def start_orbit(
    problem: Problem, setting: Setting, *, tell: Callable[[str], None] | None = None
) -> ZenoOrbit:
    """Return the orbit at given numbers that a motion settles to.

    By simulation alone, and where that does not close one, by the search.

    Raises:
        OrbitNotFoundError: If there is none.
    """
    try:
        closing = close_orbit(problem, setting, on_progress=tell, shape=ONE_ZENO)
    except InputError:
        # A rough simulation may drift off a holonomic row; the search is no worse for it.
        closing = None
    if closing is not None and closing.orbit is not None:
        return closing.orbit
    return find_orbit(problem, setting, shape=ONE_ZENO).unwrap()


def _both_ways(track: Track, x: Vector, s: float, dispatch: Dispatch) -> Grown:
    ways = tuple(
        Direction(
            course=track.course,
            start=first_point(track.returns, track.metric, x, s, rising=rising),
        )
        for rising in (True, False)
    )
    ((forward, *backward),) = dispatch.done("directions", "directions", [ways])
    closed = Branch(points=(), special=(), ending=Kind.CLOSED)
    return as_family(track, backward[0] if backward else closed, forward)
