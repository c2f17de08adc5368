"""The starts of a search by their numbers, and what comes of them: here, or by many workers."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.model.library import ProblemFile
from zeno_orbits.model.problem import ParameterValues, Problem
from zeno_orbits.orbits.bounds import Bound
from zeno_orbits.orbits.orbit import ZenoOrbit
from zeno_orbits.orbits.shape import OrbitShape
from zeno_orbits.search.objectives import Objective
from zeno_orbits.search.refinement import Hunt
from zeno_orbits.search.settings import Known, SearchSettings, SearchStatus, Start
from zeno_orbits.search.start import Accept, Trial, tried
from zeno_orbits.search.start_data import trial_from_json, trial_to_json
from zeno_orbits.search.validation import clipped
from zeno_orbits.work import Lost, Plan, spread_in_order
from zeno_orbits.work.progress import Progress, silent
from zeno_orbits.work.serialization import plain
from zeno_orbits.work.versions import versions


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """By whom the starts of a search are tried.

    Attributes:
        problem: Where workers find the problem; the search is told ``problem.load()``.
        plan: Where they are, and where finished starts are kept. Its identity is filled in.
        tell: Told how many starts are done, and the part of what was left at the start.
    """

    problem_file: ProblemFile
    plan: Plan
    tell: Progress = silent


def start_count(hunt: Hunt) -> int:
    """Return how many starts a search has."""
    return 1 + (hunt.settings.n_starts if hunt.free else 0)


def numbered_start(hunt: Hunt, near: ZenoOrbit | None, number: int) -> Start:
    """Return a start: 0 is the given numbers, moved into their box, then a Halton sequence in it.

    It depends on the number and on what is searched, and not on what was tried before.
    """
    if number > 0:
        lower, upper = np.array(list(hunt.free.values())).T
        place = _halton(len(hunt.free), hunt.settings.n_starts, hunt.settings.seed)[number - 1]
        chosen = dict(zip(hunt.free, map(float, lower + place * (upper - lower)), strict=True))
        return Start(values=hunt.values.replaced(chosen))
    first = clipped(hunt.values, hunt.free)
    known = None
    if near is not None:
        known = Known(
            values=near.values(hunt.problem),
            start=np.array(hunt.problem.state_vector(near.start_state)),
            shape=near.shape,
        )
    return Start(values=first, known=known, easy=_easy_settings(hunt.problem, first))


def trials_here(hunt: Hunt, near: ZenoOrbit | None, accept: Accept | None) -> Generator[Trial]:
    """Try one start after another in this process, for as long as somebody asks."""
    for number in range(start_count(hunt)):
        yield tried(hunt, numbered_start(hunt, near, number), accept, number + 1)


def trials_spread(
    hunt: Hunt, near: ZenoOrbit | None, accept: Accept | None, spread: Spread
) -> Generator[Trial]:
    """Try the first start in this process and the others by workers; give them in order.

    Most searches end at their first start, before workers could have begun.

    Raises:
        InputError: If the problem is another one, the place cannot be had, or the checkpoint is
            another's.
        WorkError: If the work cannot be finished.
    """
    if spread.problem_file.load() is not hunt.problem:
        wanted = "must be what the `problem` of `spread` loads"
        raise InputError(f"Argument `problem` {wanted}, but it is another `{hunt.problem.name}`.")
    task = _Task(
        problem_file=spread.problem_file,
        values=hunt.values,
        free=hunt.free,
        objective=hunt.objective,
        bounds=hunt.bounds,
        settings=hunt.settings,
        shape=hunt.shape,
        near=near,
        accept=accept,
    )
    plan = replace(spread.plan, chunk=1, noun="starts at most")
    if plan.checkpoint is not None:
        own = _identity(hunt, near, accept, spread.problem_file)
        plan = replace(plan, identity={**own, **plan.identity})
    results = spread_in_order(
        task,
        range(start_count(hunt)),
        plan,
        here=lambda numbers: task.tried(hunt, numbers),
        on_progress=spread.tell,
    )
    try:
        for result in results:
            yield _lost(result) if isinstance(result, Lost) else trial_from_json(result)
    finally:
        results.close()


@dataclass(frozen=True, slots=True, kw_only=True)
class _Task:
    """Tries starts by their numbers; it holds all that a worker has to know."""

    problem_file: ProblemFile
    values: ParameterValues
    free: Mapping[str, tuple[float, float]]
    objective: Objective
    bounds: tuple[Bound, ...]
    settings: SearchSettings
    shape: OrbitShape | None
    near: ZenoOrbit | None
    accept: Accept | None

    def __call__(self, numbers: Sequence[int]) -> list[dict[str, Any]]:
        """Return what comes of starts, as plain data."""
        problem = self.problem_file.load()
        hunt = Hunt(
            problem=problem,
            compiled=problem.compiled(),
            values=self.values,
            free=self.free,
            objective=self.objective,
            bounds=self.bounds,
            settings=self.settings,
            shape=self.shape,
            tell=_nobody,
        )
        return self.tried(hunt, numbers)

    def tried(self, hunt: Hunt, numbers: Sequence[int]) -> list[dict[str, Any]]:
        starts = [numbered_start(hunt, self.near, number) for number in numbers]
        pairs = zip(numbers, starts, strict=True)
        return [trial_to_json(tried(hunt, start, self.accept, k + 1)) for k, start in pairs]


def _identity(
    hunt: Hunt, near: ZenoOrbit | None, accept: Accept | None, problem_file: ProblemFile
) -> dict[str, Any]:
    """Return everything that the outcome of a start depends on."""
    return {
        "work": "search",
        "problem": hunt.problem.name,
        "problem_digest": problem_file.digest,
        "gains": plain(hunt.values.gains),
        "parameters": plain(hunt.values.parameters),
        "free": plain(hunt.free),
        "objective": plain(hunt.objective, "objective"),
        "bounds": plain(hunt.bounds),
        "from": None if near is None else near.as_json(),
        "settings": plain(hunt.settings, "settings"),
        "shape": None if hunt.shape is None else hunt.shape.text,
        "accept": plain(accept, "accept"),
        "versions": versions(),
    }


def _lost(lost: Lost) -> Trial:
    return Trial(status=SearchStatus.NOT_SOLVED, detail=lost.reason)


def _nobody(_: str) -> None:
    """Tell nobody."""


@lru_cache(maxsize=1)
def _halton(dimension: int, count: int, seed: int) -> Vector:
    """Return quasi-random places in the unit box, ``(count, dimension)``."""
    # SciPy's statistics take half a second to import, and most searches end at their first start.
    from scipy.stats import qmc

    return qmc.Halton(dimension, seed=seed).random(count)


def _easy_settings(problem: Problem, values: ParameterValues) -> tuple[ParameterValues, ...]:
    """Return where an orbit is to be had more easily: the problem's own gains, a duller stop."""
    gains = {gain.name: gain.default for gain in problem.gains if gain.default is not None}
    own = values.replaced(gains)
    dull = {"restitution": values.parameters["restitution"] / 2}
    found = [own, values.replaced(dull), own.replaced(dull), problem.values()]
    return tuple(one for k, one in enumerate(found) if one != values and one not in found[:k])
