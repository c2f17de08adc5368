"""Join both directions of a family, with the names of its problem."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.branch import LEAST_DOUBT, Branch
from zeno_orbits.continuation.corrector import BranchPoint
from zeno_orbits.continuation.families import Family, FamilyPoint, SpecialPoint, SpecialPointKind
from zeno_orbits.continuation.margins import ENDS
from zeno_orbits.continuation.return_maps import ImpactReturns
from zeno_orbits.continuation.setup import ONE_RETURN, Setup
from zeno_orbits.continuation.special_points.special_points import Located
from zeno_orbits.model import Problem
from zeno_orbits.orbits import EventSection, Margin, MarginKind


@dataclass(frozen=True, kw_only=True)
class FollowedFamily:
    """A family, with the data from which branches and curves are followed.

    Attributes:
        family: The family.
        setup: The setup of the family.
        special: Its special points.
        ends: Its located ends, each with the last points before it.
    """

    family: Family
    setup: Setup
    special: tuple[Located, ...]
    ends: tuple[tuple[Located, tuple[BranchPoint, ...]], ...]


def whole_family(
    problem: Problem, setup: Setup, backward: Branch, forward: Branch
) -> FollowedFamily:
    """Return both directions of a family as one.

    Args:
        problem: The problem.
        setup: The setup of the family.
        backward: One direction. It has zero points if the family starts at an end.
        forward: The opposite direction.
    """
    names = _Names(problem=problem, setup=setup)
    before = len(backward.points)
    # Both directions begin at the start, unless the family is followed in one direction only.
    shared = 1 if before else 0
    points = (*backward.points[::-1], *forward.points[shared:])
    special = [
        names.special(located, max(before - 2 - index, 0))
        for index, located in reversed(backward.special)
    ]
    special += [
        names.special(located, max(before - shared, 0) + index)
        for index, located in forward.special
    ]
    located = [one for _, one in (*backward.special, *forward.special)]
    return FollowedFamily(
        family=Family(
            problem=problem.name,
            parameter=setup.parameter,
            gains=setup.values.gains,
            parameters=setup.values.parameters,
            n_returns=setup.n_returns,
            points=tuple(names.point(point) for point in points),
            special=tuple(special),
            first=names.end(backward, points[0], 0),
            last=names.end(forward, points[-1], len(points) - 1),
            resolution=setup.metric.unit * max(backward.doubt, forward.doubt, LEAST_DOUBT),
        ),
        setup=setup,
        special=tuple(located),
        ends=tuple(
            (branch.end, _leading(branch.points, branch.end))
            for branch in (backward, forward)
            if branch.end is not None and len(branch.points) > 1
        ),
    )


_AHEAD, _AWAY_FROM_END = 0.005, 0.2
"""Distance from an end at which its curve is started: in the parameter's range, or in all scaled
coordinates."""


def _leading(points: tuple[BranchPoint, ...], end: Located) -> tuple[BranchPoint, ...]:
    """Return two neighbours before an end, at about the distance from which its curve is started.

    The second is the last point at least that far from the end.
    """
    far = [
        k
        for k, point in enumerate(points)
        if abs(point.z[-1] - end.z[-1]) > _AHEAD
        or float(np.linalg.norm(point.z - end.z)) > _AWAY_FROM_END
    ]
    last = max(far[-1] if far else 1, 1)
    return points[last - 1 : last + 1]


@dataclass(frozen=True, kw_only=True)
class _Names:
    """The names of a problem, with which points of a branch become points of a family."""

    problem: Problem
    setup: Setup

    def point(self, point: BranchPoint) -> FamilyPoint:
        """Return a point of a branch as a point of the family."""
        return FamilyPoint(
            value=point.s,
            state=self._state(point.x),
            period=point.found.time,
            multipliers=point.multipliers,
            multiplier_error=point.multiplier_error,
            margins=self._margins(point.found.margins),
            miss=point.miss,
        )

    def special(self, located: Located, index: int) -> SpecialPoint:
        """Return a special point, after the point with an index in the family."""
        x, s = self.setup.metric.of_place(located.z)
        at = replace(
            self.point(located.point),
            value=s,
            state=self._state(x),
            period=located.period,
            multipliers=located.multipliers,
            multiplier_error=located.multiplier_error,
            margins=self._margins(located.margins),
        )
        also = ", ".join(kind.value for kind in located.also)
        details = [f"together with: {also}" if also else "", self._event_of(located)]
        return SpecialPoint(
            kind=self._kind_of(located),
            at=at,
            error=located.error,
            index=index,
            detail="; ".join(filter(None, details)),
        )

    def _event_of(self, located: Located) -> str:
        """Return the events that meet at an end, or the event that is lost there."""
        section = self.setup.section
        if located.kind not in ENDS.values():
            return ""
        if located.rest:
            rest, scale = np.array(located.rest), self.setup.metric.scale
            rest[np.abs(rest) < _ZERO * scale] = 0.0
            named = self._state(rest).items()
            return "rests at " + ", ".join(f"{name} = {value:.6g}" for name, value in named)
        of_period = (SpecialPointKind.AMPLITUDE_ZERO, SpecialPointKind.PERIOD_INFINITE)
        if section is ImpactReturns and self.setup.n_returns > ONE_RETURN:
            number = self._number_of_impact(located)
            return "" if located.kind in of_period else f"impact {number} of {self.setup.n_returns}"
        if not isinstance(section, EventSection):
            return ""
        if located.kind in of_period:
            return ""
        sequence = section.sequence
        turn, place = divmod(located.place, len(sequence))
        several = self.setup.n_returns > ONE_RETURN
        where = f", return {turn + 1} of {self.setup.n_returns}" if several else ""
        if located.name and located.kind is SpecialPointKind.EVENTS_MEET:
            return f"{sequence[place]} and release {located.name}{where}"
        if located.name:
            return f"{_entering(located)} before {sequence[place]}{where}"
        if located.kind in (SpecialPointKind.EVENTS_MEET, SpecialPointKind.LOCK_VANISHES):
            return f"{sequence[place - 1]} and {sequence[place]}{where}"
        return f"{sequence[place]}{where}"

    def _number_of_impact(self, located: Located) -> int:
        """Return the number, from 1, of the impact that ends a return.

        The section is just after the first impact, so that the last return ends with it.
        """
        return (located.place + 1) % self.setup.n_returns + 1

    def _kind_of(self, located: Located) -> SpecialPointKind:
        """Return the kind of a special point. In a family of impacts a later impact may graze."""
        later = self.setup.section is ImpactReturns and self._number_of_impact(located) > 1
        grazes = located.kind is SpecialPointKind.GRAZING
        return SpecialPointKind.LATER_GRAZING if grazes and later else located.kind

    def end(self, branch: Branch, last: BranchPoint, index: int) -> SpecialPoint:
        """Return the end of a branch, or its last point if the end was not located.

        Args:
            branch: The branch.
            last: Its last point.
            index: Index of that point in the family.
        """
        if branch.end is not None:
            return self.special(branch.end, index)
        return SpecialPoint(
            kind=branch.ending, at=self.point(last), error=0.0, index=index, detail=branch.detail
        )

    def _state(self, x: Vector) -> dict[str, float]:
        return dict(zip(self.problem.state_names, x.tolist(), strict=True))

    def _margins(self, margins: Mapping[Margin, float]) -> dict[str, float]:
        """Return margins by name. The name has the number of the return if there are several."""
        section = self.setup.section
        sequence = section.sequence if isinstance(section, EventSection) else ("",)
        found: dict[str, float] = {}
        for margin, value in margins.items():
            turn, place = divmod(margin.place, len(sequence))
            of_return = margin.loss in (MarginKind.AMPLITUDE, *_OF_PERIOD)
            event = "" if of_return else sequence[place]
            word = "after" if margin.loss is MarginKind.OPENING else "before"
            before = f"{margin.name} {word} {event}" if margin.name else event
            several = self.setup.n_returns > ONE_RETURN
            parts = (margin.loss.value, before, f"return {turn + 1}" if several else "")
            found[", ".join(filter(None, parts))] = value
        return found


_ZERO = 1e-9
"""Size of a state that is zero, over its scale."""
_OF_PERIOD = (MarginKind.FREQUENCY, MarginKind.STALL)
"""Margins of the period."""


def _entering(located: Located) -> str:
    """Return the event that enters the event sequence at an end."""
    kinds = {
        SpecialPointKind.EARLIER_GRAZING: "impact",
        SpecialPointKind.EARLIER_RELEASE: "release",
    }
    return f"{kinds.get(located.kind, 'switch')} {located.name}"
