r"""The way along an execution with derivatives, event by event.

Every event is the zero of a guard :math:`g` along the flow `f` of its mode, as in theory (4.3):

.. math:: \delta t = -\frac{\nabla g\,V + g_p Q}{\dot g}, \qquad \delta x = V + f\,\delta t

The next arc starts at the event, so the jump of the flow at a switch adds no term of its own
(saltation). Impacts and Zeno points follow the formulas of their stop with the closed stops of the
mode as constraints, and a reset its own derivative.

Arcs of one view that the loop recorded are followed there, with the same formulas. The iteration
in Python serves all others, and is the reference.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.model import GAP, GAP_RATE, MULTIPLIER
from zeno_orbits.simulation.derivatives.sensitivity import (
    ImpactDerivative,
    SaltationDerivative,
    VariationalEquation,
    change_of,
)
from zeno_orbits.simulation.derivatives.tangent import course_of_arc, recorded_arcs
from zeno_orbits.simulation.events import (
    Event,
    EventKind,
    Impact,
    Release,
    SwitchEvent,
    ZenoPoint,
)
from zeno_orbits.simulation.execution import Arc, Ending, Execution, Mode

if TYPE_CHECKING:
    from zeno_orbits.simulation.derivatives.passages import EventDerivatives

_RESTS = 1e-9
"""Gap rate of a closed stop after an impact, relative to that of the impact, that is rounding."""

Crossing = tuple[Event, SaltationDerivative, SaltationDerivative]
"""An event with the derivatives of its time and of the states before and after it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ArcPassage:
    """An arc with the derivatives of its ends.

    Attributes:
        arc: The arc.
        start: Derivatives of its start.
        end: Derivatives of its end, before any reset. At the tail of an impact sequence they are
            those of the Zeno point. At the end of an execution they hold at a given time.
        crossings: The events at its end. The first arc also has the events at its start.
    """

    arc: Arc
    start: SaltationDerivative
    end: SaltationDerivative
    crossings: tuple[Crossing, ...]

    @property
    def after(self) -> SaltationDerivative:
        """Derivatives after the events at its end."""
        return self.crossings[-1][2] if self.crossings else self.end


class Walk:
    """The way along an execution, arc after arc."""

    def __init__(
        self,
        of: EventDerivatives,
        execution: Execution,
        place: int,
        start: SaltationDerivative | None,
    ) -> None:
        """Begin it, and pass the events at the start of its first arc.

        Args:
            of: The derivatives.
            execution: The execution.
            place: Index of the first arc.
            start: Derivatives of its start. By default it moves by itself, also off its stop.
        """
        self._of, self._execution = of, execution
        self._arcs, self._events = execution.arcs, execution.events
        self.place, self._here = place, of.at_start() if start is None else start
        self._bounces: list[ImpactDerivative] = []
        # The switches of dry friction since the last impact.
        self._beside: set[int] = set()
        self._crossings: list[Crossing] = []
        arc = self._arcs[place]
        # Events before an arc that is not the first do not count.
        self._n = sum(event.time <= arc.start_time for event in self._events) if place else 0
        at_start = [event for event in self._events[self._n :] if event.time == arc.start_time]
        for event in at_start:
            # A start off the stop flies to its impact.
            flies = bool(self._crossings) or isinstance(event, Impact)
            self._cross(event, arc, arc, caused=flies)
        self._launch(at_start, arc)
        stop = of.stop_of_flight(arc)
        is_fresh = start is None and not at_start
        if is_fresh and stop is not None and arc.flow_states[0, -2] == 0.0:
            self._here = self._left(arc, of.of_stop(arc, stop))

    @property
    def is_over(self) -> bool:
        """True after the last arc."""
        return self.place == len(self._arcs)

    def past(self) -> ArcPassage:
        """Pass the next arc and the events at its end.

        Raises:
            SimulationError: If a stop is touched there without an impact.
        """
        arc, following, start = self._arcs[self.place], self._following, self._here
        events, n_before = self._ending, len(self._crossings)
        if not events and arc.ending not in (Ending.SWITCH, Ending.HORIZON):
            raise _touched(arc)
        if arc.ending is Ending.HORIZON:
            self._here = self._at_given_time(arc)
        elif arc.ending is not Ending.ZENO:
            self._here = self._end(arc, events)
        end = self._here
        for event in events:
            self._cross(event, arc, following, caused=len(self._crossings) > n_before)
        if events:
            end = self._crossings[n_before][1]
        self._launch(events, following)
        return self._passage(start, end)

    def followed(self) -> list[ArcPassage]:
        """Pass the next arcs as the loop follows them: none if it did not record them."""
        # The loop needs a sequence of impacts from its first one on.
        joins = bool(self._bounces) and self._bounces[-1].impact is self._events[self._n - 1]
        if self._of.in_python or len(self._bounces) > joins:
            return []
        arcs = recorded_arcs(self._execution, self.place, self._n, joins=joins)
        if arcs is None:
            return []
        closed, stop, sides = arcs.view
        perturbations = self._of.at((closed, sides), stop)
        shifts = arcs.followed(perturbations, self._here)
        if not shifts:
            return []
        passages, struck = list[ArcPassage](), list[tuple[Impact, SaltationDerivative]]()
        for one, then in zip(shifts, [*shifts[1:], None], strict=True):
            events, end = self._ending, one.end
            if then is None and any(isinstance(event, ZenoPoint) for event in events):
                # The loop has the limit only at the start of the contact.
                break
            for event in events:
                before, self._here = one.end, one.after
                if isinstance(event, ZenoPoint) and then is not None:
                    before = self._here = then.start
                if isinstance(event, Impact):
                    struck.append((event, one.after))
                else:
                    struck.clear()
                self._add(event, before, self._here)
            if events and self._arcs[self.place].ending is Ending.ZENO:
                end = self._here
            passages.append(self._passage(one.start, end))
        if not passages:
            return []
        self._bounces, self._beside = [], set()
        for impact, after in struck if not self.is_over else ():
            self._bounces = perturbations.joined(self._bounces, impact, after)
        return passages

    def _passage(self, start: SaltationDerivative, end: SaltationDerivative) -> ArcPassage:
        """Return the passage of the next arc, and go on to the arc after it."""
        arc, crossings, self._crossings = self._arcs[self.place], tuple(self._crossings), []
        self.place += 1
        return ArcPassage(arc=arc, start=start, end=end, crossings=crossings)

    def _add(self, event: Event, before: SaltationDerivative, after: SaltationDerivative) -> None:
        self._crossings.append((event, before, after))
        self._n += 1

    @property
    def _following(self) -> Arc:
        """The arc after the next one, or the next one if it is the last."""
        return self._arcs[min(self.place + 1, len(self._arcs) - 1)]

    @property
    def _ending(self) -> list[Event]:
        """The events at the end of the next arc.

        Contact that takes no time ends with a release at the same time, which belongs to it.
        """
        arc, following, found = self._arcs[self.place], self._following, list[Event]()
        closed = () if following is arc else following.mode_in(self._of.graph)[0]
        for k in range(self._n, len(self._events)):
            event = self._events[k]
            held = isinstance(event, Release) and self._of.index(event.stop) in closed
            if event.time > arc.end_time or (found and held):
                break
            found.append(event)
        return found

    # Ends of arcs.

    def _end(self, arc: Arc, events: Sequence[Event]) -> SaltationDerivative:
        """Return the derivatives of the end of an arc, before any reset."""
        event = events[0] if events else None
        by_kind = None if event is None else self._ENDS.get(event.kind)
        return self._end_at_switch(arc, event) if by_kind is None else by_kind(self, arc, event)

    def _end_at_impact(self, arc: Arc, impact: Impact) -> SaltationDerivative:
        stop = self._of.index(impact.stop)
        if self._of.stop_of_flight(arc) == stop:
            return self._crossed(arc, None)
        contact = self._of.of_stop(arc, stop).differentials.contact(arc.end_state)
        return _with_gap_rate(self._crossed(arc, contact[GAP]), contact)

    def _end_at_release(self, arc: Arc, release: Release) -> SaltationDerivative:
        by = self._of.of_stop(arc, self._of.index(release.stop)).differentials
        return self._crossed(arc, by.contact(arc.end_state)[MULTIPLIER])

    def _end_at_switch(self, arc: Arc, event: Event | None) -> SaltationDerivative:
        """Return the derivatives at a switch, armed or not. An armed switch makes an event."""
        graph, switch = self._of.graph, self._switch_of(arc, event)
        mode = arc.mode_in(graph)
        gradient = graph.guard_gradient(switch, arc.end_state, self._of.chosen, mode)
        return self._crossed(arc, gradient)

    _ENDS: ClassVar[Mapping[EventKind, Callable[..., SaltationDerivative]]] = {
        EventKind.IMPACT: _end_at_impact,
        EventKind.RELEASE: _end_at_release,
    }
    """How an arc ends at the zero of the guard of an event, by the kind of the event."""

    def _switch_of(self, arc: Arc, event: Event | None) -> int:
        """Return the switch at the end of an arc: the event's, or one that is not armed.

        Raises:
            SimulationError: If the arc ends at no switch.
        """
        graph = self._of.graph
        if isinstance(event, SwitchEvent):
            return graph.switch_names.index(event.name)
        if not graph.n_declared:
            raise _touched(arc)
        guards, rounding, _ = graph.guards(arc.mode_in(graph), arc.end_state)
        declared = slice(graph.n_declared)
        return int(np.argmin(np.abs(guards[declared]) / np.maximum(rounding[declared], 1e-300)))

    def _crossed(self, arc: Arc, gradient: Vector | None) -> SaltationDerivative:
        """Return the derivatives of the zero of a guard at the end of an arc.

        Args:
            arc: The arc.
            gradient: Derivatives of the guard, or ``None`` for the gap that a flight carries.
        """
        n_x, start = arc.start_state.size, self._here
        perturbations, v, rate, longer = self._carried(arc)
        end = arc.flow_state_at(arc.duration)
        if gradient is None:
            delay = -v[n_x] / end[n_x + 1]
        else:
            change = gradient[:n_x] @ v[:n_x] + gradient[n_x:] @ perturbations.parameters
            delay = -change / (gradient[:n_x] @ rate[:n_x])
        v = v + rate[:, None] * delay
        by_rate = np.zeros_like(start.rate)
        if gradient is None:
            by_rate = end[n_x + 1] * start.rate + arc.time_unit * v[n_x + 1]
        time = start.time + longer + arc.time_unit * delay
        return SaltationDerivative(time=time, state=v[:n_x], rate=by_rate)

    def _carried(self, arc: Arc) -> tuple[VariationalEquation, Vector, Vector, Vector]:
        """Return the derivatives at the end of an arc of fixed duration, and its change in time.

        Returns:
            The equation of perturbations, the perturbations, ``(n_y, m)``, the rate of the flow,
            ``(n_y,)``, and by how much the arc takes longer since its unit of time moves, ``(m,)``.
        """
        start = self._here
        perturbations, mode, v, q = self._of.flow(arc, start)
        _, rows = course_of_arc(perturbations, arc, mode, v, q)
        flow, _ = perturbations.flow_of(arc, mode, len(v))
        is_flight = len(v) > arc.start_state.size
        longer = arc.duration * start.rate if is_flight else np.zeros_like(start.rate)
        return perturbations, rows[-1], flow.rate(arc.flow_state_at(arc.duration)), longer

    def _at_given_time(self, arc: Arc) -> SaltationDerivative:
        """Return the derivatives of the end of an arc that ends at a given time."""
        start, n_x = self._here, arc.start_state.size
        perturbations, v, rate, longer = self._carried(arc)
        later = (start.time + longer) / arc.time_unit
        zero = np.zeros_like(start.time)
        state = (v - rate[:, None] * later)[:n_x]
        moved = SaltationDerivative(time=zero, state=state, rate=zero)
        if arc.mode is Mode.LOCKED:
            return moved
        contact = perturbations.differentials.contact(arc.end_state)
        return _with_gap_rate(moved, contact)

    # Events.

    def _cross(self, event: Event, arc: Arc, following: Arc, *, caused: bool) -> None:
        """Pass an event at the end of an arc.

        Args:
            event: The event.
            arc: The arc.
            following: The arc after it.
            caused: Whether another event at the same time comes before it.
        """
        before, after = self._RESETS[event.kind](self, event, arc, following, caused=caused)
        self._here = after
        self._add(event, before, after)

    def _through_impact(
        self, impact: Impact, arc: Arc, following: Arc, *, caused: bool
    ) -> tuple[SaltationDerivative, SaltationDerivative]:
        before = self._before_impact(impact, arc, following, caused=caused)
        perturbations = self._struck(impact, arc, following)
        after = perturbations.struck(impact, before)
        # Only the impacts of one stop in one mode accumulate.
        goes_on = [one.impact.stop for one in self._bounces[-1:]] == [impact.stop]
        goes_on = goes_on and arc.closed == following.closed
        beside, self._beside = frozenset(self._beside), set()
        bounces = self._bounces if goes_on else ()
        self._bounces = perturbations.joined(bounces, impact, after, beside)
        return before, after

    def _through_zeno_point(
        self, zeno: ZenoPoint, arc: Arc, following: Arc, **_: bool
    ) -> tuple[SaltationDerivative, SaltationDerivative]:
        if not self._bounces:
            raise _touched(arc)
        perturbations = self._of.of_stop(following, self._of.index(zeno.stop))
        limit = perturbations.zeno_point(zeno, self._bounces)
        for place in self._of.graph.sticking(self._bounces[-1].estimate.beside):
            self._here = limit
            limit = self._reset(self._of.graph.reset_derivative(place, zeno.state, self._of.chosen))
        self._bounces = []
        return limit, limit

    def _through_release(
        self, release: Release, _: Arc, following: Arc, *, caused: bool
    ) -> tuple[SaltationDerivative, SaltationDerivative]:
        here = self._here
        # A release that another event causes changes nothing.
        if not caused:
            by = self._of.of_stop(following, self._of.index(release.stop)).differentials
            here = self._reset(by.resting(release.state)[: here.state.shape[0]])
            self._bounces = []
        return here, here

    def _through_switch(
        self, switch: SwitchEvent, *_: Arc, **__: bool
    ) -> tuple[SaltationDerivative, SaltationDerivative]:
        graph, here = self._of.graph, self._here
        place = graph.switch_names.index(switch.name)
        if place >= graph.n_declared:
            return here, here
        if place in graph.frictional:
            self._beside.add(place)
        else:
            self._bounces = []
        derivative = graph.reset_derivative(place, switch.state_minus, self._of.chosen)
        return here, self._reset(derivative)

    _RESETS: ClassVar[
        Mapping[EventKind, Callable[..., tuple[SaltationDerivative, SaltationDerivative]]]
    ] = {
        EventKind.IMPACT: _through_impact,
        EventKind.ZENO: _through_zeno_point,
        EventKind.RELEASE: _through_release,
        EventKind.SWITCH: _through_switch,
    }
    """Derivatives before and after an event, by its kind."""

    def _reset(self, derivative: Vector) -> SaltationDerivative:
        here = self._here
        state = change_of(derivative, here.state)
        return SaltationDerivative(time=here.time, state=state, rate=np.zeros_like(here.rate))

    def _launch(self, events: Sequence[Event], following: Arc) -> None:
        """Start a flight from another stop than the last struck, or after states are set anew.

        Args:
            events: The events at the start of the flight.
            following: The flight, or another arc, which needs nothing.
        """
        declared = self._of.graph.switch_names[: self._of.graph.n_declared]
        struck = [event.stop for event in events if isinstance(event, Impact)]
        is_kink = [isinstance(e, SwitchEvent) and e.name not in declared for e in events]
        left = following.stop_left
        if not left or all(is_kink):
            return
        perturbations = self._of.of_stop(following, self._of.index(left))
        if left not in struck[-1:]:
            self._here = self._on_gap(following.start_state, perturbations)
        elif any(isinstance(event, SwitchEvent) for event in events):
            # A reset keeps the gap at zero, and the rate may have changed with it.
            contact = perturbations.differentials.contact(following.start_state)
            self._here = _with_gap_rate(self._here, contact)

    def _before_impact(
        self, impact: Impact, arc: Arc, following: Arc, *, caused: bool
    ) -> SaltationDerivative:
        """Return the derivatives before an impact, with those of the gap rate.

        An impact at the time of another event is met by the flow after that event.
        """
        here = self._here
        if caused:
            perturbations = self._of.of_stop(following, self._of.index(impact.stop))
            return self._on_gap(impact.state_minus, perturbations)
        if here.rate.any():
            return here
        by = self._struck(impact, arc, following).differentials
        return _with_gap_rate(here, by.contact(impact.state_minus))

    def _on_gap(self, x: Vector, perturbations: VariationalEquation) -> SaltationDerivative:
        """Return the derivatives moved along the free flow to the zero of a gap, with its rate."""
        here = self._here
        contact, rates = perturbations.differentials.contact(x), perturbations.dynamics.free.rate(x)
        delay = -change_of(contact[GAP], here.state) / float(contact[GAP][: x.size] @ rates)
        moved = SaltationDerivative(
            time=here.time + delay,
            state=here.state + rates[:, None] * delay,
            rate=np.zeros_like(here.rate),
        )
        return _with_gap_rate(moved, contact)

    def _left(self, arc: Arc, perturbations: VariationalEquation) -> SaltationDerivative:
        """Return the derivatives of a start on the stop of its flight."""
        if perturbations.dynamics.gap_rate(arc.start_state) < arc.time_unit / 2:
            # It rests there. Only directions along the stop have a derivative.
            return _with_gap_rate(self._here, perturbations.differentials.contact(arc.start_state))
        # The flight came from its stop before or after the start.
        return self._on_gap(arc.start_state, perturbations)

    def _struck(self, impact: Impact, arc: Arc, following: Arc) -> VariationalEquation:
        """Return the derivatives of an impact in the mode that keeps its closed stops.

        An impulse opens a stop with a gap rate. A force may open one just after the impact.
        """
        graph, kept = self._of.graph, list[str]()
        for name in arc.closed:
            view = graph.view(graph.open_mode, self._of.index(name))
            rate = abs(view.gap_rate(impact.state_plus))
            if name != impact.stop and rate <= _RESTS * abs(impact.approach_rate):
                kept.append(name)
        closed, _ = graph.mode_of(kept, ())
        return self._of.at((closed, following.sides), self._of.index(impact.stop))


def _with_gap_rate(moved: SaltationDerivative, contact: Vector) -> SaltationDerivative:
    """Return the derivatives of an event with those of a gap rate, by the slopes of a contact."""
    return replace(moved, rate=change_of(contact[GAP_RATE], moved.state))


def _touched(arc: Arc) -> SimulationError:
    """Return the error of an arc that ends at a stop without an impact."""
    return SimulationError(
        "The derivative is undefined: a stop is touched without an impact",
        time=arc.end_time,
        state=tuple(arc.end_state.tolist()),
    )
