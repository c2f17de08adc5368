"""One start of a search from beginning to end: its numbers, its outcome, measured and judged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from zeno_orbits.errors import InputError, ZenoOrbitsError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import Bound, ZenoOrbit, objection_to
from zeno_orbits.search.number_notes import far_from_own
from zeno_orbits.search.objectives import NearestGains
from zeno_orbits.search.outcome import Accept, Candidate, Judgement, StartOutcome
from zeno_orbits.search.search_problem import SearchProblem, clipped, listed
from zeno_orbits.search.settings import SearchStatus
from zeno_orbits.search.strategy import SearchStart, beside, from_start
from zeno_orbits.simulation import Extent
from zeno_orbits.verification import measure


def start_count(search: SearchProblem) -> int:
    """Return how many starts a search has."""
    return 1 + (search.settings.n_starts if search.free else 0)


def scanned(search: SearchProblem, number: int) -> SearchProblem:
    """Return the search with the order of its starts, if that is needed for one of them.

    Args:
        search: The search.
        number: The start. The first one of a search for what is near is at the given numbers.
    """
    if search.order is not None or not (number > 0 or search.seeks_optimum):
        return search
    # Most searches end at their first start, sooner than what follows many motions is imported.
    from zeno_orbits.search.scan import start_order

    search.tell("looking at places all over the box")
    return replace(search, order=start_order(search))


def numbered_start(search: SearchProblem, number: int) -> SearchStart:
    """Return a start: a pure function of its arguments, whatever has been tried before.

    Args:
        search: The search; all but the first start of one for what is near need its order.
        number: Which start it is, from 0.
    """
    place = number if search.order is None else search.order[number]
    if place > 0:
        from zeno_orbits.search.scan import start_place

        return SearchStart(values=start_place(search, place))
    values = clipped(search.values, search.free)
    again = search.order is not None and search.order.index(0) < number
    # The long way, for where nothing else leads to an orbit.
    easy = _easy_values(search.problem, values) if again or start_count(search) == 1 else ()
    near = None if again else search.near
    return SearchStart(values=values, near=near, easy=easy, known_empty=again)


def try_start(search: SearchProblem, number: int, accept: Accept | None) -> StartOutcome:
    """Search from one start and judge the orbit that it finds.

    Args:
        search: The search.
        number: Which start it is, as for `numbered_start`.
        accept: The check of orbits; any orbit is accepted by default.
    """
    start = numbered_start(search, number)
    name = f"start {number + 1}"
    search.tell(f"{name}: simulating {listed(search.numbers(start.values))}")
    outcome, judgement = _judged(search, from_start(search, start), accept, name)
    if judgement is not None and judgement.repels and search.free:
        outcome = _attracting(search, start, accept, name, outcome, judgement)
    numbers = {name: start.values.number(name) for name in search.free}
    return replace(outcome, solution=None, start=numbers)


def _judged(
    search: SearchProblem, outcome: StartOutcome, accept: Accept | None, name: str
) -> tuple[StartOutcome, Judgement | None]:
    """Measure the orbit of a start on a simulation, if there is one, and accept or refuse it."""
    orbit = None if outcome.solution is None else outcome.solution.orbit
    if outcome.status is not SearchStatus.FOUND or orbit is None:
        return outcome, None
    try:
        extents = _measured(search, orbit, name)
    except ZenoOrbitsError as error:
        return replace(outcome, status=SearchStatus.NOT_ACCEPTED, detail=str(error)), None
    judgement = Judgement(objection=objection_to(search.bounds, extents))
    if not judgement.objection and accept is not None:
        search.tell(f"{name}: verifying")
        judgement = accept(orbit)
    if judgement.objection:
        refused = replace(
            outcome,
            status=SearchStatus.NOT_ACCEPTED,
            detail=judgement.objection,
            repels=judgement.repels,
        )
        return refused, judgement
    score = search.score(orbit.values(search.problem), extents)
    certificate = judgement.certificate
    candidate = Candidate(orbit=orbit, score=score, extents=extents, certificate=certificate)
    return replace(outcome, candidate=candidate), judgement


_ATTRACTS = 0.99
"""Spectral radius that is asked for where the best orbit of all does not attract."""

_AT_LIMIT = 0.01
"""Distance of a multiplier from 1 or -1 at which an orbit is on a fold or a period doubling."""


def _attracting(
    search: SearchProblem,
    start: SearchStart,
    accept: Accept | None,
    name: str,
    refused: StartOutcome,
    judgement: Judgement,
) -> StartOutcome:
    """Search for the best orbit that attracts, where the best one of all does not.

    Args:
        search: The search.
        start: The start.
        accept: The check of orbits.
        name: The start in words.
        refused: Outcome of the search without regard to stability.
        judgement: The refusal of its orbit.
    """
    if refused.solution is None or any(one.name == "spectral_radius" for one in search.bounds):
        return refused
    where = listed(search.numbers(refused.solution.values))
    search.tell(f"{name}: looking for an orbit that attracts")
    bound = Bound(name="spectral_radius", upper=_ATTRACTS)
    bounded = replace(search, bounds=(*search.bounds, bound))
    try:
        # It is most often near.
        outcome, _ = _judged(bounded, beside(bounded, start, refused.solution), accept, name)
        if outcome.candidate is None:
            outcome, _ = _judged(bounded, from_start(bounded, start), accept, name)
    except InputError:
        # Only a few multipliers can be bounded.
        return refused
    limit = "does not attract"
    multipliers = () if judgement.certificate is None else judgement.certificate.multipliers
    for value, word in ((1.0, "a fold of the family"), (-1.0, "a period doubling")):
        if any(abs(multiplier - value) < _AT_LIMIT for multiplier in multipliers):
            limit = f"lies on {word}, where orbits cease to attract"
    the_best = f"The best orbit, at {where}, {limit}"
    if outcome.candidate is not None:
        detail = f"{the_best}; this is the best one with a spectral radius up to {_ATTRACTS:g}."
        return replace(outcome, detail=detail)
    if isinstance(search.objective, NearestGains):
        outcome = _on_the_way(search, start, accept, name, refused.solution.values)
    if outcome.candidate is None:
        return refused
    return replace(outcome, detail=f"{the_best}; this one, on the way to it, does.")


_PARTS = (0.95, 0.8, 0.5, 0.2, 0.0)
"""Places on the way to an orbit that does not attract, from the start, at which others may."""


def _on_the_way(
    search: SearchProblem,
    start: SearchStart,
    accept: Accept | None,
    name: str,
    place: ParameterValues,
) -> StartOutcome:
    """Search at given numbers between a start and a place; nearness is a wish, an orbit the point.

    Args:
        search: The search.
        start: The start.
        accept: The check of orbits.
        name: The start in words.
        place: Where the nearest orbit of all is.
    """
    held = replace(search, free={})
    outcome = StartOutcome(status=SearchStatus.NO_GUESS)
    for part in _PARTS:
        numbers = {
            free: (1.0 - part) * start.values.number(free) + part * place.number(free)
            for free in search.free
        }
        there = SearchStart(values=start.values.replaced(numbers))
        outcome, _ = _judged(search, from_start(held, there), accept, name)
        if outcome.candidate is not None:
            break
    return outcome


def _measured(search: SearchProblem, orbit: ZenoOrbit, name: str) -> Mapping[str, Extent]:
    names = [bound.name for bound in search.bounds]
    if search.free:
        names = [*search.objective.quantities, *names]
    if not names:
        return {}
    search.tell(f"{name}: measuring {', '.join(dict.fromkeys(names))}")
    return measure(orbit, search.problem, names)


def _easy_values(problem: Problem, values: ParameterValues) -> tuple[ParameterValues, ...]:
    """Return easier numbers: the problem's own gains, half the restitution, or both.

    All of the problem's own numbers are another, unless one is so far off that no path leads there.
    """
    gains = {gain.name: gain.default for gain in problem.gains if gain.default is not None}
    own = values.replaced(gains)
    dull = {"restitution": values.parameters["restitution"] / 2}
    found = [own, values.replaced(dull), own.replaced(dull)]
    if not far_from_own(problem, values):
        found.append(problem.values())
    return tuple(one for k, one in enumerate(found) if one != values and one not in found[:k])
