"""Margins: distances of a return from the loss of an event, and the contact phases of a return.

A family keeps its event sequence. It ends where a margin vanishes.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import FlowWithEvent
from zeno_orbits.model import GraphDynamics, HybridDynamics
from zeno_orbits.orbits.events.section import EventReturn, fall_at
from zeno_orbits.orbits.saddle import Saddle, nearest_saddle
from zeno_orbits.orbits.sequences import orbit_event_name, phases_of_events
from zeno_orbits.simulation import (
    Arc,
    Ending,
    Event,
    Impact,
    Lows,
    Release,
    SwitchEvent,
    ZenoPoint,
    lows_inside,
    samples_inside,
    state_before,
)


class MarginKind(Enum):
    """Kinds of margins, which are positive along a family. The value is the name in the output.

    ``AMPLITUDE`` is the largest range of any state over a few fixed phases of a return, in the
    problem's characteristic scales. It is smooth along a family, and zero at an equilibrium. The
    amplitude that a problem names is `orbit_amplitude`. ``FREQUENCY`` is the inverse of the time of
    a return. It is zero if a motion stalls, so that its period tends to infinity. ``STALL`` falls
    in proportion to the distance of the parameter from such an end at a saddle.
    """

    AMPLITUDE = "amplitude"
    FREQUENCY = "returns per second"
    STALL = "exponential of minus the time of a return over that of the nearest saddle"
    LOCK = "contact duration"
    ACCELERATION = "acceleration onto the stop at the Zeno point"
    FIRST_IMPACT = "speed of the first impact"
    NEAR_MISS = "least gap of an open stop"
    LATER_IMPACT = "speed of a later impact, relative to the flight before it"
    RELEASE_RATE = "rate of the multiplier at the release"
    ADHESION = "least multiplier of a closed stop"
    OPENING = "pull on a stop that a jump of the force or an impact opens"
    CUT = "distance from the separatrix of the impacts"
    EVENTS = "time since the previous event"
    SWITCH_RATE = "rate of the guard at a switch"
    SWITCH_MISS = "least guard of a switch that does not act"
    ARMED = "arming of a switch where its guard falls through zero"


@dataclass(frozen=True, slots=True, kw_only=True)
class Margin:
    """A margin of one of several returns.

    Attributes:
        loss: Its kind.
        place: Index of the return, from 0, or of the event in the event sequence.
        name: Name of the stop or switch, if its event is not in the event sequence.
    """

    loss: MarginKind
    place: int = 0
    name: str = ""


def margins_of_return(graph: GraphDynamics, found: EventReturn) -> Mapping[Margin, float]:
    """Return the distances of a return from every change of its event sequence.

    The place of a margin is the index of its event in the event sequence.

    Args:
        graph: The graph of modes.
        found: The return.
    """
    arcs = [arc for arc in found.execution.arcs if arc.start_time < found.period]
    phases = phases_of_events([orbit_event_name(event) for event in found.events])
    states = np.array([found.start, *(state_before(event) for event in found.events)])
    flights = {found.events[phase[0]].time for phase in phases}
    n_x = found.start.size
    inside = [
        arc.flow_states_at(arc.duration * _PARTS)[:, :n_x]
        for arc in arcs
        if arc.trajectory is not None and arc.end_time in flights
    ]
    # A state may be the same at every event.
    ranges = np.delete(np.ptp(np.concatenate([states, *inside]), axis=0), graph.first.clock)
    sizes = np.delete(graph.own.states(found.start.size), graph.first.clock)
    margins = {
        Margin(loss=MarginKind.AMPLITUDE): float(np.max(ranges / sizes)),
        Margin(loss=MarginKind.FREQUENCY): 1 / found.period,
    }
    saddle = saddle_of_return(graph, found)
    if saddle is not None:
        margins[Margin(loss=MarginKind.STALL)] = float(np.exp(-saddle.rate * found.period))
    before = 0.0
    contacts = contacts_of(found)
    # The end of a contact phase has a law of its own, theory (5.7).
    locked = {contact.place for contact in contacts}
    for place, phase in enumerate(phases):
        first, event = found.events[phase[0]], found.events[phase[-1]]
        if place not in locked:
            margins[Margin(loss=MarginKind.EVENTS, place=place)] = first.time - before
        before = event.time
        if isinstance(first, Impact):
            margins[Margin(loss=MarginKind.FIRST_IMPACT, place=place)] = -first.approach_rate
        kept = _least_kept(graph, [found.events[k] for k in phase])
        if kept is not None:
            margins[Margin(loss=MarginKind.LATER_IMPACT, place=place)] = kept
        if isinstance(event, Release | SwitchEvent):
            rate = fall_at(graph, arcs, event)
            if rate is not None:
                loss = (
                    MarginKind.RELEASE_RATE
                    if isinstance(event, Release)
                    else MarginKind.SWITCH_RATE
                )
                margins[Margin(loss=loss, place=place)] = rate
    for contact in contacts:
        margins[Margin(loss=MarginKind.LOCK, place=contact.place)] = contact.duration
    for key, value in _margins_outside(graph, found, arcs, phases):
        margins[key] = min(value, margins.get(key, value))
    return margins


_PARTS = np.array([0.25, 0.5, 0.75])
"""Fractions of an arc at which states are compared. Since they are fixed, the range is smooth."""


def _inside(arc: Arc, part: float) -> Vector:
    # The flow of a rescaled flight has further states.
    return arc.flow_state_at(part * arc.duration)[: arc.start_state.size]


def saddle_of_return(graph: GraphDynamics, found: EventReturn) -> Saddle | None:
    """Return the saddle near the slowest state of a return, or ``None``.

    Args:
        graph: The graph of modes.
        found: The return.
    """
    if graph.first.clock:
        # A clock does not rest.
        return None

    def flow_of(arc: Arc) -> FlowWithEvent:
        return graph.flow(arc.mode_in(graph))

    arcs = [arc for arc in found.execution.arcs if arc.start_time < found.period]
    return nearest_saddle(arcs, flow_of, graph.own.states(found.start.size))


def _least_kept(graph: GraphDynamics, events: Sequence[Event]) -> float | None:
    """Return the least ratio of impact speed to initial speed over the flights of a phase.

    It tends to one as impacts accumulate, and to zero only if an impact grazes.
    """
    impacts = [event for event in events if isinstance(event, Impact)]
    kept: list[float] = []
    for one, other in pairwise(impacts):
        view = graph.view(graph.open_mode, graph.stop_names.index(one.stop))
        if view.restitution > 0.0:
            kept.append(-other.approach_rate / view.speed_after(one.approach_rate))
    return min(kept, default=None)


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
        impact = next((one for one in reversed(earlier) if isinstance(one, Impact)), None)
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
    closed, sides = after.mode_in(graph)
    return graph.view((tuple(k for k in closed if k != stop), sides), stop)


# Events outside the event sequence.


@dataclass(frozen=True, slots=True, kw_only=True)
class _Guard:
    """A condition that holds along an arc, and whose loss is an event outside the event sequence.

    Attributes:
        flow: Flow of the arc with the condition as its guard.
        zero: Level at which the condition is zero: its own event ends or begins the arc there.
        is_above: Whether it holds above zero. A declared switch acts where its guard falls.
        is_declared: Whether it belongs to a declared switch.
    """

    flow: FlowWithEvent
    zero: float
    is_above: bool = True
    is_declared: bool = False

    def value(self, x: Vector) -> float:
        """Return the condition at a state."""
        return self.flow.guard(x)[0]


_Key = tuple[MarginKind, str]
"""Kind of a margin, and the name of its stop or switch."""

_LONG_FLIGHTS = 3
"""Number of flights of accumulating impacts that are sampled as any other flight."""
_ZERO, _JUMP = 1e-12, 1e-6
"""Size of a condition that is zero, over its scale, and least relative change that is a jump."""


def _margins_outside(
    graph: GraphDynamics, found: EventReturn, arcs: Sequence[Arc], phases: Sequence[Sequence[int]]
) -> Iterator[tuple[Margin, float]]:
    """Yield the distances of a return from events that are not in its event sequence.

    A condition is nearest to zero inside an arc, or at an event that turns its rate or makes it
    jump.
    """
    ends = [found.events[phase[-1]].time for phase in phases]
    flown = [arc for arc in arcs if arc.trajectory is not None]
    places = [bisect_left(ends, arc.end_time) for arc in flown]
    accumulating = _accumulating(found.events, phases)
    conditions = [_conditions(graph, arc, accumulating) for arc in flown]

    def is_armed(key: _Key, x: Vector, arc: Arc) -> bool:
        if key[0] is not MarginKind.SWITCH_MISS:
            return True
        switch = graph.switch_names.index(key[1])
        return switch >= graph.n_declared or graph.guards(arc.mode_in(graph), x)[2][switch] > 0.0

    lows = _lows(flown, conditions, found.events, phases)
    for arc, place, known, low in zip(flown, places, conditions, lows, strict=True):
        for key, guard in known.items():
            for x in low[key].states:
                if is_armed(key, x, arc):
                    yield Margin(loss=key[0], place=place, name=key[1]), guard.value(x)
    for k, after in enumerate(flown):
        before, place = flown[k - 1], places[k - 1]
        for key, guard in conditions[k - 1].items():
            other = conditions[k].get(key)
            x, y = before.end_state, after.start_state
            # Its rate may be zero at the event itself, as that of a gap at a kink of the speed.
            falls = lows[k - 1][key].falls
            rises = other is not None and lows[k][key].rises
            if other is None or not (falls or rises) or not is_armed(key, x, before):
                continue
            left, right = guard.value(x), other.value(y)
            ended, began = left <= guard.zero, right <= other.zero
            turns = guard.is_above != other.is_above
            jumps = turns or abs(right - left) > _JUMP * max(left, right)
            # The tail of a Zeno point lies between two arcs that do not meet.
            jumps = jumps and (after.start_time == before.end_time or k == 0)
            blind = guard.is_declared and jumps
            lost = guard.is_above or not blind
            if falls and not ended and lost and (jumps or (rises and not began)):
                yield Margin(loss=key[0], place=place, name=key[1]), left
            if rises and not began and jumps and not (blind and other.is_above):
                yield Margin(loss=key[0], place=places[k], name=key[1]), right
    yield from _of_contacts(graph, found, flown, places)
    yield from _of_arming(graph, found, arcs, ends)


def _lows(
    flown: Sequence[Arc],
    conditions: Sequence[Mapping[_Key, _Guard]],
    events: Sequence[Event],
    phases: Sequence[Sequence[int]],
) -> list[dict[_Key, Lows]]:
    """Return the minima of all conditions inside each arc."""
    # The first flights of accumulating impacts may be long.
    short = {events[k].time for phase in phases for k in phase[_LONG_FLIGHTS:]}
    inside = [samples_inside(arc, is_short=arc.end_time in short) for arc in flown]
    # A flow is asked once for all arcs on which a condition is its guard.
    together: dict[tuple[_Key, int], list[int]] = {}
    for k, known in enumerate(conditions):
        for key, guard in known.items():
            together.setdefault((key, id(guard.flow)), []).append(k)
    lows: list[dict[_Key, Lows]] = [{} for _ in flown]
    for (key, _), arcs in together.items():
        rates = conditions[arcs[0]][key].flow.guard_rates
        for k, one in zip(arcs, lows_inside([inside[k] for k in arcs], rates), strict=True):
            lows[k][key] = one
    return lows


def _accumulating(
    events: Sequence[Event], phases: Sequence[Sequence[int]]
) -> list[tuple[float, float, set[str]]]:
    """Return the first and last time of impacts that accumulate, and the kinks in their flights."""
    found: list[tuple[float, float, set[str]]] = []
    for phase in phases:
        members = [events[k] for k in phase]
        kinks = {event.name for event in members if isinstance(event, SwitchEvent)}
        if len(phase) > 1 and kinks:
            found.append((members[0].time, members[-1].time, kinks))
    return found


def _conditions(
    graph: GraphDynamics, arc: Arc, accumulating: Sequence[tuple[float, float, set[str]]]
) -> dict[_Key, _Guard]:
    """Return the gaps of open stops, multipliers of closed ones, and guards of switches."""
    mode = arc.mode_in(graph)
    found: dict[_Key, _Guard] = {}
    for k, name in enumerate(graph.stop_names):
        if k in mode[0]:
            view = graph.holding(mode, k)
            zero = _ZERO * view.own.multiplier
            found[MarginKind.ADHESION, name] = _Guard(flow=view.locked, zero=zero)
        else:
            view = graph.view(mode, k)
            zero = _ZERO * view.own.gap
            found[MarginKind.NEAR_MISS, name] = _Guard(flow=view.free, zero=zero)
    if not graph.switch_names:
        return found
    guards, levels, _ = graph.guards(arc.mode_in(graph), _inside(arc, 0.5))
    absorbed = {
        name
        for begin, end, names in accumulating
        if begin <= arc.start_time < end
        for name in names
    }
    for switch, name in enumerate(graph.switch_names):
        if name in absorbed:
            continue
        is_declared = switch < graph.n_declared
        is_above = guards[switch] > 0.0 if is_declared else arc.sides[switch - graph.n_declared]
        flow = graph.guard_flow(mode, switch, bool(is_above))
        found[MarginKind.SWITCH_MISS, name] = _Guard(
            flow=flow,
            zero=_LEVELS * float(levels[switch]),
            is_above=bool(is_above),
            is_declared=is_declared,
        )
    return found


_LEVELS = 1e3
"""Rounding levels at which the guard of a switch is zero."""


def _of_contacts(
    graph: GraphDynamics, found: EventReturn, arcs: Sequence[Arc], places: Sequence[int]
) -> Iterator[tuple[Margin, float]]:
    """Yield the margins of contacts that begin, and of contacts that end without a release.

    A jump of the force opens a stop, and so does a plastic impact after which the force pulls.
    """
    switched = {event.time for event in found.events if isinstance(event, SwitchEvent)}
    struck = {event.time: event.stop for event in found.events if isinstance(event, Impact)}
    for k, after in enumerate(arcs):
        before, place = arcs[k - 1], places[k - 1]
        closed, sides = after.mode_in(graph)
        for name in set(after.closed) - set(before.closed):
            view, x = (
                graph.holding((closed, sides), graph.stop_names.index(name)),
                after.start_state,
            )
            yield Margin(loss=MarginKind.ACCELERATION, place=place), -view.gap_acceleration(x)
        opened = set(before.closed) if before.ending is not Ending.RELEASE else set[str]()
        for name in opened - set(after.closed):
            mode, x = before.mode_in(graph), before.end_state
            held = graph.holding(mode, graph.stop_names.index(name))
            if held.multiplier_rate(x) < 0.0:
                yield Margin(loss=MarginKind.ADHESION, place=place, name=name), held.multiplier(x)
        if before.end_time not in switched:
            opened = {struck[before.end_time]} if before.end_time in struck else set[str]()
        for name in opened - set(after.closed):
            view = graph.view((closed, sides), graph.stop_names.index(name))
            if name in before.closed or view.restitution == 0.0:
                pull = -view.multiplier(after.start_state)
                yield Margin(loss=MarginKind.OPENING, place=place, name=name), pull


def _of_arming(
    graph: GraphDynamics, found: EventReturn, arcs: Sequence[Arc], ends: Sequence[float]
) -> Iterator[tuple[Margin, float]]:
    """Yield how far declared switches are armed where they act, and not armed where they do not."""
    acts = {event.time: event for event in found.events if isinstance(event, SwitchEvent)}
    for arc in arcs:
        if arc.ending is not Ending.SWITCH:
            continue
        guards, levels, _ = graph.guards(arc.mode_in(graph), arc.end_state)
        armed = graph.arming(arc.end_state)
        event, place = acts.get(arc.end_time), bisect_left(ends, arc.end_time)
        for switch in range(graph.n_declared):
            name = graph.switch_names[switch]
            if event is not None and event.name == name:
                yield Margin(loss=MarginKind.ARMED, place=place), float(armed[switch])
            elif event is None and abs(guards[switch]) <= _LEVELS * levels[switch]:
                mode = arc.mode_in(graph)
                if graph.guard_flow(mode, switch, above=True).guard(arc.end_state)[1] < 0.0:
                    key = Margin(loss=MarginKind.ARMED, place=place, name=name)
                    yield key, -float(armed[switch])
