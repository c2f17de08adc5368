"""The starts of a search one after another: in this process, or by many workers."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from zeno_orbits.errors import InputError
from zeno_orbits.model import ProblemFile
from zeno_orbits.search.outcome import Accept, StartOutcome
from zeno_orbits.search.search_problem import SearchProblem
from zeno_orbits.search.settings import SearchStatus
from zeno_orbits.search.start import scanned, start_count, try_start
from zeno_orbits.work import (
    LostPoint,
    Plan,
    Progress,
    plain,
    restored,
    silent,
    spread_in_order,
    versions,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class StartWorkers:
    """Workers that try the starts of a search.

    Attributes:
        problem_file: File of the problem; the search is given ``problem_file.load()``.
        plan: Place of the workers and of finished starts. Its identity is filled in.
        tell: Told how many starts are done, and the part of what was left at the start.
    """

    problem_file: ProblemFile
    plan: Plan
    tell: Progress = silent


def outcomes_here(search: SearchProblem, accept: Accept | None) -> Generator[StartOutcome]:
    """Yield the outcome of each start, tried in this process when it is asked for."""
    for number in range(start_count(search)):
        search = scanned(search, number)
        yield try_start(search, number, accept)


def outcomes_spread(
    search: SearchProblem, accept: Accept | None, spread: StartWorkers
) -> Generator[StartOutcome]:
    """Yield the outcome of each start in order: the first from this process, others from workers.

    Most searches end at their first start, before workers could have begun.

    Args:
        search: What is asked.
        accept: Judges an orbit; any orbit is accepted by default.
        spread: The workers, and where finished starts are kept.

    Raises:
        InputError: If the problem is another one, the place cannot be had, or the checkpoint is
            another's.
        WorkError: If the work cannot be finished.
    """
    if spread.problem_file.load() is not search.problem:
        wanted = "must be what the `problem` of `spread` loads"
        raise InputError(f"Argument `problem` {wanted}, but it is another `{search.problem.name}`.")
    search = scanned(search, 0)
    question = search.question()
    task = _Task(problem_file=spread.problem_file, question=question, accept=accept)
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
            yield _lost(result) if isinstance(result, LostPoint) else restored(StartOutcome, result)
    finally:
        results.close()


@dataclass(frozen=True, slots=True, kw_only=True)
class _Task:
    """Tries starts by their numbers; it holds all that a worker needs.

    Attributes:
        problem_file: File from which the worker loads the problem.
        question: The search but for its problem.
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
        """Return the outcomes of starts of a search that is at hand, as plain data."""
        return [
            plain(try_start(scanned(search, number), number, self.accept)) for number in numbers
        ]


def _identity(task: _Task) -> dict[str, Any]:
    """Return everything that the outcome of a start depends on."""
    question = dict(task.question)
    values = question.pop("values")
    # The order follows from all the rest.
    del question["order"]
    return {
        "work": "search",
        "problem": task.problem_file.load().name,
        "problem_digest": task.problem_file.digest,
        "gains": plain(values.gains),
        "parameters": plain(values.parameters),
        "from": plain(question.pop("near")),
        **{name: plain(value, name) for name, value in question.items()},
        "accept": plain(task.accept, "accept"),
        "versions": versions(),
    }


def _lost(lost: LostPoint) -> StartOutcome:
    return StartOutcome(status=SearchStatus.NOT_SOLVED, detail=lost.reason)
