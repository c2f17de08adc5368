"""The workers of a Dask cluster as a pool."""
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import logging
import time
from collections.abc import Generator, Sequence
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

from zeno_orbits.errors import InputError, WorkError
from zeno_orbits.work.plan import Cluster
from zeno_orbits.work.software import code_digest
from zeno_orbits.work.tasks import Task, run_chunk

_PAUSE = 1.0
"""Interval between two queries of the scheduler [s]."""


class ClusterPool:
    """Workers of a Dask cluster."""

    # The scheduler itself tries a chunk on several workers before it reports `KilledWorker`.
    attempts = 1
    one_fate = False

    def __init__(self, client: Any, cluster: Cluster) -> None:
        self._client = client
        self._cluster = cluster
        # The second chunk of a worker is transferred while the worker computes the first.
        self.window = 2 * max(len(self._workers()), 1)
        self._executor: Executor = client.get_executor(pure=False)
        self._asked = self._seen = time.monotonic()

    def submit(self, task: Task, points: Sequence[Any]) -> Future[str]:
        """Send a chunk to the scheduler."""
        return self._executor.submit(run_chunk, task, points, code_digest())

    def part(self, future: Future[str]) -> float:  # noqa: ARG002 (its notes are elsewhere)
        """Return 0, since a worker on another machine does not report partial progress."""
        return 0.0

    def died(self, future: Future[str]) -> bool:
        """Return True if a chunk crashed several workers in succession.

        Raises:
            WorkError: If the chunk failed for a reason outside its task.
        """
        from distributed import KilledWorker

        if future.cancelled():
            raise self._gone()
        error = future.exception()
        if error is None:
            return False
        if isinstance(error, CancelledError):
            raise self._gone()
        if isinstance(error, KilledWorker):
            return True
        raise WorkError(
            f"The workers of the cluster `{self._cluster.address}` cannot compute a chunk "
            f"({type(error).__name__}: {error}). Is zeno_orbits installed there?"
        ) from error

    def check(self) -> None:
        """Raise an error if the scheduler is lost, or all workers have been missing for long."""
        now = time.monotonic()
        if now - self._asked < _PAUSE:
            return
        self._asked = now
        if self._client.status not in ("running", "connecting"):
            raise self._gone()
        if self._client.status == "running" and self._workers():
            self._seen = now
        elif now - self._seen > 4 * self._cluster.patience:
            raise self._gone()

    def _workers(self) -> dict[str, Any]:
        return self._client.scheduler_info(n_workers=-1)["workers"]

    def _gone(self) -> WorkError:
        return WorkError(
            f"The cluster `{self._cluster.address}` has lost its scheduler or all its workers; "
            "finished results remain in the checkpoint, if one is used"
        )


@contextmanager
def open_cluster(cluster: Cluster) -> Generator[ClusterPool]:
    """Provide the workers of a cluster within a context.

    Raises:
        InputError: If Dask is not installed, the scheduler does not answer, or no worker is
            connected to it.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(
            "Argument `scheduler` must come with the extra `cluster`, but Dask is not "
            "installed; run `pip install 'zeno_orbits[cluster]'`."
        ) from error
    _require_scheduler(cluster)
    patience = cluster.patience
    with _quiet(), Client(cluster.address, timeout=patience, set_as_default=False) as client:
        try:
            client.wait_for_workers(1, timeout=patience)
        except TimeoutError as error:
            asked = _asked(cluster)
            raise InputError(f"{asked} lacks a worker after {patience:g} s.") from error
        yield ClusterPool(client, cluster)


def _asked(cluster: Cluster) -> str:
    return f"Argument `scheduler` must be the address of a Dask scheduler, but `{cluster.address}`"


def _require_scheduler(cluster: Cluster) -> None:
    """Check that an address belongs to a scheduler, since a client would wait indefinitely."""
    # Most work does not need these modules, which import more slowly than the rest of this module.
    import asyncio

    from distributed import Security
    from distributed.core import rpc

    async def ask() -> dict[str, Any]:
        security = Security().get_connection_args("client")
        other: Any
        async with rpc(cluster.address, connection_args=security) as other:
            return await other.identity()

    async def ask_in_time() -> dict[str, Any]:
        return await asyncio.wait_for(ask(), cluster.patience)

    # The thread of a notebook already runs an event loop and cannot run a second loop.
    with ThreadPoolExecutor(1) as thread:
        try:
            found = thread.submit(asyncio.run, ask_in_time()).result()["type"]
        except OSError as error:
            # Base class of all errors of time-outs and connections.
            late = f"does not answer within {cluster.patience:g} s"
            raise InputError(f"{_asked(cluster)} {late}.") from error
        except Exception as error:
            reason = f"is not one ({type(error).__name__}: {error})"
            raise InputError(f"{_asked(cluster)} {reason}.") from error
    if found != "Scheduler":
        raise InputError(f"{_asked(cluster)} is the address of a {found}.")


@contextmanager
def _quiet() -> Generator[None]:
    """Silence the log messages of Dask about errors that are handled here."""
    loggers = [logging.getLogger(f"distributed.{name}") for name in ("client", "comm")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
