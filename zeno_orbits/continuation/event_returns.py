"""Return map of a machine with several stops or switches, from an event of a kind to itself.

A family keeps its event sequence. It ends where an event is lost: the rate at an event vanishes,
or the time between two events.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.return_maps import (
    LOOSER,
    PATIENCE,
    DifferentiatedReturn,
    LazyMargins,
    turns_of_clock,
)
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model import CompiledGraph, GraphDynamics
from zeno_orbits.orbits import (
    EventReturn,
    EventSection,
    Line,
    Margin,
    Saddle,
    Section,
    event_return,
    extrapolated,
    kept_section,
    margins_of_return,
    on_section,
    relaxed_settings,
    saddle_of_return,
)
from zeno_orbits.simulation import (
    Completion,
    SimulationSettings,
)


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

    @property
    def n_places(self) -> int:
        """Number of events in the event sequence."""
        return len(self.section.sequence)

    def dynamics(self, s: float) -> GraphDynamics:
        """Return the graph of modes at a position on the line.

        Raises:
            SimulationError: If the values are invalid there, such as a negative restitution.
        """
        graph = GraphDynamics(self.compiled, self.line.at(s))
        try:
            _ = graph.open_views
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
        return replace(self, settings=relaxed_settings(self.settings, factor=LOOSER))

    def frame(self, x: Vector, s: float, scale: Vector) -> Section:
        """Return a chart of the admissible states around a state.

        A return removes the directions off the section, so they have the multiplier zero.
        """
        line = self.line
        kept = kept_section(self.dynamics(s), x, self.section.mode, scale, line.moving)
        return replace(kept, drift=(kept.drift @ line.slopes)[:, None])

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
        return self.differentiated(
            graph, found, LazyMargins(lambda: margins_of_return(graph, found))
        )

    def saddle(self, x: Vector, s: float, *, horizon: float) -> Saddle | None:
        """Return the saddle near the slowest state of the motion from a state, or ``None``."""
        graph = self.dynamics(s)
        found = self.returned(graph, x, horizon=horizon, completion=extrapolated(self.settings))
        return saddle_of_return(graph, found)

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
            openings=self.section.openings,
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
