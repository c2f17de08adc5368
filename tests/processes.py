"""Processes that tests start and kill."""

from __future__ import annotations

import subprocess


def workers_of(process: int) -> list[int]:
    """Return the numbers of the workers that a process has started."""
    listed = subprocess.run(
        ["ps", "-o", "pid=,args=", "--ppid", str(process)],
        check=False,
        capture_output=True,
        text=True,
    )
    lines = [line.split(maxsplit=1) for line in listed.stdout.splitlines()]
    return [int(pid) for pid, words in lines if "popen_loky" in words]
