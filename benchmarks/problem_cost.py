"""Measure what a problem costs: states, formulas, and the time to compile, simulate and solve it.

Only what a problem needs is modelled: without a motor there is no current, and a mechanism of one
coordinate has the formulas of one. Prints the table of `docs/performance.md`.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, fields, is_dataclass, replace

import casadi as ca

from zeno_orbits.model.library import load_problem
from zeno_orbits.search import orbit_at_gains
from zeno_orbits.simulation.simulator import simulate

PROBLEMS = ("bouncing_ball", "vibrating_table", "motor_valve", "motor_pendulum", "two_motors")
NO_ORBIT = {"bouncing_ball": 4.0}
"""Problem without an orbit: the time to simulate instead of a period [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """What a problem costs; times are medians of processor time [ms].

    Attributes:
        problem: Its name.
        states: Number of states.
        functions: Functions that are built for it.
        operations: Elementary operations in all of them.
        compiling: Time to build them.
        simulating: Time of a period, or of a fall until rest where there is no orbit.
        solving: Time of a whole search at given gains; nothing without an orbit.
    """

    problem: str
    states: int
    functions: int
    operations: int
    compiling: float
    simulating: float
    solving: float | None


def functions_in(value: object) -> Iterator[ca.Function]:
    """Yield the functions that a value holds."""
    if isinstance(value, ca.Function):
        yield value
    elif is_dataclass(value) and not isinstance(value, type):
        for one in fields(value):
            yield from functions_in(getattr(value, one.name))
    elif isinstance(value, tuple | list):
        for one in value:
            yield from functions_in(one)


def median_time(work: Callable[[], object], runs: int) -> float:
    """Return the median processor time of some work after a run that does not count [ms]."""
    times: list[float] = []
    for _ in range(runs + 1):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return 1e3 * statistics.median(times[1:])


def cost_of(name: str, runs: int) -> Cost:
    """Return what a problem costs at its own numbers."""
    problem = load_problem(name)
    values = problem.values()
    compiled = problem.compiled()
    built = {id(function): function for function in functions_in(compiled)}.values()
    dynamics = problem.dynamics(values)
    if name in NO_ORBIT:
        start, until, solving = problem.state_vector(problem.starts[0]), NO_ORBIT[name], None
    else:
        orbit = orbit_at_gains(problem, values).unwrap()
        start, until = problem.state_vector(orbit.release_state), orbit.period
        solving = median_time(lambda: orbit_at_gains(problem, values).unwrap(), runs)
    return Cost(
        problem=name,
        states=len(problem.state_names),
        functions=len(built),
        operations=sum(function.n_instructions() for function in built),
        compiling=median_time(lambda: replace(problem, origin=None).compiled(), runs),
        simulating=median_time(lambda: simulate(dynamics, start, until=until), runs),
        solving=solving,
    )


def table(costs: list[Cost]) -> str:
    """Return the costs as a Markdown table."""
    lines = [
        "| Problem | states | functions | operations | compile | a period | search |",
        "|---|---|---|---|---|---|---|",
    ]
    for cost in costs:
        solving = "no orbit" if cost.solving is None else f"{cost.solving:.0f} ms"
        cells = (cost.problem, cost.states, cost.functions, cost.operations)
        times = (f"{cost.compiling:.0f} ms", f"{cost.simulating:.1f} ms", solving)
        lines.append(f"| {' | '.join(map(str, (*cells, *times)))} |")
    return "\n".join(lines)


def main() -> int:
    """Print the table; exit 1 if the simplest problem is not cheaper than the pendulum."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    costs = [cost_of(name, options.runs) for name in PROBLEMS]
    print(json.dumps([asdict(cost) for cost in costs], indent=2) if options.json else table(costs))
    by_name = {cost.problem: cost for cost in costs}
    simple, pendulum = by_name["vibrating_table"], by_name["motor_pendulum"]
    cheaper = simple.operations < pendulum.operations and simple.compiling < pendulum.compiling
    return 0 if cheaper and (simple.solving or 0.0) < (pendulum.solving or 0.0) else 1


if __name__ == "__main__":
    sys.exit(main())
