"""Jobs of a continuation run by this process, or by a crew of workers."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar, cast

from zeno_orbits.continuation.branch import Branch
from zeno_orbits.continuation.families import HalfCurve, SpecialPointKind
from zeno_orbits.continuation.jobs import Job
from zeno_orbits.continuation.setup import ContinuationSettings
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model import Problem, ProblemFile
from zeno_orbits.orbits import StepError
from zeno_orbits.work import (
    ExecutionPlan,
    FailedPoint,
    Pool,
    Progress,
    claim_checkpoint,
    from_plain,
    parallel_map,
    silent,
    to_plain,
)

R = TypeVar("R")


@dataclass(frozen=True, kw_only=True)
class WorkerPool:
    """Workers of a continuation.

    Attributes:
        problem_file: File of the problem. The problem of the continuation is
            ``problem_file.load()``.
        plan: Plan with the checkpoint of finished jobs. Its identity is filled in.
        pool: The workers, from `open_pool`.
        on_progress: Called with the number of finished jobs of a stage.
    """

    problem_file: ProblemFile
    plan: ExecutionPlan
    pool: Pool
    on_progress: Progress


@dataclass(frozen=True, kw_only=True)
class Dispatch:
    """Run jobs in this process or by a crew.

    Attributes:
        problem: The problem.
        settings: Settings of the continuation.
        on_progress: Called with each point that this process computes.
        crew: The workers, or ``None``.
    """

    problem: Problem
    settings: ContinuationSettings
    on_progress: Progress
    crew: WorkerPool | None = None

    def claimed(self, own: dict[str, Any]) -> Dispatch:
        """Return this dispatch with the checkpoint claimed for one continuation.

        Args:
            own: Data that distinguish the continuation from other work, as plain data.

        Raises:
            InputError: If the crew has another problem, or the checkpoint belongs to other work.
        """
        if self.crew is None:
            return self
        if self.crew.problem_file.load() is not self.problem:
            wanted = "must be the problem that the workers of `crew` load"
            raise InputError(f"Argument `problem` {wanted}.")
        identity = {"work": "continuation", **own, "problem_digest": self.crew.problem_file.digest}
        plan = replace(self.crew.plan, chunk=1, identity={**identity, **self.crew.plan.identity})
        claim_checkpoint(plan)
        return replace(self, crew=replace(self.crew, plan=plan))

    def results(self, stage: str, noun: str, groups: Sequence[Sequence[Job[R]]]) -> list[list[R]]:
        """Return the results of jobs, in their groups.

        Within a group each job continues the work of the previous job. A group ends after a family
        or a curve that closes, because the remaining jobs are then unnecessary.

        Args:
            stage: Name under which finished jobs are kept.
            noun: Name of the jobs in progress reports.
            groups: The jobs.
        """
        if self.crew is not None:
            flat = [job for group in groups for job in group]
            results = iter(_results_of_crew(self.crew, stage, noun, self.settings, flat))
            return [_until_closed([next(results) for _ in group]) for group in groups]
        found: list[list[R]] = []
        for group in groups:
            found.append([])
            for job in group:
                found[-1].append(_attempted(job, self.problem, self.settings, self.on_progress))
                if _closes(found[-1][-1]):
                    break
        return found


def _attempted(
    job: Job[R], problem: Problem, settings: ContinuationSettings, on_progress: Progress
) -> R:
    """Return the result of a job. If the job fails, the other jobs continue."""
    try:
        return job.run(problem, settings, on_progress)
    except (SimulationError, StepError) as error:
        return job.failed(str(error))


def _closes(result: object) -> bool:
    if isinstance(result, Branch):
        return result.ending is SpecialPointKind.CLOSED
    return isinstance(result, HalfCurve) and result.closes


def _until_closed(results: list[R]) -> list[R]:
    closed = next((k for k, result in enumerate(results) if _closes(result)), len(results))
    return results[: closed + 1]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Task(Generic[R]):
    """Run jobs by their indices. An instance contains all data that a worker needs."""

    problem_file: ProblemFile
    settings: ContinuationSettings
    jobs: tuple[Job[R], ...]

    def __call__(self, numbers: Sequence[int]) -> list[Any]:
        """Return the results of jobs as plain data."""
        problem = self.problem_file.load()
        chosen = [self.jobs[number] for number in numbers]
        return [to_plain(_attempted(job, problem, self.settings, silent)) for job in chosen]


def _results_of_crew(
    crew: WorkerPool,
    stage: str,
    noun: str,
    settings: ContinuationSettings,
    jobs: Sequence[Job[R]],
) -> list[R]:
    if not jobs:
        return []
    task = _Task(problem_file=crew.problem_file, settings=settings, jobs=tuple(jobs))
    plan = replace(crew.plan, noun=noun)
    if plan.checkpoint is not None:
        words = json.dumps([to_plain(job) for job in jobs])
        digest = hashlib.sha256(words.encode()).hexdigest()
        plan = replace(
            plan,
            checkpoint=plan.checkpoint / stage,
            identity={**plan.identity, "stage": stage, "jobs": digest},
        )
    results = parallel_map(
        task, range(len(jobs)), plan, on_progress=crew.on_progress, pool=crew.pool
    )
    return [
        job.failed(result.reason)
        if isinstance(result, FailedPoint)
        else from_plain(cast("type[R]", job.result), result)
        for job, result in zip(jobs, results, strict=True)
    ]
