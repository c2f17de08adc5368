"""Attractor of a motion after a long simulation: periods, growth, chaos."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.model import GraphDynamics, HybridDynamics, own_time
from zeno_orbits.simulation.attractor import AttractorKind, scale_of
from zeno_orbits.simulation.events import Event, Impact, SwitchEvent
from zeno_orbits.simulation.lyapunov import Exponent, largest_exponent
from zeno_orbits.simulation.settings import SimulationTask
from zeno_orbits.simulation.simulator import pieces
from zeno_orbits.simulation.watch import (
    MotionEnd,
    Reason,
    clock_turn,
    transient_settings,
    watched_motion,
)

_KEPT = 512
"""Number of stored impacts and switches. A period of up to half of them is found."""
_FEW = 24
"""Impacts below which nothing is concluded from them."""
_QUARTERS, _GROWS = 4, 1.02
"""Parts of the time, and the factor by which a growing motion is faster in each."""
_STRIDES, _STEADY = 4, 0.1
"""Impacts of a period in the search for a drift, and the relative spread of a steady change."""
_TURNS = 32
"""Longest period in the search for motions without impacts, in turns of the clock."""
_REPEATED = 3.0
"""Turns in which a motion that has converged shows its period twice."""
_NEARLY = 1e3
"""Factor of the change that counts as zero, up to which a motion settles to a shorter period."""
_REGULAR = 1e-3
"""Exponent over a turn below which a motion that does not repeat is regular."""
_NONE = 1e-6
"""Exponent over a turn that differs from zero by rounding."""
_BOUNDED = 0.05
"""Largest error of that, over a turn: distances of regular motions go up and down by turns."""
_ERROR = 1e-10
"""Local error of the runs that an exponent is taken from."""
_ALIKE = 1e-2
"""Relative change of the fastest impact over a period that repeats."""
_ROUNDED, _COUNTED = 1e-15, 1e-13
"""Change of the speed per impact that differs from zero by rounding, and that has no digit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RepeatedCycle:
    """A period of a motion whose impacts and switches repeat.

    Attributes:
        period: [s].
        events: Its events, the last impact or switch at the end.
    """

    period: float
    events: tuple[Event, ...]


@dataclass(slots=True, kw_only=True)
class MotionLog:
    """The events of a motion so far that determine its attractor.

    Attributes:
        units: Unit of each state.
        usual: Size that each state usually has, ``(n_x,)``.
        elastic: Whether impacts lose nothing, so that a change per impact below the local error
            may be an error.
        events: The last events and their times.
        speeds: Speed of every impact.
        times: Times of all impacts [s].
        count: Number of impacts and switches so far.
        last: Time of the last of them [s].
    """

    units: Sequence[str]
    usual: Vector | float = 1.0
    elastic: bool = False
    events: deque[tuple[float, Event]] = field(
        default_factory=lambda: deque[tuple[float, Event]](maxlen=2 * _KEPT)
    )
    speeds: list[float] = field(default_factory=list[float])
    times: list[float] = field(default_factory=list[float])
    count: int = 0
    last: float = 0.0

    def add(self, event: Event, since: float = 0.0) -> None:
        """Note an event.

        Args:
            event: The event.
            since: When its execution started [s].
        """
        time = since + event.time
        self.events.append((time, event))
        if isinstance(event, Impact | SwitchEvent):
            self.count, self.last = self.count + 1, time
        if isinstance(event, Impact):
            self.speeds.append(-event.approach_rate)
            self.times.append(time)

    def _marks(self) -> list[int]:
        """Return the places of the impacts and switches among the last events."""
        every = [
            k for k, (_, one) in enumerate(self.events) if isinstance(one, Impact | SwitchEvent)
        ]
        return every[-_KEPT:]

    def scale(self) -> Vector:
        """Return the size of each state at the last impacts and switches, ``(n_x,)``."""
        states = [self.events[k][1].after for k in self._marks()[-_FEW:]]
        return scale_of(states, self.units, self.usual)

    def cycle(self, close: float) -> RepeatedCycle | None:
        """Return the shortest period after which impacts and switches repeat, if they have twice.

        Args:
            close: Change of a state that counts as none, relative.
        """
        marks = self._marks()
        n_seen = len(marks)
        if n_seen < 3:
            return None
        rows = np.array([self.events[k][1].after for k in marks]) / self.scale()
        speeds = np.array([_speed(self.events[k][1]) for k in marks])
        away = np.max(np.abs(rows[-1] - rows[:-1]), axis=1)[::-1]
        for place in np.flatnonzero(away[: (n_seen - 1) // 2] < close).tolist():
            n = place + 1
            # Impacts that accumulate differ by less and less, but not in proportion.
            fastest, before = np.max(speeds[-n:]), np.max(speeds[-2 * n : -n])
            if abs(fastest - before) > _ALIKE * before:
                continue
            if np.max(np.abs(rows[-n:] - rows[-2 * n : -n])) < close:
                first, last = marks[-1 - n], marks[-1]
                within = [one for _, one in list(self.events)[first + 1 : last + 1]]
                period = self.events[last][0] - self.events[first][0]
                return RepeatedCycle(period=period, events=tuple(within))
        return None

    def drift(self) -> float:
        """Return the steady change of the speed of impacts, relative and per impact, else zero.

        An orbit is approached by smaller and smaller changes. Elastic impacts do not slow down.
        """
        speeds = np.array(self.speeds[-_KEPT:])
        if len(speeds) < _FEW or not np.all(speeds > 0.0):
            return 0.0
        logarithms = np.log(speeds)
        least = _ERROR if self.elastic else _ROUNDED
        for n in range(1, _STRIDES + 1):
            change = (logarithms[n:] - logarithms[:-n]) / n
            mean = float(np.mean(change))
            if abs(mean) > least and np.ptp(change) < _STEADY * abs(mean):
                return mean
        return 0.0

    def grows(self, time: float) -> bool:
        """Return True if the impacts become faster from each quarter of the time to the next."""
        if len(self.speeds) < _FEW:
            return False
        part = np.minimum(np.array(self.times) * (_QUARTERS / time), _QUARTERS - 1).astype(int)
        speeds = np.array(self.speeds)
        largest = [np.max(speeds[part == k], initial=0.0) for k in range(_QUARTERS)]
        middle = [float(np.median(speeds[part == k])) for k in range(_QUARTERS) if k in part]
        if len(middle) < _QUARTERS:
            return False
        pairs = [*pairwise(largest), *pairwise(middle)]
        return all(later > _GROWS * before for before, later in pairs)


def _speed(event: Event) -> float:
    return -event.approach_rate if isinstance(event, Impact) else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class AttractorVerdict:
    """Classification of a motion at the end of its time limit.

    Attributes:
        kind: Kind of the attractor.
        cycle: Period of its impacts, if they repeat.
        turns: Number of clock periods in a period, or 0 without a period.
        exponent: Largest Lyapunov exponent, if it was computed.
        reason: Reason why the result is undecided, as a clause.
    """

    kind: AttractorKind
    cycle: RepeatedCycle | None = None
    turns: int = 0
    exponent: Exponent | None = None
    reason: str = ""


def verdict(
    graph: GraphDynamics,
    log: MotionLog,
    state: Vector,
    time: float,
    *,
    close: float,
    goes_on: bool,
) -> AttractorVerdict:
    """Classify a motion that neither rests nor diverges.

    Args:
        graph: The graph of modes.
        log: Events of the motion.
        state: Final state, ``(n_x,)``.
        time: Duration of the simulation [s].
        close: Relative change over a period that counts as zero.
        goes_on: Whether the motion is simulated on, for its Lyapunov exponent.
    """
    cycle, drift = log.cycle(close), log.drift()
    if cycle is not None and not drift:
        turns = turns_in(graph.first, state, cycle.period)
        return AttractorVerdict(kind=AttractorKind.REPEATS, cycle=cycle, turns=turns)
    if log.grows(time):
        return AttractorVerdict(kind=AttractorKind.GROWS)
    if drift:
        word = "slower" if drift < 0.0 else "faster"
        much = f"{abs(drift):.1g}" if abs(drift) > _COUNTED else f"less than {_COUNTED:g}"
        reason = f"its impacts become steadily {word}, by {much} of their speed each"
        return AttractorVerdict(kind=AttractorKind.UNDECIDED, reason=reason)
    if not goes_on:
        return AttractorVerdict(kind=AttractorKind.UNDECIDED, reason="it does not repeat")
    settings = transient_settings(_ERROR)
    try:
        if not log.last > time / 2:
            return without_events(graph, log, state, close)
        turn = clock_turn(graph.first, state) or own_time(graph.first, state)
        found = largest_exponent(graph, state, turn=turn, scale=log.scale(), settings=settings)
        later = _later(graph, log, state, found, turn, time, close)
        if later is not None:
            return later
    except SimulationError as error:
        clause = error.reason[0].lower() + error.reason[1:]
        return AttractorVerdict(
            kind=AttractorKind.UNDECIDED, reason=f"it cannot be continued: {clause}"
        )
    return _by_exponent(found, turn)


def _later(
    graph: GraphDynamics,
    log: MotionLog,
    state: Vector,
    exponent: Exponent,
    turn: float,
    time: float,
    close: float,
) -> AttractorVerdict | None:
    """Classify a motion that comes nearer to an orbit after the time that its exponent asks for.

    The time is at most as long again as the simulation, or a few turns. ``None`` if that is not
    enough, or if the motion ends before.
    """
    if exponent.value + exponent.error >= 0.0:
        return None
    needed = math.log(close) / exponent.value
    if needed > time:
        return None
    needed = max(needed, _REPEATED * turn)
    after = MotionLog(units=log.units, usual=log.usual, elastic=log.elastic)
    for piece in watched_motion(graph, state, until=needed, error=_ERROR, goes_on=True):
        if isinstance(piece, MotionEnd):
            if piece.reason is not Reason.HORIZON:
                return None
            break
        state = piece.state
        for event in piece.events:
            after.add(event)
    cycle = after.cycle(close)
    if cycle is not None:
        turns = turns_in(graph.first, state, cycle.period)
        return AttractorVerdict(kind=AttractorKind.REPEATS, cycle=cycle, turns=turns)
    if after.last > needed / 2:
        return None
    found = without_events(graph, log, state, close)
    return found if found.kind is AttractorKind.REPEATS else None


def without_events(
    graph: GraphDynamics, log: MotionLog, state: Vector, close: float
) -> AttractorVerdict:
    """Classify a motion without events, from its states at periods of the clock.

    Args:
        graph: The graph of modes.
        log: Events of the motion.
        state: A late state, ``(n_x,)``.
        close: Relative change over a period that counts as zero.

    Raises:
        SimulationError: If the motion cannot be continued.
    """
    lasting = "it strikes the stop no more" if log.count else "it strikes no stop, passes no switch"
    undecided = AttractorVerdict(kind=AttractorKind.UNDECIDED, reason=lasting)
    turn = clock_turn(graph.first, state)
    if turn is None:
        return undecided
    states = _states_at_turns(graph, state, turn)
    if states is None:
        reason = "it meets its next event after the time limit"
        return AttractorVerdict(kind=AttractorKind.UNDECIDED, reason=reason)
    scale = scale_of(states, log.units, log.usual)
    rows = np.array(states) / scale
    changes = [float(np.max(np.abs(rows[n:] - rows[:-n]))) for n in range(1, _TURNS + 1)]
    if min(changes) < close:
        # A motion that alternates while it settles is nearer to its start after two turns.
        turns = 1 + next(k for k, change in enumerate(changes) if change < _NEARLY * close)
        return AttractorVerdict(kind=AttractorKind.REPEATS, turns=turns)
    return undecided


def _states_at_turns(graph: GraphDynamics, state: Vector, turn: float) -> list[Vector] | None:
    """Return the states of a motion at periods of its clock, ``None`` if it meets an event."""
    states, settings = [state], transient_settings(_ERROR)
    for _ in range(2 * _TURNS):
        task = SimulationTask(
            dynamics=graph, state=state, until=turn, settings=settings, goes_on=True
        )
        for piece in pieces(task):
            if any(isinstance(event, Impact | SwitchEvent) for event in piece.events):
                return None
            state = piece.state
        states.append(state)
    return states


def _by_exponent(found: Exponent, turn: float) -> AttractorVerdict:
    """Classify a motion that does not repeat by its Lyapunov exponent."""
    low, high = found.value - found.error, found.value + found.error
    shown = f"{found.value:.2g} +- {found.error:.1g} 1/s"
    if low * turn > _REGULAR:
        return AttractorVerdict(kind=AttractorKind.CHAOTIC, exponent=found)
    decays = high * turn < -_NONE
    if abs(found.value) * turn < _REGULAR and found.error * turn < _BOUNDED and not decays:
        return AttractorVerdict(kind=AttractorKind.QUASI_PERIODIC, exponent=found)
    reason = f"its largest Lyapunov exponent is too uncertain for a sign: {shown}"
    if high < 0.0:
        reason = f"it still comes nearer to an orbit: its largest Lyapunov exponent is {shown}"
    return AttractorVerdict(kind=AttractorKind.UNDECIDED, exponent=found, reason=reason)


_WHOLE = 1e-3
"""Part of a turn by which a period may miss whole turns."""


def turns_in(dynamics: HybridDynamics, state: Vector, period: float) -> int:
    """Return the number of clock periods in a period, or 0 without a clock or a whole number.

    Args:
        dynamics: The system.
        state: A state of the motion, ``(n_x,)``.
        period: Period [s].
    """
    turn = clock_turn(dynamics, state)
    if turn is None or not math.isfinite(period):
        return 0
    turns = round(period / turn)
    return turns if abs(period / turn - turns) < _WHOLE else 0
