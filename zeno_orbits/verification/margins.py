"""Margins of an orbit of events: distances to the loss of an event (theory (3.9)).

They are positive along an orbit. A share relates a margin to its largest possible value.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from zeno_orbits.arrays import Scalar, Vector
from zeno_orbits.model import GraphDynamics
from zeno_orbits.orbits import (
    EventReturn,
    fall_at,
    orbit_event_name,
    phases_of_events,
    sequence_of,
)
from zeno_orbits.simulation import (
    Arc,
    Event,
    Impact,
    Release,
    SwitchEvent,
    extent_of,
    state_after,
)
from zeno_orbits.verification.energies import struck_view
from zeno_orbits.verification.integration import Period

SHARE = "margin"
"""Name of the smallest share."""
EVENT_MARGINS = (
    "gap_acceleration",
    "first_impact_speed",
    "release_transversality",
    "switch_transversality",
    "locked_time",
)
"""Distances to the loss of an event that a search can bound."""
_FURTHER = ("later_impact_speed", "lets_go", "events_apart", "phases_apart")
"""Further distances, in a certificate."""
_SAME = 1e-6
"""Relative distance below which two states are equal: the accuracy of an orbit."""


def margins_of(graph: GraphDynamics, period: Period, scale: Vector) -> dict[str, float]:
    """Return the distances to the loss of an event, the smallest of each kind that occurs.

    ``later_impact_speed`` is the speed of an impact relative to the speed after the impact before
    it in its sequence. ``lets_go`` is d2h/dt2 after a plastic impact without contact.
    ``events_apart`` is the least time between events, where impacts belong to their Zeno point.
    ``phases_apart`` is the distance of the start from the state after a part of the events that
    repeats. It is 0 if both are equal to the accuracy of an orbit: the period then consists of
    several shorter periods.

    Args:
        graph: The graph of modes.
        period: The period.
        scale: Size of each state, ``(n_x,)``.
    """
    found = _at_events(graph, period)
    phases = phases_of_events([orbit_event_name(event) for event in period.events])
    apart, before = list[float](), period.start
    for phase in phases:
        first, last = period.events[phase[0]], period.events[phase[-1]]
        if first.time > before:
            apart.append(first.time - before)
        before = last.time
        found["later_impact_speed"] += _kept_speeds(graph, [period.events[k] for k in phase])
        if isinstance(last, Impact):
            view = struck_view(graph, period, last)
            if view.restitution == 0.0:
                found["lets_go"].append(view.gap_acceleration(last.state_plus))
    found["events_apart"] += apart
    found["phases_apart"] += _shorter_periods(period, scale)
    return {name: float(min(values)) for name, values in found.items() if values}


def _at_events(graph: GraphDynamics, period: Period) -> dict[str, list[float]]:
    """Return the margins of single events and contacts, by name."""
    found: dict[str, list[float]] = {name: [] for name in (*EVENT_MARGINS, *_FURTHER)}
    for impact in _first_impacts(graph, period):
        found["first_impact_speed"].append(-impact.approach_rate)
    for contact in _contacts(graph, period):
        found["gap_acceleration"].append(contact.push)
        found["locked_time"].append(contact.duration)
    for event in period.events:
        if isinstance(event, Release | SwitchEvent):
            fall = fall_at(graph, period.arcs, event)
            found[f"{event.kind.word}_transversality"] += [] if fall is None else [fall]
    return found


def _kept_speeds(graph: GraphDynamics, events: Sequence[Event]) -> list[float]:
    """Return the ratio of impact speed to initial speed of every flight of a phase.

    It tends to one as impacts accumulate, and to zero only if an impact grazes.
    """
    impacts = [event for event in events if isinstance(event, Impact)]
    kept: list[float] = []
    for one, other in pairwise(impacts):
        view = graph.view(graph.open_mode, graph.stop_names.index(one.stop))
        if view.restitution > 0.0:
            kept.append(-other.approach_rate / view.speed_after(one.approach_rate))
    return kept


def _shorter_periods(period: Period, scale: Vector) -> list[float]:
    """Return the distances of a period from several periods of each shorter event sequence."""
    names = [orbit_event_name(event) for event in period.events]
    sequence, found = sequence_of(names), list[float]()
    ends = [phase[-1] for phase in phases_of_events(names)]
    for k in range(1, len(sequence)):
        if len(sequence) % k == 0 and sequence[:k] * (len(sequence) // k) == sequence:
            away = np.max(np.abs(state_after(period.events[ends[k - 1]]) - period.begin) / scale)
            found.append(float(away) if away > _SAME else 0.0)
    return found


def measured_margin(name: str, graph: GraphDynamics, found: EventReturn) -> float | None:
    """Return a margin of a periodic return, or the smallest share. ``None`` without such an event.

    Args:
        name: Name of the margin.
        graph: The graph of modes.
        found: The return.
    """
    period = Period(
        events=found.events,
        opened=found.opened,
        arcs=tuple(arc for arc in found.execution.arcs if arc.start_time < found.period),
        start=0.0,
        end=found.period,
        begin=found.start,
        state=found.end,
    )
    if name == SHARE:
        return smallest_share(graph, period)
    return min(_at_events(graph, period)[name], default=None)


def smallest_share(graph: GraphDynamics, period: Period) -> float | None:
    r"""Return the smallest margin of all contacts, relative to its largest possible value.

    The contact duration is relative to the period. :math:`-\ddot h` at a Zeno point is relative to
    its largest value in the contact phase. The speed of a first impact is relative to the largest
    gap rate since the last event of its stop. Theory (5.3).

    Args:
        graph: The graph of modes.
        period: The period.

    Returns:
        The share, or ``None`` if no stop is struck.
    """
    shares: list[float] = []
    for impact in _first_impacts(graph, period):
        view = graph.view(graph.open_mode, graph.stop_names.index(impact.stop))
        flight = _flight_to(impact, period)
        if flight:
            shares.append(-impact.approach_rate / extent_of(view.gap_rate, flight).largest)
    for contact in _contacts(graph, period):
        shares += [contact.duration / period.duration, contact.push / contact.largest_push]
    return min(shares, default=None)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Contact:
    """A contact phase after a Zeno point.

    Attributes:
        duration: Its duration [s].
        push: Minus the gap acceleration at the Zeno point.
        pushes: Gap acceleration of the stop in each arc of the phase.
    """

    duration: float
    push: float
    pushes: tuple[tuple[Scalar, Arc], ...]

    @property
    def largest_push(self) -> float:
        """Largest modulus of the gap acceleration in the phase."""
        return max(extent_of(push, [arc]).largest for push, arc in self.pushes)


def _first_impacts(graph: GraphDynamics, period: Period) -> Iterator[Impact]:
    """Yield the first impact of every sequence."""
    quantities = period.quantities(graph)
    speeds = {
        (stop, one.value)
        for stop in graph.stop_names
        for one in quantities.readings(f"{stop}.impact_speed")
    }
    for impact in period.impacts:
        # The speeds are those of the events, bit for bit.
        if (impact.stop, -impact.approach_rate) in speeds:
            yield impact


def _contacts(graph: GraphDynamics, period: Period) -> Iterator[_Contact]:
    """Yield the contact phases of a period. The last one may go on over its end."""
    arcs = period.arcs
    for event in period.zeno_points:
        first = next((k for k, arc in enumerate(arcs) if arc.start_time >= event.time), 0)
        held: list[Arc] = []
        for arc in (*arcs[first:], *arcs[:first]):
            if event.stop not in arc.closed:
                break
            held.append(arc)
        if not held:
            continue
        stop = graph.stop_names.index(event.stop)
        pushes = [(graph.holding(arc.mode_in(graph), stop).gap_acceleration, arc) for arc in held]
        mode = held[0].mode_in(graph)
        yield _Contact(
            duration=sum(arc.duration for arc in held),
            push=-graph.holding(mode, stop).gap_acceleration(event.state),
            pushes=tuple(pushes),
        )


def _flight_to(impact: Impact, period: Period) -> list[Arc]:
    """Return the arcs from the last event of a stop to an impact on it."""
    arcs = period.arcs
    last = next((k for k, arc in enumerate(arcs) if arc.end_time == impact.time), None)
    if last is None:
        return []
    times = {event.time for event in period.events if event.what == impact.stop}
    flight: list[Arc] = []
    for arc in reversed((*arcs[last + 1 :], *arcs[: last + 1])):
        flight.append(arc)
        if arc.start_time in times:
            break
    return flight
