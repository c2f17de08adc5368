"""Time calls in a warm process: short simulations, maps of chaotic motions, reading a map file.

Two versions are compared by two runs in turns, each with its own `PYTHONPATH`. Processor times
remain meaningful on a busy machine. Exponents are held against the multiplier of a stable orbit by
`tests/maps/test_kinds.py`.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import cycle, islice
from pathlib import Path

import numpy as np

import zeno_orbits as zo
from zeno_orbits.maps import AttractorClass, attractors_at, read_map, write_map
from zeno_orbits.model import ParameterValues

SIMULATIONS = (("motor_pendulum", 1.0), ("vibrating_table", 1.0), ("relay", 0.05))
"""Problems and times [s] of short simulations, of which the loop itself takes a fraction."""

CHAOTIC: dict[str, tuple[tuple[str, float], ...]] = {
    "vibrating_table": (("A", 0.0232), ("A", 0.0266), ("A", 0.0277)),
    "relief_valve": (("q", 0.3), ("q", 0.4), ("q", 0.6)),
}
"""Problems and values at which a motion is chaotic."""

BOUNCY = {"relief_valve": {"restitution": 0.8}}

BOUND = 0.5
"""Longest time to read a map of 200 x 200 points on a quiet machine [s]."""


def median_time(call: Callable[[], object], runs: int) -> float:
    """Return the median processor time of a call after a first one [s]."""
    call()
    times: list[float] = []
    for _ in range(runs):
        started = time.process_time()
        call()
        times.append(time.process_time() - started)
    return statistics.median(times)


def chaotic_points(name: str, runs: int) -> tuple[float, int]:
    """Return the time of a point [s], and how many of the points are called chaotic."""
    problem, settings = zo.load_problem(name), list[ParameterValues]()
    for word, value in CHAOTIC[name]:
        known = [one.name for one in problem.gains]
        gains = {word: value} if word in known else {}
        parameters = {**BOUNCY.get(name, {}), **({} if gains else {word: value})}
        settings.append(problem.values(gains=gains, parameters=parameters))
    found = attractors_at(problem, settings)
    n_chaotic = sum(
        one.fate is AttractorClass.UNSETTLED and one.exponent > one.exponent_error for one in found
    )
    seconds = median_time(lambda: attractors_at(problem, settings), runs)
    return seconds / len(settings), n_chaotic


def reading_time(size: int, runs: int) -> float:
    """Return the time to read a map of the reference problem, whose points are repeated [s]."""
    small = zo.parameter_map("motor_pendulum", x=("Kp", 1.0, 5.0, 8), y=("Kd", -2.0, 0.0, 8))
    large = replace(
        small,
        x=replace(small.x, count=size),
        y=replace(small.y, count=size),
        attractors=tuple(islice(cycle(small.attractors), size * size)),
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.json"
        write_map(large, path)
        if not np.array_equal(read_map(path).numbers("returns"), large.numbers("returns")):
            raise SystemExit("The map that was read is another one.")
        return median_time(lambda: read_map(path), runs)


def main() -> int:
    """Print a line for each call; 1 if a large map takes too long, or chaos is not found."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--runs", type=int, default=11, metavar="N", help="runs of each call")
    parser.add_argument("--size", type=int, default=200, metavar="N", help="points along a side")
    parser.add_argument("--json", action="store_true", help="print JSON for programs")
    options = parser.parse_args()
    figures: dict[str, float] = {}
    for name, until in SIMULATIONS:
        seconds = median_time(lambda n=name, t=until: zo.simulate(n, until=t), options.runs)
        figures[f"simulate {name}, {until:g} s [ms]"] = 1e3 * seconds
    n_chaotic = 0
    for name in CHAOTIC:
        seconds, n_found = chaotic_points(name, options.runs)
        figures[f"chaotic point of {name} [ms]"] = 1e3 * seconds
        n_chaotic += n_found
    reading = reading_time(options.size, options.runs)
    figures[f"read_map, {options.size} x {options.size} [ms]"] = 1e3 * reading
    if options.json:
        print(json.dumps(figures, indent=2))
    else:
        for word, figure in figures.items():
            print(f"{word:40}{figure:10.3g}")
    missed = n_chaotic < sum(map(len, CHAOTIC.values()))
    return int(missed or reading > BOUND * (options.size / 200) ** 2)


if __name__ == "__main__":
    sys.exit(main())
