r"""Ends of a family: the limit at which one of its margins vanishes.

At an end the family exists on one side only. The end is approached in a variable in which the
family is smooth up to the end. The last part of the family is extrapolated. Theory (5.7) and (5.8).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.corrector import BranchPoint, FamilyMetric, correct, corrected_again
from zeno_orbits.continuation.lock_end import locate_cut
from zeno_orbits.continuation.margins import ENDS, VanishingMargin, causes, stages
from zeno_orbits.continuation.return_maps import ReturnMap
from zeno_orbits.continuation.special_points.special_points import Located
from zeno_orbits.continuation.special_points.subdivision import neville
from zeno_orbits.errors import SimulationError, ZenoOrbitsError
from zeno_orbits.orbits import Margin, MarginKind


def locate_end(
    returns: ReturnMap,
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
    cause, *others = causes(stages([*points[-2:], *found.path]), threat.margin)
    if (
        cause.loss is MarginKind.ACCELERATION
        and returns.restitution(found.point.s, cause.place) > 0.0
    ):
        raise SimulationError("The acceleration vanishes without a known cause", time=0.0, state=())
    if cause != threat.margin:
        found = _better(found, returns, metric, points, replace(threat, margin=cause))
    kinds = {ENDS[margin.loss]: None for margin in (cause, *others)}
    name, *also = kinds
    return replace(found, kind=name, place=cause.place, also=tuple(also))


def _located(
    returns: ReturnMap,
    metric: FamilyMetric,
    points: Sequence[BranchPoint],
    threat: VanishingMargin,
) -> Located:
    last, margin = points[-1], threat.margin
    if margin.loss is MarginKind.LOCK and returns.restitution(last.s, margin.place) > 0.0:
        return locate_cut(returns, metric, last, margin, threat.distance)
    return _approach(returns, metric, points[-2], last, margin)


def _better(
    found: Located,
    returns: ReturnMap,
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


def _limits(before: BranchPoint, last: BranchPoint, gone: Margin) -> dict[Margin, float]:
    """Return the margins at an end by linear extrapolation to the zero of one of them."""
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
    returns: ReturnMap, metric: FamilyMetric, before: BranchPoint, last: BranchPoint, margin: Margin
) -> Located:
    """Return the limit of a sequence of points along which a margin is halved repeatedly."""
    nodes, unit = [before, last], last.found.time
    patience, stalls = metric.horizon / unit, margin.loss is MarginKind.FREQUENCY
    best: tuple[float, Vector] | None = None
    for _ in range(_HALVINGS):
        metric = metric.waiting_for(nodes[-1].found.time, longer=patience)
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
        times = [0.0 if stalls else node.found.time / unit for node in used]
        rows = np.array([np.append(node.z, time) for node, time in zip(used, times, strict=True)])
        limit, change = neville(np.array(values), rows)
        error = float(np.max(change))
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
        period=math.inf if stalls else float(limit[-1]) * unit,
        error=error * metric.unit,
        margins=_limits(nodes[-2], nodes[-1], margin),
        place=margin.place,
        path=tuple(nodes[2:]),
    )


def _noise(
    returns: ReturnMap, metric: FamilyMetric, nodes: Sequence[BranchPoint], margin: Margin
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
    returns: ReturnMap, metric: FamilyMetric, nodes: Sequence[BranchPoint], margin: Margin
) -> BranchPoint:
    """Return a point at which a margin is about half its value at the last point."""
    used = nodes[-4:]
    values = np.array([node.found.margins[margin] for node in used])
    rows = np.array([node.z for node in used])
    part = 0.5
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
