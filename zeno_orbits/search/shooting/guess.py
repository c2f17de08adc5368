"""First guesses by simulation: simulate a motion until its attractor is classified."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, RunawayError, SimulationError, any_number
from zeno_orbits.integrators import Tolerance
from zeno_orbits.model import HybridDynamics, Problem, own_time
from zeno_orbits.orbits import (
    Cycle,
    EventSequence,
    cycle_of,
    cycles,
    place_on_section,
    to_next_release,
)
from zeno_orbits.search.shooting.recurrence import Recurrence, Recurring
from zeno_orbits.simulation import (
    OSCILLATIONS,
    WAITING,
    Execution,
    Mode,
    SimulationSettings,
    ZenoExtrapolation,
    bounds_of,
    growth_of,
    has_left,
    is_still,
    simulate,
)
from zeno_orbits.work import require_kinds

_DIFFERENCE = 1e-6
"""Relative step of a difference quotient. Its error affects only a small correction."""
_SMALL = 1e-3
"""Smallest size of a state, in units of the largest state."""

_SHARE = 1 / 3
"""Part of the time limit that every start has, however long earlier starts took."""

_LOOK = 6
"""Oscillations, or turns of the clock, between two checks of a motion without releases."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TransientSettings:
    """Limits of the simulation of a motion until it repeats.

    Attributes:
        horizon: Longest simulated time from one start [s]. The default is about one hundred turns
            of the problem's clock, or periods of its slowest oscillation.
        chunk: Longest simulated time between two checks [s]. The motion is also checked at every
            release. If it does not return to its release within this time, the time is doubled.
            The default is a few turns or oscillations.
        settled: Relative change of the release state over a period that counts as repeating.
        usable: Largest relative change with which the last period still serves as a guess.
        simulation: Accuracy, looser than for a verification.
    """

    horizon: float | None = None
    chunk: float | None = None
    settled: float = 1e-6
    usable: float = 0.1
    simulation: SimulationSettings = field(
        default_factory=lambda: SimulationSettings(
            tolerance=Tolerance(relative=1e-8, absolute=1e-10),
            completion=ZenoExtrapolation(tolerance=1e-11),
        )
    )

    def __post_init__(self) -> None:
        """Reject time limits that are not positive."""
        require_kinds(self)
        for name, time in (("until", self.horizon), ("chunk", self.chunk)):
            if time is not None and not 0.0 < any_number(name, time) < math.inf:
                wanted = "must be a finite, positive number of seconds"
                raise InputError(f"Argument `{name}` {wanted}, but it is {time:g}.")


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowedMotion:
    """Result of the simulation of a motion until it repeats.

    Attributes:
        cycle: Last period of the motion, if usable as a guess.
        reason: Reason of a missing period, as a clause. Empty with a period.
        waited: Simulated time [s].
        undecided: True if the motion had not converged at the time limit.
    """

    cycle: Cycle | None
    reason: str = ""
    waited: float = 0.0
    undecided: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class _Watch:
    """Limits of the simulation, as values.

    Attributes:
        settings: Accuracy of the simulation, with the bounds of the coordinates.
        settled: As in `TransientSettings`.
        usable: As in `TransientSettings`.
        horizon: Longest simulated time [s].
        chunk: Longest simulated time between two checks [s].
        turn: A turn of the clock or longer [s]. A motion that is at rest for so long stays at rest.
        phrases: Name of a coordinate to the description of its divergence.
    """

    settings: SimulationSettings
    settled: float
    usable: float
    horizon: float
    chunk: float
    turn: float
    phrases: Mapping[str, str]


def run_to_attractor(
    dynamics: HybridDynamics,
    starts: Sequence[Vector | tuple[float, ...]],
    settings: TransientSettings | None = None,
    shape: EventSequence | None = None,
    problem: Problem | None = None,
) -> FollowedMotion:
    """Return the last period of the first start whose motion repeats.

    Args:
        dynamics: The system.
        starts: Initial states, tried in order.
        settings: Limits of the simulation.
        shape: The shape of the period. The default is the shape of the attractor. If the attractor
            has a different shape, the result is the earlier period of this shape that came nearest
            to repeating.
        problem: The problem, with its divergence limits, units and clock.
    """
    settings = settings or TransientSettings()
    wanted = None if shape is None else shape.at_restitution(dynamics.restitution)
    reasons: list[str] = []
    waited, undecided = 0.0, False
    for start in starts:
        state = np.array(start, dtype=np.float64)
        watch = _watch(dynamics, state, settings, problem)
        left = max(watch.horizon - waited, _SHARE * watch.horizon)
        settling = _settle_from(dynamics, state, replace(watch, horizon=left), wanted)
        if settling.cycle is not None:
            return settling
        reasons.append(settling.reason)
        waited += settling.waited
        undecided |= settling.undecided
    reason = " / ".join(dict.fromkeys(reasons))
    return FollowedMotion(cycle=None, reason=reason, undecided=undecided)


def _watch(
    dynamics: HybridDynamics, state: Vector, settings: TransientSettings, problem: Problem | None
) -> _Watch:
    """Return the limits for the motion from a state, in the problem's characteristic scales."""
    own, turns, far, phrases = own_time(dynamics, state), OSCILLATIONS, math.inf, {}
    if problem is not None:
        declared = {name: escape.beyond for name, escape in problem.escapes.items()}
        bounds = bounds_of(problem.state_names, problem.state_units, dynamics.n_q, declared)
        far = tuple(bounds[: dynamics.n_q].tolist())
        phrases = {name: escape.phrase for name, escape in problem.escapes.items()}
        turns = WAITING if problem.compiled().clock else OSCILLATIONS
    return _Watch(
        settings=replace(settings.simulation, far=far),
        settled=settings.settled,
        usable=settings.usable,
        horizon=turns * own if settings.horizon is None else settings.horizon,
        chunk=_LOOK * own if settings.chunk is None else settings.chunk,
        turn=own,
        phrases=phrases,
    )


def _settle_from(
    dynamics: HybridDynamics, state: Vector, watch: _Watch, wanted: EventSequence | None
) -> FollowedMotion:
    """Return the last period of the motion from a state, or the reason of a missing period."""
    n_q, names = dynamics.n_q, dynamics.state_names
    elapsed, at_release, patience, still, held = 0.0, False, watch.chunk, 0.0, 0.0
    recurrence = Recurrence(settled=watch.settled, wanted=wanted)
    speeds: list[float] = []
    rates, position = np.zeros(len(state) - len(dynamics.clock)), np.abs(state[:n_q])
    while elapsed < watch.horizon:
        try:
            run = _to_next_look(dynamics, state, watch, patience, at_release=at_release)
        except RunawayError as error:
            phrase = watch.phrases.get(error.coordinate, error.reason)
            return FollowedMotion(cycle=None, reason=phrase)
        except SimulationError as error:
            clause = error.reason[0].lower() + error.reason[1:]
            return FollowedMotion(cycle=None, reason=f"the simulation fails: {clause}")
        found = cycles(run, start=state if at_release else None)
        recurrence = recurrence.after(run, found, since=elapsed)
        elapsed += run.end_time
        if at_release and not run.releases:
            # The next time limit is twice as long, for motions that return later.
            patience *= 2
        speeds += [-cycle.impacts[0].approach_rate for cycle in found]
        settled = recurrence.settled_to()
        if settled is not None and wanted in (None, settled.shape):
            return _period(dynamics, settled, watch.settings)
        if settled is not None:
            break
        if found and growth_of(speeds).dies_out:
            return FollowedMotion(cycle=None, reason="the motion decays")
        now = _rates(dynamics, run.end_state, locked=run.arcs[-1].mode is Mode.LOCKED)
        rates = np.max([rates, now, *_rates_at_impacts(dynamics, run)], axis=0)
        quiet = run.end_time if not run.events else -math.inf
        still = still + quiet if is_still(now[None, None], rates[None])[0] else 0.0
        if still >= watch.turn:
            return FollowedMotion(cycle=None, reason="the motion comes to rest")
        held = held + quiet if run.arcs[-1].mode is Mode.LOCKED else 0.0
        still, held = max(still, 0.0), max(held, 0.0)
        if elapsed < watch.horizon / 2:
            position = np.maximum(position, np.abs(run.end_state[:n_q]))
        at_release = bool(run.releases) and run.releases[-1].time == run.end_time
        state = run.releases[-1].state if at_release else run.end_state
        state = back_on_constraints(dynamics, state, locked=run.arcs[-1].mode is Mode.LOCKED)
    nearest = recurrence.nearest(watch.usable)
    if nearest is not None:
        return _period(dynamics, nearest, watch.settings)
    left = has_left(state[:n_q], position)
    if np.any(left):
        return FollowedMotion(cycle=None, reason=f"{names[int(np.argmax(left))]} runs away")
    if held > watch.horizon / 2:
        return FollowedMotion(
            cycle=None, reason=f"the motion stays on its stop for {held:.4g} s", waited=elapsed
        )
    undecided = recurrence.settled_to() is None
    return FollowedMotion(cycle=None, reason=recurrence.reason(watch.horizon), undecided=undecided)


def _period(
    dynamics: HybridDynamics, found: Recurring, settings: SimulationSettings
) -> FollowedMotion:
    """Return the period: simulated again, unless the motion contains it in one piece."""
    if found.cycle is not None:
        return FollowedMotion(cycle=found.cycle)
    start = back_on_constraints(
        dynamics, place_on_section(dynamics, found.shape, found.start), locked=False
    )
    try:
        cycle = cycle_of(dynamics, start, found.shape, horizon=2 * found.period, settings=settings)
    except SimulationError as error:
        return FollowedMotion(cycle=None, reason=error.reason[0].lower() + error.reason[1:])
    return FollowedMotion(cycle=cycle)


def _to_next_look(
    dynamics: HybridDynamics, state: Vector, watch: _Watch, patience: float, *, at_release: bool
) -> Execution:
    """Return the execution up to the next release, or over a chunk without a release."""
    if at_release:
        return to_next_release(dynamics, state, horizon=patience, settings=watch.settings)
    return simulate(dynamics, state, until=watch.chunk, releases=1, settings=watch.settings)


def back_on_constraints(dynamics: HybridDynamics, state: Vector, *, locked: bool) -> Vector:
    """Project a state onto the stop and the constraints, from which a loose integration drifts.

    The projection onto the constraints is a Newton step of least length in units of the
    characteristic sizes of the states. Its derivatives are difference quotients.

    Args:
        dynamics: The system.
        state: A state, ``(n_x,)``.
        locked: True if the state is on the stop.
    """
    state = dynamics.on_stop(state) if locked else state
    off = dynamics.holonomic(state)
    if off.size == 0:
        return state
    scale = dynamics.own.not_small(np.abs(state), _SMALL)
    steps = _DIFFERENCE * np.diag(scale)
    slopes = [(dynamics.holonomic(state + step) - off) / _DIFFERENCE for step in steps]
    return state - scale * np.linalg.lstsq(np.array(slopes).T, off, rcond=None)[0]


def _rates(dynamics: HybridDynamics, state: Vector, *, locked: bool) -> Vector:
    """Return the absolute rates of all states except the clock."""
    mode = dynamics.locked if locked else dynamics.free
    return np.delete(np.abs(mode.rate(state)), dynamics.clock)


def _rates_at_impacts(dynamics: HybridDynamics, run: Execution) -> list[Vector]:
    return [_rates(dynamics, one.state_minus, locked=False) for one in run.impacts[:1]]
