r"""Predictor-corrector path following: the loop that controls the length of a step.

From the last points of a path, the next point is predicted a step :math:`h` ahead and corrected to
a point of the path. A step that fails, or leads to a rejected point, is repeated with :math:`q h`,
:math:`0 < q < 1`. After an easy step the next step is :math:`\min(g h, h_\mathrm{max})`,
:math:`g > 1`. The path ends if a step returns an end, if :math:`h < h_\mathrm{min}`, or after a
number of points. [Keller1977]_

The loop does not depend on the equations. `follow_path` gets functions, which define the unit of a
step. A step is rejected if its motion cannot be simulated or its point is rejected. The last reason
is passed to the function that returns the end. Every other error is due to the input or the
program. A shorter step cannot avoid it, so it is raised.
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
    """A step is rejected, because its point is not a neighbour of the last point.

    The text is the reason.
    """


@dataclass(frozen=True, slots=True, kw_only=True)
class StepControl:
    """Lengths of steps along a path, in the unit of the path.

    Attributes:
        first: First step.
        longest: Longest step.
        shortest: A path that needs a shorter step ends.
        most: Largest number of points after the first.
        growth: Factor on the step after an easy step.
        shrinkage: Factor on the step after a rejected step.
    """

    first: float
    longest: float = math.inf
    shortest: float
    most: float = math.inf
    growth: float = 1.5
    shrinkage: float = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class PathStep(Generic[P, E]):
    """Outcome of an accepted step.

    Attributes:
        points: New points, in order along the path.
        easy: True if the next step may be longer.
        end: Reason why the path ends after these points, or ``None`` if it continues.
    """

    points: tuple[P, ...] = ()
    easy: bool = False
    end: E | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Path(Generic[P, E]):
    """A path in one direction.

    Attributes:
        points: Points in order. The first is the given start.
        end: Reason of the end. ``None`` if the number of points was reached.
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
    """Return the path from a point, with steps as long as the path allows.

    Args:
        start: The first point.
        control: Lengths of steps.
        advance: Function that predicts, corrects and checks the next point. Its arguments are all
            points so far and the length of the step. It raises `StepError` or `SimulationError` to
            reject the step.
        give_up: Function that returns the end of a path whose steps became too short. Its arguments
            are all points and the last reason for rejecting a step.
        shortened: Function that searches for an end ahead, called after each rejected step. Its
            arguments are all points and the new length. By default the step is only repeated.
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
        """The point in scaled coordinates, ``(n,)``."""
        ...

    @property
    def tangent(self) -> Vector:
        """Unit tangent of the curve at the point, ``(n,)``."""
        ...


_LEAST_LOOP = 4
"""Least number of points of a curve that may have returned to its start."""


def returns_to_start(points: Sequence[CurvePoint], stray: float, turn: float) -> bool:
    """Return True if the start of a curve lies between its last two points.

    Args:
        points: Points of the curve, in order.
        stray: Largest distance of the start from their chord, relative to its length.
        turn: Largest angle between neighbouring tangents [rad]. For the start it is doubled.
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
