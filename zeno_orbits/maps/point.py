"""One point of a map: its motion is simulated until its attractor is known."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.maps.approach import (
    SAME_PERIOD,
    Accuracy,
    Approach,
    all_come_nearer,
    is_approached,
    places_on_the_way,
    steps_towards,
)
from zeno_orbits.maps.attractors import Attractor, AttractorClass
from zeno_orbits.maps.known import KnownOrbit, Recognition
from zeno_orbits.maps.newton import ClosedOrbit, fades, limit_of_steps, orbit_near, usual_sections
from zeno_orbits.model import GraphDynamics
from zeno_orbits.orbits import SectionMode, event_return, kind_of_events, orbit_event_name
from zeno_orbits.simulation import (
    LOOK_BACK,
    WAITING,
    AttractorKind,
    Event,
    Impact,
    Motion,
    MotionEnd,
    MotionLog,
    Piece,
    Reason,
    Repetition,
    SectionReturn,
    Settling,
    SwitchEvent,
    changes,
    clock_turn,
    outcome_of,
    scale_of,
    state_after,
    transient_settings,
    verdict,
    watched_motion,
    without_events,
)

_BETWEEN, _EXACT = 128, 1e-9
"""Impacts between two tests for repetition, and change over a period that counts as zero."""
_REMEMBERED = 40
"""Number of stored returns to a section."""
_SEEN, _AFRESH = 64, 64
"""Number of the last events that have the section, and events after which it is chosen anew."""
_MUCH_NEARER, _LATER = 0.3, 8
"""Newton's method is repeated if the change decreases by this factor, or after as many returns."""
_CLOSE, _FAST = 1e-4, 0.25
"""Change up to which a motion goes on, if it decreases by this factor per period."""
_PATIENCE = 4
"""Failures of Newton's method after which a decrease of the change does not cause a repetition."""
_APART = 0.2
"""Factor by which a longer period must reduce the change over a shorter period."""
_STRETCHES = 2.0
"""Relative difference of return times per unit of distance from the orbit."""
_SAME = 1e-8
"""Two events are the same if they differ by less than this part of the time limit.

Rounding has then put the start in contact.
"""
_STEADY, _PERIODS, _ROUNDED = 0.1, 12, 1e-15
"""Relative spread of a steady change, the periods that show it, and a change that is rounding."""
_IDLE = 16.0
"""Turns of the clock without an event, after which a motion may repeat without events."""


@dataclass(slots=True)
class _Visits:
    """The events of one name.

    Attributes:
        every: Times of all of them [s].
        times: Times of those that do not accumulate [s].
        returns: The last of these.
        unit: Size of each state at the first of these, ``(n_x,)``.
        amplitudes: Scalar size of each of these.
        tried: Change and number of returns at the last attempt, by the number of returns.
    """

    unit: Vector
    every: list[float] = field(default_factory=list[float])
    times: list[float] = field(default_factory=list[float])
    returns: list[SectionReturn] = field(default_factory=list[SectionReturn])
    amplitudes: list[float] = field(default_factory=list[float])
    tried: dict[int, tuple[float, int]] = field(default_factory=dict[int, tuple[float, int]])


class Point:
    """A motion that is simulated until its attractor is known."""

    def __init__(
        self,
        graph: GraphDynamics,
        units: Sequence[str],
        start: Vector,
        until: float,
        accuracy: Accuracy,
        bounds: Vector | None = None,
        known: Sequence[KnownOrbit] = (),
        starts: Sequence[str] = (),
    ) -> None:
        """Begin at an initial state.

        Args:
            graph: The graph of modes.
            units: Unit of each state.
            start: Initial state, ``(n_x,)``.
            until: Longest simulated time [s].
            accuracy: Accuracy of the simulation.
            bounds: Largest modulus of each state, ``(n_x,)``.
            known: Orbits with which the motion is compared at every event.
            starts: Events at which the period of an orbit starts, the best first. By default the
                usual sections.
        """
        self._graph, self._units, self._start, self._until = graph, units, start, until
        self._accuracy, self._bounds, self._starts = accuracy, bounds, tuple(starts)
        self._usual = graph.own.states(len(start))
        # Returns of one simulation differ by its own errors.
        self._same = max(accuracy.repeats, accuracy.reached)
        # A longer limit does not make events the same.
        self._at_once = _SAME * min(until, WAITING * graph.own.time)
        self._views = dict(zip(graph.stop_names, graph.open_views, strict=False))
        elastic = all(view.restitution >= 1.0 for view in graph.open_views)
        self._log = MotionLog(units=units, usual=self._usual, elastic=elastic)
        self._checked, self._failures, self._reason = 0, 0, ""
        self._visits: dict[str, _Visits] = {}
        self._speeds: dict[str, float] = {}
        self._recent: deque[Event] = deque(maxlen=_SEEN)
        self._section, self._chosen, self._among = "", 0, frozenset[str]()
        self._count = 0
        self._changed, self._idle = 0.0, 0.0
        self._piece: Piece | None = None
        self._known = [Recognition(orbit=one, reached=accuracy.reached) for one in known]
        self.way: Approach | None = None

    def attractor(self) -> Attractor:
        """Simulate the motion and return its attractor."""
        motion = watched_motion(
            self._graph,
            self._start,
            until=self._until,
            error=self._accuracy.motion,
            bounds=self._bounds,
        )
        for piece in motion:
            found = self._ended(piece) if isinstance(piece, MotionEnd) else self._went_on(piece)
            if found is not None:
                return found
        raise AssertionError("The run lacks an end.")

    def _went_on(self, piece: Piece) -> Attractor | None:
        """Return the attractor if a piece of the motion shows it."""
        self._piece = piece
        for event in piece.events:
            found = self._met(event) or self._repeating()
            if found is not None:
                return found
        return self._without_events(piece)

    def _met(self, event: Event) -> Attractor | None:
        """Compare the state after an event with those after earlier events of its name."""
        name, time, state = orbit_event_name(event), event.time, np.asarray(state_after(event))
        self._log.add(event)
        self._recent.append(event)
        self._count += 1
        if name not in self._visits:
            self._visits[name] = _Visits(scale_of([state], self._units, self._usual))
        visits = self._visits[name]
        visits.every.append(time)
        recognized = self._recognized(name, state)
        if recognized is not None:
            return recognized
        if self._accumulates(event):
            return None
        if visits.times and time - visits.times[-1] < self._at_once:
            return None
        visits.times.append(time)
        visits.returns.append(SectionReturn(time=time, state=state))
        del visits.returns[:-_REMEMBERED]
        visits.amplitudes.append(float(np.max(np.abs(state) / visits.unit)))
        if len(visits.returns) < 2:
            return None
        self._choose(name)
        return self._returned(visits) if name == self._section else None

    def _accumulates(self, event: Event) -> bool:
        """Return True for an impact that goes on with the sequence of its predecessor.

        The speed of successive impacts in a sequence decreases by about the factor `e`.
        """
        if isinstance(event, SwitchEvent):
            return False
        if not isinstance(event, Impact):
            self._speeds.pop(event.stop, None)
            return False
        view = self._views[event.stop]
        speed = view.speed_after(event.approach_rate)
        before, self._speeds[event.stop] = self._speeds.get(event.stop, 0.0), speed
        return view.restitution < 1.0 and speed < (1.0 + view.restitution) / 2.0 * before

    def _choose(self, name: str) -> None:
        """Choose the section among the last events, from time to time and at a new event."""
        if name in self._among and self._count < self._chosen + _AFRESH:
            return
        names = [orbit_event_name(event) for event in self._recent]
        self._among = frozenset(names)
        section = next(iter(usual_sections(self._graph, self._recent)), "")
        times = Counter(event.time for event in self._recent)
        release = section.replace("zeno ", "release ", 1)
        ends = zip(self._recent, names, strict=True)
        is_own = (times[one.time] == 1 and name == release for one, name in ends)
        # A motion that is held forgets its errors up to the release.
        self._section = release if any(is_own) else section
        self._chosen = self._count

    def _returned(self, visits: _Visits) -> Attractor | None:
        """Compare a new return to the section with earlier returns."""
        settling = self._settling(visits)
        if settling.outcome is AttractorKind.DIES_OUT:
            return Attractor(fate=AttractorClass.REST, trend=settling.trend)
        if any(one.orbit.section == self._section and one.may_see for one in self._known):
            return None
        for repeated in settling.repetitions:
            if self._is_worth_it(visits, repeated):
                return self._attempted(visits, repeated)
        return None

    def _settling(self, visits: _Visits) -> Settling:
        """Classify the motion from its returns to a section."""
        # A forced motion strikes for as long as its amplitude changes, by other laws than at rest.
        fades = not self._graph.first.clock or not self._section.startswith("impact ")
        motion = Motion(
            units=self._units,
            usual=self._usual,
            returns=visits.returns,
            amplitudes=visits.amplitudes if fades else (),
        )
        return outcome_of(motion, close=self._accuracy.near, apart=_APART)

    def _is_worth_it(self, visits: _Visits, repeated: Repetition) -> bool:
        """Return True if another attempt of Newton's method is worthwhile."""
        n, returns = repeated.returns, visits.returns
        if repeated.change > _CLOSE and len(returns) > 2 * n:
            # A motion that converges fast comes nearer at less cost than by Newton's method.
            earlier = changes([one.state for one in returns[:-n]], self._scale(visits)).get(n)
            if earlier is not None and repeated.change < _FAST * earlier:
                return False
        before, at = visits.tried.get(n, (np.inf, -np.inf))
        # A motion that never converges passes near many orbits. The attempts become less frequent.
        later = len(visits.amplitudes) >= at + _LATER * 2 ** max(self._failures - 1, 0)
        return later or (repeated.change < _MUCH_NEARER * before and self._failures < _PATIENCE)

    def _attempted(self, visits: _Visits, repeated: Repetition) -> Attractor | None:
        """Return the orbit near returns that nearly repeat, if the motion converges to it."""
        n = repeated.returns
        visits.tried[n] = repeated.change, len(visits.amplitudes)
        now, before = visits.returns[-1], visits.returns[-1 - n]
        x, mode = now.state, self._mode(now.time)
        if len(visits.returns) > 2 * n:
            earlier = visits.returns[-1 - 2 * n].state
            x = limit_of_steps(x, before.state, earlier, self._scale(visits))
        closed = orbit_near(
            self._graph,
            x,
            section=self._section,
            n_returns=_between(visits.every, before.time, now.time),
            guess=now.time - before.time,
            mode=mode,
            accuracy=self._accuracy,
            starts=self._starts,
        )
        if closed is not None:
            found = self._converged(closed, visits, n, mode)
        else:
            # A change that is an error has no direction.
            may_fade = n == 1 and repeated.change > self._same
            found = (self._fading(visits, mode) if may_fade else None) or self._repeated(visits, n)
        self._failures += found is None
        return found

    def _fading(self, visits: _Visits, mode: SectionMode) -> Attractor | None:
        """Return the rest to which the steps of Newton's method lead, if the motion decays."""
        trend = self._settling(visits).trend
        last, before = visits.returns[-1], visits.returns[-2]
        if not trend < 1.0 or not fades(
            self._graph,
            last.state,
            section=self._section,
            guess=last.time - before.time,
            mode=mode,
            error=self._accuracy.motion,
        ):
            return None
        return Attractor(fate=AttractorClass.REST, trend=trend)

    def _scale(self, visits: _Visits) -> Vector:
        """Return the size of each state at the last returns, ``(n_x,)``."""
        states = [one.state for one in visits.returns[-LOOK_BACK:]]
        return scale_of(states, self._units, self._usual)

    def _mode(self, time: float) -> SectionMode:
        """Return the mode just after the event of the section."""
        assert self._piece is not None
        closed, sides = self._piece.mode_after(time)
        names = tuple(self._graph.stop_names[k] for k in closed)
        return SectionMode.in_mode(names, sides, tuple(self._recent))

    def _converged(
        self, closed: ClosedOrbit, visits: _Visits, n: int, mode: SectionMode
    ) -> Attractor | None:
        """Return an orbit if it is stable and the motion converges to it.

        Args:
            closed: The orbit.
            visits: The returns of the motion.
            n: Number of them after which the motion nearly repeats.
            mode: The mode just after the event of the section.
        """
        if not all(abs(value) < 1.0 for value in closed.attractor.multipliers):
            return None
        events = _between(visits.every, visits.returns[-1 - n].time, visits.returns[-1].time)
        n = max(n * closed.n_returns // events, 1)
        before, now = visits.returns[-1 - n], visits.returns[-1]
        since, away = (closed.chart.coordinates(one.state) for one in (before, now))
        span, accuracy = now.time - before.time, self._accuracy
        distance = float(np.max(np.abs([since, away]), initial=0.0))
        close = max(SAME_PERIOD, accuracy.reached, _STRETCHES * distance)
        is_doubtful = abs(closed.attractor.period - span) > close * span
        if is_doubtful and not accuracy.motion > accuracy.orbit:
            return None
        if not (
            is_approached(since, away, closed.slope, accuracy.reached)
            or self._leads_there(closed, since, away, mode)
        ):
            return None
        passed = [one.state for one in reversed(visits.returns)][::n]
        chart = closed.chart
        on_the_way = steps_towards(passed, chart.centre, chart.scale, accuracy.reached)
        self._note_way(visits.times, n * on_the_way)
        if self.way is not None:
            self.way = replace(self.way, doubtful=is_doubtful)
        return closed.attractor

    def _leads_there(
        self, closed: ClosedOrbit, since: Vector, away: Vector, mode: SectionMode
    ) -> bool:
        """Return True if returns lead to an orbit from all test points on the way to it.

        Args:
            closed: The orbit.
            since: The return a period before in the chart of the orbit, ``(d,)``.
            away: The last return in the chart of the orbit, ``(d,)``.
            mode: The mode just after the event of the section.
        """
        if not all_come_nearer(since[None], away[None], closed.slope):
            return False
        settings = transient_settings(self._accuracy.orbit)
        places, images = list[Vector](), list[Vector]()
        try:
            for place in places_on_the_way(away, closed.slope):
                found = event_return(
                    self._graph,
                    closed.chart.centre + closed.chart.lift @ place,
                    section=self._section,
                    n_returns=closed.n_returns,
                    guess=closed.attractor.period,
                    settings=settings,
                    mode=mode,
                )
                places.append(closed.chart.coordinates(found.start))
                images.append(closed.chart.coordinates(found.end))
        except SimulationError:
            return False
        if not places:
            return False
        return all_come_nearer(np.array(places), np.array(images), closed.slope)

    def _repeated(self, visits: _Visits, n: int) -> Attractor | None:
        """Return the orbit of returns that repeat to the accuracy, without its multipliers."""
        if len(visits.returns) <= 2 * n:
            return None
        earlier, before, now = (
            visits.returns[-1 - 2 * n],
            visits.returns[-1 - n],
            visits.returns[-1],
        )
        period = now.time - before.time
        # A section may be a single state, to which a chaotic motion returns.
        if not math.isclose(before.time - earlier.time, period, rel_tol=SAME_PERIOD):
            return None
        states = np.array([one.state for one in visits.returns[-1 - 2 * n :]])
        scale = scale_of(list(states), self._units, self._usual)
        if not np.max(np.abs(states[n:] - states[:-n]) / scale) < self._same:
            return None
        drift = _drift([one.state for one in visits.returns[::-n][:_PERIODS]], scale)
        if drift:
            name = self._graph.state_names[drift[0]]
            much = f"by {drift[1]:.1g} of its size per period"
            self._reason = f"`{name}` changes steadily, {much}, so the motion does not repeat"
            return None
        self._note_way(visits.times, n)
        events = [one for one in self._recent if before.time < one.time <= now.time]
        return self._unclosed(events, period, now.state)

    def _unclosed(self, events: Sequence[Event], period: float, state: Vector) -> Attractor:
        """Return the orbit of some events, without its multipliers."""
        names = [orbit_event_name(event) for event in events]
        times = [event.time for event in events]
        kind = kind_of_events(list(zip(names, times, strict=True)))
        speeds = [-event.approach_rate for event in events if isinstance(event, Impact)]
        return Attractor(
            fate=AttractorClass(kind),
            returns=sum(name in self._starts[:1] for name in names),
            period=period,
            margins={"first_impact_speed": min(speeds)} if speeds else {},
            state=self._named(state),
        )

    def _note_way(self, times: Sequence[float], on_the_way: int) -> None:
        """Record the approach of the motion to its orbit, over its last events."""
        self.way = Approach(times=tuple(times), captured=max(len(times) - 1 - on_the_way, 0))

    def _recognized(self, name: str, state: Vector) -> Attractor | None:
        """Return the known orbit to which the motion converges, and record its approach."""
        for one in self._known:
            if one.orbit.section == name and one.sees(state):
                self._note_way(self._visits[name].every, len(one.passed) - 1)
                return one.orbit.attractor
        return None

    def _repeating(self) -> Attractor | None:
        """Return the orbit of a motion whose events repeat to rounding, tested at intervals."""
        if self._log.count < self._checked + _BETWEEN:
            return None
        self._checked = self._log.count
        cycle = self._log.cycle(_EXACT)
        if cycle is None or self._log.drift():
            return None
        return self._unclosed(cycle.events, cycle.period, np.asarray(cycle.events[-1].after))

    def _without_events(self, piece: Piece) -> Attractor | None:
        """Return the orbit of a motion without events, looked for at longer and longer times."""
        turn = clock_turn(self._graph.first, piece.state)
        if piece.events or turn is None:
            self._changed, self._idle = piece.time, _IDLE
            return None
        if piece.time - self._changed < self._idle * turn:
            return None
        self._idle *= 2.0
        try:
            found = without_events(self._graph, self._log, piece.state, self._same)
        except SimulationError:
            return None
        if found.kind is not AttractorKind.REPEATS:
            return None
        return self._eventless(found.turns, turn, piece.state)

    def _eventless(self, turns: int, turn: float, state: Vector) -> Attractor:
        """Return the attractor of a motion that repeats without events.

        Args:
            turns: Number of turns of the clock in a period.
            turn: Time of a turn [s].
            state: A state of the motion, ``(n_x,)``.
        """
        stops = self._in_contact()
        fate = AttractorClass.HELD if stops else AttractorClass.NO_ZENO
        return Attractor(
            fate=fate,
            period=turns * turn,
            state=self._named(state),
            detail=self._where(stops),
        )

    def _in_contact(self) -> list[str]:
        """Return the names of the stops that are closed at the end of the motion so far."""
        closed = () if self._piece is None else self._piece.mode[0]
        return [self._graph.stop_names[k] for k in closed]

    def _where(self, stops: Sequence[str]) -> str:
        """Return the stops of permanent contact as text. A single stop is not named."""
        if not stops or len(self._graph.stop_names) == 1:
            return ""
        return f"contact on {', '.join(f'`{name}`' for name in stops)}"

    def _ended(self, event: MotionEnd) -> Attractor:
        """Return the attractor at the end of the observation."""
        match event.reason:
            case Reason.FAILURE:
                return Attractor(
                    fate=AttractorClass.FAILED, detail=event.detail, state=self._named(event.state)
                )
            case Reason.ESCAPE:
                return Attractor(fate=AttractorClass.ESCAPE, escaped=event.detail)
            case Reason.REST:
                return Attractor(fate=AttractorClass.REST)
            case Reason.HELD:
                return self._held()
            case Reason.HORIZON:
                return self._at_last(event.state)

    def _held(self) -> Attractor:
        """Classify a motion that stays in contact."""
        visits = self._visits.get(self._section)
        dies_out = visits and self._settling(visits).outcome is AttractorKind.DIES_OUT
        if dies_out:
            return Attractor(fate=AttractorClass.REST)
        return Attractor(fate=AttractorClass.HELD, detail=self._where(self._in_contact()))

    def _at_last(self, state: Vector) -> Attractor:
        """Classify a motion that was simulated to its time limit."""
        visits, trend = self._visits.get(self._section), math.nan
        if visits is not None:
            settling = self._settling(visits)
            trend = settling.trend
            if settling.outcome is AttractorKind.DIES_OUT:
                return Attractor(fate=AttractorClass.REST)
        found = verdict(
            self._graph,
            self._log,
            state,
            self._until,
            close=self._accuracy.repeats,
            goes_on=self._accuracy.exponents,
        )
        if found.cycle is not None:
            events = found.cycle.events
            return self._unclosed(events, found.cycle.period, np.asarray(events[-1].after))
        if found.kind is AttractorKind.REPEATS:
            turn = clock_turn(self._graph.first, state) or math.nan
            return self._eventless(found.turns, turn, state)
        exponent = found.exponent
        return Attractor(
            fate=AttractorClass.UNSETTLED,
            kind=found.kind,
            trend=trend,
            detail=self._reason or found.reason,
            exponent=math.nan if exponent is None else exponent.value,
            exponent_error=math.nan if exponent is None else exponent.error,
        )

    def _named(self, state: Vector) -> dict[str, float]:
        # The state of a failure may have further entries.
        names = self._graph.state_names
        return dict(zip(names, state[: len(names)].tolist(), strict=True))


def _between(times: Sequence[float], after: float, last: float) -> int:
    """Return the number of times after one time, up to another."""
    return bisect_right(times, last) - bisect_right(times, after)


def _drift(passed: Sequence[Vector], scale: Vector) -> tuple[int, float] | None:
    """Return the state that changes most by equal steps, and the step, relative to its size.

    The changes of a motion that approaches an orbit become smaller, or are rounding.
    """
    if len(passed) < _PERIODS:
        return None
    steps = np.diff(np.array(passed), axis=0) / scale
    means = np.abs(np.mean(steps, axis=0))
    k = int(np.argmax(means))
    steady = np.ptp(steps[:, k]) < _STEADY * means[k]
    return (k, float(means[k])) if steady and means[k] > _ROUNDED else None
