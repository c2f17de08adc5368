"""The legs of a period: flows of one mode, each up to one event.

A leg is made of the arcs of a simulation up to an event of the orbit. Arcs that end at no event are
one leg with the next arc. Of a sequence of impacts that accumulate, as many impacts are legs as the
extrapolation of the Zeno point needs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Array
from zeno_orbits.model import GraphDynamics, GraphMode, HybridDynamics
from zeno_orbits.orbits import EventReturn
from zeno_orbits.search.program.closure import closure_of
from zeno_orbits.simulation import Arc, Ending, Event, Impact, Release, SwitchEvent, ZenoPoint


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tail:
    """The impacts of a sequence whose limit is a Zeno point.

    Attributes:
        legs: Places of the legs that end at the resolved impacts, in order.
        nodes: Places of those that determine the limit.
        error: Estimated relative error of the limit.
    """

    legs: tuple[int, ...]
    nodes: tuple[int, ...]
    error: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Leg:
    """A flow in one mode up to one event.

    Attributes:
        mode: The mode.
        stop: Index of the stop that a rescaled flight has just left, ``None`` in a plain flow.
        pieces: The arcs.
        ending: Kind of the event. A Zeno point is the end of the leg of the last resolved impact.
        index: Index of the stop, or of the switch.
        event: The event. At a Zeno point it is the last resolved impact.
        after: The mode after it, ``None`` if the simulation ends there.
        tail: The sequence that ends there, ``None`` at any other event and at a plastic impact.
    """

    mode: GraphMode
    stop: int | None
    pieces: tuple[Arc, ...]
    ending: Ending
    index: int
    event: Event
    after: GraphMode | None
    tail: Tail | None = None

    @property
    def strikes(self) -> bool:
        """True if the leg ends at an impact."""
        return self.ending in (Ending.IMPACT, Ending.ZENO)

    @property
    def unit(self) -> float:
        """Length of one unit of the flow's own time [s]."""
        return self.pieces[0].time_unit if self.stop is not None else 1.0

    @property
    def spans(self) -> Array:
        """Length of each arc [s]."""
        return np.array([arc.end_time - arc.start_time for arc in self.pieces])

    @property
    def duration(self) -> float:
        """Length in the flow's own time."""
        if self._is_one_flow:
            return self.pieces[0].duration
        return float(np.sum(self.spans)) / self.unit

    @property
    def _is_one_flow(self) -> bool:
        """True for one arc in the leg's own time. A flight that a switch interrupts goes on."""
        return len(self.pieces) == 1 and (self.stop is not None or not self.pieces[0].stop)

    def struck(self, graph: GraphDynamics) -> HybridDynamics:
        """Return the system of the stop of its impact, in the mode before it."""
        return graph.view(without(self.mode, self.index), self.index)

    def trajectory(self, graph: GraphDynamics, fractions: Array) -> Array:
        """Return the states of the flow at fractions of the leg, ``(n, n_y)``.

        Args:
            graph: The graph of modes.
            fractions: The fractions, ``(n,)``.
        """
        if self._is_one_flow:
            arc = self.pieces[0]
            return arc.flow_states_at(np.clip(fractions, 0.0, 1.0) * arc.duration)
        spans = self.spans.tolist()
        times = np.clip(fractions, 0.0, 1.0) * sum(spans)
        states = np.empty((len(times), len(self.pieces[0].start_state)))
        begin = 0.0
        for arc, span in zip(self.pieces, spans, strict=True):
            # The end of the last arc may be rounded.
            own = times >= begin
            states[own] = arc.states_at(arc.start_time + times[own] - begin)
            begin += span
        if self.stop is None:
            return states
        view = graph.view(self.mode, self.stop)
        scaled = [(view.gap(x) / self.unit**2, view.gap_rate(x) / self.unit) for x in states]
        return np.hstack([states, scaled])


def without(mode: GraphMode, stop: int) -> GraphMode:
    """Return a mode with a stop open.

    Args:
        mode: The mode.
        stop: Index of the stop.
    """
    closed, sides = mode
    return tuple(k for k in closed if k != stop), sides


def legs_of(graph: GraphDynamics, found: EventReturn, tolerance: float) -> tuple[Leg, ...]:
    """Return the legs of a return to a section.

    Args:
        graph: The graph of modes.
        found: The return. It need not be closed.
        tolerance: Largest relative error of a Zeno point.
    """
    return _closed(graph, _walked(graph, found), tolerance)


def _walked(graph: GraphDynamics, found: EventReturn) -> list[Leg]:
    """Return the legs of all events. At each Zeno point a leg ends with the impact before it."""
    arcs, events = found.execution.arcs, list(found.events)
    while events and events[0].time <= arcs[0].start_time:
        events.pop(0)
    legs: list[Leg] = []
    pieces: list[Arc] = []
    for k, arc in enumerate(arcs):
        if not events:
            break
        following = arcs[k + 1] if k + 1 < len(arcs) else None
        after = None if following is None else following.mode_in(graph)
        if arc.trajectory is None:
            while events and not isinstance(events[0], ZenoPoint):
                events.pop(0)
            events = events[1:]
            legs[-1] = replace(legs[-1], ending=Ending.ZENO, after=after)
            continue
        pieces.append(arc)
        if events[0].time > arc.end_time:
            # A guard that falls without an event ends an arc, and the flow goes on.
            continue
        event = events.pop(0)
        is_tail_next = following is not None and following.trajectory is None
        while events and events[0].time <= arc.end_time and not is_tail_next:
            # Stops that an impact opens, and the Zeno point of a plastic impact.
            events.pop(0)
        first = pieces[0]
        legs.append(
            Leg(
                mode=first.mode_in(graph),
                stop=graph.stop_names.index(first.stop_left) if first.stop_left else None,
                pieces=tuple(pieces),
                ending=_ENDINGS[type(event)],
                index=_index_of(graph, event),
                event=event,
                after=after,
            )
        )
        pieces = []
    return legs


_ENDINGS = {
    Impact: Ending.IMPACT,
    ZenoPoint: Ending.ZENO,
    Release: Ending.RELEASE,
    SwitchEvent: Ending.SWITCH,
}


def _index_of(graph: GraphDynamics, event: Event) -> int:
    """Return the index of the switch or stop of an event."""
    if isinstance(event, SwitchEvent):
        return graph.switch_names.index(event.name)
    return graph.stop_names.index(event.stop)


def _closed(graph: GraphDynamics, legs: Sequence[Leg], tolerance: float) -> tuple[Leg, ...]:
    """Return the legs up to the impacts that each Zeno point needs."""
    kept: list[Leg] = []
    first = 0
    for leg in legs:
        last = kept[-1] if kept else None
        goes_on = (
            last is not None
            and last.ending is Ending.IMPACT
            and leg.strikes
            and leg.stop == leg.index == last.index
        )
        if not goes_on:
            first = len(kept)
        kept.append(leg)
        if leg.ending is not Ending.ZENO or leg.struck(graph).restitution == 0.0:
            continue
        run = kept[first:]
        impacts = [one.event for one in run if isinstance(one.event, Impact)]
        closure = closure_of(impacts, leg.struck(graph), tolerance)
        del kept[first + closure.n_impacts :]
        places = tuple(range(first, len(kept)))
        kept[-1] = replace(
            kept[-1],
            ending=Ending.ZENO,
            after=leg.after,
            tail=Tail(
                legs=places,
                nodes=tuple(first + node for node in closure.nodes),
                error=closure.error,
            ),
        )
    return tuple(kept)
