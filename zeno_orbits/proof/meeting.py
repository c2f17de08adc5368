"""A guess of when a set meets its guard, in doubles; what is proved does not depend on it."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

from flint import arb

from zeno_orbits.proof.ball_system import BallSystem
from zeno_orbits.proof.recurrences import Series
from zeno_orbits.proof.stage import Departure, ProofStage

_GRID = 16
"""Parts of the time in which a crossing is looked for."""


def meeting_guess(
    system: BallSystem, stage: ProofStage, points: list[Series], within: float
) -> float | None:
    """Return when the middle of a set meets its guard, if it does soon; not for certain.

    Args:
        system: The problem.
        stage: Where the set is.
        points: Taylor coefficients of its middle.
        within: How far to look [s].
    """
    if stage.departure is Departure.LOCKED:
        return _release_guess(system, points, within)
    coefficients = [float(c.mid()) for c in points[system.gap]]
    skipped = {Departure.FLYING: 0, Departure.STRUCK: 1, Departure.RELEASED: 3}[stage.departure]
    return _first_root(coefficients[skipped:], within)


def _release_guess(system: BallSystem, points: list[Series], within: float) -> float | None:
    def multiplier(time: float) -> float:
        at = [_horner([float(c.mid()) for c in one], time) for one in points]
        return float(system.locked.guard([arb(x) for x in at])[0].mid())

    times = [within * k / _GRID for k in range(_GRID + 1)]
    values = [multiplier(time) for time in times]
    for k in range(_GRID):
        if values[k] > 0.0 >= values[k + 1]:
            return _bisected(multiplier, times[k], times[k + 1])
    return None


def _first_root(coefficients: list[float], within: float) -> float | None:
    def value(time: float) -> float:
        return _horner(coefficients, time)

    grid = [within * k / (2 * _GRID) for k in range(2 * _GRID + 1)]
    if coefficients[0] > 0.0 and len(coefficients) > 2:
        # A flight near a Zeno point is far shorter than a step.
        short = -coefficients[0] / coefficients[1] if coefficients[1] < 0 else within
        grid = sorted({*grid, *(short * k / 8 for k in range(1, 17) if short * k / 8 < within)})
    for left, right in pairwise(grid):
        if value(left) > 0.0 >= value(right):
            return _bisected(value, left, right)
    return None


def _bisected(value: Callable[[float], float], left: float, right: float) -> float:
    for _ in range(100):
        middle = (left + right) / 2
        if not left < middle < right:
            break
        if value(middle) > 0.0:
            left = middle
        else:
            right = middle
    return (left + right) / 2


def _horner(coefficients: list[float], time: float) -> float:
    value = 0.0
    for one in reversed(coefficients):
        value = value * time + one
    return value
