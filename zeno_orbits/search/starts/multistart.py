"""The starts of a search: one after another in this process, or in parallel by many workers."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from zeno_orbits.errors import InputError
from zeno_orbits.model import ProblemFile
from zeno_orbits.search.outcome import StartOutcome
from zeno_orbits.search.search_problem import SearchProblem
from zeno_orbits.search.settings import SearchStatus
from zeno_orbits.search.starts.start import scanned, start_count, try_start
from zeno_orbits.simulation import simulator_in_use
from zeno_orbits.work import (
    ExecutionPlan,
    FailedPoint,
    Progress,
    from_plain,
    silent,
    spread_in_order,
    to_plain,
    versions,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class StartWorkers:
    """Workers that run the starts of a search.

    Attributes:
        problem_file: File of the problem. The search receives ``problem_file.load()``.
        plan: Executor of the workers and checkpoint of finished starts. The search completes the
            plan's identity.
        tell: Called with the number of finished starts, and with the finished part of the starts
            that remained at the beginning.
    """

    problem_file: ProblemFile
    plan: ExecutionPlan
    tell: Progress = silent


def outcomes(search: SearchProblem, spread: StartWorkers | None) -> Generator[StartOutcome]:
    """Yield the outcome of each start in order: from this process, then from workers if given.

    Most searches end at their first start, before workers could begin.

    Args:
        search: The search.
        spread: The workers, and the checkpoint of finished starts. By default every outcome is
            computed on demand in this process.

    Raises:
        InputError: If the workers load another problem, the executor is not available, or the
            checkpoint belongs to another search.
        WorkError: If the work cannot be finished.
    """
    if spread is None:
        for number in range(start_count(search)):
            search = scanned(search, number)
            yield try_start(search, number)
        return
    if spread.problem_file.load() is not search.problem:
        wanted = "must be the problem that the workers of `spread` load"
        raise InputError(f"Argument `problem` {wanted}, but it is another `{search.problem.name}`.")
    search = scanned(search, 0)
    task = _Task(problem_file=spread.problem_file, question=search.question())
    plan = replace(spread.plan, chunk=1, noun="starts at most")
    if plan.checkpoint is not None:
        plan = replace(plan, identity={**_identity(task), **plan.identity})
    results = spread_in_order(
        task,
        range(start_count(search)),
        plan,
        here=lambda numbers: task.outcomes(search, numbers),
        on_progress=spread.tell,
    )
    try:
        for result in results:
            lost = isinstance(result, FailedPoint)
            yield _lost(result) if lost else from_plain(StartOutcome, result)
    finally:
        results.close()


@dataclass(frozen=True, slots=True, kw_only=True)
class _Task:
    """A task that runs starts by their indices. It contains all data that a worker needs.

    Attributes:
        problem_file: File from which the worker loads the problem.
        question: The search without its problem.
    """

    problem_file: ProblemFile
    question: Mapping[str, Any]

    def __call__(self, numbers: Sequence[int]) -> list[dict[str, Any]]:
        """Return the outcomes of starts, as plain data."""
        search = SearchProblem(problem=self.problem_file.load(), **self.question)
        return self.outcomes(search, numbers)

    def outcomes(self, search: SearchProblem, numbers: Sequence[int]) -> list[dict[str, Any]]:
        """Return the outcomes of starts of a given search, as plain data."""
        return [to_plain(try_start(scanned(search, number), number)) for number in numbers]


def _identity(task: _Task) -> dict[str, Any]:
    """Return all inputs on which the outcome of a start depends, as plain data."""
    question, file = dict(task.question), task.problem_file
    # The order follows from the other entries.
    del question["order"]
    values, accept = question.pop("values"), question.pop("accept")
    return {
        "work": "search",
        "problem": file.load().name,
        "problem_digest": file.digest,
        "gains": to_plain(values.gains),
        "parameters": to_plain(values.parameters),
        "from": to_plain(question.pop("near")),
        **{name: to_plain(value, name) for name, value in question.items()},
        "accept": to_plain(accept, "accept"),
        "simulator": simulator_in_use(),
        "versions": versions(),
    }


def _lost(lost: FailedPoint) -> StartOutcome:
    return StartOutcome(status=SearchStatus.NOT_SOLVED, detail=lost.reason)
