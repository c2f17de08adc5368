"""Maps of a plane of gains, parameters or states: the attractors at the points of a grid."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from zeno_orbits.arrays import Rows, Vector
from zeno_orbits.errors import InputError, shown
from zeno_orbits.maps.attractors import (
    Attractor,
    AttractorClass,
    attractor_from_json,
    attractor_json,
)
from zeno_orbits.maps.plane import Axis, Plane, require_plane, require_refinement
from zeno_orbits.maps.refinement import Place, fine_count, inherited, refined
from zeno_orbits.model import ProblemFile, RecordedFile
from zeno_orbits.orbits import digest_of
from zeno_orbits.simulation import compile_formulas, simulator_in_use
from zeno_orbits.work import (
    Columns,
    ExecutionPlan,
    FailedPoint,
    Pool,
    Progress,
    TableRepr,
    Workers,
    by_name,
    checked,
    claim_checkpoint,
    open_pool,
    parallel_map,
    parts_told_to,
    silent,
    versions,
)

FORMAT = 1
"""Version of the file format for writing, and the newest version for reading."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Boundary:
    """A bifurcation curve in a plane.

    Attributes:
        name: Kind of the boundary.
        points: Points along the curve, ``(m, 2)``.
    """

    name: str
    points: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class BetweenPoint:
    """A point of a refinement, between the points of the grid.

    Attributes:
        row: Row in the finest grid, from below.
        column: Column in the finest grid.
        attractor: The attractor.
    """

    row: int
    column: int
    attractor: Attractor


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class ParameterMap(TableRepr):
    """The attractors over a plane.

    Attributes:
        problem: Name of the problem.
        x: The horizontal axis.
        y: The vertical axis.
        gains: Gains that differ from their defaults.
        parameters: Parameters that differ from their defaults.
        start: Initial state of every motion, by name.
        until: Longest simulated time of each motion [s].
        attractors: Attractor of each point, row by row from below, ``(n_y * n_x,)``.
        versions: Program name to version, for the programs that computed the map.
        orbits: The distinct orbits with which motions were compared.
        refine: Number of halvings of cells along boundaries.
        between: The points of the refinement, in the order of their computation.
        problem_digest: Digest of the equations of the problem, empty in files of earlier versions.
        problem_file: File of the problem, or None if the problem is bundled. Not compared.
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
    orbits: tuple[Attractor, ...] = ()
    refine: int = 0
    between: tuple[BetweenPoint, ...] = ()
    problem_digest: tuple[float, ...] = ()
    problem_file: RecordedFile | None = field(default=None, compare=False)

    def __repr__(self) -> str:
        """Return one line: the axes, and the number of points per attractor."""
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
        """Return the number of points per attractor."""
        counts = Counter(one.phrase for one in self.attractors).most_common()
        return {"settles to": [phrase for phrase, _ in counts], "points": [n for _, n in counts]}

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns, ``(n_y, n_x)``."""
        return self.y.count, self.x.count

    def numbers(self, name: str) -> Vector:
        """Return a value of every attractor by its name in ``Attractor``, ``(n_y, n_x)``.

        Raises:
            InputError: If an attractor lacks a value of this name.
        """
        try:
            values = [float(getattr(attractor, name)) for attractor in self.attractors]
        except (AttributeError, TypeError, ValueError) as error:
            wanted = "must be a number of an attractor, such as `period`"
            raise InputError(f"Argument `name` {wanted}, but it is {shown(name)}.") from error
        return np.reshape(values, self.shape)

    @checked
    def margin(self, name: str) -> Vector:
        """Return a margin of every attractor, NaN if it is missing, ``(n_y, n_x)``."""
        values = [attractor.margins.get(name, math.nan) for attractor in self.attractors]
        return np.reshape(values, self.shape)

    def finest(self) -> tuple[Axis, Axis, tuple[Attractor, ...]]:
        """Return the axes of the finest grid and the attractors there, row by row from below.

        A point that is not near a boundary has the attractor of a corner of its cell.
        """
        x, y = (
            replace(axis, count=fine_count(axis.count, self.refine)) for axis in (self.x, self.y)
        )
        if not self.refine:
            return x, y, self.attractors
        every = (*self.attractors, *(one.attractor for one in self.between))
        index: Rows = np.reshape(np.arange(len(self.attractors), dtype=np.intp), self.shape)
        added = np.array([(one.row, one.column) for one in self.between]).reshape(-1, 2)
        for level in range(1, self.refine + 1):
            step = 2 ** (self.refine - level)
            index = inherited(index)
            for k in np.flatnonzero(np.all(added % step == 0, axis=1)).tolist():
                index[tuple(added[k] // step)] = len(self.attractors) + k
        places: list[int] = index.ravel().tolist()
        return x, y, tuple(every[k] for k in places)

    @property
    def has_zeno(self) -> bool:
        """True if an attractor is a Zeno periodic orbit or a simple periodic orbit."""
        return any(
            one.fate in (AttractorClass.ZENO, AttractorClass.SIMPLE) for one in self.attractors
        )

    def header(self) -> dict[str, Any]:
        """Return the map without its points, as plain data."""
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
            **({"problem_digest": list(self.problem_digest)} if self.problem_digest else {}),
            **({"orbits": [attractor_json(one) for one in self.orbits]} if self.orbits else {}),
            **({"refine": self.refine} if self.refine else {}),
        }

    def as_json(self) -> dict[str, Any]:
        """Return the map as the plain data of its file."""
        points = [attractor_json(one) for one in self.attractors]
        between = {"between": self.between_json()} if self.refine else {}
        return {**self.header(), **between, "points": points}

    def between_json(self) -> list[dict[str, Any]]:
        """Return the points of the refinement as plain data."""
        return [
            {"row": one.row, "column": one.column, **attractor_json(one.attractor)}
            for one in self.between
        ]


def map_of_plane(
    plane: Plane, plan: ExecutionPlan, *, refine: int = 0, on_progress: Progress = silent
) -> ParameterMap:
    """Compute the map of a plane.

    In a plane of two states, orbits are first identified from a few points. All motions are then
    compared with these orbits.

    Args:
        plane: The plane.
        plan: Executor and checkpoint of the work. Its identity is completed here.
        refine: Number of halvings of cells along boundaries.
        on_progress: Called with the number of finished points.

    Raises:
        InputError: If the plane, the executor or the checkpoint is not usable, or the problem does
            not have a file although other processes need it.
        WorkError: If the work cannot be finished.
    """
    plane = require_plane(plane)
    require_refinement(plane, refine)
    problem = plane.problem
    _compile_first(plane, on_progress)
    with ExitStack() as stack:
        several = refine > 0 or plane.has_fixed_numbers
        pool = None
        if several and isinstance(plane.source, ProblemFile):
            pool = stack.enter_context(open_pool(plan.place))
        stages = _Stages(plane, plan, refine, on_progress, pool)
        if plane.has_fixed_numbers:
            plane = plane.known_among(stages.attractors(plane, _sample(plane), "sample"))
        found = stages.attractors(plane, plane.points(), "points")
        between = _between(plane, found, refine, stages) if refine else ()
    return ParameterMap(
        problem=problem.name,
        x=plane.x,
        y=plane.y,
        gains=plane.gains,
        parameters=plane.parameters,
        start=dict(zip(problem.state_names, plane.start, strict=True)),
        until=plane.time,
        attractors=found,
        versions=versions(),
        orbits=tuple(one.attractor for one in plane.known),
        refine=refine,
        between=between,
        problem_digest=digest_of(problem),
        problem_file=RecordedFile.of(problem),
    )


_COMPILED = 250
"""Points of a grid from which compiled formulas save more time than their compilation takes. At a
point of the reference problem they save 2.5 ms, where the compilation takes 0.5 s."""


def _compile_first(plane: Plane, on_progress: Progress) -> None:
    """Compile the formulas of a problem if its plane is large. All digits remain the same.

    Without a working compiler, the tapes are used.
    """
    if plane.x.count * plane.y.count >= _COMPILED:
        on_progress("compiling formulas", None)
        compile_formulas(plane.problem.compiled_graph())


_SAMPLE = 6
"""Number of points along an axis for the identification of orbits."""


def _sample(plane: Plane) -> tuple[tuple[float, float], ...]:
    """Return points of the grid, evenly distributed."""

    def some(axis: Axis) -> list[float]:
        places: list[int] = np.linspace(0, axis.count - 1, _SAMPLE).astype(int).tolist()
        return [axis.values()[k] for k in sorted(set(places))]

    return tuple((x, y) for y in some(plane.y) for x in some(plane.x))


def _between(
    plane: Plane, found: Sequence[Attractor], refine: int, stages: _Stages
) -> tuple[BetweenPoint, ...]:
    """Return the points of the refinement."""
    x, y = (
        replace(axis, count=fine_count(axis.count, refine)).values() for axis in (plane.x, plane.y)
    )
    added: list[BetweenPoint] = []

    def classes_at(level: int, places: Sequence[Place]) -> list[str]:
        step = 2 ** (refine - level)
        fine: list[Place] = [(row * step, column * step) for row, column in places]
        points = [(x[column], y[row]) for row, column in fine]
        attractors = stages.attractors(plane, points, f"level-{level}-{len(added)}")
        added.extend(
            BetweenPoint(row=row, column=column, attractor=one)
            for (row, column), one in zip(fine, attractors, strict=True)
        )
        return [one.phrase for one in attractors]

    shape = (plane.y.count, plane.x.count)
    refined([one.phrase for one in found], shape, refine, classes_at)
    return tuple(added)


@dataclass(frozen=True, slots=True)
class _Stages:
    """The stages of a map. Each stage is distributed over the workers, and has its own folder.

    A map with a single stage uses the folder of the checkpoint itself.
    """

    plane: Plane
    plan: ExecutionPlan
    refine: int
    on_progress: Progress
    pool: Pool | None

    def attractors(
        self, task: Plane, points: Sequence[tuple[float, float]], stage: str
    ) -> tuple[Attractor, ...]:
        """Return the attractors at some points."""
        source = self.plane.source
        if not isinstance(source, ProblemFile):
            return tuple(map(_found, _computed_here(task, points, self.plan, self.on_progress)))
        identity = {**_identity(self.plane, source), **self.plan.identity}
        plan = replace(self.plan, identity=identity)
        if self.refine or self.plane.has_fixed_numbers:
            identity = {**identity, "refine": self.refine}
            claim_checkpoint(replace(plan, identity=identity))
            folder = None if plan.checkpoint is None else plan.checkpoint / stage
            plan = replace(plan, identity={**identity, "stage": stage}, checkpoint=folder)
        results = parallel_map(task, points, plan, on_progress=self.on_progress, pool=self.pool)
        return tuple(map(_found, results))


def _computed_here(
    plane: Plane, points: Sequence[tuple[float, float]], plan: ExecutionPlan, on_progress: Progress
) -> list[Any]:
    """Compute the points of a plane in this process, for a problem without a file.

    Raises:
        InputError: If the plan has other processes or a checkpoint, which need the file.
    """
    if plan.place != Workers(count=1) or plan.checkpoint is not None:
        wanted = "must be a name or a file where workers or a checkpoint are used"
        raise InputError(f"Argument `problem` {wanted}, but it is an object.")
    results = list[Any]()

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
        "simulator": simulator_in_use(),
        "versions": versions(),
    }


def _found(result: Any) -> Attractor:
    if isinstance(result, FailedPoint):
        return Attractor(fate=AttractorClass.FAILED, detail=result.reason)
    return attractor_from_json(result)


def _axis_json(axis: Axis) -> dict[str, Any]:
    return {
        "name": axis.name,
        "lower": axis.lower,
        "upper": axis.upper,
        "count": axis.count,
        "unit": axis.unit,
    }
