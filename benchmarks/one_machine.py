"""A machine with one stop beside the same machine as a graph of modes: times and abilities.

    python benchmarks/one_machine.py [--only times|abilities]

`times` simulates every bundled problem with one stop, closes and verifies its orbit, by both roads
in turns, and prints processor times and their ratios, or those of `--problems NAME ...`.
`abilities` calls every public function that takes an orbit (or those of `--tasks NAME ...`) with
three orbits: of a machine with one stop, of the same machine as a graph, and of a machine with two
stops. A refusal counts as "no".
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import zeno_orbits as zo
from zeno_orbits.model import Problem, bundled_problems, load_problem
from zeno_orbits.simulation import simulate

ABLE = 47
"""Abilities that must remain."""
ONE_STOP, TWO_STOPS = "forced_oscillator", "clapper"


def in_turns(first: Callable[[], Any], other: Callable[[], Any], turns: int) -> tuple[float, float]:
    """Return the least processor times of two tasks that are carried out in turns [s]."""
    spent: tuple[list[float], list[float]] = ([], [])
    for _ in range(turns):
        for task, times in zip((first, other), spent, strict=True):
            begin = time.process_time()
            task()
            times.append(time.process_time() - begin)
    return min(spent[0]), min(spent[1])


def times_of(problem: Problem) -> dict[str, tuple[float, float]]:
    """Return the times of every task by the road with one stop and by the graph [s]."""
    values, start = problem.values(), problem.initial_state(None)
    one, graph = problem.dynamics(values), problem.graph_dynamics(values)
    until = 10 * one.own.time
    found = {
        "run": in_turns(
            lambda: simulate(one, start, until=until),
            lambda: simulate(graph, start, until=until),
            15,
        )
    }
    orbit = zo.find_orbit(problem).orbit
    if orbit is None:
        return found
    events = zo.find_orbit(problem).unwrap()
    found["close"] = in_turns(
        lambda: zo.find_orbit_by_shooting(problem, near=orbit),
        lambda: zo.find_orbit(problem, near=events).unwrap(),
        3,
    )
    found["verify"] = in_turns(
        lambda: zo.verify(orbit, problem=problem), lambda: zo.verify(events, problem=problem), 3
    )
    return found


def print_times(names: Sequence[str]) -> None:
    """Print processor times of both roads, and their median ratio."""
    ratios: dict[str, list[float]] = {}
    for name in names:
        told: list[str] = []
        for task, (one, graph) in times_of(load_problem(name)).items():
            ratios.setdefault(task, []).append(graph / one)
            told.append(f"{task} {1e3 * one:.2f} / {1e3 * graph:.2f} ms ({graph / one:.2f})")
        print(f"{name:20s} {'; '.join(told)}", flush=True)
    for task, values in ratios.items():
        print(f"{task}: median ratio {statistics.median(values):.2f}")


def _recording(orbit: Any) -> Any:
    if orbit.has_phases:
        return zo.rig_recording(zo.simulate_experiment(orbit, cycles=3).run)
    return zo.rig_recording(zo.simulate_periods(orbit, periods=3))


def _written(orbit: Any, path: Path) -> Any:
    zo.write_orbit(orbit, path)
    return zo.read_orbit(path)


def _family(orbit: Any) -> Any:
    name = "restitution" if "restitution" in orbit.parameters else next(iter(orbit.parameters))
    value = orbit.parameters[name]
    return zo.continue_orbit(orbit, name, (0.9 * value, 1.1 * value))


def _fitted(orbit: Any) -> Any:
    name = "restitution" if "restitution" in orbit.parameters else next(iter(orbit.parameters))
    return zo.identify(orbit.problem, _recording(orbit), [name])


TASKS: dict[str, Callable[[Any, Path], Any]] = {
    "verify": lambda orbit, _: zo.verify(orbit),
    "floquet_multipliers": lambda orbit, _: zo.floquet_multipliers(orbit),
    "prove": lambda orbit, _: zo.prove(orbit),
    "enclose_period": lambda orbit, _: zo.enclose_period(orbit),
    "continue_orbit": lambda orbit, _: _family(orbit),
    "largest_push": lambda orbit, _: zo.largest_push(orbit, settings=zo.PushSettings(phases=2)),
    "recovery": lambda orbit, _: zo.recovery(orbit),
    "simulate_experiment": lambda orbit, _: zo.simulate_experiment(orbit),
    "simulate_periods": lambda orbit, _: zo.simulate_periods(orbit),
    "compare": lambda orbit, _: zo.compare(orbit, _recording(orbit)),
    "plot": lambda orbit, _: zo.plot(orbit),
    "report_page": lambda orbit, _: zo.report_page(orbit),
    "work_precision": lambda orbit, _: zo.work_precision(
        orbit.problem, settings=zo.WorkPrecisionSettings.quick()
    ),
    "identify": lambda orbit, _: _fitted(orbit),
    "simulate_with_error": lambda orbit, _: zo.simulate_with_error(orbit.problem, until=1.0),
    "write_orbit": _written,
    "search_gains": lambda orbit, _: zo.search_gains(orbit.problem, near=orbit, vary={}).unwrap(),
    "find_orbit": lambda orbit, _: zo.find_orbit(orbit.problem).unwrap(),
    "find_orbit_by_shooting": lambda orbit, _: zo.find_orbit_by_shooting(orbit.problem).unwrap(),
}
"""Name of a public function to a call of it with an orbit and a file."""


def print_abilities(names: Sequence[str]) -> bool:
    """Print which functions serve which orbits; return True if as many as before do."""
    orbits = {
        "one stop": zo.find_orbit(ONE_STOP).unwrap(),
        "as a graph": zo.find_orbit(ONE_STOP).unwrap(),
        "two stops": zo.find_orbit(TWO_STOPS).unwrap(),
    }
    able = total = 0
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            for kind, orbit in orbits.items():
                begin = time.process_time()
                said = ""
                try:
                    TASKS[name](orbit, Path(folder) / "o.json")
                except zo.ZenoOrbitsError as error:
                    said = f"{type(error).__name__}: {error}"[:120]
                answer = not said
                able, total = able + answer, total + 1
                took = time.process_time() - begin
                print(f"{name:24s} {kind:12s} {'yes' if answer else 'no':3s} {took:5.1f} s {said}")
    print(f"{able} of {total} calls work")
    return len(names) < len(TASKS) or able >= ABLE


def main() -> int:
    """Print the parts; 1 if an ability is lost."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--only", choices=("times", "abilities"))
    parser.add_argument("--problems", nargs="+", metavar="NAME")
    parser.add_argument("--tasks", nargs="+", metavar="NAME", choices=tuple(TASKS))
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    if options.only != "abilities":
        print_times(
            options.problems
            or [name for name in bundled_problems() if not load_problem(name).has_graph]
        )
    return int(options.only != "times" and not print_abilities(options.tasks or tuple(TASKS)))


if __name__ == "__main__":
    raise SystemExit(main())
