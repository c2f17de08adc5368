"""Two directions of a family as one, in the names of its problem."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.continuation.branch import Branch
from zeno_orbits.continuation.corrector import BranchPoint
from zeno_orbits.continuation.families import Family, FamilyPoint, SpecialPoint
from zeno_orbits.continuation.return_maps import Margin
from zeno_orbits.continuation.setup import ONE_RETURN, Track
from zeno_orbits.continuation.special_points import Located


@dataclass(frozen=True, kw_only=True)
class Grown:
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


def as_family(track: Track, backward: Branch, forward: Branch) -> Grown:
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
    return Grown(
        family=Family(
            problem=track.problem.name,
            parameter=track.course.parameter,
            gains=track.course.values.gains,
            parameters=track.course.values.parameters,
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
    also = ", ".join(kind.value for kind in located.also)
    return SpecialPoint(
        kind=located.kind,
        at=at,
        error=located.error,
        index=index,
        detail=f"together with: {also}" if also else "",
    )


def _end(track: Track, branch: Branch, last: BranchPoint, index: int) -> SpecialPoint:
    if branch.end is not None:
        return _special(track, branch.end, index)
    at = family_point(track, last)
    return SpecialPoint(kind=branch.ending, at=at, error=0.0, index=index, detail=branch.detail)
