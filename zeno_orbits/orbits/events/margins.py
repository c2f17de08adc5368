"""Margins: distances of a return from the loss of an event, and the contact phases of a return.

A family keeps its event sequence. It ends where a margin vanishes.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np

from zeno_orbits.model import GraphDynamics, HybridDynamics
from zeno_orbits.orbits.events.event_orbit import orbit_event_name, phases_of_events
from zeno_orbits.orbits.events.section import EventReturn, fall_at
from zeno_orbits.simulation import (
    Arc,
    Impact,
    Release,
    SwitchEvent,
    ZenoPoint,
    least_inside,
    state_before,
)


class MarginKind(Enum):
    """Kinds of margins, which are positive along a family. The value is the name in the output.

    ``AMPLITUDE`` is the largest range of any state over a few fixed phases of a return, in the
    problem's characteristic scales. It is smooth along a family, and zero at an equilibrium. The
    amplitude that a problem names is `orbit_amplitude`. ``FREQUENCY`` is the inverse of the time of
    a return. It is zero if a motion stalls, so that its period tends to infinity.
    """

    AMPLITUDE = "amplitude"
    FREQUENCY = "returns per second"
    LOCK = "locked time"
    ACCELERATION = "acceleration onto the stop at the Zeno point"
    FIRST_IMPACT = "speed of the first impact"
    NEAR_MISS = "least gap before the first impact"
    LATER_IMPACT = "speed of a later impact, relative to the flight before it"
    RELEASE_RATE = "rate of the multiplier at the release"
    ADHESION = "least multiplier on the locked arc"
    CUT = "distance from the separatrix of the impacts"
    EVENTS = "time since the previous event"
    SWITCH_RATE = "rate of the guard at a switch"


@dataclass(frozen=True, slots=True, kw_only=True)
class Margin:
    """A margin of one of several returns.

    Attributes:
        loss: Its kind.
        place: Index of the return, from 0.
    """

    loss: MarginKind
    place: int = 0


def margins_of_return(graph: GraphDynamics, found: EventReturn) -> Mapping[Margin, float]:
    """Return the distances of a return from the loss of an event.

    The place of a margin is the index of its event in the event sequence.

    Args:
        graph: The graph of modes.
        found: The return.
    """
    arcs = [arc for arc in found.execution.arcs if arc.start_time < found.period]
    states = np.array([found.start, *(state_before(event) for event in found.events)])
    ranges = np.delete(np.ptp(states, axis=0), graph.first.clock)
    sizes = np.delete(graph.own.states(found.start.size), graph.first.clock)
    margins = {
        Margin(loss=MarginKind.AMPLITUDE): float(np.max(ranges / sizes)),
        Margin(loss=MarginKind.FREQUENCY): 1 / found.period,
    }
    before = 0.0
    phases = phases_of_events([orbit_event_name(event) for event in found.events])
    ends = [found.events[phase[-1]].time for phase in phases]
    for place, phase in enumerate(phases):
        first, event = found.events[phase[0]], found.events[phase[-1]]
        if not isinstance(event, Release):
            # The end of a contact phase has a law of its own, theory (5.7).
            margins[Margin(loss=MarginKind.EVENTS, place=place)] = first.time - before
        before = event.time
        if isinstance(first, Impact):
            margins[Margin(loss=MarginKind.FIRST_IMPACT, place=place)] = -first.approach_rate
        if isinstance(event, Release | SwitchEvent):
            rate = fall_at(graph, arcs, event)
            if rate is not None:
                loss = (
                    MarginKind.RELEASE_RATE
                    if isinstance(event, Release)
                    else MarginKind.SWITCH_RATE
                )
                margins[Margin(loss=loss, place=place)] = rate
    for contact in contacts_of(found):
        margins[Margin(loss=MarginKind.LOCK, place=contact.place)] = contact.duration
    for arc in arcs:
        place = bisect_left(ends, arc.end_time)
        for loss, value in _least_guards(graph, arc):
            key = Margin(loss=loss, place=place)
            margins[key] = min(value, margins.get(key, value))
    return margins


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactPhase:
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


def contacts_of(found: EventReturn) -> list[ContactPhase]:
    """Return the contact phases of a return that end with a release.

    Args:
        found: The return. Its first contact phase may begin at its end.
    """
    phases = phases_of_events([orbit_event_name(event) for event in found.events])
    contacts: list[ContactPhase] = []
    for place, phase in enumerate(phases):
        # The phase before the first is the last phase of the previous period.
        *earlier, zeno = [found.events[k] for k in phases[place - 1]]
        release = found.events[phase[-1]]
        if not isinstance(release, Release) or not isinstance(zeno, ZenoPoint):
            continue
        impact = earlier[-1] if earlier else None
        if zeno.stop == release.stop and isinstance(impact, Impact):
            wait = release.time - zeno.time + (0.0 if place else found.period)
            contacts.append(ContactPhase(place=place, last_impact=impact, zeno=zeno, duration=wait))
    return contacts


def contact_view(graph: GraphDynamics, found: EventReturn, contact: ContactPhase) -> HybridDynamics:
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


def _least_guards(graph: GraphDynamics, arc: Arc) -> list[tuple[MarginKind, float]]:
    """Return the least gaps of open stops, and multipliers of closed ones, inside an arc."""
    if arc.trajectory is None:
        return []
    closed, sides = graph.mode_of(arc.closed, arc.sides)
    found: list[tuple[MarginKind, float]] = []
    for k in range(len(graph.stop_names)):
        if k in closed:
            view = graph.holding((closed, sides), k)
            least = least_inside(arc, view.multiplier, view.multiplier_rate)
            loss = MarginKind.ADHESION
        else:
            view = graph.view((closed, sides), k)
            least, loss = least_inside(arc, view.gap, view.gap_rate), MarginKind.NEAR_MISS
        if least is not None:
            found.append((loss, least))
    return found
