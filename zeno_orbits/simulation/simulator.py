"""Completed executions, event by event: flights, impacts, Zeno point, locked arc, release, again.

A flight after an impact is integrated in the scaled variables of theory (14), so none is missed
and none invented however slow the impact was. Source: [OrAmes2011]_ for the completion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ChatterError, InputError, PenetrationError, SimulationError
from zeno_orbits.integrators import (
    Automatic,
    Engine,
    GuardedFlow,
    SteppedTrajectory,
    Tolerance,
    Trajectory,
)
from zeno_orbits.model import HybridDynamics, OwnScale, constraint_sizes
from zeno_orbits.simulation.arc_follower import ArcFollower, ArcStart
from zeno_orbits.simulation.completion import Completion, ZenoPassage
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
from zeno_orbits.simulation.zeno_limit import TailEstimate, ZenoLimit, tail_from
from zeno_orbits.work import Progress, silent

_OFF = 1e-9
"""Part of a constraint's size by which an admissible state may miss it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulationSettings:
    """Accuracy and limits of a simulation.

    Attributes:
        engine: The integrator.
        tolerance: Its local error.
        completion: How a Zeno point is reached.
        contact: A gap, gap rate or gap acceleration below this part of the problem's own counts
            as zero.
        far: A coordinate beyond this ends the execution with an error: one bound for all
            coordinates, or one for each.
        most_impacts: Impacts in one sequence before it is given up.
        most_steps: Steps of all arcs before the execution is given up; each is kept for dense
            output, at about 400 bytes.
    """

    engine: Engine = field(default_factory=Automatic)
    tolerance: Tolerance = field(default_factory=Tolerance)
    completion: Completion = field(default_factory=ZenoPassage)
    contact: float = 1e-12
    far: float | tuple[float, ...] = math.inf
    most_impacts: int = 100_000
    most_steps: int = 2_000_000


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
        dynamics: The system at fixed numbers.
        state: Initial state, ``(n_x,)``, at time 0.
        until: When to stop [s].
        releases: Stop earlier, at this many releases; never by default.
        impacts: Stop earlier, just after this many impacts that end flights; likewise.
        settings: Accuracy; the defaults aim at 1e-11 a period.
        on_progress: Called with the part of the time that is simulated.

    Raises:
        InputError: If the state is not admissible or the horizon is not a positive number.
        SimulationError: If the execution cannot be continued; it says where and why, and holds
            what came before.
    """
    if not (math.isfinite(until) and until > 0.0):
        raise InputError(
            f"Argument `until` must be a positive number of seconds, but it is {until}."
        )
    chosen = settings or SimulationSettings()
    run = _Run(
        dynamics=dynamics,
        settings=chosen,
        follower=ArcFollower(
            dynamics=dynamics,
            engine=chosen.engine,
            tolerance=chosen.tolerance.times(dynamics.own.least),
            until=until,
            contact=chosen.contact,
            far=chosen.far,
            most_steps=chosen.most_steps,
        ),
        most_releases=math.inf if releases is None else releases,
        most_impacts=math.inf if impacts is None else impacts,
    )
    start = run.admitted(np.array(state, dtype=np.float64))
    try:
        while start is not None:
            start = run.after_phase(start)
            reached = run.arcs[-1].end_time if run.arcs else 0.0
            on_progress("simulating", reached / until)
    except SimulationError as error:
        error.execution = run.execution() if run.arcs else None
        raise
    return run.execution()


@dataclass(slots=True, kw_only=True)
class _Run:
    """One execution in the making: what each event leads to.

    Every method returns where the next arc starts, or ``None`` at the end of the execution.

    Attributes:
        dynamics: The system.
        settings: Accuracy.
        follower: What follows its arcs, until the end of the time.
        most_releases: Releases at which it ends.
        most_impacts: Impacts that end flights, likewise.
        arcs: Arcs so far.
        events: Events so far.
        n_impacts: Impacts among them.
        n_landings: Those that ended a flight: all but one that the execution starts with.
        n_releases: Releases among them.
        own: Sizes of the problem's numbers.
        small_gap: A gap below this counts as zero.
        small_rate: A gap rate below this does.
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
    own: OwnScale = field(init=False)
    small_gap: float = field(init=False)
    small_rate: float = field(init=False)

    def __post_init__(self) -> None:
        """Look up what every event asks for."""
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

    def admitted(self, x: Vector) -> ArcStart | None:
        """Return the first start.

        Raises:
            InputError: If the state is not admissible; it says why.
        """
        dynamics, small, small_rate = self.dynamics, self.small_gap, self.small_rate
        names = dynamics.state_names
        if x.shape != (len(names),):
            message = (
                f"Argument `state` must have {len(names)} entries, but its shape is {x.shape}."
            )
            raise InputError(message)
        if not np.all(np.isfinite(x)):
            raise InputError("Argument `state` must be finite, but it holds NaN or infinity.")
        self._require_constraints(x)
        gap, rate = dynamics.gap(x), dynamics.gap_rate(x)
        if gap < -small:
            raise InputError(f"Argument `state` must have a gap >= 0, but it is {gap:.6g}.")
        if gap > small:
            return ArcStart(mode=Mode.FREE, time=0.0, state=x)
        if rate > small_rate:
            return ArcStart(mode=Mode.FREE, time=0.0, state=x, speed=rate)
        if rate < -small_rate:
            return self.impact(0.0, x, rate)
        return self.on_stop(0.0, dynamics.on_stop(x))

    def _require_constraints(self, x: Vector) -> None:
        """Refuse a state off its constraints, relative to what the problem's own sizes change.

        Raises:
            InputError: With how far it is off.
        """
        dynamics = self.dynamics
        off = np.abs(dynamics.holonomic(x))
        if dynamics.own.least == 1.0 and not np.any(off > _OFF):
            return
        if not np.any(off > _OFF * constraint_sizes(dynamics, x)):
            return
        if dynamics.clock and off[-1] > _OFF:
            names = " and ".join(f"`{dynamics.state_names[k]}`" for k in dynamics.clock)
            seen = " and ".join(f"{x[k]:g}" for k in dynamics.clock)
            message = f"must have {names} on the unit circle, as a clock, but they are {seen}"
            first = dynamics.state_names[dynamics.clock[0]]
            raise InputError(f"Argument `state` {message}; a turn starts with {first}=1.")
        message = "Argument `state` must keep the holonomic constraints, but it is off by"
        raise InputError(f"{message} {float(np.max(off)):.3g}.")

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
        arc, _ = self._arc(start, self.dynamics.locked, Ending.RELEASE, on_guard=slack)
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
        arc, _ = self._arc(start, self.dynamics.free, Ending.IMPACT, on_guard=released)
        if arc.ending is Ending.HORIZON:
            return None
        rate = self.dynamics.gap_rate(arc.end_state)
        if abs(rate) <= self.small_rate:
            # The gap closes no faster than rounding: the stop is touched, not struck.
            return self.on_stop(arc.end_time, self.dynamics.on_stop(arc.end_state))
        return self.landing(arc.end_time, arc.end_state, rate)

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
        """Apply the reset map and return what follows it, if anything is to.

        Args:
            time: Time of the impact [s].
            state_minus: State before it, ``(n_x,)``.
            approach_rate: Gap rate before it, exactly.

        Raises:
            SimulationError: If the gap does not close, or the reset sends the state into the stop.
        """
        dynamics = self.dynamics
        if not approach_rate < 0.0:
            raise SimulationError(
                f"An impact must close the gap, but the gap rate is {approach_rate:.3g}",
                time=time,
                state=tuple(state_minus.tolist()),
            )
        landed = dynamics.landed(state_minus, approach_rate)
        state_plus = landed.state_plus
        speed = dynamics.speed_after(approach_rate)
        if enters_stop(landed.gap_rate, approach_rate, self.own.gap_rate):
            raise PenetrationError(
                "The reset map sends the state into the stop",
                time=time,
                state=tuple(state_minus.tolist()),
            )
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
                # The stop lets go: whatever is left of the speed, the flight is the free flow's.
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
        lift = self.dynamics.gap_acceleration(x)
        slack = self._is_slack(x, lift)
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
                raise ChatterError(
                    f"More than {self.settings.most_impacts} impacts came without a Zeno point",
                    time=here.time,
                    state=tuple(here.state.tolist()),
                )
            here = self.rescaled_flight(here, here.speed)
        return here

    def rescaled_flight(self, start: ArcStart, speed: float) -> ArcStart | None:
        """Follow one rescaled flight from an impact to the next (theory (14))."""
        flight = self.dynamics.flight(speed)
        arc, end = self._arc(start, flight, Ending.IMPACT, on_guard=True)
        if arc.ending is Ending.HORIZON:
            return None
        return self.landing(arc.end_time, arc.end_state, speed * float(end[-1]))

    def _zeno_point(
        self, start: ArcStart, speed: float, estimates: list[TailEstimate]
    ) -> ArcStart | None:
        """Return the start of the locked arc if the impacts so far tell the Zeno point."""
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
                    trajectory=self._tail_of(limit, last.time),
                )
            )

    @staticmethod
    def _tail_of(limit: ZenoLimit, start: float) -> Trajectory | None:
        """Return the way to a limit if it was followed, along the curve of the impacts."""
        if not limit.path:
            return None
        return SteppedTrajectory(steps=limit.path, duration=limit.time - start, end=limit.state)

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
            start: Where it starts; its speed makes it a rescaled flight.
            flow: The flow.
            natural: What the guard means.
            on_guard: The start is a root of the guard that does not count.
        """
        arc, end = self.follower.follow(
            start, flow, natural, impact_index=self.n_impacts, on_guard=on_guard
        )
        self.arcs.append(arc)
        return arc, end
