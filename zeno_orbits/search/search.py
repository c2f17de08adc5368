"""Find orbits: one start after another, until enough are found and accepted, ranked."""

from __future__ import annotations

import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace

from zeno_orbits.errors import InputError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import Bound, OrbitShape, ZenoOrbit
from zeno_orbits.search.multistart import StartWorkers, outcomes_here, outcomes_spread
from zeno_orbits.search.objectives import NearestGains, Objective, Target
from zeno_orbits.search.outcome import (
    Accept,
    Candidate,
    SearchResult,
    StartAttempt,
    StartOutcome,
)
from zeno_orbits.search.search_problem import SearchProblem, with_targets
from zeno_orbits.search.settings import SearchSettings, SearchStatus
from zeno_orbits.search.validation import check_search
from zeno_orbits.work import Progress, silent

_SAME = 1e-5
"""Orbits whose free numbers and periods differ by less, relative, are the same candidate: a program
ends a few 1e-6 off the nearest numbers, as their score is flat there."""
_SAME_OPTIMUM = 1e-3
"""The same for optima, and for their scores."""


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
        settings: Limits and tolerances.
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
    on_progress: Progress = silent,
    spread: StartWorkers | None = None,
    shape: OrbitShape | None = None,
    initial_states: Sequence[Mapping[str, float]] = (),
) -> SearchResult:
    """Find gains, parameters and initial states of an orbit, from one start after another.

    Args:
        problem: The problem.
        values: Its numbers; what is free starts here, then at places in its box, the most promising
            first by a scan of short simulations. An optimum is sought from these at once.
        free: Name to bounds of the gains and parameters to be found; none at fixed numbers. What
            the problem derives from a free parameter keeps its number in ``values``.
        objective: The objective; by default numbers near their start.
        bounds: Bounds that the orbit must keep, whatever the objective.
        near: A known orbit of the problem to start from, at these numbers or near them.
        settings: Limits, tolerances and the number of orbits to rank.
        accept: Check of the orbits; by default all are accepted.
        on_progress: Receives progress reports.
        spread: Workers for the starts after the first; by default all are tried in this process.
            The result is the same bit for bit for any number of workers, times apart: starts count
            in their order. With a checkpoint, ``accept`` must be
            a function of a module, or a frozen dataclass with ``__call__``.
        shape: The shape of the orbits that are wanted; by default that of ``near``, or whatever a
            simulation settles to.
        initial_states: States from which simulations look for orbits, name to value; by default
            those of the problem.

    Returns:
        The accepted orbits, the best first, or why there is none.

    Raises:
        InputError: If a name is unknown, bounds are the wrong way round, or the place or the
            checkpoint of ``spread`` is not usable.
        WorkError: If the workers of ``spread`` cannot finish.
    """
    objective = objective or NearestGains(target={})
    search = SearchProblem(
        problem=problem,
        values=values,
        free=free,
        objective=objective,
        bounds=tuple(bounds),
        near=near,
        shape=shape,
        initial_states=tuple(initial_states) or problem.starts,
        settings=settings or SearchSettings(),
        on_progress=on_progress,
    )
    check_search(search)
    if near is not None:
        search = replace(search, shape=near.shape.agreed(shape))
    search = with_targets(search)
    if spread is None:
        return _ranked(search, outcomes_here(search, accept))
    return _ranked(search, outcomes_spread(search, accept, spread))


def _ranked(search: SearchProblem, outcomes: Generator[StartOutcome]) -> SearchResult:
    """Rank the outcomes of starts, in the order of the starts, until there are enough."""
    started = time.perf_counter()
    attempts: list[StartAttempt] = []
    candidates: list[Candidate] = []
    best: StartOutcome | None = None
    failures = 0
    # Workers on other starts are stopped when there are enough.
    with closing(outcomes):
        for outcome in outcomes:
            attempts.append(_attempt(search, outcome))
            failures += outcome.status not in (SearchStatus.NO_GUESS, SearchStatus.FOUND)
            if outcome.candidate is None:
                best = outcome if best is None else max(best, outcome, key=_merit)
            else:
                candidates = _joined(search, candidates, outcome.candidate)
                if outcome.candidate.score <= min(one.score for one in candidates):
                    best = outcome
            if _enough(search, candidates, len(attempts)):
                break
            if not candidates and failures >= _enough_failures(search):
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
        undecided=best.undecided,
        repels=best.repels,
        scan="" if ranked or len(attempts) == 1 else _summary(search),
    )


def _summary(search: SearchProblem) -> str:
    """Return what motions settle to all over the box."""
    from zeno_orbits.search.scan import scan_summary

    return scan_summary(search)


_AGREE = 2
"""Starts that lead to the same optimum before it is believed."""
_MOST_TRIED = 4
"""Starts that are compared if no two agree on the best optimum."""


def _enough(search: SearchProblem, candidates: Sequence[Candidate], n_tried: int) -> bool:
    """Return True if there are as many orbits as asked, and starts agree on the best optimum."""
    if not candidates or len(candidates) < search.settings.candidates:
        return False
    best = min(candidates, key=lambda one: one.score)
    if not search.seeks_optimum or best.score <= search.objective.least:
        return True
    return best.starts >= _AGREE or n_tried >= _MOST_TRIED


def _attempt(search: SearchProblem, outcome: StartOutcome) -> StartAttempt:
    values = search.values.replaced(outcome.start)
    free = {name: values.parameters[name] for name in search.free if name in values.parameters}
    return StartAttempt(
        gains=values.gains, parameters=free, status=outcome.status, detail=outcome.detail
    )


def _joined(
    search: SearchProblem, candidates: Sequence[Candidate], found: Candidate
) -> list[Candidate]:
    """Return the candidates with another one, or with one more start that led to one of them."""
    for k, one in enumerate(candidates):
        if _same(search, found, one):
            better = min(one, found, key=lambda either: either.score)
            both = replace(better, starts=one.starts + found.starts)
            return [*candidates[:k], both, *candidates[k + 1 :]]
    return [*candidates, found]


def _same(search: SearchProblem, one: Candidate, other: Candidate) -> bool:
    """Return True if two candidates are the same orbit at the same numbers.

    The numbers of an optimum are told less exactly than its score: that is flat there.
    """
    if one.orbit.shape != other.orbit.shape:
        return False
    a, b = one.orbit.values(search.problem), other.orbit.values(search.problem)
    pairs = [(a.number(name), b.number(name)) for name in search.free]
    pairs.append((one.orbit.period, other.orbit.period))
    close = _SAME
    if search.seeks_optimum:
        close = _SAME_OPTIMUM
        pairs.append((one.score, other.score))
    return all(abs(p - q) <= close * max(abs(p), abs(q)) for p, q in pairs)


def _enough_failures(search: SearchProblem) -> int:
    """Return how many starts with a good guess may fail before a search gives up.

    A target or a bound is approached in small steps from every start, which takes long and ends at
    much the same place.
    """
    slow = isinstance(search.objective, Target) or search.bounds
    return 2 if slow else 5


_FARTHEST_LAST = (
    SearchStatus.NO_GUESS,
    SearchStatus.NOT_SOLVED,
    SearchStatus.NOT_FOLLOWED,
    SearchStatus.NOT_ACCEPTED,
    SearchStatus.FOUND,
)


def _merit(outcome: StartOutcome) -> tuple[int, float]:
    return _FARTHEST_LAST.index(outcome.status), -outcome.shortfall
