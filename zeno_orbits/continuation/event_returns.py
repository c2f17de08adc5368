"""Return map of a machine with several stops or switches, from an event of a kind to itself.

A family keeps its event sequence. It ends where an event is lost: the rate at an event vanishes,
or the time between two events.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.return_maps import (
    DifferentiatedReturn,
    LazyMargins,
    Loss,
    Margin,
)
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model import CompiledGraph, GraphDynamics
from zeno_orbits.orbits import (
    EventReturn,
    Line,
    Section,
    SectionMode,
    event_return,
    kept_directions,
    loosened,
    on_section,
    orbit_event_name,
    sequence_of,
    state_before,
)
from zeno_orbits.simulation import (
    Arc,
    Ending,
    Event,
    Impact,
    Release,
    SimulationSettings,
    SwitchEvent,
    least_inside,
)

_LOOSER = 30.0
"""Factor on the tolerances for the second computation of a point."""
_PATIENCE = 4.0
"""Longest time to wait for a return, in periods."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EventSection:
    """A section of a machine with several stops or switches.

    Attributes:
        name: Name of the event.
        n_returns: Number of such events in a period.
        sequence: Event sequence of a period.
        mode: The mode just after the event.
    """

    name: str
    n_returns: int
    sequence: tuple[str, ...]
    mode: SectionMode


@dataclass(frozen=True, kw_only=True)
class EventReturns:
    """Return map from an event to the end of its event sequence, along a line of parameters.

    Attributes:
        compiled: Functions of the problem.
        line: The line of parameters.
        settings: Accuracy.
        section: The section.
    """

    compiled: CompiledGraph
    line: Line
    settings: SimulationSettings
    section: EventSection

    def dynamics(self, s: float) -> GraphDynamics:
        """Return the graph of modes at a position on the line.

        Raises:
            SimulationError: If the values are invalid there, such as a negative restitution.
        """
        graph = GraphDynamics(self.compiled, self.line.at(s))
        try:
            for stop in range(len(graph.stop_names)):
                graph.view(graph.open_mode, stop)
        except InputError as error:
            raise SimulationError(str(error), time=0.0, state=()) from error
        return graph

    def restitution(self, s: float) -> float:
        """Return the coefficient of restitution of the first stop at a position on the line."""
        return self.dynamics(s).first.restitution

    def moved_to(self, line: Line) -> Self:
        """Return the same map along another line."""
        return replace(self, line=line)

    def loosened(self) -> Self:
        """Return the same map at a looser tolerance."""
        return replace(self, settings=loosened(self.settings, factor=_LOOSER))

    def frame(self, x: Vector, s: float, scale: Vector) -> Section:
        """Return the directions that keep the constraints, as a chart around a state.

        A return removes the directions off the section, so they have the multiplier zero.
        """
        tangent = kept_directions(self.dynamics(s), x, scale)
        return Section(
            rows=(),
            centre=x,
            scale=scale,
            tangent=tangent,
            normal=np.zeros((x.size, 0)),
            drift=np.zeros((x.size, 1)),
        )

    def projected(self, x: Vector, s: float, scale: Vector) -> Vector:
        """Return the state projected onto its closed stops, and onto the stop that it leaves."""
        del scale
        return on_section(self.dynamics(s), x, self.section.mode)

    def follow(self, x: Vector, s: float, *, horizon: float) -> DifferentiatedReturn:
        """Return the motion from a state of the section to the end of the event sequence.

        Raises:
            SimulationError: If the event sequence is another, or the motion does not return.
        """
        graph, line = self.dynamics(s), self.line
        found = event_return(
            graph,
            x,
            section=self.section.name,
            n_returns=self.section.n_returns,
            guess=horizon / _PATIENCE,
            settings=self.settings,
            parameters=line.moving,
            mode=self.section.mode,
        )
        sequence = sequence_of([orbit_event_name(event) for event in found.events])
        if sequence != self.section.sequence:
            raise SimulationError(
                f"The event sequence changes to `{', '.join(sequence)}`",
                time=found.period,
                state=tuple(x.tolist()),
            )
        clock = self.compiled.graph.mechanism.clock
        turns = 0.0
        if clock is not None:
            first = graph.first.clock[0]
            turn = 2 * np.pi * abs(float(x[first]) / float(graph.first.free.rate(x)[first + 1]))
            turns = found.period / turn if np.isfinite(turn) and turn > 0.0 else 0.0
        return DifferentiatedReturn(
            time=found.period,
            end=found.end,
            by_state=found.by_state,
            by_parameter=found.by_parameters @ line.slopes,
            margins=LazyMargins(lambda: _margins(graph, found)),
            turns=turns,
        )


def _margins(graph: GraphDynamics, found: EventReturn) -> Mapping[Margin, float]:
    """Return the distances of a return from the loss of an event.

    The place of a margin is the index of its event in the event sequence.
    """
    arcs = [arc for arc in found.execution.arcs if arc.start_time < found.period]
    states = np.array([found.start, *(state_before(event) for event in found.events)])
    ranges = np.delete(np.ptp(states, axis=0), graph.first.clock)
    sizes = np.delete(graph.own.states(found.start.size), graph.first.clock)
    margins = {
        Margin(loss=Loss.AMPLITUDE): float(np.max(ranges / sizes)),
        Margin(loss=Loss.FREQUENCY): 1 / found.period,
    }
    before = 0.0
    for place, events in enumerate(_phases(found.events)):
        event = events[-1]
        if not isinstance(event, Release):
            # The end of a contact phase has a law of its own, theory (39).
            margins[Margin(loss=Loss.EVENTS, place=place)] = events[0].time - before
        before = event.time
        if isinstance(events[0], Impact):
            rate = -events[0].approach_rate
            margins[Margin(loss=Loss.FIRST_IMPACT, place=place)] = rate
        if isinstance(event, Release | SwitchEvent):
            rate = _fall(graph, event, arcs)
            if rate is not None:
                loss = Loss.RELEASE_RATE if isinstance(event, Release) else Loss.SWITCH_RATE
                margins[Margin(loss=loss, place=place)] = rate
    for arc in arcs:
        place = sum(1 for one in _phases(found.events) if one[-1].time < arc.end_time)
        for loss, value in _least_guards(graph, arc):
            key = Margin(loss=loss, place=place)
            margins[key] = min(value, margins.get(key, value))
    return margins


def _phases(events: tuple[Event, ...]) -> list[list[Event]]:
    """Return the events of each entry of the event sequence."""
    phases: list[list[Event]] = []
    for event in events:
        last = phases[-1][-1] if phases else None
        goes_on = (
            isinstance(last, Impact)
            and not isinstance(event, Release | SwitchEvent)
            and event.stop == last.stop
            and _accumulates(events, last)
        )
        if goes_on:
            phases[-1].append(event)
        else:
            phases.append([event])
    return phases


def _accumulates(events: tuple[Event, ...], impact: Impact) -> bool:
    """Return True if an impact belongs to a sequence that ends in a Zeno point."""
    for event in events[events.index(impact) + 1 :]:
        if not isinstance(event, Impact) or event.stop != impact.stop:
            return orbit_event_name(event) == f"zeno {impact.stop}"
    return False


def _fall(graph: GraphDynamics, event: Release | SwitchEvent, arcs: list[Arc]) -> float | None:
    """Return how fast a guard falls at its event, or ``None`` if an impact opened the stop."""
    arc = next((one for one in arcs if one.end_time == event.time), None)
    if arc is None or arc.ending not in (Ending.RELEASE, Ending.SWITCH):
        return None
    closed, sides = graph.mode_of(arc.closed, arc.sides)
    if isinstance(event, Release):
        stop = graph.stop_names.index(event.stop)
        view = graph.view((tuple(k for k in closed if k != stop), sides), stop)
        return -view.multiplier_rate(arc.end_state)
    switch = graph.switch_names.index(event.name)
    above = switch < graph.n_declared or sides[switch - graph.n_declared]
    return -float(graph.guard_flow((closed, sides), switch, above).guard(arc.end_state)[1])


def _least_guards(graph: GraphDynamics, arc: Arc) -> list[tuple[Loss, float]]:
    """Return the least gaps of open stops, and multipliers of closed ones, inside an arc."""
    if arc.trajectory is None or arc.stop:
        return []
    closed, sides = graph.mode_of(arc.closed, arc.sides)
    found: list[tuple[Loss, float]] = []
    for k in range(len(graph.stop_names)):
        if k in closed:
            view = graph.view((tuple(j for j in closed if j != k), sides), k)
            least = least_inside(arc, view.multiplier, view.multiplier_rate)
            loss = Loss.ADHESION
        else:
            view = graph.view((closed, sides), k)
            least, loss = least_inside(arc, view.gap, view.gap_rate), Loss.NEAR_MISS
        if least is not None:
            found.append((loss, least))
    return found
