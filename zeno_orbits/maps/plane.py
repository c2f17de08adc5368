"""The plane of a map: two axes through the values of a problem, and the task of its points."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, any_number, shown
from zeno_orbits.maps.approach import Accuracy
from zeno_orbits.maps.attractors import Attractor, AttractorClass, attractor_json
from zeno_orbits.maps.classify import (
    attractors_from,
    known_orbits,
    usual_time,
)
from zeno_orbits.maps.known import KnownOrbit
from zeno_orbits.maps.refinement import fine_count
from zeno_orbits.model import ParameterValues, Problem, ProblemFile, unknown
from zeno_orbits.simulation import simulate
from zeno_orbits.work import report_part

_CHUNKS = 4
"""Smallest number of chunks of a plane."""
_SMALLEST, _LARGEST = 16, 250
"""Points of a chunk: many, so that the last few motions to converge cost little, and few enough
that a plane of 100 x 100 points uses 40 workers."""
_LEAST = 2
"""Smallest number of points along an axis."""
OF_BASINS = Accuracy(motion=1e-10, orbit=1e-11, repeats=1e-11)
"""Accuracy of maps over states, which limits the accuracy of boundaries between basins."""
MOST_HALVINGS = 10
"""Largest number of halvings of cells along boundaries."""
_MOST = 10_000_000
"""Largest number of points of a plane: a day of work for a hundred cores, and gigabytes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Axis:
    """One direction of the plane.

    Attributes:
        name: Name of a gain, a parameter, or an initial state.
        lower: Lower end of the axis.
        upper: Upper end of the axis.
        count: Number of points along the axis, including both ends.
        unit: Unit of the values.
    """

    name: str
    lower: float
    upper: float
    count: int
    unit: str = "1"

    def values(self) -> tuple[float, ...]:
        """Return the values along the axis, ``(count,)``."""
        return tuple(np.linspace(self.lower, self.upper, self.count).tolist())


@dataclass(frozen=True, slots=True, kw_only=True)
class Plane:
    """A plane through the gains, the parameters and the initial states of a problem.

    Attributes:
        source: The problem itself, or its file if other processes have to load it.
        x: The horizontal axis.
        y: The vertical axis.
        gains: Gains that differ from their defaults, except the gains of the axes.
        parameters: Parameters that differ from their defaults, likewise. Derived values are derived
            at every point.
        start: Initial state of every motion, ``(n_x,)``, except the states of the axes.
        is_declared: Whether it is the problem's first start, whose formulas are then evaluated at
            every point.
        until: Longest simulated time of a motion [s], or ``None`` for the usual time of the slowest
            corner.
        known: Orbits with which motions are compared, only for a plane of two states.
    """

    source: Problem | ProblemFile
    x: Axis
    y: Axis
    gains: Mapping[str, float] = field(default_factory=dict[str, float])
    parameters: Mapping[str, float] = field(default_factory=dict[str, float])
    start: tuple[float, ...]
    is_declared: bool = False
    until: float | None = None
    known: tuple[KnownOrbit, ...] = ()

    @property
    def problem(self) -> Problem:
        """The problem, the same object every time in one process."""
        return self.source.load() if isinstance(self.source, ProblemFile) else self.source

    @property
    def time(self) -> float:
        """Longest simulated time of a motion [s]."""
        if self.until is not None:
            return self.until
        corners: list[ParameterValues] = []
        for x in (self.x.lower, self.x.upper):
            for y in (self.y.lower, self.y.upper):
                with suppress(InputError):
                    corners.append(self.values(x, y))
        return usual_time(self.problem, corners or [self.problem.values()], self.start)

    def __call__(self, points: Sequence[Sequence[float]]) -> list[dict[str, Any]]:
        """Return the attractors at some points as plain data: the task of a worker.

        Args:
            points: Points ``(x, y)``.
        """
        problem = self.problem
        fixed = self.values(*points[0]) if points and self.has_fixed_numbers else None
        motions: dict[int, tuple[ParameterValues, Vector]] = {}
        found: dict[int, Attractor] = {}
        for k, (x, y) in enumerate(points):
            try:
                motions[k] = fixed or self.values(x, y), self.state(x, y)
            except InputError as error:
                # An axis is inside its range, but a derived value may be outside of its range.
                found[k] = Attractor(fate=AttractorClass.FAILED, detail=str(error))
        attractors = attractors_from(
            problem,
            tuple(motions.values()),
            until=self.time,
            accuracy=OF_BASINS if self.has_states else None,
            known=self.known,
            on_progress=lambda _stage, part: report_part(part or 0.0),
        )
        found |= dict(zip(motions, attractors, strict=True))
        return [attractor_json(found[k]) for k in range(len(points))]

    def points(self) -> tuple[tuple[float, float], ...]:
        """Return the points of the grid, row by row from below."""
        return tuple((x, y) for y in self.y.values() for x in self.x.values())

    def values(self, x: float, y: float) -> ParameterValues:
        """Return the gains and parameters at a point.

        Args:
            x: Value of the horizontal axis.
            y: Value of the vertical axis.

        Raises:
            InputError: If the problem rejects the values.
        """
        problem = self.problem
        point = {self.x.name: x, self.y.name: y}
        numbers = {name: value for name, value in point.items() if name in problem.names}
        return problem.values(gains=self.gains, parameters=self.parameters, numbers=numbers)

    def state(self, x: float, y: float) -> Vector:
        """Return the initial state of the motion of a point, ``(n_x,)``.

        Args:
            x: Value of the horizontal axis.
            y: Value of the vertical axis.
        """
        problem = self.problem
        point = {self.x.name: x, self.y.name: y}
        start = self.start
        if self.is_declared:
            start = problem.state_vector(problem.starts[0], self.values(x, y))
        names = zip(problem.state_names, start, strict=True)
        return np.array(
            [value if name in problem.names else point.get(name, value) for name, value in names]
        )

    @property
    def has_states(self) -> bool:
        """True if an axis is a state."""
        return any(axis.name not in self.problem.names for axis in (self.x, self.y))

    @property
    def has_fixed_numbers(self) -> bool:
        """True if both axes are states."""
        return all(axis.name not in self.problem.names for axis in (self.x, self.y))

    def known_among(self, attractors: Sequence[Attractor]) -> Plane:
        """Return the plane with the stable orbits among some attractors as known orbits."""
        values = self.values(self.x.lower, self.y.lower)
        return replace(self, known=known_orbits(self.problem, values, attractors, OF_BASINS))


def chunk_of(plane: Plane) -> int:
    """Return the number of points per task.

    It depends on the plane alone, so a checkpoint is valid on every machine and for any number of
    workers.

    Args:
        plane: The plane.
    """
    part = math.ceil(plane.x.count * plane.y.count / _CHUNKS)
    return min(max(part, _SMALLEST), _LARGEST)


def require_plane(plane: Plane) -> Plane:
    """Check a plane, and return it with its units and its time limit.

    Raises:
        InputError: If a name is unknown or given twice, bounds are reversed or out of the
            parameter's range, the number of points is too small or too large, or the time limit is
            not positive.
    """
    problem = plane.problem
    if plane.until is not None and not 0.0 < any_number("until", plane.until) < math.inf:
        wanted = "must be a finite, positive number of seconds"
        raise InputError(f"Argument `until` {wanted}, but it is {plane.until:g}.")
    if plane.x.name == plane.y.name:
        message = f"must be another name than `x`, but both are `{plane.x.name}`"
        raise InputError(f"Argument `y` {message}.")
    for axis in (plane.x, plane.y):
        if type(axis.count) is not int:
            wanted = f"must be a whole number for `{axis.name}`"
            raise InputError(f"Argument `points` {wanted}, but it is {shown(axis.count)}.")
    count = plane.x.count * plane.y.count
    if count > _MOST:
        made = f"{plane.x.count} values and {plane.y.count} of `y` make {count} points"
        raise InputError(f"Argument `x`: {made}, more than {_MOST}. Ask for fewer values.")
    axes = {name: _checked(problem, plane, name) for name in ("x", "y")}
    _require_clock(problem, problem.values(gains=plane.gains, parameters=plane.parameters), plane)
    return replace(plane, x=axes["x"], y=axes["y"], until=plane.time)


def require_refinement(plane: Plane, refine: int) -> None:
    """Reject a refinement that is not valid.

    Raises:
        InputError: If it is not a whole number from 0 to 10, or the finest grid has too many
            points.
    """
    if type(refine) is not int or not 0 <= refine <= MOST_HALVINGS:
        wanted = f"must be a whole number from 0 to {MOST_HALVINGS}"
        raise InputError(f"Argument `refine` {wanted}, but it is {shown(refine)}.")
    count = fine_count(plane.x.count, refine) * fine_count(plane.y.count, refine)
    if count > _MOST:
        wanted = f"must lead to at most {_MOST} points in the finest grid"
        raise InputError(f"Argument `refine` {wanted}, not {count}.")


def require_free_states(plane: Plane, fixed: Collection[str]) -> None:
    """Reject an initial value of a state that is an axis.

    Args:
        plane: The plane.
        fixed: Names of states with initial values.

    Raises:
        InputError: If the name of an axis is among ``fixed``.
    """
    for side, axis in (("x", plane.x), ("y", plane.y)):
        if axis.name in fixed:
            message = f"must name a free quantity, but `{axis.name}` has an initial value"
            raise InputError(f"Argument `{side}` {message}.")


_OFF = 1e-9
"""Distance of an initial state from its clock's circle that is larger than rounding."""


def _require_clock(problem: Problem, values: ParameterValues, plane: Plane) -> None:
    """Reject an initial state off the circle of the clock, with the error message of a simulation.

    Raises:
        InputError: If the state is off the circle. The message names the two states of the clock.
    """
    first, start = problem.first_system(values), np.array(plane.start)
    if first.clock and abs(first.holonomic(start)[-1]) > _OFF:
        simulate(problem.system(values), start, until=1.0)


def _checked(problem: Problem, plane: Plane, side: str) -> Axis:
    axis = plane.x if side == "x" else plane.y
    every = (*problem.names, *problem.state_names)
    if axis.name not in every:
        raise InputError(unknown(side, axis.name, every))
    if axis.name in problem.state_names and axis.name not in problem.names:
        unit = _unit_of_state(problem, axis, side)
    else:
        unit = problem.require_range(axis.name, (axis.lower, axis.upper), argument=side).unit
    if axis.name in {**plane.gains, **plane.parameters}:
        message = f"must name a free quantity, but `{axis.name}` is fixed"
        raise InputError(f"Argument `{side}` {message}.")
    if axis.count < _LEAST:
        message = f"must be at least {_LEAST}x{_LEAST}, but one of them is {axis.count}"
        raise InputError(f"Argument `points` {message}.")
    return replace(axis, unit=unit)


def _unit_of_state(problem: Problem, axis: Axis, side: str) -> str:
    """Return the unit of an initial state on an axis.

    Raises:
        InputError: If its bounds are not a range, or the state is part of the clock.
    """
    low, high = (any_number(side, end) for end in (axis.lower, axis.upper))
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        wanted = f"must have finite bounds LOWER < UPPER for `{axis.name}`"
        raise InputError(f"Argument `{side}` {wanted}, but they are {low:g}:{high:g}.")
    place = problem.state_names.index(axis.name)
    if place in problem.clock:
        wanted = "must not be a state of the clock, which stays on its circle"
        raise InputError(f"Argument `{side}` {wanted}, but it is `{axis.name}`.")
    return problem.state_units[place]
