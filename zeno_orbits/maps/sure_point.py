"""A point of a map, simulated again more accurately if small errors may decide (theory (4.7))."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from zeno_orbits.maps.approach import SAME_PERIOD, Accuracy, Approach
from zeno_orbits.maps.attractors import Attractor, AttractorClass
from zeno_orbits.maps.point import Point

_WANDERS = 10
"""Number of returns before the approach to an orbit from which small errors may decide."""
_FINER = 1e-2
"""Local error of the last simulation, in units of the orbit's local error."""
_DEPENDS = "its attractor depends on the smallest errors"


def sure_attractor(
    motion: Callable[[Accuracy], Point], accuracy: Accuracy
) -> tuple[Attractor, Approach | None]:
    """Return the attractor of a motion. After a long transient, two accuracies have to agree.

    Args:
        motion: Function of an accuracy that returns the motion from its start.
        accuracy: The usual accuracy.

    Returns:
        The attractor, and the approach of the motion if the attractor has a period.
    """
    left = [
        replace(accuracy, motion=error, orbit=min(error, accuracy.orbit))
        for error in (accuracy.orbit, _FINER * accuracy.orbit)
        if error < accuracy.motion
    ]
    before: tuple[Attractor, Approach] | None = None
    while True:
        point = motion(accuracy)
        answer = point.attractor()
        way = point.way if math.isfinite(answer.period) else None
        if before is None:
            if way is None or not (way.captured >= _WANDERS or way.doubtful):
                return answer, way
        elif way is not None and _agree(*before, answer, way):
            return answer, way
        if way is None or not left:
            return Attractor(
                fate=AttractorClass.UNSETTLED, trend=answer.trend, detail=_DEPENDS
            ), None
        # A doubtful orbit says nothing.
        before, accuracy = None if way.doubtful else (answer, way), left.pop(0)


def _agree(first: Attractor, way: Approach, again: Attractor, way_again: Approach) -> bool:
    """Return True if a motion approaches the same orbit in the same way at two accuracies.

    Args:
        first: Attractor at the first accuracy.
        way: Approach to this attractor.
        again: Attractor at the higher accuracy.
        way_again: Approach to this attractor.
    """
    alike = (first.fate, first.returns) == (again.fate, again.returns)
    same = abs(first.period - again.period) <= SAME_PERIOD * first.period
    return alike and same and way.is_shared_by(way_again)
