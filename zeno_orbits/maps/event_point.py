"""One point of a map of a machine with several stops or switches.

The motion is simulated from its start for longer and longer times. Its returns to a section after
an event are classified as those of a machine with one stop. Newton's method then closes the orbit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import (
    InputError,
    RunawayError,
    SimulationError,
    StepLimitError,
    counted,
)
from zeno_orbits.maps.approach import Approach, is_approached, steps_towards
from zeno_orbits.maps.attempt import Accuracy
from zeno_orbits.maps.attractors import Attractor, AttractorClass
from zeno_orbits.maps.known import KnownOrbit, Recognition
from zeno_orbits.model import GraphDynamics, own_time
from zeno_orbits.orbits import (
    EventReturn,
    SectionMode,
    closed_return,
    event_return,
    event_sections,
    kind_of_events,
    largest_states,
    multipliers_of_return,
    orbit_event_name,
    phases_of_events,
    sequence_of,
    shortest_return,
)
from zeno_orbits.simulation import (
    AttractorKind,
    Event,
    Execution,
    Motion,
    SectionReturn,
    Settling,
    SimulationSettings,
    ZenoPoint,
    clock_turn,
    has_left,
    has_overflowed,
    is_still,
    outcome_of,
    scale_of,
    simulated_at_most,
    state_after,
    transient_settings,
)

_FIRST, _LONGER = 12.0, 4.0
"""First simulated time in units of the problem's slowest time, and factor of the next one."""
_STEPS = 20_000
"""Most steps of the first simulation. The slowest time may be far longer than a period."""
_REMEMBERED = 40
"""Number of the last returns that are compared."""
_APART = 0.2
"""Factor by which a longer period must reduce the change over a shorter period."""
_STEADY, _PERIODS, _ROUNDED = 0.1, 12, 1e-15
"""Relative spread of a steady change, the periods that show it, and a change that is rounding."""
_TURNS = 32
"""Longest period in the search for motions without events, in turns of the clock."""
_SAMPLES = 64
"""States of the last turn of a motion that may rest."""
_CONTACT = 1e-9
"""Part of a state's usual size that counts as no motion."""


class EventPoint:
    """A motion of a machine with several stops or switches, until its attractor is known."""

    def __init__(
        self,
        graph: GraphDynamics,
        units: Sequence[str],
        start: Vector,
        until: float,
        accuracy: Accuracy,
        bounds: Vector,
        known: Sequence[KnownOrbit] = (),
    ) -> None:
        """Begin at an initial state.

        Args:
            graph: The graph of modes.
            units: Unit of each state.
            start: Initial state, ``(n_x,)``.
            until: Longest simulated time [s].
            accuracy: Accuracy of the simulation.
            bounds: Largest modulus of each state, ``(n_x,)``.
            known: Orbits with which the motion is compared.
        """
        self._graph, self._units, self._start, self._until = graph, units, start, until
        self._accuracy, self._bounds, self._known = accuracy, bounds, known
        self._usual = graph.own.states(len(start))
        # Returns of one simulation differ by its own errors.
        self._same = max(accuracy.repeats, accuracy.reached)
        self.way: Approach | None = None
        self._reason = ""

    def attractor(self) -> Attractor:
        """Simulate the motion and return its attractor."""
        far = tuple(self._bounds[: self._graph.n_q].tolist())
        settings = transient_settings(self._accuracy.motion, far)
        time, steps = _FIRST * own_time(self._graph.first, self._start), _STEPS
        try:
            while True:
                time = min(time, self._until)
                motion, is_cut = self._simulated(time, steps, settings)
                found = None if motion is None else self._classified(motion)
                if found is not None:
                    return found
                if motion is not None and time == self._until and not is_cut:
                    return self._at_last(motion)
                if is_cut and steps >= settings.most_steps:
                    most = counted(settings.most_steps, "step")
                    detail = f"The motion needs more than {most}"
                    return Attractor(fate=AttractorClass.FAILED, detail=detail)
                steps *= int(_LONGER)
                if not is_cut:
                    time *= _LONGER
        except RunawayError as error:
            escaped = error.coordinate or error.reason.split()[0]
            return Attractor(fate=AttractorClass.ESCAPE, escaped=escaped)
        except SimulationError as error:
            beyond = has_overflowed(error.state, self._graph.n_q, self._graph.own)
            if beyond.any():
                return self._escaped(beyond)
            return Attractor(fate=AttractorClass.FAILED, detail=error.reason)
        except InputError as error:
            detail = f"The start is not admissible: {str(error).partition('must ')[2]}"
            return Attractor(fate=AttractorClass.FAILED, detail=detail)

    def _simulated(
        self, time: float, steps: int, settings: SimulationSettings
    ) -> tuple[Execution | None, bool]:
        """Return the motion until a time or a number of steps, and whether the steps ended it.

        It is None without an event in these steps, if more are allowed: a pole may be ahead.
        """
        try:
            return simulated_at_most(
                self._graph, self._start, until=time, most_steps=steps, settings=settings
            )
        except StepLimitError:
            if steps >= settings.most_steps:
                raise
            return None, True

    def _classified(self, motion: Execution) -> Attractor | None:
        """Return the attractor of a motion, if it is known by now."""
        recognized = self._recognized(motion)
        if recognized is not None:
            return recognized
        beyond = np.abs(motion.end_state) > self._bounds
        if beyond.any():
            return self._escaped(beyond)
        if self._is_still(motion):
            return Attractor(fate=AttractorClass.REST)
        late = tuple(event for event in motion.events if event.time > motion.end_time / 2)
        if not late:
            return self._without_events(motion)
        counted = _counted(motion.events)
        for section in _sections(event_sections(replace(motion, events=late), self._graph)):
            returns = [
                SectionReturn(time=event.time, state=np.asarray(state_after(event)))
                for event in counted
                if orbit_event_name(event) == section
            ]
            settling = self._settling(returns)
            if settling.outcome is AttractorKind.DIES_OUT:
                return Attractor(fate=AttractorClass.REST, trend=settling.trend)
            for repeated in settling.repetitions:
                found = self._closed(motion, section, returns, repeated.returns)
                if found is not None:
                    return found
        return None

    def _settling(self, returns: Sequence[SectionReturn]) -> Settling:
        """Classify the motion from its returns to a section."""
        unit = scale_of([returns[0].state], self._units, self._usual)
        motion = Motion(
            units=self._units,
            usual=self._usual,
            returns=returns[-_REMEMBERED:],
            amplitudes=[float(np.max(np.abs(one.state) / unit)) for one in returns],
        )
        return outcome_of(motion, close=self._accuracy.near, apart=_APART)

    def _closed(
        self, motion: Execution, section: str, returns: Sequence[SectionReturn], n: int
    ) -> Attractor | None:
        """Return the stable orbit of `n` returns that the motion approaches."""
        before, now = returns[-1 - n], returns[-1]
        mode = SectionMode.after(motion, section, now.time, before.time)
        try:
            found = self._near(section, now.state, n, now.time - before.time, mode)
            found = shortest_return(self._graph, found, SimulationSettings())
            multipliers = multipliers_of_return(self._graph, found)
            scale = largest_states(found.execution.arcs, self._graph)
            jacobian = found.by_state * scale[None, :] / scale[:, None]
        except (SimulationError, np.linalg.LinAlgError):
            return self._repeated(returns, n)
        n = _count(found, section)
        since, away = ((one.state - found.start) / scale for one in (returns[-1 - n], now))
        approached = is_approached(since, away, jacobian, self._accuracy.reached)
        if not (approached and all(abs(value) < 1.0 for value in multipliers)):
            return None
        passed = [one.state for one in reversed(returns)][::n]
        on_the_way = steps_towards(passed, found.start, scale, self._accuracy.reached)
        self._note_way(returns, n * on_the_way)
        return self._orbit(self._standard(found, section), multipliers)

    def _near(
        self, section: str, start: Vector, n: int, guess: float, mode: SectionMode | None
    ) -> EventReturn:
        """Return the orbit of `n` returns near a state in a mode, by Newton's method."""
        return closed_return(
            self._graph,
            start,
            section=section,
            n_returns=n,
            guess=guess,
            settings=SimulationSettings(),
            mode=mode,
            is_near=True,
        )

    def _repeated(self, returns: Sequence[SectionReturn], n: int) -> Attractor | None:
        """Return the orbit of returns that repeat to the accuracy, without its multipliers."""
        if len(returns) <= 2 * n:
            return None
        states = np.array([one.state for one in returns[-1 - 2 * n :]])
        scale = scale_of(list(states), self._units, self._usual)
        if not np.max(np.abs(states[n:] - states[:-n]) / scale) < self._same:
            return None
        drift = _drift([one.state for one in returns[::-n][:_PERIODS]], scale)
        if drift:
            name = self._graph.state_names[drift[0]]
            much = f"by {drift[1]:.1g} of its size per period"
            self._reason = f"`{name}` changes steadily, {much}, so the motion does not repeat"
            return None
        self._note_way(returns, n)
        return Attractor(
            fate=AttractorClass.NO_ZENO,
            period=returns[-1].time - returns[-1 - n].time,
            state=self._named(returns[-1].state),
        )

    def _note_way(self, returns: Sequence[SectionReturn], on_the_way: int) -> None:
        """Record the approach of the motion to its orbit, over its last returns."""
        times = tuple(one.time for one in returns)
        self.way = Approach(times=times, captured=max(len(times) - 1 - on_the_way, 0))

    def _standard(self, found: EventReturn, section: str) -> EventReturn:
        """Return an orbit from its first section, so that one orbit has one start."""
        run = replace(found.execution, events=found.events)
        usual = _sections(event_sections(run, self._graph))[0]
        if usual == section:
            return found
        last = next(one for one in reversed(found.events) if orbit_event_name(one) == usual)
        try:
            mode = SectionMode.after(found.execution, usual, last.time)
            n = _count(found, usual)
            return self._near(usual, state_after(last), n, found.period, mode)
        except SimulationError:
            return found

    def _orbit(self, found: EventReturn, multipliers: tuple[complex, ...]) -> Attractor:
        """Return an orbit by the events of its period."""
        sequence = sequence_of([orbit_event_name(event) for event in found.events])
        kind = kind_of_events([(orbit_event_name(event), event.time) for event in found.events])
        return Attractor(
            fate=AttractorClass(kind),
            returns=_count(found, sequence[-1]),
            period=found.period,
            multipliers=multipliers,
            state=self._named(found.start),
            sequence=sequence,
        )

    def _recognized(self, motion: Execution) -> Attractor | None:
        """Return the known orbit to which the motion converges, and record its approach."""
        watches = [Recognition(orbit=one, reached=self._accuracy.reached) for one in self._known]
        seen: dict[str, list[SectionReturn]] = {one.section: [] for one in self._known}
        for event in motion.events:
            name = orbit_event_name(event)
            if name not in seen:
                continue
            state = np.asarray(state_after(event))
            seen[name].append(SectionReturn(time=event.time, state=state))
            for one in watches:
                if one.orbit.section == name and one.sees(state):
                    self._note_way(seen[name], len(one.passed))
                    return one.orbit.attractor
        return None

    def _is_still(self, motion: Execution) -> bool:
        """Return True if no state but the clock has changed for a turn, or the slowest time."""
        first, x = self._graph.first, motion.end_state
        span = clock_turn(first, x) or own_time(first, self._start)
        begin = motion.end_time - span
        if begin < motion.end_time / 2 or any(event.time > begin for event in motion.events):
            return False
        moving = [k for k in range(len(x)) if k not in first.clock]
        times = np.linspace(begin, motion.end_time, _SAMPLES)
        moved = motion.states_at(times) - x
        largest = np.max(np.abs([arc.start_state - x for arc in motion.arcs]), axis=0)
        zero = _CONTACT * self._usual[moving]
        moves = np.abs(moved[None, :, moving])
        return bool(is_still(moves, largest[None, moving], zero)[0])

    def _without_events(self, motion: Execution) -> Attractor | None:
        """Return the orbit of a motion without events, from its states at turns of the clock."""
        turn = clock_turn(self._graph.first, motion.end_state)
        if turn is None:
            return None
        count = min(int(motion.end_time / 2 / turn), 2 * _TURNS)
        ends: Vector = motion.end_time - turn * np.arange(count, -1.0, -1.0)
        states = list(motion.states_at(ends))
        rows = np.array(states) / scale_of(states, self._units, self._usual)
        for n in range(1, count // 2 + 1):
            if np.max(np.abs(rows[n:] - rows[:-n])) < self._same:
                state = self._named(states[-1])
                return Attractor(fate=AttractorClass.NO_ZENO, period=n * turn, state=state)
        return None

    def _at_last(self, motion: Execution) -> Attractor:
        """Classify a motion that was simulated to its time limit."""
        arc, half = motion.arcs[-1], motion.end_time / 2
        n_q = self._graph.n_q
        # The ends of arcs alone may all lie on the stops, where a gap is rounding.
        reached = [one.flow_states[:, :n_q] for one in motion.arcs if one.end_time <= half]
        if reached:
            before = np.max(np.abs(np.concatenate(reached)), axis=0)
            left = has_left(motion.end_state[:n_q], before)
            if left.any():
                return self._escaped(left)
        if arc.closed and arc.start_time < half:
            return Attractor(fate=AttractorClass.HELD)
        return Attractor(fate=AttractorClass.UNSETTLED, detail=self._reason)

    def _escaped(self, beyond: NDArray[np.bool_]) -> Attractor:
        """Return the escape of the first of some coordinates."""
        escaped = self._graph.state_names[int(np.argmax(beyond))]
        return Attractor(fate=AttractorClass.ESCAPE, escaped=escaped)

    def _named(self, state: Vector) -> dict[str, float]:
        return dict(zip(self._graph.state_names, state.tolist(), strict=True))


def _counted(events: Sequence[Event]) -> list[Event]:
    """Return events without the impacts that accumulate, whose number depends on the accuracy."""
    phases = phases_of_events([orbit_event_name(event) for event in events])
    return [
        events[k]
        for phase in phases
        for k in (phase[-1:] if isinstance(events[phase[-1]], ZenoPoint) else phase)
    ]


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


def _count(found: EventReturn, section: str) -> int:
    """Return the number of returns to a section in a period."""
    return sum(orbit_event_name(event) == section for event in found.events)


def _sections(found: Sequence[str]) -> list[str]:
    """Return sections of one kind in the order of their names.

    So an orbit has one section, whichever of its events the motion met first.
    """
    kinds = groupby(found, key=lambda name: name.partition(" ")[0])
    return [name for _, names in kinds for name in sorted(names)]


def known_event_orbit(
    graph: GraphDynamics, attractor: Attractor, accuracy: Accuracy
) -> KnownOrbit | None:
    """Return an attractor of such a machine as a known orbit, or ``None`` if it is not usable.

    An orbit is usable if its multipliers are known and below one.

    Args:
        graph: The graph of modes.
        attractor: The attractor.
        accuracy: Accuracy of the simulation.
    """
    if not attractor.sequence or not attractor.spectral_radius < 1.0:
        return None
    try:
        found = event_return(
            graph,
            np.array([attractor.state[name] for name in graph.state_names]),
            section=attractor.sequence[-1],
            n_returns=attractor.returns,
            guess=attractor.period,
            settings=transient_settings(accuracy.orbit),
        )
    except SimulationError:
        return None
    section = attractor.sequence[-1]
    states = [state_after(one) for one in found.events if orbit_event_name(one) == section]
    return KnownOrbit(
        attractor=attractor,
        at_releases=False,
        section=section,
        states=tuple(tuple(np.asarray(state).tolist()) for state in states),
        scale=tuple(largest_states(found.execution.arcs, graph).tolist()),
        rate=attractor.spectral_radius,
    )
