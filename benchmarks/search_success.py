"""How often a search finds and verifies an orbit of which a simulation says that it exists.

Random motor pendulums: masses and lengths within 40 % of the declared ones, `R` likewise, `L` over
one and a half decades, `e` from 0 to 0.8, gains over the region where orbits live. A problem counts
if a long simulation of it settles to a periodic orbit, to 1e-6; most have one Zeno point. Then

* fixed: the search at these gains must find the orbit, and the verifier must pass it;
* default: the search starts 30 % off in every gain, with all gains free;
* nearest: likewise, and asks for the gains nearest to a random place of the box;
* contraction: likewise, and asks for the least spectral radius in the box.

A free search must end in an orbit that the verifier passes and calls stable, as the command asks
for. Prints the counts and every failure with its cause; exit 1 if a kind is below 98 %.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from zeno_orbits import MinSpectralRadius, NearestGains
from zeno_orbits.api import Verified
from zeno_orbits.errors import InputError, ZenoOrbitsError
from zeno_orbits.model.library import locate_problem
from zeno_orbits.model.problem import ParameterValues, Problem
from zeno_orbits.report import terminal as report
from zeno_orbits.search import (
    Objective,
    SearchResult,
    orbit_at_gains,
    orbit_by_shooting,
    search_orbits,
)
from zeno_orbits.verification.verifier import verify
from zeno_orbits.work import Cluster, ExecutionPlan, FailedPoint, Workers, spread_in_order, versions

GOAL = 0.98
BOX = {"Kp": (0.3, 12.0), "Kd": (-2.2, -0.2)}


MOST = 8
"""Random problems for one with an orbit, at most; about every other one has been found to do."""


def pendulum() -> Problem:
    """Return the problem, the same object every time in one process, and so are its functions."""
    return locate_problem("motor_pendulum").load()


def random_problems(seed: int) -> Iterator[dict[str, Any]]:
    """Yield the numbers of random problems that the calibration admits, without end."""
    problem = pendulum()
    declared = problem.values().parameters
    random, places = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    while True:
        chosen = {
            name: declared[name] * random.uniform(0.7, 1.4)
            for name in ("L1", "lc1", "m1", "I1", "lc2", "m2", "I2", "R")
        }
        chosen["L"] = declared["L"] * 10 ** random.uniform(-0.5, 1.0)
        chosen["restitution"] = random.uniform(0.0, 0.8)
        gains = {"Kp": random.uniform(0.5, 8.0), "Kd": random.uniform(-1.6, -0.3)}
        off = [float(random.choice([0.7, 1.3])) for _ in gains]
        try:
            values = problem.values(gains=gains, parameters=chosen)
        except InputError:
            continue
        wrong = {name: value * k for (name, value), k in zip(gains.items(), off, strict=True)}
        target = {name: places.uniform(*box) for name, box in BOX.items()}
        parameters = dict(values.parameters)
        yield {"gains": gains, "wrong": wrong, "target": target, "parameters": parameters}


def has_orbit(values: ParameterValues) -> bool:
    """Return True if a long simulation settles to a periodic orbit."""
    return orbit_by_shooting(pendulum(), values).orbit is not None


def complaint(result: SearchResult) -> str:
    """Return why a search failed, or nothing if its orbit is verified."""
    if result.orbit is None:
        return f"{result.status.value} {result.detail}"
    certificate = verify(result.orbit, pendulum())
    return "" if certificate.passed else certificate.verdict()


@dataclass(frozen=True, slots=True, kw_only=True)
class Judge:
    """Searches random problems.

    Attributes:
        kinds: Names of the searches.
    """

    kinds: tuple[str, ...]

    def __call__(self, problems: Sequence[dict[str, Any]]) -> list[list[str] | None]:
        """Return the complaints of each search of problems; ``None`` without an orbit."""
        return [self._judged(problem) for problem in problems]

    def _judged(self, given: dict[str, Any]) -> list[str] | None:
        values = ParameterValues(gains=given["gains"], parameters=given["parameters"])
        if not has_orbit(values):
            return None
        wrong = replace(values, gains=given["wrong"])
        return [complaint(SEARCHES[kind](values, wrong, given["target"])) for kind in self.kinds]


def _free(wrong: ParameterValues, objective: Objective) -> SearchResult:
    problem = pendulum()
    judge = Verified(problem=problem)
    return search_orbits(problem, wrong, free=BOX, objective=objective, accept=judge)


SEARCHES: Mapping[str, Callable[[ParameterValues, ParameterValues, Any], SearchResult]] = {
    "fixed": lambda values, _, __: orbit_at_gains(pendulum(), values),
    "default": lambda _, wrong, __: _free(wrong, NearestGains(target={})),
    "nearest": lambda _, wrong, target: _free(wrong, NearestGains(target=target)),
    "contraction": lambda _, wrong, __: _free(wrong, MinSpectralRadius()),
}


def study(options: argparse.Namespace) -> tuple[list[list[str]], int]:
    """Return the complaints about problems with an orbit, and the number of problems tried."""
    kinds = tuple(options.kinds)
    problems = list(itertools.islice(random_problems(options.seed), MOST * options.problems))
    place = Workers(count=options.workers)
    identity = {
        "work": "search_success",
        "kinds": list(kinds),
        "script": hashlib.sha256(Path(__file__).read_bytes()).hexdigest(),
        "versions": versions(),
    }
    plan = ExecutionPlan(
        place=place if options.scheduler is None else Cluster(address=options.scheduler),
        chunk=1,
        checkpoint=options.checkpoint,
        identity=identity,
    )
    results: list[list[str]] = []
    tried = 0
    with (
        report.ProgressLine(lambda: None) as progress,
        closing(spread_in_order(Judge(kinds=kinds), problems, plan)) as found,
    ):
        while len(results) < options.problems and tried < len(problems):
            result = next(found)
            tried += 1
            if isinstance(result, FailedPoint):
                results.append([result.reason] * len(kinds))
            elif result is not None:
                results.append(result)
            done = len(results) / options.problems
            progress(f"{len(results)} of {options.problems} problems with an orbit", done)
    return results, tried


def main() -> int:
    """Run the study and return the exit code."""
    parser = argparse.ArgumentParser(description="How often a search finds and verifies an orbit.")
    parser.add_argument("--problems", type=int, default=200, help="problems with an orbit")
    parser.add_argument("--kinds", nargs="+", choices=SEARCHES, default=list(SEARCHES))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, help="processes; one a core by default")
    parser.add_argument("--scheduler", help="address of a Dask cluster to work on instead")
    parser.add_argument("--checkpoint", type=Path, help="keep what is finished here, and go on")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    try:
        results, tried = study(options)
    except ZenoOrbitsError as error:
        report.print_error(str(error))
        return 2
    if len(results) < options.problems:
        report.print_error(f"only {len(results)} of {tried} random problems have an orbit")
        return 1
    failures = [[entry for entry in column if entry] for column in zip(*results, strict=True)]
    rates = [1 - len(column) / len(results) for column in failures]
    if options.json:
        print(
            json.dumps({"problems": len(results), "rates": rates, "failures": failures}, indent=2)
        )
    else:
        print(f"{len(results)} problems with an orbit among {tried} random ones")
        for name, rate, column in zip(options.kinds, rates, failures, strict=True):
            print(f"{name:>12}: {100 * rate:5.1f} % found and verified")
            print(*(f"        {entry[:200]}" for entry in column), sep="\n", end="\n")
    return 0 if min(rates) >= GOAL else 1


if __name__ == "__main__":
    sys.exit(main())
