"""Optima of `search` against grids with local polishing.

    python benchmarks/optima.py [--only INDEX ...] [--workers N] [--checkpoint FOLDER] [--quick]

Each case has a problem, an objective, bounds and free values. The truth closes orbits by simulation
alone on a grid of the free values, measures the quantity on each, leaves out those that break a
bound or that the verification refuses, as next to the end of a family, and polishes the best of
them by a method without derivatives. For a target the truth is the
orbit with the wanted quantity whose free value is nearest to its start.

A case fails if the truth beats the answer by more than 1e-6, relative, or if the answer took more
than 60 s of processor time. At an end of a family the last verified orbit is the answer. Rounding
decides which one that is, so 1e-4 is the limit there.

An answer that only one start led to is said to be possibly local: the table counts for how many of
these the truth is better, and for how many it is not.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import brentq, minimize, minimize_scalar

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from support.spreading import add_options, arriving

import zeno_orbits as zo
from tests.support.measured import measured
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.orbits import Orbit
from zeno_orbits.orbits.bounds import Bound, is_kept
from zeno_orbits.search import Objective, orbit_by_shooting

MACHINES = Path(__file__).parents[1] / "tests" / "support" / "machines"
BEATEN, BEATEN_AT_END, LONGEST = 1e-6, 1e-4, 60.0
"""Largest relative advantage of the truth, also at an end of a family, and longest processor time
of an answer [s]."""
ALONG, ACROSS = 41, 13
"""Points of a grid in one free value, and along each of two."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A search.

    Attributes:
        problem: Name or file of the problem.
        free: Ranges of the free values.
        objective: The objective.
        quantity: Quantity that a target prescribes, or an empty string.
        numbers: Numbers that differ from the problem's.
        bounds: Bounds.
    """

    problem: str
    free: Mapping[str, tuple[float, float]]
    objective: Objective
    quantity: str = ""
    numbers: Mapping[str, float] = field(default_factory=dict[str, float])
    bounds: tuple[Bound, ...] = ()


def machine(name: str) -> str:
    """Return the file of a machine of the tests."""
    return str(MACHINES / f"{name}.py")


def least(quantity: str) -> Objective:
    """Return the objective of the least energy, radius or peak."""
    named = {"energy": zo.MinEnergy(), "spectral_radius": zo.MinSpectralRadius()}
    return named.get(quantity) or zo.MinPeak(signal=quantity)


def single(name: str, of: str, low: float, high: float, quantity: str, **more: Any) -> Case:
    """Return a case with one free value whose quantity is least."""
    return Case(problem=name, free={of: (low, high)}, objective=least(quantity), **more)


PENDULUM = {"Kp": 2.5, "Kd": -1.0}
CASES = (
    single("forced_oscillator", "A", 0.85, 1.3, "energy"),
    single("forced_oscillator", "c", 1.2, 2.6, "speed"),
    single("forced_oscillator", "omega", 0.8, 1.2, "distance"),
    single(
        *("forced_oscillator", "A", 0.85, 1.6, "energy"),
        bounds=(Bound(name="distance", lower=-1.0, upper=0.35),),
    ),
    single("relief_valve", "q", 0.2, 0.45, "pressure"),
    single("relief_valve", "d", 7.0, 14.0, "rate"),
    single(
        *("relief_valve", "b", 14.0, 30.0, "lift"),
        bounds=(Bound(name="period", upper=2.6),),
    ),
    single("motor_valve", "Kp", 6.0, 16.0, "current"),
    single("motor_valve", "Kp", 6.0, 16.0, "energy"),
    single("motor_valve", "preload", 0.03, 0.07, "voltage"),
    single("solenoid", "R", 16.0, 24.0, "current"),
    single("solenoid", "omega", 45.0, 75.0, "spectral_radius"),
    single("curved_surface", "lean", 0.1, 0.6, "spectral_radius"),
    single("curved_surface", "A", 0.013, 0.019, "y"),
    single("torque_pendulum", "A", 0.2, 0.4, "dtheta2"),
    single("torque_pendulum", "b1", 0.05, 0.2, "spectral_radius"),
    single("motor_pendulum", "Kp", 1.0, 5.0, "energy", numbers={"Kd": -1.0}),
    single("motor_pendulum", "Kp", 1.0, 5.0, "voltage", numbers={"Kd": -1.0}),
    single("motor_pendulum", "Kd", -1.5, -0.5, "spectral_radius", numbers={"Kp": 2.5}),
    single(
        *("motor_pendulum", "R", 2.0, 4.0, "energy"),
        numbers=PENDULUM,
        bounds=(Bound(name="period", lower=1.8),),
    ),
    single("vibrating_table", "restitution", 0.1, 0.4, "height", numbers={"A": 0.02}),
    single("vibrating_table", "A", 0.0125, 0.02, "energy"),
    single(machine("micro_relay"), "restitution", 0.1, 0.5, "energy"),
    single(machine("shaken_pair"), "F", 5.0, 8.0, "carriage"),
    single(machine("eccentric_cam"), "omega", 110.0, 130.0, "speed"),
    Case(
        problem="motor_pendulum",
        free={"Kp": (1.0, 5.0)},
        numbers={"Kd": -1.0},
        objective=zo.TargetPeriod(target=1.83),
        quantity="period",
    ),
    Case(
        problem="relief_valve",
        free={"b": (14.0, 30.0)},
        objective=zo.TargetPeriod(target=2.5),
        quantity="period",
    ),
    Case(
        problem="motor_pendulum",
        free={"Kp": (1.0, 5.0), "Kd": (-1.5, -0.6)},
        objective=zo.MinEnergy(),
        bounds=(Bound(name="theta2", upper=1.9),),
    ),
    Case(
        problem="relief_valve",
        free={"q": (0.2, 0.45), "d": (7.0, 14.0)},
        objective=zo.MinPeak(signal="pressure"),
        bounds=(Bound(name="period", upper=2.6),),
    ),
    Case(
        problem="curved_surface",
        free={"lean": (0.1, 0.6), "A": (0.013, 0.019)},
        objective=zo.MinSpectralRadius(),
    ),
)


@dataclass(frozen=True, kw_only=True)
class Truth:
    """Orbits by simulation alone.

    Attributes:
        case: The search.
    """

    case: Case

    def orbit(self, point: Sequence[float], near: Orbit | None = None) -> Orbit | None:
        """Return the attracting orbit at free values, or nothing."""
        case = self.case
        problem = zo.load_problem(case.problem)
        numbers = {**case.numbers, **dict(zip(case.free, map(float, point), strict=True))}
        for known in (near, None) if near is not None else (None,):
            try:
                found = orbit_by_shooting(
                    problem, problem.values(numbers=numbers), near=known
                ).orbit
            except ZenoOrbitsError:
                continue
            if found is None:
                continue
            certificate = zo.verify(found, problem=problem)
            if certificate.passed and certificate.stable:
                return found
        return None

    def score(self, orbit: Orbit | None) -> float:
        """Return the score of an orbit, infinite without one or outside a bound."""
        if orbit is None:
            return math.inf
        case, names = self.case, [bound.name for bound in self.case.bounds]
        wanted = case.objective.quantities[0] if not case.quantity else case.quantity
        problem = zo.load_problem(case.problem)
        found = {name: measured(orbit, problem, name) for name in [wanted, *names]}
        if not all(is_kept(bound, found[bound.name]) for bound in case.bounds):
            return math.inf
        return case.objective.rank(found[wanted]) if not case.quantity else found[wanted].highest

    def best(self) -> tuple[float, list[float]]:
        """Return the best score and its free values, from a grid and a polish."""
        ranges = np.array(list(self.case.free.values()))
        n = ALONG if len(ranges) == 1 else ACROSS
        grid = [np.linspace(low, high, n) for low, high in ranges]
        points = [np.array(point) for point in itertools.product(*grid)]
        known: dict[int, Orbit | None] = {}
        scores: list[float] = []
        for k, point in enumerate(points):
            known[k] = self.orbit(point)
            scores.append(self.score(known[k]))
        order = np.argsort(scores)
        found = float(scores[order[0]]), points[order[0]].tolist()
        units = ranges[:, 1] - ranges[:, 0]
        for k in order[:2]:
            if not math.isfinite(scores[k]):
                break
            around = points[k]

            def cost(point: Any, k: int = int(k)) -> float:
                at = np.atleast_1d(point)
                if np.any(at < ranges[:, 0]) or np.any(at > ranges[:, 1]):
                    return math.inf
                return self.score(self.orbit(at, known[k]))

            if len(ranges) == 1:
                step = units[0] / (n - 1)
                ends = around[0] - step, around[0] + step
                one = minimize_scalar(
                    cost, bounds=ends, method="bounded", options={"xatol": 1e-9 * units[0]}
                )
                value, at = float(one.fun), [float(one.x)]
            else:
                corners = [around, *(around + np.diag(units / (n - 1) / 2))]
                simplex = np.clip(corners, ranges[:, 0], ranges[:, 1])
                tight = {"initial_simplex": simplex, "xatol": 1e-8, "fatol": 1e-10, "maxfev": 200}
                more = minimize(cost, around, method="Nelder-Mead", options=tight)
                value, at = float(more.fun), more.x.tolist()
            if value < found[0]:
                found = value, at
        return found

    def nearest(self, target: float, start: float) -> list[float]:
        """Return the free value nearest to its start at which a quantity has a target."""
        (low, high), *_ = self.case.free.values()
        grid = np.linspace(low, high, ALONG)
        scores = [self.score(self.orbit([value])) - target for value in grid]
        roots: list[float] = []
        for a, b, left, right in zip(grid, grid[1:], scores, scores[1:], strict=False):
            if math.isfinite(left) and math.isfinite(right) and left * right <= 0.0:
                near = self.orbit([a])

                def miss(value: float, near: Any = near) -> float:
                    return self.score(self.orbit([value], near)) - target

                roots.append(float(brentq(miss, a, b, xtol=1e-12)))
        return sorted(roots, key=lambda root: abs(root - start))


@dataclass(frozen=True)
class Judge:
    """Searches beside their truth."""

    def __call__(self, indices: Sequence[int]) -> list[dict[str, Any]]:
        """Return answer, truth and times of cases."""
        return [self._judged(CASES[index]) for index in indices]

    def _judged(self, case: Case) -> dict[str, Any]:
        name = Path(case.problem).stem
        wish = case.objective.wish + "".join(f", {b.name} in {b.text}" for b in case.bounds)
        told: dict[str, Any] = {"name": f"{name}, {', '.join(case.free)}: {wish}"}
        problem = zo.load_problem(case.problem)
        fixed = {k: v for k, v in case.numbers.items() if k in problem.values().gains}
        others = {k: v for k, v in case.numbers.items() if k not in fixed}
        began = time.process_time()
        try:
            found = zo.search_gains(
                problem,
                gains=fixed,
                parameters=others,
                vary=dict(case.free),
                objective=case.objective,
                bounds=case.bounds,
            )
        except ZenoOrbitsError as error:
            return {**told, "refused": str(error)}
        told["seconds"] = time.process_time() - began
        truth, began = Truth(case=case), time.process_time()
        if found.orbit is None:
            best, at = truth.best()
            detail = f"{found.status.value} {found.detail}"
            return {**told, "none": detail, "best": best, "at": at}
        answer = [found.orbit.values(problem).number(name) for name in case.free]
        told["answer"] = [float(value) for value in answer]
        told["local"] = found.candidates[0].starts == 1
        told["ends"] = "this is the last orbit before" in found.detail
        if case.quantity:
            start = problem.values().replaced(dict(case.numbers)).number(next(iter(case.free)))
            target = float(case.objective.target)
            roots = truth.nearest(target, start)
            told["score"], told["best"] = abs(answer[0] - start), math.inf
            if roots:
                told["best"], told["at"] = abs(roots[0] - start), roots[:1]
        else:
            told["score"] = truth.score(found.orbit)
            told["best"], told["at"] = truth.best()
        told["truth seconds"] = time.process_time() - began
        return told


def main() -> int:
    """Print a row a case and the sums; 1 if an answer is beaten, missing or late."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", type=int, nargs="+", help="indices of cases")
    add_options(parser)
    parser.add_argument("--quick", action="store_true", help="two cases")
    options = parser.parse_args()
    indices = options.only or list(range(len(CASES)))[: 2 if options.quick else None]
    beaten, late, local, needless = 0, 0, 0, 0
    print("| Case | Answer | Truth | Excess | Time |\n|---|---|---|---|---|")
    for index, one in zip(indices, arriving("optima", Judge(), indices, options), strict=True):
        if "score" not in one:
            beaten += 1
            print(f"| {index} | {one} |", flush=True)
            continue
        excess = (one["score"] - one["best"]) / max(abs(one["best"]), 1e-3)
        lost = excess > (BEATEN_AT_END if one["ends"] else BEATEN)
        beaten, late = beaten + lost, late + (one["seconds"] > LONGEST)
        local, needless = local + one["local"], needless + (one["local"] and not lost)
        words = " beaten" if lost else ""
        print(
            f"| {index} {one['name']} | {one['score']:.9g} at {one['answer']} | {one['best']:.9g} "
            f"at {one.get('at')} | {excess:.1e}{words} | {one['seconds']:.1f} s"
            f"{', may be local' if one['local'] else ''}"
            f"{', end of the family' if one['ends'] else ''} |",
            flush=True,
        )
    print(
        f"{beaten} of {len(indices)} answers beaten or missing, {late} late; {local} may be local, "
        f"of which {needless} are not beaten."
    )
    return 1 if beaten or late else 0


if __name__ == "__main__":
    raise SystemExit(main())
