r"""Curves of folds and flips in two parameters, by pseudo-arclength in the state and both.

A curve may turn back in either parameter. It may also turn back at a point where two folds meet.
There it has a cusp in the plane, but it is smooth in the space of the state and both parameters.
Theory (5.8).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.branch import require_continuous
from zeno_orbits.continuation.families import HalfCurve, SpecialPointKind
from zeno_orbits.continuation.margins import CLOSE, Stage, meeting
from zeno_orbits.continuation.two_parameters.fold_flip_point import FoldFlipPoint, FoldFlipSystem
from zeno_orbits.continuation.two_parameters.plane import CurveSetup, CurveStart
from zeno_orbits.errors import SimulationError, counted
from zeno_orbits.orbits import PathStep, StepControl, StepError, follow_path, returns_to_start

MULTIPLIERS = {SpecialPointKind.FOLD: 1.0, SpecialPointKind.FLIP: -1.0}
"""Multiplier of a fold and of a flip."""

_EASY = 0.4
"""Largest turn and stray of an easy step, relative to their limits."""
_FAR = 2.0
"""Largest distance of a neighbour, for instance on a bound, in steps."""
_SMOOTH = 5.0
"""Factor by which the gradient of the test function may change per step."""
_REACHED = 1e-6
"""Length of a failed step below which a margin vanishes within ten times this length."""
_FOUND = 1e-8
"""Accuracy of a cusp relative to the step. The error of the parameters is its square."""


def half_fold_flip(setup: CurveSetup, start: CurveStart, *, upwards: bool) -> HalfCurve:
    """Return the curve of a fold or a flip in one direction.

    Args:
        setup: The setup of the curve. Its unit of the parameter is one range.
        start: The fold or flip.
        upwards: True if the second parameter rises at first, False if it falls.

    Raises:
        ZenoOrbitsError: If the point is not on a curve, or its neighbours do not return.
    """
    found, steps = start.found, setup.steps
    system = FoldFlipSystem(setup=setup, multiplier=MULTIPLIERS[found.kind])
    along = np.zeros(found.z.size + 1)
    along[-1] = 1.0
    at = np.array(start.value) / setup.plane.units
    first = system.point_at(found.z[:-1] * setup.metric.scale, at, along)
    if not upwards:
        first = replace(first, tangent=-first.tangent)
    follower = _Follower(system, found.kind)
    path = follow_path(
        first,
        StepControl(
            first=steps.first, longest=steps.longest, shortest=steps.least_arc, most=steps.most_arcs
        ),
        follower.advance,
        shortened=follower.end_ahead,
        give_up=follower.last_end,
    )
    values = np.array([point.at * setup.plane.units for point in path.points])
    return HalfCurve(
        x=tuple(values[:, 0].tolist()),
        y=tuple(values[:, 1].tolist()),
        errors=tuple(point.error for point in path.points),
        end=path.end or counted(steps.most_arcs, "step"),
        cusps=tuple(follower.cusps),
    )


class _Follower:
    """The steps along a curve, and the cusps passed so far."""

    def __init__(self, system: FoldFlipSystem, kind: SpecialPointKind) -> None:
        self.system, self.setup, self.kind = system, system.setup, kind
        self.steps, self.cusps = system.setup.steps, list[int]()

    def advance(self, points: Sequence[FoldFlipPoint], step: float) -> PathStep[FoldFlipPoint, str]:
        """Return the next point, with the cusp before it if there is a cusp."""
        last = points[-1]
        new, at_bound = self._predicted(last, step)
        if new is None:
            return PathStep(end=SpecialPointKind.BOUND.value)
        self._require_neighbour(last, new, step)
        cusp = self._cusp_between(last, new)
        if cusp is not None:
            self.cusps.append(len(points))
            self.setup.report("cusp", cusp.at)
        self.setup.report(self.kind.value, new.at)
        passed = () if cusp is None else (cusp,)
        if at_bound:
            return PathStep(points=(*passed, new), end=SpecialPointKind.BOUND.value)
        if returns_to_start((*points, *passed, new), self.steps.bend, self.steps.turn):
            return PathStep(points=(*passed, points[0]), end=SpecialPointKind.CLOSED.value)
        return PathStep(points=(*passed, new), easy=self._effort(last, new) < _EASY)

    def end_ahead(
        self, points: Sequence[FoldFlipPoint], step: float
    ) -> PathStep[FoldFlipPoint, str]:
        """Return the end if the steps became short and another margin vanishes nearby."""
        if step < _REACHED:
            return PathStep(end=self._meeting(points, 10 * _REACHED) or None)
        return PathStep()

    def last_end(
        self, points: Sequence[FoldFlipPoint], trouble: str
    ) -> PathStep[FoldFlipPoint, str]:
        """Return the end at a point from which every step fails."""
        return PathStep(end=self._meeting(points) or f"{SpecialPointKind.GAVE_UP.value}: {trouble}")

    def _predicted(self, last: FoldFlipPoint, step: float) -> tuple[FoldFlipPoint | None, bool]:
        """Return the next point, and True if it is on a bound.

        The point is ``None`` if the last point is already on a bound.
        """
        plane = self.setup.plane
        z = last.z + step * last.tangent
        if plane.holds(z[-2:]):
            new = self._corrected(last, z, last.tangent)
            if plane.holds(new.at):
                return new, False
            z = new.z
        bounds = plane.box / plane.units[:, None]
        reach: list[tuple[float, int]] = []
        for k, (low, high) in enumerate(bounds):
            went = z[k - 2] - last.z[k - 2]
            bound = high if went > 0.0 else low
            if (z[k - 2] - bound) * went > 0.0:
                reach.append(((bound - last.z[k - 2]) / went, k))
        part, k = min(reach)
        if part * step < self.steps.least_arc:
            return None, True
        normal = np.zeros(z.size)
        normal[k - 2] = 1.0
        new = self._corrected(last, last.z + part * (z - last.z), normal)
        if not plane.holds(new.at):
            raise SimulationError("The curve leaves the ranges at a corner", time=0.0, state=())
        return new, True

    def _corrected(self, last: FoldFlipPoint, z: Vector, normal: Vector) -> FoldFlipPoint:
        return self.system.corrected(z, normal, last.gradient, last.tangent)

    def _require_neighbour(self, last: FoldFlipPoint, new: FoldFlipPoint, step: float) -> None:
        """Reject a point that is not a neighbour of the last point."""
        steps = self.steps
        if not 0.0 < float((new.z - last.z) @ last.tangent) < _FAR * step:
            raise StepError("the steps lead to another point")
        if float(new.tangent @ last.tangent) < np.cos(steps.turn):
            raise StepError("the curve turns too fast")
        if self.kind is SpecialPointKind.FOLD and abs(float(new.normal @ last.normal)) < np.cos(
            steps.turn
        ):
            raise StepError("the curve turns too fast in the plane")
        if _stray(last, new) > steps.bend:
            raise StepError("the curve bends too fast")
        growth = float(np.linalg.norm(new.gradient) / np.linalg.norm(last.gradient))
        if not 1 / _SMOOTH < growth < _SMOOTH:
            raise StepError("the test function is not smooth")
        require_continuous(last.found, new.found)

    def _effort(self, last: FoldFlipPoint, new: FoldFlipPoint) -> float:
        """Return the larger of the turn and the stray of a step, relative to its limit."""
        angles = [float(new.tangent @ last.tangent)]
        if self.kind is SpecialPointKind.FOLD:
            angles.append(abs(float(new.normal @ last.normal)))
        turn = max(float(np.arccos(min(1.0, angle))) for angle in angles) / self.steps.turn
        return max(turn, _stray(last, new) / self.steps.bend)

    def _cusp_between(self, last: FoldFlipPoint, new: FoldFlipPoint) -> FoldFlipPoint | None:
        """Return the cusp between two neighbours, or ``None``.

        The parameters move at right angles to the normal. At a point where two folds meet, they are
        stationary along the curve.
        """
        from scipy.optimize import brentq

        if self.kind is not SpecialPointKind.FOLD or _speed(last, last) * _speed(new, last) >= 0.0:
            return None
        known = {0.0: last, 1.0: new}

        def speed_at(part: float) -> float:
            if part not in known:
                z = last.z + part * (new.z - last.z)
                known[part] = self._corrected(last, z, new.z - last.z)
            return _speed(known[part], last)

        root = float(brentq(speed_at, 0.0, 1.0, xtol=_FOUND))
        return min(known.items(), key=lambda item: abs(item[0] - root))[1]

    def _meeting(self, points: Sequence[FoldFlipPoint], within: float = CLOSE) -> str:
        """Return a description of a margin that vanishes near the last point, or an empty text."""
        way = [Stage(z=point.z, margins=point.found.margins) for point in points]
        return meeting(way, partial(self.setup.restitution_at, points[-1].at), within)


def _stray(last: FoldFlipPoint, new: FoldFlipPoint) -> float:
    """Return the distance of two points from each other's tangents, relative to their distance."""
    step = new.z - last.z
    length = float(np.linalg.norm(step)) or 1.0
    return max(
        float(np.linalg.norm(step - (step @ tangent) * tangent)) / length
        for tangent in (last.tangent, new.tangent)
    )


def _speed(point: FoldFlipPoint, other: FoldFlipPoint) -> float:
    """Return the speed of the parameters along a curve, signed by the normal of a neighbour.

    Args:
        point: The point of the curve.
        other: The neighbour.
    """
    sense = 1.0 if float(point.normal @ other.normal) > 0.0 else -1.0
    return sense * float(point.normal[0] * point.tangent[-1] - point.normal[1] * point.tangent[-2])
