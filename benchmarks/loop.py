"""Time the compiled loop beside the paths that it replaces, and beside heyoka by hand.

All take turns in one process, from run to run, so that a busy machine meets them alike. The motor
pendulum is followed for 20 s from the release of its orbit, as in `beside_others.py`. Times are
those of the processor, medians. Errors are held against our own result at 1e-13, which
`beside_others.py` confirms.

* *loop, by tape*: nothing is compiled for the problem; its formulas are carried out as tapes.
* *loop, compiled*: the same with the formulas of the problem compiled, which changes no digit.
* *interpreted*: the plain simulator in Python, the reference.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

from beside_others import distance, milliseconds, time_at

sys.path.insert(0, str(Path(__file__).with_name("others")))

import numpy as np
import ours
import work

from zeno_orbits.integrators import Automatic
from zeno_orbits.loop import loop_account, program_of
from zeno_orbits.model import HybridDynamics, bind, load_problem
from zeno_orbits.simulation import Execution, SimulationTask, by_reference, simulate

TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11)
LEVELS = (1e-6, 1e-8, 1e-10)
EXACT = 1e-13
RATES = (1e3, 1e4, 1e5, 1e6)

LOOP, COMPILED, HEYOKA = "loop, by tape", "loop, compiled", "heyoka by hand"
PLAIN = "interpreted"


@cache
def _dynamics(name: str, rate: float) -> HybridDynamics:
    """Return the motor pendulum with formulas of its own, compiled or not."""
    problem = load_problem("motor_pendulum")
    system = problem.compiled(lambda system: system) if name == COMPILED else problem.compiled()
    program = program_of(system)
    if name == COMPILED and program is not None and not program.is_compiled:
        program.compile()
    return bind(system, problem.values(parameters=work.declared(rate)).vector)


def _moved(run: Execution) -> work.Motion:
    # Whoever asks for the end of the loop's record makes its arcs into values.
    return work.Motion(state=run.end_state.tolist(), locks=len(run.zeno_points))


def prepared(name: str, accuracy: float, rate: float) -> Callable[[], work.Motion]:
    """Return a motion as a function without arguments."""
    if name == HEYOKA:
        import heyoka_by_hand

        return heyoka_by_hand.prepare(rate, accuracy, work.RELEASE, False)
    settings = ours.settings(accuracy, Automatic())
    if name in (LOOP, COMPILED):
        dynamics = _dynamics(name, rate)
        return lambda: _moved(
            simulate(dynamics, work.RELEASE, until=work.HORIZON, settings=settings)
        )
    dynamics = ours.problem("motor_pendulum", rate)
    formulas = dynamics.formulas
    if formulas is not None:
        dynamics = bind(formulas.system.interpreted(), formulas.values)
    task = SimulationTask(
        dynamics=dynamics,
        state=np.array(work.RELEASE),
        until=work.HORIZON,
        settings=settings,
    )
    return lambda: _moved(by_reference(task))


def in_turns(tasks: Sequence[Callable[[], work.Motion]], runs: int) -> list[float]:
    """Return the median processor time of each task, all in turns."""
    times: list[list[float]] = [[] for _ in tasks]
    for task in tasks:
        task()
    for _ in range(runs):
        for task, taken in zip(tasks, times, strict=True):
            started = time.thread_time()
            task()
            taken.append(time.thread_time() - started)
    return [statistics.median(taken) for taken in times]


def _first_call() -> tuple[float, float]:
    """Return the processor time of a first call on a problem, from its file on, and of another."""
    times: list[float] = []
    for _ in range(2):
        started = time.thread_time()
        problem = load_problem("motor_pendulum")
        run = simulate(problem.dynamics(problem.values()), work.RELEASE, until=work.HORIZON)
        len(run.events)
        times.append(time.thread_time() - started)
    return times[0], times[1]


def main() -> int:
    """Print a line for each tolerance, then the times at equal error."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--runs", type=int, default=15, metavar="N", help="runs of each motion")
    parser.add_argument("--no-reference", action="store_true", help="leave out the reference")
    options = parser.parse_args()
    print(f"{loop_account()}.")
    first, later = _first_call()
    print(f"first call on a problem {milliseconds(first)} ms, later {milliseconds(later)} ms")
    names = [LOOP, COMPILED, *(() if options.no_reference else (PLAIN,))]
    if importlib.util.find_spec("heyoka") is not None:
        names.append(HEYOKA)
    truth = prepared(LOOP, EXACT, work.REFERENCE_RATE)().state
    rows = [(name, accuracy) for accuracy in TOLERANCES for name in names]
    tasks = [prepared(*row, work.REFERENCE_RATE) for row in rows]
    errors = [distance(task().state, truth) for task in tasks]
    times = in_turns(tasks, options.runs)
    points: dict[str, list[tuple[float, float]]] = {name: [] for name in names}
    print(f"{'':22}{'asked':>8}{'time [ms]':>11}{'error':>10}")
    for (name, accuracy), error, took in zip(rows, errors, times, strict=True):
        points[name].append((error, took))
        print(f"{name:22}{accuracy:8.0e}{milliseconds(took):>11}{error:10.1e}")
    print(f"\n{'at equal error':22}" + "".join(f"{level:>10.0e}" for level in LEVELS))
    for name in names:
        shown = [milliseconds(time_at(level, points[name])) for level in LEVELS]
        print(f"{name:22}" + "".join(f"{one:>10}" for one in shown))
    print("\nR/L [1/s] at 1e-6      " + "".join(f"{rate:>10.0e}" for rate in RATES))
    for name in (LOOP, COMPILED):
        stiff = in_turns([prepared(name, 1e-6, rate) for rate in RATES], options.runs)
        print(f"{name:22} " + "".join(f"{milliseconds(one):>10}" for one in stiff))
    return 0


if __name__ == "__main__":
    os.environ.setdefault("ZENO_ORBITS_CACHE", tempfile.mkdtemp(prefix="zeno_orbits_"))
    sys.exit(main())
