"""Maps of a plane of two gains or parameters: what motions settle to at the points of a grid."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.maps.attractors import Attractor, Fate, attractor_from_json, attractor_json
from zeno_orbits.maps.plane import Axis, Plane, require_plane
from zeno_orbits.model import ProblemFile
from zeno_orbits.work import (
    Columns,
    Displayed,
    LostPoint,
    Plan,
    Progress,
    Workers,
    by_name,
    parts_told_to,
    silent,
    spread,
    versions,
)

FORMAT = 1
"""Version of the file format that this code writes, and the newest that it reads."""


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
class ParameterMap(Displayed):
    """The attractors over a plane.

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

    def _columns(self) -> Columns:
        """Return the points, row by row from below."""
        x, y = np.meshgrid(self.x.values(), self.y.values())
        return {
            self.x.name: x.ravel(),
            self.y.name: y.ravel(),
            "settles_to": [one.phrase for one in self.attractors],
            "returns": [one.returns for one in self.attractors],
            "period": [one.period for one in self.attractors],
            "spectral_radius": [one.spectral_radius for one in self.attractors],
            **by_name([one.margins for one in self.attractors]),
            **by_name([one.state for one in self.attractors]),
        }

    def _shown_columns(self) -> Columns:
        """Return how many points settle to what."""
        counts = Counter(one.phrase for one in self.attractors).most_common()
        return {"settles to": [phrase for phrase, _ in counts], "points": [n for _, n in counts]}

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
        """True if a motion settles to a Zeno periodic orbit or a simple one somewhere."""
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
        InputError: If the plane, the place or the checkpoint is not usable, or the
            problem has no file where other processes need it.
        WorkError: If the work cannot be finished.
    """
    plane = require_plane(plane)
    problem = plane.problem
    if isinstance(plane.source, ProblemFile):
        identity = {**_identity(plane, plane.source), **plan.identity}
        whole = replace(plan, identity=identity)
        results = spread(plane, plane.points(), whole, on_progress=on_progress)
    else:
        results = _computed_here(plane, plan, on_progress)
    return ParameterMap(
        problem=problem.name,
        x=plane.x,
        y=plane.y,
        gains=plane.gains,
        parameters=plane.parameters,
        start=dict(zip(problem.state_names, plane.start, strict=True)),
        until=plane.time,
        attractors=tuple(_found(result) for result in results),
        versions=versions(),
    )


def _computed_here(plane: Plane, plan: Plan, on_progress: Progress) -> list[Any]:
    """Return the results at the points of a plane whose problem has no file: by this process.

    Raises:
        InputError: If other processes or a checkpoint are asked for; both need the file.
    """
    if plan.place != Workers(count=1) or plan.checkpoint is not None:
        wanted = "must be a name or a file where workers or a checkpoint are used"
        raise InputError(f"Argument `problem` {wanted}, but it is an object.")
    points, results = plane.points(), list[Any]()

    def tell(part: float) -> None:
        done = len(results) + part * min(plan.chunk, len(points) - len(results))
        on_progress(f"{int(done)} of {len(points)} {plan.noun}", done / len(points))

    for k in range(0, len(points), plan.chunk):
        with parts_told_to(tell):
            found = plane(points[k : k + plan.chunk])
        results += found
        tell(0.0)
    return results


def _identity(plane: Plane, file: ProblemFile) -> dict[str, Any]:
    return {
        "work": "map",
        "problem": plane.problem.name,
        "problem_digest": file.digest,
        "x": _axis_json(plane.x),
        "y": _axis_json(plane.y),
        "gains": dict(plane.gains),
        "parameters": dict(plane.parameters),
        "start": list(plane.start),
        "until": plane.until,
        "versions": versions(),
    }


def _found(result: Any) -> Attractor:
    if isinstance(result, LostPoint):
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
