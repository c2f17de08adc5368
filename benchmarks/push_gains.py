"""Least pushes of the orbits that several objectives find, on three problems.

    python benchmarks/push_gains.py [--problems NAME ...] [--objectives NAME ...]

The stated gains or parameters are free in their ranges. Each orbit is then pushed with the
same settings, finer than those of the search: 12 phases, 48 impulses. The ratio is that of its
least push to the least push of `nearest`. `push` must have the largest one.
"""

from __future__ import annotations

import argparse
import math
import sys
import time

import zeno_orbits as zo

CASES = {
    "motor_pendulum": {"Kd": (-1.5, -0.4)},
    "two_motors": {"Kp": (1.5, 4.0), "Kd2": (0.05, 0.3)},
    "torque_pendulum": {"A": (0.27, 0.33), "b1": (0.08, 0.12)},
}
"""Free gains or parameters of each problem, with their ranges. The last problem has a clock."""
OBJECTIVES = {
    "nearest": None,
    "contraction": zo.MinSpectralRadius(),
    "margin": zo.MaxMargin(),
    "push": zo.MaxPush(),
}
FINER = zo.PushSettings(phases=12, steps=48, error=1e-3)


def measured(problem: str, objective: str, starts: int) -> tuple[str, float, str]:
    """Return the free values, the least push and its unit, or the reason of a failure."""
    free = CASES[problem]
    try:
        result = zo.search_gains(
            problem,
            vary=free,
            objective=OBJECTIVES[objective],
            settings=zo.SearchSettings(n_starts=starts),
        )
    except zo.InputError as error:
        return str(error), 0.0, ""
    if result.orbit is None:
        return result.detail, 0.0, ""
    values = {**result.orbit.gains, **result.orbit.parameters}
    where = ", ".join(f"{name} = {values[name]:.5g}" for name in free)
    pushes = zo.largest_push(result.orbit, settings=FINER)
    least = pushes.least
    if least is None:
        return where, min(push.searched for push in pushes.pushes), "none lost"
    return where, least.largest, least.unit


def main() -> int:
    """Print the table, and return 1 if another objective has a larger least push than `push`."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--problems", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--objectives", nargs="+", choices=list(OBJECTIVES), default=[])
    parser.add_argument("--starts", type=int, default=6, help="starts of a search (default: 6)")
    options = parser.parse_args()
    beaten = False
    print(f"{'problem':16} {'objective':12} {'least push':>11} {'ratio':>6} {'time [s]':>9}  at")
    for problem in options.problems:
        found: dict[str, float] = {}
        for objective in options.objectives or OBJECTIVES:
            begun = time.process_time()
            where, push, unit = measured(problem, objective, options.starts)
            found[objective] = push
            ratio = push / found["nearest"] if found.get("nearest") else math.nan
            took = time.process_time() - begun
            row = f"{problem:16} {objective:12} {push:11.5g} {ratio:6.2f} {took:9.1f}"
            print(f"{row}  {where} {unit}")
            sys.stdout.flush()
        # The finer scan finds losses that the scan of the search misses.
        beaten |= found.get("push", math.inf) < 0.99 * max(found.values())
    return int(beaten)


if __name__ == "__main__":
    sys.exit(main())
