"""Pools of workers behind one interface: loky's processes on this machine, or Dask's workers.

Both are executors of ``concurrent.futures``; joblib brings loky.
"""
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import os
import signal
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
"""Processes fill the cores; and a sum over threads may end in other bits."""
_LOOK = 1.0
"""Interval at which a worker checks that its parent is alive [s]."""


class Pool(Protocol):
    """Computes chunks.

    Attributes:
        window: Chunks that are worth having under way at once.
        attempts: Number of times a chunk may kill its worker while it is computed alone.
        one_fate: The death of one worker fails all that is under way.
    """

    window: int
    attempts: int
    one_fate: bool

    def submit(self, task: Task, points: Sequence[Any]) -> Future[str]:
        """Start a chunk; a dead worker is replaced first."""
        ...

    def part(self, future: Future[str]) -> float:
        """Return how much of a chunk under way is done, in [0, 1]; 0 where nobody tells."""
        ...

    def died(self, future: Future[str]) -> bool:
        """Return True if a finished future ended with the death of a worker.

        Raises:
            WorkError: If it ended for another reason than its task.
        """
        ...

    def check(self) -> None:
        """Raise ``WorkError`` if no chunk will ever be finished."""
        ...


@contextmanager
def open_pool(place: Place) -> Generator[Pool]:
    """Give a pool for as long as the context lasts; what is under way at its end is dropped.

    Raises:
        InputError: If the place cannot be had.
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
        InputError: If it is not positive, or more than there are cores.
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
        try:
            future = self._open().submit(*work)
        except BrokenProcessPool:
            # A worker died with nothing to do.
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
        """Processes are replaced; there is always one."""

    def _open(self) -> Executor:
        from joblib.externals.loky import ProcessPoolExecutor

        if self._executor is None:
            self._executor = ProcessPoolExecutor(
                max_workers=self.window,
                env=_ONE_THREAD,
                initializer=_begin,
                initargs=(os.getpid(),),
            )
        return self._executor

    def close(self) -> None:
        """End the processes, and remove their notes."""
        self.end_processes()
        self._folder.cleanup()

    def end_processes(self) -> None:
        """End the processes; others take their place when they are needed."""
        if self._executor is not None:
            # Loky adds the second argument to those of an executor.
            self._executor.shutdown(wait=True, kill_workers=True)  # pyright: ignore[reportCallIssue]
            self._executor = None


def _begin(parent: int) -> None:
    """Prepare a process: Ctrl-C is its parent's affair, and without one it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def look() -> None:
        while os.getppid() == parent:
            time.sleep(_LOOK)
        os._exit(1)

    threading.Thread(target=look, daemon=True).start()
