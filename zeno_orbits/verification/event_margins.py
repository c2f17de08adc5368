"""Margins of an orbit of events: distances to the loss of an event (theory (3.9)).

They are positive along an orbit. A share relates a margin to its largest possible value.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from zeno_orbits.arrays import Vector
from zeno_orbits.model import GraphDynamics
from zeno_orbits.orbits import EventQuantities, EventReturn, fall_at
from zeno_orbits.simulation import (
    Arc,
    Event,
    Impact,
    Release,
    SwitchEvent,
    ZenoPoint,
    extent_of,
)

SHARE = "margin"
"""Name of the smallest share."""
EVENT_MARGINS = (
    "gap_acceleration",
    "first_impact_speed",
    "release_transversality",
    "switch_transversality",
    "locked_time",
)
"""Distances to the loss of an event, as in a certificate."""


def event_margins(
    graph: GraphDynamics,
    start: Vector,
    events: Sequence[Event],
    arcs: Sequence[Arc],
    period: float,
) -> dict[str, float]:
    """Return the distances to the loss of an event, the smallest of each kind that occurs.

    Args:
        graph: The graph of modes.
        start: State at the start of the period, ``(n_x,)``.
        events: Events of the period. The last event ends it.
        arcs: Its arcs.
        period: The period [s].
    """
    found: dict[str, list[float]] = {}

    def keep(name: str, value: float | None) -> None:
        if value is not None:
            found.setdefault(name, []).append(value)

    for impact in _first_impacts(graph, start, events, period):
        keep("first_impact_speed", -impact.approach_rate)
    for contact in _contacts(graph, events, arcs):
        keep("gap_acceleration", contact.push)
        keep("locked_time", contact.duration)
    for event in events:
        if isinstance(event, Release | SwitchEvent):
            what = "release" if isinstance(event, Release) else "switch"
            keep(f"{what}_transversality", fall_at(graph, arcs, event))
    return {name: min(found[name]) for name in EVENT_MARGINS if name in found}


def measured_margin(name: str, graph: GraphDynamics, found: EventReturn) -> float | None:
    """Return a margin of a periodic return, or the smallest share. ``None`` without such an event.

    Args:
        name: Name of the margin.
        graph: The graph of modes.
        found: The return.
    """
    arcs = [arc for arc in found.execution.arcs if arc.start_time < found.period]
    if name == SHARE:
        return smallest_event_share(graph, found.start, found.events, arcs, found.period)
    return event_margins(graph, found.start, found.events, arcs, found.period).get(name)


def smallest_event_share(
    graph: GraphDynamics,
    start: Vector,
    events: Sequence[Event],
    arcs: Sequence[Arc],
    period: float,
) -> float | None:
    r"""Return the smallest margin of all contacts, relative to its largest possible value.

    The contact duration is relative to the period. :math:`-\ddot h` at a Zeno point is relative to
    its largest value in the contact phase. The speed of a first impact is relative to the largest
    gap rate since the last event of its stop. Theory (5.3).

    Args:
        graph: The graph of modes.
        start: State at the start of the period, ``(n_x,)``.
        events: Events of the period. The last event ends it.
        arcs: Its arcs.
        period: The period [s].

    Returns:
        The share, or ``None`` if no stop is struck.
    """
    shares: list[float] = []
    for impact in _first_impacts(graph, start, events, period):
        view = graph.view(graph.open_mode, graph.stop_names.index(impact.stop))
        flight = _flight_to(impact, events, arcs)
        if flight:
            shares.append(-impact.approach_rate / extent_of(view.gap_rate, flight).largest)
    for contact in _contacts(graph, events, arcs):
        shares += [contact.duration / period, contact.push / contact.largest_push]
    return min(shares, default=None)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Contact:
    """A contact phase after a Zeno point.

    Attributes:
        duration: Its duration [s].
        push: Minus the gap acceleration at the Zeno point.
        largest_push: Largest modulus of the gap acceleration in the phase.
    """

    duration: float
    push: float
    largest_push: float


def _first_impacts(
    graph: GraphDynamics, start: Vector, events: Sequence[Event], period: float
) -> Iterator[Impact]:
    """Yield the first impact of every sequence."""
    quantities = EventQuantities(graph=graph, start=start, period=period, events=tuple(events))
    speeds = {
        (stop, one.value)
        for stop in graph.stop_names
        for one in quantities.readings(f"{stop}.impact_speed")
    }
    for event in events:
        # The speeds are those of the events, bit for bit.
        if isinstance(event, Impact) and (event.stop, -event.approach_rate) in speeds:
            yield event


def _contacts(
    graph: GraphDynamics, events: Sequence[Event], arcs: Sequence[Arc]
) -> Iterator[_Contact]:
    """Yield the contact phases of a period. The last one may go on over its end."""
    for event in events:
        if not isinstance(event, ZenoPoint):
            continue
        first = next((k for k, arc in enumerate(arcs) if arc.start_time >= event.time), 0)
        held: list[Arc] = []
        for arc in (*arcs[first:], *arcs[:first]):
            if event.stop not in arc.closed:
                break
            held.append(arc)
        if not held:
            continue
        stop = graph.stop_names.index(event.stop)
        pushes = [
            extent_of(graph.holding(arc.mode_in(graph), stop).gap_acceleration, [arc])
            for arc in held
        ]
        mode = held[0].mode_in(graph)
        yield _Contact(
            duration=sum(arc.duration for arc in held),
            push=-graph.holding(mode, stop).gap_acceleration(event.state),
            largest_push=max(one.largest for one in pushes),
        )


def _flight_to(impact: Impact, events: Sequence[Event], arcs: Sequence[Arc]) -> list[Arc]:
    """Return the arcs from the last event of a stop to an impact on it."""
    last = next((k for k, arc in enumerate(arcs) if arc.end_time == impact.time), None)
    if last is None:
        return []
    times = {
        event.time
        for event in events
        if not isinstance(event, SwitchEvent) and event.stop == impact.stop
    }
    flight: list[Arc] = []
    for arc in reversed((*arcs[last + 1 :], *arcs[: last + 1])):
        flight.append(arc)
        if arc.start_time in times:
            break
    return flight
