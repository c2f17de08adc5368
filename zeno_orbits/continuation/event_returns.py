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
from zeno_orbits.model import CompiledGraph, GraphDynamics
from zeno_orbits.orbits import (
    EventReturn,
    Line,
    Section,
    SectionMode,
    event_return,
    fall_at,
    kept_directions,
    loosened,
    on_section,
    orbit_event_name,
    phases_of_events,
    sequence_of,
)
from zeno_orbits.simulation import (
    Arc,
    Impact,
    Release,
    SimulationSettings,
    SwitchEvent,
    least_inside,
    state_before,
)


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
        graph, line = self.dynamics(s), self.line
        found = event_return(
            graph,
            x,
            section=self.section.name,
            n_returns=self.section.n_returns,
            guess=horizon / PATIENCE,
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
        return DifferentiatedReturn(
            time=found.period,
            end=found.end,
            by_state=found.by_state,
            by_parameter=found.by_parameters @ line.slopes,
            margins=LazyMargins(lambda: _margins(graph, found)),
            turns=turns_of_clock(graph.first, x, found.period),
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
    for arc in arcs:
        place = bisect_left(ends, arc.end_time)
        for loss, value in _least_guards(graph, arc):
            key = Margin(loss=loss, place=place)
            margins[key] = min(value, margins.get(key, value))
    return margins


def _least_guards(graph: GraphDynamics, arc: Arc) -> list[tuple[Loss, float]]:
    """Return the least gaps of open stops, and multipliers of closed ones, inside an arc."""
    if arc.trajectory is None:
        return []
    closed, sides = graph.mode_of(arc.closed, arc.sides)
    found: list[tuple[Loss, float]] = []
    for k, name in enumerate(graph.stop_names):
        if name == arc.stop:
            continue
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
