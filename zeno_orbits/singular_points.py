r"""Where a family changes its character, and where it ends: test functions and their roots.

Inside a family every test function is smooth along it, and a sign change between two points is
closed in on by points of the family in between. At an end the family exists on one side only. It is
approached in a variable in which it is smooth up to the end, and the last stretch is extrapolated.
Theory (38) to (40).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from zeno_orbits.corrector import BranchPoint, Metric, correct, corrected_again
from zeno_orbits.cut_returns import cut_after
from zeno_orbits.dynamics import Vector
from zeno_orbits.errors import SimulationError, ZenoOrbitsError
from zeno_orbits.families import Kind
from zeno_orbits.return_maps import Loss, Margin, ReturnMap
from zeno_orbits.separatrix import separatrix

TestFunction = Callable[[BranchPoint], float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Located:
    """A special point and how well it is known.

    Attributes:
        kind: What it is.
        point: A point of the family at it, or the nearest that was computed.
        z: Its ambient place, ``(n_x + 1,)``; at an end, the limit.
        period: [s].
        error: Estimated error of the parameter.
        margins: How far the orbit is from each loss; at an end, the limits.
        place: At an end, the return in which it is, counted from 0.
        path: Points of the family on the way to an end, in order.
    """

    kind: Kind
    point: BranchPoint
    z: Vector
    period: float
    error: float
    margins: Mapping[Margin, float]
    place: int = 0
    path: tuple[BranchPoint, ...] = ()


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


INSIDE: dict[Kind, TestFunction] = {
    Kind.FOLD: fold_test,
    Kind.FLIP: flip_test,
    Kind.TORUS: torus_test,
    Kind.BRANCHING: branching_test,
}

_ROOT = 1e-13
_MOST_TRIALS = 40
_REAL = 1e-6


def crossings(a: BranchPoint, b: BranchPoint) -> tuple[Kind, ...]:
    """Return the kinds of special points between two neighbours on a family."""
    found = [kind for kind, test in INSIDE.items() if test(a) * test(b) < 0.0]
    if Kind.FOLD in found and Kind.BRANCHING in found:
        # The quotient of two numbers with one simple root each between the points.
        found.remove(Kind.BRANCHING)
    return tuple(found)


def locate_inside(
    returns: ReturnMap, metric: Metric, a: BranchPoint, b: BranchPoint, kind: Kind
) -> Located | None:
    """Return the special point between two neighbours, or ``None`` if it is none after all.

    Raises:
        ZenoOrbitsError: If a point in between cannot be had.
    """
    root = root_between(returns, metric, a, b, INSIDE[kind])
    point = root.point
    pair = max((abs(m.imag) for m in point.multipliers), default=0.0)
    if kind is Kind.TORUS and pair < _REAL:
        # Two real multipliers with product one: nothing happens to the orbit.
        return None
    return Located(
        kind=kind,
        point=point,
        z=point.z,
        period=point.found.time,
        error=root.error * metric.unit,
        margins=point.found.margins,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Root:
    """A root of a test function on a family.

    Attributes:
        point: The point there.
        error: Estimated error of the parameter in its unit.
    """

    point: BranchPoint
    error: float


def root_between(
    returns: ReturnMap, metric: Metric, a: BranchPoint, b: BranchPoint, test: TestFunction
) -> Root:
    """Return the root of a test function between two points at which its signs differ."""
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
    returns: ReturnMap, metric: Metric, start: BranchPoint, kind: Kind, test: TestFunction
) -> Located:
    """Return the special point near a point of a family, by secants along it.

    Raises:
        ZenoOrbitsError: If there is none near.
    """
    here, value = start, test(start)
    other = correct(returns, metric, here.z + _NUDGE * here.tangent, here.tangent)
    slope = (test(other) - value) / _NUDGE
    for _ in range(_MOST_SECANTS):
        distance = -value / slope if slope else np.inf
        if not abs(distance) < _NEAR:
            break
        if abs(distance) < _ROOT:
            error = _doubt(returns, metric, here, test, slope) * metric.unit
            return Located(
                kind=kind,
                point=here,
                z=here.z,
                period=here.found.time,
                error=error,
                margins=here.found.margins,
            )
        there = correct(returns, metric, here.z + distance * here.tangent, here.tangent)
        gone, value_there = float((there.z - here.z) @ here.tangent), test(there)
        if gone != 0.0 and value_there != value and abs(distance) > _TINY:
            slope = (value_there - value) / gone
        here, value = there, value_there
        if abs(distance) < _TINY:
            error = _doubt(returns, metric, here, test, slope) * metric.unit
            return Located(
                kind=kind,
                point=here,
                z=here.z,
                period=here.found.time,
                error=error,
                margins=here.found.margins,
            )
    raise SimulationError(f"There is no {kind.value} near", time=0.0, state=())


_NEAR, _TINY = 0.3, 1e-8
"""How far a special point may be along the family, and a secant after which rounding is left."""


def _doubt(
    returns: ReturnMap, metric: Metric, point: BranchPoint, test: TestFunction, slope: float
) -> float:
    """Return by how much a looser computation moves a root along the parameter, in its unit."""
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


ENDS = {
    Loss.AMPLITUDE: Kind.AMPLITUDE_ZERO,
    Loss.LOCK: Kind.LOCK_VANISHES,
    Loss.ACCELERATION: Kind.THEOREM_LOST,
    Loss.FIRST_IMPACT: Kind.GRAZING,
    Loss.NEAR_MISS: Kind.EARLIER_GRAZING,
    Loss.RELEASE_RATE: Kind.RELEASE_LOST,
    Loss.ADHESION: Kind.EARLIER_RELEASE,
}
"""What a loss is called when it happens."""

_NEARLY = 0.4
"""Part of a margin's largest value below which its end may be near."""
_TOGETHER = 0.6
"""Fall of a margin, as a part of what another's entails, at which both vanish at one point."""
_ENTAILED: dict[Loss, dict[Loss, float]] = {
    Loss.AMPLITUDE: {
        Loss.FIRST_IMPACT: 1.0,
        Loss.ACCELERATION: 1.0,
        Loss.RELEASE_RATE: 1.0,
        Loss.NEAR_MISS: 1.0,
    },
    Loss.RELEASE_RATE: {Loss.FIRST_IMPACT: 3.0},
    Loss.LOCK: {Loss.ACCELERATION: 1.0, Loss.ADHESION: 2.0},
}
"""What else vanishes with a margin, and with which power of it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Threat:
    """A margin that runs out.

    Attributes:
        margin: Which.
        distance: Predicted distance along the family.
        fall: Logarithm of its last fall.
    """

    margin: Margin
    distance: float
    fall: float


def threats(points: Sequence[BranchPoint], restitution: float) -> list[Threat]:
    """Return the margins that run out beyond the last point, the nearest first.

    Args:
        points: Points of a family in order, at least two.
        restitution: At the last one.
    """
    before, last = points[-2], points[-1]
    step = float(np.linalg.norm(last.z - before.z))
    found: dict[Margin, Threat] = {}
    for margin, value in last.found.margins.items():
        earlier = before.found.margins.get(margin)
        if earlier is None or step == 0.0 or margin.loss is Loss.CUT:
            continue
        largest = max(p.found.margins.get(margin, 0.0) for p in points)
        if 0.0 < value < min(earlier, _NEARLY * largest):
            power = 1.0
            if margin.loss is Loss.LOCK and restitution > 0.0:
                power = 1 / separatrix(restitution).exponent
            found[margin] = Threat(
                margin=margin,
                distance=step / ((earlier / value) ** power - 1),
                fall=float(np.log(earlier / value)),
            )
    return _without_consequences(found)


def _without_consequences(found: dict[Margin, Threat]) -> list[Threat]:
    """Return threats without those that a greater one entails, by how fast they fall together.

    Where the amplitude vanishes everything does that is no time, in proportion. Where the release
    is not transversal the flight after it vanishes, and lands with the cube of the release's rate.
    Where the locked arc vanishes, so does the acceleration at its start.
    """
    left = dict(found)
    for margin, threat in found.items():
        for loss, power in _ENTAILED.get(margin.loss, {}).items():
            lesser = left.get(Margin(loss=loss, place=margin.place))
            if lesser is not None and threat.fall > _TOGETHER * lesser.fall / power:
                del left[lesser.margin]
    return sorted(left.values(), key=lambda threat: threat.distance)


def locate_end(
    returns: ReturnMap,
    metric: Metric,
    points: Sequence[BranchPoint],
    threat: Threat,
    restitution: Callable[[float], float],
) -> Located:
    """Return the end of a family at which a margin is zero.

    Args:
        returns: The return map.
        metric: Units.
        points: Points in order, the last one near the end.
        threat: What vanishes.
        restitution: At a parameter.

    Raises:
        ZenoOrbitsError: If it cannot be closed in on.
    """
    if threat.margin.loss is Loss.LOCK and restitution(points[-1].s) > 0.0:
        return _locate_cut(returns, metric, points[-1], threat, restitution)
    return _approach(returns, metric, points[-2], points[-1], threat.margin)


def _limits(before: BranchPoint, last: BranchPoint, gone: Margin) -> dict[Margin, float]:
    """Return margins where one of them vanishes, on a line through the last two points."""
    early, late = before.found.margins, last.found.margins
    part = late[gone] / (early[gone] - late[gone])
    return {
        margin: max(0.0, value - part * (early.get(margin, value) - value))
        for margin, value in late.items()
    }


_HALVINGS = 12
_NODES = 7
_GOOD = 1e-11


def _approach(
    returns: ReturnMap, metric: Metric, before: BranchPoint, last: BranchPoint, margin: Margin
) -> Located:
    """Return the limit of points at which a margin is halved again and again."""
    nodes = [before, last]
    best: tuple[float, Vector] | None = None
    for _ in range(_HALVINGS):
        try:
            nodes.append(_halved(returns, metric, nodes, margin))
        except ZenoOrbitsError:
            if best is None:
                raise
            break
        used = nodes[-_NODES:]
        if len(used) < 4:
            continue
        values = [node.found.margins[margin] for node in used]
        rows = np.array([np.append(node.z, node.found.time) for node in used])
        limit, error = _neville(np.array(values), rows)
        if best is None or error < best[0]:
            best = (error, limit)
        elif error > 10 * best[0]:
            break
        if error < _GOOD:
            break
    if best is None:
        raise SimulationError("The end cannot be approached", time=0.0, state=())
    error, limit = best
    error += _noise(returns, metric, nodes, margin)
    return Located(
        kind=ENDS[margin.loss],
        point=nodes[-1],
        z=limit[:-1],
        period=float(limit[-1]),
        error=error * metric.unit,
        margins=_limits(nodes[-2], nodes[-1], margin),
        place=margin.place,
        path=tuple(nodes[2:]),
    )


def _noise(
    returns: ReturnMap, metric: Metric, nodes: Sequence[BranchPoint], margin: Margin
) -> float:
    """Return by how much a looser computation moves the nearest points to an end, and it."""
    before, last = nodes[-2:]
    fall = last.found.margins[margin] - before.found.margins[margin]
    slope = abs(float(last.z[-1] - before.z[-1]) / fall)
    moved = 0.0
    for node in (before, last):
        try:
            again = corrected_again(returns.loosened(), metric, node)
        except ZenoOrbitsError:
            continue
        value = again.found.margins.get(margin, node.found.margins[margin])
        change = abs(value - node.found.margins[margin])
        moved = max(moved, abs(float(again.z[-1] - node.z[-1])) + slope * change)
    return moved


def _halved(
    returns: ReturnMap, metric: Metric, nodes: Sequence[BranchPoint], margin: Margin
) -> BranchPoint:
    """Return a point at which a margin is about half that of the last one."""
    used = nodes[-4:]
    values = np.array([node.found.margins[margin] for node in used])
    rows = np.array([node.z for node in used])
    part = 0.5
    last = nodes[-1]
    for _ in range(6):
        target, _ = _neville(values - part * values[-1], rows)
        try:
            point = correct(returns, metric, target, last.tangent)
            value = point.found.margins.get(margin)
        except ZenoOrbitsError:
            value = None
        else:
            if value is not None and 0.0 < value < 0.95 * values[-1]:
                return point
        part = (1 + part) / 2
    raise SimulationError("The end cannot be approached", time=0.0, state=())


def _neville(places: Vector, rows: Vector) -> tuple[Vector, float]:
    """Return the value at 0 of the polynomial through rows at places, and the last change."""
    table = list(rows)
    previous = table[-1]
    for order in range(1, len(table)):
        previous = table[-1]
        table = [
            (places[k + order] * table[k] - places[k] * table[k + 1])
            / (places[k + order] - places[k])
            for k in range(len(table) - 1)
        ]
    return table[0], float(np.max(np.abs(table[0] - previous)))


_REACH = 4.0
"""Distance of an end from the last point, as a multiple of the predicted one."""
_MOST_IMPACTS = 400
_FIRST_RATIO = 0.9


def _locate_cut(
    returns: ReturnMap,
    metric: Metric,
    last: BranchPoint,
    threat: Threat,
    restitution: Callable[[float], float],
) -> Located:
    """Return where the locked arc vanishes beyond a point of the family."""
    place = threat.margin.place
    near = _Near(centre=last.z, reach=_REACH * threat.distance)
    n, here, step = _first_cut(returns, metric, last, place, Margin(loss=Loss.CUT, place=place))
    found = _cut_ever_later(returns, metric, here, n, step, place, restitution, near)
    return replace(found, margins={**last.found.margins, threat.margin: 0.0})


def locate_cut_near(
    returns: ReturnMap,
    metric: Metric,
    z: Vector,
    along: Vector,
    place: int,
    restitution: Callable[[float], float],
) -> Located:
    """Return where the locked arc vanishes near a place at which it is expected to.

    Args:
        returns: The return map.
        metric: Units.
        z: The place, ``(n_x + 1,)``.
        along: Tangent of the family there, roughly, ``(n_x + 1,)``.
        place: The return in which it is.
        restitution: At a parameter.

    Raises:
        ZenoOrbitsError: If it does not.
    """
    for n in _KNOWN_CUTS:
        try:
            here = correct(cut_after(returns, place, n), metric, z, along)
            near = _Near(centre=here.z, reach=_BESIDE)
            return _cut_ever_later(returns, metric, here, n, 1e-4, place, restitution, near)
        except ZenoOrbitsError:
            # Beyond the end a sequence is let go, the later the nearer: fewer impacts still are.
            continue
    raise SimulationError("The end of the locked arc is not near", time=0.0, state=())


_KNOWN_CUTS = (9, 7, 5, 4)
"""Impacts of the first cut where the end is known roughly."""
_BESIDE = 0.03
"""How far from there the end may be."""


def _cut_ever_later(
    returns: ReturnMap,
    metric: Metric,
    here: BranchPoint,
    n: int,
    step: float,
    place: int,
    restitution: Callable[[float], float],
    near: _Near,
) -> Located:
    r"""Return the limit of the points at which cut sequences are on the separatrix (theory (39)).

    The root of :math:`1 - r_n / r_*` converges like :math:`(\sigma/\kappa)^n`, so every two
    give a better third.
    """
    cut, law = Margin(loss=Loss.CUT, place=place), separatrix(restitution(here.s))
    # About one decade of convergence between the cuts, so that their differences tell something.
    stride = max(1, round(-1.0 / np.log10(law.shrinking / law.repulsion)))
    found: list[BranchPoint] = []
    limits: list[Vector] = []
    error = np.inf
    for _ in range(_MOST_CUTS):
        here = _cut_root(cut_after(returns, place, n), metric, here, step, cut, near)
        found.append(here)
        if len(found) > 1:
            change = found[-1].z - found[-2].z
            law = separatrix(restitution(here.s))
            part = (law.shrinking / law.repulsion) ** stride
            limits.append(np.append(here.z + change * part / (1 - part), here.found.time))
            step = float(np.linalg.norm(change)) * part
        if len(limits) > 1:
            error = float(np.max(np.abs(limits[-1] - limits[-2])[:-1]))
            if error < _GOOD or step < _GOOD:
                break
        n += stride
    # The last cut's own convergence, and what a looser computation changes.
    loose = corrected_again(cut_after(returns, place, n).loosened(), metric, here)
    slope = _slope(cut_after(returns, place, n), metric, here, cut, max(step, 1e-9))
    doubt = abs(loose.found.margins[cut] - here.found.margins[cut]) / abs(slope)
    return Located(
        kind=Kind.LOCK_VANISHES,
        point=here,
        z=limits[-1][:-1],
        period=float(limits[-1][-1]),
        error=(error + doubt) * metric.unit,
        margins=here.found.margins,
        place=place,
    )


_MOST_CUTS = 16


def _first_cut(
    returns: ReturnMap, metric: Metric, last: BranchPoint, place: int, cut: Margin
) -> tuple[int, BranchPoint, float]:
    """Return the least number of impacts at which the cut tells how far the end is."""
    n = 2
    while n < _MOST_IMPACTS:
        whole = cut_after(returns, place, n)
        point = correct(whole, metric, last.z, last.tangent)
        if point.found.margins[cut] > 0.0:
            return n, point, 1e-4
        n = max(n + 1, round(1.2 * n))
    raise SimulationError("The locked arc does not vanish", time=0.0, state=())


def _slope(
    returns: ReturnMap, metric: Metric, point: BranchPoint, cut: Margin, step: float
) -> float:
    """Return the derivative of the cut's margin along the family."""
    for _ in range(6):
        try:
            other = correct(returns, metric, point.z - step * point.tangent, point.tangent)
        except ZenoOrbitsError:
            step /= 4
            continue
        return (point.found.margins[cut] - other.found.margins[cut]) / step
    raise SimulationError("The cut has no slope", time=0.0, state=())


@dataclass(frozen=True, slots=True, kw_only=True)
class _Near:
    """Where a root is looked for: farther off it is another one, or none."""

    centre: Vector
    reach: float

    def check(self, z: Vector) -> None:
        """Refuse a place that is too far."""
        if not float(np.linalg.norm(z - self.centre)) <= self.reach:
            raise SimulationError("The locked arc does not vanish near", time=0.0, state=())


_MOST_CUT_SECANTS, _MOST_CUT_TRIALS = 12, 5


def _cut_root(
    returns: ReturnMap, metric: Metric, start: BranchPoint, step: float, cut: Margin, near: _Near
) -> BranchPoint:
    """Return the point at which a cut sequence is on the separatrix, by secants."""
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
    raise SimulationError("The end of the locked arc is not found", time=0.0, state=())


def _less(
    returns: ReturnMap, metric: Metric, here: BranchPoint, distance: float, cut: Margin
) -> BranchPoint:
    """Return a point ahead at which the cut's margin is smaller, as far ahead as it can be had."""
    for _ in range(_MOST_CUT_TRIALS):
        try:
            other = correct(returns, metric, here.z + distance * here.tangent, here.tangent)
        except ZenoOrbitsError:
            pass
        else:
            if abs(other.found.margins[cut]) < 2 * abs(here.found.margins[cut]):
                return other
        distance /= 4
    raise SimulationError("The end of the locked arc is not found", time=0.0, state=())
