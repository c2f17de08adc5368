r"""The end at which a contact phase vanishes, as the limit of truncated impact sequences.

At this end the Zeno point is not differentiable. A return that is truncated after some impacts is
differentiable on both sides of the end. Theory (5.7).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.corrector import BranchPoint, FamilyMetric, correct, corrected_again
from zeno_orbits.continuation.families import SpecialPointKind
from zeno_orbits.continuation.return_maps import FamilyMap
from zeno_orbits.continuation.separatrix import separatrix
from zeno_orbits.continuation.special_points.special_points import Located
from zeno_orbits.continuation.special_points.test_functions import multiplier_change, with_course
from zeno_orbits.errors import SimulationError, ZenoOrbitsError
from zeno_orbits.orbits import Margin, MarginKind

_ROOT = 1e-13
_GOOD = 1e-11
_REACH = 4.0
"""Largest distance of an end from the last point, as a multiple of the predicted distance."""
_MOST_IMPACTS = 400
_MOST_FIRST_CUTS = 16
"""Number of truncations that are tried as the first of the sequence.

They have up to 42 impacts: at a restitution of 0.85 the first dozen impacts are still far from the
self-similar sequence."""
_FIRST_STEP = 1e-4


def locate_cut(
    returns: FamilyMap,
    metric: FamilyMetric,
    last: BranchPoint,
    margin: Margin,
    distance: float,
) -> Located:
    """Return the end beyond a point of the family at which the contact phase vanishes.

    Args:
        returns: The return map.
        metric: Units.
        last: The last point of the family.
        margin: The contact duration, of one of several returns.
        distance: Rough distance of the end.

    Raises:
        ZenoOrbitsError: If the contact phase does not vanish nearby.
    """
    near = _Near(centre=last.z, reach=_REACH * distance)
    trouble: ZenoOrbitsError | None = None
    for n, here in islice(_telling_cuts(returns, metric, last, margin), _MOST_FIRST_CUTS):
        try:
            found = _cut_ever_later(returns, metric, here, n, _FIRST_STEP, margin, near)
        except ZenoOrbitsError as error:
            # The root of a truncation converges to the end as (sigma/kappa)^n. It may be far from
            # the end after few impacts.
            trouble = error
            continue
        return replace(found, margins={**last.found.margins, margin: 0.0})
    raise trouble or SimulationError("The contact phase does not vanish", time=0.0, state=())


def locate_cut_near(
    returns: FamilyMap,
    metric: FamilyMetric,
    z: Vector,
    along: Vector,
    margin: Margin,
) -> Located:
    """Return the end at which the contact phase vanishes, near an estimate of it.

    Args:
        returns: The return map.
        metric: Units.
        z: The estimate, ``(n_x + 1,)``.
        along: Approximate tangent of the family at the estimate, ``(n_x + 1,)``.
        margin: The contact duration.

    Raises:
        ZenoOrbitsError: If the contact phase does not vanish nearby.
    """
    for n in _KNOWN_CUTS:
        try:
            here = correct(returns.cut_after(n), metric, z, along)
            near = _Near(centre=here.z, reach=_BESIDE)
            return _cut_ever_later(returns, metric, here, n, _FIRST_STEP, margin, near)
        except ZenoOrbitsError:
            # Beyond the end contact ends before the impacts accumulate, the later the nearer the
            # end is. So fewer impacts may still occur.
            continue
    raise SimulationError(
        "The end of the contact phase is not near the predicted point", time=0.0, state=()
    )


_KNOWN_CUTS = (9, 7, 5, 4)
"""Numbers of impacts to try in the first truncation, near an estimate of the end."""
_BESIDE = 0.03
"""Largest distance of the end from its first approximation."""


def _cut_ever_later(
    returns: FamilyMap,
    metric: FamilyMetric,
    here: BranchPoint,
    n: int,
    step: float,
    margin: Margin,
    near: _Near,
) -> Located:
    r"""Return the limit of the points with truncated sequences on the separatrix (theory (5.7)).

    The root of :math:`1 - r_n / r_*` converges as :math:`(\sigma/\kappa)^n`, so each pair of roots
    is extrapolated to a better estimate.
    """
    cut = replace(margin, loss=MarginKind.CUT)
    law = separatrix(returns.restitution(here.s, margin.place))
    # About one decade of convergence per truncation, so that the differences are significant.
    stride = max(1, round(-1.0 / np.log10(law.shrinking / law.repulsion)))
    found: list[BranchPoint] = []
    limits: list[Vector] = []
    error = np.inf
    for _ in range(_MOST_CUTS):
        here = _cut_root(returns.cut_after(n), metric, here, step, cut, near)
        found.append(here)
        if len(found) > 1:
            change = found[-1].z - found[-2].z
            law = separatrix(returns.restitution(here.s, margin.place))
            part = (law.shrinking / law.repulsion) ** stride
            limits.append(np.append(here.z + change * part / (1 - part), here.found.time))
            step = float(np.linalg.norm(change)) * part
        if len(limits) > 1:
            error = float(np.max(np.abs(limits[-1] - limits[-2])[:-1]))
            if error < _GOOD or step < _GOOD:
                break
        n += stride
    # The error is the last change of the limit plus the change of the root at a looser tolerance.
    loose = corrected_again(returns.cut_after(n).loosened(), metric, here)
    slope = _slope(returns.cut_after(n), metric, here, cut, max(step, 1e-9))
    doubt = abs(loose.found.margins[cut] - here.found.margins[cut]) / abs(slope)
    here = with_course(returns.cut_after(n), metric, here, max(step, 1e-9))
    # A shorter truncation approximates the multipliers less well.
    moved = multiplier_change(here, found[-2])
    return Located(
        kind=SpecialPointKind.LOCK_VANISHES,
        point=here,
        z=limits[-1][:-1],
        period=float(limits[-1][-1]),
        error=(error + doubt) * metric.unit,
        margins=here.found.margins,
        multipliers=here.multipliers,
        multiplier_error=moved,
        cause=margin,
    )


_MOST_CUTS = 16


def _telling_cuts(
    returns: FamilyMap, metric: FamilyMetric, last: BranchPoint, margin: Margin
) -> Iterator[tuple[int, BranchPoint]]:
    """Yield the numbers of impacts, in ascending order, whose truncation has a positive margin.

    The distance of the end can be estimated from such a margin. A truncation to fewer impacts than
    another stop has in a row changes the event sequence.
    """
    n, cut = 2, replace(margin, loss=MarginKind.CUT)
    while n < _MOST_IMPACTS:
        try:
            point = correct(returns.cut_after(n), metric, last.z, last.tangent)
        except ZenoOrbitsError:
            point = None
        if point is not None and point.found.margins[cut] > 0.0:
            yield n, point
        n = max(n + 1, round(1.2 * n))


def _slope(
    returns: FamilyMap, metric: FamilyMetric, point: BranchPoint, cut: Margin, step: float
) -> float:
    """Return the derivative of the truncation's margin along the family."""
    for _ in range(6):
        try:
            other = correct(returns, metric, point.z - step * point.tangent, point.tangent)
        except ZenoOrbitsError:
            step /= 4
            continue
        return (point.found.margins[cut] - other.found.margins[cut]) / step
    raise SimulationError("The slope of the cut is undefined", time=0.0, state=())


@dataclass(frozen=True, slots=True, kw_only=True)
class _Near:
    """The ball in which a root is searched. Any root outside belongs to another end."""

    centre: Vector
    reach: float

    def check(self, z: Vector) -> None:
        """Reject a point outside the ball."""
        if not float(np.linalg.norm(z - self.centre)) <= self.reach:
            raise SimulationError(
                "The contact phase does not vanish near the predicted point", time=0.0, state=()
            )


_MOST_CUT_SECANTS, _MOST_CUT_TRIALS = 12, 5


def _cut_root(
    returns: FamilyMap,
    metric: FamilyMetric,
    start: BranchPoint,
    step: float,
    cut: Margin,
    near: _Near,
) -> BranchPoint:
    """Return the point at which a truncated sequence is on the separatrix, by secants."""
    here = correct(returns, metric, start.z, start.tangent)
    value = here.found.margins[cut]
    slope = _slope(returns, metric, here, cut, step)
    for _ in range(_MOST_CUT_SECANTS):
        distance = -value / slope
        if abs(distance) < _ROOT:
            return here
        near.check(here.z + distance * here.tangent)
        other = _less(returns, metric, here, distance, cut)
        gone = float((other.z - here.z) @ here.tangent)
        if other.found.margins[cut] == value or gone == 0.0:
            return other
        slope = (other.found.margins[cut] - value) / gone
        here, value = other, other.found.margins[cut]
        if abs(value / slope) < 3 * _ROOT:
            return here
    raise SimulationError("The end of the contact phase is not found", time=0.0, state=())


def _less(
    returns: FamilyMap, metric: FamilyMetric, here: BranchPoint, distance: float, cut: Margin
) -> BranchPoint:
    """Return a point ahead with an acceptable margin, as far ahead as it can be computed.

    The distance is reduced until the margin's modulus is below twice its value here.
    """
    for _ in range(_MOST_CUT_TRIALS):
        try:
            other = correct(returns, metric, here.z + distance * here.tangent, here.tangent)
        except ZenoOrbitsError:
            pass
        else:
            if abs(other.found.margins[cut]) < 2 * abs(here.found.margins[cut]):
                return other
        distance /= 4
    raise SimulationError("The end of the contact phase is not found", time=0.0, state=())
