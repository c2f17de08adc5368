"""What a long-lived process keeps: growth of its memory, and what else it leaves behind.

    python benchmarks/memory.py             # 20,000 simulations, 500 searches, 200 problems
    python benchmarks/memory.py --quick     # a twentieth of it

Each kind of work is done a tenth first, so that code, caches and the allocator have their usual
size. Growth counts from there, as resident memory after a garbage collection. Open files, threads,
child processes and temporary files count from before all work. The last line is the processor time
in which a recording of a million samples is read.

Exit code 1 if memory grows by 20 MB or more in all, if anything is left, or if the recording
takes 2 s or more.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import numpy as np

import zeno_orbits as zo
from zeno_orbits.experiment import read_recording

ALLOWED = 20.0
"""Growth at most [MB]."""
ALLOWED_TIME = 2.0
"""Processor time in which a million samples are read [s]."""
PATIENCE = 120.0
"""Time in which background work ends [s]."""
SAMPLES = 1_000_000

SOURCE = Path(__file__).resolve().parents[1] / "problems" / "bouncing_ball.py"
"""The problem of which others are made."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Left:
    """What a process holds.

    Attributes:
        files: Open files.
        threads: Threads.
        processes: Child processes.
        temporary: Entries of the folder for temporary files.
    """

    files: int
    threads: int
    processes: int
    temporary: int

    @classmethod
    def now(cls, folder: Path) -> Left:
        """Return what this process holds now."""
        own = Path("/proc/self")
        children = [(task / "children").read_text().split() for task in (own / "task").iterdir()]
        return cls(
            files=len(list((own / "fd").iterdir())),
            threads=threading.active_count(),
            processes=sum(map(len, children)),
            temporary=len(list(folder.iterdir())),
        )


def resident() -> float:
    """Return the resident memory of this process after a garbage collection [MB]."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def simulations() -> Iterator[None]:
    """Simulate the reference problem from ever other starts, for two periods each."""
    pendulum = zo.load_problem("motor_pendulum")
    for number in count():
        angle = 0.2 + 0.8 * (number * 0.618 % 1.0)
        zo.simulate(pendulum, start={"theta1": angle}, until=3.6)
        yield


def searches() -> Iterator[None]:
    """Search the orbit of a shaken table at ever other restitutions."""
    for number in count():
        zo.find_orbit(
            "vibrating_table", parameters={"restitution": 0.2 + 0.3 * (number * 0.618 % 1)}
        )
        yield


def problems(folder: Path) -> Iterator[None]:
    """Load ever other problems, each with equations of its own, and simulate them."""
    text = SOURCE.read_text()
    for number in count():
        path = folder / f"ball_{number}.py"
        path.write_text(
            text.replace('p["m"] * p["g"] * height', f"{1.0 + number} * p['m'] * p['g'] * height")
        )
        zo.simulate(zo.load_problem(path), until=1.0)
        path.unlink()
        yield


def growth(work: Iterator[None], times: int) -> float:
    """Return by how much resident memory grows over so much work, after a tenth of it [MB]."""
    for _ in range(max(times // 10, 1)):
        next(work)
    before = resident()
    for _ in range(times):
        next(work)
    return resident() - before


def reading_time(folder: Path) -> float:
    """Return the processor time in which a recording of a million samples is read [s]."""
    path = folder / "recording.csv"
    time_of = np.arange(SAMPLES) / 1e4
    table = np.stack([time_of, np.sin(time_of)], axis=1)
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header="time [s],angle [rad]", comments="")
    started = time.process_time()
    recording = read_recording(path)
    taken = time.process_time() - started
    path.unlink()
    if len(recording.time) != SAMPLES or not np.allclose(recording.time, time_of, atol=1e-8):
        raise ValueError("The recording was not read whole.")
    return taken


def main(arguments: Sequence[str] | None = None) -> int:
    """Do the work and print what is left of it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="a twentieth of the work")
    parser.add_argument("--json", action="store_true", help="print JSON for programs")
    for kind, number in (("simulations", 20_000), ("searches", 500), ("problems", 200)):
        parser.add_argument(f"--{kind}", type=int, metavar="N", help=f"{number} by default")
    options = parser.parse_args(arguments)
    share = 20 if options.quick else 1
    with tempfile.TemporaryDirectory() as own:
        folder, temporary = Path(own) / "work", Path(own) / "temporary"
        folder.mkdir()
        temporary.mkdir()
        # Other programs share the usual folder for temporary files.
        os.environ["TMPDIR"], tempfile.tempdir = str(temporary), None
        kinds: dict[str, tuple[Callable[[], Iterator[None]], int]] = {
            "simulations": (simulations, options.simulations or 20_000 // share),
            "searches": (searches, options.searches or 500 // share),
            "problems": (lambda: problems(folder), options.problems or 200 // share),
        }
        before = Left.now(temporary)
        grown: dict[str, float] = {}
        for kind, (work, times) in kinds.items():
            started = time.process_time()
            grown[kind] = growth(work(), times)
            taken = time.process_time() - started
            if not options.json:
                print(f"{times:6d} {kind:12} {grown[kind]:+7.2f} MB  ({taken:.0f} s)", flush=True)
        # Code of the last problems may still be compiled in the background.
        patience = time.monotonic() + PATIENCE
        while (after := Left.now(temporary)) != before and time.monotonic() < patience:
            time.sleep(1.0)
        seconds = reading_time(folder)
    left = {name: getattr(after, name) - getattr(before, name) for name in Left.__slots__}
    total = sum(grown.values())
    if options.json:
        print(json.dumps({"growth_MB": grown, "left": left, "reading_s": seconds}))
    else:
        print(f"growth in all: {total:+.2f} MB, {ALLOWED:g} MB allowed")
        print("left: " + ", ".join(f"{number} {name}" for name, number in left.items()))
        print(f"a recording of {SAMPLES} samples: {seconds:.2f} s, {ALLOWED_TIME:g} s allowed")
    return int(total >= ALLOWED or any(n > 0 for n in left.values()) or seconds >= ALLOWED_TIME)


if __name__ == "__main__":
    sys.exit(main())
