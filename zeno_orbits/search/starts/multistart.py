"""The starts of a search: one after another in this process, or in parallel by many workers."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from zeno_orbits.errors import InputError
from zeno_orbits.model import ParameterValues, Problem, ProblemFile
from zeno_orbits.search.outcome import Accept, StartOutcome
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


RunStarts = Callable[[Sequence[int]], Sequence[Any]]
"""Function from indices of starts to their results as plain data. It can be pickled."""


def results_in_order(
    task: RunStarts,
    count: int,
    spread: StartWorkers,
    *,
    problem: Problem,
    here: RunStarts,
    identity: Callable[[], Mapping[str, Any]],
) -> Generator[Any]:
    """Return the results of the starts of a search in order: first from this process, then others.

    Most searches end at their first start, before workers could begin.

    Args:
        task: Function from indices of starts to their results as plain data.
        count: Number of starts.
        spread: The workers, and the checkpoint of finished starts.
        problem: The problem of the search.
        here: The same task for this process.
        identity: Function that returns all inputs on which a result depends, for the checkpoint.

    Raises:
        InputError: If the workers load another problem, the executor is not available, or the
            checkpoint belongs to another search.
        WorkError: If the work cannot be finished.
    """
    if spread.problem_file.load() is not problem:
        wanted = "must be the problem that the workers of `spread` load"
        raise InputError(f"Argument `problem` {wanted}, but it is another `{problem.name}`.")
    plan = replace(spread.plan, chunk=1, noun="starts at most")
    if plan.checkpoint is not None:
        plan = replace(plan, identity={**identity(), **plan.identity})
    return spread_in_order(task, range(count), plan, here=here, on_progress=spread.tell)


def outcomes_here(search: SearchProblem, accept: Accept | None) -> Generator[StartOutcome]:
    """Yield the outcome of each start, computed on demand in this process."""
    for number in range(start_count(search)):
        search = scanned(search, number)
        yield try_start(search, number, accept)


def outcomes_spread(
    search: SearchProblem, accept: Accept | None, spread: StartWorkers
) -> Generator[StartOutcome]:
    """Yield the outcome of each start in order, as `results_in_order`.

    Args:
        search: The search.
        accept: Check of an orbit. By default all orbits are accepted.
        spread: The workers, and the checkpoint of finished starts.
    """
    search = scanned(search, 0)
    question = search.question()
    task = _Task(problem_file=spread.problem_file, question=question, accept=accept)
    results = results_in_order(
        task,
        start_count(search),
        spread,
        problem=search.problem,
        here=lambda numbers: task.outcomes(search, numbers),
        identity=lambda: _identity(task),
    )
    try:
        for result in results:
            yield (
                _lost(result)
                if isinstance(result, FailedPoint)
                else from_plain(StartOutcome, result)
            )
    finally:
        results.close()


@dataclass(frozen=True, slots=True, kw_only=True)
class _Task:
    """A task that runs starts by their indices. It contains all data that a worker needs.

    Attributes:
        problem_file: File from which the worker loads the problem.
        question: The search without its problem.
        accept: The check of orbits.
    """

    problem_file: ProblemFile
    question: Mapping[str, Any]
    accept: Accept | None

    def __call__(self, numbers: Sequence[int]) -> list[dict[str, Any]]:
        """Return the outcomes of starts, as plain data."""
        search = SearchProblem(problem=self.problem_file.load(), **self.question)
        return self.outcomes(search, numbers)

    def outcomes(self, search: SearchProblem, numbers: Sequence[int]) -> list[dict[str, Any]]:
        """Return the outcomes of starts of a given search, as plain data."""
        return [
            to_plain(try_start(scanned(search, number), number, self.accept)) for number in numbers
        ]


def _identity(task: _Task) -> dict[str, Any]:
    """Return all inputs on which the outcome of a start depends."""
    question = dict(task.question)
    # The order follows from the other entries.
    del question["order"]
    values = question.pop("values")
    accept = {"accept": to_plain(task.accept, "accept")}
    return identity_of("search", task.problem_file, values, question, accept)


def identity_of(
    work: str,
    file: ProblemFile,
    values: ParameterValues,
    question: Mapping[str, Any],
    others: Mapping[str, Any],
) -> dict[str, Any]:
    """Return all inputs on which the result of a start depends, as plain data.

    Args:
        work: Name of the work.
        file: File of the problem.
        values: Gains and parameters of the search.
        question: The search without its problem and these values.
        others: Further inputs, as plain data.
    """
    further = dict(question)
    return {
        "work": work,
        "problem": file.load().name,
        "problem_digest": file.digest,
        "gains": to_plain(values.gains),
        "parameters": to_plain(values.parameters),
        "from": to_plain(further.pop("near")),
        **{name: to_plain(value, name) for name, value in further.items()},
        **others,
        "simulator": simulator_in_use(),
        "versions": versions(),
    }


def _lost(lost: FailedPoint) -> StartOutcome:
    return StartOutcome(status=SearchStatus.NOT_SOLVED, detail=lost.reason)
