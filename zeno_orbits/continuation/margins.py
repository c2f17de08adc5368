r"""Margins that vanish at the end of a family, and the margin that causes the others to vanish.

Several margins may vanish at one point. The kind of an end must not depend on the margin that was
followed to it. So the kind is determined from the powers with which the margins vanish together.
Theory (5.8).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.corrector import BranchPoint
from zeno_orbits.continuation.families import SpecialPointKind
from zeno_orbits.continuation.separatrix import separatrix
from zeno_orbits.orbits import Margin, MarginKind

ENDS = {
    MarginKind.AMPLITUDE: SpecialPointKind.AMPLITUDE_ZERO,
    MarginKind.FREQUENCY: SpecialPointKind.PERIOD_INFINITE,
    MarginKind.STALL: SpecialPointKind.PERIOD_INFINITE,
    MarginKind.LOCK: SpecialPointKind.LOCK_VANISHES,
    MarginKind.ACCELERATION: SpecialPointKind.THEOREM_LOST,
    MarginKind.RELEASE_RATE: SpecialPointKind.RELEASE_LOST,
    MarginKind.SWITCH_RATE: SpecialPointKind.SWITCH_LOST,
    MarginKind.EVENTS: SpecialPointKind.EVENTS_MEET,
    MarginKind.FIRST_IMPACT: SpecialPointKind.GRAZING,
    MarginKind.NEAR_MISS: SpecialPointKind.EARLIER_GRAZING,
    MarginKind.LATER_IMPACT: SpecialPointKind.LATER_GRAZING,
    MarginKind.ADHESION: SpecialPointKind.EARLIER_RELEASE,
    MarginKind.OPENING: SpecialPointKind.EVENTS_MEET,
    MarginKind.ARMED: SpecialPointKind.ARMING,
    MarginKind.SWITCH_MISS: SpecialPointKind.SWITCH_ENTERS,
}
"""Kind of the end at which a margin vanishes."""

_NEARLY = 0.4
"""Fraction of a margin's largest value below which its end may be near."""
_TOGETHER = 0.6
"""Least ratio between the decrease of a margin and the decrease that another margin entails.

If the ratio is between this value and its inverse, both margins vanish at one point. The test is
for points far from the end. Close to the end, the powers are determined to `_POWER`."""
_ENTAILED: dict[MarginKind, dict[MarginKind, float]] = {
    MarginKind.AMPLITUDE: {
        MarginKind.FIRST_IMPACT: 1.0,
        MarginKind.ACCELERATION: 1.0,
        MarginKind.RELEASE_RATE: 1.0,
        MarginKind.NEAR_MISS: 1.0,
        MarginKind.ADHESION: 1.0,
    },
    MarginKind.RELEASE_RATE: {
        MarginKind.FIRST_IMPACT: 3.0,
        MarginKind.ACCELERATION: 2.0,
        MarginKind.AMPLITUDE: 3.0,
        MarginKind.EVENTS: 1.0,
    },
    MarginKind.SWITCH_RATE: {MarginKind.SWITCH_RATE: 1.0, MarginKind.EVENTS: 1.0},
    MarginKind.EVENTS: {MarginKind.EVENTS: 1.5, MarginKind.FIRST_IMPACT: 1.5},
    MarginKind.LOCK: {MarginKind.ACCELERATION: 1.0, MarginKind.ADHESION: 2.0},
}
"""Margins that vanish with another margin, each with its power of that margin (theory (5.8)).

The amplitude vanishes with the release rate if the state changes only in the flight. A guard that
does not cross zero loses two events, which meet before.
"""
_LATER = (MarginKind.RELEASE_RATE, MarginKind.SWITCH_RATE, MarginKind.EVENTS)
"""Margins whose consequences are at the next event."""
_BESIDE = (MarginKind.OPENING, MarginKind.SWITCH_MISS)
"""Margins that are not the cause if an event of the event sequence is lost. A kink of a speed is
near zero at an impact that grazes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VanishingMargin:
    """A margin that is about to vanish.

    Attributes:
        margin: The margin.
        distance: Predicted distance along the family.
        fall: Logarithm of the ratio of its last two values.
    """

    margin: Margin
    distance: float
    fall: float


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A point on the way to an end.

    Attributes:
        z: The point, in any metric.
        margins: The margins at the point.
    """

    z: Vector
    margins: Mapping[Margin, float]


def stages(points: Sequence[BranchPoint]) -> list[Stage]:
    """Return points of a family as stages on the way to its end."""
    return [Stage(z=point.z, margins=point.found.margins) for point in points]


def threats(way: Sequence[Stage], restitution: Callable[[int], float]) -> list[VanishingMargin]:
    """Return the margins that vanish beyond the last stage, the nearest first.

    Args:
        way: Neighbours in order, at least two.
        restitution: From the place of a margin to the coefficient of restitution of its stop, at
            the last stage.
    """
    before, last = way[-2], way[-1]
    step = float(np.linalg.norm(last.z - before.z))
    found: dict[Margin, VanishingMargin] = {}
    for margin, value in last.margins.items():
        earlier = before.margins.get(margin)
        if earlier is None or step == 0.0 or margin.loss is MarginKind.CUT:
            continue
        if margin.loss is MarginKind.ACCELERATION and restitution(margin.place) > 0.0:
            # It vanishes independently at plastic impacts only.
            continue
        largest = max(stage.margins.get(margin, 0.0) for stage in way)
        if 0.0 < value < min(earlier, _NEARLY * largest):
            power = 1.0
            if margin.loss is MarginKind.LOCK and restitution(margin.place) > 0.0:
                power = 1 / separatrix(restitution(margin.place)).exponent
            found[margin] = VanishingMargin(
                margin=margin,
                distance=step / ((earlier / value) ** power - 1),
                fall=float(np.log(earlier / value)),
            )
    return _without_consequences(found, _n_places(last))


def _n_places(stage: Stage) -> int:
    return 1 + max((margin.place for margin in stage.margins), default=0)


def consequences(margin: Margin, n_places: int, known: Iterable[Margin]) -> dict[Margin, float]:
    """Return the margins that vanish with another margin, each with its power of that margin.

    If the amplitude vanishes, all margins that are not times vanish in proportion. If the release
    stops being transversal, the flight after it vanishes, at the next event. If the contact phase
    vanishes, so does the acceleration at its start, at the previous event.

    Args:
        margin: The margin that vanishes.
        n_places: Number of events per period.
        known: The margins to choose from.
    """
    powers = _ENTAILED.get(margin.loss, {})

    def is_at_once(one: Margin) -> bool:
        if MarginKind.AMPLITUDE in (one.loss, margin.loss):
            return True
        begins = margin.loss is MarginKind.LOCK and one.loss is MarginKind.ACCELERATION
        shift = -1 if begins else int(margin.loss in _LATER)
        return one.place == (margin.place + shift) % n_places

    return {
        one: powers[one.loss]
        for one in known
        if one.loss in powers and is_at_once(one) and one != margin
    }


def _without_consequences(
    found: dict[Margin, VanishingMargin], n_places: int
) -> list[VanishingMargin]:
    """Return threats without the consequences of others, according to their joint decrease."""
    left = dict(found)
    for margin, threat in found.items():
        for consequence, power in consequences(margin, n_places, tuple(left)).items():
            lesser = left[consequence]
            if _TOGETHER < power * threat.fall / lesser.fall < 1 / _TOGETHER:
                del left[consequence]
    return sorted(left.values(), key=lambda threat: threat.distance)


def causes(way: Sequence[Stage], gone: Margin) -> tuple[Margin, ...]:
    r"""Return the margins that vanish together with a margin, without the consequences of others.

    If :math:`m` is the margin, the others vanish with it as :math:`m^\alpha`. Next to the end
    :math:`\alpha` is constant. The exponent of a margin with a positive limit tends to zero.

    Args:
        way: Stages on the way to the end, at least three. The last stages are next to the end.
        gone: The margin.

    Returns:
        The margins in the order of `ENDS`. So the result does not depend on the margin that was
        followed.
    """
    powers = {gone: 1.0}
    for margin in way[-1].margins:
        fallen = [_exponent(before, after, margin, gone) for before, after in pairwise(way[-3:])]
        if min(fallen) > LEAST_POWER and abs(fallen[1] / fallen[0] - 1) < _STEADY:
            powers[margin] = fallen[-1]
    entailed = {
        margin
        for cause, power in powers.items()
        for margin, factor in consequences(cause, _n_places(way[-1]), powers).items()
        if abs(powers[margin] / (factor * power) - 1) < _POWER
    }
    order = list(ENDS)
    left = [margin for margin in powers if margin not in entailed and margin.loss in ENDS]
    left = [margin for margin in left if margin.loss not in _BESIDE] or left
    return tuple(sorted(left, key=lambda margin: (order.index(margin.loss), margin.place)))


LEAST_POWER, _STEADY, _POWER = 0.2, 0.1, 0.25
"""Least exponent of a margin that vanishes, its largest relative change between stages, and its
largest relative deviation from an entailed power."""


def _exponent(before: Stage, after: Stage, margin: Margin, gone: Margin) -> float:
    """Return the exponent of a margin's decrease relative to another margin between two stages."""
    early, late = (stage.margins.get(margin, 0.0) for stage in (before, after))
    if not early > late > 0.0:
        return 0.0
    return float(np.log(early / late) / np.log(before.margins[gone] / after.margins[gone]))


CLOSE = 0.02
"""Largest distance along a curve, in units of the ranges, of a margin's zero from the curve's end.

Within this distance the curve is reported to end at that zero.
"""


def meeting(
    way: Sequence[Stage], restitution: Callable[[int], float], within: float = CLOSE
) -> str:
    """Return a description of the margin that vanishes at the end of a curve of special points.

    The end is a point of codimension two. The text is empty if no margin vanishes nearby.

    Args:
        way: Points of the curve in order.
        restitution: From the place of a margin to the coefficient of restitution of its stop, at
            the last point.
        within: Largest distance ahead.
    """
    found: list[VanishingMargin] = []
    for margin, value in way[-1].margins.items():
        # A margin may fluctuate on its last steps. So its decrease is measured from the last
        # stage at which it was larger by a factor.
        whence = [
            k for k, stage in enumerate(way) if stage.margins.get(margin, 0.0) > _FALL * value
        ]
        if whence and value == 0.0:
            last = float(np.linalg.norm(way[-1].z - way[whence[-1]].z))
            found.append(VanishingMargin(margin=margin, distance=last, fall=np.inf))
        elif whence:
            fallen = threats((*way[: whence[-1] + 1], way[-1]), restitution)
            found += [threat for threat in fallen if threat.margin == margin]
    for threat in sorted(found, key=lambda threat: threat.distance):
        if threat.distance < within:
            word = ENDS[threat.margin.loss].value
            return f"meets: {word}, within {threat.distance:.0e} of the ranges"
    return ""


_FALL = 1.5
"""Factor of a margin's decrease from which the distance of its end is estimated."""
