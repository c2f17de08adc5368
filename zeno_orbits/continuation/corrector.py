r"""Points of a family of fixed points, and Newton's method that leads to them.

With the section coordinates `y` and the parameter `s`, a family solves :math:`P(y, s) - y = 0`.
Everything is measured in scaled ambient terms, :math:`z = (x / \mathrm{scale}, s / \mathrm{unit})`,
so that a chart can be laid anew around every iterate and none is ever left. Theory (37).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from zeno_orbits.arrays import Vector, eigenvalues
from zeno_orbits.continuation.return_maps import DifferentiatedReturn, ReturnMap
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.orbits import Section

_MOST_ITERATIONS = 9
CLOSED = 2e-11
"""Miss of a return, in scaled states, that counts as zero."""
STALLED = 2e-9
"""Miss that rounding may leave near an end of a family; more is no point of it."""
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
        """Return the ambient place of a state and a parameter, ``(n_x + 1,)``."""
        return np.append(x / self.scale, s / self.unit)

    def of_place(self, z: Vector) -> tuple[Vector, float]:
        """Return the state and the parameter at an ambient place."""
        return z[:-1] * self.scale, float(z[-1]) * self.unit


@dataclass(frozen=True, kw_only=True)
class BranchPoint:
    r"""A point of a family.

    Attributes:
        x: State on the section, ``(n_x,)``.
        s: Parameter.
        z: Both in scaled terms, ``(n_x + 1,)``.
        tangent: Unit tangent of the family there, ``(n_x + 1,)``.
        jacobian: :math:`\partial P / \partial y`, ``(d, d)``.
        found: The return.
        miss: Largest difference of the return from the state, in scaled states.
    """

    x: Vector
    s: float
    z: Vector
    tangent: Vector
    jacobian: Vector
    found: DifferentiatedReturn
    miss: float

    @cached_property
    def multipliers(self) -> tuple[complex, ...]:
        """Floquet multipliers, the largest first."""
        return eigenvalues(self.jacobian)


def correct(
    returns: ReturnMap,
    metric: FamilyMetric,
    z: Vector,
    along: Vector,
    *,
    fixed: Vector | None = None,
) -> BranchPoint:
    r"""Return the point of the family in the plane through a place, at right angles to a tangent.

    .. math::
        \begin{pmatrix} \partial_y P - 1 & \partial_s P\\ t^\top \partial_y z & t^\top \partial_s z
        \end{pmatrix} \begin{pmatrix}\delta y\\ \delta s\end{pmatrix} =
        - \begin{pmatrix} P - y\\ t^\top (z - z_0) \end{pmatrix}

    with `s` in units of its range: of very different columns rounding leaves only the largest.

    Args:
        returns: The return map.
        metric: Units.
        z: The place :math:`z_0`, ``(n_x + 1,)``.
        along: The tangent `t`, whose sense the new tangent gets, ``(n_x + 1,)``.
        fixed: Normal of another plane, if not the tangent.

    Raises:
        SimulationError: If Newton's method does not converge.
        ZenoOrbitsError: If a return fails on the way.
    """
    normal = along if fixed is None else fixed
    # A parameter at an end of its range must not leave it by a rounding error.
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
            # The last correction is too small to be worth another return.
            return _point(x, s, metric, rows, ambient, found, miss, along)
        before = miss
    raise SimulationError(
        f"Newton's method does not close the return, it misses by {before:.1e}",
        time=metric.horizon,
        state=tuple(x.tolist()),
    )


def corrected_again(returns: ReturnMap, metric: FamilyMetric, point: BranchPoint) -> BranchPoint:
    """Return a point after one more correction, however small its miss is.

    Args:
        returns: The return map, at another accuracy than the one of the point for instance.
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


def first_point(
    returns: ReturnMap, metric: FamilyMetric, x: Vector, s: float, *, rising: bool
) -> BranchPoint:
    """Return the point of the family at a parameter, its tangent with the parameter or against it.

    Args:
        returns: The return map.
        metric: Units.
        x: A state near it, ``(n_x,)``.
        s: The parameter.
        rising: True if the parameter rises along the tangent.

    Raises:
        ZenoOrbitsError: If no point is near the state.
    """
    z = metric.place(x, s)
    upwards = np.zeros(z.size)
    upwards[-1] = 1.0 if rising else -1.0
    return correct(returns, metric, z, upwards)


def returned(returns: ReturnMap, x: Vector, s: float, metric: FamilyMetric) -> DifferentiatedReturn:
    """Return the return from a state.

    Args:
        returns: The return map.
        x: The state, ``(n_x,)``.
        s: The parameter.
        metric: Units, and the time to wait.

    Raises:
        SimulationError: If numbers ran out of range on the way.
    """
    if not (np.all(np.isfinite(x)) and np.isfinite(s)):
        raise SimulationError("Newton's method diverges", time=0.0, state=tuple(x.tolist()))
    try:
        return returns.follow(x, s, horizon=metric.horizon)
    except (InputError, np.linalg.LinAlgError, OverflowError) as error:
        # A trial far off the family may be no state of the machine, or run away unstopped.
        raise SimulationError(str(error), time=metric.horizon, state=tuple(x.tolist())) from error


def linearized(
    here: Section, found: DifferentiatedReturn, metric: FamilyMetric
) -> tuple[Vector, Vector]:
    """Return the derivative of `P - y` and of the ambient place.

    By the coordinates, then by the parameter in units of its range.

    Args:
        here: The section around the state.
        found: The return from it.
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
        tangent = -tangent
    return BranchPoint(
        x=x,
        s=s,
        z=metric.place(x, s),
        tangent=tangent,
        jacobian=rows[:, :d] + np.eye(d),
        found=found,
        miss=miss,
    )
