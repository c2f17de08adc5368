"""Processor time of tables and records beside the same motion without them.

A cubic table of 10 000 knots is run beside one of 10 over the same motion, a record of 100 000
samples over 100 s, and a map of `measured_valve` with no share of its table beside one of
`relief_valve`, which is the same machine. Rows of ratios are medians of runs in turns. Knots of
linear and monotone tables are events, so their times are given per knot that is passed.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import zeno_orbits as zo
from tests.support.tabled import followed, mass, oscillator, wavy

MOST_KNOTS, MOST_POINT, MOST_RECORD = 1.5, 1.5, 5.0
"""Ratio of 10 000 knots to 10, ratio of map points, and time of the record [s]."""
MOST_ERROR = 1e-9
"""Of the state after the record, against matrix exponentials."""
PLANE: dict[str, Any] = {"x": ("q", 2.0, 4.0, 3), "y": ("restitution", 0.5, 0.8, 2)}


def seconds(run: Callable[[], Any]) -> float:
    """Return the processor time of a call."""
    begin = time.process_time()
    run()
    return time.process_time() - begin


def in_turns(first: Callable[[], Any], second: Callable[[], Any], n: int) -> tuple[float, float]:
    """Return the medians of two calls that take turns."""
    first(), second()
    pairs = [(seconds(first), seconds(second)) for _ in range(n)]
    return statistics.median(a for a, _ in pairs), statistics.median(b for _, b in pairs)


def falls(n: int, kind: str) -> Callable[[], Any]:
    """Return a run of a mass that falls on its stop under a table of `n` knots."""
    problem = mass(lambda x, _: zo.table(x, *wavy(n), kind, outside="extend"))
    return partial(zo.simulate, problem, until=1.5)


def row(what: str, *cells: str) -> None:
    """Print a row of the table."""
    print("|", " | ".join((what, *cells)), "|", flush=True)


def main() -> int:
    """Print the times and return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--runs", type=int, default=41, help="runs of a median")
    options = parser.parse_args()
    row("processor time", "without, or 10 knots", "with, or 10 000 knots", "ratio")
    row("---", "---", "---", "---")
    few, many = in_turns(falls(10, "cubic"), falls(10_000, "cubic"), options.runs)
    row("cubic table", f"{1e3 * few:.2f} ms", f"{1e3 * many:.2f} ms", f"{many / few:.2f}")
    for kind in ("linear", "monotone"):
        run = falls(10_000, kind)
        n = len(run().switches)
        taken = statistics.median(seconds(run) for _ in range(9))
        row(f"{kind} table", "", f"{1e6 * taken / n:.1f} us a knot", "")
    plain, measured = (
        partial(zo.parameter_map, name, **PLANE, parameters=values)
        for name, values in (("relief_valve", {}), ("measured_valve", {"share": 0.0}))
    )
    smooth, tabled = in_turns(plain, measured, max(3, options.runs // 8))
    n = PLANE["x"][3] * PLANE["y"][3]
    row(
        "point of a map",
        f"{1e3 * smooth / n:.0f} ms",
        f"{1e3 * tabled / n:.0f} ms",
        f"{tabled / smooth:.2f}",
    )
    times = np.linspace(0.0, 100.0, 100_001)
    inputs = np.random.default_rng(0).normal(size=len(times))
    made: list[Any] = []
    record = seconds(
        lambda: made.append(zo.simulate(oscillator(zo.record(times, inputs)), until=100.0))
    )
    error = float(np.max(np.abs(made[0].end_state[:2] - followed(times, inputs, 100.0))))
    row("record of 100 000 samples", "", f"{record:.2f} s", f"error {error:.0e}")
    good = many <= MOST_KNOTS * few and tabled <= MOST_POINT * smooth and record <= MOST_RECORD
    return int(not good or error > MOST_ERROR)


if __name__ == "__main__":
    sys.exit(main())
