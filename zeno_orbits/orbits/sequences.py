"""Names of events, and the event sequence of a period: one entry per phase, named after its end."""

from __future__ import annotations

from collections.abc import Sequence

from zeno_orbits.errors import InputError
from zeno_orbits.orbits.shape import (
    NO_ZENO_ORBIT,
    SIMPLE_ORBIT,
    ZENO_ORBIT,
    EventSequence,
    PhaseKind,
)
from zeno_orbits.simulation import Event, Release, SwitchEvent


def kind_of_events(events: Sequence[tuple[str, float]]) -> str:
    """Return the name of an orbit by its events.

    At a plastic stop the Zeno point has the time of an impact, and no impacts accumulate.

    Args:
        events: Name and time of each event of a period, in order.
    """
    zenos = [(name.removeprefix("zeno "), t) for name, t in events if name.startswith("zeno ")]
    if not zenos:
        return NO_ZENO_ORBIT
    plastic = all((f"impact {stop}", time) in events for stop, time in zenos)
    return SIMPLE_ORBIT if plastic else ZENO_ORBIT


def shape_of_events(events: Sequence[Event], *, is_plastic: bool = False) -> EventSequence | None:
    """Return the phases that the events of a period form, or ``None`` if they form none.

    Args:
        events: Events of a period of one stop named `stop`, in order.
        is_plastic: Whether the stop is plastic, so that each impact ends a phase.
    """
    kinds, impacts, holds = list[PhaseKind](), 0, False
    for name in map(orbit_event_name, events):
        if (name == "release stop") is not holds:
            return None
        if name == "impact stop":
            impacts += 1
        elif name == "zeno stop":
            own = [PhaseKind.PLASTIC] if is_plastic else [PhaseKind.ZENO]
            kinds += [PhaseKind.IMPACT] * ((impacts - 1) * is_plastic) + own
            impacts = 0
        elif not holds:
            return None
        holds = name == "zeno stop"
    try:
        return EventSequence(phases=(*kinds, *[PhaseKind.IMPACT] * impacts)) if not holds else None
    except InputError:
        return None


def events_of_shape(shape: EventSequence) -> tuple[str, ...]:
    """Return the event sequence of the phases of one stop named `stop`.

    Args:
        shape: The phases.
    """
    held = ("impact stop", "zeno stop", "release stop")
    return sequence_of([name for kind in shape.phases for name in held[: 3 if kind.holds else 1]])


def sequence_of(names: Sequence[str]) -> tuple[str, ...]:
    """Return the event sequence of all events, without the impacts before their Zeno point.

    Args:
        names: Names of the events in order.
    """
    return tuple(names[phase[-1]] for phase in phases_of_events(names))


def events_as_listed(events: Sequence[Event], sequence: Sequence[str]) -> list[Event]:
    """Return the events of a period as an orbit lists them.

    Earlier files lack the releases that a switch causes.

    Args:
        events: The events.
        sequence: Event sequence of the orbit.
    """
    if sequence_of([orbit_event_name(event) for event in events]) == tuple(sequence):
        return list(events)
    switches = {event.time for event in events if isinstance(event, SwitchEvent)}
    return [one for one in events if not (isinstance(one, Release) and one.time in switches)]


def caused_releases(events: Sequence[Event], place: int) -> tuple[Release, ...]:
    """Return the releases that an event causes.

    Args:
        events: Events in order.
        place: Index of the event.
    """
    found: list[Release] = []
    for event in events[place + 1 :]:
        if not isinstance(event, Release) or event.time != events[place].time:
            break
        found.append(event)
    return tuple(found)


def sequence_as_listed(events: Sequence[Event], sequence: Sequence[str]) -> tuple[str, ...]:
    """Return the event sequence of a period as an orbit lists it.

    Args:
        events: The events.
        sequence: Event sequence of the orbit.
    """
    return sequence_of([orbit_event_name(one) for one in events_as_listed(events, sequence)])


def phases_of_events(names: Sequence[str]) -> list[list[int]]:
    """Return the indices of the events of each phase: impacts belong to their Zeno point.

    A kink that acts in the last two flights up to the Zeno point acts as often as flights are
    resolved. So it belongs to the Zeno point as well, from the first impact on.

    Args:
        names: Names of the events in order.
    """
    phases: list[list[int]] = []
    for k, name in enumerate(names):
        kind, _, what = name.partition(" ")
        phase = [k]
        if kind == "zeno":
            impact = f"impact {what}"
            own = {impact, *_kinks_of_flights(names[:k], impact)}
            while phases and names[phases[-1][-1]] in own:
                phase = phases.pop() + phase
            while names[phase[0]] not in (impact, name):
                phases.append([phase.pop(0)])
        phases.append(phase)
    return phases


def _kinks_of_flights(names: Sequence[str], impact: str) -> set[str]:
    """Return the switches in each of the last two flights between impacts on a stop.

    An event of the clock may fall into the last flight, but not into two. A single flight between
    two plastic impacts is no sequence that accumulates.

    Args:
        names: Names of events in order, of which the last is an impact on the stop.
        impact: Name of such an impact.
    """
    flights: list[set[str]] = []
    for name in reversed(names):
        if name == impact:
            flights.append(set())
        elif name.startswith("switch ") and flights:
            flights[-1].add(name)
        else:
            break
        if len(flights) > _FLIGHTS:
            break
    complete = flights[:-1]
    return complete[0] & complete[-1] if len(complete) == _FLIGHTS else set()


_FLIGHTS = 2
"""Flights before a Zeno point in each of which a kink of that sequence acts."""


def lasting_events(names: Sequence[str]) -> list[int]:
    """Return the indices of events without the kinks in the flights of impacts that accumulate.

    Args:
        names: Names of the events in order.
    """
    return [
        k
        for phase in phases_of_events(names)
        for k in phase
        if len(phase) == 1 or not names[k].startswith("switch ")
    ]


def orbit_event_name(event: Event) -> str:
    """Return the name of an event in orbit files, such as ``zeno knee``.

    Args:
        event: The event.
    """
    return f"{event.kind.word} {event.what}".rstrip()


def accumulating_events(names: Sequence[str]) -> dict[str, str]:
    """Return the Zeno point of each event that accumulates, by names.

    Args:
        names: Names of all events in order.
    """
    return {names[k]: names[phase[-1]] for phase in phases_of_events(names) for k in phase[:-1]}
