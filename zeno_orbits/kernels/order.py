"""A library that another process makes: asked for by a file, so that of several one makes it."""

from __future__ import annotations

import atexit
import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path

from zeno_orbits.errors import KernelError
from zeno_orbits.kernels.compiler import Compiler
from zeno_orbits.kernels.folder import KernelFolder

_POLL = 0.05
"""Interval at which a library that was asked for is looked for [s]."""
_PATIENCE = 60.0
"""Longest wait for a library that another process makes [s]."""
_ABANDONED = 600.0
"""Age of a request that nobody works on any more [s]."""


class Order:
    """A library that another process makes."""

    def __init__(self, job: Path, process: subprocess.Popen[bytes] | None) -> None:
        self._job, self._process, self._next = job, process, 0.0

    @classmethod
    def placed(
        cls, folder: KernelFolder, key: str, recipe: Mapping[str, object], compiler: Compiler
    ) -> Order:
        """Ask for a library, unless somebody else did.

        Args:
            folder: Where it is to be.
            key: Digest of what it is made of.
            recipe: How it is made, as plain data.
            compiler: What compiles it.

        Raises:
            KernelError: If the folder cannot be written, or no process started.
        """
        folder.make()
        job = folder.job_of(key)
        content = {
            "key": key,
            "folder": str(folder.path),
            "command": compiler.command,
            "file": str(compiler.file),
            **recipe,
        }
        try:
            if job.exists() and time.time() - job.stat().st_mtime > _ABANDONED:
                job.unlink(missing_ok=True)
            handle = os.open(job, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        except FileExistsError:
            return cls(job, None)
        except OSError as error:
            reason = f"`{folder.path}` cannot be written ({error.strerror})"
            raise KernelError(reason) from error
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                json.dump(content, file)
            return cls(job, _start(job))
        except OSError as error:
            job.unlink(missing_ok=True)
            raise KernelError(f"no compiling could be started ({error.strerror})") from error

    def due(self) -> bool:
        """Return True now and then."""
        now = time.monotonic()
        if now < self._next:
            return False
        self._next = now + _POLL
        return True

    def is_over(self) -> bool:
        """Return True if nobody works on it any more."""
        if self._process is not None:
            return self._process.poll() is not None
        return not self._job.exists()

    def wait(self) -> None:
        """Wait until nobody works on it any more.

        Raises:
            KernelError: If another process takes too long: it may have been killed.
        """
        if self._process is not None:
            self._process.wait()
        end = time.monotonic() + _PATIENCE
        while not self.is_over():
            if time.monotonic() > end:
                reason = f"another process has not compiled them within {_PATIENCE:g} s"
                raise KernelError(f"{reason} (`zeno-orbits cache --clear` forgets it)")
            time.sleep(_POLL)


_started: list[subprocess.Popen[bytes]] = []


def _start(job: Path) -> subprocess.Popen[bytes]:
    """Start a process that makes a library and outlives this one."""
    # It finds what this process finds, and nothing that lies in the current folder by chance.
    paths = [path or str(Path.cwd()) for path in sys.path]
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "zeno_orbits.kernels", str(job)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths), "ZENO_ORBITS_COMPILE": "never"},
        start_new_session=True,
    )
    _started.append(process)
    return process


@atexit.register
def _let_go() -> None:
    """Leave the processes that still compile alone: they end by themselves."""
    for process in _started:
        if process.poll() is None:
            process.returncode = 0
