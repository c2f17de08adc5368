"""From a start to an orbit: by simulation, from a known orbit, or by continuation."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from zeno_orbits.errors import EventlessError, SimulationError, UnsettledError
from zeno_orbits.model import ParameterValues
from zeno_orbits.orbits import (
    EventReturn,
    EventSequence,
    Orbit,
    events_of_shape,
    orbit_event_name,
    shortest_return,
)
from zeno_orbits.search.closing.closing import event_orbit_of, return_near, settled_return
from zeno_orbits.search.closing.limits import beyond_limits
from zeno_orbits.search.closing.line import Followed
from zeno_orbits.search.objectives import NearestGains
from zeno_orbits.search.optimum.gains import BestOrbit, GainSearch
from zeno_orbits.search.optimum.paths import TO_VALUES, OrbitPaths
from zeno_orbits.search.optimum.points import OrbitsOverValues
from zeno_orbits.search.outcome import SimulatedOrbit, StartOutcome
from zeno_orbits.search.program.agreement import Agreement, agreement_of
from zeno_orbits.search.search_problem import SearchProblem, listed
from zeno_orbits.search.settings import SearchMethod, SearchStatus

_BY_ITSELF = "Errors grow too much on it for the program: simulation alone closes the orbit."


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowedMotion:
    """Result of the simulation of a motion until it settles.

    Attributes:
        found: The orbit to which it settles, if there is one.
        reason: Reason of a missing orbit, as a clause. Empty with an orbit.
        undecided: True if the motion had not settled at its time limit.
        status: Status of a search that starts from this motion, if no orbit was found.
    """

    found: EventReturn | None
    reason: str = ""
    undecided: bool = False
    status: SearchStatus = SearchStatus.NO_GUESS


_MOST_COMPARED = 200
"""Events per period up to which a program is compared: 390 events take it more than 4 minutes."""

_NOT_FOLLOWED = FollowedMotion(found=None, reason="no orbit is near")


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchStart:
    """Start of a search.

    Attributes:
        values: Values of the gains and parameters.
        near: An orbit at these values or near them. By default the problem is simulated.
        easy: Values from which orbits are continued to ``values`` if a simulation finds no orbit.
        known_empty: True if an earlier simulation found no orbit.
    """

    values: ParameterValues
    near: Orbit | None = None
    easy: tuple[ParameterValues, ...] = ()
    known_empty: bool = False


def from_start(search: SearchProblem, start: SearchStart) -> StartOutcome:
    """Search from one start. The result depends on the arguments alone, not on earlier starts.

    Args:
        search: The search.
        start: The start.
    """
    if start.near is not None:
        return _from_known(search, start, start.near)
    motion = _NOT_FOLLOWED if start.known_empty else simulated(search, start.values)
    if motion.found is not None:
        outcome = from_orbit(search, start.values, motion.found)
        if outcome.status is SearchStatus.FOUND or search.free:
            return outcome
    else:
        numbers = search.numbers(start.values)
        detail = f"{f'At {listed(numbers)}, ' if numbers else ''}{motion.reason}."
        outcome = StartOutcome(
            status=motion.status,
            detail=detail[0].upper() + detail[1:],
            undecided=motion.undecided,
        )
    return _by_an_easier_way(search, start, outcome)


def simulated(search: SearchProblem, values: ParameterValues) -> FollowedMotion:
    """Return the orbit to which the problem settles, or the reason of a failure.

    Args:
        search: The search.
        values: The values of the simulation.
    """
    try:
        found = settled_return(
            search.problem,
            values,
            starts=search.initial_states,
            section=search.section,
            shape=search.shape,
            until=search.settings.settling.horizon,
            simulation=search.settings.simulation,
            changing=(*search.free, *search.objective.parameter_ranges),
        )
    except SimulationError as error:
        # What to do about it depends on the search.
        clause = re.split(": (?:start|simulate) ", error.reason)[0]
        reason = f"{clause[0].lower()}{clause[1:]}"
        undecided = isinstance(error, UnsettledError)
        none = isinstance(error, EventlessError)
        status = SearchStatus.NO_EVENTS if none else SearchStatus.NO_GUESS
        return FollowedMotion(found=None, reason=reason, undecided=undecided, status=status)
    return FollowedMotion(found=found)


def from_orbit(search: SearchProblem, values: ParameterValues, found: EventReturn) -> StartOutcome:
    """Search from an orbit.

    Args:
        search: The search.
        values: Values of the orbit.
        found: The orbit.
    """
    # Margins and pushes of one orbit are not part of its search.
    is_held = not search.free and search.objective.is_maximized
    gains = GainSearch(
        problem=search.problem,
        origin=search.values,
        free=search.free,
        objective=NearestGains(target={}) if is_held else search.objective,
        bounds=search.bounds,
        method=search.method,
        accept=search.accept,
        shape=search.shape,
        starts=search.initial_states,
        simulation=search.settings.simulation,
        on_progress=search.on_progress,
    )
    try:
        best = _shortest(gains, gains.best(found, values))
    except SimulationError as error:
        return StartOutcome(status=SearchStatus.NOT_SOLVED, detail=f"{error.reason.rstrip('.')}.")
    if not search.free:
        return _compared(search, best)
    result = best.result
    if result.orbit is None:
        return StartOutcome(
            status=SearchStatus.NOT_SOLVED,
            detail=result.detail,
            iterations=result.iterations,
            shortfall=best.violation,
            result=result,
        )
    outcome = _compared(search, best)
    said = (result.detail or result.told_push, *result.remarks, outcome.detail)
    return replace(
        outcome,
        detail=" ".join(filter(None, said)),
        is_last=best.is_last,
        iterations=outcome.iterations + result.iterations,
    )


def _shortest(gains: GainSearch, best: BestOrbit) -> BestOrbit:
    """Return the end of a search at its shortest period, by which its quantities are measured.

    A search may begin at an orbit of several returns, and end where they are equal.

    Raises:
        SimulationError: If the shortest period does not close.
    """
    if best.result.orbit is None:
        return best
    graph = gains.problem.graph_dynamics(best.values)
    short = shortest_return(graph, best.found, gains.simulation)
    if len(short.events) == len(best.found.events):
        return best
    again = gains.best(short, best.values)
    return again.told(n_orbits=best.result.n_orbits + again.result.n_orbits)


def paths_of(search: SearchProblem, values: ParameterValues) -> OrbitPaths:
    """Return the orbits of a search over its free values as lines.

    Args:
        search: The search.
        values: Values of everything that is not free.
    """
    orbits = OrbitsOverValues(
        problem=search.problem,
        values=values,
        names=tuple(search.free),
        simulation=search.settings.simulation,
    )
    return OrbitPaths(
        orbits=orbits, free=search.free, bounds=search.bounds, on_progress=search.on_progress
    )


def _compared(search: SearchProblem, best: BestOrbit) -> StartOutcome:
    """Return an orbit with its agreement with a program, whose mesh is refined until they agree.

    Shooting compares no program, and neither does the default method if there are many events.
    """
    values, found = best.values, best.found
    problem, settings = search.problem, search.settings
    graph = problem.graph_dynamics(values)
    orbit = event_orbit_of(problem, values, found)
    if search.shape is not None and not _is_of_shape(orbit, search.shape):
        has = f"`{orbit.phases_as.text}`" if orbit.phases_as else "other events"
        detail = f"The orbit has the shape {has}, not `{search.shape.text}`."
        return StartOutcome(status=SearchStatus.NOT_FOLLOWED, detail=detail)
    beyond = beyond_limits(problem, found.arcs)
    if beyond:
        return StartOutcome(status=SearchStatus.NOT_FOLLOWED, detail=f"{beyond}.")
    solution = SimulatedOrbit(
        values=values,
        found=found,
        orbit=orbit,
        extents=best.extents,
        result=best.result,
    )
    if search.method is SearchMethod.SHOOTING:
        return StartOutcome(status=SearchStatus.FOUND, solution=solution)
    if search.method is SearchMethod.AUTO and len(found.events) > _MOST_COMPARED:
        detail = (
            f"Its {len(found.events)} events per period take a program minutes: no program is "
            "compared with it (`method`, --method program)."
        )
        return StartOutcome(status=SearchStatus.FOUND, detail=detail, solution=solution)
    seen = agreement_of(graph, found, settings.transcription)
    for _ in range(settings.rounds - 1):
        if seen.difference <= settings.agreement:
            break
        mesh = 0.1 * settings.transcription.mesh_tolerance
        settings = replace(
            settings, transcription=replace(settings.transcription, mesh_tolerance=mesh)
        )
        seen = agreement_of(graph, found, settings.transcription)
    return _found(seen, solution, settings.agreement)


def _is_of_shape(orbit: Orbit, shape: EventSequence) -> bool:
    own = orbit.phases_as
    return own is not None and events_of_shape(own) == events_of_shape(shape)


def _found(seen: Agreement, solution: SimulatedOrbit, wanted: float) -> StartOutcome:
    return StartOutcome(
        status=SearchStatus.FOUND,
        detail="" if seen.difference <= wanted else _BY_ITSELF,
        residuals=seen.residuals,
        agreement=seen.difference,
        closure_error=seen.closure_error,
        n_unknowns=seen.n_unknowns,
        iterations=seen.iterations,
        solve_time=seen.solve_time,
        solution=solution,
    )


def _from_known(search: SearchProblem, start: SearchStart, near: Orbit) -> StartOutcome:
    """Search from a known orbit, which is followed to the values of the start."""
    own = near.values(search.problem)
    try:
        found = _return_to(search, near, own)
    except SimulationError:
        detail = "From the known orbit no orbit could be followed."
        return StartOutcome(status=SearchStatus.NO_GUESS, detail=detail)
    if own == start.values:
        return from_orbit(search, own, found)
    path = _followed(search, found, own, start.values)
    outcome = _along(search, start, path, "the known orbit")
    if outcome.status is not SearchStatus.NO_GUESS:
        return outcome
    try:
        # The events may change on the way.
        found = _return_to(search, near, start.values)
    except SimulationError:
        return outcome
    return from_orbit(search, start.values, found)


def _return_to(search: SearchProblem, near: Orbit, values: ParameterValues) -> EventReturn:
    """Return a known orbit at values, by the search's integrator."""
    return return_near(
        search.problem,
        values,
        near,
        simulation=search.settings.simulation,
        on_progress=search.on_progress,
    )


def _followed(
    search: SearchProblem, found: EventReturn, here: ParameterValues, wanted: ParameterValues
) -> Followed:
    """Follow an orbit, stable or not, to other values. The last one starts at the same event."""
    paths = paths_of(search, here)
    path = paths.follow(found, here, wanted, steps=TO_VALUES, is_stable=False)
    if path.orbit is None:
        return path
    try:
        last = paths.back(path.orbit, path.values, orbit_event_name(found.events[-1]))
    except SimulationError:
        return path
    return replace(path, orbit=last)


def _by_an_easier_way(
    search: SearchProblem, start: SearchStart, outcome: StartOutcome
) -> StartOutcome:
    """Continue orbits from easier values to the start's values, after a failed direct search."""
    for easy in start.easy:
        if easy == start.values:
            continue
        origin = listed(_differing(easy, start.values))
        search.tell(f"following orbits from {origin}")
        found = simulated(search, easy).found
        if found is None:
            continue
        path = _followed(search, found, easy, start.values)
        if path.orbit is None:
            continue
        reached = _along(search, start, path, origin)
        if reached.status is SearchStatus.FOUND:
            return reached
        detail = f"{outcome.detail} {path.ending}".strip()
        return replace(outcome, detail=detail, shortfall=min(outcome.shortfall, path.left))
    return outcome


def _along(search: SearchProblem, start: SearchStart, path: Followed, origin: str) -> StartOutcome:
    """Search from the last orbit of a path, which may end before the values of the start."""
    if path.orbit is None:
        detail = f"From {origin} no orbit could be followed."
        return StartOutcome(status=SearchStatus.NO_GUESS, detail=detail)
    if path.arrived:
        return from_orbit(search, start.values, path.orbit)
    inside = all(
        search.free[name][0] <= path.values.number(name) <= search.free[name][1]
        if name in search.free
        else path.values.number(name) == start.values.number(name)
        for name in path.values.numbers
    )
    if inside and search.free:
        outcome = from_orbit(search, path.values, path.orbit)
        if outcome.status is SearchStatus.FOUND:
            detail = f"{path.ending} {outcome.detail}".strip()
            return replace(outcome, detail=detail, is_last=True)
        return outcome
    return StartOutcome(status=SearchStatus.NO_GUESS, detail=path.ending)


def _differing(values: ParameterValues, other: ParameterValues) -> dict[str, float]:
    return {n: value for n, value in values.numbers.items() if value != other.number(n)}
