"""The best orbit on the way to an objective that is not reached, and the cause of the failure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.model import ParameterValues
from zeno_orbits.orbits import Cycle, excess, objection_to
from zeno_orbits.search.cycles import orbit_of
from zeno_orbits.search.homotopy.homotopy import follow
from zeno_orbits.search.outcome import StartOutcome
from zeno_orbits.search.refinement import refine
from zeno_orbits.search.search_problem import SearchProblem
from zeno_orbits.search.settings import SearchStatus
from zeno_orbits.search.trust_region import LastStep
from zeno_orbits.simulation import Extent
from zeno_orbits.verification import measure

_BACK = (1e-5, 1e-4, 1e-3, 1e-2, 0.1)
"""Points before the end of a family, as parts of the line back to the origin, in this order."""


def best_on_the_way(
    search: SearchProblem, origin: ParameterValues, last: LastStep
) -> StartOutcome | None:
    """Return the best orbit before the steps to an objective failed, or ``None``.

    An objective may improve up to the end of a family, without an optimum inside. Orbits are
    therefore continued along the line of the steps, beyond the last step, and the end is reported.

    Args:
        search: The search.
        origin: Values at which the steps began.
        last: The last step.
    """
    objective, ending = search.objective, ""
    places = [(last.values, last.cycle)]
    beyond = _edge(search, origin, last.values)
    if beyond is not None:
        earlier = [(last.cycle, last.values), *_before(search, origin, last.values, last.cycle)]
        path = follow(search, *earlier[-1], beyond)
        ending = path.ending
        if path.orbit is not None:
            places.append((path.values, path.orbit))
    held = replace(search, free={})
    found: list[tuple[float, StartOutcome]] = []
    for values, cycle in places:
        here = refine(held, values, cycle, objective)
        score = _score(search, here)
        if score is not None:
            found.append((score, here))
    if not found:
        before = _before_the_end(search, origin, *places[-1])
        if before is None:
            return None
        found.append(before)
    best = min(found, key=lambda pair: pair[0])[1]
    lost = f"The way to {objective.wish} was lost: this is the last orbit on it."
    if ending and best is found[-1][1]:
        lost = f"The way to {objective.wish} ends: this is the last orbit before. {ending}"
    return replace(best, detail=lost)


def _before_the_end(
    search: SearchProblem, origin: ParameterValues, last: ParameterValues, cycle: Cycle
) -> tuple[float, StartOutcome] | None:
    """Return the score and the outcome of the nearest accepted orbit before an end.

    If an orbit shrinks to a point at the end of its family, its relative accuracy decreases there.
    """
    for earlier, values in _before(search, origin, last, cycle):
        here = refine(replace(search, free={}), values, earlier, search.objective)
        score = _score(search, here)
        if score is not None:
            return score, here
    return None


def _before(
    search: SearchProblem, origin: ParameterValues, last: ParameterValues, cycle: Cycle
) -> Iterator[tuple[Cycle, ParameterValues]]:
    """Yield orbits farther and farther back from a last orbit toward an origin, until one is lost.

    Near the end of a family orbits change fast, so each orbit is continued from the previous orbit.
    """
    here = last
    for part in _BACK:
        shifts = {
            name: last.number(name) + part * (origin.number(name) - last.number(name))
            for name in search.free
            if origin.number(name) != last.number(name)
        }
        path = follow(search, cycle, here, last.replaced(shifts)) if shifts else None
        if path is None or path.orbit is None or not path.arrived:
            return
        cycle, here = path.orbit, path.values
        yield cycle, here


def _edge(
    search: SearchProblem, origin: ParameterValues, last: ParameterValues
) -> ParameterValues | None:
    """Return the values at which the line through two points leaves the box, or ``None``."""
    steps = {name: last.number(name) - origin.number(name) for name in search.free}
    reach = [
        ((search.free[name][1] if step > 0.0 else search.free[name][0]) - last.number(name)) / step
        for name, step in steps.items()
        if step != 0.0
    ]
    if not reach or min(reach) <= 0.0:
        return None
    part = min(reach)
    return last.replaced({name: last.number(name) + part * step for name, step in steps.items()})


def _score(search: SearchProblem, outcome: StartOutcome) -> float | None:
    """Return the score of an orbit within the bounds, or ``None`` for other outcomes."""
    solution = outcome.solution
    if outcome.status is not SearchStatus.FOUND or solution is None or solution.orbit is None:
        return None
    names = [*search.objective.quantities, *(bound.name for bound in search.bounds)]
    try:
        extents = measure(solution.orbit, search.problem, names) if names else {}
    except ZenoOrbitsError:
        return None
    if objection_to(search.bounds, extents):
        return None
    return search.score(solution.values, extents)


def all_kept(search: SearchProblem, values: ParameterValues, cycle: Cycle) -> bool:
    """Return True if all bounds can be measured on a simulated period and are satisfied.

    Args:
        search: The search.
        values: Values of the orbit.
        cycle: One simulated period of the orbit.
    """
    try:
        return not objection_to(search.bounds, bounded_extents(search, values, cycle))
    except ZenoOrbitsError:
        return False


def kept_and_exceeded(search: SearchProblem, values: ParameterValues, cycle: Cycle) -> str:
    """Return the distance of each bounded quantity from its bounds, as clauses.

    Args:
        search: The search.
        values: Values of the orbit.
        cycle: One simulated period of the orbit.
    """
    if not search.bounds:
        return ""
    try:
        extents = bounded_extents(search, values, cycle)
    except ZenoOrbitsError:
        return ""
    clauses = [
        f"`{bound.name}` {'exceeds' if over > 0.0 else 'is within'} {bound.text} by {abs(over):.3g}"
        for bound in search.bounds
        for over in (excess(bound, extents[bound.name]),)
    ]
    return "; " + ", ".join(clauses)


def bounded_extents(
    search: SearchProblem, values: ParameterValues, cycle: Cycle
) -> Mapping[str, Extent]:
    """Return the range of each bounded quantity, measured on a simulated period.

    Args:
        search: The search, with its bounds.
        values: Gains and parameters.
        cycle: The period.

    Raises:
        ZenoOrbitsError: If the period cannot be measured.
    """
    names = [bound.name for bound in search.bounds]
    return measure(orbit_of(cycle, search.problem, values), search.problem, names)
