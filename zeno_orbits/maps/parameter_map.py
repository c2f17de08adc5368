"""Maps of a plane of two gains or parameters: what motions settle to at the points of a grid."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.maps.attractors import Attractor, Fate, attractor_from_json, attractor_json
from zeno_orbits.maps.classify import attractors_at
from zeno_orbits.model.library import ProblemFile
from zeno_orbits.model.problem import ParameterValues, Problem
from zeno_orbits.work import Lost, Plan, Progress, silent, spread
from zeno_orbits.work.versions import versions

FORMAT = 1
"""Version of the file format that this code writes, and the newest that it reads."""
_CHUNKS = 4
_SMALLEST, _LARGEST = 16, 1250
"""Points that advance together: many, so that the last few motions to settle cost little."""
_LEAST = 2
"""Points along an axis."""
_MOST = 10_000_000
"""Points of a plane: a day of work for a hundred cores, and gigabytes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Axis:
    """One direction of the plane.

    Attributes:
        name: A gain or a parameter.
        lower: Where it starts.
        upper: Where it ends.
        count: Points along it, both ends included.
        unit: Of the gain or parameter.
    """

    name: str
    lower: float
    upper: float
    count: int
    unit: str = "1"

    def values(self) -> tuple[float, ...]:
        """Return the grid along it, ``(count,)``."""
        return tuple(np.linspace(self.lower, self.upper, self.count).tolist())


@dataclass(frozen=True, slots=True, kw_only=True)
class Plane:
    """A plane through the numbers of a problem.

    Attributes:
        problem: The problem.
        x: The axis across.
        y: The axis upwards.
        gains: Gains elsewhere than at their defaults, but for those of the axes.
        parameters: Parameters, likewise. What is derived from others is derived at every point.
        start: State at which every motion starts, ``(n_x,)``.
        until: How long a motion may take to settle [s].
    """

    problem_file: ProblemFile
    x: Axis
    y: Axis
    gains: Mapping[str, float] = field(default_factory=dict[str, float])
    parameters: Mapping[str, float] = field(default_factory=dict[str, float])
    start: tuple[float, ...]
    until: float = 60.0

    def __call__(self, points: Sequence[Sequence[float]]) -> list[dict[str, Any]]:
        """Return the attractors at some points as plain data: the task of a worker."""
        problem = self.problem_file.load()
        settings: dict[int, ParameterValues] = {}
        found: dict[int, Attractor] = {}
        for k, (x, y) in enumerate(points):
            try:
                settings[k] = self.values(problem, x, y)
            except InputError as error:
                # An axis is inside its range, but what is derived from it need not be.
                found[k] = Attractor(fate=Fate.FAILED, detail=str(error))
        start = dict(zip(problem.state_names, self.start, strict=True))
        attractors = attractors_at(problem, tuple(settings.values()), start=start, until=self.until)
        found |= dict(zip(settings, attractors, strict=True))
        return [attractor_json(found[k]) for k in range(len(points))]

    def points(self) -> tuple[tuple[float, float], ...]:
        """Return the points of the grid, row by row from below."""
        return tuple((x, y) for y in self.y.values() for x in self.x.values())

    def values(self, problem: Problem, x: float, y: float) -> ParameterValues:
        """Return the numbers at a point.

        Raises:
            InputError: If the problem refuses them.
        """
        point = {self.x.name: x, self.y.name: y}
        return problem.values(gains=self.gains, parameters=self.parameters, numbers=point)


def chunk_of(plane: Plane) -> int:
    """Return how many points of a plane to compute together, whoever computes them."""
    quarter = math.ceil(plane.x.count * plane.y.count / _CHUNKS)
    return min(max(quarter, _SMALLEST), _LARGEST)


def require_plane(plane: Plane) -> Plane:
    """Return a plane with its units, or say what is wrong with it.

    Raises:
        InputError: If a name is unknown or given twice, bounds are the wrong way round or out of
            the parameter's range, there are too few points or too many, or no time.
    """
    problem = plane.problem_file.load()
    if not (math.isfinite(plane.until) and plane.until > 0.0):
        wanted = "must be a positive number of seconds"
        raise InputError(f"Argument `until` {wanted}, but it is {plane.until:g}.")
    if plane.x.name == plane.y.name:
        message = f"must be another gain or parameter than `x`, but both are `{plane.x.name}`"
        raise InputError(f"Argument `y` {message}.")
    count = plane.x.count * plane.y.count
    if count > _MOST:
        raise InputError(f"Argument `points` must ask for at most {_MOST} points, not {count}.")
    axes = {name: _checked(problem, plane, name) for name in ("x", "y")}
    problem.values(gains=plane.gains, parameters=plane.parameters)
    return replace(plane, x=axes["x"], y=axes["y"])


def _checked(problem: Problem, plane: Plane, side: str) -> Axis:
    axis = plane.x if side == "x" else plane.y
    quantity = problem.require_range(axis.name, (axis.lower, axis.upper), argument=side)
    if axis.name in {**plane.gains, **plane.parameters}:
        message = f"must name what is not fixed, but `{axis.name}` is"
        raise InputError(f"Argument `{side}` {message}.")
    if axis.count < _LEAST:
        message = f"must be at least {_LEAST}x{_LEAST}, but one of them is {axis.count}"
        raise InputError(f"Argument `points` {message}.")
    return replace(axis, unit=quantity.unit)


@dataclass(frozen=True, slots=True, kw_only=True)
class Boundary:
    """A curve in a plane, on which something ends or begins.

    Attributes:
        name: What.
        points: Along the curve, ``(m, 2)``.
    """

    name: str
    points: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class ParameterMap:
    """What motions settle to over a plane.

    Attributes:
        problem: Name of the problem.
        x: The axis across.
        y: The axis upwards.
        gains: Gains elsewhere than at their defaults.
        parameters: Parameters, likewise.
        start: State at which every motion starts, by name.
        until: How long each was followed [s].
        attractors: One a point, row by row from below, ``(n_y * n_x,)``.
        versions: Name to version of what computed it.
    """

    problem: str
    x: Axis
    y: Axis
    gains: Mapping[str, float]
    parameters: Mapping[str, float]
    start: Mapping[str, float]
    until: float
    attractors: tuple[Attractor, ...]
    versions: Mapping[str, str]

    def __repr__(self) -> str:
        """Return one line: the axes, and how many points settle to what."""
        axes = ", ".join(
            f"{axis.name} from {axis.lower:g} to {axis.upper:g} in {axis.count} points"
            for axis in (self.x, self.y)
        )
        counts = Counter(attractor.fate.value for attractor in self.attractors)
        found = ", ".join(f"{phrase}: {count}" for phrase, count in counts.most_common())
        return f"<ParameterMap of {self.problem}: {axes}; {found}>"

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns, ``(n_y, n_x)``."""
        return self.y.count, self.x.count

    def numbers(self, name: str) -> Vector:
        """Return a number of every attractor by its name in ``Attractor``, ``(n_y, n_x)``."""
        values = [float(getattr(attractor, name)) for attractor in self.attractors]
        return np.reshape(values, self.shape)

    def margin(self, name: str) -> Vector:
        """Return a margin of every attractor, NaN where it has none, ``(n_y, n_x)``."""
        values = [attractor.margins.get(name, math.nan) for attractor in self.attractors]
        return np.reshape(values, self.shape)

    @property
    def has_zeno(self) -> bool:
        """Whether a motion settles to a Zeno periodic orbit or a simple one somewhere."""
        return any(one.fate in (Fate.ZENO, Fate.SIMPLE) for one in self.attractors)

    def header(self) -> dict[str, Any]:
        """Return all but the points as plain data."""
        return {
            "format": FORMAT,
            "problem": self.problem,
            "x": _axis_json(self.x),
            "y": _axis_json(self.y),
            "gains": dict(self.gains),
            "parameters": dict(self.parameters),
            "start": dict(self.start),
            "until": self.until,
            "versions": dict(self.versions),
        }

    def as_json(self) -> dict[str, Any]:
        """Return the map as the plain data of its file."""
        return {**self.header(), "points": [attractor_json(one) for one in self.attractors]}


def parameter_map(plane: Plane, plan: Plan, *, on_progress: Progress = silent) -> ParameterMap:
    """Return the map of a plane.

    Args:
        plane: The plane.
        plan: Where to compute and where to keep what is finished; its identity is filled in.
        on_progress: Called with the number of points done.

    Raises:
        InputError: If the plane, the place or the checkpoint is not usable.
        WorkError: If the work cannot be finished.
    """
    plane = require_plane(plane)
    problem = plane.problem_file.load()
    whole = replace(plan, identity={**_identity(plane, problem), **plan.identity})
    results = spread(plane, plane.points(), whole, on_progress=on_progress)
    return ParameterMap(
        problem=problem.name,
        x=plane.x,
        y=plane.y,
        gains=plane.gains,
        parameters=plane.parameters,
        start=dict(zip(problem.state_names, plane.start, strict=True)),
        until=plane.until,
        attractors=tuple(_found(result) for result in results),
        versions=versions(),
    )


def _identity(plane: Plane, problem: Problem) -> dict[str, Any]:
    return {
        "work": "map",
        "problem": problem.name,
        "problem_digest": plane.problem_file.digest,
        "x": _axis_json(plane.x),
        "y": _axis_json(plane.y),
        "gains": dict(plane.gains),
        "parameters": dict(plane.parameters),
        "start": list(plane.start),
        "until": plane.until,
        "versions": versions(),
    }


def _found(result: Any) -> Attractor:
    if isinstance(result, Lost):
        return Attractor(fate=Fate.FAILED, detail=result.reason)
    return attractor_from_json(result)


def _axis_json(axis: Axis) -> dict[str, Any]:
    return {
        "name": axis.name,
        "lower": axis.lower,
        "upper": axis.upper,
        "count": axis.count,
        "unit": axis.unit,
    }
