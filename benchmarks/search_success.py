"""How often a search finds and verifies an orbit of which a simulation says that it exists.

Random motor pendulums: masses and lengths within 40 % of the declared ones, `R` likewise, `L` over
one and a half decades, `e` from 0 to 0.8, gains over the region where orbits live. A scene counts
if a long simulation of it settles to one Zeno point a period, to 1e-6. Then

* fixed: the search at these gains must find the orbit, and the verifier must pass it;
* free: the search starts 30 % off in every gain, with all gains free, and must end in a verified
  orbit.

Prints the counts and every failure with its cause; exit 1 below 98 % fixed or 95 % free.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache

import numpy as np

from zeno_orbits.compiled import CompiledSystem, bind, compile_problem
from zeno_orbits.errors import InputError
from zeno_orbits.guess import settle
from zeno_orbits.problem import Problem, Setting, load_problem
from zeno_orbits.search import SearchResult, find_orbit, search_gains
from zeno_orbits.verify import verify

SETTLED = 1e-6
FIXED_GOAL, FREE_GOAL = 0.98, 0.95
BOX = {"Kp": (0.3, 12.0), "Kd": (-2.2, -0.2)}


@cache
def pendulum() -> tuple[Problem, CompiledSystem]:
    """Return the scene and its functions, once a process."""
    problem = load_problem("motor_pendulum")
    return problem, compile_problem(problem)


def random_settings(seed: int) -> Iterator[Setting]:
    """Yield random scenes that the calibration admits, without end."""
    problem, _ = pendulum()
    declared = problem.setting().parameters
    random = np.random.default_rng(seed)
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
            setting = problem.setting(gains=gains, parameters=chosen)
        except InputError:
            continue
        wrong = {name: value * k for (name, value), k in zip(gains.items(), off, strict=True)}
        yield setting
        yield replace(setting, gains=wrong)


def has_orbit(setting: Setting) -> bool:
    """Tell whether a long simulation settles to one Zeno point a period."""
    problem, compiled = pendulum()
    starts = [problem.state_vector(start) for start in problem.starts]
    cycle = settle(bind(compiled, setting.values()), starts).cycle
    return cycle is not None and cycle.drift(cycle.scale()) < SETTLED


def complaint(result: SearchResult) -> str:
    """Return why a search failed, or nothing if its orbit is verified."""
    if result.orbit is None:
        return f"{result.status.value} {result.detail}"
    certificate = verify(result.orbit, pendulum()[0])
    return "" if certificate.passed else certificate.verdict()


def judge(pair: tuple[Setting, Setting]) -> tuple[str, str] | None:
    """Return the complaints of the fixed and of the free search; ``None`` if there is no orbit."""
    setting, wrong = pair
    if not has_orbit(setting):
        return None
    problem = pendulum()[0]
    fixed = complaint(find_orbit(problem, setting))
    return fixed, complaint(search_gains(problem, wrong, free=BOX))


def main() -> int:
    """Run the study and return the exit code."""
    parser = argparse.ArgumentParser(description="How often a search finds and verifies an orbit.")
    parser.add_argument("--scenes", type=int, default=200, help="scenes with an orbit")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    started = time.perf_counter()
    source = random_settings(options.seed)
    results: list[tuple[str, str]] = []
    tried = 0
    with ProcessPoolExecutor(options.workers) as pool:
        while len(results) < options.scenes:
            batch = [(next(source), next(source)) for _ in range(4 * options.workers)]
            results += [result for result in pool.map(judge, batch) if result is not None]
            tried += len(batch)
            elapsed = time.perf_counter() - started
            left = elapsed * (options.scenes / max(len(results), 1) - 1)
            line = f"{len(results)} of {options.scenes} scenes, {max(left, 0.0):.0f} s left\n"
            sys.stderr.write(line)
    results = results[: options.scenes]
    failures = [[entry for entry in column if entry] for column in zip(*results, strict=True)]
    rates = [1 - len(column) / len(results) for column in failures]
    if options.json:
        print(json.dumps({"scenes": len(results), "rates": rates, "failures": failures}, indent=2))
    else:
        print(f"{len(results)} scenes with an orbit among {tried} random ones")
        for name, rate, column in zip(("fixed", "free"), rates, failures, strict=True):
            print(f"{name:>6}: {100 * rate:5.1f} % found and verified")
            print(*(f"        {entry[:200]}" for entry in column), sep="\n", end="\n")
    return 0 if rates[0] >= FIXED_GOAL and rates[1] >= FREE_GOAL else 1


if __name__ == "__main__":
    sys.exit(main())
