"""Families of the reference scene, and where they change or end in the plane of its gains.

    python benchmarks/families.py [--quick] [-o boundaries.json] [--pictures FOLDER]

The family in the restitution from 0 to its end; the families in both gains; their special points
followed in both, as polylines ``{"name": "fold", "x": [Kp ...], "y": [Kd ...]}``. Ten minutes;
without the curves (``--quick``) one.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from zeno_orbits import plots
from zeno_orbits.continuation import (
    continue_orbit,
    continue_orbit_in_two,
    start_orbit,
)
from zeno_orbits.families import Boundary, Continuation, Kind
from zeno_orbits.files import write_whole
from zeno_orbits.plane import CurveSteps
from zeno_orbits.problem import Problem, load_problem
from zeno_orbits.tracks import ContinuationSettings

KP, KD = (0.5, 12.0), (-2.5, 0.0)
RESTITUTION = (0.0, 0.5)
KINDS = tuple(kind for kind in Kind if kind.located)
SETTINGS = ContinuationSettings(curve=CurveSteps(first=0.005, longest=0.05, most=40))


def families(problem: Problem, *, curves: bool) -> dict[str, Continuation]:
    """Return the families by the parameter that they are in, printing their tables."""
    orbit = start_orbit(problem, problem.setting())
    found: dict[str, Continuation] = {}
    boxes = {"restitution": RESTITUTION, "Kd": KD, "Kp": KP}
    for name, box in boxes.items():
        started = time.process_time()
        other = {"Kd": "Kp", "Kp": "Kd"}.get(name)
        if curves and other is not None:
            found[name] = continue_orbit_in_two(
                problem,
                orbit,
                (name, other),
                (box, boxes[other]),
                kinds=KINDS,
                settings=SETTINGS,
            )
        else:
            found[name] = continue_orbit(problem, orbit, name, box, settings=SETTINGS)
        show(name, found[name], time.process_time() - started)
    return found


def show(name: str, found: Continuation, seconds: float) -> None:
    """Print a family's special points and ends, and its curves."""
    for family in found.families:
        print(f"{name}: {len(family.points)} orbits, {seconds:.1f} s of processor time")
        for special in family.named:
            error = f"{special.error:.0e}" if special.kind.located else "given"
            radius = special.at.spectral_radius
            print(
                f"  {special.kind.value:32s} {special.at.value:.12f}  {error:6s} "
                f"period {special.at.period:.10f}  radius {radius:.6g}"
            )
    for boundary in found.boundaries:
        print(
            f"  curve of {boundary.kind.value}: {len(boundary.x)} points, errors below "
            f"{max(boundary.errors):.0e}; ends: {boundary.ends[0]} | {boundary.ends[1]}"
        )


def in_gains(boundary: Boundary) -> Boundary:
    """Return a boundary with Kp as its first parameter."""
    if boundary.names == ("Kp", "Kd"):
        return boundary
    return replace(boundary, names=("Kp", "Kd"), x=boundary.y, y=boundary.x)


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="leave out the curves")
    parser.add_argument("-o", "--output", type=Path, help="write the curves here")
    parser.add_argument("--pictures", type=Path, help="draw into this folder")
    options = parser.parse_args()
    problem = load_problem("motor_pendulum")
    found = families(problem, curves=not options.quick)
    curves = [in_gains(b) for one in found.values() for b in one.boundaries]
    if options.output is not None:
        data: list[dict[str, Any]] = [curve.as_json() for curve in curves]
        write_whole(options.output, json.dumps(data, indent=1) + "\n")
    if options.pictures is not None:
        for name, one in found.items():
            path = options.pictures / f"family_{name}.png"
            plots.save_figure(plots.plot_families(one, problem), path)
        if curves:
            both = replace(found["Kd"], boundaries=tuple(curves))
            path = options.pictures / "boundaries.png"
            plots.save_figure(plots.plot_boundaries(both, problem), path)


if __name__ == "__main__":
    main()
