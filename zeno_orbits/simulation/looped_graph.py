"""An execution over a graph of modes by the compiled loop, where one stop is involved.

The loop looks at one stop at a time, with the other guards beside it. It goes on as long as they
are not involved: through flights, impacts, Zeno points, contact and releases. The rules of
`GraphRun` apply to an event of another guard, or one that may change another stop or switch. It
also follows the arcs whose guards begin at zero. So every event obeys that reference.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimultaneousEventsError
from zeno_orbits.integrators import GuardedFlow, Outcome, Passage
from zeno_orbits.loop import (
    Beside,
    GraphProgram,
    LoopRun,
    OtherGuard,
    Record,
    UnknownOperationError,
    binding,
    loop_library,
    program_of,
)
from zeno_orbits.model import CompiledGraph, ModeFunctions, OwnScale, Resting
from zeno_orbits.simulation.arc_follower import ArcStart, Pace
from zeno_orbits.simulation.execution import Arc, Ending, Event, Execution, Impact, Mode
from zeno_orbits.simulation.graph_run import GraphRun, Interruption, Kind
from zeno_orbits.simulation.loop_steps import loop_steps
from zeno_orbits.simulation.looped import COMPLETIONS, run_settings
from zeno_orbits.simulation.recorded import RecordedExecution, RecordedRun, events_of
from zeno_orbits.simulation.reference_run import ImpactSequence
from zeno_orbits.simulation.settings import SimulationTask
from zeno_orbits.simulation.zeno_limit import TailEstimate

_SEEN = 6
"""Impacts on one stop after which impacts no longer come in turn."""


class View(NamedTuple):
    """What the loop looks at.

    Attributes:
        rest: The closed stops beside the stop.
        focus: The stop.
        sides: Side of every kink.
        above: For each declared switch, whether its guard is positive.
        on: Whether a motion has entered the mode on the stop.
    """

    rest: tuple[int, ...]
    focus: int
    sides: tuple[bool, ...]
    above: tuple[bool, ...]
    on: bool


@dataclass(kw_only=True, eq=False)
class GraphRecord(RecordedRun):
    """A part of an execution that the loop carried out at one stop.

    Attributes:
        stop: Name of the stop.
        rest: Names of the stops closed beside it.
        locked: Names of the closed stops on the stop.
        sides: Side of every kink.
    """

    stop: str
    rest: tuple[str, ...]
    locked: tuple[str, ...]
    sides: tuple[bool, ...]

    @cached_property
    def events(self) -> tuple[Event, ...]:
        """The events in order of time."""
        return tuple(events_of(self.record.events, self._n_x, self.stop))

    @cached_property
    def arcs(self) -> tuple[Arc, ...]:
        """The arcs in order of time."""
        return tuple(self._named(self._arc(row), row) for row in self.record.arcs)

    def _named(self, arc: Arc, row: Vector) -> Arc:
        closed = self.locked if arc.mode is Mode.LOCKED else self.rest
        return replace(
            arc,
            mode=Mode.LOCKED if closed else Mode.FREE,
            closed=closed,
            stop=self.stop if row[0] == binding.FLIGHT else "",
            sides=self.sides,
        )


@dataclass(kw_only=True, eq=False)
class Followed:
    """A part of an execution that the reference followed.

    Attributes:
        arcs: Its arcs.
        events: Its events.
    """

    arcs: tuple[Arc, ...]
    events: tuple[Event, ...]

    @property
    def end_time(self) -> float:
        """Time of its end [s]."""
        return self.arcs[-1].end_time

    @property
    def end_state(self) -> Vector:
        """State at its end, ``(n_x,)``."""
        return self.arcs[-1].end_state


@dataclass(kw_only=True, eq=False)
class GraphHistory:
    """An execution over a graph of modes, part by part.

    Attributes:
        state_names: Name of each state.
        own: Characteristic scales of the problem.
        parts: The parts in order of time, the last one with an arc.
    """

    state_names: tuple[str, ...]
    own: OwnScale
    parts: tuple[GraphRecord | Followed, ...]

    @cached_property
    def events(self) -> tuple[Event, ...]:
        """The events in order of time."""
        return tuple(event for part in self.parts for event in part.events)

    @cached_property
    def arcs(self) -> tuple[Arc, ...]:
        """The arcs in order of time."""
        return tuple(arc for part in self.parts for arc in part.arcs)

    @property
    def end_time(self) -> float:
        """Time of the end [s]."""
        return self._last.end_time

    @property
    def end_state(self) -> Vector:
        """State at the end, ``(n_x,)``."""
        return self._last.end_state

    @property
    def _last(self) -> GraphRecord | Followed:
        return next(part for part in reversed(self.parts) if _has_arcs(part))


def _has_arcs(part: GraphRecord | Followed) -> bool:
    return bool(len(part.record.arcs) if isinstance(part, GraphRecord) else part.arcs)


@dataclass(slots=True, kw_only=True)
class LoopedGraphRun(GraphRun):
    """A running execution over a graph of modes, by the compiled loop where possible.

    Attributes:
        task: The simulation task.
        past: The execution so far, without the present arcs and events.
        runs: Runs of the loop, by what they look at.
        entered: Modes on a stop that a motion has entered.
        by_arc: Whether the loop follows single arcs: a kink splits flights of a sequence.
    """

    task: SimulationTask
    past: list[GraphRecord | Followed] = field(default_factory=list[GraphRecord | Followed])
    runs: dict[View, LoopRun | None] = field(default_factory=dict[View, "LoopRun | None"])
    entered: set[View] = field(default_factory=set[View])
    by_arc: bool = False

    def execution(self) -> Execution:
        """Return the execution so far."""
        self._put_away()
        history = GraphHistory(
            state_names=self.graph.state_names, own=self.graph.own, parts=tuple(self.past)
        )
        return RecordedExecution.of(history)

    def close(self) -> None:
        """Free the memory of the runs."""
        for run in self.runs.values():
            if run is not None:
                run.close()
        self.runs.clear()

    @property
    def has_flown(self) -> bool:
        """True if an arc has been followed."""
        return bool(self.arcs) or any(map(_has_arcs, self.past))

    @property
    def reached(self) -> float:
        """Time that the arcs have reached [s]."""
        if self.arcs:
            return self.arcs[-1].end_time
        return next((part.end_time for part in reversed(self.past) if _has_arcs(part)), 0.0)

    @property
    def last_event(self) -> Event | None:
        """The last event, if there is one."""
        if self.events:
            return self.events[-1]
        return next((part.events[-1] for part in reversed(self.past) if part.events), None)

    def phase(self, start: ArcStart) -> ArcStart | None:
        """Go on in the loop up to an event beside a stop, or follow the arc that it leaves."""
        here, self.by_arc = start, not self._may_go_on(start)
        while self._may_go_on(here):
            view = self._view_of(here)
            run = self._run_of(view)
            if run is None:
                break
            after, is_over = self._carried_on(run, here)
            if after is None or is_over:
                return after
            here = after
            if self._view_of(here) == view:
                break
        return GraphRun.phase(self, here)

    def _may_go_on(self, start: ArcStart) -> bool:
        """Return True if the loop can take over: no sequence of impacts is split by a kink."""
        if start.hop is not None:
            return False
        if self.current is None:
            return True
        if start.speed is None:
            return False
        return self.current.place != self.place or not any(self.split_by)

    def _view_of(self, start: ArcStart) -> View:
        """Return what the loop looks at from a start."""
        view = View(self.rest, self.focus, self.sides, self.above, on=True)
        if start.mode is Mode.LOCKED:
            self.entered.add(view)
        return view if view in self.entered else view._replace(on=False)

    def _run_of(self, view: View) -> LoopRun | None:
        """Return the run at a stop, or ``None`` if the library cannot carry it out."""
        if view not in self.runs:
            self.runs[view] = self._begun(view)
        return self.runs[view]

    def _begun(self, view: View) -> LoopRun | None:
        program = graph_program(self.graph.compiled, view)
        if program is None:
            return None
        # The steps of every stop have the tolerance of the machine.
        tolerance = self.follower.tolerance
        settings = run_settings(
            replace(self.task, dynamics=self.dynamics),
            relative=tolerance.relative,
            absolute=tolerance.absolute,
        )
        return LoopRun(program, settings.filled(), self.graph.p, np.zeros(program.n_x))

    def _carried_on(self, run: LoopRun, start: ArcStart) -> tuple[ArcStart | None, bool]:
        """Carry out the execution from a start.

        Returns:
            The next start, and whether the loop followed the arcs up to it. Otherwise the next arc
            is left to the reference.
        """
        place, estimates = self._place(start)
        status = self._resumed(run, place, estimates)
        record = run.taken()
        place, estimates = run.where()
        is_left = status == binding.OTHER_SIDE
        if is_left and not (len(record.arcs) or len(record.events)):
            return self.on_other_side(start, self._other(place.fallen)[1]), True
        if not (len(record.arcs) or len(record.events)):
            return start, False
        part = self._part(record)
        self._keep(part)
        self._take_counts(place)
        if status == binding.DONE:
            return None, True
        after = self._start_at(place, part, start)
        self.current = None
        if place.in_sequence and after.speed is not None:
            self.current = ImpactSequence(
                place=self.place,
                first_impact=place.first_impact,
                estimates=[_estimate(row) for row in estimates],
            )
        if is_left:
            return self.on_other_side(after, self._other(place.fallen)[1]), True
        if status != binding.EVENT:
            return after, False
        return self._event(after, record.arcs[-1], place.fallen), True

    def _resumed(self, run: LoopRun, place: binding.PlaceType, estimates: Vector) -> int:
        """Carry out a run from a place, and return its status."""
        run.put(place, estimates)
        status = binding.FULL
        while status == binding.FULL:
            status = run.resume()
            if status == binding.FULL:
                reached = run.now()[0]
                self.task.on_progress("simulating", reached / self.task.until)
        return status

    def _event(self, start: ArcStart, row: Vector, fallen: int) -> ArcStart | None:
        """Return the next start after the event at the end of an arc.

        Args:
            start: Start of the arc.
            row: The arc in the record.
            fallen: Guard beside the guard of the stop that fell, or -1.
        """
        n_x, first = len(start.state), binding.ARC_WIDTH + len(start.state)
        mode, _, time, unit = row[:4].tolist()
        x = row[first : first + n_x].copy()
        if fallen >= 0:
            return self.after_other(start, time, x, *self._other(fallen))
        if mode == binding.FLIGHT:
            return self.landing(time, x, unit * float(row[first + n_x + 1]))
        return self.meet(time, x, self.dynamics.gap_rate(x))

    def _other(self, fallen: int) -> tuple[Kind, int]:
        """Return kind and index of a guard beside the guard of the stop."""
        others = (*self.rest, *self._open_beside(self.rest))
        if fallen >= len(others):
            return Kind.SWITCH, fallen - len(others)
        return Kind.MULTIPLIER if fallen < len(self.rest) else Kind.GAP, others[fallen]

    def follow_arc(
        self, start: ArcStart, flow: GuardedFlow, natural: Ending, *, on_guard: bool
    ) -> tuple[Arc, Vector]:
        """Return the next arc, to the earliest event, and the last state of the flow itself."""
        if self.by_arc and start.hop is None:
            found = self._single(start)
            if found is not None:
                return found
        return GraphRun.follow_arc(self, start, flow, natural, on_guard=on_guard)

    def _single(self, start: ArcStart) -> tuple[Arc, Vector] | None:
        """Return the same by the loop, or ``None`` if the arc is left to the reference."""
        run = self._run_of(self._view_of(start))
        if run is None:
            return None
        place, estimates = self._place(start)
        place.single, place.n_estimates = 1, 0
        status = self._resumed(run, place, estimates[:0])
        record = run.taken()
        place, _ = run.where()
        if status not in (binding.EVENT, binding.DONE):
            return None
        self._take_pace(place)
        self.window = place.window
        part = self._part(record)
        (arc,) = part.arcs
        self.arcs.append(arc)
        (row,), n_x = record.arcs, len(start.state)
        n_y = n_x if start.speed is None else n_x + 2
        end = row[binding.ARC_WIDTH + n_x :][:n_y].copy()
        if status == binding.EVENT and place.fallen >= 0 and arc.trajectory is not None:
            kind, index = self._other(place.fallen)
            passage = Passage(
                outcome=Outcome.FALL, duration=arc.duration, state=end, trajectory=arc.trajectory
            )
            self.interruption = Interruption(kind=kind, index=index, passage=passage)
        return arc, end

    # From here to the loop.

    def _place(self, start: ArcStart) -> tuple[binding.PlaceType, Vector]:
        """Return the start of a run, and the estimates of its sequence of impacts."""
        n_x = len(start.state)
        pace = self.follower.pace
        place = binding.PlaceType(
            mode=binding.LOCKED if start.mode is Mode.LOCKED else binding.FREE,
            time=start.time,
            speed=0.0 if start.speed is None else start.speed,
            has_speed=start.speed is not None,
            has_impact=start.impact is not None and start.resting is not None,
            window=self.window,
            quiet=self.seen.quiet(self.own.time),
            n_impacts=self.n_impacts,
            n_landings=self.n_landings,
            n_releases=self.n_releases,
            n_arcs=int(self.has_flown),
            n_steps=pace.n_steps,
            next_look=pace.next_look,
            fastest=pace.fastest,
            which=pace.which,
            n_looks=len(pace.looks),
        )
        place.state[:n_x] = start.state.tolist()
        place.sizes[:n_x] = self.graph.own.states(n_x).tolist()
        place.looks[: 3 * len(pace.looks)] = [number for look in pace.looks for number in look]
        if start.impact is not None and start.resting is not None:
            place.plus[:n_x] = start.impact.state_plus.tolist()
            place.resting[:n_x] = start.resting.state.tolist()
            place.rate[:n_x] = start.resting.rate.tolist()
            place.lift = start.resting.gap_acceleration
        rounding = self._rounding()
        place.rounding[: len(rounding)] = rounding
        rows = np.zeros((0, binding.ESTIMATE_WIDTH + 2 * n_x))
        if self.current is not None and self.current.place == self.place:
            place.in_sequence, place.first_impact = 1, self.current.first_impact
            estimates = self.current.estimates
            if estimates:
                rows = np.array([_row(estimate) for estimate in estimates])
                place.n_estimates, place.first_speed = len(rows), estimates[0].speed
        return place, rows

    def _rounding(self) -> list[float]:
        """Return the rounding of the guards of other stops, in the order of their program."""
        contact, open_mode = self.settings.contact, self.graph.open_mode
        others = (*self.rest, *self._open_beside(self.rest))
        owns = [self.graph.view(open_mode, k).own for k in others]
        n = len(self.rest)
        return [contact * (own.multiplier if k < n else own.gap) for k, own in enumerate(owns)]

    # From the loop.

    def _part(self, record: Record) -> GraphRecord:
        names = self.graph.stop_names
        return GraphRecord(
            dynamics=self.dynamics,
            tolerance=self.follower.tolerance,
            record=record,
            paths={},
            stop=self.stop_name,
            rest=tuple(names[k] for k in self.rest),
            locked=tuple(names[k] for k in sorted((*self.rest, self.focus))),
            sides=self.sides,
        )

    def _keep(self, part: GraphRecord) -> None:
        """Record a part, unless its impacts accumulate on several stops in turn.

        Raises:
            SimultaneousEventsError: If they do, with the execution up to that impact.
        """
        self._put_away()
        rows = part.record.events
        impacts = np.flatnonzero(rows[:, 0] == binding.IMPACT)
        times, states = rows[impacts, 1].tolist(), binding.EVENT_WIDTH
        n_x = len(self.dynamics.state_names)
        for k, time in zip(impacts[:_SEEN].tolist(), times, strict=False):
            try:
                self.seen.see_impact(time, self.stop_name, rows[k, states : states + n_x])
            except SimultaneousEventsError:
                n_arcs = int(np.sum(part.record.arcs[:, 2] <= time))
                self.past.append(self._part(_until(part.record, k, n_arcs)))
                raise
        self.seen.see_impacts(times[_SEEN:], self.stop_name)
        for _ in times[:2]:
            self.split_by = self.split_by[1], frozenset()
        self.past.append(part)

    def _put_away(self) -> None:
        """Move the arcs and events that the reference followed to the past."""
        if self.arcs or self.events:
            self.past.append(Followed(arcs=tuple(self.arcs), events=tuple(self.events)))
            self.arcs, self.events = [], []

    def _take_counts(self, place: binding.PlaceType) -> None:
        self.n_impacts, self.n_landings = place.n_impacts, place.n_landings
        self.n_releases, self.window = place.n_releases, place.window
        self._take_pace(place)

    def _take_pace(self, place: binding.PlaceType) -> None:
        numbers = iter(place.looks[: 3 * place.n_looks])
        self.follower.pace = Pace(
            n_steps=place.n_steps,
            next_look=place.next_look,
            looks=tuple(zip(numbers, numbers, numbers, strict=True)),
            fastest=place.fastest,
            which=place.which,
        )

    def _start_at(self, place: binding.PlaceType, part: GraphRecord, before: ArcStart) -> ArcStart:
        """Return the start at which the loop stopped."""
        n_x = len(before.state)
        impact, resting = before.impact, None
        if place.has_impact:
            rows = part.record.events
            for event in events_of(rows[rows[:, 0] == binding.IMPACT][-1:], n_x, self.stop_name):
                impact = event if isinstance(event, Impact) else None
            resting = Resting(
                state=np.array(place.resting[:n_x]),
                gap_acceleration=place.lift,
                rate=np.array(place.rate[:n_x]),
            )
        return ArcStart(
            mode=Mode.LOCKED if place.mode == binding.LOCKED else Mode.FREE,
            time=place.time,
            state=np.array(place.state[:n_x]),
            speed=place.speed if place.has_speed else None,
            impact=impact if place.has_impact else None,
            resting=resting,
        )


def serves_graph(task: SimulationTask) -> bool:
    """Return True if the loop can carry out parts of a task: steps and completion are its own."""
    return (
        loop_library() is not None
        and loop_steps(task.settings.engine) is not None
        and type(task.settings.completion) in COMPLETIONS
    )


_programs: WeakKeyDictionary[CompiledGraph, dict[View, GraphProgram | None]] = WeakKeyDictionary()


def graph_program(compiled: CompiledGraph, view: View) -> GraphProgram | None:
    """Return a stop of a graph in the library's format, or ``None`` if it cannot carry it out.

    Args:
        compiled: The graph.
        view: The stop and its mode.
    """
    made = _programs.setdefault(compiled, {})
    if view not in made:
        made[view] = _made(compiled, view)
    return made[view]


def _made(compiled: CompiledGraph, view: View) -> GraphProgram | None:
    library, n_stops = loop_library(), len(compiled.graph.stops)
    mode = (view.rest, view.sides)
    program = program_of(compiled.system(mode, view.focus))
    sides = (*view.above, *view.sides)
    n_guards = n_stops - 1 + len(sides)
    if library is None or program is None or n_guards > binding.GUARDS:
        return None
    beside = Beside(
        stop=view.focus,
        n_stops=n_stops,
        guards=_others(compiled, view),
        n_switches=len(sides),
        switches=compiled.switches,
        delassus=compiled.delassus,
    )
    try:
        return GraphProgram(library, program, beside)
    except UnknownOperationError:
        return None


def _others(compiled: CompiledGraph, view: View) -> list[OtherGuard]:
    """Return the guards beside a stop: closed stops, open stops, declared switches, kinks."""
    off = (view.rest, view.sides)
    on = (tuple(sorted((*view.rest, view.focus))), view.sides) if view.on else None
    found: list[OtherGuard] = []
    for j in view.rest:
        held = [
            None
            if mode is None
            else compiled.system((tuple(k for k in mode[0] if k != j), mode[1]), j).locked
            for mode in (off, on)
        ]
        found.append(_other(binding.OTHER_MULTIPLIER, j, 1.0, held))
    for k in range(len(compiled.graph.stops)):
        if k not in (*view.rest, view.focus):
            open_at = [
                None if mode is None else compiled.system(mode, k).free for mode in (off, on)
            ]
            found.append(_other(binding.OTHER_GAP, k, 1.0, open_at))
    for s, positive in enumerate((*view.above, *view.sides)):
        kind = binding.DECLARED if s < len(view.above) else binding.KINK
        at = [None if mode is None else compiled.guard(mode, s, positive) for mode in (off, on)]
        found.append(_other(kind, -1, 1.0 if positive else -1.0, at))
    return found


def _other(kind: int, stop: int, sign: float, modes: list[ModeFunctions | None]) -> OtherGuard:
    off, on = modes
    if off is None:
        raise ValueError("Argument `modes` must begin with the mode off the stop.")
    return OtherGuard(kind=kind, stop=stop, sign=sign, off=off, on=on)


def _row(estimate: TailEstimate) -> list[float]:
    """Return an estimate as the library has it."""
    told = (estimate.impact_time, estimate.speed, estimate.gap_acceleration, estimate.time)
    return [*told, *estimate.resting.tolist(), *estimate.state.tolist()]


def _estimate(row: Vector) -> TailEstimate:
    """Return an estimate of the library."""
    n_x = (len(row) - binding.ESTIMATE_WIDTH) // 2
    impact_time, speed, lift, time = row[: binding.ESTIMATE_WIDTH].tolist()
    resting, state = np.split(row[binding.ESTIMATE_WIDTH :], [n_x])
    return TailEstimate(
        impact_time=impact_time,
        resting=resting,
        speed=speed,
        time=time,
        state=state,
        gap_acceleration=lift,
    )


def _until(record: Record, n_events: int, n_arcs: int) -> Record:
    """Return the first events and arcs of a record."""
    return Record(
        steps=record.steps,
        polynomials=record.polynomials,
        arcs=record.arcs[:n_arcs],
        events=record.events[:n_events],
    )
