"""A completed execution: its arcs, its events and the state at any time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from zeno_orbits.arrays import Vector, finite_vector
from zeno_orbits.errors import (
    InputError,
    any_number,
    finite_number,
    positive_number,
    require_counts,
)
from zeno_orbits.integrators import Trajectory, fast_dataclass
from zeno_orbits.model import UNIT_SCALES, CharacteristicScales, GraphDynamics, GraphMode
from zeno_orbits.simulation.events import (
    Event,
    EventKind,
    Impact,
    Release,
    SwitchEvent,
    ZenoPoint,
    event_name,
    state_after,
)
from zeno_orbits.work import ByValue, Columns, TableRepr, checked


class Mode(Enum):
    """Off the stop, or on it."""

    FREE = "free"
    LOCKED = "locked"


class Ending(Enum):
    """Ends of an arc. The value is the word shown to the user."""

    IMPACT = EventKind.IMPACT.label
    ZENO = EventKind.ZENO.label
    RELEASE = EventKind.RELEASE.label
    SWITCH = EventKind.SWITCH.label
    HORIZON = "end of the simulation"


def closed_names(names: Sequence[str], stops: Iterable[int]) -> tuple[str, ...]:
    """Return the names of stops. A stop without a name is the only stop.

    Args:
        names: Name of each stop.
        stops: Indices of the stops.
    """
    return tuple(names[k] for k in stops if names[k])


_AT_ONCE = 1e-6
"""A release earlier than this part of a period belongs to the start of the execution."""


@fast_dataclass
class Arc(ByValue):
    """A stretch in one mode.

    Attributes:
        mode: Free or locked.
        start_time: When it starts [s].
        end_time: When it ends [s].
        start_state: State at its start, ``(n_x,)``.
        end_state: State at its end, before any reset.
        ending: Event that ended the arc.
        impact_index: Number of previous resolved impacts, the `j` of hybrid time ``(t, j)``.
        time_unit: Length of one unit of the flow's own time [s]: the impact speed in a rescaled
            flight (theory (2.6)), else 1.
        closed: Names of the closed stops, empty for a machine with one stop.
        stop: Name of the stop whose gap the flow of a rescaled flight carries, empty for others.
        sides: Side of every kink of the formulas, in a machine with switches.
        trajectory: The flow along the arc. For the tail of an impact sequence it is the curve of
            the impacts if that curve was followed, else ``None``. Then the state is interpolated.
    """

    mode: Mode
    start_time: float
    end_time: float
    start_state: Vector
    end_state: Vector
    ending: Ending
    impact_index: int
    time_unit: float
    trajectory: Trajectory | None = field(repr=False, compare=False)
    closed: tuple[str, ...] = ()
    stop: str = ""
    sides: tuple[bool, ...] = ()

    def mode_in(self, graph: GraphDynamics) -> GraphMode:
        """Return the mode of the arc in the graph of its machine.

        Args:
            graph: The graph of modes.
        """
        closed, sides = graph.mode_of(self.closed, self.sides)
        # A stop without a name is the only one.
        return (closed or ((0,) if self.mode is Mode.LOCKED else ())), sides

    @property
    def stop_left(self) -> str:
        """Name of the stop on which a rescaled flight begins, empty for any other arc."""
        return self.stop if self.stop and float(self.flow_states[0, -2]) == 0.0 else ""

    def state_at(self, time: float) -> Vector:
        """Return the state at a time inside the arc, to the accuracy of the integration.

        Raises:
            InputError: If the time is not a number.
        """
        return self.states_at(np.array([any_number("time", time)]))[0]

    def states_at(self, times: Vector) -> Vector:
        """Return the states at times inside the arc, ``(n, n_x)``.

        Args:
            times: ``(n,)`` [s].
        """
        if self.trajectory is None:
            length = self.end_time - self.start_time
            part = (times - self.start_time) / length if length else np.zeros(len(times))
            states = self.start_state + part[:, None] * (self.end_state - self.start_state)
        else:
            offsets = (times - self.start_time) / self.time_unit
            inside = np.minimum(np.maximum(offsets, 0.0), self.trajectory.duration)
            states = self.trajectory.states_at(inside)[:, : len(self.start_state)]
        states[times <= self.start_time] = self.start_state
        states[times >= self.end_time] = self.end_state
        return states

    def sampled(self, n: int = 150) -> tuple[Vector, Vector]:
        """Return times ``(m,)`` and states ``(m, n_x)`` along the arc, for plots.

        They stand close where the arc starts and ends, and none of the integrator's steps is left
        out, so that neither a thin layer nor an oscillation is missed.

        Args:
            n: Samples at least.
        """
        steps = self.time_unit * self.flow_times[:-1]
        dense_ends = (1 - np.cos(np.linspace(0, np.pi, n))) / 2
        offsets = np.union1d(dense_ends * (self.end_time - self.start_time), steps)
        times = self.start_time + offsets
        times = np.append(times[times < self.end_time], self.end_time)
        return times, self.states_at(times)

    @property
    def duration(self) -> float:
        """Length in the flow's own time, which in a rescaled flight is time over impact speed."""
        if self.trajectory is not None:
            # The flow's own time is not rounded, even in a late and short flight.
            return self.trajectory.duration
        return (self.end_time - self.start_time) / self.time_unit

    def flow_state_at(self, offset: float) -> Vector:
        """Return the state of the flow itself, scaled gap and gap rate included in a flight.

        Args:
            offset: The flow's own time since the start of the arc.

        Raises:
            ValueError: If the arc is the tail of an impact sequence: no flow was followed.
        """
        return self._flow().state_at(offset)

    def flow_states_at(self, offsets: Vector) -> Vector:
        """Return the states of the flow itself, ``(n, n_y)``.

        Args:
            offsets: The flow's own times since the start of the arc, ``(n,)``.

        Raises:
            ValueError: If the arc is the tail of an impact sequence: no flow was followed.
        """
        return self._flow().states_at(offsets)

    def _flow(self) -> Trajectory:
        if self.trajectory is None:
            raise ValueError("Argument `self` must be an arc with a flow, but it is a tail.")
        return self.trajectory

    @property
    def flow_times(self) -> Vector:
        """Times of the engine's steps, in the flow's own time, both ends included, ``(m,)``."""
        return np.array([0.0, self.duration]) if self.trajectory is None else self.trajectory.times

    @property
    def flow_states(self) -> Vector:
        """States of the flow itself there, ``(m, n_y)``."""
        if self.trajectory is None:
            return np.array([self.start_state, self.end_state])
        return self.trajectory.states


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Execution(TableRepr):
    """A completed execution on the hybrid time domain ``(t, j)``.

    Attributes:
        state_names: Name of each state.
        arcs: Arcs in order of time, without a break.
        events: Impacts, Zeno points, releases and switches in order of time.
        own: Sizes of the problem's numbers.
    """

    state_names: tuple[str, ...]
    arcs: tuple[Arc, ...]
    events: tuple[Event, ...]
    own: CharacteristicScales = UNIT_SCALES

    def __repr__(self) -> str:
        """Return one line: the span of time and how much happens in it."""
        if not self.arcs:
            return "<Execution without arcs>"
        return (
            f"<Execution of {', '.join(self.state_names)} from {self.arcs[0].start_time:g} to "
            f"{self.end_time:.9g} s: arcs={len(self.arcs)}, impacts={len(self.impacts)}, "
            f"zeno_points={len(self.zeno_points)}, releases={len(self.releases)}>"
        )

    def _columns(self) -> Columns:
        """Return the sampled states, with the mode and number of the arc they are of."""
        pairs = [(arc, *arc.sampled()) for arc in self.arcs]
        states = np.concatenate([states for _, _, states in pairs])
        return {
            "time": np.concatenate([times for _, times, _ in pairs]),
            "arc": np.repeat(np.arange(len(pairs)), [len(times) for _, times, _ in pairs]),
            "mode": [arc.mode.value for arc, times, _ in pairs for _ in times],
            **{name: states[:, k] for k, name in enumerate(self.state_names)},
        }

    def _shown_columns(self) -> Columns:
        """Return the events."""
        after = [state_after(event) for event in self.events]
        return {
            "time": [event.time for event in self.events],
            "event": [event_name(event) for event in self.events],
            **{name: [float(x[k]) for x in after] for k, name in enumerate(self.state_names)},
        }

    @property
    def end_time(self) -> float:
        """Time of its end [s]."""
        return self.arcs[-1].end_time

    @property
    def end_state(self) -> Vector:
        """State at its end, ``(n_x,)``."""
        return self.arcs[-1].end_state

    @property
    def impacts(self) -> tuple[Impact, ...]:
        """The resolved impacts."""
        return tuple(event for event in self.events if isinstance(event, Impact))

    @property
    def zeno_points(self) -> tuple[ZenoPoint, ...]:
        """The Zeno points."""
        return tuple(event for event in self.events if isinstance(event, ZenoPoint))

    @property
    def switches(self) -> tuple[SwitchEvent, ...]:
        """The switches."""
        return tuple(event for event in self.events if isinstance(event, SwitchEvent))

    @property
    def releases(self) -> tuple[Release, ...]:
        """The releases."""
        return tuple(event for event in self.events if isinstance(event, Release))

    def returns(self, period: float) -> tuple[Release, ...]:
        """Return the later releases of an execution that starts at a release.

        An immediate release does not count as a return if the initial state is locked only by a
        rounding error.

        Args:
            period: Approximate time of a return [s].
        """
        least = _AT_ONCE * positive_number("period", period)
        return tuple(release for release in self.releases if release.time > least)

    def state_at(self, time: float) -> Vector:
        """Return the state at a time, which at an impact is the state after it.

        Raises:
            InputError: If the time is not a number, or outside the execution.
        """
        return self._states_at("time", np.array([finite_number("time", time)]))[0]

    def states_at(self, times: Sequence[float] | Vector) -> Vector:
        """Return the states at times, which at an impact is the state after it, ``(n, n_x)``.

        Args:
            times: ``(n,)`` [s].

        Raises:
            InputError: If a time is not a number, or outside the execution.
        """
        return self._states_at("times", finite_vector("times", times))

    def _states_at(self, argument: str, times: Vector) -> Vector:
        first, last = self.arcs[0].start_time, self.end_time
        outside = times[~((first <= times) & (times <= last))]
        if outside.size:
            message = f"Argument `{argument}` must lie in [{first:g}, {last:g}], but it is"
            raise InputError(f"{message} {outside[0]:g}.")
        starts = np.array([arc.start_time for arc in self.arcs])
        at = np.maximum(np.searchsorted(starts, times, side="right") - 1, 0)
        states = np.empty((len(times), len(self.arcs[0].start_state)))
        for place in set[int](at.tolist()):
            own = at == place
            states[own] = self.arcs[place].states_at(times[own])
        return states

    @checked
    def sampled(self, n_per_arc: int = 150) -> tuple[Vector, Vector]:
        """Return times ``(n,)`` and states ``(n, n_x)`` of all arcs, for plots.

        Args:
            n_per_arc: Samples at least, of every arc.

        Raises:
            InputError: If samples are missing.
        """
        require_counts(n_per_arc=n_per_arc)
        times, states = zip(*(arc.sampled(n_per_arc) for arc in self.arcs), strict=True)
        return np.concatenate(times), np.concatenate(states)
