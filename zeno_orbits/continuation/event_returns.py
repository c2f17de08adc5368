"""Return map of a machine with several stops or switches, from an event of a kind to itself.

A family keeps its event sequence. It ends where an event is lost: the rate at an event vanishes,
or the time between two events.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.return_maps import (
    LOOSER,
    PATIENCE,
    DifferentiatedReturn,
    LazyMargins,
    Loss,
    Margin,
    turns_of_clock,
)
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model import CompiledGraph, GraphDynamics, HybridDynamics
from zeno_orbits.orbits import (
    EventReturn,
    Line,
    Section,
    SectionMode,
    event_return,
    extrapolated,
    fall_at,
    kept_directions,
    loosened,
    on_section,
    orbit_event_name,
    phases_of_events,
)
from zeno_orbits.simulation import (
    Arc,
    Completion,
    Impact,
    Release,
    SimulationSettings,
    SwitchEvent,
    ZenoPoint,
    least_inside,
    state_before,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class EventSection:
    """A section of a machine with several stops or switches.

    Attributes:
        name: Name of the event.
        n_returns: Number of events of the section in a period.
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

    def restitution(self, s: float, place: int = 0) -> float:
        """Return the coefficient of restitution of the stop of an event.

        Args:
            s: Position on the line.
            place: Index of the event in the event sequence. If it has no stop, the first is meant.
        """
        graph = self.dynamics(s)
        _, _, name = self.section.sequence[place % len(self.section.sequence)].partition(" ")
        stop = graph.stop_names.index(name) if name in graph.stop_names else 0
        return graph.view(graph.open_mode, stop).restitution

    def moved_to(self, line: Line) -> Self:
        """Return the same map along another line."""
        return replace(self, line=line)

    def loosened(self) -> Self:
        """Return the same map at a looser tolerance."""
        return replace(self, settings=loosened(self.settings, factor=LOOSER))

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
        graph = self.dynamics(s)
        found = self.returned(graph, x, horizon=horizon, completion=extrapolated(self.settings))
        return self.differentiated(graph, found, LazyMargins(lambda: _margins(graph, found)))

    def returned(
        self, graph: GraphDynamics, x: Vector, *, horizon: float, completion: Completion
    ) -> EventReturn:
        """Return the motion from a state of the section to the end of the event sequence.

        Args:
            graph: The graph of modes.
            x: The state, ``(n_x,)``.
            horizon: Longest time to wait [s].
            completion: Method by which Zeno points are reached. It must resolve the impacts.

        Raises:
            SimulationError: If the event sequence is another, or the motion does not return.
        """
        return event_return(
            graph,
            x,
            section=self.section.name,
            n_returns=self.section.n_returns,
            guess=horizon / PATIENCE,
            settings=self.settings,
            parameters=self.line.moving,
            mode=self.section.mode,
            completion=completion,
            sequence=self.section.sequence,
        )

    def differentiated(
        self, graph: GraphDynamics, found: EventReturn, margins: Mapping[Margin, float]
    ) -> DifferentiatedReturn:
        """Return a return with its derivatives along the line.

        Args:
            graph: The graph of modes.
            found: The return.
            margins: Its margins.
        """
        return DifferentiatedReturn(
            time=found.period,
            end=found.end,
            by_state=found.by_state,
            by_parameter=found.by_parameters @ self.line.slopes,
            margins=margins,
            turns=turns_of_clock(graph.first, found.start, found.period),
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
    phases = phases_of_events([orbit_event_name(event) for event in found.events])
    ends = [found.events[phase[-1]].time for phase in phases]
    for place, phase in enumerate(phases):
        first, event = found.events[phase[0]], found.events[phase[-1]]
        if not isinstance(event, Release):
            # The end of a contact phase has a law of its own, theory (39).
            margins[Margin(loss=Loss.EVENTS, place=place)] = first.time - before
        before = event.time
        if isinstance(first, Impact):
            margins[Margin(loss=Loss.FIRST_IMPACT, place=place)] = -first.approach_rate
        if isinstance(event, Release | SwitchEvent):
            rate = fall_at(graph, arcs, event)
            if rate is not None:
                loss = Loss.RELEASE_RATE if isinstance(event, Release) else Loss.SWITCH_RATE
                margins[Margin(loss=loss, place=place)] = rate
    for contact in contacts_of(found):
        margins[Margin(loss=Loss.LOCK, place=contact.place)] = contact.duration
    for arc in arcs:
        place = bisect_left(ends, arc.end_time)
        for loss, value in _least_guards(graph, arc):
            key = Margin(loss=loss, place=place)
            margins[key] = min(value, margins.get(key, value))
    return margins


@dataclass(frozen=True, slots=True, kw_only=True)
class Contact:
    """A contact phase from a Zeno point to the release of the same stop, without other events.

    Attributes:
        place: Index of the release in the event sequence.
        last_impact: The last impact before the Zeno point.
        zeno: The Zeno point.
        duration: Time from the Zeno point to the release [s].
    """

    place: int
    last_impact: Impact
    zeno: ZenoPoint
    duration: float


def contacts_of(found: EventReturn) -> list[Contact]:
    """Return the contact phases of a return that end with a release.

    Args:
        found: The return. Its first contact phase may begin at its end.
    """
    phases = phases_of_events([orbit_event_name(event) for event in found.events])
    contacts: list[Contact] = []
    for place, phase in enumerate(phases):
        # The phase before the first is the last phase of the previous period.
        *earlier, zeno = [found.events[k] for k in phases[place - 1]]
        release = found.events[phase[-1]]
        if not isinstance(release, Release) or not isinstance(zeno, ZenoPoint):
            continue
        impact = earlier[-1] if earlier else None
        if zeno.stop == release.stop and isinstance(impact, Impact):
            wait = release.time - zeno.time + (0.0 if place else found.period)
            contacts.append(Contact(place=place, last_impact=impact, zeno=zeno, duration=wait))
    return contacts


def contact_view(graph: GraphDynamics, found: EventReturn, contact: Contact) -> HybridDynamics:
    """Return the machine with the stop of a contact phase alone, in the mode of that phase.

    Args:
        graph: The graph of modes.
        found: The return.
        contact: One of its contact phases.
    """
    after = next(arc for arc in found.execution.arcs if arc.start_time >= contact.zeno.time)
    stop = graph.stop_names.index(contact.zeno.stop)
    closed, sides = graph.mode_of(after.closed, after.sides)
    return graph.view((tuple(k for k in closed if k != stop), sides), stop)


def _least_guards(graph: GraphDynamics, arc: Arc) -> list[tuple[Loss, float]]:
    """Return the least gaps of open stops, and multipliers of closed ones, inside an arc."""
    if arc.trajectory is None:
        return []
    closed, sides = graph.mode_of(arc.closed, arc.sides)
    found: list[tuple[Loss, float]] = []
    for k in range(len(graph.stop_names)):
        if k in closed:
            view = graph.holding((closed, sides), k)
            least = least_inside(arc, view.multiplier, view.multiplier_rate)
            loss = Loss.ADHESION
        else:
            view = graph.view((closed, sides), k)
            least, loss = least_inside(arc, view.gap, view.gap_rate), Loss.NEAR_MISS
        if least is not None:
            found.append((loss, least))
    return found
