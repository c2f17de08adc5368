"""Simulation of a motion until it settles: its events, and the attractor at the end."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, RunawayError, SimulationError
from zeno_orbits.integrators import Tolerance
from zeno_orbits.model import GraphDynamics, GraphMode, HybridDynamics
from zeno_orbits.simulation.attractor import (
    has_left,
    has_overflowed,
    is_still,
    keeps_holding,
)
from zeno_orbits.simulation.events import Impact
from zeno_orbits.simulation.pieces import Piece
from zeno_orbits.simulation.settings import SimulationSettings, SimulationTask
from zeno_orbits.simulation.simulator import pieces
from zeno_orbits.simulation.zeno.completion import ZenoPassage

_PHASES = 64
"""Phases of the clock in which a motion at rest is looked at."""
_LIMIT = 1e-3
"""Largest estimated error of a Zeno point, for a unit of the local error."""
_ABSOLUTE = 0.1
"""Absolute over relative local error."""
_MOST_IMPACTS, _MOST_STEPS = 20_000, 200_000
_RATED = 32
"""Number of states at which rates are evaluated between two tests for rest."""
_SOME = 8
"""Number of these states in a piece without events."""
_PASSED = 64
"""Number of pieces whose states are kept before their largest moduli are taken."""


class Reason(Enum):
    """Why the observation of a motion ended."""

    HORIZON = "the end of the time was reached"
    ESCAPE = "a coordinate left its bounds"
    REST = "it came to rest"
    HELD = "it stays in permanent contact"
    FAILURE = "it cannot be continued"


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionEnd:
    """The end of the observation of a motion.

    Attributes:
        time: Time of the end [s].
        state: Where, ``(n_x,)``.
        reason: Why.
        detail: Name of the coordinate that escaped, or a sentence on the failure.
    """

    time: float
    state: Vector
    reason: Reason
    detail: str = ""


@lru_cache(maxsize=64)
def transient_settings(error: float, far: tuple[float, ...] = ()) -> SimulationSettings:
    """Return the settings of a motion that is followed for a long time.

    Args:
        error: Local error of a step, relative.
        far: Largest modulus of each coordinate, if there is one.
    """
    return SimulationSettings(
        tolerance=Tolerance(relative=error, absolute=_ABSOLUTE * error),
        completion=ZenoPassage(tolerance=_LIMIT * error),
        far=far or math.inf,
        most_impacts=_MOST_IMPACTS,
        most_steps=_MOST_STEPS,
    )


def watched_motion(
    graph: GraphDynamics,
    state: Vector,
    *,
    until: float,
    error: float,
    bounds: Vector | None = None,
    goes_on: bool = False,
) -> Iterator[Piece | MotionEnd]:
    """Yield a motion in pieces, and finally its attractor.

    Args:
        graph: The graph of modes.
        state: Initial state, ``(n_x,)``.
        until: Longest simulated time [s].
        error: Relative local error of a step.
        bounds: Largest modulus of each state of a motion that has not escaped, ``(n_x,)``.
        goes_on: Whether the state continues an earlier motion, or is near a state of it.
    """
    far = np.full(len(state), np.inf) if bounds is None else bounds
    task = SimulationTask(
        dynamics=graph,
        state=state,
        until=until,
        settings=transient_settings(error, tuple(far[: graph.n_q].tolist())),
        goes_on=goes_on,
    )
    watch = _Watch(graph, state, until, far, task.settings.contact)
    recent = [state[None]]
    try:
        for piece in pieces(task):
            recent = [recent[-1], piece.states] if len(piece.states) else recent
            end = watch.end_after(piece)
            if end is None or piece.events:
                yield piece
            if end is not None:
                yield end
                return
    except RunawayError as caught:
        name = caught.coordinate or caught.reason.split()[0]
        if caught.coordinate:
            # The step beyond a bound is also recorded.
            rows = np.concatenate(recent)
            within = rows[np.all(np.abs(rows) <= far, axis=1)]
            last = within[-1] if len(within) else state
            name = _first_beyond(graph, last, np.array(caught.state), far) or name
        yield _end(caught, Reason.ESCAPE, name)
    except SimulationError as caught:
        beyond = has_overflowed(caught.state, graph.n_q, graph.own)
        if beyond.any():
            yield _end(caught, Reason.ESCAPE, graph.state_names[int(np.argmax(beyond))])
        else:
            yield _end(caught, Reason.FAILURE, caught.reason)
    except InputError as caught:
        detail = f"The start is not admissible: {str(caught).partition('must ')[2]}"
        if graph.has_one_guard and graph.first.gap(state) < 0.0:
            detail = "The start is not admissible: the gap is negative"
        yield MotionEnd(time=0.0, state=state, reason=Reason.FAILURE, detail=detail)


def _first_beyond(graph: GraphDynamics, before: Vector, after: Vector, far: Vector) -> str:
    """Return the coordinate that passes its bound first in a step, if it is known.

    In between a coordinate is about linear in time: a step may lead beyond several bounds.

    Args:
        graph: The graph of modes.
        before: State at the start of the step, ``(n_x,)``.
        after: State at its end, ``(n_x,)``.
        far: Bounds, ``(n_x,)``.
    """
    q, to, bounds = (row[: graph.n_q] for row in (before, after, far))
    beyond = np.flatnonzero((np.abs(to) > bounds) & (np.abs(q) <= bounds))
    if not len(beyond):
        return ""
    parts = (np.sign(to) * bounds - q)[beyond] / (to - q)[beyond]
    return graph.state_names[int(beyond[np.argmin(parts)])]


def _end(error: SimulationError, reason: Reason, detail: str) -> MotionEnd:
    return MotionEnd(time=error.time, state=np.array(error.state), reason=reason, detail=detail)


class _Watch:
    """Memory of a motion for the detection of its end."""

    def __init__(
        self,
        graph: GraphDynamics,
        state: Vector,
        until: float,
        bounds: Vector,
        contact: float,
    ) -> None:
        self._graph, self._until, self._contact = graph, until, contact
        self._clock = graph.first.clock
        self._moving = [k for k in range(len(state)) if k not in self._clock]
        # The simulation itself ends at the bound of a coordinate.
        self._bounds = bounds[graph.n_q :]
        self._is_bounded = bool(self._bounds.size) and float(self._bounds.min()) < np.inf
        self._largest = np.zeros(len(self._moving))
        self._unrated: list[tuple[Vector, GraphMode]] = [(state, graph.open_mode)]
        self._passed = [state[None, : graph.n_q]]
        self._changed = 0.0

    def end_after(self, piece: Piece) -> MotionEnd | None:
        """Return the end of the motion if it shows after a piece."""
        n_q, names = self._graph.n_q, self._graph.state_names
        if piece.events:
            self._changed = piece.events[-1].time
        if len(self._unrated) < _RATED:
            free: GraphMode = (), piece.mode[1]
            rated = [(one.state_minus, free) for one in piece.events if isinstance(one, Impact)]
            if not piece.events:
                every = len(piece.states) // _SOME + 1
                rated = [(x, piece.mode) for x in piece.states[::every]]
            self._unrated += rated[: _RATED - len(self._unrated)]
        if self._is_bounded and len(piece.states):
            beyond = np.max(np.abs(piece.states[:, n_q:]), axis=0) > self._bounds
            if beyond.any():
                return self._ended(piece, Reason.ESCAPE, names[n_q + int(np.argmax(beyond))])
        if 2 * piece.time <= self._until:
            self._passed.append(piece.states[:, :n_q])
            if len(self._passed) > _PASSED:
                self._passed = [self._reach()[None]]
        over = piece.time >= self._until
        if not over and piece.events:
            return None
        if self._rests(piece):
            return self._ended(piece, Reason.REST, "")
        if not over:
            return None
        left = has_left(piece.state[:n_q], self._reach())
        if left.any():
            return self._ended(piece, Reason.ESCAPE, names[int(np.argmax(left))])
        held = bool(piece.mode[0]) and self._changed < self._until / 2
        return self._ended(piece, Reason.HELD if held else Reason.HORIZON, "")

    def _reach(self) -> Vector:
        """Return the largest modulus of each coordinate in the first half of the time."""
        return np.max(np.abs(np.concatenate(self._passed)), axis=0)

    def _ended(self, piece: Piece, reason: Reason, detail: str) -> MotionEnd:
        return MotionEnd(time=piece.time, state=piece.state, reason=reason, detail=detail)

    def _rates(self, x: Vector, mode: GraphMode) -> Vector:
        closed, sides = mode
        flow = self._graph.flow((closed, self._graph.sides_at(x, sides)))
        return np.abs(flow.rate(x)[self._moving])

    def _rests(self, piece: Piece) -> bool:
        """Return True if all states except the clock are constant, for every phase of the clock."""
        graph, x, mode = self._graph, piece.state, piece.mode
        rates = [self._rates(*one) for one in self._unrated]
        self._unrated.clear()
        now = self._rates(x, mode)
        self._largest = np.max([self._largest, now, *rates], axis=0)
        own = graph.own.rates(graph.n_q, len(x))
        zero = self._contact * own[self._moving]
        if not is_still(now[None, None], self._largest[None], zero)[0]:
            return False
        whole = clock_turn(graph.first, x)
        if whole is None:
            return True
        # A switch of the clock may act on a motion that stands still before it.
        if graph.switch_names and piece.time - self._changed < whole:
            return False
        turn = np.linspace(0.0, 2 * np.pi, _PHASES + 1)
        states = np.repeat(x[None], len(turn), axis=0)
        states[:, self._clock] = _turned(x[list(self._clock)], turn)
        phases = np.array([self._rates(state, mode) for state in states])
        if not is_still(phases[None], self._largest[None], zero)[0]:
            return False
        return all(self._holds(states, mode, k, whole / _PHASES) for k in mode[0])

    def _holds(self, states: Vector, mode: GraphMode, stop: int, step: float) -> bool:
        """Return True if a closed stop stays closed over a turn of the clock."""
        closed, sides = mode
        guards = np.array(
            [
                self._graph.holding((closed, self._graph.sides_at(x, sides)), stop).locked.guard(x)
                for x in states
            ]
        )
        return bool(keeps_holding(guards[None, :, 0], guards[None, :, 1], step)[0])


def clock_turn(dynamics: HybridDynamics, state: Vector) -> float | None:
    """Return the time of a turn of the clock [s], ``None`` without a clock.

    Args:
        dynamics: The system.
        state: Any state, ``(n_x,)``.
    """
    if not dynamics.clock:
        return None
    places = list(dynamics.clock)
    (c, s), (c_rate, s_rate) = state[places], dynamics.free.rate(state)[places]
    rate = float((c * s_rate - s * c_rate) / (c**2 + s**2))
    return 2 * math.pi / abs(rate) if rate != 0.0 else None


def steady_turn(dynamics: HybridDynamics, state: Vector) -> float | None:
    """Return the time of a turn of the clock [s], ``None`` if its rate changes along a turn.

    Args:
        dynamics: The system.
        state: Any state, ``(n_x,)``.
    """
    turns = list[float]()
    for angle in _ANGLES if dynamics.clock else ():
        at = np.array(state)
        at[list(dynamics.clock)] = math.cos(angle), math.sin(angle)
        turns.append(clock_turn(dynamics, at) or math.inf)
    longest = max(turns, default=math.inf)
    return longest if longest < math.inf and longest <= (1 + _STEADY) * min(turns) else None


_ANGLES = (0.1, 1.3, 2.9, 4.4)
"""Angles of a clock at which its rate is compared [rad]."""
_STEADY = 1e-9
"""Part by which the rate of a clock may change along a turn."""


def _turned(clock: Vector, angle: Vector) -> Vector:
    """Return the states of a clock turned by angles, ``(n_angles, 2)``."""
    c, s = clock
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.stack([c * cosine - s * sine, s * cosine + c * sine], axis=1)
