"""From a start to an orbit: by simulation, from a known orbit, or by continuation.

The objective is then reached directly, in small steps, or after a minimisation of the violation of
the bounds.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from zeno_orbits.errors import SimulationError, UnsettledError, ZenoOrbitsError
from zeno_orbits.model import ParameterValues
from zeno_orbits.orbits import (
    Cycle,
    Orbit,
    orbit_event_name,
    relaxed_tolerance,
    round_again,
    shape_of_events,
)
from zeno_orbits.search.closing import settled_return
from zeno_orbits.search.cycles import beyond_limits, closed_cycle, cycle_of_return, orbit_of
from zeno_orbits.search.homotopy.best_on_line import all_kept, best_on_the_way, kept_and_exceeded
from zeno_orbits.search.homotopy.homotopy import follow
from zeno_orbits.search.homotopy.line import Followed
from zeno_orbits.search.homotopy.margins import CycleWays
from zeno_orbits.search.homotopy.persistence import Persistence, widest
from zeno_orbits.search.objectives import MaxPush, NearestGains, Target, TowardTarget
from zeno_orbits.search.outcome import SimulatedSolution, StartOutcome
from zeno_orbits.search.refinement import (
    COARSE,
    ON_THE_WAY,
    least_violation,
    refine,
    solve_once,
)
from zeno_orbits.search.search_problem import SearchProblem, listed
from zeno_orbits.search.settings import SearchStatus
from zeno_orbits.search.strength import Strength, strongest
from zeno_orbits.search.trust_region import LastStep, trust_region_steps
from zeno_orbits.simulation import SimulationSettings

_AT_BOUND = 0.02
"""Distance below which a value is at its bound, in units of its range."""

_VIOLATED = 1e-5
"""Relative violation above which a bound cannot be satisfied."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowedMotion:
    """Result of the simulation of a motion until it settles.

    Attributes:
        cycle: The period to which it settles, if there is one.
        reason: Reason of a missing period, as a clause. Empty with a period.
        undecided: True if the motion had not settled at its time limit.
    """

    cycle: Cycle | None
    reason: str = ""
    undecided: bool = False


_NOT_FOLLOWED = FollowedMotion(cycle=None, reason="no orbit is near")


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
    """Search from one start. The result depends on the arguments alone, not on earlier starts."""
    values, near = start.values, start.near
    if near is not None:
        path = follow(search, near, near.values(search.problem), values)
        return _along(search, start, path, "the known orbit")
    motion = _NOT_FOLLOWED if start.known_empty else simulated(search, values)
    if motion.cycle is not None:
        outcome = from_cycle(search, values, motion.cycle)
        if outcome.status is SearchStatus.FOUND or search.free:
            return outcome
        outcome = _closed(search, values, motion.cycle) or outcome
        if outcome.status is SearchStatus.FOUND:
            return outcome
    else:
        where = f"At {listed(search.numbers(values))}, " if search.numbers(values) else ""
        detail = f"{where}{motion.reason}."
        outcome = StartOutcome(
            status=SearchStatus.NO_GUESS,
            detail=detail[0].upper() + detail[1:],
            undecided=motion.undecided,
        )
    return _by_an_easier_way(search, start, outcome)


def beside(search: SearchProblem, start: SearchStart, solution: SimulatedSolution) -> StartOutcome:
    """Search from the solution of a search with fewer bounds.

    Args:
        search: The search.
        start: The start.
        solution: The solution of the search with fewer bounds.
    """
    return refine(search, solution.values, solution.cycle, search.objective, start.values)


def simulated(search: SearchProblem, values: ParameterValues) -> FollowedMotion:
    """Return the period to which the problem settles, or the reason of a failure."""
    problem, settings = search.problem, SimulationSettings()
    try:
        found = settled_return(
            problem,
            values,
            starts=search.initial_states,
            shape=search.shape,
            until=search.settings.settling.horizon,
        )
        is_plastic = search.dynamics(values).restitution == 0.0
        shape = search.shape or shape_of_events(found.events, is_plastic=is_plastic)
        if shape is None:
            sequence = ", ".join(map(orbit_event_name, found.events))
            return FollowedMotion(cycle=None, reason=f"the motion has the events `{sequence}`")
        cycle = cycle_of_return(problem.graph_dynamics(values), found, shape, settings)
    except SimulationError as error:
        # What to do about it depends on the search.
        clause = re.split(": (?:start|simulate) ", error.reason)[0]
        undecided = isinstance(error, UnsettledError)
        reason = f"{clause[0].lower()}{clause[1:]}"
        return FollowedMotion(cycle=None, reason=reason, undecided=undecided)
    return FollowedMotion(cycle=cycle)


def _closed(search: SearchProblem, values: ParameterValues, cycle: Cycle) -> StartOutcome | None:
    """Return the orbit to which a motion converges, closed by simulation at the highest accuracy.

    Over many impacts errors grow beyond the tolerance between program and simulation. A
    continuation from easier values would lead to another orbit than the attractor of the motion.
    """
    if isinstance(search.objective, Target):
        return None
    try:
        found = closed_cycle(
            search.problem.graph_dynamics(values),
            cycle.start.state,
            shape=cycle.shape,
            period=cycle.period,
            settings=_FINEST,
        )
    except ZenoOrbitsError:
        return None
    if round_again(found) or beyond_limits(search.problem, found.arcs):
        return None
    orbit = orbit_of(found, search.problem, values)
    return StartOutcome(
        status=SearchStatus.FOUND,
        detail=_BY_ITSELF,
        agreement=found.drift(found.scale_at_events()),
        solution=SimulatedSolution(
            values=values, cycle=found, unknowns={}, orbit=orbit, excesses={}
        ),
    )


_FINEST = relaxed_tolerance(SimulationSettings(), factor=1e-2)
_BY_ITSELF = "Errors grow too much on it for the program: simulation alone closes the orbit."


def _by_an_easier_way(
    search: SearchProblem, start: SearchStart, outcome: StartOutcome
) -> StartOutcome:
    """Continue orbits from easier values to the start's values, after a failed direct search."""
    for easy in start.easy:
        if easy == start.values:
            continue
        search.tell(f"following orbits from {listed(_differing(easy, start.values))}")
        cycle = simulated(search, easy).cycle
        if cycle is None:
            continue
        path = follow(search, cycle, easy, start.values)
        if path.orbit is None:
            continue
        reached = _along(search, start, path, listed(_differing(easy, start.values)))
        if reached.status is SearchStatus.FOUND:
            return reached
        detail = f"{outcome.detail} {path.ending}".strip()
        return replace(outcome, detail=detail, shortfall=min(outcome.shortfall, path.left))
    return outcome


def _along(
    search: SearchProblem, start: SearchStart, path: Followed[Cycle], origin: str
) -> StartOutcome:
    """Search from the last orbit of a path, which may end before the values of the start."""
    if path.orbit is None:
        detail = f"From {origin} no orbit could be followed."
        return StartOutcome(status=SearchStatus.NO_GUESS, detail=detail)
    if path.arrived:
        return from_cycle(search, start.values, path.orbit)
    inside = all(
        search.free[name][0] <= path.values.number(name) <= search.free[name][1]
        if name in search.free
        else path.values.number(name) == start.values.number(name)
        for name in path.values.numbers
    )
    if inside and search.free:
        outcome = from_cycle(search, path.values, path.orbit)
        if outcome.status is SearchStatus.FOUND:
            return replace(outcome, detail=f"{path.ending} {outcome.detail}".strip())
        return outcome
    return StartOutcome(status=SearchStatus.NO_GUESS, detail=path.ending)


def _differing(values: ParameterValues, other: ParameterValues) -> dict[str, float]:
    return {n: value for n, value in values.numbers.items() if value != other.number(n)}


def from_cycle(search: SearchProblem, values: ParameterValues, cycle: Cycle) -> StartOutcome:
    """Search from one simulated period.

    Args:
        search: The search.
        values: Values at which the period was simulated.
        cycle: The period.
    """
    objective = search.objective
    if isinstance(objective, Target):
        return _to_target(search, values, cycle, objective)
    if objective.is_sampled and search.free:
        return _by_samples(search, values, cycle)
    held = replace(search, free={})
    nearest = isinstance(objective, NearestGains)
    if nearest and all(values.number(n) == v for n, v in objective.target.items()):
        # An orbit at the target itself is optimal, so the gains are fixed.
        here = refine(held, values, cycle, objective)
        if not search.bounds or not search.free:
            return here
    outcome = refine(search, values, cycle, objective)
    if outcome.status is SearchStatus.FOUND or not search.free:
        return outcome
    if search.bounds:
        values, cycle, lacking = _where_bounds_are_kept(search, values, cycle)
        if lacking is not None:
            return replace(
                outcome,
                status=lacking.status,
                detail=lacking.detail,
                shortfall=lacking.shortfall,
            )
    search.tell(f"small steps toward {objective.wish}")

    def solve(near: SearchProblem, here: ParameterValues, around: Cycle) -> StartOutcome:
        return solve_once(near, values, here, around, objective, COARSE)

    last = trust_region_steps(search, values, cycle, solve)
    stepped = refine(search, last.values, last.cycle, objective, values)
    if stepped.status is SearchStatus.FOUND:
        return stepped
    # An orbit matters more than its optimum: return the best orbit of the steps.
    return best_on_the_way(search, values, last) or outcome


def _by_samples(search: SearchProblem, values: ParameterValues, cycle: Cycle) -> StartOutcome:
    """Return the orbit with the best sampled quantity."""
    if search.bounds:
        values, cycle, lacking = _where_bounds_are_kept(search, values, cycle)
        if lacking is not None:
            return lacking
    best: Strength | Persistence[Cycle | Orbit]
    if isinstance(search.objective, MaxPush):
        best = strongest(search, values, cycle)
        if best.push is None:
            return StartOutcome(status=SearchStatus.NO_GUESS, detail=best.text)
        found = best.cycle
    else:
        best = widest(CycleWays(search=search), values, cycle)
        found = best.orbit
    around = found if isinstance(found, Cycle) else cycle
    outcome = refine(replace(search, free={}), best.values, around, search.objective)
    if outcome.status is not SearchStatus.FOUND:
        return outcome
    return replace(outcome, detail=best.text)


def _where_bounds_are_kept(
    search: SearchProblem, values: ParameterValues, cycle: Cycle
) -> tuple[ParameterValues, Cycle, StartOutcome | None]:
    """Minimise the violation of the bounds, and describe the remaining violation.

    The result is a local minimum near the start. Another start may have a smaller violation. An
    orbit that satisfies all bounds is returned unchanged.
    """
    if all_kept(search, values, cycle):
        return values, cycle, None
    search.tell("looking for where the bounds are kept")
    origin = values

    def solve(near: SearchProblem, here: ParameterValues, around: Cycle) -> StartOutcome:
        return least_violation(near, origin, here, around)

    last = trust_region_steps(search, values, cycle, solve)
    if last.outcome is None or last.outcome.solution is None:
        return values, cycle, None
    unknowns = last.outcome.solution.unknowns
    slacks = [float(unknowns[f"slack {k}"][0, 0]) for k in range(len(search.bounds))]
    broken = [
        f"`{bound.name}` leaves its bounds {bound.text} by "
        f"{float(unknowns[f'excess {k}'][0, 0]):.3g}"
        for k, bound in enumerate(search.bounds)
        if slacks[k] > _VIOLATED
    ]
    if not broken or not last.converged:
        return last.values, last.cycle, None
    where = listed({name: last.values.number(name) for name in search.free})
    detail = f"No orbit was found that keeps all bounds. The nearest one, at {where}"
    lacking = StartOutcome(
        status=SearchStatus.NOT_SOLVED,
        detail=f"{detail}{_held(search, last.values)}, {', '.join(broken)}.",
        shortfall=sum(slacks),
    )
    return last.values, last.cycle, lacking


def _to_target(
    search: SearchProblem, values: ParameterValues, cycle: Cycle, target: Target
) -> StartOutcome:
    """Reach a target: directly if it is near, else by steps that reduce the squared distance.

    If the bounds cannot be satisfied even without the target, the message names the bounds and not
    the target.
    """
    if search.bounds and search.free:
        values, cycle, lacking = _where_bounds_are_kept(search, values, cycle)
        if lacking is not None:
            here = target.measured(cycle)
            missed = f"There the orbit has {replace(target, target=here).wish}."
            return replace(lacking, detail=f"{lacking.detail} {missed}")
    if target.miss(cycle) <= search.settings.first_step:
        search.tell(f"asking for {target.wish}")
        outcome = refine(search, values, cycle, target)
        if outcome.status is SearchStatus.FOUND:
            return outcome
    search.tell(f"small steps toward {target.wish}")
    toward = TowardTarget(target=target)

    def solve(near: SearchProblem, here: ParameterValues, around: Cycle) -> StartOutcome:
        return solve_once(near, values, here, around, toward, COARSE)

    last = trust_region_steps(search, values, cycle, solve)
    here = target.measured(last.cycle)
    if abs(here - target.target) > search.settings.smallest_step * target.target:
        return _short_of(search, target, here, last, last.outcome)
    search.tell(f"asking for {target.wish}")
    outcome = refine(search, last.values, last.cycle, target, values)
    if outcome.status is not SearchStatus.FOUND:
        # The nearest values with the target may be far away on its level set.
        outcome = refine(search, last.values, last.cycle, target, last.values)
    if outcome.status is SearchStatus.FOUND:
        return outcome
    short = _short_of(search, target, here, last, outcome)
    return replace(short, detail=outcome.detail)


def _short_of(
    search: SearchProblem,
    target: Target,
    here: float,
    step: LastStep,
    last: StartOutcome | None,
) -> StartOutcome:
    """Return a failure with the remaining distance from a target and the active bounds."""
    values = step.values
    at = listed(search.numbers(values))
    reached = f"The nearest that was reached is {replace(target, target=here).wish}, at {at}"
    detail = f"{reached}{_held(search, values)}"
    miss = abs(target.target - here)
    why = "" if last is None or last.agreement < ON_THE_WAY else last.detail
    return replace(
        last or StartOutcome(status=SearchStatus.NOT_SOLVED),
        status=SearchStatus.NOT_SOLVED,
        detail=f"{detail}; missed: `{target.wish}` by {miss:.3g}"
        f"{kept_and_exceeded(search, values, step.cycle)}. {why}".strip(),
        shortfall=miss,
    )


def _held(search: SearchProblem, values: ParameterValues) -> str:
    """Return the free values at a bound of their box, in brackets."""
    held = [
        f"{name} at its bound {bound:g}"
        for name, bounds in search.free.items()
        for bound in bounds
        if abs(values.number(name) - bound) <= _AT_BOUND * (bounds[1] - bounds[0])
    ]
    return f" ({', '.join(held)})" if held else ""
