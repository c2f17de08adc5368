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

from zeno_orbits.continuation.corrector import BranchPoint, Metric, correct, is_back
from zeno_orbits.continuation.ends import locate_end
from zeno_orbits.continuation.families import Kind
from zeno_orbits.continuation.margins import Threat, stages, threats
from zeno_orbits.continuation.return_maps import Loss, Return, ReturnMap
from zeno_orbits.continuation.special_points import Located, crossings, locate_inside
from zeno_orbits.errors import ZenoOrbitsError


@dataclass(frozen=True, slots=True, kw_only=True)
class Steps:
    """How a family is followed.

    Attributes:
        first: First step, in scaled arclength: the parameter's whole range is one.
        longest: Longest step.
        shortest: A step that would have to be shorter is given up.
        most: Steps in a direction.
        turn: Largest angle between neighbouring tangents [rad].
        stray: Largest distance of a point from its neighbour's tangent, as part of the step.
    """

    first: float = 0.01
    longest: float = 0.04
    shortest: float = 1e-6
    most: int = 300
    turn: float = 0.2
    stray: float = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Branch:
    """A family in one direction.

    Attributes:
        points: In order, the first one given.
        special: Place of the point before it, and the special point.
        ending: Why it ends.
        end: The end as it was located, if it was.
        detail: What else is to be said of the end.
    """

    points: tuple[BranchPoint, ...]
    special: tuple[tuple[int, Located], ...]
    ending: Kind
    end: Located | None = None
    detail: str = ""


Tell = Callable[[str, float | None], None]

_GROWTH, _EASY = 1.5, 0.4
_FAR = 4.0
"""How many steps ahead an end may be that is sought when a step has failed."""
_SOON = 1.0
"""How many steps ahead an end is sought before a step fails."""


def follow(
    returns: ReturnMap,
    metric: Metric,
    start: BranchPoint,
    box: tuple[float, float],
    steps: Steps,
    *,
    restitution: Callable[[float], float],
    tell: Tell,
    alien: Callable[[BranchPoint], bool] | None = None,
) -> Branch:
    """Return the family from a point along its tangent.

    Args:
        returns: The return map.
        metric: Units.
        start: The first point; its tangent says in which direction.
        box: Range of the parameter.
        steps: How to step.
        restitution: At a parameter.
        tell: Called with what happens.
        alien: Tells a point that belongs to another family: an orbit of lower period.
    """
    walk = _Walk(returns, metric, box, steps, restitution, tell, alien)
    return walk.run(start)


class _Walk:
    """A family in the making."""

    def __init__(
        self,
        returns: ReturnMap,
        metric: Metric,
        box: tuple[float, float],
        steps: Steps,
        restitution: Callable[[float], float],
        tell: Tell,
        alien: Callable[[BranchPoint], bool] | None,
    ) -> None:
        self.returns, self.metric, self.box, self.steps = returns, metric, box, steps
        self.restitution, self.tell, self.alien = restitution, tell, alien
        self.points: list[BranchPoint] = []
        self.special: list[tuple[int, Located]] = []
        self.tried: dict[Loss, float] = {}

    def run(self, start: BranchPoint) -> Branch:
        self.points.append(start)
        step, trouble = self.steps.first, ""
        while len(self.points) <= self.steps.most:
            self.tell(f"{len(self.points)} orbits, at {self.points[-1].s:.6g}", None)
            ended = self._end_within(_SOON * step)
            if ended is not None:
                return ended
            new, at_bound, between = None, False, list[Located]()
            try:
                new, at_bound = self._stepped(step)
                trouble = "" if at_bound else self._objection(new, step)
                if not trouble:
                    between = self._between(self.points[-1], new)
            except ZenoOrbitsError as error:
                trouble = str(error)
            if new is None or trouble:
                step /= 2
                if step < self.steps.shortest:
                    return self._lost(trouble)
                if step < self.steps.first / 8:
                    ended = self._end_within(_FAR * 8 * step)
                    if ended is not None:
                        return ended
                continue
            self._accept(new, between)
            if at_bound:
                return self._branch(Kind.BOUND)
            if is_back(self.points, self.steps.stray, self.steps.turn):
                return self._branch(Kind.CLOSED)
            if self._ease(step) < _EASY:
                step = min(_GROWTH * step, self.steps.longest)
        return self._branch(Kind.MOST_STEPS, detail=f"{self.steps.most} steps")

    def _stepped(self, step: float) -> tuple[BranchPoint, bool]:
        """Return the next point, and whether it lies on the bound of the parameter."""
        last, low, high = self.points[-1], *self.box
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
        return correct(self.returns, self.metric, z, last.tangent, fixed=normal), True

    def _objection(self, new: BranchPoint, step: float) -> str:
        """Return why a point is no neighbour of the last one, or nothing."""
        last = self.points[-1]
        if self.alien is not None and self.alien(new):
            return _LOWER
        if float(new.tangent @ last.tangent) < np.cos(self.steps.turn):
            return "the tangent turns too fast"
        ahead = np.linalg.norm(new.z - last.z - step * last.tangent)
        behind = np.linalg.norm(new.z - last.z - step * new.tangent)
        if max(ahead, behind) > self.steps.stray * step:
            return "the points do not lie along the tangents"
        return jumped(last.found, new.found)

    def _ease(self, step: float) -> float:
        """Return how much of what a step may bend the last one did."""
        before, last = self.points[-2:]
        angle = np.arccos(min(1.0, float(before.tangent @ last.tangent)))
        ahead = np.linalg.norm(last.z - before.z - step * before.tangent)
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

    def _accept(self, new: BranchPoint, between: Sequence[Located]) -> None:
        for located in between:
            self.tell(f"{located.kind.value} at {located.z[-1] * self.metric.unit:.6g}", None)
            self.special.append((len(self.points) - 1, located))
        self.points.append(new)

    def _end_within(self, distance: float) -> Branch | None:
        """Return the family with its end, if one is near and can be located."""
        if len(self.points) < 2:
            return None
        for threat in self._threats():
            if threat.distance > distance:
                continue
            key = threat.margin.loss
            if threat.distance > 0.5 * self.tried.get(key, np.inf):
                continue
            self.tried[key] = threat.distance
            end = self._located(threat)
            if end is None or (not end.path and crossings(self.points[-1], end.point)):
                # What happens before an end has to be passed step by step.
                continue
            try:
                way = (self.points[-1], *end.path)
                found = [self._between(*neighbours) for neighbours in pairwise(way)]
            except ZenoOrbitsError:
                continue
            for point, between in zip(end.path, found, strict=True):
                self._accept(point, between)
            return self._branch(end.kind, end=end)
        return None

    def _threats(self) -> Sequence[Threat]:
        try:
            return threats(stages(self.points), self.restitution(self.points[-1].s))
        except (ZeroDivisionError, ValueError):
            return []

    def _located(self, threat: Threat) -> Located | None:
        """Return the end at which a margin vanishes, if it is where it was predicted."""
        last = self.points[-1]
        try:
            end = locate_end(self.returns, self.metric, self.points, threat, self.restitution)
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

    def _lost(self, trouble: str) -> Branch:
        """Return the family with an end that has no other name."""
        self.tried.clear()
        ended = self._end_within(np.inf)
        if ended is not None:
            return ended
        nearest = min((abs(1 - mu) for mu in self.points[-1].multipliers), default=1.0)
        if trouble == _LOWER and nearest < _REJOINS:
            return self._branch(Kind.REJOINS, detail="at the flip that is nearest")
        return self._branch(Kind.GAVE_UP, detail=trouble)

    def _branch(self, ending: Kind, *, end: Located | None = None, detail: str = "") -> Branch:
        return Branch(
            points=tuple(self.points),
            special=tuple(self.special),
            ending=ending,
            end=end,
            detail=detail,
        )


def jumped(before: Return, after: Return) -> str:
    """Return what is not continuous between two neighbours: an impact more or less, or nothing."""
    if not 1 / _SAME_PERIOD < after.time / before.time < _SAME_PERIOD:
        return "the period is another one"
    for margin, value in after.margins.items():
        if margin.loss is not Loss.FIRST_IMPACT or margin not in before.margins:
            continue
        if not 0.5 < value / before.margins[margin] < 2.0:
            return "the first impact is another one"
    return ""


_SAME_PERIOD = 1.3
"""Factor by which the period may change in a step; a turn more changes it by half."""
_LOWER = "the steps lead to an orbit of lower period"
_REJOINS = 0.05
"""Distance of a multiplier from 1 at which a branch ends in the flip of half its period."""

_CERTAIN = 1e-6
"""Estimated error of an end, as part of the range, above which it is not one."""
