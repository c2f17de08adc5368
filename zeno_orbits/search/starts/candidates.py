"""Several orbits of events: starts over free values and initial states, ranked.

Every start leads to one result. Then motions start from states all over a box around the best
orbit, at its values, and every other attractor is a further start.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from zeno_orbits.errors import InputError, SimulationError, ZenoOrbitsError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import EventReturn, Orbit, orbit_event_name
from zeno_orbits.search.closing.closing import return_near
from zeno_orbits.search.objectives import NearestGains, Objective
from zeno_orbits.search.optimum.gains import BestOrbit, GainSearch
from zeno_orbits.search.outcome import (
    Accept,
    Candidate,
    SearchResult,
    StartAttempt,
)
from zeno_orbits.search.settings import SearchStatus
from zeno_orbits.search.starts.ranking import SAME, SAME_OPTIMUM, SAME_STATE, are_close
from zeno_orbits.simulation import Extent, state_before
from zeno_orbits.work import from_plain, to_plain


@dataclass(frozen=True, slots=True, kw_only=True)
class StartEnd:
    """The end of a search from one start.

    Attributes:
        result: The result, ``None`` if no orbit was found to search from.
        extents: Name to range of the measured quantities of objective and bounds.
        objection: Reason why the check refuses its orbit. Empty if it does not.
        error: Why the result is missing.
    """

    result: SearchResult | None = None
    extents: Mapping[str, Extent] = field(default_factory=dict[str, Extent])
    objection: str = ""
    error: ZenoOrbitsError | None = None

    def as_plain(self) -> dict[str, Any]:
        """Return the end as plain data, without the objective."""
        result, error = self.result, self.error
        told = None
        if error is not None:
            told = {
                "invalid": isinstance(error, InputError),
                "reason": getattr(error, "reason", str(error)),
                "time": float(getattr(error, "time", 0.0)),
                "state": list(getattr(error, "state", ())),
            }
        wished = result and replace(result, objective=NearestGains(target={}))
        return {
            "result": to_plain(wished),
            "extents": to_plain(self.extents),
            "objection": self.objection,
            "error": to_plain(told),
        }

    def candidate(self) -> Candidate | None:
        """Return the orbit with its rank, if there is one and the check accepts it."""
        result = self.result
        if result is None or result.orbit is None or self.objection:
            return None
        return Candidate(
            orbit=result.orbit,
            score=result.score,
            extents=self.extents,
            certificate=result.certificate,
        )

    def attempt(self, place: ParameterValues, free: Iterable[str]) -> StartAttempt:
        """Return the start for the user.

        Args:
            place: Values of the start.
            free: Names of the free values.
        """
        status, detail = SearchStatus.NO_GUESS, str(self.error or "")
        if self.result is not None:
            status, detail = self.result.status, self.objection or self.result.detail
        parameters = {name: place.parameters[name] for name in free if name in place.parameters}
        return StartAttempt(gains=place.gains, parameters=parameters, status=status, detail=detail)

    @classmethod
    def from_plain(cls, data: Mapping[str, Any], objective: Objective) -> StartEnd:
        """Return the end of plain data.

        Args:
            data: The data.
            objective: The objective of the search.
        """
        told = data["error"]
        if told is not None and told["invalid"]:
            return cls(error=InputError(told["reason"]))
        if told is not None:
            state = tuple(map(float, told["state"]))
            return cls(error=SimulationError(told["reason"], time=float(told["time"]), state=state))
        result = replace(from_plain(SearchResult, data["result"]), objective=objective)
        extents = from_plain(Mapping[str, Extent], data["extents"])
        return cls(result=result, extents=extents, objection=data["objection"])


def end_of_start(
    search: GainSearch, place: ParameterValues, start: Mapping[str, float] | None
) -> StartEnd:
    """Return the end of a search from one start, with the verdict on its orbit.

    Args:
        search: The search.
        place: Values of the start.
        start: Its initial state, by default each start of the problem in turn.
    """
    try:
        best = search.best(search.returned(place, start), place)
    except ZenoOrbitsError as error:
        return StartEnd(error=error)
    return _judged(best, search.accept)


def _judged(best: BestOrbit, accept: Accept | None) -> StartEnd:
    """Return a result with the certificate of its orbit, if there is a check."""
    result = best.result
    if result.orbit is None or accept is None:
        return StartEnd(result=result, extents=best.extents)
    judgement = accept(result.orbit)
    certificate = judgement.certificate
    if certificate is not None:
        certificate = replace(certificate, asked=result.asked)
    result = replace(
        result,
        status=SearchStatus.NOT_ACCEPTED if judgement.objection else result.status,
        certificate=certificate,
        repels=judgement.repels,
    )
    return StartEnd(result=result, extents=best.extents, objection=judgement.objection)


def ranked_candidates(
    search: GainSearch,
    places: Sequence[ParameterValues],
    ends: Iterable[StartEnd],
    *,
    n_wanted: int,
    seed: int,
) -> SearchResult:
    """Return the best of several orbits, with the others as its candidates.

    Args:
        search: The search from one start.
        places: Values at which the search starts.
        ends: The ends of these starts in order, until enough orbits are accepted.
        n_wanted: Number of different orbits.
        seed: Seed of the initial states.

    Raises:
        ZenoOrbitsError: If no start leads to an orbit, the reason of the last start.
    """
    # Most searches need no scan of states.
    from zeno_orbits.search.starts.coexisting import N_STATES, coexisting_attractors

    ranking, problem = _Ranking(search), search.problem
    for place, end in zip(places, ends, strict=False):
        ranking.add(place, end)
        if len(ranking.found) >= n_wanted:
            break
    n_states = 0
    if ranking.found:
        best = ranking.best.orbit
        values = best.values(problem)
        search.on_progress("looking for other attractors from other initial states", None)
        attractors = coexisting_attractors(
            problem, values, problem.graph_dynamics(values), best, until=search.until, seed=seed
        )
        n_states = N_STATES
        for one in attractors:
            ranking.add_attractor(values, one.state)
    return replace(ranking.result(), n_states=n_states)


class _Ranking:
    """The results of starts, and the different orbits among them."""

    def __init__(self, search: GainSearch) -> None:
        self._search, self._problem, self._free = search, search.problem, tuple(search.free)
        self._first: SearchResult | None = None
        self._trouble: ZenoOrbitsError | None = None
        self._attempts: list[StartAttempt] = []
        self._n_orbits = 0
        self.found: list[tuple[SearchResult, Candidate]] = []

    @property
    def best(self) -> Candidate:
        """The accepted orbit of the lowest score."""
        return min((one for _, one in self.found), key=lambda one: one.score)

    def add(self, place: ParameterValues, end: StartEnd) -> None:
        """Rank the orbit of a start.

        Args:
            place: Values of the start.
            end: Its end.
        """
        if end.result is None:
            self._trouble = end.error
        else:
            self._join(end.result, end.candidate())
        self._attempts.append(end.attempt(place, self._free))

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
                end = _judged(self._search.best(found, values), self._search.accept)
                if end.result is not None:
                    self._join(end.result, end.candidate())
        except ZenoOrbitsError:
            # The approximate attractor of a short simulation may be none.
            return

    def result(self) -> SearchResult:
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

    def _join(self, result: SearchResult, new: Candidate | None) -> None:
        """Add the orbit of a result, if it is accepted."""
        self._n_orbits += result.n_orbits
        if self._first is None:
            self._first = result
        if new is None:
            return
        for k, (known, one) in enumerate(self.found):
            if self._is_same(result, new, one):
                better = (result, new) if new.score < one.score else (known, one)
                both = replace(better[1], starts=one.starts + 1)
                self.found[k] = better[0], both
                break
        else:
            self.found.append((result, new))

    def _is_same(self, result: SearchResult, one: Candidate, other: Candidate) -> bool:
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
            there = return_near(self._problem, b, one.orbit, simulation=self._search.simulation)
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
