"""Which small faults in a room its tests notice: a mutation study.

    python benchmarks/mutants.py verification orbits --count 50 --seed 1

Faults are drawn at random from the modules of the rooms (`tests/support/mutation.py` says which
kinds there are) and put, one at a time, into a copy of this repository. There the tests of the room
run that call the changed function, the quickest first, then the rest of the room, until one fails:
the mutant is killed. So it is if the tests take far longer than they do. Survivors are printed with
their difference. Among them are mutants that change nothing.

Exit 1 if less than 95 % of the mutants are killed.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from queue import Queue
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.support.mutation import Mutant, mutants_of

ROOT = Path(__file__).parents[1]
PACKAGE = "zeno_orbits"
LEFT_OUT = (".git", "build", "__pycache__", ".hypothesis", "*.egg-info", ".pytest_cache")
GOAL = 0.95
LEAST, SLACK, FACTOR = 30.0, 20.0, 6.0
"""Time limit of a run: `FACTOR` times what its tests take, and `SLACK` for the start [s]."""
MOST_AT_ONCE = 400
"""Tests on one command line."""


class Fate(Enum):
    """What became of a mutant."""

    KILLED = "killed"
    TIMED_OUT = "timed out"
    SURVIVED = "survived"


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """A mutant and where it is.

    Attributes:
        room: Its room.
        module: Path in the repository.
        mutant: The mutant.
        diff: Lines that it changes.
    """

    room: str
    module: str
    mutant: Mutant
    diff: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Tests:
    """The tests of a room.

    Attributes:
        seconds: Test to the time that it takes.
        called: Test to the functions that it calls, as ``module:first line``.
    """

    seconds: Mapping[str, float]
    called: Mapping[str, frozenset[str]]

    def of(self, fault: Fault, source: str) -> list[str]:
        """Return the tests that call the function in which a fault is, the quickest first."""
        places = {f"{fault.module}:{line}" for line in _functions_at(source, fault.mutant)}
        chosen = [name for name, called in self.called.items() if called & places]
        return sorted(chosen, key=lambda name: self.seconds[name])

    def rest(self, chosen: Sequence[str]) -> list[str]:
        """Return all others, likewise."""
        left = set(self.seconds) - set(chosen)
        return sorted(left, key=lambda name: self.seconds[name])


def _functions_at(source: str, mutant: Mutant) -> set[int]:
    """Return first lines, decorators included, of the innermost function around a fault.

    A fault outside of all functions, in a constant for instance, belongs to those that name it.
    """
    tree = ast.parse(source)
    functions = [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef | ast.Lambda)]

    def first(node: ast.FunctionDef | ast.Lambda) -> int:
        marks = node.decorator_list if isinstance(node, ast.FunctionDef) else []
        return min([node.lineno, *(mark.lineno for mark in marks)])

    def last(node: ast.AST) -> int:
        return int(getattr(node, "end_lineno", 0) or 0)

    around = [n for n in functions if first(n) <= mutant.line and mutant.last <= last(n)]
    if around:
        return {first(n) for n in around} | set(range(mutant.line, mutant.last + 1))
    names = {
        target.id
        for node in tree.body
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.lineno <= mutant.line <= last(node)
        for target in ast.walk(node)
        if isinstance(target, ast.Name) and isinstance(target.ctx, ast.Store)
    }
    return {
        first(n)
        for n in functions
        if any(isinstance(one, ast.Name) and one.id in names for one in ast.walk(n))
    }


def folders_of(room: str) -> list[str]:
    """Return the folders of the tests of a room."""
    own = ROOT / "tests" / room
    return [f"tests/{room}"] if own.is_dir() else [f"tests/{room.split('/')[0]}"]


def faults_in(rooms: Sequence[str], count: int, seed: int) -> list[Fault]:
    """Return faults drawn at random: as many of each room, the same for the same seed."""
    drawn = random.Random(seed)
    found: list[Fault] = []
    for room in rooms:
        place = ROOT / PACKAGE / room
        files = sorted(place.rglob("*.py")) if place.is_dir() else [place.with_suffix(".py")]
        possible: list[Fault] = []
        for file in files:
            source = file.read_text(encoding="utf-8")
            possible += [
                Fault(
                    room=room,
                    module=file.relative_to(ROOT).as_posix(),
                    mutant=mutant,
                    diff=mutant.diff(source),
                )
                for mutant in mutants_of(source)
            ]
        found += drawn.sample(possible, min(count, len(possible)))
    return found


@contextmanager
def copies(number: int) -> Iterator[Queue[Path]]:
    """Yield copies of the repository, which vanish in the end."""
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        places: Queue[Path] = Queue()
        for k in range(number):
            place = Path(folder) / str(k)
            shutil.copytree(ROOT, place, ignore=shutil.ignore_patterns(*LEFT_OUT))
            places.put(place)
        yield places


def run_tests(copy: Path, tests: Sequence[str], limit: float, **variables: str) -> int | None:
    """Return the exit code of pytest in a copy, or nothing if it took too long."""
    listed = copy / "tests_to_run.txt"
    listed.write_text("\n".join(tests), encoding="utf-8")
    plugin = ["-p", "tests.support.functions_called"] if variables else ["-x"]
    command = [sys.executable, "-m", "pytest", "-q", "-n0", "-p", "no:cacheprovider", *plugin]
    environment = {**os.environ, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    with subprocess.Popen(
        [*command, "--no-header", f"@{listed}"],
        cwd=copy,
        env={**environment, "OPENBLAS_NUM_THREADS": "1", **variables},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    ) as process:
        try:
            return process.wait(limit)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            return None


def tests_of(room: str, chosen: Sequence[str], copy: Path) -> Tests:
    """Run the tests of a room once, without a fault, and return what each calls.

    Args:
        room: The room.
        chosen: Files, folders or names of tests; by default all of the room.
        copy: Where to run them.
    """
    table = copy / "called.json"
    run_tests(copy, chosen or folders_of(room), 3600.0, FUNCTIONS_CALLED=str(table))
    entries: dict[str, dict[str, Any]] = json.loads(table.read_text(encoding="utf-8"))
    if not entries:
        raise SystemExit(f"No test of `{room}` passes without a fault.")
    return Tests(
        seconds={name: float(entry["seconds"]) for name, entry in entries.items()},
        called={
            name: frozenset(
                f"{Path(file).relative_to(copy).as_posix()}:{line}"
                for file, line in entry["called"]
            )
            for name, entry in entries.items()
        },
    )


def fate_of(fault: Fault, tests: Tests, copy: Path) -> Fate:
    """Return what the tests say of a fault; the copy is as it was afterwards."""
    file = copy / fault.module
    source = file.read_text(encoding="utf-8")
    chosen = tests.of(fault, source)
    runs = [names for names in (chosen, tests.rest(chosen)) if names]
    file.write_text(fault.mutant.source, encoding="utf-8")
    try:
        for names in runs:
            for k in range(0, len(names), MOST_AT_ONCE):
                some = names[k : k + MOST_AT_ONCE]
                limit = LEAST + SLACK + FACTOR * sum(tests.seconds[name] for name in some)
                code = run_tests(copy, some, limit)
                if code is None:
                    return Fate.TIMED_OUT
                if code != 0:
                    return Fate.KILLED
    finally:
        file.write_text(source, encoding="utf-8")
    return Fate.SURVIVED


def study(options: argparse.Namespace) -> dict[Fate, int]:
    """Return how many mutants met which fate; survivors are printed as they are found."""
    faults = faults_in(options.rooms, options.count, options.seed)
    counts = dict.fromkeys(Fate, 0)
    with copies(options.jobs) as places:
        first = places.get()
        rooms = dict.fromkeys(options.rooms)
        tests = {room: tests_of(room, options.tests, first) for room in rooms}
        places.put(first)

        def judged(fault: Fault) -> tuple[Fault, Fate]:
            copy = places.get()
            try:
                return fault, fate_of(fault, tests[fault.room], copy)
            finally:
                places.put(copy)

        with ThreadPoolExecutor(options.jobs) as pool:
            for fault, fate in pool.map(judged, faults):
                counts[fate] += 1
                where = f"{fault.module}:{fault.mutant.line}"
                if fate is Fate.SURVIVED:
                    print(f"\n{where}: {fault.mutant.kind} survived\n{fault.diff}", flush=True)
                elif options.verbose:
                    print(f"{where}: {fault.mutant.kind} {fate.value}", flush=True)
    return counts


def main() -> int:
    """Run the study and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rooms", nargs="+", help="folders or modules of zeno_orbits")
    parser.add_argument("--count", type=int, default=50, help="mutants of each room")
    parser.add_argument("--tests", nargs="+", default=[], help="tests in place of the rooms' own")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1, help="copies that work at once")
    parser.add_argument("--verbose", action="store_true", help="name the killed ones too")
    counts = study(parser.parse_args())
    killed = counts[Fate.KILLED] + counts[Fate.TIMED_OUT]
    print("\n" + ", ".join(f"{count} {fate.value}" for fate, count in counts.items()))
    return int(killed < GOAL * sum(counts.values()))


if __name__ == "__main__":
    sys.exit(main())
