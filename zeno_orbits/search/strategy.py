"""The ways from a start to an orbit: a simulation, a known orbit, or a path from an easier place.

What is asked is then reached directly, step by step through wanted values on the way, or by first
making the violation of the bounds as small as may be.
"""

from __future__ import annotations

from dataclasses import replace

from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.model.problem import Setting
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
    setting = start.setting
    if start.known is not None:
        known = start.known
        path = follow(hunt, known.setting, known.start, setting, known.shape)
        return _along(hunt, start, path, "the known orbit")
    cycle, reason = simulated(hunt, setting)
    if cycle is not None:
        find = from_cycle(hunt, setting, cycle)
        if find.status is SearchStatus.FOUND or hunt.free:
            return find
    else:
        where = f"At {listed(hunt.numbers(setting))}, " if hunt.numbers(setting) else ""
        detail = f"{where}{reason}."
        find = Find(status=SearchStatus.NO_GUESS, detail=detail[0].upper() + detail[1:])
    return _by_an_easier_way(hunt, start, find)


def simulated(hunt: Hunt, setting: Setting) -> tuple[Cycle | None, str]:
    """Return a period to which the scene settles, or why there is none."""
    dynamics = hunt.dynamics(setting)
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
        if easy == start.setting:
            continue
        hunt.tell(f"following orbits from {listed(_differing(easy, start.setting))}")
        cycle, _ = simulated(hunt, easy)
        if cycle is None:
            continue
        path = follow(hunt, easy, cycle.start.state, start.setting, cycle.shape)
        if path.cycle is None:
            continue
        reached = _along(hunt, start, path, listed(_differing(easy, start.setting)))
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
        return from_cycle(hunt, start.setting, path.cycle)
    inside = all(
        hunt.free[name][0] <= path.setting.number(name) <= hunt.free[name][1]
        if name in hunt.free
        else path.setting.number(name) == start.setting.number(name)
        for name in (*path.setting.gains, *path.setting.parameters)
    )
    if inside and hunt.free:
        find = from_cycle(hunt, path.setting, path.cycle)
        if find.status is SearchStatus.FOUND:
            return replace(find, detail=f"{path.ending} {find.detail}".strip())
        return find
    return Find(status=SearchStatus.NO_GUESS, detail=path.ending)


def _differing(setting: Setting, other: Setting) -> dict[str, float]:
    names = (*setting.gains, *setting.parameters)
    return {n: setting.number(n) for n in names if setting.number(n) != other.number(n)}


def from_cycle(hunt: Hunt, setting: Setting, cycle: Cycle) -> Find:
    """Search from one simulated period."""
    objective = hunt.objective
    if isinstance(objective, WantedPeriod | WantedAmplitude):
        return toward(hunt, setting, cycle, objective)
    held = replace(hunt, free={})
    nearest = isinstance(objective, NearestGains)
    if nearest and all(setting.number(n) == v for n, v in objective.target.items()):
        # Nothing is nearer than the target itself: its gains need no freedom.
        here = held.refine(setting, cycle, objective)
        if not hunt.bounds or not hunt.free:
            return here
    find = hunt.refine(setting, cycle, objective)
    if find.status is SearchStatus.FOUND or not hunt.free:
        return find
    if hunt.bounds:
        setting, cycle, lacking = where_bounds_are_kept(hunt, setting, cycle)
        if lacking is not None:
            return replace(
                find,
                status=lacking.status,
                detail=lacking.detail,
                orbit=None,
                shortfall=lacking.shortfall,
            )
    hunt.tell(f"walking toward {objective.wish}")
    walked = in_small_steps(hunt, setting, cycle, objective)
    if walked.status is SearchStatus.FOUND:
        return walked
    if nearest and not hunt.bounds:
        # Nearness is a wish, the orbit the point: keep the one at the gains of the start.
        here = held.refine(setting, cycle, objective)
        if here.status is SearchStatus.FOUND:
            return replace(here, detail="Its gains are not the nearest: the way there was lost.")
    return find


def in_small_steps(hunt: Hunt, setting: Setting, cycle: Cycle, objective: Objective) -> Find:
    """Search on boxes around one orbit after another, then on the whole box."""
    origin = setting

    def solve(near: Hunt, here: Setting, around: Cycle) -> Find:
        return near.solve_once(origin, here, around, objective, COARSE)

    stop = walk(hunt, setting, cycle, solve)
    return hunt.refine(stop.setting, stop.cycle, objective, origin)


def where_bounds_are_kept(
    hunt: Hunt, setting: Setting, cycle: Cycle
) -> tuple[Setting, Cycle, Find | None]:
    """Walk to where the bounds are passed least; say by how much, if any is passed there.

    It is the least near where the walk began: another start may come nearer.
    """
    hunt.tell("looking for where the bounds are kept")
    origin = setting

    def solve(near: Hunt, here: Setting, around: Cycle) -> Find:
        return near.least_violation(origin, here, around)

    stop = walk(hunt, setting, cycle, solve)
    if stop.find is None or stop.find.solution is None:
        return setting, cycle, None
    values = stop.find.solution.values
    slacks = [float(values[f"slack {k}"][0, 0]) for k in range(len(hunt.bounds))]
    broken = [
        f"`{bound.name}` leaves {bound.text} by {float(values[f'excess {k}'][0, 0]):.3g}"
        for k, bound in enumerate(hunt.bounds)
        if slacks[k] > _VIOLATED
    ]
    if not broken or not stop.arrived:
        return stop.setting, stop.cycle, None
    where = listed({name: stop.setting.number(name) for name in hunt.free})
    detail = f"No orbit was found that keeps all bounds; nearest to it, at {where}"
    lacking = Find(
        status=SearchStatus.NOT_SOLVED,
        detail=f"{detail}{_held(hunt, stop.setting)}, {', '.join(broken)}.",
        shortfall=sum(slacks),
    )
    return stop.setting, stop.cycle, lacking


def toward(
    hunt: Hunt, setting: Setting, cycle: Cycle, wanted: WantedPeriod | WantedAmplitude
) -> Find:
    """Reach a wanted value: directly if it is near, else through values on the way.

    The way goes down the squared distance from the value, so that where no step brings it nearer
    the answer is no.
    """
    far = abs(wanted.measured(cycle) - wanted.target) / wanted.target
    if far <= hunt.settings.first_step:
        hunt.tell(f"asking for {wanted.wish}")
        find = hunt.refine(setting, cycle, wanted)
        if find.status is SearchStatus.FOUND:
            return find
    hunt.tell(f"walking toward {wanted.wish}")
    approach = Approach(wanted=wanted)

    def solve(near: Hunt, here: Setting, around: Cycle) -> Find:
        return near.solve_once(setting, here, around, approach, COARSE)

    stop = walk(hunt, setting, cycle, solve)
    here = wanted.measured(stop.cycle)
    if abs(here - wanted.target) > hunt.settings.smallest_step * wanted.target:
        return _short_of(hunt, wanted, here, stop.setting, stop.find)
    hunt.tell(f"asking for {wanted.wish}")
    find = hunt.refine(stop.setting, stop.cycle, wanted, setting)
    if find.status is not SearchStatus.FOUND:
        # The nearest numbers of that value may be far along its level line.
        find = hunt.refine(stop.setting, stop.cycle, wanted, stop.setting)
    if find.status is SearchStatus.FOUND:
        return find
    return replace(_short_of(hunt, wanted, here, stop.setting, find), detail=find.detail)


def _short_of(
    hunt: Hunt,
    wanted: WantedPeriod | WantedAmplitude,
    here: float,
    setting: Setting,
    last: Find | None,
) -> Find:
    """Return a failure that says how near a wanted value came, and what held it."""
    at = listed(hunt.numbers(setting))
    reached = f"The nearest that was reached is {replace(wanted, target=here).wish}, at {at}"
    detail = f"{reached}{_held(hunt, setting)}"
    miss = abs(wanted.target - here)
    return replace(
        last or Find(status=SearchStatus.NOT_SOLVED),
        status=SearchStatus.NOT_SOLVED,
        detail=f"{detail}; missed: `{wanted.wish}` by {miss:.3g}. {_why(last)}".strip(),
        orbit=None,
        shortfall=miss,
    )


def _held(hunt: Hunt, setting: Setting) -> str:
    """Return which free numbers are at a bound of their box, in brackets."""
    held = [
        f"{name} at its bound {bound:g}"
        for name, bounds in hunt.free.items()
        for bound in bounds
        if abs(setting.number(name) - bound) <= _AT_BOUND * (bounds[1] - bounds[0])
    ]
    return f" ({', '.join(held)})" if held else ""


def _why(last: Find | None) -> str:
    return "" if last is None or last.agreement < ON_THE_WAY else last.detail
