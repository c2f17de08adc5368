r"""Ends of a family: the limit at which one of its margins vanishes.

At an end the family exists on one side only. The end is approached in a variable in which the
family is smooth up to the end. The last part of the family is extrapolated. Theory (5.7) and (5.8).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from zeno_orbits.arrays import Vector, spectral_radius
from zeno_orbits.continuation.corrector import BranchPoint, FamilyMetric, correct, corrected_again
from zeno_orbits.continuation.lock_end import locate_cut
from zeno_orbits.continuation.margins import ENDS, LEAST_POWER, VanishingMargin, causes, stages
from zeno_orbits.continuation.return_maps import FamilyMap
from zeno_orbits.continuation.special_points.special_points import Located
from zeno_orbits.continuation.special_points.subdivision import neville
from zeno_orbits.errors import SimulationError, ZenoOrbitsError
from zeno_orbits.orbits import Margin, MarginKind


def locate_end(
    returns: FamilyMap,
    metric: FamilyMetric,
    points: Sequence[BranchPoint],
    threat: VanishingMargin,
) -> Located:
    """Return the end of a family at which a margin is zero, with its cause as its kind.

    Args:
        returns: The return map.
        metric: Units.
        points: Points in order. The last point is near the end.
        threat: The margin that vanishes.

    Raises:
        ZenoOrbitsError: If the end cannot be approached.
    """
    found = _located(returns, metric, points, threat)
    if not found.path:
        return found
    left = causes(stages([*points[-2:], *found.path]), threat.margin)
    # The acceleration at elastic impacts vanishes with another margin only.
    causing = [
        one
        for one in left
        if one.loss is not MarginKind.ACCELERATION
        or returns.restitution(found.point.s, one.place) == 0.0
    ]
    if not causing:
        raise SimulationError("The acceleration vanishes without a known cause", time=0.0, state=())
    cause, *others = causing
    if cause != threat.margin:
        found = _better(found, returns, metric, points, replace(threat, margin=cause))
    kinds = {ENDS[margin.loss]: None for margin in (cause, *others)}
    name, *also = kinds
    return replace(found, kind=name, cause=cause, also=tuple(also))


def _located(
    returns: FamilyMap,
    metric: FamilyMetric,
    points: Sequence[BranchPoint],
    threat: VanishingMargin,
) -> Located:
    last, margin = points[-1], threat.margin
    if margin.loss is MarginKind.LOCK and returns.restitution(last.s, margin.place) > 0.0:
        return locate_cut(returns, metric, last, margin, threat.distance)
    return _approach(returns, metric, _falling(points, margin), margin)


def _falling(points: Sequence[BranchPoint], margin: Margin) -> list[BranchPoint]:
    """Return the last points, at least two, along which a margin falls.

    Where the largest multiplier grows without bound, only a curve through several points predicts
    the next one well enough.
    """
    nodes = list(points[-2:])
    for one in reversed(points[:-2]):
        value = one.found.margins.get(margin)
        if len(nodes) == _CURVE or value is None or value <= nodes[0].found.margins[margin]:
            break
        nodes.insert(0, one)
    return nodes


def _better(
    found: Located,
    returns: FamilyMap,
    metric: FamilyMetric,
    points: Sequence[BranchPoint],
    cause: VanishingMargin,
) -> Located:
    """Return an end located by the margin of its cause, if the error estimate is smaller."""
    try:
        other = _located(returns, metric, points, cause)
    except ZenoOrbitsError:
        return found
    return other if other.error < found.error else found


def _limits(used: Sequence[BranchPoint], gone: Margin) -> dict[Margin, float]:
    """Return the margins at an end by extrapolation to the zero of one of them."""
    before, last = [node.found.margins for node in used[:-1]], used[-1].found.margins
    known = [margin for margin in last if all(margin in one for one in before)]
    rows = np.array([[one[margin] for margin in known] for one in (*before, last)])
    limit, _ = neville(rows[:, known.index(gone)], rows)
    limits = {margin: max(0.0, float(value)) for margin, value in zip(known, limit, strict=True)}
    return {**last, **limits, gone: 0.0}


def _multipliers(used: Sequence[BranchPoint], gone: Margin) -> tuple[tuple[complex, ...], float]:
    """Return the multipliers at an end by extrapolation to the zero of a margin, and their change.

    If the largest multiplier grows like a power of the margin, as at a grazing impact, it has no
    limit. The multipliers of the last point are then returned, with an infinite change.
    """
    values = np.array([node.found.margins[gone] for node in used])
    before, last = used[-2:]
    sizes = [spectral_radius(node.multipliers) for node in (before, last)]
    if min(sizes) > 0.0 and sizes[1] / sizes[0] > (values[-2] / values[-1]) ** LEAST_POWER:
        return last.multipliers, math.inf
    rows = np.array([np.sort_complex(np.array(node.multipliers)) for node in used])
    best, error = rows[-1], math.inf
    for n in range(2, len(used) + 1):
        limit, change = neville(values[-n:], rows[-n:])
        largest = float(np.max(change, initial=0.0))
        if largest < error:
            best, error = limit, largest
    # Without negative zeros, and a pair with its positive imaginary part first.
    found = sorted((best[::-1] + 0.0).tolist(), key=abs, reverse=True)
    return tuple(found), error


_HALVINGS = 12
_SMALLER = 0.1
"""Part to which the margin of a motion that stalls is reduced: powers of it need not be whole."""
_NODES, _CURVE, _LINE = 7, 4, 2
_GOOD = 1e-11


def _approach(
    returns: FamilyMap, metric: FamilyMetric, known: Sequence[BranchPoint], margin: Margin
) -> Located:
    """Return the limit of a sequence of points along which a margin is halved repeatedly."""
    nodes, unit = list(known), known[-1].found.time
    patience = metric.horizon / unit
    stalls = margin.loss in (MarginKind.FREQUENCY, MarginKind.STALL)
    best: tuple[float, Vector, Sequence[BranchPoint]] | None = None
    # The powers of a saddle's margin may be close to one, so only lines through two points count.
    most = _LINE if margin.loss is MarginKind.STALL else _NODES
    before_last: Vector | None = None
    for _ in range(_HALVINGS):
        metric = metric.waiting_for(nodes[-1].found.time, longer=patience)
        try:
            nodes.append(_halved(returns, metric, nodes, margin))
        except ZenoOrbitsError:
            if best is None:
                raise
            break
        used = nodes[-most:]
        if len(nodes) < len(known) + 2:
            continue
        values = [node.found.margins[margin] for node in used]
        times = [0.0 if stalls else node.found.time / unit for node in used]
        rows = np.array([np.append(node.z, time) for node, time in zip(used, times, strict=True)])
        limit, change = neville(np.array(values), rows)
        if most == _LINE:
            change = math.inf if before_last is None else np.abs(limit - before_last)
            before_last = limit
        error = float(np.max(change))
        if best is None or error < best[0]:
            best = (error, limit, used)
        elif error > 10 * best[0]:
            break
        if error < _GOOD:
            break
    if best is None:
        raise SimulationError("The end cannot be approached", time=0.0, state=())
    error, limit, used = best
    error += _noise(returns, metric, nodes, margin)
    multipliers, change = _multipliers(used, margin)
    rest = ()
    if margin.loss is MarginKind.STALL:
        x, s = nodes[-1].x, nodes[-1].s
        saddle = returns.saddle(x, s, horizon=patience * nodes[-1].found.time)
        rest = () if saddle is None else tuple(saddle.state.tolist())
    return Located(
        kind=ENDS[margin.loss],
        point=nodes[-1],
        rest=rest,
        z=limit[:-1],
        period=math.inf if stalls else float(limit[-1]) * unit,
        error=error * metric.unit,
        margins=_limits(used, margin),
        multipliers=multipliers,
        multiplier_error=change,
        cause=margin,
        path=tuple(nodes[len(known) :]),
    )


def _noise(
    returns: FamilyMap, metric: FamilyMetric, nodes: Sequence[BranchPoint], margin: Margin
) -> float:
    """Return an estimate of the change of an end at a looser tolerance.

    It is computed from the changes of the two points nearest to the end.
    """
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
    returns: FamilyMap, metric: FamilyMetric, nodes: Sequence[BranchPoint], margin: Margin
) -> BranchPoint:
    """Return a point at which a margin is about half its value at the last point."""
    used = nodes[-_CURVE:]
    values = np.array([node.found.margins[margin] for node in used])
    rows = np.array([node.z for node in used])
    part = _SMALLER if margin.loss is MarginKind.STALL else 0.5
    last = nodes[-1]
    for _ in range(6):
        target, _ = neville(values - part * values[-1], rows)
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
