"""One period of a motion: the part of an execution between two crossings of its section."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.orbits.phases import Moment, Phase, follow_each_other, kinds_of, phases_of
from zeno_orbits.orbits.shape import EventSequence
from zeno_orbits.simulation import Arc, Execution, Impact, Mode, ZenoPoint

_VANISHING = 1e-9
"""Size of a state relative to the largest, in characteristic scales, below which it is rounding."""


@dataclass(frozen=True, kw_only=True)
class Cycle:
    """One period of a motion: usually release, flight, impacts, Zeno point, contact, release.

    All periods have this type, measured from their own section. The only exception is `maps`, where
    the periods of many simultaneous simulations are arrays.

    Attributes:
        execution: Execution from start to end of the period, with the tails of accumulations.
        phases: Its phases in order, at least one.
    """

    execution: Execution
    phases: tuple[Phase, ...]

    @property
    def state_names(self) -> tuple[str, ...]:
        """Name of each state."""
        return self.execution.state_names

    @property
    def shape(self) -> EventSequence:
        """Kinds of its phases."""
        return EventSequence(phases=kinds_of(self.phases))

    @property
    def start(self) -> Moment:
        """Start: a release, or the state just after an impact."""
        return self.phases[0].start

    @property
    def end(self) -> Moment:
        """End: a release, or the state just after an impact."""
        return self.phases[-1].end

    @property
    def period(self) -> float:
        """Time from start to end [s]."""
        return self.end.time - self.start.time

    @property
    def arcs(self) -> tuple[Arc, ...]:
        """All arcs of the phases that have a flow. The tails of accumulations are not included."""
        return tuple(arc for phase in self.phases for arc in phase.arcs)

    @property
    def impacts(self) -> tuple[Impact, ...]:
        """All resolved impacts."""
        return tuple(impact for phase in self.phases for impact in phase.impacts)

    @property
    def zeno_points(self) -> tuple[ZenoPoint, ...]:
        """All Zeno points."""
        return tuple(phase.zeno for phase in self.phases if phase.zeno is not None)

    @property
    def flight(self) -> Arc:
        """The first flight."""
        return self.phases[0].flight

    @property
    def rescaled_flights(self) -> tuple[Arc, ...]:
        """The flights between impacts that accumulate."""
        return tuple(arc for phase in self.phases for arc in phase.rescaled_flights)

    @property
    def zeno(self) -> ZenoPoint:
        """The Zeno point of a period with one Zeno point.

        Raises:
            InputError: If the number of Zeno points differs from one.
        """
        return self._held()[0]

    @property
    def locked(self) -> Arc:
        """The contact phase of a period with one contact phase.

        Raises:
            InputError: If the number of contact phases differs from one.
        """
        return self._held()[1]

    def _held(self) -> tuple[ZenoPoint, Arc]:
        self.shape.require_one_release()
        phase = self.phases[-1]
        if phase.zeno is None or phase.locked is None:
            raise ValueError(
                "Argument `phases` must have a Zeno point with a contact phase after it."
            )
        return phase.zeno, phase.locked

    def drift(self, scale: Vector) -> float:
        """Return the change of the start over the cycle, in units of ``scale``."""
        return float(np.max(np.abs(self.end.state - self.start.state) / scale))

    def scale(self) -> Vector:
        """Return the size of each state over the cycle, ``(n_x,)``. Every entry is nonzero."""
        return self._sizes.copy()

    def scale_at_events(self) -> Vector:
        """Return the size of each state at the events of the cycle, ``(n_x,)``, away from zero.

        With some integrators, sizes between events require an integration. A state that vanishes at
        every event, such as the gap, does not drift at events. It gets the largest size.
        """
        return self._sizes_at_events.copy()

    @cached_property
    def _sizes_at_events(self) -> Vector:
        sizes = np.max(np.abs(self._event_states()), axis=0)
        return self.execution.own.not_small(sizes, _VANISHING)

    def _event_states(self) -> Vector:
        ends = [self.start.state, *(phase.end.state for phase in self.phases)]
        ends += [point.state for point in self.zeno_points]
        return np.array([*ends, *(x for i in self.impacts for x in (i.state_minus, i.state_plus))])

    @cached_property
    def _sizes(self) -> Vector:
        # Between accumulating impacts only the gap has its largest value inside, and it is tiny.
        n_x = len(self.state_names)
        inside = [
            arc.flow_states[:, :n_x]
            for phase in self.phases
            for arc in (phase.flight, *(() if phase.locked is None else (phase.locked,)))
        ]
        sizes = np.max(np.abs(np.concatenate([self._event_states(), *inside])), axis=0)
        return np.where(sizes > 0.0, sizes, 1.0)


def cycle_between(
    execution: Execution, phases: Sequence[Phase], *, since: float | None = None
) -> Cycle:
    """Return the cycle that consists of some phases of an execution.

    Args:
        execution: The execution.
        phases: Consecutive phases of the execution.
        since: Start of the cycle's execution [s]. By default it is the start of the first phase.
    """
    start = phases[0].start.time if since is None else since
    end = phases[-1].end.time
    first = bisect_left(execution.arcs, start, key=lambda arc: arc.start_time)
    last = bisect_left(execution.arcs, end, key=lambda arc: arc.start_time)
    before = bisect_right(execution.events, start, key=lambda event: event.time)
    after = bisect_right(execution.events, end, key=lambda event: event.time)
    cut = Execution(
        state_names=execution.state_names,
        arcs=execution.arcs[first:last],
        events=execution.events[before:after],
        own=execution.own,
    )
    return Cycle(execution=cut, phases=tuple(phases))


def cycles(execution: Execution, *, start: Vector | None = None) -> list[Cycle]:
    """Return the returns of an execution, each from a release to the next.

    Args:
        execution: The execution.
        start: Its initial state, if it starts at a release.
    """
    found: list[Cycle] = []
    passed: list[Phase] = []
    for phase in phases_of(execution, start):
        passed.append(phase)
        if phase.kind.holds:
            found.append(cycle_between(execution, passed))
            passed = []
    return found


def first_cycles(execution: Execution, start: Vector, shape: EventSequence) -> tuple[Cycle, ...]:
    """Return the consecutive periods of a shape at the beginning of an execution.

    If the motion starts in contact, it is first released. The first period includes that contact
    phase.

    Args:
        execution: The execution.
        start: Its initial state, at the start of a period of the shape, ``(n_x,)``.
        shape: The shape, at the coefficient of restitution of the system.
    """
    phases = phases_of(execution, start, held=shape.starts_at_release)
    n, found = shape.n_phases, list[Cycle]()
    flight = next((arc for arc in execution.arcs if arc.mode is Mode.FREE), None)
    if not phases or phases[0].flight is not flight:
        return ()
    for k in range(0, len(phases), n):
        period = phases[k : k + n]
        if kinds_of(period) != shape.phases or not follow_each_other(phases[: k + n]):
            break
        found.append(cycle_between(execution, period, since=None if found else 0.0))
    return tuple(found)
