"""Processes that tests start and kill."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO


@dataclass
class Commands:
    """The command line in processes of their own, none of which outlives its test."""

    started: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def start(
        self, *words: str | Path, stdout: int | IO[bytes] = subprocess.DEVNULL
    ) -> subprocess.Popen[bytes]:
        process = subprocess.Popen(
            [sys.executable, "-m", "zeno_orbits", *map(str, words)],
            stdout=stdout,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        self.started.append(process)
        return process

    def end(self) -> None:
        for process in self.started:
            process.kill()
            process.wait()


def workers_of(process: int) -> list[int]:
    """Return the numbers of the workers that a process has started."""
    listed = subprocess.run(
        # Unlimited width: a terminal's would cut the words that tell a worker.
        ["ps", "-ww", "-o", "pid=,args=", "--ppid", str(process)],
        check=False,
        capture_output=True,
        text=True,
    )
    lines = [line.split(maxsplit=1) for line in listed.stdout.splitlines()]
    return [int(pid) for pid, words in lines if "popen_loky" in words]
