r"""The reference of the compiled loop: an execution over a graph of modes, followed in Python.

A run looks at one stop at a time. The stops that are closed beside it are constraints of both its
flows. Along the steps of an arc every guard is followed: the gaps of the open stops, the
multipliers of the closed stops, and the switches. The earliest zero ends the arc. A flight after an
impact is integrated in the scaled variables of theory (2.6), so none is missed and none invented
however slow the impact was. Source: [OrAmes2011]_ for the completion.

While a set `S` of stops is closed, an impact on the stop `k` has the impulses :math:`p` of `k` and
:math:`\Lambda \ge 0` of `S` with

.. math:: G_{SS}\,\Lambda + G_{Sk}\,p \ge 0,\qquad \Lambda \perp (G_{SS}\,\Lambda + G_{Sk}\,p),
    \qquad G = J W J^\top

A stop whose impulse would be negative opens. `G` is positive definite, so there is one solution.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from itertools import combinations
from typing import cast

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import PenetrationError, SimulationError, StepSizeError
from zeno_orbits.integrators import (
    LEAVES,
    BoxedStep,
    Engine,
    FlowWithEvent,
    Segment,
    SegmentResult,
    SteppedTrajectory,
    Termination,
    follow_steps,
)
from zeno_orbits.model import (
    PER_PART,
    START_OFF,
    CharacteristicScales,
    GraphDynamics,
    GraphMode,
    HybridDynamics,
    require_start,
)
from zeno_orbits.simulation.accumulations import Accumulations
from zeno_orbits.simulation.arc_follower import ArcFollower, ArcStart, launched
from zeno_orbits.simulation.event_rules import ROUNDING, rounding_of, stop_holds
from zeno_orbits.simulation.events import EventKind, Impact, Release, SwitchEvent, ZenoPoint
from zeno_orbits.simulation.execution import Arc, Ending, Execution, Mode, closed_names
from zeno_orbits.simulation.interruptions import (
    accumulate_together,
    armed_at_start,
    coincide,
    enters_by_switch,
    flow_ends,
    leaves_set,
    slides,
    switches_accumulate,
    switches_too_often,
    undefined_guard,
    undetermined_contact,
)
from zeno_orbits.simulation.recorded import LoopTrajectory
from zeno_orbits.simulation.settings import SimulationTask
from zeno_orbits.simulation.stop_run import ImpactSequence, StopRun, is_slack
from zeno_orbits.simulation.zeno.completion import ZenoExtrapolation, ZenoPassage
from zeno_orbits.simulation.zeno.zeno_limit import TailEstimate, ZenoLimit, speeds_excess

_APART = 1e-11
"""Times of two events differ at least by this part of the problem's time."""
_AT_ONCE = ROUNDING
"""The same of impacts on stops that are not coupled, over the problem's time and their own time."""
_OF_FLIGHT = 1e-6
"""Part of a rescaled flight by which its impact and another event differ at least."""
_CONTINUOUS = 1e-6
"""Relative difference of gap accelerations on both sides of a kink, below which it is continuous.
"""
_GROW, _SHORTEST = 4.0, 1e-3
"""Next window over the previous arc or window, and the shortest window over the problem's time."""
_SPENT = 1e3
"""Rounding levels below zero to which a guard may be at a Zeno point."""
_LEAST_IMPULSE = 1e-12
"""Impulse or rate of a closed stop in an impact that counts as zero, over the largest."""
_BEFORE = 1e-9
"""Part of a window that is left out where the flow of a branch ends to exist."""
_NEAR_KINK = 1e6
"""Distance of a singular state from a kink, in rounding levels of its condition."""
_SPLIT, _SPLIT_RESOLVED = 1e-8, 1e-4
"""Largest error of a Zeno point whose flights are split by a kink, and the part of the first speed
from which it is accepted."""
_SLOW_BESIDE, _LEAST_BESIDE = 1e-7, 1e-10
"""Speeds over the problem's own of impacts beside dry friction. Below the first, the limit need not
be slow by the first speed of the sequence. Below the second there is no limit."""
_ACCUMULATED = 1e-3
"""Part of the first speed of a sequence below which its impacts accumulate."""


_ONE_SURFACE = 1e-6
"""Relative difference between the slopes of two kinks, over their rates, that is rounding."""
_SHIFT = 1e-6
"""Relative shift of a state by which slopes of kinks along closed stops are found."""
_SAME = 1e-9
"""Relative difference of two flows that is rounding."""
_LOW, _SLOW = 1e-9, 3e-5
"""Gap and gap rate over the problem's own, below which a flight beside another has few digits."""
_LOST = 1e-5
"""Part of the height of a flight that rounding may take from it, where impacts come in turn."""
_LEFT = 4.0
"""Gap over the gap that an event left at its stop, below which it is the rounding of that event."""
_COUPLED = 1e-12
"""Entry of `J W J^T`, over the roots of its diagonal entries, above which two stops are coupled."""


class Kind(Enum):
    """Kinds of guards."""

    GAP = EventKind.IMPACT.label
    MULTIPLIER = EventKind.RELEASE.label
    SWITCH = EventKind.SWITCH.label


@dataclass(frozen=True, slots=True, kw_only=True)
class _WayToRest:
    """How a stop comes to rest at a constant gap acceleration.

    Attributes:
        time: Time to its Zeno point [s].
        lift: The gap acceleration, negative.
        speed: Speed of its next impact.
        rebound: Speed after that impact.
        rounding: Error of the time by the rounding of the gap [s].
    """

    time: float
    lift: float
    speed: float
    rebound: float
    rounding: float


@dataclass(frozen=True, slots=True)
class _Guard:
    """A guard beside the guard of the stop that a run looks at.

    Attributes:
        kind: Its kind.
        index: Index of the stop or switch.
        flow: The flow of the mode with this guard.
        y: Start of the flow.
        launched: Speed with which another stop is just left, or ``None``. Its flight is followed in
            rescaled time. All other guards are followed along the steps of the arc.
        on_guard: Whether the start is a root that does not count.
        rounding: Rounding level of the guard.
    """

    kind: Kind
    index: int
    flow: FlowWithEvent
    y: Vector
    launched: float | None
    on_guard: bool
    rounding: float


@dataclass(frozen=True, slots=True)
class _AlongArc:
    """A guard of a state along an arc, whose flow may have further entries and its own time.

    Attributes:
        flow: The flow with the guard.
        n_x: Number of states.
        unit: Length of one unit of the arc's own time [s].
    """

    flow: FlowWithEvent
    n_x: int
    unit: float

    def guard(self, y: Vector) -> tuple[float, float]:
        """Return the guard and its rate in the arc's own time."""
        value, rate = self.flow.guard(y[: self.n_x])
        return value, rate * self.unit

    @property
    def is_bounded(self) -> bool:
        """True if the guard varies otherwise than the state, and its bounds are known."""
        return self.flow.is_bounded

    @property
    def is_carried(self) -> bool:
        """False: the guard is a formula, not a further state."""
        return False

    def guard_bounds(self, lower: Vector, upper: Vector) -> Sequence[float]:
        """Return bounds of the guard, its rate and its second derivative over a box of states."""
        n_x, unit = self.n_x, self.unit
        low, high, *rates = self.flow.guard_bounds(lower[:n_x], upper[:n_x])
        slow, fast, bend, most_bend = rates
        square = unit * unit
        return low, high, slow * unit, fast * unit, bend * square, most_bend * square


@dataclass(frozen=True, slots=True, kw_only=True)
class Interruption:
    """An event that ends an arc before the event of the stop that a run looks at.

    Attributes:
        kind: Kind of the guard that fell.
        index: Index of its stop or switch.
        passage: The flow up to its zero, or ``None`` if the arc began on the wrong side of it.
        launched: Gap rate at the start of the flight, if the flight is rescaled.
        cut: Whether the guard of another event, which is of no account, fell first by rounding.
    """

    kind: Kind
    index: int
    passage: SegmentResult | None
    launched: float | None = None
    cut: bool = False


@dataclass(slots=True, kw_only=True)
class ReferenceRun(StopRun):
    """A running execution over a graph of modes.

    Attributes:
        graph: The graph.
        rest: The closed stops beside the stop that the run looks at.
        focus: The stop that the run looks at.
        sides: Side of every kink, True where its condition is positive.
        above: For each declared switch, whether its guard is positive.
        interruption: The event that ended the present arc early.
        current: The sequence of impacts that a kink may have split.
        split_by: The kinks and switches of dry friction that split the last flight of that
            sequence, and the present flight.
        window: Time in which the next event is first looked for [s].
        flipped: Time of the last start on the wrong side of a switch, and the switches then.
        n_switches: Number of declared switches so far.
        together: The stops that open at the end of the last arc, if there are several.
        past: The switch that has just occurred at the start, as in `SimulationTask.past_switch`.
        seen: The last impacts and switches, by which accumulations are recognized.
    """

    graph: GraphDynamics
    rest: tuple[int, ...] = ()
    focus: int = 0
    sides: tuple[bool, ...] = ()
    above: tuple[bool, ...] = ()
    interruption: Interruption | None = None
    current: ImpactSequence | None = None
    split_by: tuple[frozenset[int], frozenset[int]] = (frozenset(), frozenset())
    window: float = np.inf
    flipped: tuple[float, frozenset[int]] = (math.nan, frozenset())
    n_switches: int = 0
    together: tuple[int, ...] = ()
    past: int = 0
    seen: Accumulations = field(default_factory=Accumulations)

    @classmethod
    def of(cls, task: SimulationTask, engine: Engine | None = None) -> ReferenceRun:
        """Return the run of a task at its start.

        Args:
            task: The simulation task.
            engine: Integrator of the arcs, by default the integrator of the settings.
        """
        graph, chosen = task.graph, task.settings
        follower = ArcFollower(
            dynamics=graph.first,
            engine=engine or chosen.engine,
            tolerance=chosen.tolerance.times(graph.own.least),
            until=task.until,
            contact=chosen.contact,
            far=chosen.far,
            most_steps=chosen.most_steps,
        )
        return cls(
            dynamics=graph.first,
            settings=chosen,
            follower=follower,
            most_releases=task.most_releases,
            most_impacts=task.most_impacts,
            graph=graph,
            past=task.past_switch,
        )

    def execution(self) -> Execution:
        """Return the execution so far."""
        return Execution(
            state_names=self.graph.state_names,
            arcs=tuple(self.arcs),
            events=tuple(self.events),
            own=self.graph.own,
        )

    def admitted(self, x: Vector, *, checked: bool = True) -> ArcStart | None:
        """Return the first start.

        Raises:
            InputError: If the state is not admissible. The message contains the reason.
        """
        if checked:
            require_start(self.graph, x, self.settings.contact)
        self.sides = (True,) * (len(self.graph.switch_names) - self.graph.n_declared)
        self._take_sides(x)
        self.look((), 0)
        return self._placed(0.0, x, None)

    # The part at one stop, beside other stops and switches.

    @property
    def place(self) -> object:
        """The stop of the impacts of a sequence, and the stops closed beside it."""
        return self.rest, self.focus

    def sequence(self) -> ImpactSequence:
        """Return the sequence that begins, or goes on after a kink split one of its flights."""
        if self.current is None or self.current.place != self.place:
            self.current = ImpactSequence(place=self.place, first_impact=self.n_impacts)
            self.split_by = frozenset(), frozenset()
        return self.current

    def impact_sequence(self, start: ArcStart, speed: float) -> ArcStart | None:
        """Follow one flight of a sequence of impacts, or go to its Zeno point.

        Args:
            start: Start of the flight.
            speed: Gap rate there.
        """
        return self.after_impact(self.sequence(), start, speed)

    def on_stop(self, time: float, x: Vector) -> ArcStart:
        """Return the mode that holds on the stop at zero gap rate."""
        after = StopRun.on_stop(self, time, x)
        if after.mode is Mode.FREE:
            self.current = None
        return after

    def reach(self, limit: ZenoLimit, last: Impact, last_speed: float) -> None:
        """Record a Zeno point."""
        self.seen.require_no_switches(limit.time, self.stop_name, limit.state, self.own.time)
        self.seen.forget(self.stop_name)
        n_arcs = len(self.arcs)
        StopRun.reach(self, limit, last, last_speed)
        if len(self.arcs) > n_arcs:
            self.arcs[-1] = self._named(self.arcs[-1], self.rest)
        self.current = None

    def after_zeno_point(self, after: ArcStart) -> ArcStart | None:
        """Return the start of the contact after a Zeno point, at which states may be set."""
        return self._set_anew(f"zeno {self.stop_name}", after.time, after.state, after)

    def limit_of(self, estimates: Sequence[TailEstimate]) -> ZenoLimit | None:
        """Return the Zeno point. Flights that a kink splits determine it less accurately."""
        if not self.split_by[0]:
            return StopRun.limit_of(self, estimates)
        rule = self.settings.completion
        if isinstance(rule, ZenoPassage):
            # Along the curve of the impacts, no kink changes its side within a flight.
            rule = rule.one_by_one
        slow = self.beside and estimates[-1].speed <= _SLOW_BESIDE * self.own.gap_rate
        rough = ZenoExtrapolation(tolerance=_SPLIT, resolved=1.0 if slow else _SPLIT_RESOLVED)
        limit = rule.limit(self.dynamics, estimates) or rough.limit(self.dynamics, estimates)
        if limit is None:
            self._require_fast(estimates[-1])
            return None
        # A part that every impact moves has no rate at the limit.
        for s in self.graph.sticking(self.beside):
            limit = replace(limit, state=self.graph.after_switch(s, limit.state))
        return limit

    @property
    def beside(self) -> frozenset[int]:
        """The switches of dry friction in the last flight between impacts."""
        return frozenset(s for s in self.split_by[0] if s in self.graph.frictional)

    def _require_fast(self, last: TailEstimate) -> None:
        """Refuse impacts beside dry friction that are too slow for a limit.

        Raises:
            ChatterError: If the last impact is.
        """
        if self.beside and last.speed <= _LEAST_BESIDE * self.own.gap_rate:
            name = self.graph.switch_names[min(self.beside)]
            raise switches_accumulate(name, last.impact_time, last.resting)

    def reaches(self, arc: Arc, natural: Ending) -> bool:
        """Return True if an arc ended at the event of the stop that the run looks at."""
        return self.interruption is None and arc.ending is natural

    def follow_arc(
        self, start: ArcStart, flow: FlowWithEvent, natural: Ending, *, on_guard: bool
    ) -> tuple[Arc, Vector]:
        """Return the next arc, to the earliest event, and the last state of the flow itself.

        The event is first looked for within a few times the previous arc: the flow of a branch need
        not exist far beyond the zero of its kink.
        """
        follower, n_arcs = self.follower, len(self.arcs)
        window = self.window if self._has_others else math.inf
        last = follower.until - follower.late
        try:
            while True:
                follower.window = start.time + window
                if follower.window >= last:
                    follower.window = follower.until
                try:
                    arc, end = self._followed(start, flow, natural, on_guard=on_guard)
                except StepSizeError as error:
                    # Another guard may fall before the flow of this branch ends to exist.
                    del self.arcs[n_arcs:]
                    reached = (start.speed or 1.0) * error.time
                    if not self._has_others or not 0.0 < reached <= window:
                        raise self._singular(error, start.time + reached) from error
                    window = reached * (1.0 - _BEFORE)
                    follower.window = start.time + window
                    arc, end = self._followed(start, flow, natural, on_guard=on_guard)
                    if arc.ending is Ending.HORIZON and self.interruption is None:
                        raise self._singular(error, start.time + reached) from error
                if follower.window >= follower.until or arc.ending is not Ending.HORIZON:
                    break
                if self.interruption is not None and self.interruption.passage is None:
                    break
                self.arcs.pop()
                window *= _GROW
        finally:
            follower.window = math.inf
        self.window = max(_GROW * (arc.end_time - arc.start_time), _SHORTEST * self.own.time)
        return arc, end

    @property
    def _has_others(self) -> bool:
        """True if there are guards beside that of the stop."""
        return not self.graph.has_one_guard

    def _singular(self, error: StepSizeError, time: float) -> StepSizeError:
        """Return an error with the time of the execution, and a kink that is zero there."""
        x = np.array(error.state)[: len(self.dynamics.state_names)]
        guards, rounding, _ = self.graph.guards(((), self.sides), x)
        n = self.graph.n_declared
        kinks = np.flatnonzero(np.abs(guards[n:]) <= _NEAR_KINK * rounding[n:])
        name = self.graph.switch_names[n + int(kinks[0])] if kinks.size else ""
        return flow_ends(error, self.graph, time, name)

    def _followed(
        self, start: ArcStart, flow: FlowWithEvent, natural: Ending, *, on_guard: bool
    ) -> tuple[Arc, Vector]:
        """Return the next arc within the present window."""
        arc, end = StopRun.follow_arc(self, start, flow, natural, on_guard=on_guard)
        closed = self._closed(start)
        try:
            guards = list(self._guards(start, closed))
            found = self._earliest(guards, arc)
            self.interruption = self._first_of_surface(guards, found, closed, start.state.size)
        except SimulationError:
            # The arc does not reach its end.
            self.arcs.pop()
            raise
        found = self.interruption
        stop = self.stop_name if start.speed is not None else ""
        if found is None:
            self.arcs[-1] = arc = self._named(arc, closed, stop)
        elif found.passage is None:
            self.arcs.pop()
            return arc, end
        else:
            arc = self._cut(start, arc, found, found.passage)
            if found.launched is not None:
                stop = self.graph.stop_names[found.index]
            self.arcs[-1] = arc = self._named(arc, closed, stop)
            end = found.passage.state
        if arc.ending is not Ending.HORIZON:
            kind, index = self._event_at(start, arc, end, guards, closed)
            if found is None and kind is Kind.SWITCH:
                found = self._at_end(arc, end)
            if found is not None and (kind, index) != (found.kind, found.index):
                self.interruption = replace(found, kind=kind, index=index, cut=True)
                self.arcs[-1] = arc = replace(arc, ending=Ending(kind.value))
        return arc, end

    def _at_end(self, arc: Arc, end: Vector) -> Interruption:
        """Return the event of the stop that the run looks at as one that ends its arc early.

        Raises:
            AssertionError: If the arc lacks a flow.
        """
        if arc.trajectory is None:
            raise AssertionError("An arc that ends at a guard has a flow.")
        passage = SegmentResult(
            outcome=Termination.FALL, duration=arc.duration, state=end, trajectory=arc.trajectory
        )
        return Interruption(kind=Kind.MULTIPLIER, index=self.focus, passage=passage)

    def is_clear(self, limit: ZenoLimit) -> bool:
        """Return True if no other guard falls on the way to a Zeno point.

        Raises:
            SimultaneousEventsError: If a kink that changes the acceleration of the gap changes its
                side in every flight. The impacts then do not accumulate by the law of the tail.
        """
        mode = (self.rest, self.sides)
        for x in (*(step.after for step in limit.path), limit.state):
            for k in self._open_beside(self.rest):
                if not self.graph.view(mode, k).gap(x) > 0.0:
                    return False
            for j in self.rest:
                if not self._holding(self.rest, j).multiplier(x) > 0.0:
                    return False
            guards, rounding, _ = self.graph.guards((self.rest, self.sides), x)
            signs = np.where(self._signs(), guards, -guards)
            # A kink or a part that splits every flight is zero at the limit itself.
            signs[list(self.split_by[0])] = np.inf
            first = self.graph.frictional.start
            for s in self.beside:
                part = s - (s - first) % PER_PART
                signs[part : part + PER_PART] = np.inf
            if not np.all(signs > -_SPENT * rounding):
                return False
        values, rounding, _ = self.graph.guards(((), self.sides), limit.state)
        for kink in self.split_by[0] - self.beside:
            if abs(values[kink]) <= _SPENT * rounding[kink]:
                self._require_continuous(kink, limit.time, limit.state)
        return True

    def after_phase(self, start: ArcStart) -> ArcStart | None:
        """Follow one phase.

        Raises:
            SlidingError: If the state leaves the admissible set where a kink is zero, as by dry
                friction at rest.
        """
        try:
            return self.phase(start)
        except PenetrationError as error:
            x = np.array(error.state)[: start.state.size]
            guards, rounding, _ = self.graph.guards(((), self.sides), x)
            zero = np.flatnonzero(np.abs(guards) <= _SPENT * rounding)
            kinks = [int(s) for s in zero if s >= self.graph.n_declared]
            if self.seen.is_in_corner(self.own.time):
                raise self.seen.in_turn(error.time, x) from error
            if not kinks:
                raise
            raise slides(self.graph, kinks[0], error.time, x) from error

    def phase(self, start: ArcStart) -> ArcStart | None:
        """Follow one phase, without the names of its errors."""
        s = self._due(start)
        if s is not None:
            limit = self._limit_before(start)
            return limit or self._switched(start, start.time, start.state, s)
        if start.mode is Mode.LOCKED:
            return self.locked_arc(start)
        if start.speed is None:
            return self.free_flight(start)
        return self.impact_sequence(start, start.speed)

    def _limit_before(self, start: ArcStart) -> ArcStart | None:
        """Return the contact after a Zeno point, if the impact at a start determines it.

        Every impact moves a part with dry friction, which is due to slip at the start.
        """
        if start.mode is Mode.LOCKED or start.speed is None:
            return None
        sequence = self.sequence()
        if not self.estimated(start, start.speed, sequence) or not self.beside:
            return None
        return self.zeno_point(start, start.speed, sequence)

    def interrupted(self, start: ArcStart, arc: Arc) -> ArcStart | None:
        """Return the next start after an arc that another event ended."""
        found, self.interruption = self.interruption, None
        if found is None:
            return None
        if found.passage is None:
            return self.on_other_side(start, found.index)
        scaled = _scaled_gap(start, found, found.passage.state)
        time, x, last = arc.end_time, arc.end_state, float(found.passage.state[-1])
        is_own = start.mode is Mode.FREE and found.index == self.focus
        if found.kind is Kind.GAP and is_own:
            if start.speed is None or found.launched is not None:
                return self.meet(time, x, self.dynamics.gap_rate(x))
            return self.landing(time, x, arc.time_unit * last)
        rate = None
        if found.launched is not None and not found.cut:
            rate = found.launched * last
        return self.after_other(start, time, x, found.kind, found.index, rate, scaled)

    def after_other(
        self,
        start: ArcStart,
        time: float,
        x: Vector,
        kind: Kind,
        index: int,
        rate: float | None = None,
        scaled: tuple[float, float] | None = None,
    ) -> ArcStart | None:
        """Return the next start after the event of another guard.

        Args:
            start: Start of the arc that it ended.
            time: Time of the event [s].
            x: State there, ``(n_x,)``.
            kind: Kind of the guard.
            index: Index of the stop or switch.
            rate: Gap rate of the stop, by default of the state.
            scaled: Scaled gap and its rate, if the arc is a rescaled flight.
        """
        closed = self._closed(start)
        if kind is Kind.SWITCH:
            return self._switched(start, time, x, index, scaled)
        self.current = None
        if kind is Kind.MULTIPLIER:
            self.look(tuple(k for k in closed if k != index), index)
            return self.release(time, x)
        self.look(closed, index)
        return self.meet(time, x, self.dynamics.gap_rate(x) if rate is None else rate)

    def release(self, time: float, x: Vector) -> ArcStart | None:
        """Record a release, and those of the stops that open with it."""
        others, name = [k for k in self.together if k != self.focus], self.stop_name
        after = StopRun.release(self, time, x)
        released = self.events[-1].after
        if after is not None and others:
            self.look(tuple(k for k in self.rest if k not in others), self.focus)
            after = None if self._opened(others, time, after.state) else after
        return self._set_anew(f"release {name}", time, released, after)

    def _set_anew(
        self, event: str, time: float, x: Vector, after: ArcStart | None
    ) -> ArcStart | None:
        """Set states anew after an event of a stop.

        Args:
            event: Name of the event.
            time: Time of the event [s].
            x: State just after it, ``(n_x,)``.
            after: The start without that, or ``None`` if the event ends the execution.
        """
        s = self.graph.setter_at(event)
        if s is None:
            return after
        then = self.graph.after_switch(s, x)
        self.flipped = math.nan, frozenset()
        name = self.graph.switch_names[s]
        self._count_switch(time, name, x, then)
        if after is None:
            return None
        closed = self._closed(after)
        self.current = None
        self._take_sides(then)
        return self._placed(time, then, closed, switch=name)

    def impact(self, time: float, state_minus: Vector, approach_rate: float) -> ArcStart | None:
        """Apply the reset map in the mode that its impulses determine."""
        before = self.rest
        in_turn = self.seen.see_impact(
            time, self.stop_name, lambda stops: self._rest(stops, state_minus)
        )
        together = self._limit_of_each(time, state_minus, approach_rate)
        if together is not None:
            return together
        if in_turn and self._turns_are_coupled(state_minus):
            raise self.seen.in_turn(time, state_minus)
        self.split_by = self.split_by[1], frozenset()
        for s in self.graph.frictional:
            # What an impact causes belongs to the sequence of the impacts.
            self.seen.switches.pop(self.graph.switch_names[s], None)
        if approach_rate < 0.0:
            self.look(self._kept(state_minus), self.focus)
            self._take_sides(self.dynamics.reset_map(state_minus, approach_rate))
            self.look(self.rest, self.focus)
        name = self.stop_name
        after = StopRun.impact(self, time, state_minus, approach_rate)
        if after is None:
            return self._set_anew(f"impact {name}", time, self.events[-1].after, None)
        kinds = ("impact", "zeno") if after.mode is Mode.LOCKED else ("impact",)
        # The reset changes the forces on the other closed stops.
        candidates = self._closed(after)
        closed = self._contact_set(time, after.state, candidates) if self.rest else candidates
        held = {*self.rest, self.focus}.intersection(closed) if self.rest else {self.focus}
        if self._opened([k for k in before if k not in held], time, after.state):
            return None
        if closed != candidates:
            after = self._opened_by_impact(after, closed)
        events = [f"{kind} {name}" for kind in kinds]
        if all(self.graph.setter_at(event) is None for event in events):
            return self._struck_again(time, after)
        for event in events:
            if after is not None:
                after = self._set_anew(event, time, after.state, after)
        return after

    def _turns_are_coupled(self, x: Vector) -> bool:
        """Return True if two stops of the last impacts are coupled.

        Others come to rest each by itself.
        """
        names = {name for _, name in self.seen.impacts}
        struck = [k for k, name in enumerate(self.graph.stop_names) if name in names]
        return self._coupled(struck, self.rest, x) is not None

    def _rest(self, stops: Collection[str], x: Vector) -> bool:
        """Return True if stops have zero gap and gap rate to the accuracy of a flight."""
        views = [self._view((), self.graph.stop_names.index(name)) for name in stops]
        return all(
            view.gap(x) <= _LOW * view.own.gap
            and abs(view.gap_rate(x)) <= _SLOW * view.own.gap_rate
            for view in views
        )

    def _limit_of_each(self, time: float, x: Vector, approach_rate: float) -> ArcStart | None:
        """Go to the Zeno points of several stops at rest, one of which is struck.

        The stops are so near to rest that their gap accelerations are constant but for a linear
        change. They are not coupled, so each comes to rest by its own law. What gap rates change of
        the accelerations is an error of the limits.

        Args:
            time: Time of the event [s].
            x: State before the impact, ``(n_x,)``.
            approach_rate: Gap rate before it.

        Returns:
            The start of the contact at the last limit, or ``None`` if such stops are missing, or
            the limits are not determined.
        """
        if not -_SLOW * self.own.gap_rate <= approach_rate < 0.0:
            return None
        beside = self._open_beside(self.rest)
        stops = [k for k in beside if self._rest([self.graph.stop_names[k]], x)]
        if not stops:
            return None
        stops = sorted((*stops, self.focus))
        names = [self.graph.stop_names[k] for k in stops]
        events = [f"{kind} {name}" for kind in ("zeno", "impact") for name in names]
        if any(self.graph.setter_at(event) is not None for event in events):
            return None
        closed = tuple(sorted((*self.rest, *stops)))
        if self._coupled(stops, self.rest, x) is not None:
            return None
        rested = x
        for k in closed:
            rested = self._holding(closed, k).on_stop(rested)
        lifts = [self._view(self.rest, k).gap_acceleration(rested) for k in stops]
        if not self._accumulates(stops, lifts):
            return None
        rough = self._ways_to_rest(stops, lifts, x, approach_rate)
        longest = max(way.time for way in rough)
        end = self._held(closed, rested, longest)
        means = [
            (lift + self._view(self.rest, k).gap_acceleration(end)) / 2
            for k, lift in zip(stops, lifts, strict=True)
        ]
        if not self._accumulates(stops, means):
            return None
        ways = self._ways_to_rest(stops, means, x, approach_rate)
        longest = max(way.time for way in ways)
        end, last = self._held(closed, rested, longest), time + longest
        error, changes = 0.0, self._changes_of_lift(stops, closed, rested, ways)
        for k, way, first, change in zip(stops, ways, rough, changes, strict=True):
            share = change / (1.0 - self._view(self.rest, k).restitution)
            doubt = max(abs(way.time - first.time), way.time * share / -way.lift)
            error = max(error, doubt / (self.own.time + last))
        if not (error <= _SPLIT and last < self.follower.until and self._clear_beside(closed, end)):
            return None
        if self._contact_set(last, end, closed) != closed:
            return None
        self.seen.require_no_switches(last, self.stop_name, end, self.own.time)
        self.seen.forget(*(self.graph.stop_names[k] for k in stops))
        error = max(error, *(way.rounding / (self.own.time + last) for way in ways))
        for way, k in sorted(zip(ways, stops, strict=True), key=lambda one: one[0].time):
            point = ZenoPoint(
                time=time + way.time,
                state=self._held(closed, rested, way.time),
                limit_error=error,
                tail=way.time,
                last_speed=way.rebound,
                stop=self.graph.stop_names[k],
            )
            self.events.append(point)
        return self._at_rest(time, rested, last, end, closed)

    def _at_rest(
        self, time: float, rested: Vector, last: float, end: Vector, closed: tuple[int, ...]
    ) -> ArcStart:
        """Return the start of the contact of several stops, after a tail to the last limit.

        Args:
            time: When the tail starts [s].
            rested: State there with all stops at rest, ``(n_x,)``.
            last: When it ends [s].
            end: State there, ``(n_x,)``.
            closed: The closed stops then.
        """
        tail = Arc(
            mode=Mode.FREE,
            start_time=time,
            end_time=last,
            start_state=rested,
            end_state=end,
            ending=Ending.ZENO,
            impact_index=self.n_impacts,
            time_unit=1.0,
            trajectory=None,
        )
        self.arcs.append(self._named(tail, self.rest))
        self.current = None
        self.look(closed[:-1], closed[-1])
        return ArcStart(mode=Mode.LOCKED, time=last, state=end)

    def _accumulates(self, stops: Sequence[int], lifts: Sequence[float]) -> bool:
        """Return True if impacts on stops accumulate at these gap accelerations."""
        return all(
            lift < 0.0 and self._view(self.rest, k).restitution < 1.0
            for k, lift in zip(stops, lifts, strict=True)
        )

    def _ways_to_rest(
        self, stops: Sequence[int], lifts: Sequence[float], x: Vector, approach_rate: float
    ) -> list[_WayToRest]:
        """Return the way of each stop to its Zeno point.

        The gap of a stop counts from the gap that its last impact left. Its rounding moves the
        Zeno point by a time of this size over the speed.

        Args:
            stops: The stops, one of which is struck now.
            lifts: Gap acceleration of each, which is constant.
            x: The state, ``(n_x,)``.
            approach_rate: Gap rate of the stop that is struck.
        """
        ways: list[_WayToRest] = []
        for k, lift in zip(stops, lifts, strict=True):
            view, e = self._view(self.rest, k), self._view(self.rest, k).restitution
            is_struck = k == self.focus
            gap = 0.0 if is_struck else max(view.gap(x) - self._left_gap(k), 0.0)
            rate = approach_rate if is_struck else view.gap_rate(x)
            speed = math.sqrt(rate * rate - 2.0 * lift * gap)
            after = view.speed_after(-speed)
            excess = speeds_excess(view, after)
            way = (rate + speed) / -lift + 2.0 * after / (-lift * (1.0 - e))
            way += 2.0 * excess / -lift
            rounding = 0.0 if is_struck else self._rounding_of_states(k, x)
            least = math.sqrt(-2.0 * lift * rounding)
            doubt = rounding * (1.0 + e) / ((1.0 - e) * max(speed, least)) if rounding else 0.0
            ways.append(_WayToRest(time=way, lift=lift, speed=speed, rebound=after, rounding=doubt))
        return ways

    def _changes_of_lift(
        self,
        stops: Sequence[int],
        closed: tuple[int, ...],
        rested: Vector,
        ways: Sequence[_WayToRest],
    ) -> list[float]:
        r"""Return by how much the gap acceleration of each stop may change while stops bounce.

        Forces that depend on gap rates and gaps change with the impulses of every stop, and other
        states follow them for a flight. Where the gap acceleration is :math:`-a + s \dot g`, the
        time to rest :math:`t` from the speed :math:`v` errs by :math:`t s v / (3 a (1 - e))`.

        Args:
            stops: The stops.
            closed: They, and the stops that are closed beside them.
            rested: State with all of these at rest, ``(n_x,)``.
            ways: The way of each stop.
        """
        rate = self._holding(closed, closed[-1]).locked.rate
        views, still = [self._view(self.rest, k) for k in stops], rate(rested)
        lifts, changes = [view.gap_acceleration(rested) for view in views], [0.0] * len(stops)
        for way, struck in zip(ways, views, strict=True):
            kick = struck.reset_map(rested, -way.speed) - rested
            most = [0.0] * len(stops)
            for sign in (1.0, -1.0):
                moved = rested + sign * kick
                late = moved + (2.0 * way.speed / -way.lift) * (rate(moved) - still)
                for k, (view, lift) in enumerate(zip(views, lifts, strict=True)):
                    for state in (moved, late):
                        most[k] = max(most[k], abs(view.gap_acceleration(state) - lift))
            changes = [old + new for old, new in zip(changes, most, strict=True)]
        return changes

    def _held(self, closed: tuple[int, ...], x: Vector, time: float) -> Vector:
        """Return the state after a short time on closed stops, by the midpoint rule."""
        rate = self._holding(closed, closed[-1]).locked.rate
        return x + time * rate(x + (time / 2.0) * rate(x))

    def _clear_beside(self, closed: Sequence[int], x: Vector) -> bool:
        """Return True if no guard beside closed stops has fallen at a state, and no kink jumps."""
        for k in range(len(self.graph.stop_names)):
            if k not in closed and not self._view((), k).gap(x) > 0.0:
                return False
        guards, levels, _ = self.graph.guards((tuple(closed), self.sides), x)
        for s, above in enumerate(self._signs()):
            value, small = float(guards[s]), _SPENT * float(levels[s])
            if not (value if above else -value) > -small:
                return False
            if abs(value) <= small and (
                s < self.graph.n_declared or not self._leave_flow([s], tuple(closed), x)
            ):
                return False
        return True

    def _opened_by_impact(self, after: ArcStart, closed: tuple[int, ...]) -> ArcStart:
        """Return the start after an impact whose change of forces opens closed stops."""
        self.current = None
        self.look(tuple(k for k in closed if k != self.focus), self.focus)
        if after.mode is Mode.LOCKED and self.focus not in closed:
            return replace(after, mode=Mode.FREE)
        if after.impact is None:
            return after
        return replace(after, resting=self.dynamics.resting(after.impact.state_plus))

    def _struck_again(self, time: float, after: ArcStart) -> ArcStart | None:
        """Strike a stop that closes at the time of an impact on another stop, if there is one.

        Raises:
            SimultaneousEventsError: If the two stops are coupled.
        """
        closed, x = self._closed(after), after.state
        for k in self._open_beside(closed):
            view = self._view((), k)
            rate = view.gap_rate(x)
            contact = self.settings.contact
            if rate < -contact * view.own.gap_rate and self._closes(
                k, view.gap(x), rate, x, contact * view.own.gap
            ):
                self._require_apart(sorted((self.focus, k)), closed, time, x)
                if not self._closes_now(k, view.gap(x), rate, time, x):
                    continue
                self.look(closed, k)
                return self.impact(time, x, rate)
        return after

    # Modes.

    def _view(self, closed: tuple[int, ...], stop: int) -> HybridDynamics:
        return self.graph.view((closed, self.sides), stop)

    def _holding(self, closed: tuple[int, ...], stop: int) -> HybridDynamics:
        """Return the system in which a closed stop of a mode is the stop."""
        return self.graph.holding((closed, self.sides), stop)

    def look(self, rest: tuple[int, ...], focus: int) -> None:
        """Look at a stop, with others closed beside it.

        Args:
            rest: The closed stops.
            focus: The stop.
        """
        self.rest, self.focus = rest, focus
        self.see(self._view(rest, focus))
        self.follower.apart = _APART * self.own.time if self._has_others else 0.0
        self.stop_name = self.graph.stop_names[focus] if self.graph.stop_names else ""

    def mode_at(self, start: ArcStart) -> GraphMode:
        """Return the mode of an arc that starts now.

        Args:
            start: The start.
        """
        return self._closed(start), self.sides

    def _closed(self, start: ArcStart) -> tuple[int, ...]:
        """Return the closed stops of an arc."""
        if start.mode is Mode.FREE:
            return self.rest
        return tuple(sorted((*self.rest, self.focus)))

    def _open_beside(self, closed: Sequence[int]) -> list[int]:
        """Return the open stops beside the stop that the run looks at."""
        known = (*closed, self.focus)
        return [k for k in range(len(self.graph.stop_names)) if k not in known]

    def _signs(self) -> Vector:
        """Return for every switch whether its guard is positive, the declared switches first."""
        return np.array([*self.above, *self.sides], dtype=bool)

    def _named(self, arc: Arc, closed: tuple[int, ...], stop: str = "") -> Arc:
        """Return an arc with its mode, and with the stop of a rescaled flight."""
        mode = Mode.LOCKED if closed else Mode.FREE
        names = closed_names(self.graph.stop_names, closed)
        return replace(arc, closed=names, mode=mode, stop=stop, sides=self.sides)

    def _take_sides(self, x: Vector) -> None:
        """Take the side of every switch at a state. A zero keeps the side of a kink."""
        guards, rounding, _ = self.graph.guards(((), self.sides), x)
        declared = range(self.graph.n_declared)
        self.above = tuple(bool(not guards[k] < -rounding[k]) for k in declared)
        self.sides = self.graph.sides_at(x, self.sides)

    # Guards.

    def _guards(self, start: ArcStart, closed: tuple[int, ...]) -> Iterator[_Guard]:
        """Yield the guards of an arc beside the guard of the stop that the run looks at."""
        x, contact = start.state, self.settings.contact
        mode: GraphMode = (closed, self.sides)
        for j in self.rest:
            view = self._holding(closed, j)
            rounding = contact * view.own.multiplier
            on_guard = view.multiplier(x) <= rounding
            yield _Guard(Kind.MULTIPLIER, j, view.locked, x, None, on_guard, rounding)
        for k in self._open_beside(closed):
            view = self.graph.view(mode, k)
            gap, rate, rounding = view.gap(x), view.gap_rate(x), contact * view.own.gap
            lost, moves = _lost(rate, view.own), abs(rate) > contact * view.own.gap_rate
            if gap <= rounding and moves and self._is_left(k, rate, start):
                rounding = contact / view.own.gap_acceleration
                height = self._height(k, gap, start.time) / (rate * rate)
                flight, y = view.flight(rate), launched(x, 1.0, height)
                yield _Guard(Kind.GAP, k, flight, y, rate, height <= rounding, rounding)
            elif self.seen.come_in_turn and gap > lost:
                # Its flight is under way.
                rounding = min(rounding, lost)
                yield _Guard(Kind.GAP, k, view.free, x, None, gap <= rounding, rounding)
            else:
                on_guard = gap <= rounding and not self._has_left(k, gap, rate, x)
                yield _Guard(Kind.GAP, k, view.free, x, None, on_guard, rounding)
        values, levels, _ = self.graph.guards((closed, self.sides), x)
        unknown = np.flatnonzero(np.isnan(values))
        if unknown.size:
            raise undefined_guard(self.graph.switch_names[int(unknown[0])], start.time, x)
        for s, above in enumerate(self._signs()):
            if s < self.graph.n_declared and self.graph.causes[s]:
                continue
            value = float(values[s] if above else -values[s])
            flow = self.graph.guard_flow(mode, s, bool(above))
            on_guard = value <= float(levels[s])
            yield _Guard(Kind.SWITCH, s, flow, x, None, on_guard, float(levels[s]))

    def is_under_way(self, x: Vector) -> bool:
        """Return True if the flight from the stop has left its gap of zero at a state."""
        return self._has_left(self.focus, self.dynamics.gap(x), self.dynamics.gap_rate(x), x)

    def _has_left(self, stop: int, gap: float, rate: float, x: Vector) -> bool:
        """Return True if a flight has left a gap of zero. At its top the gap alone shows it."""
        small = self.settings.contact * self._view((), stop).own.gap_rate
        return gap > 0.0 and (abs(rate) > small or gap > self._rounding(stop, x))

    def _is_left(self, stop: int, rate: float, start: ArcStart) -> bool:
        """Return True if the flight from another stop begins with an arc, and is not under way."""
        if not rate > 0.0:
            return False
        if self.seen.come_in_turn or self._is_met(stop, start.time):
            return True
        return self._view((), stop).gap(start.state) <= self._rounding(stop, start.state)

    def _height(self, stop: int, gap: float, time: float) -> float:
        """Return the gap since the last event at another stop, if its flight is under way."""
        if not self.seen.come_in_turn or self._is_met(stop, time):
            return 0.0
        return max(gap - self._left_gap(stop), 0.0)

    def _earliest(self, guards: Sequence[_Guard], arc: Arc) -> Interruption | None:
        """Return the earliest event of other guards within an arc, if there is one.

        Raises:
            PenetrationError: If a stop is left on the wrong side.
        """
        found: Interruption | None = None
        duration, late = arc.duration, 0.0
        if arc.ending is Ending.HORIZON and arc.end_time == self.follower.until:
            late = self.follower.late / arc.time_unit
        for guard in guards:
            unit = arc.time_unit if guard.launched is None else guard.launched
            passage = self._passage(guard, arc, duration, late)
            if passage.outcome is Termination.LEFT:
                if guard.kind is Kind.SWITCH:
                    return Interruption(kind=guard.kind, index=guard.index, passage=None)
                time = arc.start_time + unit * passage.duration
                raise leaves_set(time, passage.state[: arc.start_state.size])
            if passage.outcome is Termination.FALL:
                found = Interruption(
                    kind=guard.kind,
                    index=guard.index,
                    passage=passage,
                    launched=guard.launched,
                )
                duration, late = passage.duration, 0.0
                if guard.launched is not None:
                    duration *= guard.launched / arc.time_unit
        return self._left_within(guards, found, arc, duration * arc.time_unit) or found

    def _left_within(
        self, guards: Sequence[_Guard], found: Interruption | None, arc: Arc, duration: float
    ) -> Interruption | None:
        """Return a switch that an arc leaves on its wrong side, if it ends in its first step."""
        end = arc.end_state
        if found is not None and found.passage is not None:
            end = found.passage.state[: arc.start_state.size]
        for guard in guards:
            is_found = found is not None and (guard.kind, guard.index) == (found.kind, found.index)
            if guard.kind is not Kind.SWITCH or not guard.on_guard or is_found:
                continue
            value, rate = guard.flow.guard(end)
            if value < -max(LEAVES * abs(rate) * duration, guard.rounding):
                return Interruption(kind=guard.kind, index=guard.index, passage=None)
        return None

    def _first_of_surface(
        self,
        guards: Sequence[_Guard],
        found: Interruption | None,
        closed: Sequence[int],
        n_x: int,
    ) -> Interruption | None:
        """Return the event of the first kink that falls where a kink fell, on one surface."""
        if found is None or found.passage is None or not self._is_kink(found):
            return found
        x = found.passage.state[:n_x]
        kinks = [guard for guard in guards if self._is_kink(guard)]
        fell = next(guard for guard in kinks if guard.index == found.index)
        for one in kinks[: kinks.index(fell)]:
            value, rate = one.flow.guard(x)
            falls = not one.on_guard and self._is_zero(value, rate, one.rounding)
            if falls and self._is_one_surface(one, fell, closed, x):
                return replace(found, index=one.index)
        return found

    def _is_one_surface(self, one: _Guard, other: _Guard, closed: Sequence[int], x: Vector) -> bool:
        """Return True if the surfaces of two kinks touch at a state where both fall.

        Their slopes, or those along the closed stops, are then in the ratio of their rates, and the
        order of both events has no effect to first order.
        """
        (_, rate), (_, other_rate) = one.flow.guard(x), other.flow.guard(x)
        slopes = self.graph.slopes(x, self.sides)
        first, second = np.abs(slopes[one.index] * other_rate), np.abs(slopes[other.index] * rate)
        if np.max(np.abs(first - second)) <= _ONE_SURFACE * np.max(first):
            return True
        return bool(closed) and self._is_one_along(one, other, closed, x)

    def _is_one_along(self, one: _Guard, other: _Guard, closed: Sequence[int], x: Vector) -> bool:
        """Return True if the surfaces of two kinks touch along closed stops."""
        (_, rate), (_, other_rate) = one.flow.guard(x), other.flow.guard(x)
        sizes = self.graph.own.states(x.size) + np.abs(x)
        largest = difference = 0.0
        for k in range(x.size):
            if k in self.graph.first.clock:
                # It has one direction, which the rates contain.
                continue
            slope = other_slope = 0.0
            for sign in (1, -1):
                moved = x.copy()
                moved[k] += sign * (_SHIFT * sizes[k])
                for j in closed:
                    moved = self._holding(tuple(closed), j).on_stop(moved)
                slope += sign * one.flow.guard(moved)[0]
                other_slope += sign * other.flow.guard(moved)[0]
            first, second = slope * other_rate, other_slope * rate
            largest = max(largest, abs(first))
            difference = max(difference, abs(first - second))
        return difference <= _ONE_SURFACE * largest

    def _leave_flow(self, kinks: Sequence[int], closed: tuple[int, ...], x: Vector) -> bool:
        """Return True if kinks that fall together leave the flow as it is, alone and together.

        Their order then has no effect.
        """

        def rate(sides: tuple[bool, ...]) -> Vector:
            if closed:
                return self.graph.view((closed[:-1], sides), closed[-1]).locked.rate(x)
            return self.graph.view(((), sides), self.focus).free.rate(x)

        before, own = rate(self.sides), self.graph.own
        small = _SAME * (own.states(x.size) / own.time + np.abs(before))
        sides, every = self.sides, list[tuple[bool, ...]]()
        for kink in sorted(kinks):
            sides = self._beyond(kink, x, sides)
            every += [self._beyond(kink, x), sides]
        return all(bool(np.all(np.abs(rate(one) - before) <= small)) for one in every)

    def _is_kink(self, event: _Guard | Interruption) -> bool:
        return event.kind is Kind.SWITCH and event.index >= self.graph.n_declared

    def _passage(self, guard: _Guard, arc: Arc, duration: float, late: float) -> SegmentResult:
        """Return a guard along an arc, up to a duration in the arc's own time.

        A zero in the last part `late` of that duration does not count.
        """
        way, n_x = arc.trajectory, arc.start_state.size
        if guard.launched is not None or not isinstance(way, SteppedTrajectory | LoopTrajectory):
            unit = 1.0 if guard.launched is None else guard.launched
            return self.follower.beside(
                guard.flow,
                guard.y,
                horizon=duration * arc.time_unit / unit,
                late=late * arc.time_unit / unit,
                on_guard=guard.on_guard,
                rounding=guard.rounding,
            )
        steps = cast("Sequence[BoxedStep]", way.steps)
        along = _AlongArc(guard.flow, n_x, arc.time_unit)
        leg = Segment(
            flow=cast("FlowWithEvent", along),
            y=steps[0].before,
            horizon=duration,
            tolerance=self.follower.tolerance,
            on_guard=guard.on_guard,
            rounding=guard.rounding,
            late=late,
            returns=guard.kind is Kind.SWITCH,
        )
        return follow_steps(iter(steps), leg)

    def _cut(self, start: ArcStart, arc: Arc, found: Interruption, passage: SegmentResult) -> Arc:
        """Return an arc that ends at another event."""
        unit = arc.time_unit if found.launched is None else found.launched
        return replace(
            arc,
            end_time=start.time + unit * passage.duration,
            end_state=passage.state[: start.state.size],
            ending=Ending(found.kind.value),
            time_unit=unit,
            trajectory=passage.trajectory,
        )

    def _event_at(
        self,
        start: ArcStart,
        arc: Arc,
        end: Vector,
        guards: Sequence[_Guard],
        closed: tuple[int, ...],
    ) -> tuple[Kind, int]:
        """Return the event at the end of an arc, of all events whose guards are zero there.

        A switch that rises, or is not armed, is not an event. A kink changes no state, so an impact
        does not depend on it, and its side is taken after the impact. Impacts on stops that are not
        coupled change nothing for each other, so their order has no effect, nor has that of kinks
        that leave the flow as it is, nor has that of stops that open in every order. A kink comes
        before a release that takes place on both of its sides.

        Raises:
            SimultaneousEventsError: If the order of two events matters. It names both events.
        """
        self.together = ()
        x, found = arc.end_state, self.interruption
        main = (Kind.MULTIPLIER if start.mode is Mode.LOCKED else Kind.GAP), self.focus
        zero = [fell := main if found is None else (found.kind, found.index)]
        for guard in guards:
            event = guard.kind, guard.index
            if event == fell or (guard.on_guard and guard.kind is not Kind.GAP):
                continue
            if found is not None and self._is_kink(found) and self._is_kink(guard):
                first = next(one for one in guards if (one.kind, one.index) == fell)
                if self._is_one_surface(guard, first, closed, x):
                    continue
            value, rate = self._value(guard, closed, x)
            if guard.kind is Kind.GAP:
                is_zero = self._closes(guard.index, value, rate, x, guard.rounding)
            else:
                is_zero = self._is_zero(value, rate, guard.rounding)
            if not is_zero:
                continue
            if self._is_own_time(zero[0], event, closed, x):
                if not self._closes_now(guard.index, value, rate, start.time, x):
                    continue
            elif guard.kind is Kind.GAP:
                self._require_resolved(value, rate, arc.end_time, x)
            zero.append(event)
        if found is not None and self._main_is_zero(start, arc, end):
            own = self._is_own_time(zero[0], main, closed, x)
            if not own or self._main_closes_now(start, arc, end):
                zero.append(main)
        events = [event for event in zero if self._occurs(*event, x, closed)]
        impacts = [index for kind, index in events if kind is Kind.GAP]
        if len(events) < 2:
            return (events or zero)[0]
        kinks = [index for kind, index in events if kind is Kind.SWITCH]
        releases = [index for kind, index in events if kind is Kind.MULTIPLIER]
        if len(releases) == len(events) and self._open_in_any_order(releases, closed, x):
            self.together = tuple(sorted(releases))
            return events[0]
        if not impacts and self._opens_beyond(kinks, events, closed, x):
            return Kind.SWITCH, kinks[0]
        are_kinks = len(kinks) == len(events) and min(kinks) >= self.graph.n_declared
        if are_kinks and self._leave_flow(kinks, closed, x):
            return Kind.SWITCH, kinks[0]
        if not impacts or not all(
            kind is Kind.GAP or (kind is Kind.SWITCH and index >= self.graph.n_declared)
            for kind, index in events
        ):
            first, second = (self._event_of(*event) for event in events[:2])
            raise coincide(first, second, arc.end_time, x)
        impacts.sort()
        self._require_apart(impacts, closed, arc.end_time, x)
        return Kind.GAP, impacts[0]

    def _open_in_any_order(self, stops: Sequence[int], closed: tuple[int, ...], x: Vector) -> bool:
        """Return True if each of some stops opens after each of the others has opened.

        The flow does not change at a release, but the rates of the other contact forces may.
        """
        for first in stops:
            mode = tuple(k for k in closed if k != first), self.sides
            for stop in stops:
                if stop == first:
                    continue
                view = self.graph.holding(mode, stop)
                rounding = self.settings.contact * view.own.multiplier
                if not self._is_zero(view.multiplier(x), view.multiplier_rate(x), rounding):
                    return False
        return True

    def _opens_beyond(
        self,
        kinks: Sequence[int],
        events: Sequence[tuple[Kind, int]],
        closed: tuple[int, ...],
        x: Vector,
    ) -> bool:
        """Return True if one kink falls, and all others are stops that open on both its sides.

        The flow does not change at a release, so the order of the kink and of the releases has no
        effect if no stop is pressed beyond the kink.
        """
        if len(kinks) != 1 or kinks[0] < self.graph.n_declared:
            return False
        mode = closed, self._beyond(kinks[0], x)
        for _, stop in [event for event in events if event[0] is Kind.MULTIPLIER]:
            view = self.graph.holding(mode, stop)
            value, rate = view.multiplier(x), view.multiplier_rate(x)
            rounding = self.settings.contact * view.own.multiplier
            if not (self._is_zero(value, rate, rounding) or value < -rounding):
                return False
        return True

    def _beyond(
        self, kink: int, x: Vector, before: tuple[bool, ...] | None = None
    ) -> tuple[bool, ...]:
        """Return the sides of all kinks beyond one of them, which is zero at a state.

        Args:
            kink: The kink.
            x: The state, ``(n_x,)``.
            before: The sides before it, by default the present sides.
        """
        k = kink - self.graph.n_declared
        sides = tuple(one ^ (i == k) for i, one in enumerate(before or self.sides))
        return self.graph.sides_at(x, sides, (k,))

    def _main_is_zero(self, start: ArcStart, arc: Arc, end: Vector) -> bool:
        """Return True if the guard of the run's stop falls through zero at the end of an arc."""
        x, own, scaled = arc.end_state, self.own, _scaled_gap(start, self.interruption, end)
        if scaled is not None:
            # The gap itself may be below its rounding in all of a flight.
            apart = min(_APART * own.time / arc.time_unit, _OF_FLIGHT * arc.duration)
            rounding = self.settings.contact / own.gap_acceleration
            return scaled[1] < 0.0 and scaled[0] <= max(rounding, -scaled[1] * apart)
        if start.mode is Mode.LOCKED:
            value, rate = self.dynamics.multiplier(x), self.dynamics.multiplier_rate(x)
            return self._is_zero(value, rate, self.settings.contact * self.own.multiplier)
        return self._closes(
            self.focus, self.dynamics.gap(x), self.dynamics.gap_rate(x), x, self.small_gap
        )

    def _is_own_time(
        self, fell: tuple[Kind, int], event: tuple[Kind, int], closed: tuple[int, ...], x: Vector
    ) -> bool:
        """Return True if two events are impacts on stops that are not coupled.

        Each then keeps its own time: to strike one too early would shift all its later impacts.
        """
        if fell[0] is not Kind.GAP or event[0] is not Kind.GAP:
            return False
        return self._coupled(sorted((fell[1], event[1])), closed, x) is None

    def _closes_now(self, stop: int, gap: float, rate: float, begin: float, x: Vector) -> bool:
        """Return True if a gap falls through zero at a state, to its rounding and that of time.

        Args:
            stop: The stop.
            gap: Its gap.
            rate: The rate of the gap.
            begin: When the arc to the state starts [s].
            x: The state, ``(n_x,)``.
        """
        return rate < 0.0 and gap <= max(
            self._rounding(stop, x), -rate * self._rounding_of_time(begin)
        )

    def _main_closes_now(self, start: ArcStart, arc: Arc, end: Vector) -> bool:
        """Return True if this holds for the stop of the run at the end of an arc."""
        scaled = _scaled_gap(start, self.interruption, end)
        if scaled is not None:
            return scaled[0] <= -scaled[1] * self._rounding_of_time(start.time) / arc.time_unit
        x = arc.end_state
        return self._closes_now(
            self.focus, self.dynamics.gap(x), self.dynamics.gap_rate(x), start.time, x
        )

    def _rounding_of_time(self, begin: float) -> float:
        return _AT_ONCE * (self.own.time + begin)

    def _occurs(self, kind: Kind, index: int, x: Vector, closed: tuple[int, ...]) -> bool:
        """Return True if the zero of a guard is an event: a declared switch is armed and falls."""
        if kind is not Kind.SWITCH or index >= self.graph.n_declared:
            return True
        return self.above[index] and bool(
            self.graph.guards((closed, self.sides), x)[2][index] > 0.0
        )

    def _require_apart(
        self, struck: Sequence[int], closed: Sequence[int], time: float, x: Vector
    ) -> None:
        """Refuse impacts at one time on stops that are coupled, directly or by closed stops.

        Raises:
            SimultaneousEventsError: If two stops are coupled.
        """
        pair = self._coupled(struck, closed, x)
        if pair is not None:
            one, other = (self._event_of(Kind.GAP, k) for k in pair)
            raise coincide(one, other, time, x)

    def _require_resolved(self, gap: float, rate: float, time: float, x: Vector) -> None:
        """Refuse a gap that only its rounding closes where impacts come on several stops in turn.

        Raises:
            SimultaneousEventsError: If the stop would be struck too early.
        """
        if self.seen.come_in_turn and gap > max(
            -rate * _APART * self.own.time, _lost(rate, self.own)
        ):
            raise self.seen.in_turn(time, x)

    def _coupled(
        self, struck: Sequence[int], closed: Sequence[int], x: Vector
    ) -> tuple[int, int] | None:
        """Return two of some stops that are coupled, directly or by closed stops, if there are."""
        if len(struck) < 2:
            return None
        matrix = self.graph.coupling(x)
        for place, first in enumerate(struck):
            reached, new = {first}, {first}
            others = {*closed, *struck[place + 1 :]}
            while new:
                new = {
                    k for k in others - reached if any(_are_coupled(matrix, j, k) for j in reached)
                }
                reached |= new
            for second in struck[place + 1 :]:
                if second in reached:
                    return first, second
        return None

    def _value(self, guard: _Guard, closed: tuple[int, ...], x: Vector) -> tuple[float, float]:
        """Return a guard and its rate at a state."""
        if guard.kind is Kind.GAP:
            view = self._view(closed, guard.index)
            return view.gap(x), view.gap_rate(x)
        value, rate = guard.flow.guard(x)
        return float(value), float(rate)

    def _is_zero(self, value: float, rate: float, rounding: float) -> bool:
        """Return True if a guard falls through zero here, to rounding."""
        return rate < 0.0 and value <= max(rounding, -rate * _APART * self.own.time)

    def _event_of(self, kind: Kind, index: int) -> str:
        names = self.graph.switch_names if kind is Kind.SWITCH else self.graph.stop_names
        return f"{kind.value} {names[index]}"

    # Events.

    def on_other_side(self, start: ArcStart, s: int) -> ArcStart | None:
        """Return the start on the other side of a switch, whose guard is zero at a start and falls.

        A declared switch occurs there if it is armed, unless it has just occurred.

        Args:
            start: Start of an arc.
            s: Index of the switch.

        Raises:
            SlidingError: If both sides are left at once.
            ChatterError: If a switch occurs again at the same time.
        """
        name, x = self.graph.switch_names[s], start.state
        time, crossed = self.flipped
        crossed = crossed if time == start.time else frozenset[int]()
        if s in crossed:
            raise slides(self.graph, s, start.time, x)
        self.flipped = start.time, crossed | {s}
        if s < self.graph.n_declared and self._occurs(Kind.SWITCH, s, x, self._closed(start)):
            if self._occurs_at_once(start, s):
                return self._switched(start, start.time, x, s)
            mode: GraphMode = (self._closed(start), self.sides)
            if self.graph.guard_flow(mode, s, above=True).guard(x)[1] > 0.0:
                # The guard rose by less than its rounding and fell again.
                raise switches_accumulate(name, start.time, x)
        self._change_side(s, x)
        self.look(self.rest, self.focus)
        if start.impact is None:
            return start
        return replace(start, resting=self.dynamics.resting(start.impact.state_plus))

    def _due(self, start: ArcStart) -> int | None:
        """Return the declared switch that occurs at a start: it is armed, and its guard falls.

        A switch that has just occurred goes over to its other side.
        """
        if not self.graph.n_declared:
            return None
        x, closed = start.state, self._closed(start)
        at_once = self.graph.due((closed, self.sides), x)
        if at_once is not None:
            return self._due_at_once(at_once, start)
        values, levels, armed = self.graph.guards((closed, self.sides), x)
        self._take_frictions(values, levels)
        for s in range(self.graph.n_declared):
            if not (self.above[s] and abs(values[s]) <= levels[s] and armed[s] > 0.0):
                continue
            rate = self.graph.guard_flow((closed, self.sides), s, above=True).guard(x)[1]
            if not rate < -levels[s] / self.own.time:
                continue
            if self._occurs_at_once(start, s):
                return s
            self._change_side(s, x)
        return None

    def _take_frictions(self, values: Vector, levels: Vector) -> None:
        """Take the sides of the switches of dry friction anew: they depend on the closed stops."""
        if not self.graph.frictional:
            return
        first = self.graph.frictional.start
        anew = range(first, self.graph.n_declared)
        self.above = (*self.above[:first], *(bool(not values[k] < -levels[k]) for k in anew))

    def _due_at_once(self, s: int, start: ArcStart) -> int:
        """Return a switch of dry friction that occurs at a start without a zero of its guard.

        Raises:
            ChatterError: If it has just occurred.
        """
        name = self.graph.switch_names[s]
        if start.time in self.seen.switches.get(name, ())[-1:]:
            raise switches_accumulate(name, start.time, start.state)
        return s

    def _occurs_at_once(self, start: ArcStart, s: int) -> bool:
        """Return True if a switch that is armed and falls at a start has not just occurred.

        Raises:
            SimulationError: If it is the start of the execution.
            ChatterError: If another switch led back to it at the same time.
        """
        name, declared = (
            self.graph.switch_names[s],
            self.graph.switch_names[: self.graph.n_declared],
        )
        if not self.events and start.time == 0.0:
            if self.past in (-1, s + 1):
                return False
            raise armed_at_start(name, start.time, start.state)
        if start.time not in self.seen.switches.get(name, ())[-1:]:
            return True
        switches = (one.name for one in reversed(self.events) if isinstance(one, SwitchEvent))
        if name != next((one for one in switches if one in declared), name):
            raise switches_accumulate(name, start.time, start.state)
        return False

    def _change_side(self, switch: int, x: Vector) -> None:
        """Go to the other side of a switch. Conditions that depend on a kink may change as well."""
        if switch < self.graph.n_declared:
            self.above = tuple(one ^ (k == switch) for k, one in enumerate(self.above))
        else:
            self.sides = self._beyond(switch, x)

    def _switched(
        self,
        start: ArcStart,
        time: float,
        x: Vector,
        s: int,
        scaled: tuple[float, float] | None = None,
    ) -> ArcStart | None:
        """Apply a switch whose guard fell through zero.

        Args:
            start: Start of the arc that it ended.
            time: Time of the event [s].
            x: State there, ``(n_x,)``.
            s: Index of the switch.
            scaled: Scaled gap and its rate, if the arc is a rescaled flight, which goes on.

        Raises:
            SlidingError: If the flow of the other side points back.
        """
        closed = self._closed(start)
        name, is_kink = self.graph.switch_names[s], s >= self.graph.n_declared
        was_above = bool(self._signs()[s])
        if self._resets(s, x, closed):
            after = self.graph.after_switch(s, x)
            self.flipped = math.nan, frozenset()
            self._count_switch(time, name, x, after)
            if s not in self.graph.frictional or start.mode is Mode.LOCKED:
                self.current = None
            self._take_sides(after)
            after = self._settled(time, after, closed)
            return self._placed(time, after, closed, switch=name)
        self._change_side(s, x)
        if is_kink:
            rate = self.graph.guard_flow((closed, self.sides), s, not was_above).guard(x)[1]
            if rate < 0.0:
                raise slides(self.graph, s, time, x)
            self._count_switch(time, name, x, x)
            if start.mode is Mode.FREE and self.current is not None:
                before, present = self.split_by
                self.split_by = before, present | {s}
                if s in before:
                    self._require_slow_decay(s, time, x)
        flying = self.focus if start.mode is Mode.FREE else None
        flight = None
        if scaled is not None:
            height, launch = scaled
            flight = ArcStart(
                mode=Mode.FREE, time=time, state=x, speed=start.speed, height=height, launch=launch
            )
        return self._placed(time, x, closed, flying=flying, flight=flight)

    def _settled(self, time: float, x: Vector, closed: tuple[int, ...]) -> Vector:
        """Return the state after the switches of dry friction that another one of them forces."""
        for _ in range(self.graph.n_declared):
            s = self.graph.due((closed, self.sides), x, forced=True)
            name = "" if s is None else self.graph.switch_names[s]
            if s is None or time in self.seen.switches.get(name, ())[-1:]:
                break
            after = self.graph.after_switch(s, x)
            self._count_switch(time, name, x, after)
            self._take_sides(after)
            x = after
        return x

    def _resets(self, s: int, x: Vector, closed: tuple[int, ...]) -> bool:
        """Return True if a switch sets the state: it is declared and armed, and falls or is due."""
        if s >= self.graph.n_declared:
            return False
        if self.above[s] and self.graph.guards((closed, self.sides), x)[2][s] > 0.0:
            return True
        return self.graph.due((closed, self.sides), x) == s

    def _count_switch(self, time: float, name: str, before: Vector, after: Vector) -> None:
        event = SwitchEvent(time=time, name=name, state_minus=before, state_plus=after)
        self.events.append(event)
        s = self.graph.switch_names.index(name)
        if s in self.graph.frictional:
            self.split_by = self.split_by[0], self.split_by[1] | {s}
        if s < self.graph.n_declared:
            self.seen.see_switch(time, name, after, self.own.time)
            # A kink ends a step, so the limit of steps is its limit.
            self.n_switches += 1
            if self.n_switches > self.settings.most_impacts:
                raise switches_too_often(name, self.settings.most_impacts, time, after)

    def _require_slow_decay(self, kink: int, time: float, x: Vector) -> None:
        """Refuse impacts that accumulate while a kink changes the acceleration of the gap."""
        estimates = self.current.estimates if self.current is not None else []
        if estimates and estimates[-1].speed < _ACCUMULATED * estimates[0].speed:
            self._require_continuous(kink, time, x)

    def _require_continuous(self, kink: int, time: float, x: Vector) -> None:
        """Refuse a kink that changes the acceleration of the gap in every flight."""
        other = self._beyond(kink, x)
        here = self._view(self.rest, self.focus).gap_acceleration(x)
        there = self.graph.view((self.rest, other), self.focus).gap_acceleration(x)
        if abs(here - there) > _CONTINUOUS * abs(here):
            what = f"the switch `{self.graph.switch_names[kink]}` changes"
            raise accumulate_together(self.stop_name, what, time, x)

    # Contact.

    def _placed(
        self,
        time: float,
        x: Vector,
        was_closed: tuple[int, ...] | None,
        *,
        switch: str = "",
        flying: int | None = None,
        flight: ArcStart | None = None,
    ) -> ArcStart | None:
        """Return the start at a state: each stop with zero gap and rate holds, or opens.

        Args:
            time: Time of the event [s].
            x: The state, ``(n_x,)``.
            was_closed: The stops that were closed. ``None`` for a first state, which may be one of
                another run.
            switch: Name of the switch whose reset led to the state, if there is one.
            flying: The stop that the run looked at in a flight, if it was in one.
            flight: The rest of that flight, if it is rescaled.

        Returns:
            The start, or ``None`` if the execution ends with the last of its releases.

        Raises:
            PenetrationError: If a switch sends the state into a stop.
            SimultaneousEventsError: If two stops that are coupled are struck at once.
        """
        still, opening, struck = self._stops_met(
            time, x, was_closed, switch=switch, flying=flying, goes_on=flight is not None
        )
        closed = self._contact_set(time, x, still)
        for k in closed:
            x = self._holding(closed, k).on_stop(x)
        self._require_apart(struck, closed, time, x)
        stay = (*closed, *(k for k in struck if self._view((), k).restitution == 0.0))
        if self._opened([k for k in was_closed or () if k not in stay], time, x):
            return None
        if struck:
            self.look(closed, struck[0])
            return self.impact(time, x, self.dynamics.gap_rate(x))
        leaving = [k for k in (*still, *opening) if k not in closed]
        if flying is not None and not leaving:
            leaving = [flying]
        if closed and not leaving:
            self.look(closed[:-1], closed[-1])
            return ArcStart(mode=Mode.LOCKED, time=time, state=x)
        focus = leaving[0] if leaving else self.focus
        self.look(closed, focus)
        if flight is not None and focus == flying:
            return replace(flight, state=x)
        rate = self.dynamics.gap_rate(x)
        known = focus in (was_closed or ()) or (
            focus != flying and self.dynamics.gap(x) <= self._rounding(focus, x)
        )
        if was_closed is None:
            known = known or self.dynamics.gap(x) <= rate * _APART * self.own.time
        launches = self.dynamics.gap(x) <= self.small_gap and rate > self.small_rate
        known = launches and (known or self._is_met(focus, time))
        return ArcStart(mode=Mode.FREE, time=time, state=x, speed=rate if known else None)

    def _last_met(self, stop: int) -> Impact | Release | None:
        """Return the last impact on a stop, or its last release, if there is one."""
        name = self.graph.stop_names[stop] if self.graph.stop_names else ""
        for event in reversed(self.events):
            if isinstance(event, Impact | Release) and event.stop == name:
                return event
        return None

    def _is_met(self, stop: int, time: float) -> bool:
        """Return True if a stop was struck or opened at a time, so that its gap is zero."""
        last = self._last_met(stop)
        return last is not None and last.time == time

    def _rounding(self, stop: int, x: Vector) -> float:
        """Return the rounding of a gap: of its states, and what an event left at the stop.

        It is at least the height of a flight that lasts for the rounding of its time.
        """
        least = ROUNDING**2 * self._view((), stop).own.gap
        return max(self._rounding_of_states(stop, x), _LEFT * abs(self._left_gap(stop)), least)

    def _left_gap(self, stop: int) -> float:
        """Return the gap that the last impact or release left at a stop, zero without one."""
        last = self._last_met(stop)
        return 0.0 if last is None else self._view((), stop).gap(last.after)

    def _rounding_of_states(self, stop: int, x: Vector) -> float:
        """Return the rounding of a gap by the rounding of its states."""
        return rounding_of(self._view((), stop).gap, x)

    def _closes(self, stop: int, gap: float, rate: float, x: Vector, largest: float) -> bool:
        """Return True if a gap falls through zero at a state, to its rounding.

        Where impacts come in turn, `_require_resolved` decides about larger gaps.
        """
        if not rate < 0.0 or gap > largest or self.seen.come_in_turn:
            return self._is_zero(gap, rate, largest)
        return self._is_zero(gap, rate, min(largest, self._rounding(stop, x)))

    def _stops_met(
        self,
        time: float,
        x: Vector,
        was_closed: tuple[int, ...] | None,
        *,
        switch: str,
        flying: int | None,
        goes_on: bool,
    ) -> tuple[list[int], list[int], list[int]]:
        """Return the stops with zero gap at a state: those at rest, those that open, those struck.

        Args:
            time: Time of the event [s].
            x: The state, ``(n_x,)``.
            was_closed: As for `_placed`.
            switch: As for `_placed`.
            flying: As for `_placed`.
            goes_on: Whether the flight from the stop `flying` goes on, so that it is not met.

        Raises:
            PenetrationError: If a switch sends the state into a stop.
        """
        still: list[int] = []
        opening: list[int] = []
        struck: list[int] = []
        contact = self.settings.contact
        for k, name in enumerate(self.graph.stop_names):
            if goes_on and k == flying:
                continue
            view = self._view((), k)
            below = max(START_OFF, contact) if was_closed is None or k in was_closed else contact
            # Of one stop alone, a start is as exact as its user gives it.
            small = below if self._has_others else contact
            gap, rate = view.gap(x), view.gap_rate(x)
            is_on = gap >= -below * view.own.gap
            falls = rate < -small * view.own.gap_rate
            # An open gap of a first state is as exact as its user gives it.
            apart = contact if was_closed is None else small
            if gap > apart * view.own.gap or (k == flying and not (is_on and falls)):
                continue
            # A gap above its rounding belongs to a flight, unless the stop was closed.
            is_given = was_closed is None or k in was_closed
            if not is_given and gap > self._rounding(k, x) and not self._is_zero(gap, rate, 0.0):
                continue
            if is_on and abs(rate) <= small * view.own.gap_rate:
                still.append(k)
            elif is_on and rate > 0.0:
                opening.append(k)
            elif switch and not is_on:
                raise enters_by_switch(switch, name, time, x)
            else:
                struck.append(k)
        return still, opening, struck

    def _opened(self, stops: Sequence[int], time: float, x: Vector) -> bool:
        """Record the releases of stops that another event opens.

        Args:
            stops: The stops.
            time: Time of the event [s].
            x: State after the event, ``(n_x,)``.

        Returns:
            True if the execution ends with the last of its releases.
        """
        for k in stops:
            self.events.append(Release(time=time, state=x, stop=self.graph.stop_names[k]))
            self.n_releases += 1
        return bool(stops) and self.n_releases >= self.most_releases

    def _contact_set(self, time: float, x: Vector, still: Sequence[int]) -> tuple[int, ...]:
        """Return the stops that stay closed, of those with zero gap and gap rate.

        Raises:
            SimultaneousEventsError: If no set of closed stops, or more than one fulfils the laws.
        """
        found = [
            closed
            for n in range(len(still) + 1)
            for closed in combinations(still, n)
            if all(self._holds(self._holding(closed, k), x) for k in closed)
            and not any(self._holds(self._view(closed, k), x) for k in still if k not in closed)
        ]
        if len(found) == 1:
            return found[0]
        names = ", ".join(f"`{self.graph.stop_names[k]}`" for k in still)
        raise undetermined_contact(names, time, x)

    def _holds(self, view: HybridDynamics, x: Vector) -> bool:
        """Return True if a stop at zero gap and rate stays closed."""
        lift = view.gap_acceleration(x)
        slack = is_slack(view, x, lift, self.settings.contact)
        return bool(stop_holds(lift, view.multiplier_rate(x) if slack else np.nan, slack))

    def _kept(self, x: Vector) -> tuple[int, ...]:
        """Return the closed stops that stay closed in an impact: none of them pulls."""
        if not self.rest:
            return ()
        matrix, k = self.graph.coupling(x), self.focus
        small = _LEAST_IMPULSE * float(np.max(np.abs(matrix)))
        for n in range(len(self.rest), -1, -1):
            for closed in combinations(self.rest, n):
                kept = list(closed)
                share = matrix[kept, k]
                if kept:
                    share = np.linalg.solve(matrix[np.ix_(kept, kept)], matrix[kept, k])
                opened = [j for j in self.rest if j not in closed]
                rates = matrix[opened, k] - matrix[np.ix_(opened, kept)] @ share
                pulls = share > small / np.maximum(np.abs(matrix[kept, kept]), small)
                if not np.any(pulls) and np.all(rates >= -small):
                    return closed
        raise AssertionError("A positive definite matrix has a solution.")


def _lost(rate: float, own: CharacteristicScales) -> float:
    """Return the gap that rounding may take from a flight with a gap rate."""
    return _LOST * (rate * rate / own.gap_acceleration)


def _scaled_gap(
    start: ArcStart, found: Interruption | None, end: Vector
) -> tuple[float, float] | None:
    """Return the scaled gap and its rate at the end of a rescaled flight, or ``None``.

    Args:
        start: Start of the arc.
        found: The event that ended it early, if there is one.
        end: Last state of the flow itself.
    """
    is_flight = start.mode is Mode.FREE and start.speed is not None and start.hop is None
    if not is_flight or (found is not None and found.launched is not None):
        return None
    return float(end[-2]), float(end[-1])


def _are_coupled(matrix: Vector, j: int, k: int) -> bool:
    """Return True if an impulse on one of two stops changes the gap rate of the other."""
    size = math.sqrt(float(matrix[j, j]) * float(matrix[k, k]))
    return abs(float(matrix[j, k])) > _COUPLED * size
