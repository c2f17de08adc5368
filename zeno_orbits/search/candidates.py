"""Several orbits of events: starts over free values and initial states, ranked.

Every start leads to one result. Then motions start from states all over a box around the best
orbit, at its values, and every other attractor is a further start.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import EventReturn, Orbit, orbit_event_name
from zeno_orbits.search.closing import return_near
from zeno_orbits.search.gains import GainSearch
from zeno_orbits.search.outcome import (
    Accept,
    EventCandidate,
    EventSearchResult,
    StartAttempt,
    Verdict,
)
from zeno_orbits.search.ranking import SAME, SAME_OPTIMUM, SAME_STATE, are_close
from zeno_orbits.search.settings import SearchStatus
from zeno_orbits.simulation import SimulationSettings, state_before
from zeno_orbits.work import Progress, silent


def judged(result: EventSearchResult, accept: Accept | None) -> EventSearchResult:
    """Return a result with the certificate of its orbit, if there is a check.

    Args:
        result: The result.
        accept: The check, or ``None``.
    """
    return _judged(result, accept)[0]


def _judged(result: EventSearchResult, accept: Accept | None) -> tuple[EventSearchResult, Verdict]:
    """Return a result with the certificate of its orbit, and the judgement."""
    if result.orbit is None or accept is None:
        return result, Verdict()
    judgement = accept(result.orbit)
    certificate = judgement.certificate
    if certificate is not None:
        certificate = replace(certificate, asked=result.asked)
    return replace(result, certificate=certificate), judgement


def ranked_candidates(
    problem: Problem,
    search: GainSearch,
    places: Sequence[ParameterValues],
    *,
    start: Mapping[str, float] | None,
    free: tuple[str, ...],
    n_wanted: int,
    accept: Accept | None,
    until: float | None,
    seed: int,
    simulation: SimulationSettings,
    on_progress: Progress = silent,
) -> EventSearchResult:
    """Return the best of several orbits, with the others as its candidates.

    Args:
        problem: The problem.
        search: The search from one start.
        places: Values at which the search starts, in order, until enough orbits are accepted.
        start: State name to initial value, by default each start of the problem in turn.
        free: Names of the free values.
        n_wanted: Number of different orbits.
        accept: Check of the orbits. By default all orbits are accepted.
        until: Longest time to settle [s].
        seed: Seed of the initial states.
        simulation: Accuracy.
        on_progress: Called with the stage.

    Raises:
        ZenoOrbitsError: If no start leads to an orbit, the reason of the last start.
    """
    # Most searches need no scan of states.
    from zeno_orbits.search.coexisting import N_STATES, coexisting_attractors

    ranking = _Ranking(problem, search, free, accept, simulation)
    for place in places:
        ranking.add(place, start)
        if len(ranking.found) >= n_wanted:
            break
    n_states = 0
    if ranking.found:
        best = ranking.best.orbit
        values = best.values(problem)
        on_progress("looking for other attractors from other initial states", None)
        attractors = coexisting_attractors(
            problem, values, problem.graph_dynamics(values), best, until=until, seed=seed
        )
        n_states = N_STATES
        for one in attractors:
            ranking.add_attractor(values, one.state)
    return replace(ranking.result(), n_states=n_states)


class _Ranking:
    """The results of starts, and the different orbits among them."""

    def __init__(
        self,
        problem: Problem,
        search: GainSearch,
        free: tuple[str, ...],
        accept: Accept | None,
        simulation: SimulationSettings,
    ) -> None:
        self._problem, self._search, self._free = problem, search, free
        self._accept, self._simulation = accept, simulation
        self._first: EventSearchResult | None = None
        self._trouble: ZenoOrbitsError | None = None
        self._attempts: list[StartAttempt] = []
        self._n_orbits = 0
        self.found: list[tuple[EventSearchResult, EventCandidate]] = []

    @property
    def best(self) -> EventCandidate:
        """The accepted orbit of the lowest score."""
        return min((one for _, one in self.found), key=lambda one: one.score)

    def add(self, place: ParameterValues, start: Mapping[str, float] | None) -> None:
        """Search from a start, and rank its orbit.

        Args:
            place: Values of the start.
            start: Its initial state, by default each start of the problem in turn.
        """
        status, detail = SearchStatus.NO_GUESS, ""
        try:
            result = self._search.best(self._search.returned(place, start), place).result
        except ZenoOrbitsError as error:
            self._trouble, detail = error, str(error)
        else:
            status, detail = self._joined(result)
        free = {name: place.parameters[name] for name in self._free if name in place.parameters}
        self._attempts.append(
            StartAttempt(gains=place.gains, parameters=free, status=status, detail=detail)
        )

    def add_attractor(self, values: ParameterValues, state: Mapping[str, float]) -> None:
        """Search from an attractor, and rank its orbit, unless it is a known one.

        Args:
            values: The values of the attractor.
            state: A state on it.
        """
        try:
            found = self._search.returned(values, state)
            known = [one.orbit for _, one in self.found]
            if not any(
                orbit.values(self._problem) == values
                and has_last_event(self._problem, orbit, found)
                for orbit in known
            ):
                self._joined(self._search.best(found, values).result)
        except ZenoOrbitsError:
            # The approximate attractor of a short simulation may be none.
            return

    def result(self) -> EventSearchResult:
        """Return the best result with all candidates.

        Raises:
            ZenoOrbitsError: If no start leads to an orbit.
        """
        if self._first is None:
            if self._trouble is None:
                raise ValueError("Argument `places` must have a start.")
            raise self._trouble
        ranked = sorted(self.found, key=lambda pair: pair[1].score)
        best = ranked[0][0] if ranked else self._first
        candidates = tuple(one for _, one in ranked)
        return replace(
            best,
            candidates=candidates,
            attempts=tuple(self._attempts),
            n_orbits=self._n_orbits,
        )

    def _joined(self, result: EventSearchResult) -> tuple[SearchStatus, str]:
        """Add the orbit of a result, if it is accepted, and return its status and the reason."""
        self._n_orbits += result.n_orbits
        result, judgement = _judged(result, self._accept)
        if self._first is None:
            self._first = result
        if result.orbit is None:
            return SearchStatus.NOT_SOLVED, result.detail
        if judgement.objection:
            return SearchStatus.NOT_ACCEPTED, judgement.objection
        new = EventCandidate(orbit=result.orbit, score=result.score, certificate=result.certificate)
        for k, (known, one) in enumerate(self.found):
            if self._is_same(result, new, one):
                better = (result, new) if new.score < one.score else (known, one)
                both = replace(better[1], starts=one.starts + 1)
                self.found[k] = better[0], both
                break
        else:
            self.found.append((result, new))
        return SearchStatus.FOUND, result.detail

    def _is_same(
        self, result: EventSearchResult, one: EventCandidate, other: EventCandidate
    ) -> bool:
        """Return True if two candidates are one orbit, at nearly the same values.

        Attractors may coexist at the same values with the same period and score. So the first orbit
        is followed to the values of the other one.
        """
        a, b = one.orbit.values(self._problem), other.orbit.values(self._problem)
        pairs = [(a.number(name), b.number(name)) for name in self._free]
        pairs.append((one.orbit.period, other.orbit.period))
        close = SAME
        if self._free and result.is_measured:
            close = SAME_OPTIMUM
            pairs.append((one.score, other.score))
        if not are_close(pairs, close):
            return False
        try:
            there = return_near(self._problem, b, one.orbit, simulation=self._simulation)
        except ZenoOrbitsError:
            return False
        return has_last_event(self._problem, other.orbit, there)


def has_last_event(problem: Problem, orbit: Orbit, found: EventReturn) -> bool:
    """Return True if an orbit has the last event of a return.

    Args:
        problem: The problem.
        orbit: The orbit.
        found: The return.
    """
    events = [(one.name, np.array(problem.state_vector(one.state))) for one in orbit.events]
    graph = problem.graph_dynamics(orbit.values(problem))
    largest = np.max(np.abs(np.array([state for _, state in events])), axis=0)
    sizes = graph.own.not_small(largest, SAME_STATE)
    last, state = found.events[-1], np.asarray(state_before(found.events[-1]))
    return any(
        name == orbit_event_name(last) and bool(np.all(np.abs(other - state) <= SAME_STATE * sizes))
        for name, other in events
    )
