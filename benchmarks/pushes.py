"""Check and time basins and largest pushes of the reference orbit by plain simulation.

    python benchmarks/pushes.py
    python benchmarks/pushes.py --only pushes --pushes 1000

Four parts, each with a bar:

- `basin` times a map of the basins over `theta1` and `dtheta1` at the release, once with every
  point and once with the refinement of boundaries, and compares the two.
- `pushes` locates the largest pushes, then simulates random pushes below them, where no motion may
  be lost, and a push one percent above each of them, where every motion has to be lost. The
  smallest lost push has to end in the stated motion. A lost interval between two impulses of the
  scan is printed with its ray. `--steps` refines the scan.
- `rig` pushes three simulated machines and compares return and loss with the model: a stiff stop
  alone, the declared compliant stop, friction and gear, and the whole declared machine, which also
  has a bridge, sensors and a sampled controller. A machine returns if its last cycle lies on its
  cycles without a push.
- `spring` compares the largest push of a mass on a spring with negative damping with a closed form.

Return and loss are judged by `zo.simulate`, not by the classification of the maps. A push is
applied here by a second derivation of the impulse law.

Exit 1 if a bar is missed.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import numpy.typing as npt

import zeno_orbits as zo

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.support.antidamped_spring import LIFTED, SETS, numbers, threshold
from zeno_orbits.api import machine_of, rig_settings
from zeno_orbits.errors import RunawayError, WorkError
from zeno_orbits.experiment import SettledRig
from zeno_orbits.maps import Attractor, Push, Pushes, PushSettings
from zeno_orbits.work import ExecutionPlan, FailedPoint, Workers, parallel_map

Vector = npt.NDArray[np.float64]

PROBLEM = "motor_pendulum"
PARTS = ("basin", "pushes", "rig", "spring")
BASIN_TIME = 60.0
"""Processor time per worker of the map of basins, its wall time on a quiet machine [s]."""
AGREEMENT = 0.95
"""Smallest share of pushes after which machine and model both return or are both lost."""
CLOSED_FORM = 1e-8
"""Largest relative error of the largest push of the mass on the spring."""
HALVINGS = 3
"""Halvings of the refined map."""

BELOW, ABOVE = 0.99, 1.01
"""Largest random push and lost push, relative to the largest push of the ray."""
NEAR = 1e-3
"""Distance of releases from the release of the orbit, relative to its states."""
IN_CONTACT = 1e-12
"""A gap below this is contact [rad]."""
STAGES = (6, 20, 60)
"""Simulated periods: a motion that has not returned is simulated again for longer."""
RETURNS = "returns"

ROOM = 1.5
"""Largest push of the machine, relative to the largest push of the ray."""
CYCLES = 12
"""Cycles of the machine after a push."""
DECLARED, STIFF = "declared machine", "stiff stop alone"
PASSIVE = "compliant stop, friction and gear"
"""The machine of the problem, and a machine that differs from the model only by its stop."""
STIFFNESS = 1e6
"""Stiffness of the stiff stop, 70 times that of the declared machine [N m/rad^1.5]."""
NEAR_CYCLE = 0.1
"""Distance of the last cycle from the unpushed cycles, relative to their states."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """A row of the table.

    Attributes:
        part: Part of the benchmark.
        measure: The measured quantity.
        value: The result as text.
        bar: The bar as text, empty without a bar.
        met: True if the bar is met.
    """

    part: str
    measure: str
    value: str
    bar: str = ""
    met: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Reference:
    """The reference orbit, and return and loss of motions near it by plain simulation.

    Attributes:
        problem: The problem.
        orbit: The orbit.
        release: State at the release, ``(n_x,)``.
        size: Largest absolute value of each state over the period, ``(n_x,)``.
        period: The period from the release.
    """

    problem: zo.Problem
    orbit: zo.Orbit
    release: Vector
    size: Vector
    period: zo.Execution

    def change(self, state: Vector, direction: Mapping[str, float]) -> Vector:
        """Return the change of the velocities per unit impulse off the stop, ``(n_q,)``."""
        (inverse,), _ = self.problem.inverse_masses(self.orbit.values(self.problem), state[None])
        force = [direction.get(name, 0.0) for name in self.problem.state_names[: len(inverse)]]
        return np.asarray(inverse @ np.array(force), dtype=np.float64)

    def pushed(self, phase: float, direction: Mapping[str, float], impulse: float) -> Vector:
        """Return the state of the orbit after an impulse.

        In contact the impulse of the stop solves the complementarity problem of a plastic impact.
        The gap is `theta2`, so the impulse of the stop acts along `theta2`.
        """
        state = self.period.state_at(phase * self.orbit.period) if phase else self.release
        after = state.copy()
        after[2:4] += impulse * self.change(state, direction)
        if abs(state[1]) < IN_CONTACT:
            stop = self.change(state, {"theta2": 1.0})
            after[2:4] += max(0.0, -after[3] / stop[1]) * stop
            after[1] = 0.0
        return after

    def end(self, state: Vector) -> str:
        """Return `RETURNS` after a motion that returns, or else the words for its end.

        A motion returns if its last two releases are nearer than `NEAR` to the release of the
        orbit, and a period apart. An angle beyond the limit that the problem declares is a loss.
        """
        for periods in STAGES:
            try:
                releases = simulated(self.problem, self.orbit, state, periods).releases[-2:]
            except RunawayError as error:
                return self.problem.escapes[error.coordinate].phrase
            except zo.SimulationError as error:
                return str(error)
            away = [np.max(np.abs(one.state - self.release) / self.size) for one in releases]
            if len(away) == 2 and max(away) < NEAR:
                duration = releases[1].time - releases[0].time
                if math.isclose(duration, self.orbit.period, rel_tol=NEAR):
                    return RETURNS
        return f"no return within {STAGES[-1]} periods"


def simulated(problem: zo.Problem, orbit: zo.Orbit, state: Vector, periods: float) -> zo.Execution:
    """Simulate a number of periods of an orbit from a state."""
    limits = [problem.escapes[name].beyond for name in ("theta1", "theta2")]
    return zo.simulate(
        problem,
        gains=dict(orbit.gains),
        parameters=dict(orbit.parameters),
        start=named(problem, state),
        until=periods * orbit.period,
        settings=zo.SimulationSettings(far=tuple(limits)),
    )


def named(problem: zo.Problem, state: Vector) -> dict[str, float]:
    """Return a state by name."""
    return dict(zip(problem.state_names, state.tolist(), strict=True))


def reference_of(path: str) -> Reference:
    """Return the reference of an orbit file."""
    problem, orbit = zo.load_problem(PROBLEM), zo.read_orbit(path)
    release = np.array(problem.state_vector(orbit.release_state))
    period = simulated(problem, orbit, release, 1.0)
    _, states = period.sampled(50)
    size = np.max(np.abs(states), axis=0)
    return Reference(problem=problem, orbit=orbit, release=release, size=size, period=period)


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """The settled machine, and return and loss after a push.

    Attributes:
        reference: The orbit of the model.
        parts: Parts of the machine.
        settled: Cycles of the machine without a push.
        size: Largest absolute value of each state of the problem over them, ``(n_x,)``.
    """

    reference: Reference
    parts: zo.Rig
    settled: SettledRig
    size: Vector

    def pushed(self, phase: float, direction: Mapping[str, float], impulse: float) -> Vector:
        """Return the state of the settled machine after an impulse. Its stop acts afterwards."""
        run, first = self.settled.run, self.settled.cycles[0]
        index = int(np.searchsorted(run.times, phase * first.period))
        after = run.states[index, : self.size.size].copy()
        after[2:4] += impulse * self.reference.change(after, direction)
        return after

    def returns(self, state: Vector, seed: int) -> bool:
        """Return True if the last cycle after a push lies on the cycles without a push."""
        problem, orbit = self.reference.problem, self.reference.orbit
        until = CYCLES * orbit.period
        try:
            run = zo.simulate_rig(
                problem,
                self.parts,
                until=until,
                gains=dict(orbit.gains),
                parameters=dict(orbit.parameters),
                start=named(problem, state),
                seed=seed,
                settings=replace(rig_settings(self.parts), keep_from=until - orbit.period),
            )
        except RunawayError:
            return False
        curve = self.settled.run.states[:, : self.size.size] / self.size
        last = run.states[::20, : self.size.size] / self.size
        return all(np.min(np.max(np.abs(curve - one), axis=1)) < NEAR_CYCLE for one in last)


def settled_machine(reference: Reference, name: str) -> Machine:
    """Return a machine with its settled cycles."""
    problem, orbit = reference.problem, reference.orbit
    stiff = {"contact.stiffness": STIFFNESS}
    parts = {
        STIFF: lambda: machine_of(problem, orbit=orbit, only=(), numbers=stiff),
        PASSIVE: lambda: machine_of(problem, orbit=orbit, only=("friction", "gears")),
        DECLARED: lambda: machine_of(problem, orbit=orbit),
    }[name]()
    settled = zo.simulate_experiment(orbit, problem=problem, rig=parts, cycles=4)
    states = settled.run.states[:, : reference.size.size]
    size = np.max(np.abs(states), axis=0)
    return Machine(reference=reference, parts=parts, settled=settled, size=size)


@dataclass(frozen=True, slots=True, kw_only=True)
class Judge:
    """Return and loss after pushes: the task of a worker.

    Attributes:
        orbit: File of the orbit.
        machine: Name of a machine that is also pushed. Empty for the model alone.
    """

    orbit: str
    machine: str = ""

    def __call__(self, points: Sequence[Any]) -> list[dict[str, Any]]:
        """Return the end of each motion, and whether the machine returns."""
        reference = reference_of(self.orbit)
        machine = settled_machine(reference, self.machine) if self.machine else None
        answers: list[dict[str, Any]] = []
        for point in points:
            push = (point["phase"], point["direction"], point["impulse"])
            state = reference.pushed(*push)
            answer: dict[str, Any] = {"end": reference.end(state)}
            if machine is not None:
                answer["machine"] = machine.returns(machine.pushed(*push), point["seed"])
            answers.append(answer)
        return answers


def judged(task: Judge, points: Sequence[Any], workers: int) -> list[dict[str, Any]]:
    """Return the answers of a judge, computed by workers.

    Raises:
        WorkError: If a push crashes its worker.
    """
    # A worker makes the reference anew for every chunk.
    chunk = min(100, math.ceil(len(points) / workers))
    found: list[dict[str, Any]] = []
    for one in parallel_map(task, points, ExecutionPlan(place=Workers(count=workers), chunk=chunk)):
        if isinstance(one, FailedPoint):
            raise WorkError(one.reason)
        found.append(one)
    return found


def point_of(push: Push, impulse: float, *, seed: int = 0) -> dict[str, Any]:
    """Return a push as the plain data of a judge."""
    return {
        "phase": push.phase,
        "direction": dict(push.direction),
        "impulse": impulse,
        "seed": seed,
    }


def basin(path: str, options: argparse.Namespace) -> Iterator[Row]:
    """Time the map of basins, every point and refined."""
    n = options.grid
    coarse = (n - 1) // 2**HALVINGS + 1
    fine = 2**HALVINGS * (coarse - 1) + 1
    maps: list[Sequence[Attractor]] = []
    for count, refine, name in (
        (fine, 0, f"{fine} x {fine} points"),
        (coarse, HALVINGS, f"{coarse} x {coarse} points, refined {HALVINGS} times"),
    ):
        started, used = time.perf_counter(), seconds()
        found = zo.parameter_map(
            PROBLEM,
            x=("theta1", -1.0, 1.5, count),
            y=("dtheta1", -12.0, 12.0, count),
            orbit=path,
            refine=refine,
            workers=options.workers,
        )
        wall, processor = time.perf_counter() - started, seconds() - used
        spent = processor / options.workers
        yield Row(
            part="basin",
            measure=f"{name}: processor time per worker",
            value=f"{spent:.1f} s",
            bar=f"{BASIN_TIME:.0f} s",
            met=spent < BASIN_TIME,
        )
        yield Row(part="basin", measure="wall time", value=f"{wall:.1f} s")
        computed = len(found.attractors) + len(found.between)
        yield Row(part="basin", measure="computed points", value=str(computed))
        maps.append(found.finest()[2])
    counts = Counter(one.phrase for one in maps[0])
    for phrase, count in counts.most_common():
        yield Row(part="basin", measure=phrase, value=f"{count} points")
    differ = sum(one.phrase != two.phrase for one, two in zip(*maps, strict=True))
    yield Row(part="basin", measure="points that differ in the refined map", value=str(differ))


def seconds() -> float:
    """Return the processor time of this process and its children [s]."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def located(path: str, options: argparse.Namespace) -> Pushes:
    """Return the largest pushes of the orbit to a relative error of 1e-4."""
    settings = PushSettings(phases=options.phases, steps=options.steps, error=1e-4)
    return zo.largest_push(path, problem=PROBLEM, settings=settings, workers=options.workers)


def end_of(push: Push) -> float:
    """Return the largest push, or the end of the scan if every push of the scan returns."""
    return push.largest if math.isfinite(push.largest) else push.searched


def ray_of(push: Push) -> str:
    """Return the ray of a push in words."""
    return f"{push.name} at phase {push.phase:.4g}"


def described(point: Mapping[str, Any], push: Push) -> str:
    """Return a push in words, for the list of exceptions."""
    part = point["impulse"] / end_of(push)
    return f"{point['impulse']:.6g} {push.unit}, {part:.4f} of the largest"


def pushes(path: str, found: Pushes, options: argparse.Namespace) -> Iterator[Row]:
    """Simulate random pushes below the largest, and two pushes above each."""
    least = found.least
    if least is not None:
        value = f"{least.largest:.6g} {least.unit}"
        where = f"least push: {ray_of(least)}"
        yield Row(part="pushes", measure=where, value=value)
    chosen, points = drawn(found, options.pushes, BELOW, options.seed)
    answers = judged(Judge(orbit=path), points, options.workers)
    lost = [k for k, one in enumerate(answers) if one["end"] != RETURNS]
    by_ray: dict[str, list[int]] = {}
    for k in sorted(lost, key=lambda k: points[k]["impulse"]):
        by_ray.setdefault(ray_of(chosen[k]), []).append(k)
    for ray, those in by_ray.items():
        print(f"lost on the ray {ray}: {len(those)}")
        for k in dict.fromkeys((those[0], those[-1])):
            print(f"  {described(points[k], chosen[k])}: {answers[k]['end']}")
    measure = f"lost of {len(points)} random pushes below {BELOW:g} of the largest"
    yield Row(part="pushes", measure=measure, value=str(len(lost)), bar="0", met=not lost)
    value = f"{len(by_ray)} of {len(found.pushes)}"
    yield Row(part="pushes", measure="rays with a lost push", value=value)

    lossy = [push for push in found.pushes if math.isfinite(push.largest)]
    points = [point_of(push, ABOVE * push.largest) for push in lossy]
    answers = judged(Judge(orbit=path), points, options.workers)
    kept = [k for k, one in enumerate(answers) if one["end"] == RETURNS]
    for k in kept:
        print(f"returns: {ray_of(lossy[k])}, {described(points[k], lossy[k])}")
    measure = f"lost of {len(lossy)} pushes at {ABOVE:g} of the largest"
    value, bar = str(len(lossy) - len(kept)), str(len(lossy))
    yield Row(part="pushes", measure=measure, value=value, bar=bar, met=not kept)

    points = [point_of(push, push.largest + push.error) for push in lossy]
    answers = judged(Judge(orbit=path), points, options.workers)
    other = [k for k, one in enumerate(answers) if one["end"] != lossy[k].beyond]
    for k in other:
        ends = f"{answers[k]['end']} instead of: {lossy[k].beyond}"
        print(f"another motion: {ray_of(lossy[k])}, {described(points[k], lossy[k])}: {ends}")
    measure = "stated motion at the smallest lost push"
    value = str(len(lossy) - len(other))
    yield Row(part="pushes", measure=measure, value=value, bar=bar, met=not other)


def drawn(
    found: Pushes, number: int, most: float, seed: int
) -> tuple[list[Push], list[dict[str, Any]]]:
    """Return random rays, and a random push of each up to a part of its largest push."""
    random = np.random.default_rng(seed)
    rays: list[int] = random.integers(len(found.pushes), size=number).tolist()
    parts: list[float] = random.uniform(0.0, most, size=number).tolist()
    chosen = [found.pushes[k] for k in rays]
    points = [
        point_of(push, part * end_of(push), seed=k)
        for k, (push, part) in enumerate(zip(chosen, parts, strict=True))
    ]
    return chosen, points


def rig(path: str, found: Pushes, options: argparse.Namespace) -> Iterator[Row]:
    """Push three machines, and compare return and loss with the model."""
    chosen, points = drawn(found, options.rig, ROOM, options.seed)
    for name in (STIFF, PASSIVE, DECLARED):
        task = Judge(orbit=path, machine=name)
        answers = judged(task, points, options.workers)
        differ = [k for k, one in enumerate(answers) if (one["end"] == RETURNS) != one["machine"]]
        for k in differ:
            said = "returns" if answers[k]["machine"] else "is lost"
            push = f"{ray_of(chosen[k])}, {described(points[k], chosen[k])}"
            print(f"{name} {said}: {push}, model: {answers[k]['end']}")
        lost = sum(one["end"] != RETURNS for one in answers)
        agree = 1.0 - len(differ) / len(points)
        yield Row(
            part="rig",
            measure=f"{name}: agreement in {len(points)} pushes, {lost} of them lost",
            value=f"{100 * agree:.1f} %",
            bar=f"{100 * AGREEMENT:.0f} %",
            met=agree >= AGREEMENT,
        )


def spring(options: argparse.Namespace) -> Iterator[Row]:
    """Compare the largest push of the mass on the spring with its closed form."""
    settings = PushSettings(phases=5, steps=8, reach=40.0, error=1e-9)
    errors: list[float] = []
    for chosen in SETS[: options.sets]:
        orbit = zo.find_orbit_by_shooting(LIFTED, parameters=numbers(*chosen)).unwrap()
        found = zo.largest_push(orbit, problem=LIFTED, settings=settings)
        # Phase 0.2 lies early in the contact, long before the next lift.
        up = next(push for push in found.pushes if push.phase == 0.2 and push.is_positive)
        errors.append(abs(up.largest / threshold(*chosen) - 1.0))
    measure = f"largest relative error of {len(errors)} parameter sets"
    value, bar = f"{max(errors):.1e}", f"{CLOSED_FORM:g}"
    met = max(errors) <= CLOSED_FORM
    yield Row(part="spring", measure=measure, value=value, bar=bar, met=met)


def print_table(rows: Sequence[Row]) -> None:
    """Print the rows as a Markdown table."""
    print("| part | quantity | value | bar | met |")
    print("|---|---|---|---|---|")
    for row in rows:
        met = ("yes" if row.met else "NO") if row.bar else ""
        print(f"| {row.part} | {row.measure} | {row.value} | {row.bar} | {met} |")


def count(text: str) -> int:
    """Return a positive whole number of the command line."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"must be at least 1, but it is {number}")
    return number


def options_of() -> argparse.Namespace:
    """Return the options of the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS, metavar="PART")
    parser.add_argument(
        "--grid",
        type=count,
        default=201,
        metavar="N",
        help="points along a side of the basin, rounded down to 8 k + 1",
    )
    parser.add_argument("--pushes", type=count, default=10_000, metavar="N", help="random pushes")
    parser.add_argument(
        "--rig", type=count, default=200, metavar="N", help="random pushes of the machines"
    )
    parser.add_argument(
        "--sets", type=count, default=len(SETS), metavar="N", help="parameter sets of the spring"
    )
    parser.add_argument(
        "--phases", type=count, default=12, metavar="N", help="phases of the pushes"
    )
    parser.add_argument("--steps", type=count, default=96, metavar="N", help="steps of the scan")
    parser.add_argument(
        "--seed", type=int, default=1, metavar="N", help="random seed of the pushes"
    )
    parser.add_argument("--workers", type=count, default=2, metavar="N", help="processes")
    options = parser.parse_args()
    if options.grid <= 2**HALVINGS:
        parser.error(f"--grid must be at least {2**HALVINGS + 1}, but it is {options.grid}")
    return options


def rows_of(path: str, options: argparse.Namespace) -> Iterator[Row]:
    """Yield the rows of the chosen parts, with the times of each part."""
    found: Pushes | None = None
    for part in options.only:
        started, used = time.perf_counter(), seconds()
        if part == "basin":
            yield from basin(path, options)
        elif part == "spring":
            yield from spring(options)
        else:
            if found is None:
                found = located(path, options)
                measure = f"processor time of `largest_push`, {options.steps} steps"
                yield Row(part=part, measure=measure, value=f"{seconds() - used:.0f} s")
            yield from (pushes if part == "pushes" else rig)(path, found, options)
        wall, processor = time.perf_counter() - started, seconds() - used
        value = f"{wall:.0f} s, {processor:.0f} s"
        yield Row(part=part, measure="wall time, processor time", value=value)


def main() -> int:
    """Print the table and return 1 if a bar is missed."""
    options = options_of()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "orbit.json"
        zo.write_orbit(zo.find_orbit(PROBLEM).unwrap(), path)
        rows = list(rows_of(str(path), options))
    print_table(rows)
    return int(not all(row.met for row in rows))


if __name__ == "__main__":
    sys.exit(main())
