"""An orbit of events as a recording shows it: sequences of impacts, and signals by phase."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.experiment.orbit_table import measurable
from zeno_orbits.experiment.recordings.recording import Recording
from zeno_orbits.model import Problem, powers_of
from zeno_orbits.orbits import EventOrbit
from zeno_orbits.simulation import simulate, steady_turn

_PHASES = 4096
"""Phases at which the signals of the orbit are evaluated."""
_PAST = 1e-9
"""Part of the period to simulate further, so that rounding cuts off no phase."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OrbitSequence:
    """A sequence of impacts of an orbit. Times count from the start of the period.

    Attributes:
        impacts: Times of the impacts, increasing [s].
        zeno: Zeno point, or ``None``.
        release: Release after the Zeno point, or ``None``.
    """

    impacts: tuple[float, ...]
    zeno: float | None
    release: float | None

    @property
    def flights(self) -> Vector:
        """Durations of the resolved flights between its impacts [s]."""
        return np.diff(self.impacts)

    @property
    def end(self) -> float:
        """Its last time [s]."""
        known = (self.impacts[-1], self.zeno, self.release)
        return max(one for one in known if one is not None)


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacedSequence:
    """A sequence of impacts as indices of events, each with the periods to add to its time.

    Attributes:
        impacts: The impacts, in order.
        zeno: Zeno point, or ``None``.
        release: Release after the Zeno point, or ``None``.
    """

    impacts: tuple[tuple[int, int], ...]
    zeno: tuple[int, int] | None
    release: tuple[int, int] | None


def placed_sequences(
    events: Sequence[tuple[str, float]], period: float, stop: str
) -> tuple[PlacedSequence, ...]:
    """Return the sequences of a stop in a period, in order of their first impacts.

    An impact that follows no impact on the same stop, or no slower motion towards a Zeno point,
    begins a sequence.

    Args:
        events: Name and time of every event of the period, in order.
        period: The period [s].
        stop: Name of the stop.
    """
    own = [
        (place, name.partition(" ")[0], time)
        for place, (name, time) in enumerate(events)
        if name.partition(" ")[2] == stop and not name.startswith("switch ")
    ]
    accumulates = any(kind == "zeno" for _, kind, _ in own)
    n = len(own)
    found: list[PlacedSequence] = []
    for first, (start, kind, begin) in enumerate(own):
        if kind != "impact" or (accumulates and own[first - 1][1] == "impact" and n > 1):
            continue
        impacts, zeno, release = [(start, 0)], None, None
        for k in range(1, n):
            place, what, time = own[(first + k) % n]
            turns = math.ceil((begin - time) / period) if time < begin else 0
            if what == "impact":
                if not accumulates or zeno is not None:
                    break
                impacts.append((place, turns))
            elif what == "zeno":
                zeno = (place, turns)
            else:
                release = (place, turns)
                break
        found.append(PlacedSequence(impacts=tuple(impacts), zeno=zeno, release=release))
    return tuple(found)


def orbit_sequences(orbit: EventOrbit, stop: str) -> tuple[OrbitSequence, ...]:
    """Return the sequences of a stop in a period, in order of their first impacts.

    Args:
        orbit: The orbit.
        stop: Name of the stop.
    """
    events = [(event.name, event.time) for event in orbit.events]

    def time(at: tuple[int, int]) -> float:
        return events[at[0]][1] + at[1] * orbit.period

    return tuple(
        OrbitSequence(
            impacts=tuple(map(time, one.impacts)),
            zeno=None if one.zeno is None else time(one.zeno),
            release=None if one.release is None else time(one.release),
        )
        for one in placed_sequences(events, orbit.period, stop)
    )


def longest_flight(sequences: Sequence[OrbitSequence], period: float) -> float:
    """Return the duration between the bounces of a stop and its other flights, their mean in size.

    Args:
        sequences: The sequences of the stop, at least one.
        period: The period [s].
    """
    begins = sorted(one.impacts[0] for one in sequences)
    free = [
        (min((b - one.end) % period for b in begins) or period)
        for one in sequences
        if one.zeno is None or one.release is not None
    ]
    least = min(free, default=period)
    bounces = [float(flight) for one in sequences for flight in one.flights]
    return math.sqrt(max(bounces) * least) if bounces else least / 2


@dataclass(frozen=True, kw_only=True, eq=False)
class EventTable:
    """The signals of an orbit by phase.

    Attributes:
        orbit: The orbit.
        problem: Its problem.
        names: Names of the signals: states and outputs.
        values: The signals at even phases from the start of the period, ``(n, n_s)``.
        turn: Time of a turn of the clock [s], or ``None`` without a steady clock.
        zero: Time of the clock's zero phase since the start of the period [s], or zero.
    """

    orbit: EventOrbit
    problem: Problem
    names: tuple[str, ...]
    values: Vector
    turn: float | None
    zero: float

    @cached_property
    def is_smooth(self) -> NDArray[np.bool_]:
        """Whether each signal is smooth around each phase, ``(n, n_s)``."""
        steps = np.abs(np.diff(np.concatenate([self.values, self.values[:1]]), axis=0))
        jumps = steps > 0.02 * np.maximum(np.ptp(self.values, axis=0), 1e-300)
        width = len(self.values) // 100
        kernel = np.ones(2 * width + 1)
        near = [
            np.convolve(np.concatenate([one[-width:], one, one[:width]]), kernel, "valid") > 0
            for one in jumps.T.astype(np.float64)
        ]
        found = np.zeros(self.values.shape, dtype=np.bool_)
        for k, one in enumerate(near):
            found[:, k] = ~one
        return found

    def since_zero(self, time: float) -> float:
        """Return a time since the last zero phase of the clock, or since the start."""
        turn = self.turn or self.orbit.period
        return (time - self.zero) % turn


def shared_event_signals(problem: Problem, recording: Recording) -> tuple[str, ...]:
    """Return the names of the recorded states and outputs of a machine with several stops.

    Raises:
        InputError: If a signal has a unit of another kind, or no values.
    """
    known = measurable(problem)
    names = tuple(name for name in recording.names if name in known)
    for name in names:
        signal = recording.signal(name)
        if powers_of(signal.unit) != powers_of(known[name]):
            wanted = f"must have `{name}` in a unit like {known[name]}"
            raise InputError(f"Argument `recording` {wanted}, but it has {signal.unit}.")
        if not np.any(np.isfinite(signal.values)):
            raise InputError(f"Argument `recording` lacks values of `{name}`.")
    return names


def event_table(orbit: EventOrbit, problem: Problem, names: Sequence[str]) -> EventTable:
    """Return the signals of an orbit by phase.

    Args:
        orbit: The orbit.
        problem: Its problem.
        names: Names of states and outputs.

    Raises:
        SimulationError: If the orbit cannot be simulated.
    """
    values = orbit.values(problem)
    graph = problem.graph_dynamics(values)
    start = np.array(problem.state_vector(orbit.start_state))
    run = simulate(graph, start, until=orbit.period * (1 + _PAST))
    times = np.arange(_PHASES) / _PHASES * orbit.period
    states = run.states_at(times)
    outputs = [output.name for output in problem.outputs]
    table = problem.output_values(values, states) if outputs else np.zeros((_PHASES, 0))
    columns = [
        states[:, problem.state_names.index(name)]
        if name in problem.state_names
        else table[:, outputs.index(name)]
        for name in names
    ]
    turn = steady_turn(graph.first, start)
    zero = 0.0
    if turn is not None:
        cosine, sine = start[list(graph.first.clock)]
        zero = -turn * (math.atan2(sine, cosine) / (2 * math.pi))
    return EventTable(
        orbit=orbit,
        problem=problem,
        names=tuple(names),
        values=np.array(columns).T if columns else np.zeros((_PHASES, 0)),
        turn=turn,
        zero=zero,
    )
