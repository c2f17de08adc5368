"""Time the default engine and CasADi's compiled `rosenbrock` in turns, at equal error.

Both are in one process and take turns from run to run, so that a busy machine meets both alike. The
motor pendulum is followed for 20 s as in `beside_others.py`, from its release and from states up to
30 % away from it. Errors are held against our own result at 1e-13, which `beside_others.py`
confirms: their geometric mean over the starts, and the largest.
"""

from __future__ import annotations

import argparse
import math
import os
import random
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from beside_others import distance, milliseconds, time_at

sys.path.insert(0, str(Path(__file__).with_name("others")))

import casadi_events
import ours
import work

from zeno_orbits.integrators import Automatic

OURS, THEIRS = "ours, automatic", "CasADi ros. with jit"
ASKED = {
    OURS: (1e-3, 1e-4, 1e-5, 3e-6, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10),
    THEIRS: (1e-4, 1e-5, 3e-6, 1e-6, 3e-7, 1e-7, 1e-8, 1e-9, 1e-10),
}
"""Tolerances of each."""

LEVELS = (1e-5, 1e-6, 1e-7, 1e-8, 1e-9)
"""Errors at which times are compared."""

EXACT = 1e-13
"""Tolerance of what errors are held against."""

Start = Sequence[float]


def prepared(name: str, accuracy: float, start: Start) -> Callable[[], work.Motion]:
    """Return a motion as a function without arguments."""
    if name == OURS:
        return ours.prepare(Automatic(), work.REFERENCE_RATE, accuracy, start, False)
    return casadi_events.prepare(
        "rosenbrock", work.REFERENCE_RATE, accuracy, start, False, compiled=True
    )


def starts(count: int) -> list[Start]:
    """Return the release of the reference orbit, and states around it with the gap closed."""
    chance = random.Random(0)
    around = [
        [entry * chance.uniform(0.7, 1.3) for entry in work.RELEASE] for _ in range(count - 1)
    ]
    return [work.RELEASE, *around]


def main() -> int:
    """Print a line for each tolerance, then the times at equal error."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--runs", type=int, default=15, metavar="N", help="runs of each motion")
    parser.add_argument("--starts", type=int, default=8, metavar="N", help="states to start from")
    options = parser.parse_args()
    if min(options.runs, options.starts) < 1:
        parser.error("--runs and --starts must be at least 1")
    chosen = starts(options.starts)
    truths = [prepared(OURS, EXACT, start)().state for start in chosen]
    rows = [(name, accuracy) for name, those in ASKED.items() for accuracy in those]
    tasks = {row: [prepared(*row, start) for start in chosen] for row in rows}
    errors = {
        row: [distance(task().state, truth) for task, truth in zip(motions, truths, strict=True)]
        for row, motions in tasks.items()
    }
    times = {row: [list[float]() for _ in chosen] for row in rows}
    for _ in range(options.runs):
        for row, motions in tasks.items():
            for task, taken in zip(motions, times[row], strict=True):
                started = time.thread_time()
                task()
                taken.append(time.thread_time() - started)
    print(f"{'':22}{'asked':>8}{'time [ms]':>11}{'mean error':>12}{'largest':>10}")
    points: dict[str, list[tuple[float, float, float]]] = {OURS: [], THEIRS: []}
    for name, accuracy in rows:
        those = errors[name, accuracy]
        took = statistics.fmean(map(statistics.median, times[name, accuracy]))
        mean, largest = math.exp(statistics.fmean(map(math.log, those))), max(those)
        points[name].append((mean, largest, took))
        print(f"{name:22}{accuracy:8.0e}{milliseconds(took):>11}{mean:12.1e}{largest:10.1e}")
    for k, kind in enumerate(("mean", "largest")):
        print(f"\nat equal {kind} error{'ours':>10}{'CasADi':>10}{'ratio':>8}")
        for level in LEVELS:
            own, their = (time_at(level, [(p[k], p[2]) for p in points[n]]) for n in (OURS, THEIRS))
            ratio = f"{own / their:.2f}" if own and their else "-"
            print(f"{level:>18.0e}{milliseconds(own):>13}{milliseconds(their):>10}{ratio:>8}")
    return 0


if __name__ == "__main__":
    # CasADi warns on stdout's and stderr's descriptors; stdout is for the result.
    result = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    sys.stdout = result
    sys.exit(main())
