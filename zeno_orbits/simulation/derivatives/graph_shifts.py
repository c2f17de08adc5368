r"""Derivatives of the events of an execution over a graph of modes.

Every event is the zero of a guard :math:`g` along the flow `f` of its mode, as in theory (4.3):

.. math:: \delta t = -\frac{\nabla g\,V + g_p Q}{\dot g}, \qquad \delta x = V + f\,\delta t

The next arc starts at the event, so the jump of the flow at a switch needs no term of its own
(saltation). Impacts and Zeno points follow the formulas of their stop with the closed stops of the
mode as constraints, and a reset its own derivative.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.integrators import Tolerance
from zeno_orbits.model import (
    GAP,
    GAP_RATE,
    MULTIPLIER,
    GraphDynamics,
    GraphMode,
)
from zeno_orbits.simulation.derivatives.sensitivity import (
    Carry,
    ImpactDerivative,
    SaltationDerivative,
    VariationalEquation,
)
from zeno_orbits.simulation.derivatives.state_transition import carried_within
from zeno_orbits.simulation.derivatives.tangent import carried_by_loop, course_of_arc
from zeno_orbits.simulation.execution import (
    Arc,
    Ending,
    Event,
    Execution,
    Impact,
    Mode,
    Release,
    SwitchEvent,
    ZenoPoint,
)

_RESTS = 1e-9
"""Gap rate of a closed stop after an impact, relative to that of the impact, that is rounding."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ArcPassage:
    """An arc with the derivatives of its ends.

    Attributes:
        arc: The arc.
        start: Derivatives of its start.
        end: Derivatives of its end, before any reset.
        crossings: The events at its end, each with the derivatives of its time and of the states
            before and after it. The first arc also has the events at its start.
    """

    arc: Arc
    start: SaltationDerivative
    end: SaltationDerivative
    crossings: tuple[tuple[Event, SaltationDerivative, SaltationDerivative], ...]


@dataclass(kw_only=True)
class GraphShifts:
    """Derivatives along an execution over a graph of modes.

    Attributes:
        graph: The graph.
        chosen: Indices in ``p`` of the parameters of the derivatives, ``(k,)``.
        tolerance: Local error of steps that have to be taken anew.
        carry: How perturbations are carried along an arc.
    """

    graph: GraphDynamics
    chosen: tuple[int, ...]
    tolerance: Tolerance
    carry: Carry = carried_by_loop
    _known: dict[tuple[GraphMode, int], VariationalEquation] = field(
        default_factory=dict["tuple[GraphMode, int]", VariationalEquation]
    )

    def along(
        self, execution: Execution
    ) -> Iterator[tuple[Event, SaltationDerivative, SaltationDerivative]]:
        """Yield every event with the derivatives of its time and of the states before and after it.

        The columns of the derivatives are the states of the start, then the chosen parameters.
        Before an impact they include the gap rate. A Zeno point has one state.

        Args:
            execution: The execution. Its impacts must be resolved one by one.

        Raises:
            SimulationError: If an event has no derivative: a stop is touched without an impact.
        """
        for passage in self.passages(execution):
            yield from passage.crossings

    def passages(self, execution: Execution, *, to_horizon: bool = False) -> Iterator[ArcPassage]:
        """Yield every arc before the end of an execution, with derivatives as `along` has them.

        Args:
            execution: The execution. Its impacts must be resolved one by one.
            to_horizon: Whether the last arc counts, which ends at no event.

        Raises:
            SimulationError: If an event has no derivative: a stop is touched without an impact.
        """
        events = list(execution.events)
        arcs = execution.arcs
        here = self._start(arcs[0])
        bounces: list[ImpactDerivative] = []
        crossings: list[tuple[Event, SaltationDerivative, SaltationDerivative]] = []
        while events and events[0].time == arcs[0].start_time:
            first, caused = events.pop(0), bool(crossings)
            before = self._before(first, here, arcs[0], arcs[0], caused=caused)
            here, bounces = self._after(first, before, arcs[0], arcs[0], bounces, caused=caused)
            crossings.append((first, before, here))
        here = self._launched([first for first, _, _ in crossings], here, arcs[0])
        for arc, following in zip(arcs, (*arcs[1:], arcs[-1]), strict=True):
            if arc.ending is Ending.HORIZON:
                if to_horizon:
                    yield ArcPassage(arc=arc, start=here, end=here, crossings=())
                return
            start = end = here
            if arc.ending is not Ending.ZENO:
                here = end = self._end(arc, here, events)
            crossed: list[Event] = []
            while events and events[0].time <= arc.end_time:
                event, caused = events.pop(0), bool(crossed)
                before = self._before(event, here, arc, following, caused=caused)
                here, bounces = self._after(event, before, arc, following, bounces, caused=caused)
                if isinstance(event, ZenoPoint):
                    before = end = here
                crossings.append((event, before, here))
                crossed.append(event)
            if not crossed and arc.ending is not Ending.SWITCH:
                raise _touched(arc)
            here = self._launched(crossed, here, following)
            yield ArcPassage(arc=arc, start=start, end=end, crossings=tuple(crossings))
            crossings = []

    def course(self, passage: ArcPassage, *, parts: int) -> tuple[Vector, Vector]:
        """Return the derivatives of the state along an arc, at equal parts of every step.

        Args:
            passage: The arc, which has a flow.
            parts: Number of outputs per step.

        Returns:
            The flow's own times since the start of the arc, ``(n,)``, and the derivatives of the
            states at these times, ``(n, n_x, m)``. The start is the first of them.
        """
        perturbations, mode, v, q = self._flow(passage.arc, passage.start)
        times, rows = course_of_arc(perturbations, passage.arc, mode, v, q, parts=parts)
        return times, rows[:, : passage.arc.start_state.size]

    def courses(
        self, execution: Execution, parts: int
    ) -> Iterator[tuple[Arc, Vector, Vector, Vector]]:
        """Yield the derivatives along every arc, at equal times.

        Args:
            execution: The execution. Its impacts must be resolved one by one.
            parts: Number of evenly spaced points per step of the integrator.

        Yields:
            An arc, times from its start on, ``(n,)`` [s], the derivatives of the state there with
            respect to the start and the chosen parameters, ``(n, n_x, m)``, and their rates in
            time. The tail of a Zeno point and arcs that take no time are left out.

        Raises:
            SimulationError: If an event has no derivative: a stop is touched without an impact.
        """
        for passage in self.passages(execution, to_horizon=True):
            arc = passage.arc
            if arc.ending is not Ending.ZENO and arc.end_time > arc.start_time:
                yield arc, *self._at_equal_times(passage, parts)

    def _at_equal_times(self, passage: ArcPassage, parts: int) -> tuple[Vector, Vector, Vector]:
        """Return times, derivatives of the state at equal times, and their rates along an arc."""
        arc, start, n_x = passage.arc, passage.start, passage.arc.start_state.size
        offsets, shifts = self.course(passage, parts=parts)
        # Rounding may put the last time beyond the end of the arc.
        offsets = np.minimum(offsets, arc.duration)
        states = arc.flow_states_at(offsets)[:, :n_x]
        perturbations, mode, _, _ = self._flow(arc, start)
        _, differential = perturbations.flow_of(arc, mode, n_x)
        own = perturbations.dynamics
        rates = (own.locked if mode is Mode.LOCKED else own.free).rates(states)
        later = start.time + offsets[:, None] * (start.rate if arc.stop else 0.0)
        moved = shifts - rates[:, :, None] * later[:, None]
        every = np.broadcast_to(
            perturbations.parameters, (len(states), *perturbations.parameters.shape)
        )
        slopes = differential.linear(states) @ np.concatenate([moved, every], axis=1)
        return arc.start_time + offsets * arc.time_unit, moved, slopes

    def within(self, passage: ArcPassage, offsets: Vector) -> Vector:
        """Return the derivatives of the states inside an arc, ``(n, n_x, m)``.

        Args:
            passage: The arc, which has a flow.
            offsets: The flow's own times since the start of the arc, ``(n,)``.
        """
        arc = passage.arc
        perturbations, mode, v, q = self._flow(arc, passage.start)
        _, before = course_of_arc(perturbations, arc, mode, v, q)
        flow, differential = perturbations.flow_of(arc, mode, len(v))
        tolerance = perturbations.tolerance
        rows = carried_within(flow, differential, arc, tolerance, before, q, offsets)
        return rows[:, : arc.start_state.size]

    def rested(self, passage: ArcPassage, stop: str) -> tuple[Vector, Vector]:
        """Return the start of an arc moved onto a stop at rest, and its derivatives.

        Args:
            passage: The arc.
            stop: Name of the stop, which is open along the arc.

        Returns:
            The state, ``(n_x,)``, and its derivatives, ``(n_x, m)``.
        """
        arc = passage.arc
        perturbations = self._of(arc, self._index(stop))
        by_state = perturbations.differentials.resting(arc.start_state)[: arc.start_state.size]
        resting = perturbations.dynamics.resting(arc.start_state)
        return resting.state, self._total(by_state, passage.start)

    def _start(self, arc: Arc) -> SaltationDerivative:
        start = self._of(arc, self._some_stop(arc)).at_start()
        if not arc.stop:
            return start
        return self._of(arc, self._index(arc.stop)).launched(arc.start_state)

    def _of(self, arc: Arc, stop: int) -> VariationalEquation:
        """Return the derivatives of a stop in the mode of an arc, with that stop open."""
        closed, sides = self.graph.mode_of(arc.closed, arc.sides)
        return self._at((tuple(k for k in closed if k != stop), sides), stop)

    def _at(self, mode: GraphMode, stop: int) -> VariationalEquation:
        key = (mode, stop)
        if key not in self._known:
            view = self.graph.view(mode, stop)
            if view.differentiation is None:
                raise AssertionError("A compiled system has formulas.")
            self._known[key] = VariationalEquation(
                dynamics=view,
                differentials=view.differentiation.by(self.chosen),
                n_parameters=len(self.chosen),
                tolerance=self.tolerance,
                carry=self.carry,
            )
        return self._known[key]

    def _some_stop(self, arc: Arc) -> int:
        """Return a stop that is open along an arc, or a closed stop if all are closed."""
        return self.graph.some_stop(self.graph.mode_of(arc.closed, arc.sides))[1]

    # Ends of arcs.

    def _end(
        self, arc: Arc, start: SaltationDerivative, events: Sequence[Event]
    ) -> SaltationDerivative:
        """Return the derivatives of the end of an arc, before any reset."""
        event = events[0] if events and events[0].time <= arc.end_time else None
        if isinstance(event, Impact):
            stop = self._index(event.stop)
            if arc.stop in ("", event.stop):
                return self._of(arc, stop).flown(arc, start)
            gradient = self._of(arc, stop).differentials.contact(arc.end_state)[GAP]
            moved = self._crossed(arc, start, gradient)
            rate = self._of(arc, stop).differentials.contact(arc.end_state)[GAP_RATE]
            return SaltationDerivative(
                time=moved.time, state=moved.state, rate=self._total(rate, moved)
            )
        if isinstance(event, Release):
            stop = self._index(event.stop)
            gradient = self._of(arc, stop).differentials.contact(arc.end_state)[MULTIPLIER]
            return self._crossed(arc, start, gradient)
        switch = self._switch_of(arc, event)
        gradient = self.graph.guard_gradient(switch, arc.end_state, self.chosen, arc.sides)
        return self._crossed(arc, start, gradient)

    def _switch_of(self, arc: Arc, event: Event | None) -> int:
        """Return the switch at the end of an arc: the event's, or one that is not armed.

        Raises:
            SimulationError: If the arc ends at no switch.
        """
        if isinstance(event, SwitchEvent):
            return self.graph.switch_names.index(event.name)
        if not self.graph.n_declared:
            raise _touched(arc)
        guards, rounding, _ = self.graph.guards(arc.end_state, arc.sides)
        declared = slice(self.graph.n_declared)
        return int(np.argmin(np.abs(guards[declared]) / np.maximum(rounding[declared], 1e-300)))

    def _crossed(
        self, arc: Arc, start: SaltationDerivative, gradient: Vector
    ) -> SaltationDerivative:
        """Return the derivatives of the zero of a guard at the end of an arc."""
        n_x, unit = arc.start_state.size, arc.time_unit if arc.stop else 1.0
        perturbations, mode, v, q = self._flow(arc, start)
        v = self.carry(perturbations, arc, mode, v, q)
        flow, _ = perturbations.flow_of(arc, mode, len(v))
        rate = flow.rate(arc.flow_state_at(arc.duration))
        change = gradient[:n_x] @ v[:n_x] + gradient[n_x:] @ perturbations.parameters
        delay = -change / (gradient[:n_x] @ rate[:n_x])
        longer = arc.duration * start.rate if arc.stop else 0.0
        return SaltationDerivative(
            time=start.time + longer + unit * delay,
            state=(v + rate[:, None] * delay)[:n_x],
            rate=np.zeros_like(start.rate),
        )

    def _flow(
        self, arc: Arc, start: SaltationDerivative
    ) -> tuple[VariationalEquation, Mode, Vector, Vector]:
        """Return the flow of an arc, with the perturbations of its start and its parameters."""
        if arc.stop:
            perturbations = self._of(arc, self._index(arc.stop))
            v = np.concatenate([start.state, np.zeros((2, start.state.shape[1]))])
            q = np.concatenate([perturbations.parameters, start.rate[None, :]])
            return perturbations, Mode.FREE, v, q
        some = self._some_stop(arc)
        perturbations = self._of(arc, some)
        is_locked = some in self.graph.mode_of(arc.closed, arc.sides)[0]
        mode = Mode.LOCKED if is_locked else Mode.FREE
        return perturbations, mode, start.state, perturbations.parameters

    # Events.

    def _after(
        self,
        event: Event,
        here: SaltationDerivative,
        arc: Arc,
        following: Arc,
        bounces: list[ImpactDerivative],
        *,
        caused: bool,
    ) -> tuple[SaltationDerivative, list[ImpactDerivative]]:
        """Return the derivatives after an event, and the impacts of the sequence so far.

        A release that another event causes at the same time changes nothing.
        """
        n_x = arc.start_state.size
        if isinstance(event, Impact):
            perturbations = self._struck(event, arc, following)
            after = perturbations.struck(event, here)
            # Only the impacts of one stop in one mode accumulate.
            goes_on = [one.impact.stop for one in bounces[-1:]] == [event.stop]
            goes_on = goes_on and arc.closed == following.closed
            return after, perturbations.joined(bounces if goes_on else [], event, after)
        if isinstance(event, ZenoPoint):
            stop = self._index(event.stop)
            perturbations = self._of(following, stop)
            if event.tail == 0.0:
                impact, shift = bounces[-1].impact, bounces[-1].shift
                return perturbations.rested(impact, shift), []
            return perturbations.limit(bounces, event.state), []
        if isinstance(event, Release):
            if caused:
                return here, bounces
            stop = self._index(event.stop)
            perturbations = self._of(following, stop)
            by_state = perturbations.differentials.resting(arc.end_state)[:n_x]
            return self._moved(here, by_state), []
        switch = self.graph.switch_names.index(event.name)
        if switch >= self.graph.n_declared:
            return here, bounces
        derivative = self.graph.reset_derivative(switch, event.state_minus, self.chosen)
        return self._moved(here, derivative), []

    def _launched(
        self, events: Sequence[Event], here: SaltationDerivative, following: Arc
    ) -> SaltationDerivative:
        """Return the derivatives at the start of a flight from another stop than the last struck.

        Args:
            events: The events at the start of the arc.
            here: Derivatives after them.
            following: The arc.
        """
        struck = [event.stop for event in events if isinstance(event, Impact)]
        if not following.stop or following.stop in struck[-1:] or all(map(self._is_kink, events)):
            return here
        perturbations = self._of(following, self._index(following.stop))
        return self._on_gap(here, following.start_state, perturbations)

    def _is_kink(self, event: Event) -> bool:
        declared = self.graph.switch_names[: self.graph.n_declared]
        return isinstance(event, SwitchEvent) and event.name not in declared

    def _on_gap(
        self, here: SaltationDerivative, x: Vector, perturbations: VariationalEquation
    ) -> SaltationDerivative:
        """Return the derivatives moved along the free flow to the zero of a gap, with its rate."""
        contact, rates = perturbations.differentials.contact(x), perturbations.dynamics.free.rate(x)
        delay = -self._total(contact[GAP], here) / float(contact[GAP][: x.size] @ rates)
        moved = SaltationDerivative(
            time=here.time + delay,
            state=here.state + rates[:, None] * delay,
            rate=np.zeros_like(here.rate),
        )
        rate = self._total(contact[GAP_RATE], moved)
        return SaltationDerivative(time=moved.time, state=moved.state, rate=rate)

    def _index(self, stop: str) -> int:
        return self.graph.stop_names.index(stop)

    def _struck(self, impact: Impact, arc: Arc, following: Arc) -> VariationalEquation:
        """Return the derivatives of an impact in the mode that keeps its closed stops.

        An impulse opens a stop with a gap rate. A force may open one just after the impact.
        """
        kept: list[str] = []
        for name in arc.closed:
            view = self.graph.view(self.graph.open_mode, self._index(name))
            rate = abs(view.gap_rate(impact.state_plus))
            if name != impact.stop and rate <= _RESTS * abs(impact.approach_rate):
                kept.append(name)
        closed, _ = self.graph.mode_of(kept, ())
        return self._at((closed, following.sides), self._index(impact.stop))

    def _before(
        self,
        event: Event,
        here: SaltationDerivative,
        arc: Arc,
        following: Arc,
        *,
        caused: bool,
    ) -> SaltationDerivative:
        """Return the derivatives before an event, at an impact with those of the gap rate.

        An impact at the time of another event is met by the flow after that event.
        """
        if not isinstance(event, Impact) or (here.rate.any() and not caused):
            return here
        if caused:
            return self._on_gap(
                here, event.state_minus, self._of(following, self._index(event.stop))
            )
        contact = self._struck(event, arc, following).differentials.contact(event.state_minus)
        rate = self._total(contact[GAP_RATE], here)
        return SaltationDerivative(time=here.time, state=here.state, rate=rate)

    def _moved(self, here: SaltationDerivative, derivative: Vector) -> SaltationDerivative:
        return SaltationDerivative(
            time=here.time, state=self._total(derivative, here), rate=np.zeros_like(here.rate)
        )

    def _total(self, gradient: Vector, here: SaltationDerivative) -> Vector:
        """Return the change of a function, due to state and parameters."""
        n_x = here.state.shape[0]
        parameters = np.eye(len(self.chosen), here.state.shape[1], n_x)
        return np.asarray(gradient[..., :n_x] @ here.state + gradient[..., n_x:] @ parameters)


def _touched(arc: Arc) -> SimulationError:
    """Return the error of an arc that ends at a stop without an impact."""
    return SimulationError(
        "The derivative is undefined: a stop is touched without an impact",
        time=arc.end_time,
        state=tuple(arc.end_state.tolist()),
    )
