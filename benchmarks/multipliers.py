"""Time a return with its exact derivatives beside a plain one, and its multipliers by differences.

    python benchmarks/multipliers.py [--repeats 15]

Processor time in one process, so read the ratios: medians on the reference orbit, then the least
times on orbits of several problems, with plain returns and returns with derivatives in turns, then
a family. The errors of the multipliers are measured against the slope that differences of 20 digits
give.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.reference.many_digits.fixed_point import extended_orbit
from zeno_orbits.continuation import family_of_orbit, start_orbit
from zeno_orbits.integrators.flow import Tolerance
from zeno_orbits.model.library import load_problem
from zeno_orbits.orbits.monodromy import return_derivative
from zeno_orbits.orbits.poincare import orbit_multipliers, poincare_map
from zeno_orbits.search import orbit_by_shooting
from zeno_orbits.simulation.simulator import SimulationSettings


def median_time(call: Callable[[], Any], repeats: int) -> float:
    """Return the median processor time of a call, warm [ms]."""
    call()
    times: list[float] = []
    for _ in range(repeats):
        started = time.process_time()
        call()
        times.append(1e3 * (time.process_time() - started))
    return statistics.median(times)


PROBLEMS = ("motor_pendulum", "forced_oscillator", "torque_pendulum", "two_motors")


def least_times(calls: Sequence[Callable[[], Any]], repeats: int) -> list[float]:
    """Return the least processor time of calls that are made in turns, warm [ms]."""
    least = [float("inf")] * len(calls)
    for turn in range(repeats + 1):
        for k, call in enumerate(calls):
            started = time.process_time()
            call()
            if turn:
                least[k] = min(least[k], 1e3 * (time.process_time() - started))
    return least


def compare_returns(name: str, repeats: int) -> str:
    """Return a line with the times of a return of a problem, plain and with derivatives."""
    problem, settings = load_problem(name), SimulationSettings()
    values = problem.values()
    orbit = orbit_by_shooting(problem, values, simulation=settings).unwrap()
    x, horizon = np.array(list(orbit.release_state.values())), 2 * orbit.period
    dynamics = problem.dynamics(values)

    def with_derivative(*parameters: int) -> object:
        return return_derivative(
            dynamics, x, horizon=horizon, settings=settings, parameters=parameters
        )

    plain, alone, two = least_times(
        [
            lambda: poincare_map(dynamics, x, horizon=horizon, settings=settings),
            with_derivative,
            lambda: with_derivative(0, 1),
        ],
        repeats,
    )
    return (
        f"{name:<20} {plain:7.2f} {alone:7.2f} {alone / plain:6.1f} {two:7.2f} {two / plain:6.1f}"
    )


def time_family(repeats: int) -> float:
    """Return the least processor time of the family in the restitution, warm [s]."""
    problem = load_problem("motor_pendulum")
    orbit = start_orbit(problem, problem.values())
    call = partial(family_of_orbit, problem, orbit, "restitution", (0.0, 0.5))
    return 1e-3 * least_times([call], repeats)[0]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=15)
    repeats = parser.parse_args().repeats
    problem = load_problem("motor_pendulum")
    values = problem.values()
    orbit = orbit_by_shooting(problem, values, simulation=SimulationSettings()).unwrap()
    x, period = np.array(list(orbit.release_state.values())), orbit.period
    scale, horizon = 1.0 + np.abs(x), 2 * period
    dynamics = problem.dynamics(values)
    plain = replace(dynamics, differentiation=None)
    truth = np.array(extended_orbit(problem, values, x.tolist(), digits=20).multipliers)
    print(
        f"{'tolerance':>9}  {'what':<34} {'ms':>7} {'ratio':>6}  {'true error':>10} {'claimed':>8}"
    )
    for exponent in (12, 10, 8):
        tolerance = Tolerance(relative=10.0**-exponent, absolute=10.0 ** -(exponent + 1))
        settings = SimulationSettings(tolerance=tolerance)

        def returned(k: int, settings: SimulationSettings = settings) -> object:
            parameters = tuple(range(k))
            return return_derivative(
                dynamics, x, horizon=horizon, settings=settings, parameters=parameters
            )

        def multipliers(system: Any, settings: SimulationSettings = settings) -> Any:
            return orbit_multipliers(system, x, scale=scale, period=period, settings=settings)

        def mapped(settings: SimulationSettings = settings) -> object:
            return poincare_map(dynamics, x, horizon=horizon, settings=settings)

        alone = median_time(mapped, repeats)
        rows: list[tuple[str, Callable[[], Any], Any]] = [
            ("return", mapped, None),
            ("return and derivative", lambda: returned(0), None),
            ("return and derivative, 2 parameters", lambda: returned(2), None),
            ("multipliers", lambda: multipliers(dynamics), multipliers(dynamics)),
            ("multipliers by differences", lambda: multipliers(plain), multipliers(plain)),
        ]
        for name, call, found in rows:
            spent = median_time(call, repeats)
            line = f"{10.0**-exponent:9.0e}  {name:<34} {spent:7.1f} {spent / alone:6.1f}"
            if found is not None:
                off = float(np.max(np.abs(np.array(found.values) - truth)))
                line += f"  {off:10.1e} {found.error:8.0e}"
            print(line)
    print(
        f"\n{'returns [ms]':<20} {'plain':>7} {'slope':>7} {'ratio':>6} {'and 2 p':>7} {'ratio':>6}"
    )
    for name in PROBLEMS:
        print(compare_returns(name, repeats))
    print(f"\nfamily in restitution from 0 to 0.5: {time_family(2):.2f} s")


if __name__ == "__main__":
    main()
