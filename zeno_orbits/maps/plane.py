"""The plane of a map: two axes through the numbers of a problem, and how to look at its points."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from zeno_orbits.errors import InputError
from zeno_orbits.maps.attractors import Attractor, Fate, attractor_json
from zeno_orbits.maps.classify import attractors_at, usual_time
from zeno_orbits.model import ParameterValues, Problem, ProblemFile
from zeno_orbits.work import Workers, tell_part, worker_count

_CHUNKS, _CHUNKS_A_CORE = 4, 2
"""Chunks of a plane at least, and for each core."""
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
        source: The problem itself, or its file where other processes have to load it.
        x: The axis across.
        y: The axis upwards.
        gains: Gains elsewhere than at their defaults, but for those of the axes.
        parameters: Parameters, likewise. What is derived from others is derived at every point.
        start: State at which every motion starts, ``(n_x,)``.
        until: How long a motion may take to settle [s]; ``None`` for the usual time of the
            slowest corner.
    """

    source: Problem | ProblemFile
    x: Axis
    y: Axis
    gains: Mapping[str, float] = field(default_factory=dict[str, float])
    parameters: Mapping[str, float] = field(default_factory=dict[str, float])
    start: tuple[float, ...]
    until: float | None = None

    @property
    def problem(self) -> Problem:
        """The problem, the same object every time in one process."""
        return self.source.load() if isinstance(self.source, ProblemFile) else self.source

    @property
    def time(self) -> float:
        """Time that a motion may take to settle [s]."""
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
            points: Each ``(x, y)``.
        """
        problem = self.problem
        known: dict[int, ParameterValues] = {}
        found: dict[int, Attractor] = {}
        for k, (x, y) in enumerate(points):
            try:
                known[k] = self.values(x, y)
            except InputError as error:
                # An axis is inside its range, but what is derived from it need not be.
                found[k] = Attractor(fate=Fate.FAILED, detail=str(error))
        start = dict(zip(problem.state_names, self.start, strict=True))
        attractors = attractors_at(
            problem,
            tuple(known.values()),
            start=start,
            until=self.time,
            on_progress=lambda _stage, part: tell_part(part or 0.0),
        )
        found |= dict(zip(known, attractors, strict=True))
        return [attractor_json(found[k]) for k in range(len(points))]

    def points(self) -> tuple[tuple[float, float], ...]:
        """Return the points of the grid, row by row from below."""
        return tuple((x, y) for y in self.y.values() for x in self.x.values())

    def values(self, x: float, y: float) -> ParameterValues:
        """Return the numbers at a point.

        Args:
            x: Number of the axis across.
            y: Number of the axis upwards.

        Raises:
            InputError: If the problem refuses them.
        """
        problem = self.problem
        point = {self.x.name: x, self.y.name: y}
        return problem.values(gains=self.gains, parameters=self.parameters, numbers=point)


def chunk_of(plane: Plane, cores: int | None = None) -> int:
    """Return how many points of a plane to compute together.

    It depends on the machine, and not on how many of its cores take part, so a checkpoint serves
    any number of workers. What a point settles to does not depend on its company.

    Args:
        plane: The plane.
        cores: Cores of the machine; by default those of this one.
    """
    cores = worker_count(Workers()) if cores is None else cores
    part = math.ceil(plane.x.count * plane.y.count / max(_CHUNKS, _CHUNKS_A_CORE * cores))
    return min(max(part, _SMALLEST), _LARGEST)


def require_plane(plane: Plane) -> Plane:
    """Return a plane with its units and the time to wait; refuse one that makes no sense.

    Raises:
        InputError: If a name is unknown or given twice, bounds are the wrong way round or out of
            the parameter's range, there are too few points or too many, or no time.
    """
    problem = plane.problem
    if plane.until is not None and not (math.isfinite(plane.until) and plane.until > 0.0):
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
    return replace(plane, x=axes["x"], y=axes["y"], until=plane.time)


def _checked(problem: Problem, plane: Plane, side: str) -> Axis:
    axis = plane.x if side == "x" else plane.y
    quantity = problem.require_range(axis.name, (axis.lower, axis.upper), argument=side)
    if axis.name in {**plane.gains, **plane.parameters}:
        message = f"must name what is not fixed, but `{axis.name}` is fixed"
        raise InputError(f"Argument `{side}` {message}.")
    if axis.count < _LEAST:
        message = f"must be at least {_LEAST}x{_LEAST}, but one of them is {axis.count}"
        raise InputError(f"Argument `points` {message}.")
    return replace(axis, unit=quantity.unit)
