"""Pools of workers with a common interface: loky's processes on this machine, or Dask's workers.

Both are executors of ``concurrent.futures``. Loky is part of joblib.
"""
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import os
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Generator, Sequence
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

from zeno_orbits.errors import InputError, WorkError
from zeno_orbits.work.cluster import open_cluster
from zeno_orbits.work.plan import Cluster, Place, Workers
from zeno_orbits.work.software import code_digest
from zeno_orbits.work.tasks import Task, read_note, run_chunk

_ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS"), "1"
)
"""One thread per process: processes fill the cores, and sums over threads may round differently."""
_SAFE_PATH = "PYTHONSAFEPATH"
"""If set, `python -m` and `python -c` do not import from the current folder."""
_LOOK = 1.0
"""Interval at which a worker checks that its parent is alive [s]."""


class Pool(Protocol):
    """Computes chunks.

    Attributes:
        window: Useful number of chunks under way at the same time.
        attempts: Number of worker crashes after which a chunk that is computed alone is given up.
        one_fate: True if the crash of one worker fails all chunks under way.
    """

    window: int
    attempts: int
    one_fate: bool

    def submit(self, task: Task, points: Sequence[Any]) -> Future[str]:
        """Start a chunk, after replacing crashed workers."""
        ...

    def part(self, future: Future[str]) -> float:
        """Return the finished part of a chunk under way, in [0, 1], or 0 if it is not reported."""
        ...

    def died(self, future: Future[str]) -> bool:
        """Return True if a finished future ended with the crash of a worker.

        Raises:
            WorkError: If the chunk failed for a reason outside its task.
        """
        ...

    def check(self) -> None:
        """Raise ``WorkError`` if chunks can no longer be finished."""
        ...


@contextmanager
def open_pool(place: Place) -> Generator[Pool]:
    """Provide a pool within a context. Chunks under way at its end are dropped.

    Raises:
        InputError: If the executor is not available.
    """
    if isinstance(place, Cluster):
        with open_cluster(place) as pool:
            yield pool
        return
    cores = _CorePool(worker_count(place), place.attempts)
    try:
        yield cores
    finally:
        cores.close()


def worker_count(workers: Workers) -> int:
    """Return the number of processes.

    Raises:
        InputError: If the number is not positive, or exceeds the number of cores.
    """
    import joblib

    cores = int(joblib.cpu_count())
    count = cores if workers.count is None else workers.count
    if count < 1:
        raise InputError(f"Argument `workers` must be at least 1, but it is {count}.")
    if count > cores:
        raise InputError(
            f"Argument `workers` must be at most the {cores} cores of this machine, "
            f"but it is {count}."
        )
    return count


class _CorePool:
    """Processes of loky, each with one thread."""

    one_fate = True

    def __init__(self, count: int, attempts: int) -> None:
        self.window = count
        self.attempts = attempts
        self._executor: Executor | None = None
        self._folder = tempfile.TemporaryDirectory(prefix="zeno-orbits-")
        self._notes: dict[Future[str], Path] = {}
        self._n_notes = 0

    def submit(self, task: Task, points: Sequence[Any]) -> Future[str]:
        from joblib.externals.loky.process_executor import BrokenProcessPool

        self._n_notes += 1
        note = Path(self._folder.name) / str(self._n_notes)
        work = (run_chunk, task, points, code_digest(), str(note))
        with _sheltered():
            try:
                future = self._open().submit(*work)
            except BrokenProcessPool:
                # An idle worker has crashed.
                self.end_processes()
                future = self._open().submit(*work)
        self._notes[future] = note
        return future

    def part(self, future: Future[str]) -> float:
        return read_note(self._notes[future])

    def died(self, future: Future[str]) -> bool:
        from joblib.externals.loky.process_executor import BrokenProcessPool

        error = future.exception()
        self._notes.pop(future, None)
        if error is None:
            return False
        self.end_processes()
        if not isinstance(error, BrokenProcessPool):
            raise WorkError(f"A chunk cannot be sent to a worker: {error}") from error
        return True

    def check(self) -> None:
        """Do nothing, since crashed processes are always replaced."""

    def _open(self) -> Executor:
        from joblib.externals.loky import ProcessPoolExecutor

        if self._executor is None:
            self._executor = ProcessPoolExecutor(
                max_workers=self.window,
                env={**_ONE_THREAD, _SAFE_PATH: "1"},
                initializer=_begin,
                initargs=(os.getpid(), self._folder.name),
            )
        return self._executor

    def close(self) -> None:
        """End the processes and remove their progress files."""
        try:
            self.end_processes()
        finally:
            self._folder.cleanup()

    def end_processes(self) -> None:
        """End the processes. New processes start when they are needed."""
        if self._executor is not None:
            # A thread of loky that a second interrupt left behind would hold a lock at exit.
            with _later_interrupts():
                # Loky adds the second argument to the arguments of an executor.
                self._executor.shutdown(wait=True, kill_workers=True)  # pyright: ignore[reportCallIssue]
                self._executor = None


@contextmanager
def _sheltered() -> Generator[None]:
    """Start processes that do not import from the current folder and do not receive Ctrl-C.

    Loky's resource tracker always inherits the environment of this process, so it is set here. A
    process starts with the signal mask of its parent, so an interrupt stays pending until `_begin`.
    In this process, another thread receives the interrupt, or it stays pending until the mask is
    restored.
    """
    # Imported here, since joblib imports it and few commands need joblib.
    from multiprocessing import resource_tracker

    before = os.environ.get(_SAFE_PATH)
    mask = hasattr(signal, "pthread_sigmask")
    blocked = set[int]()
    os.environ[_SAFE_PATH] = "1"
    try:
        if mask:
            # Python's own tracker restores the mask when it has started.
            resource_tracker.ensure_running()
            blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        yield
    finally:
        if before is None:
            os.environ.pop(_SAFE_PATH, None)
        else:
            os.environ[_SAFE_PATH] = before
        if mask:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)


@contextmanager
def _later_interrupts() -> Generator[None]:
    """Handle interrupts that arrive within the context at its end."""
    seen: list[int] = []
    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            if signal.getsignal(number) is not signal.SIG_IGN:
                before[number] = signal.signal(number, lambda seen_, _: seen.append(seen_))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if seen:
            signal.raise_signal(seen[0])


def _begin(parent: int, notes: str) -> None:
    """Prepare a process: it ignores Ctrl-C, which its parent handles, and ends with its parent.

    Args:
        parent: Identifier of the parent process.
        notes: Folder of the parent's progress files, removed if the parent ended without doing so.
    """
    # The parent has printed what the code of a problem prints.
    sys.stdout = os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8")
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})

    def look() -> None:
        while os.getppid() == parent:
            time.sleep(_LOOK)
        shutil.rmtree(notes, ignore_errors=True)
        os._exit(1)

    threading.Thread(target=look, daemon=True).start()
