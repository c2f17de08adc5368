"""Find orbits from a sequence of starts, until enough orbits are accepted, and rank them."""

from __future__ import annotations

import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, ZenoOrbitsError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import (
    Bound,
    EventReturn,
    EventSequence,
    Orbit,
    asked_and_reached,
    orbit_event_name,
)
from zeno_orbits.search.closing.closing import return_near
from zeno_orbits.search.objectives import NearestGains, Objective, TargetPeriod
from zeno_orbits.search.outcome import (
    Candidate,
    SearchResult,
    StartAttempt,
    StartOutcome,
)
from zeno_orbits.search.search_problem import Accept, SearchProblem, with_defaults
from zeno_orbits.search.settings import SearchMethod, SearchSettings, SearchStatus
from zeno_orbits.search.starts.multistart import StartWorkers, outcomes
from zeno_orbits.search.starts.ranking import SAME, SAME_OPTIMUM, SAME_STATE, are_close
from zeno_orbits.search.validation import check_search
from zeno_orbits.simulation import state_before
from zeno_orbits.work import Progress, silent


def orbit_at_gains(
    problem: Problem,
    values: ParameterValues,
    *,
    settings: SearchSettings | None = None,
    shape: EventSequence | None = None,
) -> SearchResult:
    """Find the orbit at given gains, by a program with as many conditions as unknowns.

    Args:
        problem: The problem.
        values: Values of its gains and parameters, the only start.
        settings: Limits and tolerances.
        shape: The shape of the orbit. The default is the shape of the simulated attractor.
    """
    settings = replace(settings or SearchSettings(), n_starts=0)
    return search_orbits(problem, values, free={}, settings=settings, shape=shape)


def search_orbits(
    problem: Problem,
    values: ParameterValues,
    *,
    free: Mapping[str, tuple[float, float]],
    objective: Objective | None = None,
    bounds: Sequence[Bound] = (),
    near: Orbit | None = None,
    settings: SearchSettings | None = None,
    accept: Accept | None = None,
    on_progress: Progress = silent,
    spread: StartWorkers | None = None,
    shape: EventSequence | None = None,
    section: str | None = None,
    method: SearchMethod = SearchMethod.AUTO,
    initial_states: Sequence[Mapping[str, float]] = (),
) -> SearchResult:
    """Find gains, parameters and initial states of an orbit, from a sequence of starts.

    Args:
        problem: The problem.
        values: Values of its gains and parameters: the first start. Later starts are points of the
            box, the most promising in a scan of short simulations first. A search for an optimum
            starts at the scanned points immediately.
        free: Name to bounds of the gains and parameters to be found. Empty for fixed values. A
            value that the problem derives from a free parameter keeps its value in ``values``.
        objective: The objective. The default keeps free values near their start.
        bounds: Bounds that the orbit must satisfy, for every objective.
        near: A known orbit of the problem to start from, at these values or near them.
        settings: Limits, tolerances and the number of orbits to rank.
        accept: Check of the orbits. By default all orbits are accepted.
        on_progress: Receives progress reports.
        spread: Workers for the starts after the first. By default all starts run in this process.
            The result is bitwise identical for any number of workers, except for times, since
            starts count in their order. With a checkpoint, ``accept`` must be a function of a
            module, or a frozen dataclass with ``__call__``.
        shape: The shape of the orbits. The default is the shape of ``near``, or of the simulated
            attractor.
        section: Name of the event at which the period starts and ends. The default is chosen.
        method: How an optimum is found.
        initial_states: Initial states of the simulations that find orbits, name to value. The
            default is the problem's initial states.

    Returns:
        The accepted orbits, the best first, or the reason of a failure.

    Raises:
        InputError: If a name is unknown, a lower bound exceeds its upper bound, the objective or a
            bound is about an event that no orbit has, or the executor or the checkpoint of
            ``spread`` is not usable.
        WorkError: If the workers of ``spread`` cannot finish.
    """
    search = SearchProblem(
        problem=problem,
        values=values,
        free=free,
        objective=objective or NearestGains(target={}),
        bounds=tuple(bounds),
        near=near,
        shape=shape,
        section=section,
        method=method,
        accept=accept,
        initial_states=tuple(initial_states),
        settings=settings or SearchSettings(),
        on_progress=on_progress,
    )
    check_search(search)
    search = with_defaults(search)
    _require_reach(search)
    return _ranked(search, outcomes(search, spread))


def _require_reach(search: SearchProblem) -> None:
    """Refuse a target that no orbit comes near to."""
    if isinstance(search.objective, TargetPeriod) and search.free:
        from zeno_orbits.search.starts.scan import require_period_in_reach

        require_period_in_reach(search, search.objective)


def _ranked(search: SearchProblem, outcomes: Generator[StartOutcome]) -> SearchResult:
    """Rank the outcomes of starts, in the order of the starts, until enough orbits are found."""
    started = time.perf_counter()
    attempts: list[StartAttempt] = []
    candidates: list[Candidate] = []
    best: StartOutcome | None = None
    failures = n_orbits = 0
    # Closing the generator stops the workers on other starts.
    with closing(outcomes):
        for outcome in outcomes:
            attempts.append(_attempt(search, outcome))
            n_orbits += 0 if outcome.result is None else outcome.result.n_orbits
            failures += not (outcome.status.lacks_motion or outcome.status is SearchStatus.FOUND)
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
            if len(attempts) >= _TRIED and not candidates and _only_contact(search, attempts):
                break
    n_states = 0
    if candidates and (search.settings.candidates > 1 or search.seeks_optimum):
        candidates, n_states, best = _with_coexisting(search, candidates, best)
    if best is None:
        raise InputError("Argument `settings` must allow a start.")
    ranked = tuple(sorted(candidates, key=lambda one: one.score))
    begun = best.result or SearchResult(status=best.status, orbit=None)
    return replace(
        begun,
        status=best.status,
        **_of_best(search, ranked[0]) if ranked else {},
        objective=search.objective,
        n_orbits=n_orbits,
        residuals=best.residuals,
        agreement=best.agreement,
        closure_error=best.closure_error,
        n_unknowns=best.n_unknowns,
        iterations=best.iterations,
        solve_time=best.solve_time,
        wall_time=time.perf_counter() - started,
        attempts=tuple(attempts),
        candidates=ranked,
        n_states=n_states,
        detail=best.detail,
        undecided=best.undecided,
        repels=best.repels,
        scan="" if ranked or len(attempts) == 1 else _summary(search),
    )


def _of_best(search: SearchProblem, best: Candidate) -> dict[str, Any]:
    """Return the fields of a result that describe its best orbit."""
    values = best.orbit.values(search.problem)
    return {
        "orbit": best.orbit,
        "certificate": best.certificate,
        "free": {name: values.number(name) for name in search.free},
        "asked": tuple(asked_and_reached(search.bounds, best.extents)),
    }


def _with_coexisting(
    search: SearchProblem,
    candidates: list[Candidate],
    outcome: StartOutcome | None,
) -> tuple[list[Candidate], int, StartOutcome | None]:
    """Add candidates from other attractors, at the values of the best candidate.

    Returns:
        The candidates, the number of initial states, and the outcome with the best candidate.
    """
    from zeno_orbits.search.starts.coexisting import N_STATES, coexisting_orbits
    from zeno_orbits.search.starts.start import try_orbit

    best = min(candidates, key=lambda one: one.score).orbit
    search.tell("looking for other attractors from other initial states")
    for found in coexisting_orbits(search, best):
        if any(_has_last_event(search, one.orbit, found) for one in candidates):
            continue
        other = try_orbit(search, best.values(search.problem), found)
        if other.candidate is not None:
            if other.candidate.score < min(one.score for one in candidates):
                outcome = other
            candidates = _joined(search, candidates, other.candidate)
    return candidates, N_STATES, outcome


def _has_last_event(search: SearchProblem, orbit: Orbit, found: EventReturn) -> bool:
    last = found.events[-1]
    return _has_event(search, orbit, orbit_event_name(last), np.asarray(state_before(last)))


def _has_event(search: SearchProblem, orbit: Orbit, name: str, state: Vector) -> bool:
    """Return True if an orbit has an event of a name at a state just before it, ``(n_x,)``."""
    problem = search.problem
    events = [(one.name, np.array(problem.state_vector(one.state))) for one in orbit.events]
    largest = np.max(np.abs(np.array([at for _, at in events])), axis=0)
    graph = problem.graph_dynamics(orbit.values(problem))
    sizes = graph.own.not_small(largest, SAME_STATE)
    return any(
        other == name and bool(np.all(np.abs(at - state) <= SAME_STATE * sizes))
        for other, at in events
    )


def _only_contact(search: SearchProblem, attempts: Sequence[StartAttempt]) -> bool:
    """Return True if no start led to an orbit and every point of the scan stays in contact."""
    if not search.free or not all(one.status.lacks_motion for one in attempts):
        return False
    from zeno_orbits.search.starts.scan import stays_in_contact

    return stays_in_contact(search)


def _summary(search: SearchProblem) -> str:
    """Return the attractors all over the box, as a sentence."""
    from zeno_orbits.search.starts.scan import scan_summary

    return scan_summary(search)


_TRIED = 2
"""Starts that are made even if every point of the scan stays in contact: the given values, by
simulation and by continuation."""
_AGREE = 2
"""Number of starts that must lead to the same optimum."""
_MOST_TRIED = 4
"""Largest number of starts if no two of them agree on the best optimum."""


def _enough(search: SearchProblem, candidates: Sequence[Candidate], n_tried: int) -> bool:
    """Return True if enough orbits are found, and starts agree on the best optimum."""
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
    """Return the candidates with a new orbit, or count a further start for a known candidate."""
    for k, one in enumerate(candidates):
        if _same(search, found, one):
            better = min(one, found, key=lambda either: either.score)
            both = replace(better, starts=one.starts + found.starts)
            return [*candidates[:k], both, *candidates[k + 1 :]]
    return [*candidates, found]


def _same(search: SearchProblem, one: Candidate, other: Candidate) -> bool:
    """Return True if two candidates are the same orbit at the same values.

    The values of an optimum are less accurate than its score, as the score is flat there.
    Attractors may coexist at the same values with the same period and score, so the first orbit is
    followed to the values of the other one.
    """
    problem, last = search.problem, one.orbit.events[-1]
    at_once = _has_event(search, other.orbit, last.name, np.array(problem.state_vector(last.state)))
    if not search.free:
        return at_once
    a, b = one.orbit.values(problem), other.orbit.values(problem)
    pairs = [(a.number(name), b.number(name)) for name in search.free]
    pairs.append((one.orbit.period, other.orbit.period))
    close = SAME
    if search.seeks_optimum:
        close = SAME_OPTIMUM
        pairs.append((one.score, other.score))
    if sorted(one.orbit.sequence) != sorted(other.orbit.sequence) or not are_close(pairs, close):
        return False
    if at_once:
        return True
    try:
        there = return_near(problem, b, one.orbit, simulation=search.settings.simulation)
    except ZenoOrbitsError:
        return one.orbit.sequence == other.orbit.sequence
    return _has_last_event(search, other.orbit, there)


def _enough_failures(search: SearchProblem) -> int:
    """Return the number of starts with a good guess that may fail before a search stops.

    A target or a bound is approached in small steps from every start. This takes long, and most
    starts end near the same point.
    """
    slow = search.objective.prescribes or search.bounds
    return 2 if slow else 5


_FARTHEST_LAST = (
    SearchStatus.NO_EVENTS,
    SearchStatus.NO_GUESS,
    SearchStatus.NOT_SOLVED,
    SearchStatus.NOT_FOLLOWED,
    SearchStatus.NOT_ACCEPTED,
    SearchStatus.FOUND,
)


def _merit(outcome: StartOutcome) -> tuple[int, float]:
    return _FARTHEST_LAST.index(outcome.status), -outcome.shortfall
