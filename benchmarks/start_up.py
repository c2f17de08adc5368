"""Time fresh processes: importing each public module, and whole commands, with what they load.

An import has a bound of 0.5 s, the search at fixed gains one of 2 s, Python's own start included.
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

MODULES = (
    *(
        "zeno_orbits",
        "zeno_orbits.model.problem",
        "zeno_orbits.simulation.simulator",
        "zeno_orbits.verification.verifier",
    ),
    *("zeno_orbits.search.search", "zeno_orbits.cli"),
)
SEARCH = ("search", "motor_pendulum", "--set", "Kp=2.5", "--set", "Kd=-1", "-o")
HEAVY = (
    *("numpy", "casadi", "rich", "scipy", "scipy.integrate", "scipy.linalg", "scipy.optimize"),
    *("scipy.special", "scipy.stats", "heyoka", "matplotlib", "sympy"),
)
IMPORT_BOUND, SEARCH_BOUND = 0.5, 2.0
"""Longest times allowed [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """What was measured of one process."""

    name: str
    median: float
    slowest: float
    processor: float
    bound: float | None
    heavy: tuple[str, ...]

    @property
    def good(self) -> bool:
        """Whether the median is below the bound, if there is one."""
        return self.bound is None or self.median < self.bound


def seconds(arguments: Sequence[str]) -> tuple[float, float]:
    """Return how long Python takes with these arguments, by the clock and by the processor."""
    started, used = time.perf_counter(), _processor_time()
    subprocess.run([sys.executable, *arguments], check=True, capture_output=True)
    return time.perf_counter() - started, _processor_time() - used


def _processor_time() -> float:
    """Return the processor time of all processes that were waited for [s]."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def heavy_modules(arguments: Sequence[str]) -> tuple[str, ...]:
    """Return which heavy modules Python imports with these arguments."""
    answer = subprocess.run(
        [sys.executable, "-X", "importtime", *arguments], check=True, capture_output=True, text=True
    )
    lines = [line for line in answer.stderr.splitlines() if line.startswith("import time:")]
    seen = {line.rpartition("|")[2].strip() for line in lines}
    return tuple(name for name in HEAVY if name in seen)


def processes(orbit: Path) -> dict[str, tuple[tuple[str, ...], float | None]]:
    """Return name to arguments of Python and bound [s]; the search writes the orbit."""
    command = ("-m", "zeno_orbits")
    return {
        "(Python alone)": (("-c", "pass"), None),
        **{f"import {name}": (("-c", f"import {name}"), IMPORT_BOUND) for name in MODULES},
        "--help": ((*command, "--help"), None),
        "problems": ((*command, "problems"), None),
        "search, gains fixed": ((*command, *SEARCH, str(orbit)), SEARCH_BOUND),
        "verify": ((*command, "verify", str(orbit)), None),
    }


def measured(runs: int) -> list[Row]:
    """Return a row for every process; they take turns, so that a slow minute meets them all."""
    with tempfile.TemporaryDirectory() as folder:
        wanted = processes(Path(folder) / "orbit.json")
        # One run that does not count fills the disk's cache and writes the orbit.
        heavy = {name: heavy_modules(arguments) for name, (arguments, _) in wanted.items()}
        times: dict[str, list[tuple[float, float]]] = {name: [] for name in wanted}
        for _ in range(runs):
            for name, (arguments, _) in wanted.items():
                times[name].append(seconds(arguments))
    return [
        Row(
            name=name,
            median=statistics.median(clock for clock, _ in times[name]),
            slowest=max(clock for clock, _ in times[name]),
            processor=statistics.median(processor for _, processor in times[name]),
            bound=bound,
            heavy=heavy[name],
        )
        for name, (_, bound) in wanted.items()
    ]


def main() -> int:
    """Time all processes; 1 if one is over its bound."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--runs", type=int, default=7, metavar="N", help="runs of each process")
    parser.add_argument("--json", action="store_true", help="print JSON for programs")
    options = parser.parse_args()
    if options.runs < 1:
        parser.error(f"--runs must be at least 1, but it is {options.runs}")
    rows = measured(options.runs)
    if options.json:
        print(json.dumps([asdict(row) | {"good": row.good} for row in rows], indent=2))
    else:
        head = f"{'process':28}{'median [s]':>11}{'slowest [s]':>13}{'processor [s]':>15}"
        print(f"{head}{'bound [s]':>11}  heavy modules")
        for row in rows:
            bound = "-" if row.bound is None else f"{row.bound:g}"
            figures = f"{row.median:11.2f}{row.slowest:13.2f}{row.processor:15.2f}{bound:>11}"
            print(f"{row.name:28}{figures}  {', '.join(row.heavy) or '-'}")
    return 0 if all(row.good for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
