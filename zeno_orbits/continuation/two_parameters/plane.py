"""The plane of two parameters in which special points are curves, and the steps along these."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.return_maps import ReturnMap
from zeno_orbits.orbits.section import Line

Tell = Callable[[str, float | None], None]
OnLine = Callable[[Line], ReturnMap]


@dataclass(frozen=True, slots=True, kw_only=True)
class Plane:
    """Two parameters and their ranges.

    Attributes:
        names: Their names.
        places: Their places in ``p``.
        box: Lower and upper ends, ``(2, 2)``, a row each.
        p: All numbers; the two are replaced.
        restitution: Place of the restitution in ``p``.
    """

    names: tuple[str, str]
    places: tuple[int, int]
    box: Vector
    p: Vector
    restitution: int

    @property
    def units(self) -> Vector:
        """Lengths of the ranges, ``(2,)``."""
        return self.box[:, 1] - self.box[:, 0]

    def line(self, at: Vector, direction: Vector) -> Line:
        """Return the line through a place of the plane; both in units of the ranges, ``(2,)``."""
        origin, along = self.p.copy(), np.zeros(self.p.size)
        origin[list(self.places)] = at * self.units
        along[list(self.places)] = direction * self.units
        return Line(origin=origin, direction=along)

    def restitution_at(self, at: Vector) -> float:
        """Return the restitution at a place, ``(2,)``."""
        return float(self.line(at, np.zeros(2)).origin[self.restitution])

    def holds(self, at: Vector) -> bool:
        """Tell whether a place lies in the ranges."""
        low, high = self.box[:, 0] / self.units, self.box[:, 1] / self.units
        return bool(np.all(at >= low - _EDGE) and np.all(at <= high + _EDGE))


_EDGE = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveSteps:
    """How a boundary is followed.

    Attributes:
        first: First step, in units of the ranges.
        longest: Longest step.
        shortest: Shortest step.
        most: Points in a direction.
        bend: Largest distance of a point from its prediction, as part of the step.
        turn: Largest angle between neighbouring tangents of a curve of folds or flips [rad].
        least_arc: Shortest step along such a curve, which counts the scaled state, too.
        most_arcs: Points of such a curve in a direction.
    """

    first: float = 0.005
    longest: float = 0.05
    shortest: float = 1e-5
    most: int = 200
    bend: float = 0.25
    turn: float = 0.3
    least_arc: float = 1e-8
    most_arcs: int = 300
