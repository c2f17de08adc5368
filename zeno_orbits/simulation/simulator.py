"""Completed executions, event by event: flights, impacts, Zeno point, locked arc, release, again.

A flight after an impact is integrated in the scaled variables of theory (14), so none is missed
and none invented however slow the impact was. Source: [OrAmes2011]_ for the completion.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, PenetrationError, SimulationError, any_number
from zeno_orbits.integrators import GuardedFlow, SteppedTrajectory, Trajectory
from zeno_orbits.loop import loop_library
from zeno_orbits.model import HybridDynamics, OwnScale
from zeno_orbits.simulation.admission import require_admissible
from zeno_orbits.simulation.arc_follower import ArcFollower, ArcStart
from zeno_orbits.simulation.event_rules import closes_at_once, enters_stop, stop_holds
from zeno_orbits.simulation.execution import (
    Arc,
    Ending,
    Event,
    Execution,
    Impact,
    Mode,
    Release,
    ZenoPoint,
)
from zeno_orbits.simulation.interruptions import (
    does_not_accumulate,
    does_not_close,
    enters_by_reset,
)
from zeno_orbits.simulation.looped import by_loop, pieces_by_loop, serves
from zeno_orbits.simulation.pieces import Piece
from zeno_orbits.simulation.settings import SimulationSettings, SimulationTask
from zeno_orbits.simulation.small_hops import hop_duration
from zeno_orbits.simulation.zeno_limit import TailEstimate, ZenoLimit, tail_from
from zeno_orbits.work import Progress, silent

_STEADY = 1e-9
"""Part of the problem's own rate of the multiplier below which that decides nothing."""
_ABOVE = 1e-6
"""Relative threshold of the scaled gap at a flight's end, above which the stop was reached
unexpectedly."""


def simulate(
    dynamics: HybridDynamics,
    state: Sequence[float] | Vector,
    *,
    until: float,
    releases: int | None = None,
    impacts: int | None = None,
    settings: SimulationSettings | None = None,
    on_progress: Progress = silent,
) -> Execution:
    """Return the completed execution from an admissible state, locked or free.

    Args:
        dynamics: The system at fixed parameter values.
        state: Initial state, ``(n_x,)``, at time 0.
        until: End time [s].
        releases: Number of releases after which to stop, by default unlimited.
        impacts: Number of impacts that end a flight, after which to stop, by default unlimited.
        settings: Accuracy. The defaults aim at an error of 1e-11 per period.
        on_progress: Called with the simulated part of the time.

    Raises:
        InputError: If the state is not admissible or the horizon is not a positive number.
        SimulationError: If the execution cannot be continued. The error contains time, cause and
            the execution so far.
    """
    if not 0.0 < any_number("until", until) < math.inf:
        raise InputError(
            f"Argument `until` must be a positive number of seconds, but it is {until}."
        )
    task = SimulationTask(
        dynamics=dynamics,
        state=np.array(state, dtype=np.float64),
        until=until,
        most_releases=math.inf if releases is None else releases,
        most_impacts=math.inf if impacts is None else impacts,
        settings=settings or SimulationSettings(),
        on_progress=on_progress,
    )
    return by_loop(task) if serves(task) else by_reference(task)


def simulator_in_use() -> str:
    """Return the name of the simulator of this process, for the identity of work that is kept.

    The loop and the reference agree to rounding, not in every digit (`docs/compiled_code.md`).
    """
    return "Python" if loop_library() is None else "loop"


def by_reference(task: SimulationTask) -> Execution:
    """Return the completed execution, followed in Python: the reference of the compiled loop.

    Args:
        task: The simulation task.

    Raises:
        InputError: If the state is not admissible.
        SimulationError: If the execution cannot be continued.
    """
    run = _run_of(task)
    start = run.admitted(task.state)
    try:
        while start is not None:
            start = run.after_phase(start)
            reached = run.arcs[-1].end_time if run.arcs else 0.0
            task.on_progress("simulating", reached / task.until)
    except SimulationError as error:
        error.execution = run.execution() if run.arcs else None
        raise
    return run.execution()


def pieces(task: SimulationTask) -> Iterator[Piece]:
    """Yield the completed execution in pieces, for callers that may stop early.

    Args:
        task: The simulation task.

    Raises:
        InputError: If the state is not admissible.
        SimulationError: If the execution cannot be continued, after the piece before that.
    """
    return pieces_by_loop(task) if serves(task) else pieces_by_reference(task)


def pieces_by_reference(task: SimulationTask) -> Iterator[Piece]:
    """Yield the completed execution phase by phase, followed in Python.

    Args:
        task: The simulation task.

    Raises:
        InputError: If the state is not admissible.
        SimulationError: If the execution cannot be continued, after the piece before that.
    """
    run, n_x = _run_of(task), len(task.dynamics.state_names)
    start = run.admitted(task.state, checked=not task.goes_on)
    interruption: SimulationError | None = None
    while start is not None and interruption is None:
        before = start
        try:
            start = run.after_phase(start)
        except SimulationError as error:
            interruption = error
        yield _piece(run, start, before, n_x)
        run.arcs, run.events = run.arcs[-1:], []
    if interruption is not None:
        raise interruption


def _piece(run: _Run, start: ArcStart | None, before: ArcStart, n_x: int) -> Piece:
    """Return the piece of a run in a phase, with the present state.

    Args:
        run: The run, with the arcs and events of the phase.
        start: Start of the next phase, if there is a next phase.
        before: Start of the phase.
        n_x: Number of states.
    """
    ways = [arc.trajectory for arc in run.arcs if arc.trajectory is not None]
    states = [state[:n_x] for way in ways for state in way.states[1:]]
    last = run.arcs[-1] if run.arcs else None
    now = start or before
    ended = start is None and last is not None
    return Piece(
        events=list(run.events),
        states=np.reshape(states, (-1, n_x)),
        time=last.end_time if ended and last is not None else now.time,
        state=last.end_state if ended and last is not None else now.state,
        locked=(last.mode if ended and last is not None else now.mode) is Mode.LOCKED,
    )


def _run_of(task: SimulationTask) -> _Run:
    """Return a run at its start."""
    dynamics, chosen = task.dynamics, task.settings
    return _Run(
        dynamics=dynamics,
        settings=chosen,
        follower=ArcFollower(
            dynamics=dynamics,
            engine=chosen.engine,
            tolerance=chosen.tolerance.times(dynamics.own.least),
            until=task.until,
            contact=chosen.contact,
            far=chosen.far,
            most_steps=chosen.most_steps,
        ),
        most_releases=task.most_releases,
        most_impacts=task.most_impacts,
    )


@dataclass(slots=True, kw_only=True)
class _Run:
    """A running execution, with the transition after each event.

    Every method returns the start of the next arc, or ``None`` at the end of the execution.

    Attributes:
        dynamics: The system.
        settings: Accuracy.
        follower: Integrator of the arcs until the end of the time.
        most_releases: Number of releases after which the execution ends.
        most_impacts: Number of impacts that end a flight, after which the execution ends.
        arcs: Arcs so far.
        events: Events so far.
        n_impacts: Number of impacts so far.
        n_landings: Number of impacts that ended a flight, so without an impact at the start of the
            execution.
        n_releases: Number of releases so far.
        refused: Time of the last start in a mode that ended immediately [s].
        own: Characteristic scales of the problem.
        small_gap: A gap below this counts as zero.
        small_rate: A gap rate below this counts as zero.
    """

    dynamics: HybridDynamics
    settings: SimulationSettings
    follower: ArcFollower
    most_releases: float
    most_impacts: float
    arcs: list[Arc] = field(default_factory=list[Arc])
    events: list[Event] = field(default_factory=list[Event])
    n_impacts: int = 0
    n_landings: int = 0
    n_releases: int = 0
    refused: float = -1.0
    own: OwnScale = field(init=False)
    small_gap: float = field(init=False)
    small_rate: float = field(init=False)

    def __post_init__(self) -> None:
        """Look up the quantities that every event needs."""
        self.own = self.dynamics.own
        self.small_gap = self.settings.contact * self.own.gap
        self.small_rate = self.settings.contact * self.own.gap_rate

    def execution(self) -> Execution:
        """Return the execution so far."""
        names = self.dynamics.state_names
        return Execution(
            state_names=names,
            arcs=tuple(self.arcs),
            events=tuple(self.events),
            own=self.own,
        )

    def admitted(self, x: Vector, *, checked: bool = True) -> ArcStart | None:
        """Return the first start.

        Args:
            x: State, ``(n_x,)``.
            checked: Whether to check that the state is admissible.

        Raises:
            InputError: If the state is not admissible. The message contains the reason.
        """
        dynamics, small, small_rate = self.dynamics, self.small_gap, self.small_rate
        gap = require_admissible(dynamics, x, small) if checked else dynamics.gap(x)
        rate = dynamics.gap_rate(x)
        if gap > small:
            return ArcStart(mode=Mode.FREE, time=0.0, state=x)
        if rate > small_rate:
            return ArcStart(mode=Mode.FREE, time=0.0, state=x, speed=rate)
        if rate < -small_rate:
            return self.impact(0.0, x, rate)
        return self.on_stop(0.0, dynamics.on_stop(x))

    def after_phase(self, start: ArcStart) -> ArcStart | None:
        """Follow a locked arc, a flight, or a sequence of impacts to its Zeno point."""
        if start.mode is Mode.LOCKED:
            return self.locked_arc(start)
        if start.speed is None:
            return self.free_flight(start)
        return self.impact_sequence(start)

    def locked_arc(self, start: ArcStart) -> ArcStart | None:
        """Follow the locked flow to the release, where the multiplier falls through zero."""
        slack = self._is_slack(start.state, self.dynamics.gap_acceleration(start.state))
        try:
            arc, _ = self._arc(start, self.dynamics.locked, Ending.RELEASE, on_guard=slack)
        except PenetrationError as error:
            return self._in_other_mode(start, error)
        if arc.ending is Ending.HORIZON:
            return None
        state = self.dynamics.on_stop(arc.end_state)
        self.events.append(Release(time=arc.end_time, state=state))
        self.n_releases += 1
        if self.n_releases >= self.most_releases:
            return None
        return ArcStart(mode=Mode.FREE, time=arc.end_time, state=state)

    def free_flight(self, start: ArcStart) -> ArcStart | None:
        """Follow the free flow from a start or a release to an impact."""
        released = self.dynamics.gap(start.state) <= self.small_gap
        try:
            arc, _ = self._arc(start, self.dynamics.free, Ending.IMPACT, on_guard=released)
        except PenetrationError as error:
            return self._hop(start, error)
        if arc.ending is Ending.HORIZON:
            return None
        rate = self.dynamics.gap_rate(arc.end_state)
        if abs(rate) <= self.small_rate:
            # The gap closes no faster than rounding: the stop is touched, not struck.
            return self.on_stop(arc.end_time, self.dynamics.on_stop(arc.end_state))
        return self.landing(arc.end_time, arc.end_state, rate)

    def _hop(self, start: ArcStart, error: PenetrationError) -> ArcStart | None:
        """Follow a flight that is lower than the rounding of the gap, if that explains an error."""
        slack = self._is_slack(start.state, self.dynamics.gap_acceleration(start.state))
        if not slack or (duration := hop_duration(self.dynamics, start.state)) is None:
            return self._in_other_mode(start, error)
        launched = replace(start, speed=duration, at_rest=True)
        flight = self.dynamics.flight(duration)
        try:
            arc, end = self._arc(launched, flight, Ending.IMPACT, on_guard=True)
        except PenetrationError:
            return self._in_other_mode(start, error)
        if arc.ending is Ending.HORIZON:
            return None
        return self.landing(arc.end_time, arc.end_state, duration * float(end[-1]))

    def _in_other_mode(self, start: ArcStart, error: PenetrationError) -> ArcStart:
        """Return a start on the stop in the other mode: the flow itself decides which one holds.

        The first derivative that is not zero has one sign in the multiplier, the other in the gap.

        Raises:
            PenetrationError: If both are left at once, or multiplier and rate are not zero.
        """
        x, own = start.state, self.own
        steady = abs(self.dynamics.multiplier_rate(x)) <= _STEADY * own.multiplier / own.time
        slack = self._is_slack(x, self.dynamics.gap_acceleration(x))
        if self.refused == start.time or not (steady and slack):
            raise error
        self.refused = start.time
        return replace(start, mode=Mode.FREE if start.mode is Mode.LOCKED else Mode.LOCKED)

    def landing(self, time: float, state: Vector, rate: float) -> ArcStart | None:
        """Apply the impact at the end of a flight, or fly on from a graze.

        Args:
            time: When the gap closes [s].
            state: State there, ``(n_x,)``.
            rate: Gap rate there. Dense output may see a fall where the steps, a rounding later,
                find the gap opening again.
        """
        if rate > 0.0:
            return ArcStart(mode=Mode.FREE, time=time, state=state, speed=rate)
        return self.impact(time, state, rate)

    def impact(self, time: float, state_minus: Vector, approach_rate: float) -> ArcStart | None:
        """Apply the reset map and return the next start, if the execution continues.

        Args:
            time: Time of the impact [s].
            state_minus: State before it, ``(n_x,)``.
            approach_rate: Exact gap rate before the impact.

        Raises:
            SimulationError: If the gap does not close, or the reset sends the state into the stop.
        """
        dynamics = self.dynamics
        if not approach_rate < 0.0:
            raise does_not_close(approach_rate, time, state_minus)
        landed = dynamics.landed(state_minus, approach_rate)
        state_plus = landed.state_plus
        speed = dynamics.speed_after(approach_rate)
        if enters_stop(landed.gap_rate, approach_rate, self.own.gap_rate):
            raise enters_by_reset(time, state_minus)
        impact = Impact(
            time=time,
            state_minus=state_minus,
            state_plus=state_plus,
            approach_rate=approach_rate,
        )
        self.events.append(impact)
        self.n_impacts += 1
        if self.arcs:
            self.n_landings += 1
            if self.n_landings >= self.most_impacts:
                return None
        if speed <= self.small_rate:
            state = landed.state
            after = self.on_stop(time, state)
            if after.mode is Mode.FREE:
                # Contact ends: the flight follows the free flow, for any remaining speed.
                return after
            if speed == 0.0:
                self._reach(ZenoLimit(time=time, state=state, error=0.0), impact, 0.0)
                return after
        return ArcStart(
            mode=Mode.FREE,
            time=time,
            state=state_plus,
            speed=speed,
            impact=impact,
            resting=landed,
        )

    def on_stop(self, time: float, x: Vector) -> ArcStart:
        """Return the mode that holds on the stop at zero gap rate: locked, or released at once."""
        slack = self._is_slack(x, lift := self.dynamics.gap_acceleration(x))
        rate = self.dynamics.multiplier_rate(x) if slack else math.nan
        holds = stop_holds(lift, rate, slack)
        return ArcStart(mode=Mode.LOCKED if holds else Mode.FREE, time=time, state=x)

    def impact_sequence(self, start: ArcStart) -> ArcStart | None:
        """Follow a sequence of impacts to its Zeno point, or until it turns into a free flight."""
        estimates: list[TailEstimate] = []
        first = self.n_impacts
        here: ArcStart | None = start
        while here is not None and here.speed is not None:
            zeno = self._zeno_point(here, here.speed, estimates)
            if zeno is not None:
                return zeno
            if self.n_impacts - first > self.settings.most_impacts:
                raise does_not_accumulate(self.settings.most_impacts, here.time, here.state)
            here = self.rescaled_flight(here, here.speed)
        return here

    def rescaled_flight(self, start: ArcStart, speed: float) -> ArcStart | None:
        """Follow one rescaled flight from an impact to the next (theory (14))."""
        arc, end = self._arc(start, self.dynamics.flight(speed), Ending.IMPACT, on_guard=True)
        if arc.ending is Ending.HORIZON:
            return None
        if end[-2] > _ABOVE * abs(end[-1]) * arc.duration:
            self.arcs.pop()
            return self.free_flight(replace(start, speed=None))
        return self.landing(arc.end_time, arc.end_state, speed * float(end[-1]))

    def _zeno_point(
        self, start: ArcStart, speed: float, estimates: list[TailEstimate]
    ) -> ArcStart | None:
        """Return the start of the locked arc if the impacts so far determine the Zeno point."""
        if start.impact is None or start.resting is None:
            return None
        if estimates and speed >= estimates[-1].speed:
            estimates.clear()
        estimate = tail_from(start.resting, self.dynamics.restitution, start.time, speed)
        if estimate is None:
            estimates.clear()
            return None
        estimates.append(estimate)
        limit = self.settings.completion.limit(self.dynamics, estimates)
        if limit is None or limit.time >= self.follower.until:
            return None
        after = self.on_stop(limit.time, limit.state)
        if after.mode is Mode.FREE:
            return None
        self._reach(limit, start.impact, speed)
        return after

    def _reach(self, limit: ZenoLimit, last: Impact, last_speed: float) -> None:
        """Record a Zeno point, and the tail that leads to it as an arc without steps."""
        self.events.append(
            ZenoPoint(
                time=limit.time,
                state=limit.state,
                limit_error=limit.error,
                tail=limit.time - last.time,
                last_speed=last_speed,
            )
        )
        if limit.time > last.time:
            self.arcs.append(
                Arc(
                    mode=Mode.FREE,
                    start_time=last.time,
                    end_time=limit.time,
                    start_state=self.dynamics.on_stop(last.state_plus),
                    end_state=limit.state,
                    ending=Ending.ZENO,
                    impact_index=self.n_impacts,
                    time_unit=1.0,
                    trajectory=_tail_of(limit, last.time),
                )
            )

    def _is_slack(self, x: Vector, lift: float) -> bool:
        """Return True if the stop neither holds nor repels a state on it, to rounding.

        Args:
            x: The state, ``(n_x,)``.
            lift: Its gap acceleration.
        """
        if abs(lift) <= self.settings.contact * self.own.gap_acceleration:
            return True
        if not lift > 0.0:
            return False
        return closes_at_once(
            lift,
            self.dynamics.multiplier_rate(x),
            self.dynamics.normal_inertia(x),
            float(np.max(np.abs(x[: self.dynamics.n_q]))),
        )

    def _arc(
        self, start: ArcStart, flow: GuardedFlow, natural: Ending, *, on_guard: bool
    ) -> tuple[Arc, Vector]:
        """Return the next arc, recorded, and the last state of the flow itself.

        Args:
            start: Start of the arc. With a speed the flight is rescaled.
            flow: The flow.
            natural: Kind of ending at a zero crossing of the guard.
            on_guard: Whether the start is a root of the guard that does not count.
        """
        arc, end = self.follower.follow(
            start, flow, natural, impact_index=self.n_impacts, on_guard=on_guard
        )
        self.arcs.append(arc)
        return arc, end


def _tail_of(limit: ZenoLimit, start: float) -> Trajectory | None:
    """Return the way to a limit if it was followed, along the curve of the impacts."""
    if not limit.path:
        return None
    return SteppedTrajectory(steps=limit.path, duration=limit.time - start, end=limit.state)
