r"""Families of Zeno periodic orbits in a gain or a parameter, stable or not.

From one orbit the family is followed both ways until it ends, and every point at which it changes
its character is located and named. Numbers that the scene derives from others, as the motor
pendulum's calibrated constants, are held at their values at the start: what is followed is one
machine of which one number changes. Source: [Keller1977]_, theory (37) to (40).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.boundaries import follow_boundary
from zeno_orbits.branches import Branch, Tell, follow
from zeno_orbits.closing import close_orbit
from zeno_orbits.corrector import BranchPoint, correct, first_point
from zeno_orbits.dynamics import Vector
from zeno_orbits.errors import InputError, ZenoOrbitsError
from zeno_orbits.families import Boundary, Continuation, Family, FamilyPoint, Kind, SpecialPoint
from zeno_orbits.orbit import ZenoOrbit, versions
from zeno_orbits.plane import Plane
from zeno_orbits.problem import Problem, Setting
from zeno_orbits.return_maps import Margin
from zeno_orbits.search import find_orbit
from zeno_orbits.singular_points import Located
from zeno_orbits.tracks import (
    ONE_RETURN,
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
) -> Continuation:
    """Return the family of an orbit in a gain or a parameter, and what branches off it.

    Args:
        problem: The scene.
        orbit: An orbit of it; its parameter must lie in the box.
        parameter: Name of a gain or a parameter.
        box: Range in which to follow it, lower end first.
        settings: How.
        tell: Called with what happens.

    Raises:
        InputError: If a name or a range does not fit, or the orbit is of another scene.
        SimulationError: If the orbit does not close.
    """
    settings = settings or ContinuationSettings()
    track = track_of(problem, orbit, parameter, box, settings)
    x = np.array(problem.state_vector(orbit.release_state))
    s = float(numbers(problem, orbit)[problem.names.index(parameter)])
    return continuation_on(track, x, s, settings=settings, tell=tell)


def continue_orbit_in_two(
    problem: Problem,
    orbit: ZenoOrbit,
    names: tuple[str, str],
    boxes: tuple[tuple[float, float], tuple[float, float]],
    *,
    kinds: tuple[Kind, ...],
    settings: ContinuationSettings | None = None,
    tell: Tell = _silent,
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

    Raises:
        InputError: If a name or a range does not fit, or the orbit is of another scene.
        SimulationError: If the orbit does not close.
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
    grown = _grown_from(track, x, float(p[first]), settings, tell)
    plane = Plane(
        names=names,
        places=(first, second),
        box=np.array(boxes),
        p=p,
        restitution=problem.names.index("restitution"),
    )
    boundaries: list[Boundary] = []
    for one in grown:
        for located, leading in (*((s, ()) for s in one.special), *one.ends):
            value = (located.z[-1] * track.metric.unit, float(p[second]))
            if located.kind in kinds and not _known(boundaries, plane, located.kind, value):
                boundaries.append(
                    follow_boundary(
                        plane,
                        one.track.on_line,
                        track.metric,
                        located,
                        value,
                        leading=leading,
                        steps=settings.curve,
                        tell=tell,
                    )
                )
    return Continuation(
        families=tuple(one.family for one in grown),
        boundaries=tuple(boundaries),
        versions=versions(),
    )


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
    track: Track, x: Vector, s: float, *, settings: ContinuationSettings, tell: Tell = _silent
) -> Continuation:
    """Return the family through a state of a section, and what branches off it.

    Args:
        track: What it is followed on.
        x: A state near a fixed point of the return map, ``(n_x,)``.
        s: The parameter there.
        settings: How.
        tell: Called with what happens.

    Raises:
        SimulationError: If there is no fixed point near.
    """
    grown = _grown_from(track, x, s, settings, tell)
    return Continuation(families=tuple(one.family for one in grown), versions=versions())


def _grown_from(
    track: Track, x: Vector, s: float, settings: ContinuationSettings, tell: Tell
) -> list[_Grown]:
    """Return the family through a state, and those that flips throw off."""
    found = [_both_ways(track, x, s, settings, tell)]
    latest = list(found)
    for _ in range(settings.doublings):
        later: list[_Grown] = []
        for one in latest:
            flips = [located for located in one.special if located.kind is Kind.FLIP]
            thrown = [_thrown_off(one.track, flip, settings, tell) for flip in flips]
            later += [grown for grown in thrown if grown is not None]
        found += later
        latest = later
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
        closing = close_orbit(problem, setting, on_progress=tell)
    except InputError:
        # A rough simulation may drift off a holonomic row; the search is no worse for it.
        closing = None
    if closing is not None and closing.orbit is not None:
        return closing.orbit
    return find_orbit(problem, setting).unwrap()


@dataclass(frozen=True, kw_only=True)
class _Grown:
    """A family with what is needed to go on from it.

    Attributes:
        family: The family.
        track: What it was followed on.
        special: Its special points.
        ends: Its located ends, each with the last points before it.
    """

    family: Family
    track: Track
    special: tuple[Located, ...]
    ends: tuple[tuple[Located, tuple[BranchPoint, ...]], ...]


def _both_ways(
    track: Track, x: Vector, s: float, settings: ContinuationSettings, tell: Tell
) -> _Grown:
    up = first_point(track.returns, track.metric, x, s, rising=True)
    down = first_point(track.returns, track.metric, x, s, rising=False)
    forward = _followed(track, up, settings, tell)
    if forward.ending is Kind.CLOSED:
        return _grown(track, Branch(points=(), special=(), ending=Kind.CLOSED), forward)
    return _grown(track, _followed(track, down, settings, tell), forward)


def _followed(
    track: Track,
    start: BranchPoint,
    settings: ContinuationSettings,
    tell: Tell,
    alien: Callable[[BranchPoint], bool] | None = None,
) -> Branch:
    return follow(
        track.returns,
        track.metric,
        start,
        track.box,
        settings.steps,
        restitution=track.restitution,
        tell=tell,
        alien=alien,
    )


_AWAY = (1e-3, 4e-3, 1.6e-2)
"""Distances from a flip at which the branch of twice the period is looked for."""
_APART = 0.2
"""Part of that distance by which a point must differ from its own first return."""


def _thrown_off(
    track: Track, flip: Located, settings: ContinuationSettings, tell: Tell
) -> _Grown | None:
    r"""Return the family of twice the period that a flip throws off.

    It leaves at right angles to the parameter, along the multiplier's own direction `v`:
    :math:`z = z_* \pm \epsilon v + O(\epsilon^2)`. One sense is enough, as a return leads from
    either half of the family to the other.
    """
    doubled, point = track.doubled(), flip.point
    values, vectors = np.linalg.eig(point.jacobian)
    v = np.real(vectors[:, int(np.argmin(np.abs(values + 1)))])
    here = track.returns.frame(point.x, point.s, track.metric.scale)
    direction = np.append(here.tangent @ v, 0.0)
    direction /= np.linalg.norm(direction)

    def alien(other: BranchPoint) -> bool:
        """Tell an orbit that closes after half the returns."""
        once = track.returns.follow(other.x, other.s, horizon=track.metric.horizon)
        away = float(np.linalg.norm(other.z - point.z))
        return float(np.max(np.abs(once.end - other.x) / track.metric.scale)) < min(
            _APART * away, _APART * _AWAY[0]
        )

    for away in _AWAY:
        z = point.z + away * direction
        try:
            start = correct(doubled.returns, doubled.metric, z, direction)
        except ZenoOrbitsError:
            continue
        if not alien(start) and float(start.tangent @ direction) > 0.0:
            tell(f"branch of {doubled.n_returns} returns at {start.s:.6g}", None)
            branch = _followed(doubled, start, settings, tell, alien)
            root = Branch(points=(), special=(), ending=Kind.FLIP, end=flip)
            return _grown(doubled, root, branch)
    return None


def _grown(track: Track, backward: Branch, forward: Branch) -> _Grown:
    """Return both directions as one family."""
    before = len(backward.points)
    # The start is the first point of both, but a family may grow in one direction only.
    shared = 1 if before else 0
    points = (*backward.points[::-1], *forward.points[shared:])
    special = [
        _special(track, located, max(before - 2 - index, 0))
        for index, located in reversed(backward.special)
    ]
    special += [
        _special(track, located, max(before - shared, 0) + index)
        for index, located in forward.special
    ]
    located = [one for _, one in (*backward.special, *forward.special)]
    return _Grown(
        family=Family(
            problem=track.problem.name,
            parameter=track.parameter,
            gains=track.setting.gains,
            parameters=track.setting.parameters,
            n_returns=track.n_returns,
            points=tuple(family_point(track, point) for point in points),
            special=tuple(special),
            first=_end(track, backward, points[0], 0),
            last=_end(track, forward, points[-1], len(points) - 1),
        ),
        track=track,
        special=tuple(located),
        ends=tuple(
            (branch.end, _leading(branch.points, branch.end))
            for branch in (backward, forward)
            if branch.end is not None and len(branch.points) > 1
        ),
    )


_AHEAD, _AWAY_FROM_END = 0.005, 0.2
"""Distance from an end, in the parameter's range or else in all, from which its curve is found."""


def _leading(points: tuple[BranchPoint, ...], end: Located) -> tuple[BranchPoint, ...]:
    """Return two neighbours before an end, as near to it as a step of its curve may stray."""
    far = [
        k
        for k, point in enumerate(points)
        if abs(point.z[-1] - end.z[-1]) > _AHEAD
        or float(np.linalg.norm(point.z - end.z)) > _AWAY_FROM_END
    ]
    last = max(far[-1] if far else 1, 1)
    return points[last - 1 : last + 1]


def family_point(track: Track, point: BranchPoint) -> FamilyPoint:
    """Return a point of a branch in names."""
    return FamilyPoint(
        value=point.s,
        state=dict(zip(track.problem.state_names, point.x.tolist(), strict=True)),
        period=point.found.time,
        multipliers=point.multipliers,
        margins=_named(point.found.margins, track.n_returns),
        miss=point.miss,
    )


def _named(margins: Mapping[Margin, float], n_returns: int) -> dict[str, float]:
    """Return margins by their words, with the return's number where there are several."""
    return {
        margin.loss.value
        if n_returns == ONE_RETURN
        else f"{margin.loss.value}, return {margin.place + 1}": value
        for margin, value in margins.items()
    }


def _special(track: Track, located: Located, index: int) -> SpecialPoint:
    point = family_point(track, located.point)
    x, s = track.metric.of_place(located.z)
    at = replace(
        point,
        value=s,
        state=dict(zip(track.problem.state_names, x.tolist(), strict=True)),
        period=located.period,
        margins=_named(located.margins, track.n_returns),
    )
    return SpecialPoint(kind=located.kind, at=at, error=located.error, index=index)


def _end(track: Track, branch: Branch, last: BranchPoint, index: int) -> SpecialPoint:
    if branch.end is not None:
        return _special(track, branch.end, index)
    at = family_point(track, last)
    return SpecialPoint(kind=branch.ending, at=at, error=0.0, index=index, detail=branch.detail)
