"""Parallel evaluation of points, chunk by chunk, with recovery from worker crashes."""

from __future__ import annotations

import hashlib
import json
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

from zeno_orbits.work.checkpoint import Checkpoint, folder_lock, open_checkpoint
from zeno_orbits.work.kinds import checked
from zeno_orbits.work.plan import ExecutionPlan, FailedPoint, Workers
from zeno_orbits.work.pools import Pool, open_pool
from zeno_orbits.work.progress import Progress, silent
from zeno_orbits.work.software import code_digest
from zeno_orbits.work.tasks import Task, results_of

_NEARLY = 0.99
"""Largest part of a chunk under way in progress reports."""
_TICK = 0.2
"""Longest time between two progress reports, which may check for an interrupt [s]."""


def claim_checkpoint(plan: ExecutionPlan) -> None:
    """Open the checkpoint of work in several stages, each with its own subfolder.

    Raises:
        CheckpointError: If the folder holds other files or other work. The folder is left
            unchanged.
    """
    if plan.checkpoint is not None:
        open_checkpoint(plan.checkpoint, {**plan.identity, "code": code_digest()}, ())


@checked
def parallel_map(
    task: Task,
    points: Sequence[Any],
    plan: ExecutionPlan,
    *,
    on_progress: Progress = silent,
    pool: Pool | None = None,
) -> tuple[Any, ...]:
    """Evaluate a task at all points in parallel, in order. The workers do not affect the results.

    Args:
        task: Function from a chunk of points to their results, one result per point. It is pure and
            can be pickled: a function of a module, or a frozen dataclass with ``__call__``.
        points: Plain data: numbers, texts, lists and mappings of them.
        plan: Executor, size of the chunks, and folder for finished chunks.
        on_progress: Called with the finished part of the points that were left at the start. An
            exception that it raises ends the work, and finished chunks stay in the checkpoint.
        pool: Workers of `open_pool` that replace the plan's executor, for several stages in
            succession.

    Returns:
        One result per point, converted through JSON, or ``FailedPoint`` if the point crashes its
        worker.

    Raises:
        InputError: If the executor is not available, or the checkpoint belongs to other work.
        WorkError: If the task fails, or a cluster is lost.
    """
    return tuple(spread_in_order(task, points, plan, on_progress=on_progress, pool=pool))


def spread_in_order(
    task: Task,
    points: Sequence[Any],
    plan: ExecutionPlan,
    *,
    here: Task | None = None,
    on_progress: Progress = silent,
    pool: Pool | None = None,
) -> Generator[Any]:
    """Yield the result of every point in order, once it and all earlier results are available.

    Close the iterator to stop early. Chunks under way are then dropped, and the workers end. The
    order does not depend on the workers, so the results before an early stop do not either. Workers
    start when the first chunk needs them. An executor other than the default is opened before any
    work is done.

    Args:
        task: As in ``parallel_map``.
        points: As in ``parallel_map``.
        plan: As in ``parallel_map``.
        here: The same task for this process, which computes the first chunk before workers start.
            By default this process computes no chunk.
        on_progress: As in ``parallel_map``.
        pool: As in ``parallel_map``. The iterator must then be run to the end.

    Yields:
        As ``parallel_map`` returns them.

    Raises:
        InputError: If the executor is not available, or the checkpoint belongs to other work.
        WorkError: If the task fails, or a cluster is lost.
    """
    chunks = tuple(points[k : k + plan.chunk] for k in range(0, len(points), plan.chunk))
    with ExitStack() as stack:
        if plan.checkpoint is not None:
            stack.enter_context(folder_lock(plan.checkpoint))
        store = _checkpoint(plan, points, [len(chunk) for chunk in chunks])
        found = store.finished() if store is not None else {}
        report = _report(on_progress, plan.noun, chunks, found)

        def keep(chunk: int, results: list[Any]) -> None:
            if store is not None:
                store.save(chunk, results)
            found[chunk] = results

        if pool is None and plan.place != Workers() and len(found) < len(chunks):
            pool = stack.enter_context(open_pool(plan.place))
        if here is not None and chunks and 0 not in found:
            keep(0, json.loads(json.dumps(list(here(chunks[0])), allow_nan=False)))
        arrivals: Iterator[tuple[int, list[Any]]] | None = None
        for k in range(len(chunks)):
            if k not in found and arrivals is None:
                pool = pool or stack.enter_context(open_pool(plan.place))
                run = _Run(pool=pool, task=task, chunks=chunks, report=report)
                arrivals = run.finish([j for j in range(len(chunks)) if j not in found])
            while k not in found and arrivals is not None:
                keep(*next(arrivals))
                report()
            yield from found[k]


def _checkpoint(
    plan: ExecutionPlan, points: Sequence[Any], sizes: Sequence[int]
) -> Checkpoint | None:
    if plan.checkpoint is None:
        return None
    digest = hashlib.sha256(json.dumps(list(points), allow_nan=False).encode()).hexdigest()
    own = {"points": len(points), "points_digest": digest, "chunk": plan.chunk}
    identity = {**plan.identity, **own, "code": code_digest()}
    return open_checkpoint(plan.checkpoint, identity, sizes)


def _report(
    on_progress: Progress,
    noun: str,
    chunks: Sequence[Sequence[Any]],
    found: dict[int, list[Any]],
) -> Callable[..., None]:
    """Return a progress function whose argument is the number of finished points under way.

    The reported part excludes the points that an earlier run finished.
    """
    total = sum(map(len, chunks))
    before = sum(map(len, found.values()))

    def report(under_way: float = 0.0) -> None:
        done = sum(map(len, found.values())) + under_way
        on_progress(f"{int(done)} of {total} {noun}", (done - before) / max(total - before, 1))

    return report


@dataclass(slots=True, kw_only=True)
class _Run:
    """Chunks under way.

    The crash of a worker may fail every chunk under way, without identifying the chunk that caused
    it. So these chunks are computed again, half as many at the same time, until the chunk that
    causes the crash is computed alone.
    """

    pool: Pool
    task: Task
    chunks: Sequence[Sequence[Any]]
    report: Callable[..., None]
    deaths: Counter[int] = field(default_factory=Counter[int])

    def finish(self, todo: Sequence[int]) -> Iterator[tuple[int, list[Any]]]:
        """Yield every chunk with its results as it is finished."""
        waiting, flying = deque(todo), dict[Future[str], int]()
        doubtful, window = set[int](), self.pool.window
        while waiting or flying:
            while waiting and len(flying) < window:
                chunk = waiting.popleft()
                flying[self.pool.submit(self.task, self.chunks[chunk])] = chunk
            crowd = len(flying)
            landed = [(flying.pop(future), future) for future in self._landed(flying)]
            fallen = [chunk for chunk, future in landed if self.pool.died(future)]
            for chunk, future in landed:
                if chunk not in fallen:
                    doubtful.discard(chunk)
                    yield chunk, results_of(future.result())
            if fallen:
                guilty = crowd == 1 and self._is_killer(fallen[0])
                if guilty:
                    doubtful.discard(fallen[0])
                    yield fallen[0], self._one_by_one(fallen[0])
                else:
                    waiting.extendleft(fallen)
                    doubtful.update(fallen)
                    window = max(crowd // 2, 1)
            if not doubtful:
                window = self.pool.window

    def _landed(self, flying: Mapping[Future[str], int]) -> list[Future[str]]:
        """Wait a moment and return the futures that are done.

        Args:
            flying: Futures under way, each with the index of its chunk.
        """
        done = wait(flying, timeout=_TICK, return_when=FIRST_COMPLETED).done
        if self.pool.one_fate and any(future.exception() is not None for future in done):
            done = wait(flying).done
        self.pool.check()
        parts = [self.pool.part(future) * len(self.chunks[k]) for future, k in flying.items()]
        # A chunk counts as finished only after it is stored.
        self.report(_NEARLY * sum(parts))
        return [future for future in flying if future in done]

    def _is_killer(self, chunk: int) -> bool:
        self.deaths[chunk] += 1
        return self.deaths[chunk] >= self.pool.attempts

    def _one_by_one(self, chunk: int) -> list[Any]:
        """Return the results of a chunk that crashes its workers, point by point."""
        results: list[Any] = []
        points = self.chunks[chunk]
        for k in range(len(points)):
            answer = self._alone(chunk, points[k : k + 1])
            results.append(FailedPoint() if answer is None else results_of(answer)[0])
        return results

    def _alone(self, chunk: int, points: Sequence[Any]) -> str | None:
        for _ in range(self.pool.attempts):
            future = self.pool.submit(self.task, points)
            while not self._landed({future: chunk}):
                pass
            if not self.pool.died(future):
                return future.result()
        return None
