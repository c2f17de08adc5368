r"""Predictor-corrector path following: the loop that controls the length of a step.

From the last points of a path the next is predicted a step :math:`h` ahead and corrected to a point
of the path. A step that fails, or leads to a point that is refused, is repeated with :math:`q h`,
:math:`0 < q < 1`. After an easy step the next one is :math:`\min(g h, h_\mathrm{max})`,
:math:`g > 1`. The path ends where a step says so, where :math:`h < h_\mathrm{min}`, or after a
number of points. [Keller1977]_

The loop knows no equations: `follow_path` is given functions, and the unit of a step is theirs. A
motion that cannot be simulated, or a point that is refused, refuses the step; the last reason is
told to whoever names the end. Every other error is one of the question or of the program, which no
shorter step mends, and is passed on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError, ZenoOrbitsError

P = TypeVar("P")
E = TypeVar("E")


class StepError(ZenoOrbitsError):
    """A step is refused: its point is no neighbour of the last one. The text says why."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StepControl:
    """Lengths of steps along a path, in the unit of the path.

    Attributes:
        first: First step.
        longest: Longest step.
        shortest: A path that needs a shorter step ends.
        most: Points after the first one at most.
        growth: Factor of the step after an easy one.
        shrinkage: Factor of the step after a refused one.
    """

    first: float
    longest: float = math.inf
    shortest: float
    most: float = math.inf
    growth: float = 1.5
    shrinkage: float = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class PathStep(Generic[P, E]):
    """Outcome of a step that is not refused.

    Attributes:
        points: New points, in order along the path.
        easy: True if the next step may be longer.
        end: Why the path ends after these points, or ``None`` if it goes on.
    """

    points: tuple[P, ...] = ()
    easy: bool = False
    end: E | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Path(Generic[P, E]):
    """A path in one direction.

    Attributes:
        points: In order, the first one given.
        end: Why it ends; ``None`` if the number of points was reached.
    """

    points: tuple[P, ...]
    end: E | None


def follow_path(
    start: P,
    control: StepControl,
    advance: Callable[[Sequence[P], float], PathStep[P, E]],
    *,
    give_up: Callable[[Sequence[P], str], PathStep[P, E]],
    shortened: Callable[[Sequence[P], float], PathStep[P, E]] | None = None,
) -> Path[P, E]:
    """Return the path from a point, with steps as long as it allows.

    Args:
        start: The first point.
        control: Lengths of steps.
        advance: Predict, correct and judge the next point, given all points so far and the length
            of the step. Raises `StepError` or `SimulationError` to refuse the step.
        give_up: Return the end of a path whose steps became too short, given all points and the
            last reason for which a step was refused.
        shortened: Look for an end ahead, given all points and the new length, each time a step was
            refused. By default the step is only repeated.
    """
    points, step = [start], control.first
    while len(points) <= control.most:
        try:
            taken = advance(points, step)
        except (SimulationError, StepError) as error:
            step *= control.shrinkage
            if step < control.shortest:
                taken = give_up(points, str(error))
            elif shortened is None:
                continue
            else:
                taken = shortened(points, step)
        else:
            if taken.easy:
                step = min(control.growth * step, control.longest)
        points += taken.points
        if taken.end is not None:
            return Path(points=tuple(points), end=taken.end)
    return Path(points=tuple(points), end=None)


class CurvePoint(Protocol):
    """A point of a curve with its tangent."""

    @property
    def z(self) -> Vector:
        """Place in scaled terms, ``(n,)``."""
        ...

    @property
    def tangent(self) -> Vector:
        """Unit tangent of the curve there, ``(n,)``."""
        ...


_LEAST_LOOP = 4
"""Points of a curve that may have come back to its start."""


def returns_to_start(points: Sequence[CurvePoint], stray: float, turn: float) -> bool:
    """Return True if the start of a curve lies between its last two points.

    Args:
        points: Points of the curve, in order.
        stray: Largest distance of the start from their chord, as part of its length.
        turn: Largest angle between neighbouring tangents [rad]; the start may have twice that.
    """
    if len(points) < _LEAST_LOOP:
        return False
    start, before, last = points[0], *points[-2:]
    step = last.z - before.z
    length = float(np.linalg.norm(step))
    along = float((start.z - before.z) @ step) / length
    off = float(np.linalg.norm(start.z - before.z - along / length * step))
    aligned = float(start.tangent @ last.tangent) > np.cos(2 * turn)
    return bool(0.0 < along <= length and off < stray * length and aligned)
