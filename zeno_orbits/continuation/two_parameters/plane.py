"""The plane of two parameters, and the setup and start of a curve of special points in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.corrector import BranchPoint, FamilyMetric
from zeno_orbits.continuation.return_maps import FamilyMap
from zeno_orbits.continuation.special_points.special_points import Located
from zeno_orbits.orbits import Line, StepControl
from zeno_orbits.work import Progress


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterPlane:
    """Two parameters and their ranges.

    Attributes:
        names: Their names.
        places: Their indices in ``p``.
        box: Lower and upper ends, ``(2, 2)``, one row per parameter.
        p: All parameter values. The values of the two parameters are replaced.
    """

    names: tuple[str, str]
    places: tuple[int, int]
    box: Vector
    p: Vector

    @property
    def units(self) -> Vector:
        """Lengths of the ranges, ``(2,)``."""
        return self.box[:, 1] - self.box[:, 0]

    def line(self, at: Vector, direction: Vector) -> Line:
        """Return the line through a point in a direction, both in units of the ranges, ``(2,)``."""
        origin, along = self.p.copy(), np.zeros(self.p.size)
        origin[list(self.places)] = at * self.units
        along[list(self.places)] = direction * self.units
        return Line(origin=origin, direction=along)

    def holds(self, at: Vector) -> bool:
        """Return True if a point, ``(2,)`` in units of the ranges, is inside the ranges."""
        low, high = self.box[:, 0] / self.units, self.box[:, 1] / self.units
        return bool(np.all(at >= low - _EDGE) and np.all(at <= high + _EDGE))


_EDGE = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveSteps(StepControl):
    """Steps along a curve in two parameters, in units of the ranges.

    Attributes:
        bend: Largest distance of a point from its prediction, relative to the step.
        turn: Largest angle between neighbouring tangents of a curve of folds or flips [rad].
        least_arc: Shortest step along such a curve, in arclength that includes the scaled state.
        most_arcs: Largest number of points of such a curve in one direction.
    """

    first: float = 0.005
    longest: float = 0.05
    shortest: float = 1e-5
    most: float = 200
    bend: float = 0.25
    turn: float = 0.3
    least_arc: float = 1e-8
    most_arcs: int = 300


@dataclass(frozen=True, kw_only=True)
class CurveSetup:
    """All inputs of a curve in two parameters except its start.

    Attributes:
        plane: The two parameters. The family is followed in the first.
        returns: The return map, along any line.
        metric: Units of the family.
        steps: Steps along the curve.
        on_progress: Called with each point.
    """

    plane: ParameterPlane
    returns: FamilyMap
    metric: FamilyMetric
    steps: CurveSteps
    on_progress: Progress

    def returns_on(self, at: Vector, direction: Vector) -> FamilyMap:
        """Return the return map on the line through a point in a direction, both ``(2,)``."""
        return self.returns.moved_to(self.plane.line(at, direction))

    def restitution_at(self, at: Vector, place: int = 0) -> float:
        """Return the coefficient of restitution of the stop of a margin.

        Args:
            at: The point of the plane, ``(2,)``.
            place: Place of the margin.
        """
        return self.returns_on(at, np.zeros(2)).restitution(0.0, place)

    def report(self, word: str, at: Vector) -> None:
        """Report the progress to a point of the plane, ``(2,)``."""
        x, y = at * self.plane.units
        self.on_progress(f"{word} at {x:.6g}, {y:.6g}", None)


@dataclass(frozen=True, kw_only=True)
class CurveStart:
    """A special point of a family, where a curve in two parameters starts.

    Attributes:
        found: The special point.
        value: Both parameters at the point.
        leading: The last points of the family before an end.
    """

    found: Located
    value: tuple[float, float]
    leading: tuple[BranchPoint, ...] = ()
