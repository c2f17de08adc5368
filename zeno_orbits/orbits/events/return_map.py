r"""Chart of the section at which the period of an event orbit starts, and the return map in it.

The section consists of the states just after the last event of the period, on the stops that it
touches. A switch may reset many states to one. Its section consists of the states just before it:
its guard is zero, and the stops that are closed have gap and gap rate zero. The motion then starts
at the reset of such a state. The return map :math:`P` of a section before a reset :math:`R` is
:math:`P = \varphi \circ R` with the flow :math:`\varphi` to the next state before the switch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model import GraphDynamics, GraphMode, HybridDynamics
from zeno_orbits.orbits.events.event_orbit import EventOrbit
from zeno_orbits.orbits.events.section import EventReturn, SectionMode, event_return, largest_states
from zeno_orbits.orbits.monodromy import differentials_of
from zeno_orbits.orbits.section import (
    IMPACT_ROWS,
    RELEASE_ROWS,
    REST_ROWS,
    Section,
    conditions,
    section_of,
)
from zeno_orbits.simulation import (
    Arc,
    Event,
    SimulationSettings,
    SwitchEvent,
    scale_of,
    state_after,
    state_before,
)

_ON, _CAUSED = 1e-9, 1e-6
"""Correction in scaled states above which a state is off its section, and above which an event does
not have its own conditions."""
_ROWS: dict[str, tuple[int, ...]] = {
    "impact": IMPACT_ROWS,
    "zeno": REST_ROWS,
    "release": RELEASE_ROWS,
}
"""Kind of an event to the rows of its stop that vanish just after it."""

_Contact = tuple[HybridDynamics, tuple[int, ...]]
"""A system with one stop, and the rows of its contact that vanish on a section."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Surface:
    """The set of states at an event.

    Attributes:
        graph: The graph of modes.
        contacts: The stops at the event, with their rows that vanish.
        switch: Index of the switch whose guard vanishes, or ``None``.
        sides: The side of every kink before the event.
    """

    graph: GraphDynamics
    contacts: tuple[_Contact, ...]
    switch: int | None
    sides: tuple[bool, ...]

    def values(self, x: Vector) -> Vector:
        """Return the conditions, which vanish on the set, the constraints first."""
        parts = [conditions(self.graph.first, (), x)]
        for view, rows in self.contacts:
            parts.append(conditions(view, rows, x)[: len(rows)])
        if self.switch is not None:
            parts.append(self.graph.guards(x, self.sides)[0][[self.switch]])
        return np.concatenate(parts)

    def gradient(self, x: Vector) -> Vector:
        """Return the gradient of the conditions, ``(n_conditions, n_x)``."""
        parts = [differentials_of(self.graph.first, ()).holonomic(x)]
        for view, rows in self.contacts:
            parts.append(differentials_of(view, ()).contact(x)[list(rows)])
        if self.switch is not None:
            gradient = self.graph.guard_gradient(self.switch, x, (), self.sides)
            parts.append(gradient[None, :])
        return np.concatenate(parts)

    def reset(self, x: Vector) -> Vector:
        """Return the state from which the motion goes on, ``(n_x,)``."""
        if self.switch is None or self.switch >= self.graph.n_declared:
            return x
        return self.graph.after_switch(self.switch, x)

    def reset_derivative(self, x: Vector) -> Vector:
        """Return its derivative, ``(n_x, n_x)``."""
        if self.switch is None or self.switch >= self.graph.n_declared:
            return np.eye(x.size)
        return self.graph.reset_derivative(self.switch, x, ())


@dataclass(frozen=True, slots=True, kw_only=True)
class EventChart:
    """The return map of an event orbit in coordinates of its section.

    Attributes:
        graph: The graph of modes.
        orbit: The orbit.
        settings: Accuracy.
        mode: The mode just after the last event of the period.
        before: The mode just before it.
        surface: The section.
        section: The chart of the section around the orbit.
        slope: Derivative of the return map at the orbit, ``(d, d)``.
        drift: Largest change of a scaled state over the period of the orbit.
    """

    graph: GraphDynamics
    orbit: EventOrbit
    settings: SimulationSettings
    mode: SectionMode
    before: GraphMode
    surface: _Surface
    section: Section
    slope: Vector
    drift: float

    def returned(self, coordinates: Vector) -> Vector:
        """Return the coordinates of the next return, ``(d,)``.

        Args:
            coordinates: Coordinates of a state of the section, ``(d,)``.

        Raises:
            InputError: If the motion cannot start there.
            SimulationError: If the event does not occur there, the motion does not return, or its
                event sequence is another.
        """
        start = self._start(coordinates)
        found = _next_return(self.graph, self.orbit, start, self.settings, self.mode)
        return self.section.coordinates(_on_surface(found.events[-1]))

    def _start(self, coordinates: Vector) -> Vector:
        """Return the state just after the event at section coordinates, ``(n_x,)``."""
        x = self.section.root(self.surface.values, coordinates, self.surface.gradient)
        off = self.section.normal @ self.surface.values(x)
        if np.max(np.abs(off), initial=0.0) > _ON or not self._occurs(x):
            reason = f"The event `{self.orbit.section}` does not occur here"
            raise SimulationError(reason, time=0.0, state=tuple(x.tolist()))
        return self.surface.reset(x)

    def _occurs(self, x: Vector) -> bool:
        """Return True if a motion in the mode of the orbit reaches the event at a state."""
        graph, switch = self.graph, self.surface.switch
        if switch is None:
            # The simulation starts after the event, and another mode has other events.
            return True
        declared = switch < graph.n_declared
        above = declared or self.before[1][switch - graph.n_declared]
        falls = graph.guard_flow(self.before, switch, above).guard(x)[1] < 0.0
        armed = not declared or graph.guards(x, self.before[1])[2][switch] > 0.0
        held = all(view.multiplier(x) > 0.0 for view, _ in self.surface.contacts)
        return bool(falls and armed and held)


def event_chart(
    graph: GraphDynamics, orbit: EventOrbit, units: Sequence[str], settings: SimulationSettings
) -> EventChart:
    """Return the return map of an event orbit in a chart of its section.

    Args:
        graph: The graph of modes at the values of the orbit.
        orbit: The orbit.
        units: Unit of each state.
        settings: Accuracy.

    Raises:
        InputError: If the last event of the period is the consequence of another event.
        SimulationError: If the motion from its start does not have the event sequence of the orbit.
    """
    x = np.array([orbit.start_state[name] for name in graph.state_names])
    found = _next_return(graph, orbit, x, settings, None)
    arcs = found.execution.arcs
    mode = SectionMode.of(arcs[0], orbit.section)
    last = next(arc for arc in arcs if arc.end_time >= found.period)
    surface = _surface_at(graph, orbit.section, mode, last)
    # A state that has decayed gets the size of the other states with its unit.
    scale = scale_of([largest_states(arcs, graph)], units, graph.own.states(x.size))
    centre = _on_surface(found.events[-1])
    section = section_of(surface.gradient(centre) * scale, centre, scale)
    off = section.normal @ surface.values(centre)
    if np.max(np.abs(off), initial=0.0) > _CAUSED:
        wanted = f"must start at another event, but `{orbit.section}` is caused by the one before"
        raise InputError(f"Argument `orbit` {wanted} it.")
    carried = _end_by_state(found, surface) @ surface.reset_derivative(centre)
    return EventChart(
        graph=graph,
        orbit=orbit,
        settings=settings,
        mode=mode,
        before=graph.mode_of(last.closed, last.sides),
        surface=surface,
        section=section,
        slope=section.components(carried @ section.lift),
        drift=float(np.max(np.abs(found.end - found.start) / scale)),
    )


def _next_return(
    graph: GraphDynamics,
    orbit: EventOrbit,
    x: Vector,
    settings: SimulationSettings,
    mode: SectionMode | None,
) -> EventReturn:
    """Return the motion over one event sequence of an orbit, from a state after its last event."""
    return event_return(
        graph,
        x,
        section=orbit.section,
        n_returns=orbit.n_returns,
        guess=orbit.period,
        settings=settings,
        mode=mode,
        sequence=orbit.sequence,
    )


def _on_surface(event: Event) -> Vector:
    """Return the state of an event that belongs to its section, ``(n_x,)``."""
    return state_before(event) if isinstance(event, SwitchEvent) else state_after(event)


def _end_by_state(found: EventReturn, surface: _Surface) -> Vector:
    """Return the derivative of the last state on a section by the start, ``(n_x, n_x)``."""
    return found.by_state if surface.switch is None else found.shifts[-1].state


def _surface_at(graph: GraphDynamics, section: str, mode: SectionMode, last: Arc) -> _Surface:
    """Return the section of an event.

    Args:
        graph: The graph of modes.
        section: Name of the event.
        mode: The mode just after the event.
        last: The arc that ends at the event.
    """
    kind, _, name = section.partition(" ")
    closed, sides = before = graph.mode_of(last.closed, last.sides)
    if kind == "switch":
        held = tuple((graph.holding(before, k), REST_ROWS) for k in closed)
        switch = graph.switch_names.index(name)
        return _Surface(graph=graph, contacts=held, switch=switch, sides=sides)
    # An impact may open other stops. Their gaps are zero after it.
    rows: dict[int, tuple[int, ...]] = dict.fromkeys(closed, IMPACT_ROWS)
    closed, _ = after = graph.mode_of(mode.closed, mode.sides)
    struck = graph.stop_names.index(name)
    rows[struck] = _ROWS[kind]
    if graph.holding(after, struck).restitution == 0.0 and kind == "impact":
        rows[struck] = REST_ROWS
    rows.update((k, REST_ROWS) for k in closed)
    contacts = tuple((graph.holding(after, k), chosen) for k, chosen in rows.items())
    return _Surface(graph=graph, contacts=contacts, switch=None, sides=sides)
