"""Find orbits: one start after another, until enough are found and accepted, ranked."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace

from zeno_orbits.errors import InputError, ZenoOrbitsError
from zeno_orbits.model.problem import ParameterValues, Problem
from zeno_orbits.orbits.bounds import Bound
from zeno_orbits.orbits.orbit import ZenoOrbit
from zeno_orbits.orbits.shape import OrbitShape
from zeno_orbits.search.multistart import Spread, numbered_start, trials_here, trials_spread
from zeno_orbits.search.objectives import NearestGains, Objective, WantedAmplitude, WantedPeriod
from zeno_orbits.search.refinement import Hunt
from zeno_orbits.search.settings import SearchSettings, SearchStatus, Start
from zeno_orbits.search.start import Accept, Candidate, Judgement, Trial
from zeno_orbits.search.validation import Question, clipped, require_sense

__all__ = [
    "Attempt",
    "Candidate",
    "Judgement",
    "OrbitNotFoundError",
    "SearchResult",
    "SearchSettings",
    "SearchStatus",
    "Spread",
    "find_orbit",
    "search_gains",
]

_SAME = 1e-6
"""Orbits whose free numbers and periods differ by less, relative, are the same candidate."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt:
    """One start of a search.

    Attributes:
        gains: Gains where it started.
        parameters: Free parameters where it started.
        status: How it ended.
        detail: The reason in words, for a start that found nothing.
    """

    gains: Mapping[str, float]
    parameters: Mapping[str, float] = field(default_factory=dict[str, float])
    status: SearchStatus
    detail: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class SearchResult:
    """Outcome of a search, successful or not.

    Attributes:
        status: How it ended.
        orbit: The best orbit, if there is one.
        residuals: Row name to scaled violation in the program of the best.
        agreement: Relative difference of program and simulation over one period.
        closure_error: Estimated error of the Zeno closure, relative.
        n_unknowns: Unknowns of the program.
        iterations: Ipopt's iterations in it.
        solve_time: Wall time in Ipopt in it [s].
        wall_time: Wall time of the search [s].
        attempts: Every start, in order.
        candidates: The accepted orbits, the best first.
        detail: The reason in words, if there is no orbit.
    """

    status: SearchStatus
    orbit: ZenoOrbit | None
    residuals: Mapping[str, float]
    agreement: float
    closure_error: float
    n_unknowns: int
    iterations: int
    solve_time: float
    wall_time: float
    attempts: tuple[Attempt, ...]
    candidates: tuple[Candidate, ...] = ()
    detail: str = ""

    def __repr__(self) -> str:
        """Return a few lines: the status and the best orbit."""
        best = f"\n  {self.orbit!r}" if self.orbit is not None else ""
        detail = f"{self.status.value} {self.detail}".strip()
        return (
            f"<SearchResult {self.status.name}: {detail} starts={len(self.attempts)}, "
            f"candidates={len(self.candidates)}, wall_time={self.wall_time:.1f} s{best}>"
        )

    def unwrap(self) -> ZenoOrbit:
        """Return the best orbit.

        Raises:
            OrbitNotFoundError: If there is none; the error carries this result.
        """
        if self.orbit is None:
            raise OrbitNotFoundError(self)
        return self.orbit


class OrbitNotFoundError(ZenoOrbitsError):
    """A search ended without an orbit.

    Attributes:
        result: How it ended.
    """

    def __init__(self, result: SearchResult) -> None:
        super().__init__(f"{result.status.value} {result.detail}".strip())
        self.result = result


def find_orbit(
    problem: Problem,
    values: ParameterValues,
    *,
    settings: SearchSettings | None = None,
    shape: OrbitShape | None = None,
) -> SearchResult:
    """Find the orbit at given gains: as many conditions as unknowns.

    Args:
        problem: The problem.
        values: Its numbers; there is one start.
        settings: How hard to look.
        shape: The shape of the orbit; by default whatever a simulation settles to.
    """
    settings = replace(settings or SearchSettings(), n_starts=0)
    return search_gains(problem, values, free={}, settings=settings, shape=shape)


def search_gains(
    problem: Problem,
    values: ParameterValues,
    *,
    free: Mapping[str, tuple[float, float]],
    objective: Objective | None = None,
    bounds: Sequence[Bound] = (),
    near: ZenoOrbit | None = None,
    settings: SearchSettings | None = None,
    accept: Accept | None = None,
    on_progress: Callable[[str], None] | None = None,
    spread: Spread | None = None,
    shape: OrbitShape | None = None,
) -> SearchResult:
    """Find gains, parameters and initial states of an orbit, from one start after another.

    Args:
        problem: The problem.
        values: Its numbers; what is free starts here, then at quasi-random places in its box.
        free: Name to bounds of the gains and parameters to be found; none at fixed numbers. What
            the problem derives from a free parameter keeps its number in ``setting``.
        objective: What is asked; by default numbers near their start.
        bounds: What the orbit must keep, whatever is asked.
        near: A known orbit of the problem to start from, at these numbers or near them.
        settings: How hard to look, and how many orbits to rank.
        accept: Says why an orbit will not do, or nothing if it will; any orbit does by default.
        on_progress: Called with what is being done.
        spread: By whom starts after the first are tried; by default one after another in this
            process. The result is the same bit for bit for any number of workers, times apart:
            starts count in their order, whoever is first. With a checkpoint, ``accept`` must be
            a function of a module, or a frozen dataclass with ``__call__``.
        shape: The shape of the orbits that are wanted; by default that of ``near``, or whatever a
            simulation settles to.

    Returns:
        The accepted orbits, the best first, or why there is none.

    Raises:
        InputError: If a name is unknown, bounds are the wrong way round, or the place or the
            checkpoint of ``spread`` is not usable.
        WorkError: If the workers of ``spread`` cannot finish.
    """
    question = Question(free=free, objective=objective, bounds=tuple(bounds), near=near)
    require_sense(problem, question)
    if near is not None:
        shape = near.shape.agreed(shape)
    objective = objective or NearestGains(target={})
    if isinstance(objective, NearestGains):
        # What has no target stays near its start, so the start is where the target can be met.
        values = values.replaced(objective.target)
        values = clipped(values, free)
        named = {**values.gains, **{name: values.number(name) for name in free}}
        objective = NearestGains(target=named)
    hunt = Hunt(
        problem=problem,
        compiled=problem.compiled(),
        values=values,
        free=free,
        objective=objective,
        bounds=tuple(bounds),
        settings=settings or SearchSettings(),
        shape=shape,
        tell=on_progress or (lambda _: None),
    )
    if spread is None:
        return _search(hunt, near, trials_here(hunt, near, accept))
    return _search(hunt, near, trials_spread(hunt, near, accept, spread))


def _search(hunt: Hunt, near: ZenoOrbit | None, trials: Generator[Trial]) -> SearchResult:
    """Rank what trials give, in the order of their starts, until there is enough."""
    started = time.perf_counter()
    attempts: list[Attempt] = []
    candidates: list[Candidate] = []
    best: Trial | None = None
    failures = 0
    # Whoever tries other starts meanwhile is told to stop.
    with closing(trials):
        for number, trial in enumerate(trials):
            attempts.append(_attempt(hunt, numbered_start(hunt, near, number), trial))
            failures += trial.status not in (SearchStatus.NO_GUESS, SearchStatus.FOUND)
            if trial.candidate is None:
                best = trial if best is None else max(best, trial, key=_merit)
            else:
                if not any(_same(hunt, trial.candidate, other) for other in candidates):
                    candidates.append(trial.candidate)
                if min(candidates, key=lambda one: one.score) is trial.candidate:
                    best = trial
            if len(candidates) >= hunt.settings.candidates:
                break
            if not candidates and failures >= _enough_failures(hunt):
                break
    if best is None:
        raise InputError("Argument `settings` must allow a start, but it allows none.")
    ranked = tuple(sorted(candidates, key=lambda one: one.score))
    return SearchResult(
        status=best.status,
        orbit=ranked[0].orbit if ranked else None,
        residuals=best.residuals,
        agreement=best.agreement,
        closure_error=best.closure_error,
        n_unknowns=best.n_unknowns,
        iterations=best.iterations,
        solve_time=best.solve_time,
        wall_time=time.perf_counter() - started,
        attempts=tuple(attempts),
        candidates=ranked,
        detail=best.detail,
    )


def _attempt(hunt: Hunt, start: Start, trial: Trial) -> Attempt:
    parameters = start.values.parameters
    return Attempt(
        gains=start.values.gains,
        parameters={name: parameters[name] for name in hunt.free if name in parameters},
        status=trial.status,
        detail=trial.detail,
    )


def _same(hunt: Hunt, one: Candidate, other: Candidate) -> bool:
    """Tell whether two candidates are the same orbit at the same numbers."""
    a, b = one.orbit.values(hunt.problem), other.orbit.values(hunt.problem)
    pairs = [(a.number(name), b.number(name)) for name in hunt.free]
    pairs.append((one.orbit.period, other.orbit.period))
    alike = one.orbit.shape == other.orbit.shape
    return alike and all(abs(p - q) <= _SAME * max(abs(p), abs(q)) for p, q in pairs)


def _enough_failures(hunt: Hunt) -> int:
    """Return how many starts with a good guess may fail before a search gives up.

    A wanted value or a bound is approached step by step from every start, which takes long and
    ends at much the same place.
    """
    slow = isinstance(hunt.objective, WantedPeriod | WantedAmplitude) or hunt.bounds
    return 2 if slow else 5


_RANK = {
    SearchStatus.NO_GUESS: 0,
    SearchStatus.NOT_SOLVED: 1,
    SearchStatus.NOT_FOLLOWED: 2,
    SearchStatus.NOT_ACCEPTED: 3,
    SearchStatus.FOUND: 4,
}


def _merit(trial: Trial) -> tuple[int, float]:
    return _RANK[trial.status], -trial.shortfall
