"""Join both directions of a family, with the names of its problem."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.branch import LEAST_DOUBT, Branch
from zeno_orbits.continuation.corrector import BranchPoint
from zeno_orbits.continuation.families import Family, FamilyPoint, SpecialPoint, SpecialPointKind
from zeno_orbits.continuation.setup import ONE_RETURN, Setup
from zeno_orbits.continuation.special_points.special_points import Located
from zeno_orbits.model import Problem
from zeno_orbits.orbits import Margin, MarginKind


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

    @property
    def _sequence(self) -> tuple[str, ...]:
        return self.setup.section.sequence

    @property
    def _is_named(self) -> bool:
        """True if events have names: not those of one stop without a name, each once."""
        graph = self.problem.compiled_graph().graph
        stops = tuple(stop.name for stop in graph.stops)
        return bool(graph.switches) or stops != (_STOP,) or self._sequence not in _WITHOUT_NAMES

    def _event_of(self, located: Located) -> str:
        """Return the events that meet at an end, or the event that is lost there."""
        cause = located.cause
        if cause is None:
            return ""
        if located.rest:
            rest, scale = np.array(located.rest), self.setup.metric.scale
            rest[np.abs(rest) < _ZERO * scale] = 0.0
            named = self._state(rest).items()
            return "rests at " + ", ".join(f"{name} = {value:.6g}" for name, value in named)
        if cause.loss in _OF_RETURN:
            return ""
        turn, place = divmod(cause.place, len(self._sequence))
        n = self.setup.n_returns
        where = f"return {turn + 1} of {n}" if n > ONE_RETURN else ""
        if not self._is_named:
            is_impact = len(self._sequence) == 1 and n > ONE_RETURN
            return f"impact {self._number(turn)} of {n}" if is_impact else where
        event = self._sequence[place]
        if cause.name and located.kind is SpecialPointKind.EVENTS_MEET:
            event = f"{event} and release {cause.name}"
        elif cause.name:
            event = f"{_entering(located.kind, cause.name)} before {event}"
        elif located.kind in (SpecialPointKind.EVENTS_MEET, SpecialPointKind.LOCK_VANISHES):
            event = f"{self._sequence[place - 1]} and {event}"
        return ", ".join(filter(None, (event, where)))

    def _number(self, turn: int) -> int:
        """Return the number, from 1, of the impact that ends a return.

        The section is just after the first impact, so that the last return ends with it.
        """
        return (turn + 1) % self.setup.n_returns + 1

    def _kind_of(self, located: Located) -> SpecialPointKind:
        """Return the kind of a special point. In a family of impacts a later impact may graze."""
        if located.kind is not SpecialPointKind.GRAZING or located.cause is None:
            return located.kind
        is_later = len(self._sequence) == 1 and self._number(located.cause.place) > 1
        return SpecialPointKind.LATER_GRAZING if is_later else located.kind

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
        several, is_named = self.setup.n_returns > ONE_RETURN, self._is_named
        found: dict[str, float] = {}
        for margin, value in margins.items():
            turn, place = divmod(margin.place, len(self._sequence))
            event = self._sequence[place]
            if margin.name:
                word = "after" if margin.loss is MarginKind.OPENING else "before"
                event = f"{margin.name} {word} {event}"
            is_of_event = is_named and margin.loss not in _OF_RETURN
            parts = [margin.loss.value, *([event] if is_of_event else [])]
            name = ", ".join([*parts, *([f"return {turn + 1}"] if several else [])])
            found[name] = min(value, found.get(name, value))
        return found


_ZERO = 1e-9
"""Size of a state that is zero, over its scale."""
_OF_RETURN = (MarginKind.AMPLITUDE, MarginKind.FREQUENCY, MarginKind.STALL)
"""Margins of a whole return."""
_STOP = "stop"
"""Name of the only stop of a machine that gives it no name."""
_WITHOUT_NAMES = ((f"impact {_STOP}",), (f"zeno {_STOP}", f"release {_STOP}"))
"""Event sequences whose margins are found without names of events."""


def _entering(kind: SpecialPointKind, name: str) -> str:
    """Return the event that enters the event sequence at an end."""
    kinds = {
        SpecialPointKind.EARLIER_GRAZING: "impact",
        SpecialPointKind.EARLIER_RELEASE: "release",
    }
    return f"{kinds.get(kind, 'switch')} {name}"
