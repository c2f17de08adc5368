"""Curves of special points by secants in the plane of two parameters.

For each step, the line through the predicted point normal to the secant is taken. The special point
of the family along that line is the next point of the curve. Theory (5.8), (5.10).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.corrector import BranchPoint, correct
from zeno_orbits.continuation.ends import locate_end
from zeno_orbits.continuation.families import SpecialPointKind
from zeno_orbits.continuation.lock_end import locate_cut_near
from zeno_orbits.continuation.margins import ENDS, Stage, VanishingMargin, meeting
from zeno_orbits.continuation.return_maps import FamilyMap
from zeno_orbits.continuation.special_points.special_points import (
    INSIDE,
    Located,
    TestFunction,
    located_near,
)
from zeno_orbits.continuation.two_parameters.plane import CurveSetup
from zeno_orbits.errors import SimulationError, ZenoOrbitsError, counted
from zeno_orbits.orbits import Margin, MarginKind, PathStep, StepError, follow_path


@dataclass(frozen=True, kw_only=True)
class SpecialCurvePoint:
    """A point of a boundary.

    Attributes:
        at: Both parameters in units of the ranges, ``(2,)``.
        located: The special point. Its parameter is the position on the line of its family.
        before: Points of the family that lead to an end.
    """

    at: Vector
    located: Located
    before: tuple[ApproachPoint, ...]

    @property
    def amplitude(self) -> float:
        """Largest range of a state. NaN if it is unknown, so that every comparison is false."""
        margins = self.located.margins.items()
        return next(
            (value for margin, value in margins if margin.loss is MarginKind.AMPLITUDE), np.nan
        )


@dataclass(frozen=True, kw_only=True)
class ApproachPoint:
    """A point of a family that leads to an end, relative to it.

    Attributes:
        state: Scaled state relative to the end, ``(n_x,)``.
        away: Both parameters relative to the end, ``(2,)``.
        left: Value at the point of the margin that vanishes at the end.
    """

    state: Vector
    away: Vector
    left: float


class SecantCurve:
    """Follow a curve by secants."""

    def __init__(self, setup: CurveSetup, kind: SpecialPointKind, cause: Margin | None) -> None:
        self.setup, self.kind, self.cause = setup, kind, cause
        self.plane, self.metric, self.steps = setup.plane, setup.metric, setup.steps
        # Direction of the curve, and the change of the scaled state per unit along it.
        self.forward, self.slope = np.zeros(2), np.zeros(setup.metric.scale.size)

    def run(
        self, first: SpecialCurvePoint, *, upwards: bool
    ) -> tuple[Sequence[SpecialCurvePoint], str]:
        """Return the curve from a point in one direction, and the reason of its end."""
        try:
            heading, slope = self._heading(first)
        except ZenoOrbitsError as error:
            return [first], f"{SpecialPointKind.GAVE_UP.value}: {error}"
        self.forward, self.slope = (heading, slope) if upwards else (-heading, -slope)
        path = follow_path(first, self.steps, self._advance, give_up=self._last_end)
        return path.points, path.end or counted(round(self.steps.most), "step")

    def _heading(self, first: SpecialCurvePoint) -> tuple[Vector, Vector]:
        """Return the direction of the curve at its first point, upwards, and its slope.

        A line across a guessed direction intersects the curve at another point. The chord to that
        point gives the direction.

        Raises:
            SimulationError: If no guess leads to another point of the curve.
        """
        step, trouble = self.steps.first, ""
        while step >= self.steps.shortest:
            for guess in _GUESSES:
                at = first.at + step * guess
                try:
                    new = self._located(first, at, guess)
                except ZenoOrbitsError as error:
                    trouble = str(error)
                    continue
                if float(np.linalg.norm(new.at - at)) <= step:
                    way, slope = _chord(first, new)
                    return (way, slope) if way[1] >= 0.0 else (-way, -slope)
                trouble = "the curve bends too fast"
            step /= 8
        raise SimulationError(trouble, time=0.0, state=())

    def _advance(
        self, spots: Sequence[SpecialCurvePoint], step: float
    ) -> PathStep[SpecialCurvePoint, str]:
        """Return the next point on the line across the curve a step ahead."""
        last, forward = spots[-1], self.forward
        at = last.at + step * forward
        if not self.plane.holds(at):
            reach = self._to_edge(last.at, forward)
            if reach < self.steps.shortest or reach > step:
                return PathStep(end=SpecialPointKind.BOUND.value)
            at = last.at + reach * forward
        new = self._located(last, at, forward)
        strayed = float(np.linalg.norm(new.at - at))
        if not self._fits(last, new, at, forward):
            if strayed < step:
                # A chord is less accurate at its end than the direction that was just found.
                self.forward, self.slope = _chord(last, new)
            raise StepError("the curve bends too fast")
        before = last.located.period
        # At ends to which the period tends to infinity, all periods are infinite.
        if np.isfinite(before) and not 1 / _LIKE < new.located.period / before < _LIKE:
            raise StepError("the period jumps")
        if new.amplitude < last.amplitude / _LIKE:
            raise StepError("the orbit collapses")
        if not self.plane.holds(new.at):
            # The curve leaves the plane next to the predicted point.
            raise StepError(SpecialPointKind.BOUND.value)
        self.forward, self.slope = _chord(last, new)
        self.setup.report(self.kind.value, new.at)
        return PathStep(points=(new,), easy=strayed < self.steps.bend * step / 3)

    def _last_end(
        self, spots: Sequence[SpecialCurvePoint], trouble: str
    ) -> PathStep[SpecialCurvePoint, str]:
        """Return the end at a point from which every step fails."""
        if trouble == SpecialPointKind.BOUND.value:
            return PathStep(end=trouble)
        way = [Stage(z=spot.at, margins=self._others(spot)) for spot in spots]
        met = meeting(way, partial(self.setup.restitution_at, spots[-1].at))
        return PathStep(end=met or f"{SpecialPointKind.GAVE_UP.value}: {trouble}")

    def _others(self, spot: SpecialCurvePoint) -> dict[Margin, float]:
        """Return the margins at a point that do not vanish on the curve."""
        margins = spot.located.margins.items()
        return {margin: value for margin, value in margins if ENDS.get(margin.loss) != self.kind}

    def _to_edge(self, at: Vector, forward: Vector) -> float:
        """Return the distance to the edge of the plane."""
        bounds = self.plane.box / self.plane.units[:, None]
        reach = [
            ((high if slope > 0.0 else low) - value) / slope
            for value, slope, (low, high) in zip(at, forward, bounds, strict=True)
            if slope != 0.0
        ]
        return max(0.0, min(reach))

    def _fits(
        self, last: SpecialCurvePoint, new: SpecialCurvePoint, at: Vector, forward: Vector
    ) -> bool:
        """Return True if a point is a neighbour of the last point."""
        step = float(np.linalg.norm(at - last.at))
        near = float(np.linalg.norm(new.at - at)) < self.steps.bend * step
        return near and float((new.at - last.at) @ forward) > 0.0

    def _located(self, last: SpecialCurvePoint, at: Vector, forward: Vector) -> SpecialCurvePoint:
        """Return the special point on the line across the curve through a point of the plane."""
        across = np.array([forward[1], -forward[0]])
        returns = self.setup.returns_on(at, across)
        z = last.located.z[:-1] + float(np.linalg.norm(at - last.at)) * self.slope
        if self.cause is None:
            located = self._inside(returns, np.append(z, 0.0))
            before = last.before
        else:
            located, before = self._end(returns, z, last, across, self.cause)
        if located.kind is not self.kind:
            raise SimulationError("The end has another cause", time=0.0, state=())
        if not located.error < _CERTAIN:
            raise SimulationError("The end is not certain", time=0.0, state=())
        new_at = at + located.z[-1] * across
        return SpecialCurvePoint(at=new_at, located=located, before=before)

    def _inside(self, returns: FamilyMap, z: Vector) -> Located:
        normal = np.zeros(z.size)
        normal[-1] = 1.0
        start = correct(returns, self.metric, z, normal)
        test: TestFunction = INSIDE[self.kind]
        return located_near(returns, self.metric, start, self.kind, test)

    def _end(
        self,
        returns: FamilyMap,
        z: Vector,
        last: SpecialCurvePoint,
        across: Vector,
        cause: Margin,
    ) -> tuple[Located, tuple[ApproachPoint, ...]]:
        """Return an end, approached from points at the same distances as the last end."""
        if cause.loss is MarginKind.LOCK and returns.restitution(0.0, cause.place) > 0.0:
            along = last.located.point.tangent
            found = locate_cut_near(returns, self.metric, np.append(z, 0.0), along, cause)
            return found, last.before
        points = [self._ahead(returns, z, one, across) for one in last.before]
        threat = VanishingMargin(margin=cause, distance=np.inf, fall=1.0)
        located = locate_end(returns, self.metric, points, threat)
        before = tuple(
            ApproachPoint(
                state=point.z[:-1] - located.z[:-1],
                away=(point.s - located.z[-1]) * across,
                left=left_of(point, cause),
            )
            for point in points
        )
        return located, before

    def _ahead(
        self, returns: FamilyMap, z: Vector, before: ApproachPoint, across: Vector
    ) -> BranchPoint:
        """Return the point before an end that corresponds to a point before the last end."""
        place = float(before.away @ across)
        if abs(place) < _SLANT * float(np.linalg.norm(before.away)):
            raise SimulationError("The line does not cross the end", time=0.0, state=())
        # The line crosses the curve elsewhere than the line of the last end.
        state = before.state - float(before.away @ self.forward) * self.slope
        target, normal = np.append(z + state, place), np.append(-state, -place)
        point = correct(returns, self.metric, target, normal / np.linalg.norm(normal))
        left = left_of(point, self.cause)
        # Two families may be so close at an end that Newton's method jumps to the other family.
        if not 1 / _LIKE < left / before.left < _LIKE:
            raise SimulationError(
                "The point before the end belongs to another family", time=0.0, state=()
            )
        return point


def _chord(last: SpecialCurvePoint, new: SpecialCurvePoint) -> tuple[Vector, Vector]:
    """Return the direction of the chord between two points, ``(2,)``, and its slope, ``(n_x,)``."""
    chord = new.at - last.at
    length = float(np.linalg.norm(chord))
    return chord / length, (new.located.z[:-1] - last.located.z[:-1]) / length


def left_of(point: BranchPoint, cause: Margin | None) -> float:
    """Return the value, at a point of a family, of the margin that vanishes at an end.

    Args:
        point: The point.
        cause: The margin. ``None`` inside a family.
    """
    return np.nan if cause is None else point.found.margins.get(cause, np.nan)


_LIKE = 1.4
"""Factor by which the period and the margins before an end may change per step of a curve."""
_UP, _ACROSS = np.array([0.0, 1.0]), np.array([1.0, 0.0])
_GUESSES = (_UP, -_UP, _ACROSS, -_ACROSS)
"""Directions in which a curve is searched. Any direction is within 45 degrees of one of them."""
_CERTAIN = 1e-6
"""Largest estimated error of a point, relative to the range."""
_SLANT = 0.2
"""Least sine of the angle at which a line crosses the family that leads to an end."""
