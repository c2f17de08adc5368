"""Steps along a family, subdivided until their special points are counted. Theory (5.6)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.corrector import BranchPoint, Course, FamilyMetric, correct
from zeno_orbits.continuation.return_maps import FamilyMap
from zeno_orbits.continuation.special_points.hermite import Count, Node, zeros_between
from zeno_orbits.continuation.special_points.special_points import (
    Located,
    arclength,
    locate_inside,
    place_between,
)
from zeno_orbits.continuation.special_points.test_functions import KINDS, with_course
from zeno_orbits.orbits import StepError


@dataclass(frozen=True, slots=True, kw_only=True)
class Subdivision:
    """A step along a family with the additional points inside it.

    Attributes:
        points: Points in order, with the end of the step and without its start.
        special: Special points, each with the number of points of the step before it.
        doubt: Largest distance, in units of the parameter's range, of two special points of one
            kind that the subdivision may miss.
    """

    points: tuple[BranchPoint, ...]
    special: tuple[tuple[int, Located], ...] = ()
    doubt: float = 0.0


def subdivided(
    returns: FamilyMap,
    metric: FamilyMetric,
    before: BranchPoint,
    after: BranchPoint,
    third: BranchPoint | None,
    *,
    shortest: float,
) -> Subdivision:
    """Return a step with its special points.

    Args:
        returns: The return map.
        metric: Units.
        before: Start of the step, with its course.
        after: End of the step, with its course.
        third: Another point nearby, with its course. Without it the step is halved first.
        shortest: Scaled arclength below which a step is not subdivided.

    Raises:
        ZenoOrbitsError: If a point inside cannot be computed. The step must then be shorter.
        StepError: If a point inside is not a neighbour of the ends.
    """
    if not before.jacobian.size:
        return Subdivision(points=(after,))
    counts = counted_zeros(before, after, third)
    length = arclength(before, after)
    splits = [count.split for count in counts if count.split is not None]
    if splits and length > shortest:
        middle = _inside(returns, metric, before, after, splits[0])
        first = subdivided(returns, metric, before, middle, after, shortest=shortest)
        second = subdivided(returns, metric, middle, after, before, shortest=shortest)
        shift = len(first.points)
        return Subdivision(
            points=(*first.points, *second.points),
            special=(*first.special, *((shift + k, one) for k, one in second.special)),
            doubt=max(first.doubt, second.doubt),
        )
    crossed = [kind for kind, count in zip(KINDS, counts, strict=True) if count.crosses]
    found = [locate_inside(returns, metric, before, after, kind) for kind in crossed]
    located = sorted(
        (one for one in found if one is not None),
        key=lambda one: float((one.z - before.z) @ before.tangent),
    )
    steep = max(abs(before.tangent[-1]), abs(after.tangent[-1]))
    return Subdivision(
        points=(after,),
        special=tuple((0, one) for one in located),
        doubt=length * float(steep) if splits else 0.0,
    )


def counted_zeros(
    before: BranchPoint, after: BranchPoint, third: BranchPoint | None
) -> tuple[Count, ...]:
    """Return the count of zeros of each test function between two neighbours with courses.

    Args:
        before: The first point.
        after: The second point.
        third: Another point nearby, before the first or after the second.
    """
    nodes = [_nodes(before, 0.0), _nodes(after, arclength(before, after))]
    if third is None:
        rest = (None,) * len(KINDS)
    elif float((third.z - before.z) @ before.tangent) < 0.0:
        rest = _nodes(third, -arclength(third, before))
    else:
        rest = _nodes(third, nodes[1][0].place + arclength(after, third))
    return tuple(zeros_between(*three) for three in zip(*nodes, rest, strict=True))


def signs_kept_to(points: Sequence[BranchPoint], end: Vector) -> bool:
    """Return True if no test function vanishes between the last point and the end of a family.

    Near an end a test function grows without bound, or it has a limit. The limit is extrapolated in
    the distance from the end. Its error is the change if one point fewer is used.

    Args:
        points: Points on the way to the end, at least three, with their courses.
        end: Ambient coordinates of the end, ``(n_x + 1,)``.
    """
    if len(points) < _FEWEST:
        return False
    rows = np.array([_course(point).values for point in points])
    grows = (np.abs(rows[-1]) > _GROWS * np.abs(rows[-2])) & (rows[-1] * rows[-2] > 0.0)
    distances = np.array([float(np.linalg.norm(point.z - end)) for point in points])
    limit, error = neville(distances, rows)
    kept = (limit * rows[-1] > 0.0) & (np.abs(limit) > _SURE * error)
    return bool(np.all(grows | kept))


_FEWEST, _GROWS, _SURE = 3, 1.5, 3.0
"""Least number of points before an end, growth factor per point of a function without a limit, and
least size of a limit in units of its error."""


def neville(places: Vector, rows: Vector) -> tuple[Vector, Vector]:
    """Return the value at 0 of the polynomial through rows at given nodes, and its last change."""
    table = list(rows)
    previous = table[-1]
    for order in range(1, len(table)):
        previous = table[-1]
        table = [
            (places[k + order] * table[k] - places[k] * table[k + 1])
            / (places[k + order] - places[k])
            for k in range(len(table) - 1)
        ]
    return table[0], np.abs(table[0] - previous)


def _course(point: BranchPoint) -> Course:
    if point.course is None:
        raise TypeError("Argument `point` lacks its course.")
    return point.course


def _nodes(point: BranchPoint, place: float) -> tuple[Node, ...]:
    """Return the nodes of all test functions at a point."""
    course = _course(point)
    rows = np.stack([course.values, course.slopes, course.errors], axis=1).tolist()
    return tuple(
        Node(place=place, value=value, slope=slope, error=error if math.isfinite(error) else 0.0)
        for value, slope, error in rows
    )


def _inside(
    returns: FamilyMap, metric: FamilyMetric, before: BranchPoint, after: BranchPoint, part: float
) -> BranchPoint:
    """Return the point of the family at a fraction of a step."""
    place: Vector = place_between(before, after, part)
    point = correct(returns, metric, place, before.tangent)
    length = arclength(before, after)
    if float(np.linalg.norm(point.z - place)) > _STRAY * length:
        raise StepError("the points inside the step do not lie between its ends")
    return with_course(returns, metric, point, part * length)


_STRAY = 0.1
"""Largest distance of a point from the Hermite curve through the ends of its step, relative to the
step."""
