r"""Points of a family of fixed points, computed by Newton's method.

With the section coordinates `y` and the parameter `s`, a family solves :math:`P(y, s) - y = 0`.
All distances are measured in scaled ambient coordinates,
:math:`z = (x / \mathrm{scale}, s / \mathrm{unit})`. So every iterate gets a new chart around it,
and iterates cannot leave a chart. Theory (5.5).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from zeno_orbits.arrays import Vector, eigenvalues
from zeno_orbits.continuation.return_maps import DifferentiatedReturn, FamilyMap
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.orbits import Section

_MOST_ITERATIONS = 9
CLOSED = 2e-11
"""Largest difference of a return from its start, in scaled states, that counts as zero."""
STALLED = 2e-9
"""Largest difference of a return from its start that rounding may cause near an end of a family.

A point with a larger difference is not a point of the family.
"""
_CONTRACTION = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class FamilyMetric:
    """Units in which distances along a family are measured.

    Attributes:
        scale: Size of each state, ``(n_x,)``.
        unit: Size of the parameter's range.
        horizon: Longest time to wait for a return [s].
    """

    scale: Vector
    unit: float
    horizon: float

    def place(self, x: Vector, s: float) -> Vector:
        """Return the ambient point of a state and a parameter, ``(n_x + 1,)``."""
        return np.append(x / self.scale, s / self.unit)

    def waiting_for(self, period: float, *, longer: float) -> FamilyMetric:
        """Return the same units with the longest waiting time for orbits of a period.

        Args:
            period: Period of the last orbit [s].
            longer: Longest time to wait for a return, in periods.
        """
        return replace(self, horizon=longer * period)

    def of_place(self, z: Vector) -> tuple[Vector, float]:
        """Return the state and the parameter at an ambient point."""
        return z[:-1] * self.scale, float(z[-1]) * self.unit


@dataclass(frozen=True, kw_only=True)
class Course:
    """Test functions at a point of a family, their derivatives along it, and their errors.

    Attributes:
        values: Test functions in the order of `KINDS`, ``(4,)``.
        slopes: Derivatives with respect to scaled arclength, ``(4,)``.
        errors: Estimated errors of the values, ``(4,)``. Infinite if no estimate exists.
        bend: Derivative of the unit tangent with respect to scaled arclength, ``(n_x + 1,)``.
        multiplier_error: Estimated error of the multipliers. Infinite if no estimate exists.
    """

    values: Vector
    slopes: Vector
    errors: Vector
    bend: Vector
    multiplier_error: float


@dataclass(frozen=True, kw_only=True)
class BranchPoint:
    r"""A point of a family.

    Attributes:
        x: State on the section, ``(n_x,)``.
        s: Parameter.
        z: State and parameter in scaled ambient coordinates, ``(n_x + 1,)``.
        tangent: Unit tangent of the family at the point, ``(n_x + 1,)``.
        jacobian: :math:`\partial P / \partial y`, ``(d, d)``.
        regularity: Determinant of the rows :math:`(\partial_y P - 1, \partial_s P)` above the unit
            null vector of these rows. It changes sign at a branch point only.
        found: The return.
        miss: Largest difference of the return from the state, in scaled states.
        course: Test functions, their derivatives and errors, if they were computed.
    """

    x: Vector
    s: float
    z: Vector
    tangent: Vector
    jacobian: Vector
    regularity: float
    found: DifferentiatedReturn
    miss: float
    course: Course | None = None

    @cached_property
    def multipliers(self) -> tuple[complex, ...]:
        """Floquet multipliers, the largest first."""
        return eigenvalues(self.jacobian)

    @property
    def multiplier_error(self) -> float:
        """Estimated error of the multipliers. Infinite if no estimate exists."""
        return math.inf if self.course is None else self.course.multiplier_error


def correct(
    returns: FamilyMap,
    metric: FamilyMetric,
    z: Vector,
    along: Vector,
    *,
    fixed: Vector | None = None,
) -> BranchPoint:
    r"""Return the point of the family in the plane through a given point, normal to a tangent.

    .. math::
        \begin{pmatrix} \partial_y P - 1 & \partial_s P\\ t^\top \partial_y z & t^\top \partial_s z
        \end{pmatrix} \begin{pmatrix}\delta y\\ \delta s\end{pmatrix} =
        - \begin{pmatrix} P - y\\ t^\top (z - z_0) \end{pmatrix}

    with `s` in units of its range. If the columns had very different sizes, rounding would erase
    all but the largest.

    Args:
        returns: The return map.
        metric: Units.
        z: The given point :math:`z_0`, ``(n_x + 1,)``.
        along: The tangent `t`, ``(n_x + 1,)``. It fixes the sense of the new tangent.
        fixed: Normal of the plane. By default it is the tangent.

    Raises:
        SimulationError: If Newton's method does not converge.
        ZenoOrbitsError: If a return fails.
    """
    normal = along if fixed is None else fixed
    # A parameter at an end of its range must not leave the range by a rounding error.
    is_held = fixed is not None and not fixed[:-1].any()
    x, s = metric.of_place(z)
    before = np.inf
    for _ in range(_MOST_ITERATIONS):
        x = returns.projected(x, s, metric.scale)
        here = returns.frame(x, s, metric.scale)
        found = returned(returns, x, s, metric)
        missed = here.components(found.end - x)
        miss = float(np.max(np.abs(missed), initial=0.0))
        off = float(normal @ (metric.place(x, s) - z))
        rows, ambient = linearized(here, found, metric)
        stalled = miss <= STALLED and miss > _CONTRACTION * before
        if miss > 1e3 * before:
            break
        matrix = np.concatenate([rows, (normal @ ambient)[None, :]])
        change = np.linalg.lstsq(matrix, -np.append(missed, off), rcond=None)[0]
        x = x + metric.scale * (ambient[:-1] @ change)
        s = s if is_held else s + metric.unit * float(change[-1])
        if max(miss, abs(off)) <= CLOSED or stalled:
            # The last correction is so small that another return is not needed.
            return _point(x, s, metric, rows, ambient, found, miss, along)
        before = miss
    raise SimulationError(
        f"Newton's method does not converge: the periodicity defect is {before:.1e}",
        time=metric.horizon,
        state=tuple(x.tolist()),
    )


def corrected_again(returns: FamilyMap, metric: FamilyMetric, point: BranchPoint) -> BranchPoint:
    """Return a point after one more Newton correction, even if the correction is small.

    Args:
        returns: The return map, for instance at a different accuracy.
        metric: Units.
        point: The point.

    Raises:
        ZenoOrbitsError: If a return fails.
    """
    here = returns.frame(point.x, point.s, metric.scale)
    found = returned(returns, point.x, point.s, metric)
    rows, ambient = linearized(here, found, metric)
    matrix = np.concatenate([rows, (point.tangent @ ambient)[None, :]])
    missed = np.append(here.components(found.end - point.x), 0.0)
    change = np.linalg.lstsq(matrix, -missed, rcond=None)[0]
    place = metric.place(point.x, point.s) + ambient @ change
    return correct(returns, metric, place, point.tangent)


def evaluated(returns: FamilyMap, metric: FamilyMetric, z: Vector, along: Vector) -> BranchPoint:
    """Return the return map and its derivatives at a point, without a correction.

    Args:
        returns: The return map.
        metric: Units.
        z: The point, ``(n_x + 1,)``.
        along: Tangent that fixes the sense of the new tangent, ``(n_x + 1,)``.

    Raises:
        ZenoOrbitsError: If the return fails.
    """
    x, s = metric.of_place(z)
    x = returns.projected(x, s, metric.scale)
    here = returns.frame(x, s, metric.scale)
    found = returned(returns, x, s, metric)
    rows, ambient = linearized(here, found, metric)
    miss = float(np.max(np.abs(here.components(found.end - x)), initial=0.0))
    return _point(x, s, metric, rows, ambient, found, miss, along)


def first_point(
    returns: FamilyMap, metric: FamilyMetric, x: Vector, s: float, *, rising: bool
) -> BranchPoint:
    """Return the point of the family at a parameter, with a tangent of a given sense.

    Args:
        returns: The return map.
        metric: Units.
        x: A state near the point, ``(n_x,)``.
        s: The parameter.
        rising: True if the parameter rises along the tangent.

    Raises:
        ZenoOrbitsError: If no point is near the state.
    """
    z = metric.place(x, s)
    upwards = np.zeros(z.size)
    upwards[-1] = 1.0 if rising else -1.0
    return correct(returns, metric, z, upwards)


def returned(returns: FamilyMap, x: Vector, s: float, metric: FamilyMetric) -> DifferentiatedReturn:
    """Return the return from a state.

    Args:
        returns: The return map.
        x: The state, ``(n_x,)``.
        s: The parameter.
        metric: Units, and the time to wait.

    Raises:
        SimulationError: If a computed value is out of range.
    """
    if not (np.all(np.isfinite(x)) and np.isfinite(s)):
        raise SimulationError("Newton's method diverges", time=0.0, state=tuple(x.tolist()))
    try:
        return returns.follow(x, s, horizon=metric.horizon)
    except (InputError, np.linalg.LinAlgError, OverflowError) as error:
        # A trial far from the family may be an invalid state, or its motion may diverge.
        raise SimulationError(str(error), time=metric.horizon, state=tuple(x.tolist())) from error


def linearized(
    here: Section, found: DifferentiatedReturn, metric: FamilyMetric
) -> tuple[Vector, Vector]:
    """Return the derivatives of `P - y` and of the ambient point.

    The first columns are derivatives with respect to the coordinates. The last column is the
    derivative with respect to the parameter in units of its range.

    Args:
        here: The section around the state.
        found: The return from the state.
        metric: Units.

    Returns:
        Both derivatives, ``(d, d + 1)`` and ``(n_x + 1, d + 1)``.
    """
    d = here.dimension
    moved = found.by_state @ here.lift
    moved[:, d] += found.by_parameter
    rows = here.components(moved - here.lift)
    parameter = np.zeros((1, d + 1))
    parameter[0, d] = 1.0
    ambient = np.concatenate([here.lift / metric.scale[:, None], parameter])
    rows[:, d] *= metric.unit
    ambient[:-1, d] *= metric.unit
    return rows, ambient


def _point(
    x: Vector,
    s: float,
    metric: FamilyMetric,
    rows: Vector,
    ambient: Vector,
    found: DifferentiatedReturn,
    miss: float,
    along: Vector,
) -> BranchPoint:
    d = len(rows)
    direction = np.linalg.svd(rows)[2][-1] if d else np.ones(1)
    tangent = ambient @ direction
    tangent = tangent / np.linalg.norm(tangent)
    if tangent @ along < 0.0:
        tangent, direction = -tangent, -direction
    return BranchPoint(
        x=x,
        s=s,
        z=metric.place(x, s),
        tangent=tangent,
        jacobian=rows[:, :d] + np.eye(d),
        regularity=float(np.linalg.det(np.concatenate([rows, direction[None, :]]))),
        found=found,
        miss=miss,
    )
