"""The ways from a start to an orbit: a simulation, a known orbit, or a path from an easier place.

What is asked is then reached directly, step by step through wanted values on the way, or by first
making the violation of the bounds as small as may be.
"""

from __future__ import annotations

from dataclasses import replace

from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.model.problem import ParameterValues
from zeno_orbits.orbits.cycle import Cycle, gone_round_twice, round_again
from zeno_orbits.search.closing import close_cycle
from zeno_orbits.search.confirmation import one_cycle
from zeno_orbits.search.guess import settle
from zeno_orbits.search.homotopy import Path, follow
from zeno_orbits.search.objectives import (
    Approach,
    NearestGains,
    Objective,
    WantedAmplitude,
    WantedPeriod,
)
from zeno_orbits.search.refinement import COARSE, ON_THE_WAY, Hunt
from zeno_orbits.search.settings import Find, SearchStatus, Start, listed
from zeno_orbits.search.trust_region import walk
from zeno_orbits.simulation.simulator import SimulationSettings

_AT_BOUND = 0.02
"""A number this near its bound, in units of its range, is said to be at it."""

_VIOLATED = 1e-5
"""A bound that is passed by more than this part of its size cannot be kept."""


def from_start(hunt: Hunt, start: Start) -> Find:
    """Search from one start: a pure function of its arguments, whatever has been tried before."""
    values = start.values
    if start.known is not None:
        known = start.known
        path = follow(hunt, known.values, known.start, values, known.shape)
        return _along(hunt, start, path, "the known orbit")
    cycle, reason = simulated(hunt, values)
    if cycle is not None:
        find = from_cycle(hunt, values, cycle)
        if find.status is SearchStatus.FOUND or hunt.free:
            return find
    else:
        where = f"At {listed(hunt.numbers(values))}, " if hunt.numbers(values) else ""
        detail = f"{where}{reason}."
        find = Find(status=SearchStatus.NO_GUESS, detail=detail[0].upper() + detail[1:])
    return _by_an_easier_way(hunt, start, find)


def simulated(hunt: Hunt, values: ParameterValues) -> tuple[Cycle | None, str]:
    """Return a period to which the problem settles, or why there is none."""
    dynamics = hunt.dynamics(values)
    starts = [hunt.problem.state_vector(start) for start in hunt.problem.starts]
    settling = settle(dynamics, starts, hunt.settings.settling, hunt.shape)
    cycle = settling.cycle
    if cycle is None:
        return None, settling.reason
    if hunt.shape is not None or not cycle.shape.has_one_release:
        return _brought_nearer(hunt, dynamics, cycle)
    # The noise of the loose settling would be meshed; one period costs little.
    return one_cycle(dynamics, cycle.start.state, 2 * cycle.period, cycle.shape) or cycle, ""


def _brought_nearer(hunt: Hunt, dynamics: HybridDynamics, cycle: Cycle) -> tuple[Cycle | None, str]:
    """Return the orbit near a period by simulation, if it closes: it may be a poor guess.

    A motion that settles slowly, throwing over from one period to the next, looks as if it repeated
    after two.
    """
    try:
        near = close_cycle(
            dynamics,
            cycle.start.state,
            scale=cycle.scale_at_events(),
            period=cycle.period,
            settings=SimulationSettings(),
            shape=cycle.shape,
        ).cycle
    except ZenoOrbitsError:
        return cycle, ""
    shorter = gone_round_twice(near)
    if shorter is None:
        return near, ""
    if hunt.shape is not None:
        return None, round_again(near).removesuffix(".")
    return one_cycle(dynamics, near.start.state, near.period, shorter) or near, ""


def _by_an_easier_way(hunt: Hunt, start: Start, find: Find) -> Find:
    """Follow orbits from an easier setting to the start's, where the direct way failed."""
    for easy in start.easy:
        if easy == start.values:
            continue
        hunt.tell(f"following orbits from {listed(_differing(easy, start.values))}")
        cycle, _ = simulated(hunt, easy)
        if cycle is None:
            continue
        path = follow(hunt, easy, cycle.start.state, start.values, cycle.shape)
        if path.cycle is None:
            continue
        reached = _along(hunt, start, path, listed(_differing(easy, start.values)))
        if reached.status is SearchStatus.FOUND:
            return reached
        return replace(find, detail=f"{find.detail} {path.ending}".strip())
    return find


def _along(hunt: Hunt, start: Start, path: Path, origin: str) -> Find:
    """Return what comes of the end of a path, which may be short of the start's own numbers."""
    if path.cycle is None:
        detail = f"From {origin} no orbit could be followed."
        return Find(status=SearchStatus.NO_GUESS, detail=detail)
    if path.arrived:
        return from_cycle(hunt, start.values, path.cycle)
    inside = all(
        hunt.free[name][0] <= path.values.number(name) <= hunt.free[name][1]
        if name in hunt.free
        else path.values.number(name) == start.values.number(name)
        for name in path.values.numbers
    )
    if inside and hunt.free:
        find = from_cycle(hunt, path.values, path.cycle)
        if find.status is SearchStatus.FOUND:
            return replace(find, detail=f"{path.ending} {find.detail}".strip())
        return find
    return Find(status=SearchStatus.NO_GUESS, detail=path.ending)


def _differing(values: ParameterValues, other: ParameterValues) -> dict[str, float]:
    return {n: value for n, value in values.numbers.items() if value != other.number(n)}


def from_cycle(hunt: Hunt, values: ParameterValues, cycle: Cycle) -> Find:
    """Search from one simulated period."""
    objective = hunt.objective
    if isinstance(objective, WantedPeriod | WantedAmplitude):
        return toward(hunt, values, cycle, objective)
    held = replace(hunt, free={})
    nearest = isinstance(objective, NearestGains)
    if nearest and all(values.number(n) == v for n, v in objective.target.items()):
        # Nothing is nearer than the target itself: its gains need no freedom.
        here = held.refine(values, cycle, objective)
        if not hunt.bounds or not hunt.free:
            return here
    find = hunt.refine(values, cycle, objective)
    if find.status is SearchStatus.FOUND or not hunt.free:
        return find
    if hunt.bounds:
        values, cycle, lacking = where_bounds_are_kept(hunt, values, cycle)
        if lacking is not None:
            return replace(
                find,
                status=lacking.status,
                detail=lacking.detail,
                orbit=None,
                shortfall=lacking.shortfall,
            )
    hunt.tell(f"walking toward {objective.wish}")
    walked = in_small_steps(hunt, values, cycle, objective)
    if walked.status is SearchStatus.FOUND:
        return walked
    if nearest and not hunt.bounds:
        # Nearness is a wish, the orbit the point: keep the one at the gains of the start.
        here = held.refine(values, cycle, objective)
        if here.status is SearchStatus.FOUND:
            return replace(here, detail="Its gains are not the nearest: the way there was lost.")
    return find


def in_small_steps(hunt: Hunt, values: ParameterValues, cycle: Cycle, objective: Objective) -> Find:
    """Search on boxes around one orbit after another, then on the whole box."""
    origin = values

    def solve(near: Hunt, here: ParameterValues, around: Cycle) -> Find:
        return near.solve_once(origin, here, around, objective, COARSE)

    stop = walk(hunt, values, cycle, solve)
    return hunt.refine(stop.values, stop.cycle, objective, origin)


def where_bounds_are_kept(
    hunt: Hunt, values: ParameterValues, cycle: Cycle
) -> tuple[ParameterValues, Cycle, Find | None]:
    """Walk to where the bounds are passed least; say by how much, if any is passed there.

    It is the least near where the walk began: another start may come nearer.
    """
    hunt.tell("looking for where the bounds are kept")
    origin = values

    def solve(near: Hunt, here: ParameterValues, around: Cycle) -> Find:
        return near.least_violation(origin, here, around)

    stop = walk(hunt, values, cycle, solve)
    if stop.find is None or stop.find.solution is None:
        return values, cycle, None
    solved = stop.find.solution.values
    slacks = [float(solved[f"slack {k}"][0, 0]) for k in range(len(hunt.bounds))]
    broken = [
        f"`{bound.name}` leaves {bound.text} by {float(solved[f'excess {k}'][0, 0]):.3g}"
        for k, bound in enumerate(hunt.bounds)
        if slacks[k] > _VIOLATED
    ]
    if not broken or not stop.arrived:
        return stop.values, stop.cycle, None
    where = listed({name: stop.values.number(name) for name in hunt.free})
    detail = f"No orbit was found that keeps all bounds; nearest to it, at {where}"
    lacking = Find(
        status=SearchStatus.NOT_SOLVED,
        detail=f"{detail}{_held(hunt, stop.values)}, {', '.join(broken)}.",
        shortfall=sum(slacks),
    )
    return stop.values, stop.cycle, lacking


def toward(
    hunt: Hunt, values: ParameterValues, cycle: Cycle, wanted: WantedPeriod | WantedAmplitude
) -> Find:
    """Reach a wanted value: directly if it is near, else through values on the way.

    The way goes down the squared distance from the value, so that where no step brings it nearer
    the answer is no.
    """
    far = abs(wanted.measured(cycle) - wanted.target) / wanted.target
    if far <= hunt.settings.first_step:
        hunt.tell(f"asking for {wanted.wish}")
        find = hunt.refine(values, cycle, wanted)
        if find.status is SearchStatus.FOUND:
            return find
    hunt.tell(f"walking toward {wanted.wish}")
    approach = Approach(wanted=wanted)

    def solve(near: Hunt, here: ParameterValues, around: Cycle) -> Find:
        return near.solve_once(values, here, around, approach, COARSE)

    stop = walk(hunt, values, cycle, solve)
    here = wanted.measured(stop.cycle)
    if abs(here - wanted.target) > hunt.settings.smallest_step * wanted.target:
        return _short_of(hunt, wanted, here, stop.values, stop.find)
    hunt.tell(f"asking for {wanted.wish}")
    find = hunt.refine(stop.values, stop.cycle, wanted, values)
    if find.status is not SearchStatus.FOUND:
        # The nearest numbers of that value may be far along its level line.
        find = hunt.refine(stop.values, stop.cycle, wanted, stop.values)
    if find.status is SearchStatus.FOUND:
        return find
    return replace(_short_of(hunt, wanted, here, stop.values, find), detail=find.detail)


def _short_of(
    hunt: Hunt,
    wanted: WantedPeriod | WantedAmplitude,
    here: float,
    values: ParameterValues,
    last: Find | None,
) -> Find:
    """Return a failure that says how near a wanted value came, and what held it."""
    at = listed(hunt.numbers(values))
    reached = f"The nearest that was reached is {replace(wanted, target=here).wish}, at {at}"
    detail = f"{reached}{_held(hunt, values)}"
    miss = abs(wanted.target - here)
    return replace(
        last or Find(status=SearchStatus.NOT_SOLVED),
        status=SearchStatus.NOT_SOLVED,
        detail=f"{detail}; missed: `{wanted.wish}` by {miss:.3g}. {_why(last)}".strip(),
        orbit=None,
        shortfall=miss,
    )


def _held(hunt: Hunt, values: ParameterValues) -> str:
    """Return which free numbers are at a bound of their box, in brackets."""
    held = [
        f"{name} at its bound {bound:g}"
        for name, bounds in hunt.free.items()
        for bound in bounds
        if abs(values.number(name) - bound) <= _AT_BOUND * (bounds[1] - bounds[0])
    ]
    return f" ({', '.join(held)})" if held else ""


def _why(last: Find | None) -> str:
    return "" if last is None or last.agreement < ON_THE_WAY else last.detail
