r"""Special points followed in two parameters: folds, flips and ends of families as curves.

In the plane of both parameters, in units of their ranges, a curve is followed by secants. On a line
at right angles to the secant, through the predicted place, the special point is located anew as one
of a family along that line; so every point of the curve is located as well as a point of a family,
with its own error estimate, and a curve may run in any direction. Theory (40).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.corrector import BranchPoint, Metric, correct
from zeno_orbits.critical_curves import CRITICAL, follow_critical
from zeno_orbits.dynamics import Vector
from zeno_orbits.errors import SimulationError, ZenoOrbitsError
from zeno_orbits.families import Boundary, Kind
from zeno_orbits.family_ends import ENDS, Threat, locate_end
from zeno_orbits.lock_ends import locate_cut_near
from zeno_orbits.plane import CurveSteps, OnLine, Plane, Tell
from zeno_orbits.return_maps import Margin, ReturnMap
from zeno_orbits.sections import Line
from zeno_orbits.singular_points import INSIDE, Located, TestFunction, located_near


@dataclass(frozen=True, kw_only=True)
class _Spot:
    """A point of a boundary.

    Attributes:
        at: Its place in units of the ranges, ``(2,)``.
        located: The special point; its parameter counts along the line that it was found on.
        before: States and places of family points that lead to an end, relative to it.
    """

    at: Vector
    located: Located
    before: tuple[tuple[Vector, Vector], ...]


def follow_boundary(
    plane: Plane,
    on_line: OnLine,
    metric: Metric,
    found: Located,
    value: tuple[float, float],
    *,
    leading: tuple[BranchPoint, ...],
    place: int = 0,
    steps: CurveSteps,
    tell: Tell,
) -> Boundary:
    """Return the curve of a special point of a family.

    Args:
        plane: The two parameters; the family is followed in the first.
        on_line: From a line to the return map along it.
        metric: Units of the family.
        found: The special point.
        value: Both parameters there.
        leading: The last points of the family before an end.
        place: The return at which the end is, counted from 0.
        steps: How to step.
        tell: Called with what happens.
    """
    if found.kind in CRITICAL:
        return follow_critical(plane, on_line, metric, found, value, steps=steps, tell=tell)
    at = np.array(value) / plane.units
    scale = plane.units[0] / metric.unit

    def relative(point: BranchPoint) -> tuple[Vector, Vector]:
        state = (point.x - found.z[:-1] * metric.scale) / metric.scale
        away = (point.z[-1] - found.z[-1]) / scale
        return state, np.array([away, 0.0])

    first = _Spot(
        at=at,
        located=replace(found, z=np.append(found.z[:-1], 0.0), error=found.error / plane.units[0]),
        before=tuple(relative(point) for point in leading),
    )
    curve = _Curve(plane, on_line, replace(metric, unit=1.0), found.kind, place, steps, tell)
    upwards = np.array([0.0, 1.0])
    above, above_end = curve.run(first, upwards)
    below, below_end = curve.run(first, _away_from(first, above, -upwards))
    if below and not above:
        above, above_end = curve.run(first, _away_from(first, below, upwards))
    spots = [*reversed(below), first, *above]
    values = np.array([spot.at * plane.units for spot in spots])
    return Boundary(
        kind=found.kind,
        names=plane.names,
        x=tuple(values[:, 0].tolist()),
        y=tuple(values[:, 1].tolist()),
        errors=tuple(spot.located.error for spot in spots),
        ends=(below_end, above_end),
    )


def _away_from(first: _Spot, side: list[_Spot], otherwise: Vector) -> Vector:
    """Return the direction from a point that a curve took on the other side, turned round."""
    if not side:
        return otherwise
    gone = first.at - side[0].at
    return gone / np.linalg.norm(gone)


class _Curve:
    """A boundary in the making."""

    def __init__(
        self,
        plane: Plane,
        on_line: OnLine,
        metric: Metric,
        kind: Kind,
        place: int,
        steps: CurveSteps,
        tell: Tell,
    ) -> None:
        self.plane, self.on_line, self.metric, self.kind = plane, on_line, metric, kind
        self.steps, self.tell, self.place = steps, tell, place

    def run(self, first: _Spot, forward: Vector) -> tuple[list[_Spot], str]:
        """Return the curve from a point in one direction, and why it ends."""
        spots = [first]
        step, trouble = self.steps.first, ""
        while len(spots) <= self.steps.most:
            last = spots[-1]
            at = last.at + step * forward
            if not self.plane.holds(at):
                reach = self._to_edge(last.at, forward)
                if reach < self.steps.shortest or reach > step:
                    return spots[1:], Kind.BOUND.value
                at = last.at + reach * forward
            try:
                new = self._located(last, at, forward, spots)
            except ZenoOrbitsError as error:
                new, trouble = None, str(error)
            if new is not None and not self._fits(last, new, at, forward):
                new, trouble = None, "the curve bends too fast"
            if new is not None and not self.plane.holds(new.at):
                # The curve leaves the plane beside the place that was predicted.
                new, trouble = None, Kind.BOUND.value
            if new is None:
                step /= 2
                if step < self.steps.shortest:
                    given_up = trouble != Kind.BOUND.value
                    return spots[1:], f"{Kind.GAVE_UP.value}: {trouble}" if given_up else trouble
                continue
            strayed = float(np.linalg.norm(new.at - at))
            forward = (new.at - last.at) / np.linalg.norm(new.at - last.at)
            spots.append(new)
            values = new.at * self.plane.units
            self.tell(f"{self.kind.value} at {values[0]:.6g}, {values[1]:.6g}", None)
            if strayed < self.steps.bend * step / 3:
                step = min(1.5 * step, self.steps.longest)
        return spots[1:], f"{self.steps.most} steps"

    def _to_edge(self, at: Vector, forward: Vector) -> float:
        """Return how far it is to the edge of the plane."""
        bounds = self.plane.box / self.plane.units[:, None]
        reach = [
            ((high if slope > 0.0 else low) - value) / slope
            for value, slope, (low, high) in zip(at, forward, bounds, strict=True)
            if slope != 0.0
        ]
        return max(0.0, min(reach))

    def _fits(self, last: _Spot, new: _Spot, at: Vector, forward: Vector) -> bool:
        """Tell whether a point is a neighbour of the last one."""
        step = float(np.linalg.norm(at - last.at))
        near = float(np.linalg.norm(new.at - at)) < max(self.steps.bend * step, 2e-3)
        return near and float((new.at - last.at) @ forward) > 0.0

    def _located(self, last: _Spot, at: Vector, forward: Vector, spots: list[_Spot]) -> _Spot:
        """Return the special point on the line across the curve through a place."""
        across = np.array([forward[1], -forward[0]])
        line = self.plane.line(at, across)
        returns = self.on_line(line)
        z = last.located.z[:-1]
        if len(spots) > 1:
            earlier = spots[-2]
            gone = float(np.linalg.norm(last.at - earlier.at))
            ahead = float(np.linalg.norm(at - last.at))
            z = z + ahead / gone * (last.located.z[:-1] - earlier.located.z[:-1])
        if self.kind in INSIDE:
            located = self._inside(returns, np.append(z, 0.0))
            before = last.before
        else:
            located, before = self._end(returns, line, z, last, across)
        new_at = at + located.z[-1] * across
        return _Spot(at=new_at, located=located, before=before)

    def _inside(self, returns: ReturnMap, z: Vector) -> Located:
        normal = np.zeros(z.size)
        normal[-1] = 1.0
        start = correct(returns, self.metric, z, normal)
        test: TestFunction = INSIDE[self.kind]
        return located_near(returns, self.metric, start, self.kind, test)

    def _end(
        self, returns: ReturnMap, line: Line, z: Vector, last: _Spot, across: Vector
    ) -> tuple[Located, tuple[tuple[Vector, Vector], ...]]:
        """Return an end, approached as the last one was from points at the same distance."""

        def restitution(s: float) -> float:
            return float(line.at(s)[self.plane.restitution])

        if self.kind is Kind.LOCK_VANISHES and restitution(0.0) > 0.0:
            along = last.located.point.tangent
            found = locate_cut_near(
                returns, self.metric, np.append(z, 0.0), along, self.place, restitution
            )
            return found, last.before
        loss = next(loss for loss, kind in ENDS.items() if kind is self.kind)
        points: list[BranchPoint] = []
        for state, away in last.before:
            place = float(away @ across)
            if abs(place) < _SLANT * float(np.linalg.norm(away)):
                raise SimulationError("The line does not cross the end", time=0.0, state=())
            place *= float(away @ away) / place**2
            target = np.append(z + state, place)
            normal = np.append(-state, -place)
            points.append(correct(returns, self.metric, target, normal / np.linalg.norm(normal)))
        threat = Threat(margin=Margin(loss=loss, place=self.place), distance=np.inf, fall=1.0)
        located = locate_end(returns, self.metric, points, threat, restitution)
        before = tuple(
            (point.z[:-1] - located.z[:-1], (point.s - located.z[-1]) * across) for point in points
        )
        return located, before


_SLANT = 0.2
"""Least sine of the angle at which a line crosses the family that leads to an end."""
