"""One start of a search: its values, its outcome, measurement and acceptance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from zeno_orbits.errors import InputError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import Bound, EventReturn, Orbit, objection_to
from zeno_orbits.search.closing.closing import event_orbit_of
from zeno_orbits.search.number_notes import far_from_own
from zeno_orbits.search.objectives import MaxPush, NearestGains
from zeno_orbits.search.optimum.strength import orbits_at_corners
from zeno_orbits.search.outcome import Candidate, SimulatedOrbit, StartOutcome
from zeno_orbits.search.search_problem import Accept, SearchProblem, Verdict, clipped, listed
from zeno_orbits.search.settings import SearchStatus
from zeno_orbits.search.starts.strategy import SearchStart, from_orbit, from_start, paths_of


def start_count(search: SearchProblem) -> int:
    """Return the number of starts of a search."""
    return 1 + (search.settings.n_starts if search.free else 0)


def scanned(search: SearchProblem, number: int) -> SearchProblem:
    """Return the search with the order of its starts, if a start needs this order.

    Args:
        search: The search.
        number: Index of the start. A search for the nearest orbit begins at the given values.
    """
    if search.order is not None or not (number > 0 or search.seeks_optimum):
        return search
    # Most searches end at their first start, before the import of the scan would be finished.
    from zeno_orbits.search.starts.scan import start_order

    search.tell("simulating points of the whole box")
    return replace(search, order=start_order(search))


def numbered_start(search: SearchProblem, number: int) -> SearchStart:
    """Return a start. The result depends on the arguments alone, not on earlier starts.

    Args:
        search: The search. Its order is needed except for the first start near given values.
        number: Index of the start, from 0.
    """
    place = number if search.order is None else search.order[number]
    if place > 0:
        from zeno_orbits.search.starts.scan import start_place

        return SearchStart(values=start_place(search, place))
    values = clipped(search.values, search.free)
    again = search.order is not None and search.order.index(0) < number
    # The slow continuation, if nothing else leads to an orbit.
    easy = _easy_values(search.problem, values) if again or start_count(search) == 1 else ()
    near = None if again else search.near
    return SearchStart(values=values, near=near, easy=easy, known_empty=again)


def try_start(search: SearchProblem, number: int) -> StartOutcome:
    """Search from one start and check the orbit.

    Args:
        search: The search.
        number: Index of the start, as for `numbered_start`.
    """
    start = numbered_start(search, number)
    name = f"start {number + 1}"
    search.tell(f"{name}: simulating {listed(search.numbers(start.values))}")
    reached = from_start(search, start)
    outcome, judgement = _judged(search, reached, name)
    if judgement is not None and judgement.repels and search.free:
        outcome = _attracting(search, start, name, outcome, judgement)
    elif judgement is not None and judgement.objection and reached.is_last and search.free:
        outcome = _before(search, start, name, outcome, reached)
    numbers = {name: start.values.number(name) for name in search.free}
    return _ended(outcome, numbers)


def try_orbit(search: SearchProblem, values: ParameterValues, found: EventReturn) -> StartOutcome:
    """Search from an orbit and check the result.

    Args:
        search: The search.
        values: Values of the orbit.
        found: The orbit.
    """
    name = "another attractor"
    wanted = search if search.seeks_optimum else replace(search, free={})
    outcome, _ = _judged(search, from_orbit(wanted, values, found), name)
    numbers = {free: values.number(free) for free in search.free}
    return _ended(outcome, numbers)


def _ended(outcome: StartOutcome, numbers: Mapping[str, float]) -> StartOutcome:
    """Return the outcome of a start for another process: without the simulated orbit."""
    solution = outcome.solution
    result = outcome.result if solution is None else solution.result
    if result is not None:
        # The search knows its objective, and the candidate has the orbit.
        result = replace(result, orbit=None, objective=NearestGains(target={}))
    return replace(outcome, solution=None, start=numbers, result=result)


def _judged(
    search: SearchProblem, outcome: StartOutcome, name: str
) -> tuple[StartOutcome, Verdict | None]:
    """Measure the orbit of a start on a simulation, if it exists, and accept or reject it."""
    solution = outcome.solution
    if outcome.status is not SearchStatus.FOUND or solution is None:
        return outcome, None
    orbit = solution.orbit
    extents = solution.extents
    judgement = Verdict(objection=objection_to(search.bounds, extents))
    if not judgement.objection and search.accept is not None:
        search.tell(f"{name}: verifying")
        judgement = _accepted(search, solution, search.accept)
    if judgement.objection:
        refused = replace(
            outcome,
            status=SearchStatus.NOT_ACCEPTED,
            detail=judgement.objection,
            repels=judgement.repels,
        )
        return refused, judgement
    objective, score = search.objective, solution.result.score
    if search.free and not objective.is_measured:
        score = search.score(solution.values, extents)
    candidate = Candidate(
        orbit=orbit,
        score=score if search.free else 0.0,
        extents=extents,
        certificate=judgement.certificate,
    )
    return replace(outcome, candidate=candidate), judgement


def _accepted(search: SearchProblem, solution: SimulatedOrbit, accept: Accept) -> Verdict:
    """Check an orbit, and the orbits at all corners of uncertain ranges."""
    judgement, values = accept(solution.orbit), solution.values
    if judgement.objection or not isinstance(search.objective, MaxPush) or not search.free:
        return judgement
    paths = paths_of(search, values)
    at_corners = orbits_at_corners(paths, search.objective, values, solution.found)
    for corner, other, reason in list(at_corners)[1:]:
        if other is None:
            objection = f"{reason}."
        else:
            place = values.replaced(corner)
            objection = accept(event_orbit_of(search.problem, place, other)).objection
        if objection:
            return replace(judgement, objection=f"At {listed(corner)}: {objection}")
    return judgement


_ATTRACTS = 0.99
"""Bound of the spectral radius that replaces an unstable optimum by a stable orbit."""

_AT_LIMIT = 0.01
"""Distance of a multiplier from 1 or -1 at which an orbit is on a fold or a period doubling."""


def _attracting(
    search: SearchProblem,
    start: SearchStart,
    name: str,
    refused: StartOutcome,
    judgement: Verdict,
) -> StartOutcome:
    """Search for the best stable orbit, if the optimum is not stable.

    Args:
        search: The search.
        start: The start.
        name: Name of the start for progress reports.
        refused: Outcome of the search without regard to stability.
        judgement: The rejection of its orbit.
    """
    if refused.solution is None or any(one.name == "spectral_radius" for one in search.bounds):
        return refused
    where = listed(search.numbers(refused.solution.values))
    search.tell(f"{name}: looking for a stable orbit")
    bound = Bound(name="spectral_radius", upper=_ATTRACTS)
    bounded = replace(search, bounds=(*search.bounds, bound))
    try:
        # The best stable orbit is usually near.
        beside = from_orbit(bounded, refused.solution.values, refused.solution.found)
        outcome, _ = _judged(bounded, beside, name)
        if outcome.candidate is None:
            outcome, _ = _judged(bounded, from_start(bounded, start), name)
    except InputError:
        # Only a few multipliers can be bounded.
        return refused
    limit = "is unstable"
    multipliers = () if judgement.certificate is None else judgement.certificate.multipliers
    for value, word in ((1.0, "a fold of the family"), (-1.0, "a period doubling")):
        if any(abs(multiplier - value) < _AT_LIMIT for multiplier in multipliers):
            limit = f"lies on {word}, where orbits lose stability"
    the_best = f"The best orbit, at {where}, {limit}"
    if outcome.candidate is not None:
        detail = f"{the_best}. This is the best orbit with a spectral radius up to {_ATTRACTS:g}."
        return replace(outcome, detail=detail)
    if isinstance(search.objective, NearestGains):
        outcome = _on_the_way(search, start, name, refused.solution.values)
    if outcome.candidate is None:
        return refused
    return replace(outcome, detail=f"{the_best}. This orbit, on the way to it, is stable.")


_BEFORE = (0.999, 0.99, 0.95, 0.8)
"""Points of the line from the start to the end of a family. Orbits near the end are too small for a
verification."""
_LAST = 1e-5
"""Part of that line to which the last accepted orbit is located."""


def _before(
    search: SearchProblem,
    start: SearchStart,
    name: str,
    refused: StartOutcome,
    reached: StartOutcome,
) -> StartOutcome:
    """Search for the last accepted orbit before the end of a family.

    Args:
        search: The search.
        start: The start.
        name: Name of the start for progress reports.
        refused: The rejected outcome at the end.
        reached: The same outcome before the check, with a description of the end.
    """
    if reached.solution is None:
        return refused
    place, refused_at, part = reached.solution.values, 1.0, 0.0
    outcome = refused
    for part in _BEFORE:
        outcome = _at_part(search, start, name, place, part)
        if outcome.candidate is not None:
            break
        refused_at = part
    while outcome.candidate is not None and refused_at - part > _LAST:
        middle, near = (part + refused_at) / 2, outcome.candidate.orbit
        closer = _at_part(search, start, name, place, middle, near)
        if closer.candidate is None:
            refused, refused_at = closer, middle
        else:
            outcome, part = closer, middle
    if outcome.candidate is None:
        return refused
    return replace(outcome, detail=f"{reached.detail} Nearer to it: {refused.detail}")


_PARTS = (0.95, 0.8, 0.5, 0.2, 0.0)
"""Points of the line from the start to an unstable orbit, at which orbits may be stable."""


def _on_the_way(
    search: SearchProblem,
    start: SearchStart,
    name: str,
    place: ParameterValues,
) -> StartOutcome:
    """Search at fixed values on the line from a start to a point. An orbit takes priority.

    The objective, nearness, is only approximated here: an orbit matters more than its optimum.

    Args:
        search: The search.
        start: The start.
        name: Name of the start for progress reports.
        place: Values of the nearest orbit.
    """
    outcome = StartOutcome(status=SearchStatus.NO_GUESS)
    for part in _PARTS:
        outcome = _at_part(search, start, name, place, part)
        if outcome.candidate is not None:
            break
    return outcome


def _at_part(
    search: SearchProblem,
    start: SearchStart,
    name: str,
    place: ParameterValues,
    part: float,
    near: Orbit | None = None,
) -> StartOutcome:
    """Search at fixed values on the line from a start to a point, and check the orbit.

    Args:
        search: The search.
        start: The start.
        name: Name of the start for progress reports.
        place: Values at the end of the line.
        part: The point of the line, as a part of its length from the start.
        near: An orbit near it.
    """
    numbers = {
        free: (1.0 - part) * start.values.number(free) + part * place.number(free)
        for free in search.free
    }
    there = SearchStart(values=start.values.replaced(numbers), near=near)
    return _judged(search, from_start(replace(search, free={}), there), name)[0]


def _easy_values(problem: Problem, values: ParameterValues) -> tuple[ParameterValues, ...]:
    """Return easier values: the problem's default gains, half the restitution, or both.

    The problem's defaults are a further choice, unless a value is too far from its default for a
    continuation.
    """
    gains = {gain.name: gain.default for gain in problem.gains if gain.default is not None}
    own = values.replaced(gains)
    found = [own]
    if "restitution" in values.parameters:
        dull = {"restitution": values.parameters["restitution"] / 2}
        found += [values.replaced(dull), own.replaced(dull)]
    if not far_from_own(problem, values):
        found.append(problem.values())
    return tuple(one for k, one in enumerate(found) if one != values and one not in found[:k])
