"""Families of the reference problem, and where they change or end in the plane of its gains.

    python benchmarks/families.py [--quick] [--workers N] [--checkpoint FOLDER]
        [-o boundaries.json] [--pictures FOLDER]

The family in the restitution from 0 to its end; the families in both gains, that in Kd at two
values of Kp; their special points followed in both, as polylines ``{"name": "fold",
"x": [Kp ...], "y": [Kd ...]}``. Some eighteen minutes of processor time over all workers; without
the curves (``--quick``) half a minute. With ``--checkpoint`` a run that is killed goes on.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from zeno_orbits.continuation import (
    Continuation,
    ContinuationSettings,
    CurveSteps,
    SecondParameter,
    SpecialCurve,
    SpecialPointKind,
    WorkerPool,
    family_of_orbit,
    start_orbit,
)
from zeno_orbits.model.library import locate_problem
from zeno_orbits.model.problem import Problem
from zeno_orbits.report import plots
from zeno_orbits.report.terminal.progress import ProgressLine
from zeno_orbits.work import ExecutionPlan, Workers, open_pool
from zeno_orbits.work.files import write_whole

KP, KD = (0.5, 12.0), (-2.5, 0.0)
RESTITUTION = (0.0, 0.5)
INNER = (4.3, -1.5)
"""Kp and Kd of an orbit whose family in Kd is shaped like an S, two folds and two flips more."""
KINDS = tuple(kind for kind in SpecialPointKind if kind.located)
SETTINGS = ContinuationSettings(curve=CurveSteps(most=120))
"""Beyond its hairpin the end of the contact phase takes ever shorter steps: the 63 points after
these 120 took six minutes for 0.023 of Kp."""
PROBLEM = "motor_pendulum"


def kept(crew: WorkerPool, name: str) -> WorkerPool:
    """Return the same workers for one family, which has a folder of its own in the checkpoint."""

    def report(stage: str, part: float | None, /) -> None:
        crew.on_progress(f"{name}: {stage}", part)

    folder = crew.plan.checkpoint
    own = None if folder is None else folder / name.replace(" ", "")
    return replace(crew, plan=replace(crew.plan, checkpoint=own), on_progress=report)


def families(problem: Problem, crew: WorkerPool, *, curves: bool) -> dict[str, Continuation]:
    """Return the families by the parameter that they are in, printing their tables."""
    orbit = start_orbit(problem, problem.values())
    found: dict[str, Continuation] = {}
    boxes = {"restitution": RESTITUTION, "Kd": KD, "Kp": KP}
    for name, box in boxes.items():
        started = time.perf_counter()
        other = {"Kd": "Kp", "Kp": "Kd"}.get(name)
        second = None
        if curves and other is not None:
            second = SecondParameter(name=other, box=boxes[other], kinds=KINDS)
        found[name] = family_of_orbit(
            problem,
            orbit,
            name,
            box,
            second=second,
            settings=SETTINGS,
            crew=kept(crew, name),
        )
        show(name, found[name], time.perf_counter() - started)
    if curves:
        started = time.perf_counter()
        name = f"Kd at Kp = {INNER[0]:g}"
        found[name] = inner_curves(problem, found, kept(crew, name))
        show(name, found[name], time.perf_counter() - started)
    return found


def inner_curves(
    problem: Problem, found: dict[str, Continuation], crew: WorkerPool
) -> Continuation:
    """Return the S-shaped family in Kd at a higher Kp, with its folds and flips that are new."""
    kp, kd = INNER
    inner = family_of_orbit(
        problem,
        start_orbit(problem, problem.values(gains={"Kp": kp, "Kd": kd})),
        "Kd",
        KD,
        second=SecondParameter(
            name="Kp", box=KP, kinds=(SpecialPointKind.FOLD, SpecialPointKind.FLIP)
        ),
        settings=replace(SETTINGS, doublings=0),
        crew=crew,
    )
    known = [in_gains(curve) for one in found.values() for curve in one.boundaries]
    new = [curve for curve in inner.boundaries if not any(runs_along(curve, k) for k in known)]
    return replace(inner, boundaries=tuple(new))


def runs_along(curve: SpecialCurve, known: SpecialCurve) -> bool:
    """Return True if most of a curve lies on a known one of its kind."""
    if curve.kind is not known.kind or len(known.x) < 2:
        return False
    units = np.array([KP[1] - KP[0], KD[1] - KD[0]])
    curve = in_gains(curve)
    corners = np.array([known.x, known.y]).T / units
    starts, ways = corners[:-1], np.diff(corners, axis=0)
    lengths = np.maximum(np.sum(ways**2, axis=1), 1e-300)
    off: list[float] = []
    for at in np.array([curve.x, curve.y]).T / units:
        parts = np.clip(np.sum((at - starts) * ways, axis=1) / lengths, 0.0, 1.0)
        nearest = starts + parts[:, None] * ways - at
        off.append(float(np.min(np.linalg.norm(nearest, axis=1))))
    return float(np.median(off)) < _SAME


_SAME = 1e-3
"""Part of the ranges by which a curve differs from a chain of its points."""


def show(name: str, found: Continuation, seconds: float) -> None:
    """Print a family's special points and ends, and its curves."""
    for family in found.families:
        print(f"{name}: {len(family.points)} orbits, {seconds:.1f} s")
        for special in family.named:
            error = f"{special.error:.0e}" if special.kind.located else "given"
            radius = special.at.spectral_radius
            print(
                f"  {special.kind.value:32s} {special.at.value:.12f}  {error:6s} "
                f"period {special.at.period:.10f}  radius {radius:.6g}",
                flush=True,
            )
    for boundary in found.boundaries:
        print(
            f"  curve of {boundary.kind.value}: {len(boundary.x)} points, errors below "
            f"{max(boundary.errors):.0e}; ends: {boundary.ends[0]} | {boundary.ends[1]}"
        )
        corners = [("end", 0), *(("cusp", k) for k in boundary.cusps), ("end", -1)]
        for word, k in corners:
            x, y = boundary.names
            print(f"    {word:5s} {x} = {boundary.x[k]:.9f}, {y} = {boundary.y[k]:.9f}")


def in_gains(boundary: SpecialCurve) -> SpecialCurve:
    """Return a boundary with Kp as its first parameter."""
    if boundary.names == ("Kp", "Kd"):
        return boundary
    return replace(boundary, names=("Kp", "Kd"), x=boundary.y, y=boundary.x)


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="leave out the curves")
    parser.add_argument("--workers", type=int, help="processes; one a core by default")
    parser.add_argument(
        "--checkpoint", type=Path, metavar="FOLDER", help="keep what is finished here, and go on"
    )
    parser.add_argument("-o", "--output", type=Path, help="write the curves here")
    parser.add_argument("--pictures", type=Path, help="draw into this folder")
    options = parser.parse_args()
    problem_file, place = locate_problem(PROBLEM), Workers(count=options.workers)
    problem = problem_file.load()
    if options.checkpoint is not None:
        options.checkpoint.mkdir(parents=True, exist_ok=True)
    with open_pool(place) as pool, ProgressLine(lambda: None) as progress:
        plan = ExecutionPlan(place=place, checkpoint=options.checkpoint)
        crew = WorkerPool(problem_file=problem_file, plan=plan, pool=pool, on_progress=progress)
        found = families(problem, crew, curves=not options.quick)
    curves = [in_gains(b) for one in found.values() for b in one.boundaries]
    if options.output is not None:
        data: list[dict[str, Any]] = [curve.as_json() for curve in curves]
        write_whole(options.output, json.dumps(data, indent=1) + "\n")
    if options.pictures is not None:
        for name, one in found.items():
            path = options.pictures / f"family_{name.replace(' ', '')}.png"
            plots.save_figure(plots.plot_families(one, problem), path)
        if curves:
            both = replace(found["Kd"], boundaries=tuple(curves))
            path = options.pictures / "boundaries.png"
            plots.save_figure(plots.plot_boundaries(both, problem), path)


if __name__ == "__main__":
    main()
