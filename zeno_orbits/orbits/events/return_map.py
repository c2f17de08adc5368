r"""Chart of the section at which the period of an event orbit starts, and the return map in it.

The section consists of the states just after the last event of the period, on the stops that it
touches. If another event at the same time caused the last event, the section is that of the cause.
A switch may reset many states to one. Its section consists of the states just before it: its guard
is zero, and the stops that are closed have gap and gap rate zero. The motion then starts at the
reset of such a state. The return map :math:`P` of a section before a reset :math:`R` is
:math:`P = \varphi \circ R` with the flow :math:`\varphi` to the next state before the switch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector, eigenvalues
from zeno_orbits.errors import SimulationError
from zeno_orbits.model import GraphDynamics, GraphMode, HybridDynamics
from zeno_orbits.orbits.events.section import EventReturn, SectionMode, event_return, largest_states
from zeno_orbits.orbits.orbit import Orbit
from zeno_orbits.orbits.section import (
    IMPACT_ROWS,
    RELEASE_ROWS,
    REST_ROWS,
    Section,
    conditions,
    differentials_of,
    section_of,
)
from zeno_orbits.orbits.sequences import (
    orbit_event_name,
    phases_of_events,
)
from zeno_orbits.simulation import (
    Arc,
    Event,
    Impact,
    Release,
    SaltationDerivative,
    SimulationSettings,
    SwitchEvent,
    ZenoPoint,
    scale_of,
    state_after,
    state_before,
)

_ON = 1e-9
"""Correction in scaled states above which a state is off its section."""
_AT_ONCE, _CROSSES, _JUMPS = 1e-9, 1e6, 1e-6
"""Distance of two events at one time, in periods. Least change of a condition over a period that is
a crossing, in rounding levels. Least jump of a flow, relative to its largest rate."""
_ROWS: dict[str, tuple[int, ...]] = {
    "impact": IMPACT_ROWS,
    "zeno": REST_ROWS,
    "release": RELEASE_ROWS,
}
"""Kind of an event to the rows of its stop that vanish just after it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Surface:
    """The set of states at an event.

    Attributes:
        graph: The graph of modes.
        mode: The mode before a switch, or after another event.
        rows: Index of each stop at the event, to the rows of its contact that vanish.
        switch: Index of the switch whose guard vanishes, or ``None``.
        setter: Index of the switch that sets states at the event of a stop, or ``None``.
    """

    graph: GraphDynamics
    mode: GraphMode
    rows: Mapping[int, tuple[int, ...]]
    switch: int | None
    setter: int | None = None

    @property
    def contacts(self) -> list[tuple[HybridDynamics, tuple[int, ...]]]:
        """The dynamics of each stop at the event, with its rows that vanish."""
        return [(self.graph.holding(self.mode, k), rows) for k, rows in self.rows.items()]

    def values(self, x: Vector) -> Vector:
        """Return the conditions, which vanish on the set, the constraints first."""
        parts = [conditions(self.graph.first, (), x)]
        for view, rows in self.contacts:
            parts.append(conditions(view, rows, x)[: len(rows)])
        if self.switch is not None:
            parts.append(self.graph.guards(self.mode, x)[0][[self.switch]])
        return np.concatenate(parts)

    def gradient(self, x: Vector, chosen: Sequence[int] = ()) -> Vector:
        """Return the gradient of the conditions, ``(n_conditions, n_x + k)``.

        Args:
            x: A state, ``(n_x,)``.
            chosen: Indices in ``p`` of the parameters, ``(k,)``.
        """
        chosen = tuple(chosen)
        parts = [differentials_of(self.graph.first, chosen).holonomic(x)]
        for view, rows in self.contacts:
            parts.append(differentials_of(view, chosen).contact(x)[list(rows)])
        if self.switch is not None:
            gradient = self.graph.guard_gradient(self.switch, x, chosen, self.mode)
            parts.append(gradient[None, :])
        return np.concatenate(parts)

    def state(self, section: Section, coordinates: Vector, event: str) -> Vector:
        """Return the state of the set at coordinates of a chart, ``(n_x,)``.

        Args:
            section: The chart.
            coordinates: The coordinates, ``(d,)``.
            event: Name of the event, for the message.

        Raises:
            SimulationError: If the event does not occur there.
        """
        x = section.root(self.values, coordinates, self.gradient)
        off = section.normal @ self.values(x)
        if np.max(np.abs(off), initial=0.0) > _ON or not self.occurs(x):
            reason = f"The event `{event}` does not occur here"
            raise SimulationError(reason, time=0.0, state=tuple(x.tolist()))
        return x

    def reset(self, x: Vector) -> Vector:
        """Return the state from which the motion goes on, ``(n_x,)``."""
        place = self._resetting
        return x if place is None else self.graph.after_switch(place, x)

    @property
    def _resetting(self) -> int | None:
        """Index of the declared switch whose reset the motion passes at the event."""
        is_kink = self.switch is not None and self.switch >= self.graph.n_declared
        return self.setter if self.switch is None or is_kink else self.switch

    def reset_derivative(self, x: Vector, chosen: Sequence[int] = ()) -> Vector:
        """Return its derivative, ``(n_x, n_x + k)``.

        Args:
            x: A state, ``(n_x,)``.
            chosen: Indices in ``p`` of the parameters, ``(k,)``.
        """
        place = self._resetting
        if place is None:
            return np.eye(x.size, x.size + len(chosen))
        return self.graph.reset_derivative(place, x, chosen)

    def occurs(self, x: Vector) -> bool:
        """Return True if a motion in the mode of the set has the event at one of its states."""
        graph, switch = self.graph, self.switch
        if switch is None:
            # The simulation starts after the event, and another mode has other events.
            return True
        declared = switch < graph.n_declared
        above = declared or self.mode[1][switch - graph.n_declared]
        falls = graph.guard_flow(self.mode, switch, above).guard(x)[1] < 0.0
        armed = not declared or graph.guards(self.mode, x)[2][switch] > 0.0
        held = all(view.multiplier(x) > 0.0 for view, _ in self.contacts)
        return bool(falls and armed and held)


@dataclass(frozen=True, slots=True, kw_only=True)
class EventChart:
    """The return map of an event orbit in coordinates of its section.

    Attributes:
        graph: The graph of modes.
        orbit: The orbit.
        settings: Accuracy.
        mode: The mode at the start of the period.
        surface: The section.
        section: The chart of the section around the orbit.
        slope: Derivative of the return map at the orbit, ``(d, d)``.
        drift: Largest change of a scaled state over the period of the orbit.
    """

    graph: GraphDynamics
    orbit: Orbit
    settings: SimulationSettings
    mode: SectionMode
    surface: Surface
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
        return self.section.coordinates(on_surface(cause_at(found, found.period)))

    def _start(self, coordinates: Vector) -> Vector:
        """Return the state just after the event at section coordinates, ``(n_x,)``."""
        x = self.surface.state(self.section, coordinates, self.orbit.section)
        return self.surface.reset(x)


def event_chart(
    graph: GraphDynamics, orbit: Orbit, units: Sequence[str], settings: SimulationSettings
) -> EventChart:
    """Return the return map of an event orbit in a chart of its section.

    Args:
        graph: The graph of modes at the values of the orbit.
        orbit: The orbit.
        units: Unit of each state.
        settings: Accuracy.

    Raises:
        SimulationError: If the motion from its start does not have the event sequence of the orbit.
    """
    x = np.array([orbit.start_state[name] for name in graph.state_names])
    found = _next_return(graph, orbit, x, settings, None)
    arcs = found.execution.arcs
    # A state that has decayed gets the size of the other states with its unit.
    scale = scale_of([largest_states(arcs, graph)], units, graph.own.states(x.size))
    surface, section, slope = _slope(graph, found, scale)
    return EventChart(
        graph=graph,
        orbit=orbit,
        settings=settings,
        mode=found.mode,
        surface=surface,
        section=section,
        slope=slope,
        drift=float(np.max(np.abs(found.end - found.start) / scale)),
    )


def multipliers_of_return(graph: GraphDynamics, found: EventReturn) -> tuple[complex, ...]:
    """Return the Floquet multipliers of a periodic return, the largest first.

    They are those of the disturbances that the section admits. The motion passes the sections of
    all events of the period. The one of the least dimension bounds the number of multipliers.

    Args:
        graph: The graph of modes.
        found: The return.

    Raises:
        SimulationError: If the return lacks a derivative, as where a root meets zero at an event.
    """
    scale = largest_states(found.execution.arcs, graph)
    slope = _slope(graph, found, scale)[2]
    if not np.all(np.isfinite(slope)):
        raise SimulationError(
            "The return lacks a derivative: a formula has an infinite slope at an event",
            time=found.period,
            state=tuple(found.start.tolist()),
        )
    least = len(slope)
    phases = phases_of_events([orbit_event_name(event) for event in found.events])
    # Events of one kind between the same modes have sections of one dimension.
    causes: dict[tuple[str, tuple[str, ...], tuple[str, ...]], Event] = {}
    for time in {found.events[phase[-1]].time for phase in phases}:
        cause = cause_at(found, time)
        before, after = _arcs_at(found, time)
        causes.setdefault((orbit_event_name(cause), before.closed, after.closed), cause)
    for cause in causes.values():
        least = min(least, _section_at(graph, found, cause, scale)[1].dimension)
    return eigenvalues(slope)[:least]


def is_one_sided(graph: GraphDynamics, found: EventReturn) -> bool:
    r"""Return True if a kink at which the flow jumps is crossed at the time of another event.

    A disturbance decides which of the two is first, and each order has its own derivative. The
    times are one if :math:`\lvert c \rvert \le 10^{-9}\, T\, \lvert \dot c \rvert` for the
    condition `c` of the kink at the event and the period `T`.

    Args:
        graph: The graph of modes.
        found: The return.
    """
    if graph.n_declared == len(graph.switch_names):
        return False
    switched = {event.time for event in found.events if isinstance(event, SwitchEvent)}
    for event in found.events:
        # A release that a switch causes follows it in every motion nearby.
        caused = isinstance(event, Release) and event.time in switched
        if caused or isinstance(event, SwitchEvent):
            continue
        before, after = _arcs_at(found, event.time)
        ends = [(state_before(event), before), (state_after(event), after)]
        # Seen from the contact, in which a condition of the gap rate stays zero.
        first, last = isinstance(event, ZenoPoint), 1 if isinstance(event, Release) else 2
        if any(_meets_a_kink(graph, x, arc, found.period) for x, arc in ends[first:last]):
            return True
    return False


def _meets_a_kink(graph: GraphDynamics, x: Vector, arc: Arc, period: float) -> bool:
    mode = arc.mode_in(graph)
    values, levels, _ = graph.guards(((), arc.sides), x)
    flow = graph.flow(mode).rate(x)
    for k, side in enumerate(arc.sides):
        switch = graph.n_declared + k
        change = period * abs(float(graph.guard_gradient(switch, x, (), mode) @ flow))
        # A condition that stays zero is a property of the machine, and no meeting.
        if change > _CROSSES * levels[switch] and abs(values[switch]) <= _AT_ONCE * change:
            sides = (*arc.sides[:k], not side, *arc.sides[k + 1 :])
            other = graph.flow(graph.mode_of(arc.closed, sides)).rate(x)
            if np.any(np.abs(other - flow) > _JUMPS * np.max(np.abs(flow))):
                return True
    return False


def derivative_of_return(graph: GraphDynamics, found: EventReturn) -> tuple[str, Section, Vector]:
    """Return the event of the section of a periodic return, its chart, and the derivative in it.

    Args:
        graph: The graph of modes.
        found: The return.

    Returns:
        Name of the event, chart, and derivative, ``(d, d)``.
    """
    _, section, slope = _slope(graph, found, largest_states(found.execution.arcs, graph))
    return orbit_event_name(cause_at(found, found.period)), section, slope


def _slope(
    graph: GraphDynamics, found: EventReturn, scale: Vector
) -> tuple[Surface, Section, Vector]:
    """Return the section of a periodic return, its chart, and the derivative in it, ``(d, d)``."""
    cause = cause_at(found, found.period)
    surface, section = _section_at(graph, found, cause, scale)
    at_reset = isinstance(cause, SwitchEvent) or surface.setter is not None
    carried = shift_at(found, cause).state if at_reset else found.by_state
    carried = carried[:, : len(scale)] @ surface.reset_derivative(section.centre)
    return surface, section, section.components(carried @ section.lift)


def shift_at(found: EventReturn, event: Event) -> SaltationDerivative:
    """Return the derivatives of an event, with the state on its section.

    Args:
        found: The return.
        event: One of its events.
    """
    place = found.events.index(event)
    return (found.shifts if isinstance(event, SwitchEvent) else found.after)[place]


def _section_at(
    graph: GraphDynamics, found: EventReturn, cause: Event, scale: Vector
) -> tuple[Surface, Section]:
    """Return the section of an event of a return, and its chart."""
    surface = surface_of(graph, found, cause)
    centre = on_surface(cause)
    return surface, section_of(surface.gradient(centre) * scale, centre, scale)


def _arcs_at(found: EventReturn, time: float) -> tuple[Arc, Arc]:
    """Return the arc that ends at the time of an event, and the arc that starts there."""
    arcs = found.execution.arcs
    before = next(arc for arc in arcs if arc.end_time >= time)
    return before, [arc for arc in arcs if arc.start_time <= time][-1]


def cause_at(found: EventReturn, time: float) -> Event:
    """Return the event at a time of which other events at this time are consequences.

    A contact has conditions of its own, even if another event causes it.
    """
    events = [event for event in found.events if event.time == time]
    contacts = [event for event in events if isinstance(event, Impact | ZenoPoint)]
    return contacts[-1] if contacts else events[0]


def _next_return(
    graph: GraphDynamics,
    orbit: Orbit,
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


def on_surface(event: Event) -> Vector:
    """Return the state of an event on its section, ``(n_x,)``."""
    return state_before(event) if isinstance(event, SwitchEvent) else state_after(event)


def surface_of(graph: GraphDynamics, found: EventReturn, event: Event) -> Surface:
    """Return the section of an event of a return.

    Args:
        graph: The graph of modes.
        found: The return.
        event: The event, which no other event at its time causes.
    """
    before, after = _arcs_at(found, event.time)
    kind, _, name = orbit_event_name(event).partition(" ")
    closed, _ = mode = before.mode_in(graph)
    if kind == "switch":
        held = dict.fromkeys(closed, REST_ROWS)
        return Surface(graph=graph, mode=mode, rows=held, switch=graph.switch_names.index(name))
    # An impact may open other stops. Their gaps are zero after it.
    rows: dict[int, tuple[int, ...]] = dict.fromkeys(closed, IMPACT_ROWS)
    closed, _ = mode = after.mode_in(graph)
    struck = graph.stop_names.index(name)
    rows[struck] = _ROWS[kind]
    if graph.holding(mode, struck).restitution == 0.0 and kind == "impact":
        rows[struck] = REST_ROWS
    rows.update((k, REST_ROWS) for k in closed)
    setter = graph.setter_at(orbit_event_name(event))
    return Surface(graph=graph, mode=mode, rows=rows, switch=None, setter=setter)
