r"""Distances in the free values to the loss of an orbit, and the orbit with the largest margin.

Starting at an orbit, each free value is changed alone, in both directions. The orbit is continued
until it loses its shape or becomes unstable. The distance in units of the value's range, at most
one range, has the same meaning for every shape of orbit. With :math:`s_i(p)` these distances,

.. math:: \max_p t, \quad t \le s_i(p),

is solved by linear programs in a trust region. The derivative of :math:`s_i` with respect to the
changed value is :math:`\mp 1`, as the end point is fixed. Derivatives with respect to the other
values are difference quotients, updated after each step [Broyden1965]_. See theory (5.3).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.model import ParameterValues
from zeno_orbits.orbits import EventReturn
from zeno_orbits.search.optimum.paths import TO_LOSS, OrbitPaths
from zeno_orbits.simulation import Extent

_DIFFERENCE = 0.02
"""Step of a difference quotient, in units of ranges."""
_REGION, _SMALLEST_REGION = 0.25, 1e-3
"""First and smallest trust region, in units of ranges."""
_MOST_STEPS = 16
_GAIN = 2e-5
"""Predicted gain below which the iteration ends, in units of ranges."""
_EACH = 1e-4
"""Weight of the distances other than the smallest. It selects the middle of equal optima."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reach:
    """Distance to the loss of an orbit in one value.

    Attributes:
        name: Name of the gain or parameter.
        sign: 1 for increasing, -1 for decreasing values.
        distance: Distance to the loss of the orbit, in units of the range. It is 1 if the orbit
            persists over a whole range or over all admissible values.
        error: Estimated error of the distance.
        value: Value at the loss.
        reason: Reason of the loss, as a sentence. Empty without a loss.
    """

    name: str
    sign: int
    distance: float
    error: float
    value: float
    reason: str


@dataclass(frozen=True, kw_only=True)
class Persistence:
    """Distances from an orbit to its loss.

    Attributes:
        values: Values of the orbit.
        orbit: The orbit.
        reaches: Two distances for each free value.
    """

    values: ParameterValues
    orbit: EventReturn
    reaches: tuple[Reach, ...]

    @property
    def nearest(self) -> Reach:
        """The smallest reach."""
        return min(self.reaches, key=lambda one: one.distance)

    @property
    def extent(self) -> Extent:
        """The smallest distance with its error."""
        least = self.nearest
        return Extent(lowest=least.distance, highest=least.distance, error=least.error)

    @cached_property
    def merit(self) -> float:
        """The smallest distance, plus a small part of the mean over the values' least distances."""
        pairs = zip(self.reaches[::2], self.reaches[1::2], strict=True)
        each = [min(up.distance, down.distance) for up, down in pairs]
        return min(each) + _EACH * sum(each) / len(each)

    @property
    def text(self) -> str:
        """The range in which each value may change alone, and the nearest loss, as sentences."""
        pairs = zip(self.reaches[1::2], self.reaches[::2], strict=True)
        ranges = ", ".join(f"{up.name} = {down.value:.6g} to {up.value:.6g}" for down, up in pairs)
        least = self.nearest
        lost = f" The nearest loss is at {least.name} = {least.value:.6g}: {least.reason}."
        return f"It persists for {ranges}, each alone.{lost if least.reason else ''}"


def persistence(paths: OrbitPaths, values: ParameterValues, near: EventReturn) -> Persistence:
    """Compute the distances from an orbit to its loss of existence or stability.

    Args:
        paths: The orbits over the free values.
        values: Values of the orbit.
        near: The orbit.
    """
    reaches = tuple(
        _reach(paths, values, near, name, sign) for name in paths.free for sign in (1, -1)
    )
    return Persistence(values=values, orbit=near, reaches=reaches)


def _reach(
    paths: OrbitPaths, values: ParameterValues, near: EventReturn, name: str, sign: int
) -> Reach:
    low, high = paths.free[name]
    here, whole = values.number(name), sign * (high - low)
    wanted = _admissible(paths, name, here + whole)
    part = (wanted - here) / whole
    if part <= TO_LOSS.shortest:
        return Reach(name=name, sign=sign, distance=1.0, error=0.0, value=wanted, reason="")
    path = paths.follow(near, values, values.replaced({name: wanted}))
    # Without a loss before its last admissible value, a parameter counts as persistent.
    lost = part == 1.0 or (1.0 - path.end) * part > _AT_LAST * TO_LOSS.shortest
    if path.arrived or not lost:
        return Reach(name=name, sign=sign, distance=1.0, error=0.0, value=wanted, reason="")
    return Reach(
        name=name,
        sign=sign,
        distance=path.end * part,
        error=path.end_error * part,
        value=here + path.end * part * whole,
        reason=path.loss,
    )


_AT_LAST = 2.0
"""Distance from the last admissible value that counts as zero, in units of the shortest step."""


def _admissible(paths: OrbitPaths, name: str, value: float) -> float:
    """Return a parameter's value clipped to its admissible range. A gain may have any value."""
    quantity = paths.problem.quantity(name)
    if quantity not in paths.problem.parameters:
        return value
    return min(max(value, quantity.lower), quantity.upper)


@dataclass(frozen=True, kw_only=True)
class _Place:
    """A point of the optimization.

    Attributes:
        held: The distances at this point.
        slack: Distance of each bounded quantity from its bounds, positive inside.
    """

    held: Persistence
    slack: Vector

    @property
    def rows(self) -> Vector:
        """Distances and slacks, the outputs of the linear model."""
        return np.append([one.distance for one in self.held.reaches], self.slack)


def widest(paths: OrbitPaths, values: ParameterValues, near: EventReturn) -> Persistence:
    """Return the orbit with the largest smallest distance to a loss, within the bounds.

    The optimum is local.

    Args:
        paths: The orbits over the free values.
        values: Values of an orbit that satisfies the bounds.
        near: The orbit.
    """
    here = _place(paths, values, near)
    slopes, region = _slopes(paths, here), _REGION
    for _ in range(_MOST_STEPS):
        step, gain = _best_step(paths, here, slopes, region)
        if gain <= _GAIN or region < _SMALLEST_REGION:
            break
        paths.tell(f"widening the margin: {here.held.nearest.distance:.4f} of the ranges")
        there = _moved(paths, here, step)
        reached = -np.inf if there is None else there.held.merit - here.held.merit
        if there is not None:
            slopes = _corrected(slopes, here, there, step)
        region = float(np.max(np.abs(step))) * (0.25 if reached < 0.3 * gain else 2.0)
        if there is not None and reached > 0.0 and np.all(there.slack >= 0.0):
            here = there
    return here.held


def _place(paths: OrbitPaths, values: ParameterValues, near: EventReturn) -> _Place:
    slack = paths.slack(values, near)
    return _Place(held=persistence(paths, values, near), slack=slack)


def _moved(paths: OrbitPaths, here: _Place, step: Vector) -> _Place | None:
    """Return the point after a step in units of ranges, or ``None`` if the orbit is lost before."""
    moved = {
        name: min(max(here.held.values.number(name) + float(by) * (high - low), low), high)
        for (name, (low, high)), by in zip(paths.free.items(), step, strict=True)
    }
    wanted = here.held.values.replaced(moved)
    path = paths.follow(here.held.orbit, here.held.values, wanted)
    if path.orbit is None or not path.arrived:
        return None
    try:
        return _place(paths, wanted, path.orbit)
    except ZenoOrbitsError:
        return None


def _slopes(paths: OrbitPaths, here: _Place) -> Vector:
    """Return the derivative of each row with respect to each free value, in units of ranges."""
    n = len(paths.free)
    slopes = np.zeros((here.rows.size, n))
    for k, (name, (low, high)) in enumerate(paths.free.items()):
        if n > 1 or paths.is_bounded:
            up, down = here.held.reaches[2 * k : 2 * k + 2]
            sign = 1.0 if up.distance > down.distance else -1.0
            inside = (
                (high - here.held.values.number(name))
                if sign > 0
                else (here.held.values.number(name) - low)
            )
            if inside < _DIFFERENCE * (high - low):
                sign = -sign
            step = np.zeros(n)
            step[k] = sign * _DIFFERENCE
            there = _moved(paths, here, step)
            if there is not None:
                slopes[:, k] = (there.rows - here.rows) / step[k]
        for row, one in enumerate(here.held.reaches[2 * k : 2 * k + 2]):
            slopes[2 * k + row, k] = -one.sign
    return slopes


def _corrected(slopes: Vector, here: _Place, there: _Place, step: Vector) -> Vector:
    """Return the derivatives after a step, each row corrected along the step."""
    missed = there.rows - here.rows - slopes @ step
    ends = [one.distance >= 1.0 for place in (here, there) for one in place.held.reaches]
    whole = np.any(np.reshape(ends, (2, -1)), axis=0)
    missed[: whole.size][whole] = 0.0
    return slopes + np.outer(missed, step) / float(step @ step)


def _best_step(
    paths: OrbitPaths, here: _Place, slopes: Vector, region: float
) -> tuple[Vector, float]:
    """Return the optimal step of the linear model in units of ranges, and its predicted gain.

    Unknowns are the step, the smallest distance of each value, and the smallest of all distances.
    """
    n, rows = len(paths.free), here.rows
    n_reaches = len(here.held.reaches)
    a = np.zeros((rows.size + n, 2 * n + 1))
    a[: rows.size, :n] = -slopes
    for k in range(n_reaches):
        a[k, n + k // 2] = 1.0
    for k in range(n):
        a[rows.size + k, [n + k, 2 * n]] = -1.0, 1.0
    # A distance of a whole range is not a constraint.
    free = [one.distance >= 1.0 for one in here.held.reaches]
    b = np.append(rows, np.zeros(n))
    b[:n_reaches][free] = np.inf
    bounds: list[tuple[float, float]] = []
    for name, (low, high) in paths.free.items():
        at, width = here.held.values.number(name), high - low
        bounds.append((max(-region, (low - at) / width), min(region, (high - at) / width)))
    bounds += (n + 1) * [(-1.0, 1.0)]
    cost = np.append(np.zeros(n), np.append(np.full(n, -_EACH / n), -1.0))
    kept = np.isfinite(b)
    best = _linear_program(cost, a[kept], b[kept], bounds)
    if best is None:
        return np.zeros(n), 0.0
    return best[:n], float(-cost @ best - here.held.merit)


def _linear_program(
    cost: Vector, a: Vector, b: Vector, bounds: list[tuple[float, float]]
) -> Vector | None:
    r"""Return the :math:`x` of least cost with :math:`a x \le b` in a box, or ``None``."""
    # The import of SciPy's optimizers is slow, and few searches need them.
    from scipy.optimize import linprog

    found: Any = linprog(cost, A_ub=a, b_ub=b, bounds=bounds)
    return np.array(found.x) if found.status == 0 else None
