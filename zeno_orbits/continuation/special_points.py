r"""Special points inside a family: test functions and their roots.

Inside a family every test function is smooth along it, and a sign change between two points is
closed in on by points of the family in between. Theory (38).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.corrector import BranchPoint, FamilyMetric, correct, corrected_again
from zeno_orbits.continuation.families import SpecialPointKind
from zeno_orbits.continuation.return_maps import Margin, ReturnMap
from zeno_orbits.errors import SimulationError, ZenoOrbitsError

TestFunction = Callable[[BranchPoint], float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Located:
    """A special point and its estimated error.

    Attributes:
        kind: Its kind.
        point: A point of the family at it, or the nearest that was computed.
        z: Its ambient place, ``(n_x + 1,)``; at an end, the limit.
        period: [s].
        error: Estimated error of the parameter.
        margins: Margins of the orbit; at an end, their limits.
        place: At an end, the return in which it is, counted from 0.
        path: Points of the family on the way to an end, in order.
        also: At an end of codimension two, the other kinds.
    """

    kind: SpecialPointKind
    point: BranchPoint
    z: Vector
    period: float
    error: float
    margins: Mapping[Margin, float]
    place: int = 0
    path: tuple[BranchPoint, ...] = ()
    also: tuple[SpecialPointKind, ...] = ()


def fold_test(point: BranchPoint) -> float:
    """Return the parameter's part of the tangent; it changes sign at a fold."""
    return float(point.tangent[-1])


def flip_test(point: BranchPoint) -> float:
    r"""Return :math:`\det(\partial_y P + 1)`; it vanishes with a multiplier of -1."""
    return float(np.linalg.det(point.jacobian + np.eye(len(point.jacobian))))


def torus_test(point: BranchPoint) -> float:
    r"""Return :math:`\prod_{i<j} (1 - \mu_i \mu_j)`; it vanishes with a pair on the circle."""
    product = np.prod([1 - a * b for a, b in combinations(point.multipliers, 2)])
    return float(np.real(product))


def branching_test(point: BranchPoint) -> float:
    r"""Return :math:`\det(\partial_y P - 1)` over the tangent's part along the parameter.

    By Cramer's rule both vanish at a fold; where the first does alone, another branch crosses.
    """
    determinant = np.linalg.det(point.jacobian - np.eye(len(point.jacobian)))
    return float(determinant / (point.tangent[-1] or 1e-300))


INSIDE: dict[SpecialPointKind, TestFunction] = {
    SpecialPointKind.FOLD: fold_test,
    SpecialPointKind.FLIP: flip_test,
    SpecialPointKind.TORUS: torus_test,
    SpecialPointKind.BRANCHING: branching_test,
}

_ROOT = 1e-13
_MOST_TRIALS = 40
_REAL = 1e-6


def crossings(a: BranchPoint, b: BranchPoint) -> tuple[SpecialPointKind, ...]:
    """Return the kinds of special points between two neighbours on a family."""
    found = [kind for kind, test in INSIDE.items() if test(a) * test(b) < 0.0]
    if SpecialPointKind.FOLD in found and SpecialPointKind.BRANCHING in found:
        # The quotient of two numbers with one simple root each between the points.
        found.remove(SpecialPointKind.BRANCHING)
    return tuple(found)


def locate_inside(
    returns: ReturnMap, metric: FamilyMetric, a: BranchPoint, b: BranchPoint, kind: SpecialPointKind
) -> Located | None:
    """Return the special point between two neighbours, or ``None`` if nothing happens there.

    Args:
        returns: The return map.
        metric: Units.
        a: A point of a family.
        b: Its neighbour.
        kind: Kind of a special point whose test function changes its sign in between.

    Raises:
        ZenoOrbitsError: If a point in between cannot be had.
    """
    root = root_between(returns, metric, a, b, INSIDE[kind])
    pair = max((abs(m.imag) for m in root.point.multipliers), default=0.0)
    if kind is SpecialPointKind.TORUS and pair < _REAL:
        # Two real multipliers with product one: nothing happens to the orbit.
        return None
    return _located(kind, root, metric)


@dataclass(frozen=True, slots=True, kw_only=True)
class Root:
    """A root of a test function on a family.

    Attributes:
        point: The point there.
        error: Estimated error of the parameter in its unit.
    """

    point: BranchPoint
    error: float


def _located(kind: SpecialPointKind, root: Root, metric: FamilyMetric) -> Located:
    point = root.point
    return Located(
        kind=kind,
        point=point,
        z=point.z,
        period=point.found.time,
        error=root.error * metric.unit,
        margins=point.found.margins,
    )


def root_between(
    returns: ReturnMap, metric: FamilyMetric, a: BranchPoint, b: BranchPoint, test: TestFunction
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
            z = a.z + distance / length * (b.z - a.z)
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
    return Root(point=point, error=_doubt(returns, metric, point, test, slope))


_NUDGE = 1e-4
_MOST_SECANTS = 15


def located_near(
    returns: ReturnMap,
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
        ZenoOrbitsError: If no such point is near.
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
            root = Root(point=here, error=_doubt(returns, metric, here, test, slope))
            return _located(kind, root, metric)
    raise SimulationError(f"There is no {kind.value} near", time=0.0, state=())


_NEAR, _TINY = 0.3, 1e-8
"""Largest distance of a special point along the family; length of a secant that is rounding."""


def _doubt(
    returns: ReturnMap, metric: FamilyMetric, point: BranchPoint, test: TestFunction, slope: float
) -> float:
    """Return the change of a root along the parameter by a looser computation, in its unit."""
    try:
        again = corrected_again(returns.loosened(), metric, point)
    except ZenoOrbitsError:
        return float("inf")
    along = abs(test(again) - test(point)) + abs(test(point))
    shift = along / max(abs(slope), 1e-300)
    # At a fold the parameter is stationary along the family: a shift counts by its square.
    moved = abs(again.z[-1] - point.z[-1]) + abs(point.tangent[-1]) * shift + shift**2
    return float(moved) + _ROUNDING * max(1.0, abs(point.z[-1]))


_ROUNDING = 1e-15
"""Least error that is claimed."""
