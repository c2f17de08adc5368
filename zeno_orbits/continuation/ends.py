r"""Ends of a family: the limit at which one of its margins vanishes.

At an end the family exists on one side only. It is approached in a variable in which it is smooth
up to the end, and the last stretch is extrapolated. Theory (39) and (40).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.corrector import BranchPoint, FamilyMetric, correct, corrected_again
from zeno_orbits.continuation.lock_end import locate_cut
from zeno_orbits.continuation.margins import ENDS, Threat, causes, stages
from zeno_orbits.continuation.return_maps import Loss, Margin, ReturnMap
from zeno_orbits.continuation.special_points import Located
from zeno_orbits.errors import SimulationError, ZenoOrbitsError


def locate_end(
    returns: ReturnMap,
    metric: FamilyMetric,
    points: Sequence[BranchPoint],
    threat: Threat,
) -> Located:
    """Return the end of a family at which a margin is zero, by the name of what causes it.

    Args:
        returns: The return map.
        metric: Units.
        points: Points in order, the last one near the end.
        threat: The margin that vanishes.

    Raises:
        ZenoOrbitsError: If it cannot be closed in on.
    """
    found = _located(returns, metric, points, threat)
    if not found.path:
        return found
    cause, *others = causes(stages([*points[-2:], *found.path]), threat.margin)
    if cause.loss is Loss.ACCELERATION and returns.restitution(found.point.s) > 0.0:
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
    threat: Threat,
) -> Located:
    if threat.margin.loss is Loss.LOCK and returns.restitution(points[-1].s) > 0.0:
        last, margin = points[-1], threat.margin
        return locate_cut(returns, metric, last, margin, threat.distance)
    return _approach(returns, metric, points[-2], points[-1], threat.margin)


def _better(
    found: Located,
    returns: ReturnMap,
    metric: FamilyMetric,
    points: Sequence[BranchPoint],
    cause: Threat,
) -> Located:
    """Return an end as its cause leads to it, if that tells better where it is."""
    try:
        other = _located(returns, metric, points, cause)
    except ZenoOrbitsError:
        return found
    return other if other.error < found.error else found


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
    returns: ReturnMap, metric: FamilyMetric, before: BranchPoint, last: BranchPoint, margin: Margin
) -> Located:
    """Return the limit of points at which a margin is halved again and again."""
    nodes, unit = [before, last], last.found.time
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
        rows = np.array([np.append(node.z, node.found.time / unit) for node in used])
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
        period=float(limit[-1]) * unit,
        error=error * metric.unit,
        margins=_limits(nodes[-2], nodes[-1], margin),
        place=margin.place,
        path=tuple(nodes[2:]),
    )


def _noise(
    returns: ReturnMap, metric: FamilyMetric, nodes: Sequence[BranchPoint], margin: Margin
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
    returns: ReturnMap, metric: FamilyMetric, nodes: Sequence[BranchPoint], margin: Margin
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
