r"""A family followed from a point in one direction by pseudo-arclength steps, and its ending.

A step is accepted only if both of its points are neighbours. The tangents make a small angle, the
new point is near the old tangent, and the old point is near the new tangent. Any other step is
halved, and so is a step at which Newton's method fails. So the continuation cannot jump to another
family nearby, unless the other family runs along it within a tenth of the shortest step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.corrector import BranchPoint, FamilyMetric, correct
from zeno_orbits.continuation.ends import locate_end
from zeno_orbits.continuation.families import SpecialPointKind
from zeno_orbits.continuation.margins import VanishingMargin, stages, threats
from zeno_orbits.continuation.return_maps import DifferentiatedReturn, FamilyMap
from zeno_orbits.continuation.special_points.special_points import Located, arclength
from zeno_orbits.continuation.special_points.subdivision import (
    Subdivision,
    counted_zeros,
    signs_kept_to,
    subdivided,
)
from zeno_orbits.continuation.special_points.test_functions import with_course
from zeno_orbits.errors import ZenoOrbitsError, counted
from zeno_orbits.orbits import (
    Margin,
    MarginKind,
    PathStep,
    StepControl,
    StepError,
    follow_path,
    returns_to_start,
)
from zeno_orbits.work import Progress


@dataclass(frozen=True, slots=True, kw_only=True)
class FamilySteps(StepControl):
    """Steps along a family, in scaled arclength: the parameter's whole range is one.

    Attributes:
        turn: Largest angle between neighbouring tangents [rad].
        stray: Largest distance of a point from its neighbour's tangent, relative to the step.
    """

    first: float = 0.01
    longest: float = 0.04
    shortest: float = 1e-6
    most: float = 300
    turn: float = 0.2
    stray: float = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Branch:
    """A family in one direction.

    Attributes:
        points: Points in order. The first is the given start.
        special: Special points, each with the index of the point before it.
        ending: Reason of the end.
        end: The located end, or ``None``.
        detail: More about the end.
        doubt: Distance, in units of the parameter's range, below which two special points of one
            kind may have been missed.
    """

    points: tuple[BranchPoint, ...]
    special: tuple[tuple[int, Located], ...]
    ending: SpecialPointKind
    end: Located | None = None
    detail: str = ""
    doubt: float = 0.0


_EASY = 0.4
"""Largest turn and stray of an easy step, relative to their limits."""
_FAR = 4.0
"""Distance in steps within which an end is searched after a step has failed."""
_SOON = 1.0
"""Distance in steps within which an end is searched before each step."""


def follow_branch(
    returns: FamilyMap,
    metric: FamilyMetric,
    start: BranchPoint,
    box: tuple[float, float],
    steps: FamilySteps,
    *,
    on_progress: Progress,
    excluded: Callable[[BranchPoint], bool] | None = None,
) -> Branch:
    """Return the family from a point along its tangent.

    Args:
        returns: The return map.
        metric: Units.
        start: The first point. The family is followed in the direction of its tangent.
        box: Range of the parameter.
        steps: Limits of the steps.
        on_progress: Called with each point.
        excluded: Returns True for a point of another family: an orbit of lower period.
    """
    patience = metric.horizon / start.found.time
    follower = _Follower(returns, metric, patience, box, steps, on_progress, excluded)
    path = follow_path(
        with_course(returns, metric, start, -steps.first),
        steps,
        follower.advance,
        shortened=follower.end_ahead,
        give_up=follower.last_end,
    )
    end = path.end or _End(
        kind=SpecialPointKind.MOST_STEPS, detail=counted(round(steps.most), "step")
    )
    return Branch(
        points=path.points,
        special=tuple(follower.special),
        ending=end.kind,
        end=end.located,
        detail=end.detail,
        doubt=follower.doubt,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _End:
    """The end of a family and its reason."""

    kind: SpecialPointKind
    located: Located | None = None
    detail: str = ""


class _Follower:
    """The steps along a family, and the special points passed so far."""

    def __init__(
        self,
        returns: FamilyMap,
        metric: FamilyMetric,
        patience: float,
        box: tuple[float, float],
        steps: FamilySteps,
        on_progress: Progress,
        excluded: Callable[[BranchPoint], bool] | None,
    ) -> None:
        self.returns, self.metric, self.box, self.steps = returns, metric, box, steps
        self.patience, self.on_progress, self.excluded = patience, on_progress, excluded
        self.special: list[tuple[int, Located]] = []
        self.tried: dict[Margin, float] = {}
        self.doubt = 0.0

    def advance(self, points: Sequence[BranchPoint], step: float) -> PathStep[BranchPoint, _End]:
        """Return the next point, or the end if it is near."""
        last = points[-1]
        # The period may grow without bound along a family.
        self.metric = self.metric.waiting_for(last.found.time, longer=self.patience)
        self.on_progress(f"{counted(len(points), 'orbit')}, at {last.s:.6g}", None)
        ended = self._end_within(points, _SOON * step)
        if ended is not None:
            return ended
        new, at_bound = self._corrected(points, step)
        if not at_bound:
            self._require_neighbour(last, new, step)
        taken = self._between(last, new, points[-2] if len(points) > 1 else None)
        self._pass(len(points), taken)
        if at_bound:
            return PathStep(points=taken.points, end=_End(kind=SpecialPointKind.BOUND))
        if returns_to_start((*points, *taken.points), self.steps.stray, self.steps.turn):
            return PathStep(points=taken.points, end=_End(kind=SpecialPointKind.CLOSED))
        easy = len(taken.points) == 1 and self._effort(last, new, step) < _EASY
        return PathStep(points=taken.points, easy=easy)

    def end_ahead(self, points: Sequence[BranchPoint], step: float) -> PathStep[BranchPoint, _End]:
        """Return the end if it is near and the steps have become short."""
        if step < self.steps.first / 8:
            return self._end_within(points, _FAR * 8 * step) or PathStep()
        return PathStep()

    def last_end(self, points: Sequence[BranchPoint], trouble: str) -> PathStep[BranchPoint, _End]:
        """Return the end at a point from which every step fails."""
        self.tried.clear()
        ended = self._end_within(points, np.inf, surely=False)
        if ended is not None:
            return ended
        nearest = min((abs(1 - mu) for mu in points[-1].multipliers), default=1.0)
        if trouble == _LOWER and nearest < _REJOINS:
            return PathStep(
                end=_End(kind=SpecialPointKind.REJOINS, detail="at the flip that is nearest")
            )
        return PathStep(end=_End(kind=SpecialPointKind.GAVE_UP, detail=trouble))

    def _corrected(self, points: Sequence[BranchPoint], step: float) -> tuple[BranchPoint, bool]:
        """Return the next point, and True if it lies on the bound of the parameter."""
        low, high = self.box
        last = points[-1]
        s = (last.z + step * last.tangent)[-1] * self.metric.unit
        if low <= s <= high:
            z = predicted(points, step, self.steps.stray)
            new = correct(self.returns, self.metric, z, last.tangent)
            if low <= new.s <= high:
                return new, False
        bound = low if last.tangent[-1] < 0.0 else high
        part = (bound / self.metric.unit - last.z[-1]) / last.tangent[-1]
        normal = np.zeros(last.z.size)
        normal[-1] = 1.0
        z = predicted(points, part, self.steps.stray)
        z[-1] = bound / self.metric.unit
        return correct(self.returns, self.metric, z, last.tangent, fixed=normal), True

    def _require_neighbour(self, last: BranchPoint, new: BranchPoint, step: float) -> None:
        """Reject a point that is not a neighbour of the last point."""
        if self.excluded is not None and self.excluded(new):
            raise StepError(_LOWER)
        if float(new.tangent @ last.tangent) < np.cos(self.steps.turn):
            raise StepError("the tangent turns too fast")
        ahead = np.linalg.norm(new.z - last.z - step * last.tangent)
        behind = np.linalg.norm(new.z - last.z - step * new.tangent)
        if max(ahead, behind) > self.steps.stray * step:
            raise StepError("the points do not lie along the tangents")
        require_continuous(last.found, new.found)
        if not new.jacobian.size:
            self._require_smooth(last, new)

    def _require_smooth(self, last: BranchPoint, new: BranchPoint) -> None:
        """Reject a step along which the motion jumps, though it returns to the same point.

        If the section is a single point, every motion returns to it. Two motions are neighbours if
        the contact duration halfway is near the mean of the durations at both ends.
        """
        halfway = correct(self.returns, self.metric, (last.z + new.z) / 2, last.tangent)
        ends = (last.found, new.found)
        for one in ends:
            require_continuous(one, halfway.found)
        for margin, value in halfway.found.margins.items():
            if margin.loss is MarginKind.LOCK:
                first, second = (one.margins[margin] for one in ends)
                allowed = self.steps.stray * max(first, second)
                if abs(value - (first + second) / 2) > allowed:
                    raise StepError("the contact duration jumps")

    def _effort(self, last: BranchPoint, new: BranchPoint, step: float) -> float:
        """Return the larger of the turn and the stray of a step, relative to its limit."""
        angle = np.arccos(min(1.0, float(last.tangent @ new.tangent)))
        ahead = np.linalg.norm(new.z - last.z - step * last.tangent)
        return max(float(angle) / self.steps.turn, float(ahead) / (self.steps.stray * step))

    def _between(
        self, before: BranchPoint, after: BranchPoint, third: BranchPoint | None
    ) -> Subdivision:
        """Return the points of the family up to a neighbour, and the special points among them.

        Raises:
            ZenoOrbitsError: If a special point cannot be located. The step must then be shorter.
        """
        step = float(np.linalg.norm(after.z - before.z))
        return subdivided(
            self.returns,
            self.metric,
            before,
            with_course(self.returns, self.metric, after, step),
            third,
            shortest=LEAST_DOUBT,
        )

    def _pass(self, n_points: int, taken: Subdivision) -> None:
        """Keep the special points of a step after the last point of the family."""
        self.doubt = max(self.doubt, taken.doubt)
        for shift, located in taken.special:
            self.on_progress(
                f"{located.kind.value} at {located.z[-1] * self.metric.unit:.6g}", None
            )
            self.special.append((n_points - 1 + shift, located))

    def _end_within(
        self, points: Sequence[BranchPoint], distance: float, *, surely: bool = True
    ) -> PathStep[BranchPoint, _End] | None:
        """Return the step to the end if an end is near and can be located, else ``None``.

        Args:
            points: All points so far.
            distance: Largest predicted distance of the end.
            surely: True if special points between the last point and the end must be excluded.
        """
        if len(points) < 2:
            return None
        for threat in self._threats(points):
            if threat.distance > distance:
                continue
            key = threat.margin
            if threat.distance > 0.5 * self.tried.get(key, np.inf):
                continue
            self.tried[key] = threat.distance
            end = self._located(points, threat)
            if end is None:
                continue
            try:
                way = self._way_to(end, points, surely)
            except ZenoOrbitsError:
                # Special points before an end have to be passed step by step.
                continue
            passed: list[BranchPoint] = []
            for taken in way:
                self._pass(len(points) + len(passed), taken)
                passed += taken.points
            last = passed[-1] if passed else end.point
            if not (surely if not passed else signs_kept_to((*points, *passed)[-_NODES:], end.z)):
                stretch = end.z[-1] - (*points, *passed)[-1].z[-1]
                self.doubt = max(self.doubt, float(abs(stretch)))
            own = (_AMPLIFIED if passed else 1.0) * last.multiplier_error
            end = replace(end, point=last, multiplier_error=end.multiplier_error + own)
            return PathStep(points=tuple(passed), end=_End(kind=end.kind, located=end))
        return None

    def _way_to(
        self, end: Located, points: Sequence[BranchPoint], surely: bool
    ) -> list[Subdivision]:
        """Return the steps from the last point to an end.

        Raises:
            ZenoOrbitsError: If special points may lie before an end without points on the way.
        """
        third, before = points[-2:]
        if not end.path:
            counts = counted_zeros(before, end.point, third) if before.jacobian.size else ()
            if surely and any(count.crosses or count.split is not None for count in counts):
                raise StepError("special points may lie before the end")
            return []
        way = list[Subdivision]()
        for node in end.path:
            way.append(self._between(before, node, third))
            third, before = before, node
            before = way[-1].points[-1]
        return way

    def _threats(self, points: Sequence[BranchPoint]) -> Sequence[VanishingMargin]:
        try:
            return threats(stages(points), partial(self.returns.restitution, points[-1].s))
        except (ZeroDivisionError, ValueError):
            return []

    def _located(self, points: Sequence[BranchPoint], threat: VanishingMargin) -> Located | None:
        """Return the end at which a margin vanishes if it is near its prediction, else ``None``."""
        last = points[-1]
        try:
            end = locate_end(self.returns, self.metric, points, threat)
        except (ZenoOrbitsError, ZeroDivisionError):
            return None
        s, (low, high) = end.z[-1] * self.metric.unit, self.box
        slack = end.error + 1e-12 * self.metric.unit
        far = float(np.linalg.norm(end.z - last.z)) > _FAR * max(
            threat.distance, self.steps.shortest
        )
        if far or end.error > _CERTAIN * self.metric.unit or not low - slack <= s <= high + slack:
            return None
        return end


def predicted(points: Sequence[BranchPoint], step: float, stray: float) -> Vector:
    r"""Return the predicted point a step ahead of the last point of a family, ``(n_x + 1,)``.

    The prediction is the curve through the last two points to fourth order. The curve has the
    tangents of the points and the derivatives of the tangents. If the prediction is far from the
    tangent, it is replaced by a point on the tangent.

    Args:
        points: Points of the family with their courses.
        step: Distance along the tangent.
        stray: Largest distance from the tangent, relative to the step.
    """
    last = points[-1]
    straight = last.z + step * last.tangent
    if last.course is None:
        return straight
    bend = last.course.bend
    change = step**2 / 2 * bend
    if len(points) > 1 and points[-2].course is not None:
        before, length = points[-2], arclength(points[-2], last)
        chord = (before.tangent - last.tangent + length * bend) / length**2
        slope = (bend - points[-2].course.bend) / length
        second = 6 * chord - 2 * slope
        third = 2 * (second - slope) / length
        change = change + step**3 / 6 * second + step**4 / 24 * third
    change = change - (change @ last.tangent) * last.tangent
    if float(np.linalg.norm(change)) > stray * abs(step):
        return straight
    return straight + change


def require_continuous(before: DifferentiatedReturn, after: DifferentiatedReturn) -> None:
    """Reject a step between returns that do not depend continuously on each other.

    Raises:
        StepError: If the period, the number of turns of the clock or the first impact jumps.
    """
    if abs(after.turns - before.turns) > _SAME_TURNS:
        raise StepError("the number of turns of the clock jumps")
    if not 1 / _SAME_PERIOD < after.time / before.time < _SAME_PERIOD:
        raise StepError("the period jumps")
    for margin, value in after.margins.items():
        if margin.loss is not MarginKind.FIRST_IMPACT or margin not in before.margins:
            continue
        if not 0.5 < value / before.margins[margin] < 2.0:
            raise StepError("the first impact jumps")


_SAME_PERIOD = 1.3
"""Factor by which the period may change in a step."""
_SAME_TURNS = 0.5
"""Turns of the clock by which a return may change per step."""
_LOWER = "the steps lead to an orbit of lower period"
_REJOINS = 0.05
"""Distance of a multiplier from 1 within which a branch ends at the flip of half its period."""

LEAST_DOUBT = 1e-7
"""Scaled arclength below which a step is not subdivided."""
_NODES = 4
"""Points from which test functions are extrapolated to an end."""
_AMPLIFIED = 8.3
"""Factor of the errors of points in an extrapolation by halves: the product of
``(2**k + 1) / (2**k - 1)``."""
_CERTAIN = 1e-6
"""Largest estimated error of an end, relative to the range. With a larger error it is rejected."""
