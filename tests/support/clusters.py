"""A Dask cluster of this machine's own processes, and problems that tell who computes with them."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from zeno_orbits.model import bundled_problems
from zeno_orbits.work import Cluster

ROOT = Path(__file__).parents[2]


@dataclass
class DaskCluster:
    """A scheduler and its workers, as processes."""

    folder: Path
    processes: list[subprocess.Popen[bytes]] = field(default_factory=list)

    @property
    def file(self) -> Path:
        return self.folder / "scheduler.json"

    @property
    def address(self) -> str:
        return str(json.loads(self.file.read_text())["address"])

    def start(self, part: str, *arguments: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.dask_{part}", "--no-dashboard"]
        process = subprocess.Popen(
            [*command, "--scheduler-file", str(self.file), *arguments],
            cwd=self.folder,
            env=os.environ
            | {
                "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
                # A killer is called one after its second victim.
                "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
            },
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self.processes.append(process)
        return process

    def start_scheduler(self) -> subprocess.Popen[bytes]:
        process = self.start("scheduler", "--host", "127.0.0.1", "--port", "0")
        wait_until(lambda: self.file.exists() and self.file.stat().st_size > 0)
        return process

    def start_worker(self, *arguments: str) -> subprocess.Popen[bytes]:
        return self.start("worker", "--nthreads", "1", *arguments)

    def end(self) -> None:
        for process in reversed(self.processes):
            process.terminate()
        for process in self.processes:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(2)
            process.kill()
            process.wait()

    def place(self, patience: float = 20.0) -> Cluster:
        return Cluster(address=self.address, patience=patience)


def wait_until(condition: Callable[[], bool], patience: float = 60.0) -> None:
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end, "nothing happens"
        time.sleep(0.02)


@contextlib.contextmanager
def dask_cluster(folder: Path) -> Iterator[DaskCluster]:
    """Give a scheduler without workers; none of its processes outlives it."""
    cluster = DaskCluster(folder)
    try:
        cluster.start_scheduler()
        yield cluster
    finally:
        cluster.end()


def noted_problem(name: str, folder: Path) -> tuple[Path, Path]:
    """Return a copy of a problem, and the folder where each process that loads it leaves a file.

    Args:
        name: Of a problem that is one file.
        folder: Where to put both.
    """
    problem, diary = folder / "noted.py", folder / "diary"
    diary.mkdir()
    shutil.copy(bundled_problems()[name], problem)
    note = f"(__import__('pathlib').Path({str(diary)!r}) / str(__import__('os').getpid())).touch()"
    problem.write_text(f"{problem.read_text()}\n{note}\n")
    return problem, diary
