r"""Test functions of special points, their derivatives along a family, and their errors.

Every test function is smooth along a family. Its derivative is a difference quotient along a short
part of the tangent. The error of a test function is its change at a looser tolerance.
Theory (5.6).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.corrector import BranchPoint, Course, FamilyMetric, evaluated
from zeno_orbits.continuation.families import SpecialPointKind
from zeno_orbits.continuation.return_maps import FamilyMap
from zeno_orbits.errors import ZenoOrbitsError

TestFunction = Callable[[BranchPoint], float]


def fold_test(point: BranchPoint) -> float:
    """Return the parameter's component of the tangent. It changes sign at a fold."""
    return float(point.tangent[-1])


def flip_test(point: BranchPoint) -> float:
    r"""Return :math:`\det(\partial_y P + 1)`. It vanishes if a multiplier is -1."""
    return float(np.linalg.det(point.jacobian + np.eye(len(point.jacobian))))


def torus_test(point: BranchPoint) -> float:
    r"""Return :math:`\prod_{i<j} (1 - \mu_i \mu_j)`. It vanishes with a pair on the unit circle."""
    product = np.prod([1 - a * b for a, b in combinations(point.multipliers, 2)])
    return float(np.real(product))


def branching_test(point: BranchPoint) -> float:
    r"""Return the determinant of :math:`(\partial_y P - 1, \partial_s P)` above its null vector.

    By Cramer's rule :math:`\det(\partial_y P - 1)` is this determinant times the parameter's
    component of the null vector. The component vanishes at a fold. The determinant vanishes if
    another branch crosses.
    """
    return point.regularity


INSIDE: dict[SpecialPointKind, TestFunction] = {
    SpecialPointKind.FOLD: fold_test,
    SpecialPointKind.FLIP: flip_test,
    SpecialPointKind.TORUS: torus_test,
    SpecialPointKind.BRANCHING: branching_test,
}
KINDS = tuple(INSIDE)
"""The order of test functions in a `Course`."""

_PART, _SHORTEST, _LONGEST = 1e-3, 1e-7, 1e-5
"""Displacement of a difference quotient relative to the last step, and its bounds."""


def with_course(
    returns: FamilyMap, metric: FamilyMetric, point: BranchPoint, step: float
) -> BranchPoint:
    """Return a point with its test functions, their derivatives along the family and their errors.

    Args:
        returns: The return map.
        metric: Units.
        point: The point.
        step: Distance of its neighbour in scaled arclength. It is positive if the neighbour points
            opposite to the tangent. The displaced return is taken on the side of the neighbour.

    Raises:
        ZenoOrbitsError: If a displaced state does not return.
    """
    if point.course is not None:
        return point
    displacement = -math.copysign(min(max(_PART * abs(step), _SHORTEST), _LONGEST), step)
    other = evaluated(returns, metric, point.z + displacement * point.tangent, point.tangent)
    values = _values(point)
    errors, multiplier_error = _errors(returns, metric, point, values)
    return replace(
        point,
        course=Course(
            values=values,
            slopes=(_values(other) - values) / displacement,
            errors=errors,
            bend=(other.tangent - point.tangent) / displacement,
            multiplier_error=multiplier_error,
        ),
    )


def multiplier_change(point: BranchPoint, other: BranchPoint) -> float:
    """Return the largest distance of a multiplier from the nearest multiplier of another point.

    Args:
        point: The point.
        other: The same point at another accuracy.
    """
    others = np.array(other.multipliers)
    return max((float(np.min(np.abs(others - mu))) for mu in point.multipliers), default=0.0)


def _values(point: BranchPoint) -> Vector:
    return np.array([test(point) for test in INSIDE.values()])


def _errors(
    returns: FamilyMap, metric: FamilyMetric, point: BranchPoint, values: Vector
) -> tuple[Vector, float]:
    """Return the changes of test functions and multipliers at a looser tolerance."""
    try:
        rough = evaluated(returns.loosened(), metric, point.z, point.tangent)
    except ZenoOrbitsError:
        return np.full(values.size, math.inf), math.inf
    rounding = _ROUNDING * float(np.linalg.norm(point.jacobian))
    change = max(multiplier_change(point, rough), liouville_error(point)) + rounding
    return np.abs(_values(rough) - values) + rounding, change


def liouville_error(point: BranchPoint) -> float:
    """Return the error of the smallest multiplier according to Liouville's formula.

    It is zero if the formula does not apply. Theory (5.9).

    Args:
        point: A point of a family.
    """
    if not point.found.volume:
        return 0.0
    product = float(np.linalg.det(point.jacobian))
    return abs(product / point.found.volume - 1) * min(abs(mu) for mu in point.multipliers)


_ROUNDING = 1e-14
"""Least relative error of the derivative of a return."""
