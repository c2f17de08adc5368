"""A point of a map, followed again more accurately where small errors may decide (theory (29))."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from zeno_orbits.maps.approach import Way
from zeno_orbits.maps.attempt import SAME_PERIOD, Accuracy, Request
from zeno_orbits.maps.attractors import Attractor, Fate
from zeno_orbits.maps.point import Point
from zeno_orbits.simulation import LaneEvent

_WANDERS = 10
"""Returns before a motion is on its way to its orbit, from which on small errors may lead there."""
_FINER = 1e-2
"""Local error of the last simulation, in units of that of the orbit."""
_DEPENDS = "what it settles to depends on the smallest errors"


class SurePoint:
    """A motion that settles; where it wanders first, it has to do so at two accuracies alike."""

    def __init__(self, motion: Callable[[Accuracy], Point], accuracy: Accuracy) -> None:
        """Begin at the usual accuracy.

        Args:
            motion: From an accuracy to the motion from its start.
            accuracy: The usual one.
        """
        self._motion = motion
        finer = (accuracy.orbit, _FINER * accuracy.orbit)
        self._left = [
            replace(accuracy, motion=error, orbit=min(error, accuracy.orbit))
            for error in finer
            if error < accuracy.motion
        ]
        self._before: tuple[Attractor, Way] | None = None
        self._point = motion(accuracy)

    def begin(self) -> Request:
        """Return the first lane to run."""
        return self._point.begin()

    def hear(self, rank: int, event: LaneEvent) -> Request | Attractor | None:
        """Take an event of one of its lanes, as `Point` does."""
        answer = self._point.hear(rank, event)
        if not isinstance(answer, Attractor):
            return answer
        way = self._point.way if math.isfinite(answer.period) else None
        if self._before is None:
            if way is None or not (way.captured >= _WANDERS or way.doubtful):
                return answer
        elif way is not None and _agree(*self._before, answer, way):
            return answer
        if way is None or not self._left:
            return Attractor(fate=Fate.UNSETTLED, trend=answer.trend, detail=_DEPENDS)
        self._before = answer, way
        self._point = self._motion(self._left.pop(0))
        return self._point.begin()


def _agree(first: Attractor, way: Way, again: Attractor, way_again: Way) -> bool:
    """Return True if a motion comes to the same orbit on the same way at two accuracies.

    Args:
        first: What it settles to.
        way: Its way there.
        again: What it settles to more accurately.
        way_again: Its way there.
    """
    alike = (first.fate, first.returns) == (again.fate, again.returns)
    same = abs(first.period - again.period) <= SAME_PERIOD * first.period
    return alike and same and way.is_shared_by(way_again)
