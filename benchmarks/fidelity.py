"""Measure what the reduced models of `motor_pendulum` cost in accuracy and save in time.

At each inductance the orbits of the full problem, of the quasi-static and of the corrected one are
found by Newton's method on the return map, and compared. A fourth model is built here only: the
slow manifold without the impulse of the current's layer, which is what a correction is worth that
leaves the impacts alone. `order` is the slope of an error against the row before.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import casadi as ca
import numpy as np

from zeno_orbits.model.hybrid import CompletedSystem
from zeno_orbits.model.library import load_problem
from zeno_orbits.model.numeric.binding import bind
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.model.problem import Problem
from zeno_orbits.orbits import EventReturn
from zeno_orbits.precision.reduced_models import (
    CORRECTED,
    LANDMARKS,
    QUASI_STATIC,
    errors_of_reduced_models,
    landmark_errors,
    reduced_orbit_near,
)
from zeno_orbits.search import orbit_at_gains
from zeno_orbits.simulation.simulator import simulate

INDUCTANCES = (2e-2, 6e-3, 2e-3, 6e-4, 2e-4, 6e-5, 2e-5, 6e-6)
"""L/R from 7e-3 to 2e-6 s."""

MANIFOLD = "manifold"

TENFOLD = 10.0
"""The corrected model has to be better than the quasi-static one by this, at L = 2 mH and below."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One model at one inductance.

    Attributes:
        inductance: [H].
        model: Which.
        states: Its number of states.
        period_time: Wall time of one simulated period, a median [s].
        errors: Landmark to relative error; empty for the full problem.
        orders: Landmark to observed order; empty for the full problem and at the first inductance.
        estimate: Landmark to the error that was estimated beforehand, where there is an estimate.
    """

    inductance: float
    model: str
    states: int
    period_time: float
    errors: Mapping[str, float]
    orders: Mapping[str, float]
    estimate: Mapping[str, float]


def manifold_only(problem: Problem) -> Problem:
    """Return the corrected problem with the impacts of the quasi-static one."""
    corrected, static = problem.at_fidelity(CORRECTED), problem.at_fidelity(QUASI_STATIC)

    def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
        flowing, striking = corrected.model(p), static.model(p)
        direction = ca.substitute(striking.impulse_direction, striking.state, flowing.state)
        return replace(flowing, impulse_direction=direction, law=striking.law)

    return replace(corrected, model=model)


def timed(dynamics: HybridDynamics, cycle: EventReturn, n_runs: int) -> float:
    """Return the median wall time of one period [s]."""
    times: list[float] = []
    for _ in range(n_runs):
        started = time.perf_counter()
        simulate(dynamics, cycle.start, until=cycle.period)
        times.append(time.perf_counter() - started)
    return statistics.median(times)


def orders(now: Row | None, errors: Mapping[str, float], inductance: float) -> dict[str, float]:
    """Return the slopes of the errors since the row before."""
    if now is None:
        return {}
    step = math.log(now.inductance / inductance)
    return {name: math.log(now.errors[name] / errors[name]) / step for name in errors}


def measure(problem: Problem, inductances: Sequence[float], n_runs: int) -> list[Row]:
    """Return the rows of all models, inductance by inductance."""
    models = {
        QUASI_STATIC: problem.at_fidelity(QUASI_STATIC),
        MANIFOLD: manifold_only(problem),
        CORRECTED: problem.at_fidelity(CORRECTED),
    }
    compiled = {name: one.compiled() for name, one in {"full": problem, **models}.items()}
    static = models[QUASI_STATIC]
    orbit = orbit_at_gains(static, static.values()).unwrap()
    release = np.array(static.state_vector(orbit.release_state))
    rows: list[Row] = []
    last: dict[str, Row] = {}
    for inductance in inductances:
        values = problem.values(parameters={"L": inductance})
        found: dict[str, tuple[HybridDynamics, EventReturn]] = {}
        near = release
        for name in (QUASI_STATIC, MANIFOLD, CORRECTED, "full"):
            one = models.get(name, problem)
            dynamics = bind(compiled[name], one.shared(values).vector)
            cycle = reduced_orbit_near(one, values, near, orbit.period)
            found[name] = (dynamics, cycle)
            near = cycle.start[: len(release)]
        truth = found["full"][1]
        costs = errors_of_reduced_models(problem, values)
        for name, (dynamics, cycle) in found.items():
            errors = {} if name == "full" else landmark_errors(cycle, truth)
            row = Row(
                inductance=inductance,
                model=name,
                states=len(dynamics.state_names),
                period_time=timed(dynamics, cycle, n_runs if name != "full" else 1),
                errors=errors,
                orders=orders(last.get(name), errors, inductance),
                estimate=costs[name].estimate if name in costs else {},
            )
            last[name] = row
            rows.append(row)
    return rows


def print_table(rows: Sequence[Row]) -> None:
    """Print one line a model and inductance: errors, orders in parentheses, and times."""
    print("L [H]   model         states  period [ms]  " + "  ".join(f"{n:>14}" for n in LANDMARKS))
    for row in rows:
        cells = [
            f"{row.errors[name]:.1e} ({row.orders[name]:4.2f})"
            if name in row.orders
            else f"{row.errors[name]:.1e}       "
            for name in row.errors
        ]
        told = [f"{error:.1e}" for error in row.estimate.values()]
        print(
            f"{row.inductance:<8g}{row.model:14}{row.states:6d}{1e3 * row.period_time:13.1f}  "
            + "  ".join(f"{cell:>14}" for cell in cells)
        )
        if told:
            print(f"{'estimated beforehand':43}" + "  ".join(f"{cell:14}" for cell in told))


def main() -> int:
    """Measure and print; 1 if the correction does not pay."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--runs", type=int, default=5, metavar="N", help="runs of each timing")
    parser.add_argument(
        "--least", type=float, default=6e-5, metavar="H", help="leave out smaller inductances"
    )
    parser.add_argument("--json", action="store_true", help="print JSON for programs")
    options = parser.parse_args()
    if options.runs < 1:
        parser.error(f"--runs must be at least 1, but it is {options.runs}")
    inductances = [one for one in INDUCTANCES if one >= options.least]
    if not inductances:
        parser.error(f"--least must be at most {INDUCTANCES[0]:g}, but it is {options.least:g}")
    rows = measure(load_problem("motor_pendulum"), inductances, options.runs)
    by = {(row.inductance, row.model): row for row in rows}
    pays = all(
        TENFOLD * by[one, CORRECTED].errors[name] < by[one, QUASI_STATIC].errors[name]
        for one in inductances
        if one <= 2e-3
        for name in LANDMARKS
    )
    if options.json:
        print(json.dumps({"pays": pays, "rows": [asdict(row) for row in rows]}, indent=2))
    else:
        print_table(rows)
        print("\nErrors are relative: times to the period, states to their size.")
        print(f"The correction {'pays' if pays else 'does NOT pay'} tenfold at L = 2 mH and below.")
    return 0 if pays else 1


if __name__ == "__main__":
    sys.exit(main())
