"""Whether a map agrees with long simulations at random points of the Kp-Kd plane.

A map is computed by the fast function, and 500 random points of its grid are simulated for
several times as long by `tests.reference.long_simulation`, which shares the model with it and
nothing else. Fates must be the same, and for periodic ones the number of releases, the period and
the spectral radius to their tolerances. Listed and excused are a point within one cell of a
boundary, where a neighbour in the map has another fate or a closer look at its cells finds that
of the long run, and one where the long run has not settled but moves as the map says.

Exit 1 if another point disagrees.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.reference.long_simulation import LongRun, attractor_of
from zeno_orbits.maps.attractors import (
    Attractor,
    AttractorClass,
    attractor_from_json,
    attractor_json,
)
from zeno_orbits.maps.map_file import read_map, write_map
from zeno_orbits.maps.mapping import ParameterMap, map_of_plane
from zeno_orbits.maps.plane import Axis, Plane
from zeno_orbits.model.library import locate_problem
from zeno_orbits.report import terminal as report
from zeno_orbits.work import ExecutionPlan, parallel_map

Fast = Callable[[Plane, ExecutionPlan], ParameterMap]
"""What is tested: from a plane to its map."""

LONGER = 5.0
"""Times as long as the map follows a motion at most, it is followed here."""
PERIOD, RADIUS = 1e-6, 1e-3
"""Largest difference of periods, relative, and of spectral radii: those of a long run, with room.

It stops at a part 1e-6 from the orbit, and takes multipliers by differences over 1e-4.
"""


SLOW = 0.01
"""Growth a return of a motion that is still on its way to an orbit."""

CLOSER = 9
"""Points along each side of the closer look at the four cells around a point."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """One point of both.

    Attributes:
        point: ``(x, y)``.
        fast: What the map says.
        slow: What the long simulation says.
        near_boundary: Whether a boundary runs within one cell.
    """

    point: tuple[float, float]
    fast: Attractor
    slow: Attractor
    near_boundary: bool

    @property
    def agrees(self) -> bool:
        """Whether both say the same."""
        fast, slow = self.fast, self.slow
        if _kind(fast) != _kind(slow):
            return False
        if fast.fate not in (AttractorClass.ZENO, AttractorClass.SIMPLE):
            return True
        period = abs(fast.period - slow.period) <= PERIOD * slow.period
        return period and abs(fast.spectral_radius - slow.spectral_radius) <= RADIUS

    @property
    def undecided(self) -> bool:
        """Whether the long run has not settled either way, and its trend is that of the map."""
        fast, slow = self.fast, self.slow
        if slow.fate is not AttractorClass.UNSETTLED:
            return False
        if fast.fate is AttractorClass.REST:
            return slow.trend < 1.0
        return (
            fast.fate in (AttractorClass.ZENO, AttractorClass.SIMPLE)
            and abs(slow.trend - 1.0) < SLOW
        )

    def line(self) -> str:
        """Return the point in words."""
        x, y = self.point
        return f"({x:.6g}, {y:.6g}): map {_words(self.fast)}; long run {_words(self.slow)}"


def _words(one: Attractor) -> str:
    numbers = f" T = {one.period:.10g}, radius {one.spectral_radius:.4g}" if one.returns else ""
    trend = f" x{one.trend:.4g}" if one.fate is AttractorClass.UNSETTLED else ""
    return f"{one.phrase}{numbers}{trend}"


def _kind(one: Attractor) -> str:
    return f"{one.fate.name} {one.returns} {one.escaped}"


def near_boundary(found: ParameterMap, index: int) -> bool:
    """Return True if one of the eight neighbours of a point has another fate."""
    grid = np.array([_kind(one) for one in found.attractors]).reshape(found.shape)
    row, column = divmod(index, found.x.count)
    around = grid[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
    return bool(np.any(around != grid[row, column]))


def cells_around(plane: Plane, point: tuple[float, float]) -> Plane:
    """Return the four cells around a point of a plane, as a finer plane."""

    def around(axis: Axis, middle: float) -> Axis:
        step = (axis.upper - axis.lower) / (axis.count - 1)
        return replace(axis, lower=middle - step, upper=middle + step, count=CLOSER)

    return replace(plane, x=around(plane.x, point[0]), y=around(plane.y, point[1]))


def looked_at_closer(one: Comparison, plane: Plane, fast: Fast) -> Comparison:
    """Return a comparison that knows whether the cells around have the long run's fate too.

    Between chaotic motions boundaries lie closer than any grid, and neighbours agree by chance.
    """
    if one.agrees or one.undecided or one.near_boundary:
        return one
    seen = {
        _kind(other) for other in fast(cells_around(plane, one.point), ExecutionPlan()).attractors
    }
    return replace(one, near_boundary=_kind(one.slow) in seen and len(seen) > 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class LongRuns:
    """The long runs at points of a plane: the task of a worker."""

    plane: Plane
    run: LongRun

    def __call__(self, points: Sequence[Sequence[float]]) -> list[dict[str, Any]]:
        """Return the attractors at some points as plain data."""
        problem = self.plane.problem
        settings = [self.plane.values(x, y) for x, y in points]
        found = [attractor_of(problem, one, self.plane.start, run=self.run) for one in settings]
        return [attractor_json(one) for one in found]


def compare(found: ParameterMap, task: LongRuns, indices: Sequence[int]) -> list[Comparison]:
    """Return both answers at some points of a map; the long runs are spread over all cores."""
    points = [task.plane.points()[k] for k in indices]
    with report.ProgressLine(lambda: None) as progress:
        slow = parallel_map(task, points, ExecutionPlan(chunk=4), on_progress=progress)
    return [
        Comparison(
            point=point,
            fast=found.attractors[k],
            slow=attractor_from_json(answer),
            near_boundary=near_boundary(found, k),
        )
        for k, point, answer in zip(indices, points, slow, strict=True)
    ]


def computed(plane: Plane, plan: ExecutionPlan) -> ParameterMap:
    """Return the map by the package's own function."""
    with report.ProgressLine(lambda: None) as progress:
        return map_of_plane(plane, plan, on_progress=progress)


def main(fast: Fast = computed) -> int:
    """Compare and print."""
    options = _options()
    plane = Plane(
        source=locate_problem("motor_pendulum"),
        x=Axis(name="Kp", lower=1.0, upper=5.0, count=options.grid),
        y=Axis(name="Kd", lower=-2.0, upper=0.0, count=options.grid),
        start=(0.6, 0.0, 0.0, 0.0, 0.0),
        until=options.until,
    )
    if options.map is None:
        found = fast(plane, ExecutionPlan())
    else:
        found = read_map(options.map)
        plane = replace(plane, x=found.x, y=found.y, until=found.until)
    if options.write is not None:
        write_map(found, options.write)
    random = np.random.default_rng(options.seed)
    drawn = random.choice(len(found.attractors), size=options.points, replace=False)
    task = LongRuns(plane=plane, run=LongRun(until=LONGER * plane.until))
    compared = compare(found, task, [int(k) for k in sorted(drawn)])
    compared = [looked_at_closer(one, plane, fast) for one in compared]
    return _tell(compared, as_json=options.json)


def _tell(compared: Sequence[Comparison], *, as_json: bool) -> int:
    off = [one for one in compared if not one.agrees]
    open_ = [one for one in off if one.undecided]
    near = [one for one in off if one.near_boundary and not one.undecided]
    wrong = [one for one in off if not (one.undecided or one.near_boundary)]
    numbers: dict[str, Any] = {
        "points": len(compared),
        "agree": len(compared) - len(off),
        "long run undecided, trend as in the map": len(open_),
        "differ, within a cell of a boundary": len(near),
        "disagree": len(wrong),
    }
    if as_json:
        print(json.dumps(numbers | {"off": [one.line() for one in off]}, indent=2))
    else:
        for name, value in numbers.items():
            print(f"{name:40} {value}")
        for label, group in (("undecided", open_), ("excused", near), ("DISAGREES", wrong)):
            for one in group:
                print(f"{label:9} {one.line()}")
    return 1 if wrong else 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=500, help="random points of the grid")
    parser.add_argument("--grid", type=int, default=100, help="points along each axis of the map")
    parser.add_argument("--until", type=float, default=60.0, help="how long to follow [s]")
    parser.add_argument("--seed", type=int, default=0, help="of the random points")
    parser.add_argument("--map", type=Path, help="a map file to test, in place of a new map")
    parser.add_argument("--write", type=Path, help="write the new map here")
    parser.add_argument("--json", action="store_true", help="print JSON")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
