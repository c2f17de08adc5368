r"""Special points inside a family: test functions and their roots.

Inside a family every test function is smooth along it. A sign change between two points is
located by computing points of the family between them. Theory (5.6).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.corrector import BranchPoint, FamilyMetric, correct, corrected_again
from zeno_orbits.continuation.families import SpecialPointKind
from zeno_orbits.continuation.return_maps import FamilyMap
from zeno_orbits.continuation.special_points.test_functions import (
    INSIDE,
    TestFunction,
    multiplier_change,
)
from zeno_orbits.errors import SimulationError, ZenoOrbitsError
from zeno_orbits.orbits import Margin


@dataclass(frozen=True, slots=True, kw_only=True)
class Located:
    """A special point and its estimated error.

    Attributes:
        kind: Its kind.
        point: The point of the family there, or the nearest computed point.
        z: Its ambient coordinates, ``(n_x + 1,)``. At an end, they are the limit.
        period: Period [s].
        error: Estimated error of the parameter.
        multipliers: Multipliers of the orbit, the largest first. At an end, they are the limits.
        multiplier_error: Estimated error of the multipliers.
        margins: Margins of the orbit. At an end, they are the limits.
        cause: The margin that vanishes at an end. ``None`` inside a family.
        rest: The rest point at which a motion stalls, ``(n_x,)``. Empty if it is not known.
        path: Points of the family on the way to an end, in order.
        also: Other kinds of an end of codimension two.
    """

    kind: SpecialPointKind
    point: BranchPoint
    z: Vector
    period: float
    error: float
    margins: Mapping[Margin, float]
    multipliers: tuple[complex, ...]
    multiplier_error: float = math.inf
    cause: Margin | None = None
    rest: tuple[float, ...] = ()
    path: tuple[BranchPoint, ...] = ()
    also: tuple[SpecialPointKind, ...] = ()


_ROOT = 1e-13
_MOST_TRIALS = 40
_REAL = 1e-6


def locate_inside(
    returns: FamilyMap, metric: FamilyMetric, a: BranchPoint, b: BranchPoint, kind: SpecialPointKind
) -> Located | None:
    """Return the special point between two neighbours, or ``None`` without a bifurcation.

    Args:
        returns: The return map.
        metric: Units.
        a: A point of a family.
        b: Its neighbour.
        kind: Kind of a special point whose test function changes its sign in between.

    Raises:
        ZenoOrbitsError: If a point in between cannot be computed.
    """
    root = root_between(returns, metric, a, b, INSIDE[kind])
    pair = max((abs(m.imag) for m in root.point.multipliers), default=0.0)
    if kind is SpecialPointKind.TORUS and pair < _REAL:
        # Two real multipliers have the product one. This is not a bifurcation.
        return None
    return _located(kind, root, metric)


def arclength(a: BranchPoint, b: BranchPoint) -> float:
    """Return the scaled arclength between two neighbours, to fourth order."""
    chord = float(np.linalg.norm(b.z - a.z))
    angle = float(np.linalg.norm(b.tangent - a.tangent))
    return chord * (1 + angle**2 / 24)


def place_between(a: BranchPoint, b: BranchPoint, part: float) -> Vector:
    """Return the point at a fraction of the way between two neighbours, on the Hermite cubic.

    Args:
        a: A point of a family.
        b: Its neighbour.
        part: Fraction of the way, 0 at `a` and 1 at `b`.
    """
    length, rest = arclength(a, b), 1 - part
    ahead = (1 + 2 * part) * a.z + part * length * a.tangent
    behind = (1 + 2 * rest) * b.z - rest * length * b.tangent
    return rest**2 * ahead + part**2 * behind


@dataclass(frozen=True, slots=True, kw_only=True)
class Root:
    """A root of a test function on a family.

    Attributes:
        point: The point of the family at the root.
        error: Estimated error of the parameter in its unit.
        multiplier_error: Estimated error of the multipliers.
    """

    point: BranchPoint
    error: float
    multiplier_error: float


def _located(kind: SpecialPointKind, root: Root, metric: FamilyMetric) -> Located:
    point = root.point
    return Located(
        kind=kind,
        point=point,
        z=point.z,
        period=point.found.time,
        error=root.error * metric.unit,
        multipliers=point.multipliers,
        multiplier_error=root.multiplier_error,
        margins=point.found.margins,
    )


def root_between(
    returns: FamilyMap, metric: FamilyMetric, a: BranchPoint, b: BranchPoint, test: TestFunction
) -> Root:
    """Return the root of a test function between two points at which its signs differ.

    Args:
        returns: The return map.
        metric: Units.
        a: A point of a family.
        b: Its neighbour.
        test: The test function.
    """
    from scipy.optimize import brentq

    length = float((b.z - a.z) @ a.tangent)
    known = {0.0: a, length: b}

    def point_at(distance: float) -> BranchPoint:
        if distance not in known:
            z = place_between(a, b, distance / length)
            z += (distance - float((z - a.z) @ a.tangent)) * a.tangent
            known[distance] = correct(returns, metric, z, a.tangent)
        return known[distance]

    root = float(
        brentq(
            lambda distance: test(point_at(distance)),
            0.0,
            length,
            xtol=_ROOT,
            rtol=1e-14,
            maxiter=_MOST_TRIALS,
            disp=False,
        )
    )
    point = point_at(root)
    near = sorted(known, key=lambda distance: abs(distance - root))[1:]
    other = next((d for d in near if abs(d - root) > 1e-7 * length), near[-1])
    slope = (test(known[other]) - test(point)) / (other - root)
    return _root(returns, metric, point, test, slope)


_NUDGE = 1e-4
_MOST_SECANTS = 15


def located_near(
    returns: FamilyMap,
    metric: FamilyMetric,
    start: BranchPoint,
    kind: SpecialPointKind,
    test: TestFunction,
) -> Located:
    """Return the special point near a point of a family, by secants along it.

    Args:
        returns: The return map.
        metric: Units.
        start: The point of the family.
        kind: Kind of the special point.
        test: Its test function.

    Raises:
        ZenoOrbitsError: If the iteration finds no such point nearby.
    """
    here, value = start, test(start)
    other = correct(returns, metric, here.z + _NUDGE * here.tangent, here.tangent)
    slope = (test(other) - value) / _NUDGE
    for _ in range(_MOST_SECANTS):
        distance = -value / slope if slope else np.inf
        if not abs(distance) < _NEAR:
            break
        if abs(distance) >= _ROOT:
            there = correct(returns, metric, here.z + distance * here.tangent, here.tangent)
            gone, value_there = float((there.z - here.z) @ here.tangent), test(there)
            if gone != 0.0 and value_there != value and abs(distance) > _TINY:
                slope = (value_there - value) / gone
            here, value = there, value_there
        if abs(distance) < _TINY:
            return _located(kind, _root(returns, metric, here, test, slope), metric)
    raise SimulationError(f"The {kind.value} was not found", time=0.0, state=())


_NEAR, _TINY = 0.3, 1e-8
"""Largest distance of a special point along the family, and the length of a secant below which it
is due to rounding."""


def _root(
    returns: FamilyMap, metric: FamilyMetric, point: BranchPoint, test: TestFunction, slope: float
) -> Root:
    """Return a root with its errors, which are the changes at a looser tolerance."""
    try:
        again = corrected_again(returns.loosened(), metric, point)
    except ZenoOrbitsError:
        return Root(point=point, error=math.inf, multiplier_error=math.inf)
    along = abs(test(again) - test(point)) + abs(test(point))
    shift = along / max(abs(slope), 1e-300)
    # At a fold the parameter is stationary along the family, so the error is quadratic in a shift.
    moved = abs(again.z[-1] - point.z[-1]) + abs(point.tangent[-1]) * shift + shift**2
    return Root(
        point=point,
        error=float(moved) + _ROUNDING * max(1.0, abs(point.z[-1])),
        multiplier_error=multiplier_change(point, again) + _ROUNDING,
    )


_ROUNDING = 1e-15
"""Least error estimate."""
