r"""Where a family ends: what runs out, and the limit at which it has.

At an end the family exists on one side only. It is approached in a variable in which it is smooth
up to the end, and the last stretch is extrapolated. Theory (39) and (40).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.corrector import BranchPoint, Metric, correct, corrected_again
from zeno_orbits.dynamics import Vector
from zeno_orbits.errors import SimulationError, ZenoOrbitsError
from zeno_orbits.families import Kind
from zeno_orbits.lock_ends import locate_cut
from zeno_orbits.return_maps import Loss, Margin, ReturnMap
from zeno_orbits.separatrix import separatrix
from zeno_orbits.singular_points import Located

ENDS = {
    Loss.AMPLITUDE: Kind.AMPLITUDE_ZERO,
    Loss.LOCK: Kind.LOCK_VANISHES,
    Loss.ACCELERATION: Kind.THEOREM_LOST,
    Loss.FIRST_IMPACT: Kind.GRAZING,
    Loss.NEAR_MISS: Kind.EARLIER_GRAZING,
    Loss.LATER_IMPACT: Kind.LATER_GRAZING,
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


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A place on the way to a loss.

    Attributes:
        z: Where, in any metric.
        margins: What is left there.
    """

    z: Vector
    margins: Mapping[Margin, float]


def stages(points: Sequence[BranchPoint]) -> list[Stage]:
    """Return points of a family as stages on the way to its end."""
    return [Stage(z=point.z, margins=point.found.margins) for point in points]


def threats(way: Sequence[Stage], restitution: float) -> list[Threat]:
    """Return the margins that run out beyond the last stage, the nearest first.

    Args:
        way: Neighbours in order, at least two.
        restitution: At the last one.
    """
    before, last = way[-2], way[-1]
    step = float(np.linalg.norm(last.z - before.z))
    found: dict[Margin, Threat] = {}
    for margin, value in last.margins.items():
        earlier = before.margins.get(margin)
        if earlier is None or step == 0.0 or margin.loss is Loss.CUT:
            continue
        largest = max(stage.margins.get(margin, 0.0) for stage in way)
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


CLOSE = 0.02
"""Distance along a curve, in the ranges, at which what runs out is where it ends."""


def meeting(way: Sequence[Stage], restitution: float, within: float = CLOSE) -> str:
    """Return in words what else is lost where a curve of special points ends.

    Two things happen there at once, a point of codimension two. Nothing is said if no margin runs
    out near.

    Args:
        way: Points of the curve in order.
        restitution: At the last one.
        within: How far ahead a loss may be.
    """
    found: list[Threat] = []
    for margin, value in way[-1].margins.items():
        # A margin may waver on its last steps: what counts is whence it fell to what is left.
        whence = [
            k for k, stage in enumerate(way) if stage.margins.get(margin, 0.0) > _FALL * value
        ]
        if whence and value == 0.0:
            last = float(np.linalg.norm(way[-1].z - way[whence[-1]].z))
            found.append(Threat(margin=margin, distance=last, fall=np.inf))
        elif whence:
            fallen = threats((*way[: whence[-1] + 1], way[-1]), restitution)
            found += [threat for threat in fallen if threat.margin == margin]
    for threat in sorted(found, key=lambda threat: threat.distance):
        if threat.distance < within:
            word = ENDS[threat.margin.loss].value
            return f"meets: {word}, within {threat.distance:.0e} of the ranges"
    return ""


_FALL = 1.5
"""Fall of a margin that tells how far its end is."""


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
        last, margin = points[-1], threat.margin
        return locate_cut(returns, metric, last, margin, threat.distance, restitution)
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
