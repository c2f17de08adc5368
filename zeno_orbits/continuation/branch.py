r"""A family followed from a point in one direction: steps of pseudo-arclength, and why they end.

A step is accepted only if both ends agree that they are neighbours: the tangents make a small
angle, the new point is near the old tangent and the old point near the new one. A step that is not
is halved, as is one at which Newton's method fails; so a family does not jump to another one that
comes close, unless that runs along it within a tenth of the shortest step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from zeno_orbits.continuation.corrector import BranchPoint, FamilyMetric, correct
from zeno_orbits.continuation.ends import locate_end
from zeno_orbits.continuation.families import SpecialPointKind
from zeno_orbits.continuation.margins import Threat, stages, threats
from zeno_orbits.continuation.return_maps import DifferentiatedReturn, Loss, ReturnMap
from zeno_orbits.continuation.special_points import Located, crossings, locate_inside
from zeno_orbits.errors import ZenoOrbitsError, counted
from zeno_orbits.orbits import PathStep, StepControl, StepError, follow_path, returns_to_start
from zeno_orbits.work import Progress


@dataclass(frozen=True, slots=True, kw_only=True)
class FamilySteps(StepControl):
    """Steps along a family, in scaled arclength: the parameter's whole range is one.

    Attributes:
        turn: Largest angle between neighbouring tangents [rad].
        stray: Largest distance of a point from its neighbour's tangent, as part of the step.
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
        points: In order, the first one given.
        special: Place of the point before it, and the special point.
        ending: Why it ends.
        end: The located end, if there is one.
        detail: More about the end.
    """

    points: tuple[BranchPoint, ...]
    special: tuple[tuple[int, Located], ...]
    ending: SpecialPointKind
    end: Located | None = None
    detail: str = ""


_EASY = 0.4
"""Part of the allowed turn and stray that an easy step uses at most."""
_FAR = 4.0
"""Distance in steps within which an end is sought when a step has failed."""
_SOON = 1.0
"""Distance in steps within which an end is sought before a step fails."""


def follow_branch(
    returns: ReturnMap,
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
        start: The first point; its tangent says in which direction.
        box: Range of the parameter.
        steps: How to step.
        on_progress: Called with each point.
        excluded: Returns True for a point that belongs to another family: an orbit of lower period.
    """
    follower = _Follower(returns, metric, box, steps, on_progress, excluded)
    path = follow_path(
        start,
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
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _End:
    """Why a family ends."""

    kind: SpecialPointKind
    located: Located | None = None
    detail: str = ""


class _Follower:
    """The steps along a family, and the special points passed so far."""

    def __init__(
        self,
        returns: ReturnMap,
        metric: FamilyMetric,
        box: tuple[float, float],
        steps: FamilySteps,
        on_progress: Progress,
        excluded: Callable[[BranchPoint], bool] | None,
    ) -> None:
        self.returns, self.metric, self.box, self.steps = returns, metric, box, steps
        self.on_progress, self.excluded = on_progress, excluded
        self.special: list[tuple[int, Located]] = []
        self.tried: dict[Loss, float] = {}

    def advance(self, points: Sequence[BranchPoint], step: float) -> PathStep[BranchPoint, _End]:
        """Return the next point, or the end if it is near."""
        last = points[-1]
        self.on_progress(f"{counted(len(points), 'orbit')}, at {last.s:.6g}", None)
        ended = self._end_within(points, _SOON * step)
        if ended is not None:
            return ended
        new, at_bound = self._corrected(last, step)
        if not at_bound:
            self._require_neighbour(last, new, step)
        self._pass(len(points), self._between(last, new))
        if at_bound:
            return PathStep(points=(new,), end=_End(kind=SpecialPointKind.BOUND))
        if returns_to_start((*points, new), self.steps.stray, self.steps.turn):
            return PathStep(points=(new,), end=_End(kind=SpecialPointKind.CLOSED))
        return PathStep(points=(new,), easy=self._effort(last, new, step) < _EASY)

    def end_ahead(self, points: Sequence[BranchPoint], step: float) -> PathStep[BranchPoint, _End]:
        """Return the end if the steps became short because of it."""
        if step < self.steps.first / 8:
            return self._end_within(points, _FAR * 8 * step) or PathStep()
        return PathStep()

    def last_end(self, points: Sequence[BranchPoint], trouble: str) -> PathStep[BranchPoint, _End]:
        """Return the end where no step is possible."""
        self.tried.clear()
        ended = self._end_within(points, np.inf)
        if ended is not None:
            return ended
        nearest = min((abs(1 - mu) for mu in points[-1].multipliers), default=1.0)
        if trouble == _LOWER and nearest < _REJOINS:
            return PathStep(
                end=_End(kind=SpecialPointKind.REJOINS, detail="at the flip that is nearest")
            )
        return PathStep(end=_End(kind=SpecialPointKind.GAVE_UP, detail=trouble))

    def _corrected(self, last: BranchPoint, step: float) -> tuple[BranchPoint, bool]:
        """Return the next point, and True if it lies on the bound of the parameter."""
        low, high = self.box
        z = last.z + step * last.tangent
        s = z[-1] * self.metric.unit
        if low <= s <= high:
            new = correct(self.returns, self.metric, z, last.tangent)
            if low <= new.s <= high:
                return new, False
        bound = low if last.tangent[-1] < 0.0 else high
        part = (bound / self.metric.unit - last.z[-1]) / last.tangent[-1]
        normal = np.zeros(z.size)
        normal[-1] = 1.0
        z = last.z + part * last.tangent
        z[-1] = bound / self.metric.unit
        return correct(self.returns, self.metric, z, last.tangent, fixed=normal), True

    def _require_neighbour(self, last: BranchPoint, new: BranchPoint, step: float) -> None:
        """Refuse a point that is no neighbour of the last one."""
        if self.excluded is not None and self.excluded(new):
            raise StepError(_LOWER)
        if float(new.tangent @ last.tangent) < np.cos(self.steps.turn):
            raise StepError("the tangent turns too fast")
        ahead = np.linalg.norm(new.z - last.z - step * last.tangent)
        behind = np.linalg.norm(new.z - last.z - step * new.tangent)
        if max(ahead, behind) > self.steps.stray * step:
            raise StepError("the points do not lie along the tangents")
        require_continuous(last.found, new.found)

    def _effort(self, last: BranchPoint, new: BranchPoint, step: float) -> float:
        """Return the turn and stray of a step, as part of what is allowed."""
        angle = np.arccos(min(1.0, float(last.tangent @ new.tangent)))
        ahead = np.linalg.norm(new.z - last.z - step * last.tangent)
        return max(float(angle) / self.steps.turn, float(ahead) / (self.steps.stray * step))

    def _between(self, before: BranchPoint, after: BranchPoint) -> list[Located]:
        """Return the special points between two neighbours.

        Raises:
            ZenoOrbitsError: If one cannot be located: the step must be shorter.
        """
        found = [
            locate_inside(self.returns, self.metric, before, after, kind)
            for kind in crossings(before, after)
        ]
        return [located for located in found if located is not None]

    def _pass(self, n_points: int, between: Sequence[Located]) -> None:
        """Keep the special points between the last of some points and the next."""
        for located in between:
            self.on_progress(
                f"{located.kind.value} at {located.z[-1] * self.metric.unit:.6g}", None
            )
            self.special.append((n_points - 1, located))

    def _end_within(
        self, points: Sequence[BranchPoint], distance: float
    ) -> PathStep[BranchPoint, _End] | None:
        """Return the way to the end, if one is near and can be located."""
        if len(points) < 2:
            return None
        for threat in self._threats(points):
            if threat.distance > distance:
                continue
            key = threat.margin.loss
            if threat.distance > 0.5 * self.tried.get(key, np.inf):
                continue
            self.tried[key] = threat.distance
            end = self._located(points, threat)
            if end is None or (not end.path and crossings(points[-1], end.point)):
                # What happens before an end has to be passed step by step.
                continue
            try:
                way = (points[-1], *end.path)
                found = [self._between(*neighbours) for neighbours in pairwise(way)]
            except ZenoOrbitsError:
                continue
            for k, between in enumerate(found):
                self._pass(len(points) + k, between)
            return PathStep(points=end.path, end=_End(kind=end.kind, located=end))
        return None

    def _threats(self, points: Sequence[BranchPoint]) -> Sequence[Threat]:
        try:
            return threats(stages(points), self.returns.restitution(points[-1].s))
        except (ZeroDivisionError, ValueError):
            return []

    def _located(self, points: Sequence[BranchPoint], threat: Threat) -> Located | None:
        """Return the end at which a margin vanishes, if it is where it was predicted."""
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


def require_continuous(before: DifferentiatedReturn, after: DifferentiatedReturn) -> None:
    """Refuse a step between returns that do not pass into each other.

    Raises:
        StepError: If the period jumps, or an impact comes or goes.
    """
    if not 1 / _SAME_PERIOD < after.time / before.time < _SAME_PERIOD:
        raise StepError("the period jumps")
    for margin, value in after.margins.items():
        if margin.loss is not Loss.FIRST_IMPACT or margin not in before.margins:
            continue
        if not 0.5 < value / before.margins[margin] < 2.0:
            raise StepError("the first impact jumps")


_SAME_PERIOD = 1.3
"""Factor by which the period may change in a step; a turn more changes it by half."""
_LOWER = "the steps lead to an orbit of lower period"
_REJOINS = 0.05
"""Distance of a multiplier from 1 at which a branch ends in the flip of half its period."""

_CERTAIN = 1e-6
"""Estimated error of an end, as part of the range, above which it is not one."""
