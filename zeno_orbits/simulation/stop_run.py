"""A run at the stop that it looks at: arcs, impacts, Zeno points and releases."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import PenetrationError
from zeno_orbits.integrators import FlowWithEvent, SteppedTrajectory, Trajectory
from zeno_orbits.model import CharacteristicScales, HybridDynamics
from zeno_orbits.simulation.arc_follower import ArcFollower, ArcStart
from zeno_orbits.simulation.event_rules import closes_at_once, enters_stop, stop_holds
from zeno_orbits.simulation.events import Event, Impact, Release, ZenoPoint
from zeno_orbits.simulation.execution import Arc, Ending, Mode
from zeno_orbits.simulation.interruptions import (
    does_not_accumulate,
    does_not_close,
    enters_by_reset,
    restitution_beyond,
)
from zeno_orbits.simulation.settings import SimulationSettings
from zeno_orbits.simulation.small_hops import SmallHop, small_hop
from zeno_orbits.simulation.zeno.zeno_limit import TailEstimate, ZenoLimit, join, tail_from

_STEADY = 1e-9
"""Part of the problem's own rate of the multiplier below which that decides nothing."""
_BRIEF = 1e-12
"""Duration of a flight, in units of the problem's own time, that is rounding."""
_ABOVE = 1e-6
"""Relative threshold of the scaled gap at a flight's end, above which the stop was reached
unexpectedly."""


def is_slack(dynamics: HybridDynamics, x: Vector, lift: float, contact: float) -> bool:
    """Return True if the stop neither holds nor repels a state on it, to rounding.

    Args:
        dynamics: The system.
        x: The state, ``(n_x,)``.
        lift: Its gap acceleration.
        contact: Relative threshold below which an acceleration counts as zero.
    """
    if abs(lift) <= contact * dynamics.own.gap_acceleration:
        return True
    if not lift > 0.0:
        return False
    largest = float(np.max(np.abs(x[: dynamics.n_q])))
    rate, inertia = dynamics.multiplier_rate(x), dynamics.normal_inertia(x)
    if dynamics.restitution == 0.0 and 3.0 * lift * inertia > _BRIEF * dynamics.own.time * rate:
        # After a plastic impact the flight is followed in its own time, however low it is.
        return False
    return closes_at_once(lift, rate, inertia, largest)


@dataclass(slots=True, kw_only=True)
class ImpactSequence:
    """A sequence of impacts.

    Attributes:
        place: What its impacts have in common.
        first_impact: Number of impacts before its second impact.
        estimates: The Zeno point to first order from its impacts.
    """

    place: object
    first_impact: int
    estimates: list[TailEstimate] = field(default_factory=list[TailEstimate])


@dataclass(slots=True, kw_only=True)
class StopRun(ABC):
    """A running execution, with the transition after each event of one stop.

    `ReferenceRun` adds modes, other stops and switches. Every method returns the start of the next
    arc, or ``None`` at the end of the execution.

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
        stop_name: Name of the stop in events.
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
    stop_name: str = ""
    own: CharacteristicScales = field(init=False)
    small_gap: float = field(init=False)
    small_rate: float = field(init=False)

    def __post_init__(self) -> None:
        """Look at the stop of the system."""
        self.see(self.dynamics)

    def see(self, dynamics: HybridDynamics) -> None:
        """Take a system, and the quantities that every event at its stop needs.

        Args:
            dynamics: The system.
        """
        self.dynamics = self.follower.dynamics = dynamics
        self.own = dynamics.own
        self.small_gap = self.settings.contact * self.own.gap
        self.small_rate = self.settings.contact * self.own.gap_rate

    @property
    def has_flown(self) -> bool:
        """True if an arc has been followed."""
        return bool(self.arcs)

    @property
    def reached(self) -> float:
        """Time that the arcs have reached [s]."""
        return self.arcs[-1].end_time if self.arcs else 0.0

    def locked_arc(self, start: ArcStart) -> ArcStart | None:
        """Follow the constrained flow to the release, where the multiplier falls through zero."""
        slack = self._is_slack(start.state, self.dynamics.gap_acceleration(start.state))
        try:
            arc, _ = self.follow_arc(start, self.dynamics.locked, Ending.RELEASE, on_guard=slack)
        except PenetrationError as error:
            return self._in_other_mode(start, error)
        if not self.reaches(arc, Ending.RELEASE):
            return self.interrupted(start, arc)
        return self.release(arc.end_time, arc.end_state)

    def release(self, time: float, x: Vector) -> ArcStart | None:
        """Record a release, and return the start of the flight after it.

        Args:
            time: Time of the event [s].
            x: State at the end of the contact, ``(n_x,)``.
        """
        state = self.dynamics.on_stop(x)
        self.events.append(Release(time=time, state=state, stop=self.stop_name))
        self.n_releases += 1
        if self.n_releases >= self.most_releases:
            return None
        return ArcStart(mode=Mode.FREE, time=time, state=state)

    def free_flight(self, start: ArcStart) -> ArcStart | None:
        """Follow the free flow from a start or a release to an impact."""
        dynamics, x = self.dynamics, start.state
        released = dynamics.gap(x) <= self.small_gap
        if released and self._throws_back(x) and (hop := self._small_hop(x)) is not None:
            return self._hop(start, hop)
        # A flight that is under way has left its gap of zero.
        on_guard = released and not self.is_under_way(x)
        try:
            arc, _ = self.follow_arc(start, dynamics.free, Ending.IMPACT, on_guard=on_guard)
        except PenetrationError as error:
            # A flight that is lower than the rounding of the gap may explain it.
            if (hop := self._small_hop(x)) is None:
                return self._in_other_mode(start, error)
            return self._hop(start, hop, error)
        if not self.reaches(arc, Ending.IMPACT):
            return self.interrupted(start, arc)
        return self.meet(arc.end_time, arc.end_state, dynamics.gap_rate(arc.end_state))

    @abstractmethod
    def is_under_way(self, x: Vector) -> bool:
        """Return True if a flight from the stop has left its gap of zero at a state."""

    def meet(self, time: float, x: Vector, rate: float) -> ArcStart | None:
        """Return the next start where the gap closes: the stop is struck, or only touched.

        Args:
            time: Time of the event [s].
            x: State there, ``(n_x,)``.
            rate: Gap rate there. If it is within rounding, the stop is touched.
        """
        if abs(rate) <= self.small_rate:
            return self.on_stop(time, self.dynamics.on_stop(x))
        return self.landing(time, x, rate)

    def _throws_back(self, x: Vector) -> bool:
        """Return True if a state is thrown off the stop by a force that falls at once.

        It is so after a plastic impact, while a current layer decays.
        """
        lift = self.dynamics.gap_acceleration(x)
        is_thrown = lift > self.settings.contact * self.own.gap_acceleration
        return is_thrown and self.dynamics.multiplier_rate(x) > 0.0

    def _small_hop(self, x: Vector) -> SmallHop | None:
        """Return the flight from a state at rest on the stop that is as low as rounding."""
        dynamics = self.dynamics
        rests = dynamics.gap(x) <= self.small_gap and abs(dynamics.gap_rate(x)) <= self.small_rate
        least = -self.settings.contact * self.own.gap_acceleration
        if not (rests and dynamics.gap_acceleration(x) >= least):
            return None
        return small_hop(dynamics, x, self.settings.tolerance.relative)

    def _hop(
        self, start: ArcStart, hop: SmallHop, error: PenetrationError | None = None
    ) -> ArcStart | None:
        """Follow a flight that is as low as the rounding of the gap.

        Args:
            start: Its start.
            hop: The flight.
            error: Error of the free flow, of which the flight may be the reason.
        """
        launched = replace(start, speed=hop.duration, hop=hop)
        flight = self.dynamics.flight(hop.duration)
        try:
            arc, end = self.follow_arc(launched, flight, Ending.IMPACT, on_guard=True)
        except PenetrationError as own:
            return self._in_other_mode(start, error or own)
        if not self.reaches(arc, Ending.IMPACT):
            return self.interrupted(start, arc)
        return self.landing(arc.end_time, arc.end_state, hop.duration * float(end[-1]))

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

    @abstractmethod
    def reaches(self, arc: Arc, natural: Ending) -> bool:
        """Return True if an arc ended at the event of the stop that the run looks at."""

    @abstractmethod
    def interrupted(self, start: ArcStart, arc: Arc) -> ArcStart | None:
        """Return the next start after an arc that ended otherwise.

        Args:
            start: Start of the arc.
            arc: The arc.
        """

    def landing(self, time: float, state: Vector, rate: float) -> ArcStart | None:
        """Apply the impact at the end of a flight, or fly on from a graze.

        Args:
            time: When the gap closes [s].
            state: State at that time, ``(n_x,)``.
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
            SimulationError: If the gap does not close, if the restitution leaves [0, 1] at this
                speed, or if the reset sends the state into the stop.
        """
        dynamics = self.dynamics
        if not approach_rate < 0.0:
            raise does_not_close(approach_rate, time, state_minus)
        landed = dynamics.landed(state_minus, approach_rate)
        state_plus = landed.state_plus
        speed = dynamics.speed_after(approach_rate)
        if dynamics.restitution_at is not None and not 0.0 <= speed <= -approach_rate:
            raise restitution_beyond(speed, approach_rate, self.stop_name, time, state_minus)
        if enters_stop(landed.gap_rate, approach_rate, self.own.gap_rate):
            raise enters_by_reset(time, state_minus)
        impact = Impact(
            time=time,
            state_minus=state_minus,
            state_plus=state_plus,
            approach_rate=approach_rate,
            stop=self.stop_name,
        )
        self.events.append(impact)
        self.n_impacts += 1
        if self.has_flown:
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
                self.reach(ZenoLimit(time=time, state=state, error=0.0), impact, 0.0)
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

    def after_impact(
        self, sequence: ImpactSequence, start: ArcStart, speed: float
    ) -> ArcStart | None:
        """Go to the Zeno point if the impacts so far determine it, else follow one flight.

        Args:
            sequence: The sequence of impacts.
            start: Start of the flight.
            speed: Gap rate there.

        Raises:
            ChatterError: If the sequence has too many impacts.
        """
        if self.estimated(start, speed, sequence):
            zeno = self.zeno_point(start, speed, sequence)
            if zeno is not None:
                return zeno
        if self.n_impacts - sequence.first_impact > self.settings.most_impacts:
            raise does_not_accumulate(self.settings.most_impacts, start.time, start.state)
        return self.rescaled_flight(start, speed)

    @property
    @abstractmethod
    def beside(self) -> frozenset[int]:
        """The switches of dry friction in the last flight between impacts."""

    def limit_of(self, estimates: Sequence[TailEstimate]) -> ZenoLimit | None:
        """Return the Zeno point of a sequence, or ``None`` if more impacts are to be resolved."""
        return self.settings.completion.limit(self.dynamics, estimates)

    @abstractmethod
    def is_clear(self, limit: ZenoLimit) -> bool:
        """Return True if no other event can occur on the way to a Zeno point."""

    def rescaled_flight(self, start: ArcStart, speed: float) -> ArcStart | None:
        """Follow one rescaled flight from an impact to the next (theory (2.6))."""
        on_guard = start.height <= self.settings.contact / self.own.gap_acceleration
        flight = self.dynamics.flight(speed)
        arc, end = self.follow_arc(start, flight, Ending.IMPACT, on_guard=on_guard)
        if not self.reaches(arc, Ending.IMPACT):
            return self.interrupted(start, arc)
        if end[-2] > _ABOVE * abs(end[-1]) * arc.duration:
            self.arcs.pop()
            return self.free_flight(replace(start, speed=None, height=0.0, launch=1.0))
        return self.landing(arc.end_time, arc.end_state, speed * float(end[-1]))

    def estimated(self, start: ArcStart, speed: float, sequence: ImpactSequence) -> bool:
        """Estimate the Zeno point from an impact, and return True if that is possible."""
        if start.impact is None or start.resting is None:
            return False
        if sequence.estimates and speed >= sequence.estimates[-1].speed:
            sequence.estimates = []
        estimate = tail_from(start.resting, self.dynamics.restitution, start.time, speed)
        known = sequence.estimates
        sequence.estimates = [] if estimate is None else join(known, estimate, self.beside)
        return estimate is not None

    def zeno_point(
        self, start: ArcStart, speed: float, sequence: ImpactSequence
    ) -> ArcStart | None:
        """Return the start of the contact phase if the impacts so far determine the Zeno point."""
        limit = self.limit_of(sequence.estimates)
        if limit is None or limit.time >= self.follower.until or not self.is_clear(limit):
            return None
        after = self.on_stop(limit.time, limit.state)
        if after.mode is Mode.FREE:
            return None
        # An estimate belongs to an impact.
        assert start.impact is not None
        self.reach(limit, start.impact, speed)
        return self.after_zeno_point(after)

    def after_zeno_point(self, after: ArcStart) -> ArcStart | None:
        """Return the start of the contact after a Zeno point.

        Args:
            after: The start, at the Zeno state.
        """
        return after

    def reach(self, limit: ZenoLimit, last: Impact, last_speed: float) -> None:
        """Record a Zeno point, and the tail that leads to it as an arc without steps."""
        self.events.append(
            ZenoPoint(
                time=limit.time,
                state=limit.state,
                limit_error=limit.error,
                tail=limit.time - last.time,
                last_speed=last_speed,
                stop=self.stop_name,
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
        return is_slack(self.dynamics, x, lift, self.settings.contact)

    def follow_arc(
        self, start: ArcStart, flow: FlowWithEvent, natural: Ending, *, on_guard: bool
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
