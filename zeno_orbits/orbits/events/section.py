r"""Returns to a section after an event, their derivatives, and the orbit as a fixed point.

The section is the set of states just after one kind of event. A start on it is a state of the
section: its closed stops are projected onto zero gap and rate, and a stop that the event has just
left onto zero gap. Newton's method solves :math:`P(x) - x = 0` with the derivative of theory (4.3).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from itertools import pairwise
from statistics import linear_regression

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import EventlessError, InputError, SimulationError, UnsettledError
from zeno_orbits.model import GraphDynamics, event_of_setting, require_zeno_points
from zeno_orbits.orbits.looser_run import extrapolated
from zeno_orbits.orbits.section import (
    IMPACT_ROWS,
    RELEASE_ROWS,
    REST_ROWS,
    Section,
    conditions_gradient,
    differentials_of,
    project_to_section,
    section_of,
)
from zeno_orbits.orbits.sequences import (
    accumulating_events,
    caused_releases,
    orbit_event_name,
    sequence_as_listed,
    sequence_of,
)
from zeno_orbits.simulation import (
    Arc,
    ArcPassage,
    Completion,
    Ending,
    Event,
    EventDerivatives,
    Execution,
    Release,
    SaltationDerivative,
    SimulationSettings,
    SwitchEvent,
    simulate,
    state_after,
)

_WAIT, _LONGEST = 1.05, 4.0
"""Times to wait for a return, in units of its guess. The mode after its end must be seen."""
_AT_ONCE = 1e-9
"""Part of the period in which an event belongs to the start."""
_CORRECTIONS, _ON = 6, 1e-15
"""Corrections of a state onto its constraints, and a deviation that is rounding."""
_HELD = 1e-6
"""Size of a held state that is zero, in its scale."""
_MOST_ITERATIONS = 30
_EXACT = 3e-14
"""Relative correction below which Newton's method has converged to rounding."""
_MISSED = 1e-6
"""Largest relative change over an orbit. That of a correction to rounding is larger beside an orbit
that repels strongly."""
_NEUTRAL = 1e-12
"""Distance of a multiplier from 1 that is rounding."""
_ROUNDED = 1e-9
"""Relative correction below which Newton's method ends at a correction that is not smaller."""
_DECAYED = 1e-6
"""Share of the largest size of a state, in own sizes, below which it is not a unit of a step."""
_SPACINGS = 4.0
"""Roundings of the times of a period that add up: of two switches, by the clock and by the root."""
_SHRINKS, _HALVES = 0.1, 0.5
"""Largest ratios of successive corrections with which a derivative serves again, and one that was
estimated from returns alone."""
_NEAR = 0.05
"""Relative distance of two states after events, below which a motion nearly repeats."""
_THERE, _ANY = 1e-4, 1.0
"""Distance below which an early return counts although the motion does not come nearer, and largest
distance of a return with a given event sequence."""
_MOST_RETURNS = 200
_NEARER, _SETTLED = 10.0, 1e-6
"""A motion repeats after the fewest returns whose distance is at most this many times the smallest,
or this distance."""
_SEEN, _CLEARLY, _CLOSE = 12, 1.0, 1e-3
"""Fewest returns by which a motion converges, least fall of the logarithm of their distances, and
distance from the orbit at which Newton's method is sure to converge."""
_ONE_START = 2e-6
"""Relative distance of the starts of an orbit that was closed over fewer returns."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SectionMode:
    """The mode of a motion just after an event.

    Attributes:
        closed: Names of the closed stops.
        sides: Side of every kink.
        stop: Name of the stop that the event has just left, other than at contact force zero, or
            empty.
        rested: Name of an open stop with gap and gap rate zero, at which states are set, or empty.
        released: Name of the stop that has just been released at contact force zero, or empty.
    """

    closed: tuple[str, ...]
    sides: tuple[bool, ...]
    stop: str
    released: str = ""
    rested: str = ""

    @classmethod
    def of(cls, first: Arc, events: Sequence[Event]) -> SectionMode:
        """Return the mode of the first arc of a motion.

        Args:
            first: The arc.
            events: Events up to the event at which it starts, in order.
        """
        found = cls.in_mode(first.closed, first.sides, events)
        return replace(found, stop=first.stop_left or found.stop)

    @classmethod
    def in_mode(
        cls, closed: tuple[str, ...], sides: tuple[bool, ...], events: Sequence[Event]
    ) -> SectionMode:
        """Return the mode of a motion from its closed stops.

        Args:
            closed: Names of the closed stops.
            sides: Side of every kink.
            events: Events up to the event at which the mode starts, in order.
        """
        kind, _, name = orbit_event_name(events[-1]).partition(" ")
        setting = event_of_setting(name) if kind == "switch" else ""
        if setting:
            kind, _, name = setting.partition(" ")
            rests = kind != "impact" and name not in closed
            left = name if kind == "impact" and name not in closed else ""
            return cls(closed=closed, sides=sides, stop=left, rested=name if rests else "")
        left = "" if name in closed else name
        is_caused = any(event.time == events[-1].time for event in events[:-1])
        # At a release that another event causes, the contact force is not zero.
        is_thrown = kind == "impact" or (kind == "release" and is_caused)
        return cls(
            closed=closed,
            sides=sides,
            stop=left if is_thrown else "",
            released=left if kind == "release" and not is_caused else "",
        )

    @classmethod
    def after(cls, execution: Execution, section: str, *times: float) -> SectionMode | None:
        """Return the mode just after an event.

        Args:
            execution: The execution.
            section: Name of the event.
            times: When it occurs [s]. The first time after which the execution goes on counts.

        Returns:
            The mode, or ``None`` if the execution ends at all times.
        """
        names = [orbit_event_name(event) for event in execution.events]
        for time in times:
            first = next((arc for arc in execution.arcs if arc.start_time >= time), None)
            last = [k for k, event in enumerate(execution.events) if event.time == time]
            place = next((k for k in last if names[k] == section), None)
            if first is not None and place is not None:
                return cls.of(first, execution.events[: place + 1])
        return None


@dataclass(frozen=True, slots=True, kw_only=True)
class EventSection:
    """A section of a machine with several stops or switches.

    Attributes:
        name: Name of the event.
        n_returns: Number of such events in a period.
        sequence: Event sequence of a period.
        mode: The mode just after the event.
        openings: The releases that other events cause, by `openings_of`.
    """

    name: str
    n_returns: int
    sequence: tuple[str, ...]
    mode: SectionMode
    openings: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class EventReturn:
    """A return to a section, and its derivatives, which are computed at the first use.

    Attributes:
        start: The start, ``(n_x,)``.
        end: State just after the last event, ``(n_x,)``.
        period: Time of the return [s].
        events: Events of the return. The return ends at the last event.
        execution: The execution, beyond the end of the return.
        differentiation: Derivatives along executions.
    """

    start: Vector
    end: Vector
    period: float
    events: tuple[Event, ...]
    execution: Execution
    differentiation: EventDerivatives

    @property
    def opened(self) -> tuple[Release, ...]:
        """Releases that the last event causes, at the start of the next return."""
        return caused_releases(self.execution.events, len(self.events) - 1)

    @property
    def arcs(self) -> tuple[Arc, ...]:
        """Arcs of the return."""
        return tuple(arc for arc in self.execution.arcs if arc.end_time <= self.period)

    @property
    def by_state(self) -> Vector:
        """Derivative of the end with respect to the start, ``(n_x, n_x)``.

        A start beside the stop that it leaves is moved onto it first.
        """
        return self._by_start[:, : len(self.start)]

    @property
    def by_parameters(self) -> Vector:
        """Derivative of the end with respect to the parameters, ``(n_x, k)``.

        The start stays on the stop that it leaves, which parameters may move.
        """
        return self._by_start[:, len(self.start) :]

    @property
    def shifts(self) -> tuple[SaltationDerivative, ...]:
        """Derivatives of every event, with the state before it. Columns: start, parameters."""
        return self._derivatives[1]

    @property
    def after(self) -> tuple[SaltationDerivative, ...]:
        """Derivatives of every event, with the state after it. Columns: start, parameters."""
        return self._derivatives[0]

    @property
    def landing(self) -> SaltationDerivative:
        """Derivatives of the last event, with the state after it. Columns: start, parameters.

        They are those of starts in the section, which moves with the parameters.
        """
        return self.after[-1]

    @property
    def mode(self) -> SectionMode:
        """Mode just after the event of the section."""
        return SectionMode.of(self.execution.arcs[0], self.events)

    @cached_property
    def passages(self) -> tuple[ArcPassage, ...]:
        """The arcs of the return, with derivatives of their ends.

        Raises:
            SimulationError: If an event lacks a derivative.
        """
        found: list[ArcPassage] = []
        n_crossed = 0
        for passage in self.differentiation.passages(self.execution):
            found.append(passage)
            n_crossed += len(passage.crossings)
            if n_crossed >= len(self.events):
                return tuple(found)
        raise SimulationError(
            "The last event of a return lacks a derivative",
            time=self.period,
            state=tuple(self.start.tolist()),
        )

    @cached_property
    def _by_start(self) -> Vector:
        """Derivative of the end with respect to the start and the parameters, ``(n_x, n_x + k)``.

        A flight returns to the gap from which it starts, so a start off its stop would stay off it.
        """
        first, graph = self.execution.arcs[0], self.differentiation.graph
        end, n_x = self.landing.state, len(self.start)
        if not first.stop_left:
            return end
        scale = largest_states(self.execution.arcs, graph)
        view = graph.view(first.mode_in(graph), graph.stop_names.index(first.stop_left))
        slopes = conditions_gradient(view, self.differentiation.chosen, IMPACT_ROWS, self.start)
        chart = section_of(slopes[:, :n_x] * scale, self.start, scale)
        back = scale[:, None] * chart.normal
        # Along the constraints. A motion drifts off those, as off the circle of its clock.
        onto = np.eye(n_x) - back[:, :1] * slopes[:1, :n_x]
        moved = end[:, n_x:] - end[:, :n_x] @ back @ slopes[:, n_x:]
        return np.concatenate([end[:, :n_x] @ onto, moved], axis=1)

    @cached_property
    def _derivatives(self) -> tuple[tuple[SaltationDerivative, ...], ...]:
        """Derivatives of every event with the state after it, and with the state before it."""
        crossings = [one for passage in self.passages for one in passage.crossings]
        crossings = crossings[: len(self.events)]
        return tuple(one[2] for one in crossings), tuple(one[1] for one in crossings)


def event_return(
    graph: GraphDynamics,
    x: Vector,
    *,
    section: str,
    n_returns: int,
    guess: float,
    settings: SimulationSettings,
    parameters: Sequence[int] = (),
    mode: SectionMode | None = None,
    completion: Completion | None = None,
    sequence: Sequence[str] | None = None,
    openings: Sequence[str] | None = None,
) -> EventReturn:
    """Return the n-th next event of a kind after a start, with derivatives.

    Args:
        graph: The graph of modes.
        x: The start, ``(n_x,)``.
        section: Name of the event.
        n_returns: Number of events of the section until the return.
        guess: Approximate time of the return [s].
        settings: Accuracy.
        parameters: Indices in ``p`` of the parameters of the derivatives.
        mode: The mode just after the event, by which the start is projected.
        completion: Method by which Zeno points are reached. It must resolve the impacts. The
            default is the extrapolation of the settings.
        sequence: The event sequence that the return must have. The default is any.
        openings: The releases that other events cause, by `openings_of`. The default is any.

    Raises:
        SimulationError: If the event does not follow within a few times the guess, or the event
            sequence is another.
    """
    start = x if mode is None else on_section(graph, x, mode)
    exact = _resolving(settings, completion)
    execution, end = _run_to_return(graph, start, section, n_returns, guess, exact)
    last = next(
        k
        for k, event in enumerate(execution.events)
        if orbit_event_name(event) == section and event.time == end
    )
    events = tuple(execution.events[: last + 1])
    if sequence is not None and sequence_as_listed(events, sequence) != tuple(sequence):
        passed = sequence_of([orbit_event_name(event) for event in events])
        raise SimulationError(
            f"The event sequence changes to `{', '.join(passed)}`",
            time=end,
            state=tuple(x.tolist()),
        )
    if openings is not None and openings_of(events) != tuple(openings):
        raise SimulationError("Another event opens a stop", time=end, state=tuple(x.tolist()))
    return EventReturn(
        start=np.asarray(execution.arcs[0].start_state),
        end=state_after(events[-1]),
        period=end,
        events=events,
        execution=execution,
        differentiation=EventDerivatives(graph, parameters, exact.tolerance),
    )


def _run_to_return(
    graph: GraphDynamics,
    start: Vector,
    section: str,
    n_returns: int,
    guess: float,
    exact: SimulationSettings,
) -> tuple[Execution, float]:
    """Return an execution that reaches the n-th event of a section, and the time of this event.

    Raises:
        SimulationError: If the event does not follow within a few times the guess.
    """
    past = section.removeprefix("switch ")
    try:
        execution = simulate(graph, start, until=_WAIT * guess, settings=exact, past=past)
        execution = released_at_start(execution, section)
    except InputError as error:
        # An iterate of Newton's method may lie inside of a stop.
        raise SimulationError(
            f"A return cannot start: {error}", time=0.0, state=tuple(start.tolist())
        ) from error
    times = _times_of(execution, section, guess)
    if len(times) < n_returns or times[n_returns - 1] == execution.end_time:
        execution = simulate(graph, start, until=_LONGEST * guess, settings=exact, past=past)
        execution = released_at_start(execution, section)
        times = _times_of(execution, section, guess)
    if len(times) < n_returns:
        raise SimulationError(
            f"The event `{section}` does not follow {n_returns} times",
            time=execution.end_time,
            state=tuple(execution.end_state.tolist()),
        )
    return execution, times[n_returns - 1]


def released_at_start(execution: Execution, section: str) -> Execution:
    """Return an execution from the release with which it begins, if that is the section.

    A start at a release may be in contact for a while: by rounding, or since the contact force
    rises there. That contact belongs to the start.

    Args:
        execution: The execution.
        section: Name of the event at its start.
    """
    begin = next(iter(execution.events), None)
    if not isinstance(begin, Release) or orbit_event_name(begin) != section:
        return execution
    arcs = [
        replace(one, start_time=one.start_time - begin.time, end_time=one.end_time - begin.time)
        for one in execution.arcs
        if one.start_time >= begin.time
    ]
    events = [replace(one, time=one.time - begin.time) for one in execution.events[1:]]
    return replace(execution, arcs=tuple(arcs), events=tuple(events)) if arcs else execution


@lru_cache(maxsize=64)
def _resolving(settings: SimulationSettings, completion: Completion | None) -> SimulationSettings:
    """Return settings that resolve impacts. They are asked for at every return."""
    return replace(settings, completion=completion or extrapolated(settings))


def _times_of(execution: Execution, section: str, guess: float) -> list[float]:
    """Return the times of an event after the start."""
    return [
        event.time
        for event in execution.events
        if orbit_event_name(event) == section and event.time > _AT_ONCE * guess
    ]


def on_section(graph: GraphDynamics, x: Vector, mode: SectionMode) -> Vector:
    """Return a state projected onto its closed stops, and onto the stop that it leaves.

    A release also has the contact force zero, unless another event caused it.

    Args:
        graph: The graph of modes.
        x: The state, ``(n_x,)``.
        mode: The mode just after the event of the section.

    Raises:
        SimulationError: If no release is found nearby.
    """
    x = _on_constraints(graph, x)
    closed, sides = graph.mode_of(mode.closed, mode.sides)
    for k in closed:
        x = graph.holding((closed, sides), k).on_stop(x)
    if mode.released and not mode.stop:
        view = graph.view((closed, sides), graph.stop_names.index(mode.released))
        return project_to_section(view, RELEASE_ROWS, x, graph.own.states(x.size))
    if mode.rested:
        return graph.view((closed, sides), graph.stop_names.index(mode.rested)).on_stop(x)
    if mode.stop:
        stop, n_q = graph.stop_names.index(mode.stop), graph.n_q
        view = graph.view((closed, sides), stop)
        for _ in range(_CORRECTIONS):
            moved = view.gap(x) * view.impulse_direction(x)[n_q : 2 * n_q]
            x = x.copy()
            x[:n_q] -= moved
            if not np.any(np.abs(view.holonomic(x)) > _ON):
                break
            # The direction is only tangent to the constraints.
            x = _on_constraints(graph, x)
    return x


def _on_constraints(graph: GraphDynamics, x: Vector) -> Vector:
    """Return a state moved onto the constraints and the circle of the clock, by Newton's method."""
    view = graph.first
    if view.differentiation is None or view.holonomic(x).size == 0:
        return x
    differentials = view.differentiation.by(())
    for _ in range(_CORRECTIONS):
        off = view.holonomic(x)
        if not np.any(np.abs(off) > _ON):
            break
        x = x - np.linalg.pinv(differentials.holonomic(x)[:, : x.size]) @ off
    return x


def openings_of(events: Sequence[Event]) -> tuple[str, ...]:
    """Return the releases that other events cause, with these events, in alphabetical order.

    A release that meets a switching time is caused by the switch beyond it. The event sequence is
    the same on both sides, and the return is not smooth.

    Args:
        events: Events in order.
    """
    return tuple(
        sorted(
            f"{orbit_event_name(first)}, {orbit_event_name(then)}"
            for first, then in pairwise(events)
            if isinstance(then, Release) and then.time == first.time
        )
    )


def section_of_family(found: EventReturn) -> tuple[EventSection, Vector]:
    """Return the section on which a family is followed, and the state of an orbit on it.

    A period that starts at a Zeno point is started at the release that follows. Where the contact
    phase vanishes, the family is smooth at the release only, theory (5.7).

    Args:
        found: The return of the orbit.
    """
    names = [orbit_event_name(event) for event in found.events]
    name, sequence, x = names[-1], sequence_of(names), found.start
    mode = found.mode
    n_returns = names.count(name)
    release = found.events[0]
    if isinstance(release, Release) and name == f"zeno {release.stop}":
        name, sequence = sequence[0], (*sequence[1:], sequence[0])
        n_returns = sequence.count(name)
        mode, x = (
            SectionMode.after(found.execution, name, release.time) or mode,
            np.asarray(release.state),
        )
    section = EventSection(
        name=name,
        n_returns=n_returns,
        sequence=sequence,
        mode=mode,
        openings=openings_of(found.events),
    )
    return section, x


def largest_states(arcs: Sequence[Arc], graph: GraphDynamics) -> Vector:
    """Return the size of each state at the ends of arcs, ``(n_x,)``.

    A held state that is zero in an orbit is a coefficient times the error of a measured state.

    Args:
        arcs: The arcs.
        graph: The graph of modes, whose scales replace sizes that are zero.
    """
    largest = np.max(np.abs(np.array([arc.end_state for arc in arcs])), axis=0)
    held = list(graph.held)
    usual = graph.own.states(len(largest))[held]
    largest[held] = np.where(largest[held] > _HELD * usual, largest[held], 0.0)
    return graph.own.not_zero(largest)


def time_blur(arcs: Sequence[Arc], graph: GraphDynamics, period: float, sizes: Vector) -> float:
    r"""Return the relative deviation of states that the rounding of times explains.

    It is :math:`\max_i 4\,\varepsilon(T)\,|\dot x_i| / s_i` at the ends of arcs, with the spacing
    :math:`\varepsilon(T)` of numbers at the period and the size :math:`s_i` of a state. It matters
    where a flow is as fast as in a pulse of 1e-7 s.

    Args:
        arcs: The arcs of a period.
        graph: The graph of modes.
        period: The period [s].
        sizes: Size of each state, ``(n_x,)``.
    """
    n_x = len(graph.state_names)
    rates = np.zeros(n_x)
    for arc in arcs:
        flow = graph.flow(arc.mode_in(graph))
        for x in (arc.start_state, arc.end_state):
            rates = np.maximum(rates, np.abs(flow.rate(np.asarray(x))[:n_x]))
    return float(np.max(_SPACINGS * np.spacing(period) * rates / sizes))


def fall_at(
    graph: GraphDynamics, arcs: Sequence[Arc], event: Release | SwitchEvent
) -> float | None:
    """Return how fast the guard of a release or a switch falls there.

    Args:
        graph: The graph of modes.
        arcs: The arcs around the event.
        event: The event.

    Returns:
        Minus the rate of the guard. ``None`` if another event opened the stop.
    """
    ending = Ending.RELEASE if isinstance(event, Release) else Ending.SWITCH
    arc = next((a for a in arcs if a.end_time == event.time and a.ending is ending), None)
    if arc is None:
        return None
    mode, x = arc.mode_in(graph), arc.end_state
    if isinstance(event, Release):
        return -graph.holding(mode, graph.stop_names.index(event.stop)).multiplier_rate(x)
    switch = graph.switch_names.index(event.name)
    above = switch < graph.n_declared or arc.sides[switch - graph.n_declared]
    return -float(graph.guard_flow(mode, switch, above).guard(x)[1])


def closed_return(
    graph: GraphDynamics,
    x: Vector,
    *,
    section: str,
    n_returns: int,
    guess: float,
    settings: SimulationSettings,
    parameters: Sequence[int] = (),
    mode: SectionMode | None = None,
    is_near: bool = False,
    exact: float = 10.0 * _EXACT,
    by_returns: bool = False,
) -> EventReturn:
    r"""Return the periodic orbit near a start, by Newton's method.

    With the residual :math:`r = P(x) - x`, a step is :math:`s = H r`, and :math:`H` approximates
    :math:`(1 - P')^{-1}`. After a step, :math:`y = r_k - r_{k+1}` improves it by a rank-one update,
    :math:`H \leftarrow H + (s - H y)\, s^\top H / (s^\top H y)` [Broyden1965]_. Where the
    corrections do not shrink, :math:`H` is computed from the exact derivative.

    Args:
        graph: The graph of modes.
        x: A start just after the event of the section, ``(n_x,)``.
        section: Name of the event.
        n_returns: Number of events of the section in a period.
        guess: Approximate period [s].
        settings: Accuracy.
        parameters: Indices in ``p`` of the parameters of the derivatives.
        mode: The mode just after the event. The start is projected by it. By default it is the mode
            of the motion from the start.
        is_near: Whether the start is near the orbit, so that every correction is smaller than the
            one before. The first orbit that is not ends the search.
        exact: Relative correction of an orbit. Newton's method ends at a tenth of it.
        by_returns: Start with the identity as :math:`H`, which costs no derivative. It is faster
            where the orbit attracts.

    Raises:
        SimulationError: If Newton's method does not converge, or the motion does not return.
    """
    best, best_size, size = None, math.inf, math.inf
    last: EventReturn | None = None
    inverse = np.eye(x.size) if by_returns else None
    limit = _HALVES
    returned = partial(event_return, graph, section=section, n_returns=n_returns, settings=settings)
    for _ in range(_MOST_ITERATIONS):
        found = returned(x, guess=guess, parameters=parameters, mode=mode)
        if mode is None:
            mode = found.mode
            x = on_section(graph, found.start, mode)
            if np.any(x != found.start):
                continue
        scale, guess, before = largest_states(found.execution.arcs, graph), found.period, size
        off = found.end - found.start
        if inverse is not None and last is not None and before > _ROUNDED:
            inverse = _improved(inverse, last, found, scale)
        change = None if inverse is None else inverse @ off
        if change is None or not np.max(np.abs(change) / scale) < limit * before:
            # A return without derivatives is much cheaper, so a derivative serves while it can.
            if limit > _SHRINKS:
                # A wrong estimate says nothing about how near the orbit is.
                best, best_size, before = None, math.inf, math.inf
            inverse, limit = inverse_of_closing(graph, found), _SHRINKS
            change = inverse @ off
        size, last = float(np.max(np.abs(change) / scale)), found
        if size < best_size:
            best, best_size = found, size
        elif best_size < _ROUNDED:
            break
        if size <= 0.1 * exact or (is_near and not size < before):
            break
        # A state that has decayed may change by many times its size.
        leap = float(np.max(np.abs(change) / graph.own.not_small(scale, _DECAYED)))
        if leap > 0.5:
            change *= 0.5 / leap
        x = found.start + change
    if best is None or not _is_closed(graph, best, best_size, exact):
        raise SimulationError(
            "Newton's method does not converge to a periodic orbit: the motion may repeat after "
            "more returns, or not at all",
            time=guess,
            state=tuple(x.tolist()),
        )
    return best


def _is_closed(graph: GraphDynamics, found: EventReturn, size: float, exact: float) -> bool:
    """Return True if a return repeats: its correction is rounding, and so is what it misses.

    An estimate of the inverse may be zero along what a return misses.
    """
    arcs = found.execution.arcs
    scale = largest_states(arcs, graph)
    if not np.max(np.abs(found.end - found.start) / scale) <= max(_MISSED, 10.0 * exact):
        return False
    return size <= max(1e-10, exact) or size <= time_blur(arcs, graph, found.period, scale)


def _improved(inverse: Vector, before: EventReturn, after: EventReturn, scale: Vector) -> Vector:
    """Return the inverse of a closing after the rank-one update of a step between two returns."""
    step = after.start - before.start
    told = before.end - before.start - (after.end - after.start)
    row = (step / scale**2) @ inverse
    length = float(row @ told)
    if length == 0.0:
        return inverse
    return inverse + np.outer(step - inverse @ told, row) / length


def shortest_return(
    graph: GraphDynamics, found: EventReturn, settings: SimulationSettings
) -> EventReturn:
    """Return a periodic orbit over its shortest period.

    A return near the start is not sufficient: the orbit of fewer returns must have this start.

    Args:
        graph: The graph of modes.
        found: The orbit, over any number of its periods.
        settings: Accuracy.
    """
    section = orbit_event_name(found.events[-1])
    scale = largest_states(found.execution.arcs, graph)
    begin = _AT_ONCE * found.period
    marks = [
        event for event in found.events if orbit_event_name(event) == section and event.time > begin
    ]
    for k, event in enumerate(marks[:-1], start=1):
        away = np.max(np.abs(state_after(event) - found.start) / scale)
        if len(marks) % k or not away < _NEAR:
            continue
        try:
            shorter = closed_return(
                graph,
                found.start,
                section=section,
                n_returns=k,
                guess=event.time,
                settings=settings,
                parameters=found.differentiation.chosen,
                mode=found.mode,
                is_near=True,
            )
        except SimulationError:
            continue
        if np.max(np.abs(shorter.start - found.start) / scale) < _ONE_START:
            return shorter
    return found


def after_setting(graph: GraphDynamics, section: str) -> str:
    """Return the event at which states are set, if that is so at an event, or the event itself.

    A motion goes on from the states that are set.

    Args:
        graph: The graph of modes.
        section: Name of the event.
    """
    setter = graph.setter_at(section)
    return section if setter is None else f"switch {graph.switch_names[setter]}"


def at_section(
    graph: GraphDynamics, found: EventReturn, section: str, settings: SimulationSettings
) -> EventReturn:
    """Return a periodic orbit from another one of its events.

    Args:
        graph: The graph of modes.
        found: The orbit.
        section: Name of the event.
        settings: Accuracy.

    Raises:
        SimulationError: If the orbit lacks the event, or does not return.
    """
    section = after_setting(graph, section)
    names = [orbit_event_name(event) for event in found.events]
    if names[-1] == section:
        return found
    if section not in names:
        raise SimulationError(
            f"The orbit lacks the event `{section}`",
            time=found.period,
            state=tuple(found.start.tolist()),
        )
    event = found.events[names.index(section)]
    return closed_return(
        graph,
        state_after(event),
        section=section,
        n_returns=names.count(section),
        guess=found.period,
        settings=settings,
        mode=SectionMode.after(found.execution, section, event.time),
    )


def inverse_of_closing(graph: GraphDynamics, found: EventReturn) -> Vector:
    """Return the inverse of the identity minus the derivative of a return, ``(n_x, n_x)``.

    It acts on admissible changes of the start. A direction in which the return is neutral has no
    change.

    Args:
        graph: The graph of modes.
        found: The return.
    """
    # States of unlike sizes would hide each other's singular values.
    scale = largest_states(found.execution.arcs, graph)
    keeps = kept_section(graph, found.start, found.mode, scale).tangent
    matrix = (np.eye(len(scale)) - found.by_state) * scale[None, :] / scale[:, None]
    inverse = keeps @ inverse_where_moved(keeps.T @ matrix @ keeps) @ keeps.T
    return np.asarray(inverse * scale[:, None] / scale[None, :], dtype=np.float64)


def inverse_where_moved(matrix: Vector) -> Vector:
    """Return the inverse of the identity minus a derivative, zero along neutral directions.

    Multipliers are ratios, so one is near to 1 by itself, and not relative to the others.

    Args:
        matrix: The identity minus the derivative, ``(d, d)``.
    """
    largest = float(np.linalg.norm(matrix, 2)) if matrix.size else 0.0
    neutral = _NEUTRAL * max(1.0, largest) / (largest or 1.0)
    return np.asarray(np.linalg.pinv(matrix, rcond=neutral), dtype=np.float64)


def start_by_parameters(graph: GraphDynamics, found: EventReturn) -> Vector:
    """Return the derivative of the start of a periodic orbit by the parameters, ``(n_x, k)``.

    The closed stops of the start move with the parameters, and the start with the stops.

    Args:
        graph: The graph of modes.
        found: The return.
    """
    scale, chosen = largest_states(found.execution.arcs, graph), found.differentiation.chosen
    drift = kept_section(graph, found.start, found.mode, scale, chosen).drift
    missed = found.by_parameters + found.by_state @ drift - drift
    return np.asarray(drift + inverse_of_closing(graph, found) @ missed, dtype=np.float64)


def kept_section(
    graph: GraphDynamics,
    x: Vector,
    mode: SectionMode,
    scale: Vector,
    parameters: Sequence[int] = (),
) -> Section:
    """Return a chart of the admissible states around a state.

    They keep the constraints, the circle of the clock, and gap and gap rate of the closed stops. A
    stop that is just left keeps its gap, and a stop that is just released its contact force.

    Args:
        graph: The graph of modes.
        x: The state, ``(n_x,)``.
        mode: The mode of the state.
        scale: Size of each state, ``(n_x,)``.
        parameters: Indices in ``p`` of the parameters with which the states move, ``(k,)``.
    """
    chosen, n_x = tuple(parameters), len(x)
    at = graph.mode_of(mode.closed, mode.sides)
    rows = [
        differentials_of(graph.holding(at, k), chosen).contact(x)[list(REST_ROWS)] for k in at[0]
    ]
    left = mode.stop or mode.released or mode.rested
    if left:
        view = graph.view(at, graph.stop_names.index(left))
        own = RELEASE_ROWS if mode.released else REST_ROWS if mode.rested else IMPACT_ROWS
        rows.append(differentials_of(view, chosen).contact(x)[list(own)])
    gradient = np.concatenate([differentials_of(graph.first, chosen).holonomic(x), *rows])
    section = section_of(gradient[:, :n_x] * scale, x, scale)
    return replace(section, drift=-scale[:, None] * (section.normal @ gradient[:, n_x:]))


@dataclass(frozen=True, slots=True, kw_only=True)
class NearReturn:
    """A state after an event to which a motion nearly returns.

    Attributes:
        state: The state, ``(n_x,)``.
        mode: The mode just after the event, if the motion goes on after it or the return before.
        section: Name of the event.
        n_returns: Number of such events until the motion nearly returns.
        period: Time until then [s].
    """

    state: Vector
    mode: SectionMode | None
    section: str
    n_returns: int
    period: float


def near_return(
    execution: Execution,
    graph: GraphDynamics,
    section: str | None,
    *,
    within: float = _NEAR,
    sequence: Sequence[str] | None = None,
) -> NearReturn:
    """Return the last state of an execution to which it nearly returns.

    Args:
        execution: An execution that settles.
        graph: The graph of modes.
        section: Name of the event of the section. The default is the first of a declared switch, a
            release and an impact that occurs often enough in the second half of the execution.
        within: Largest relative distance of the two states. Below the default the motion also has
            to come nearer from return to return, unless it is as near as rounding of the start.
        sequence: Event sequence that the return must have, which ends with the section. Its nearest
            return then need not be the last one. The default is any sequence.

    Raises:
        InputError: If the event of the section does not occur, belongs to impacts that accumulate,
            or is a Zeno point of a stop with elastic impacts.
        SimulationError: If the motion comes to rest, lacks events, or does not return.
    """
    if _is_at_rest(execution, graph, execution.end_time / 2):
        raise SimulationError(
            "The motion comes to rest: start elsewhere (`start`, --start), or take values that "
            "drive the machine more strongly",
            time=execution.end_time,
            state=tuple(execution.end_state.tolist()),
        )
    names = [orbit_event_name(event) for event in execution.events]
    if not names:
        raise EventlessError(
            "The motion strikes no stop and passes no switch: simulate for longer (`until`), or "
            "start elsewhere (`start`)",
            time=execution.end_time,
            state=tuple(execution.end_state.tolist()),
        )
    if sequence is not None:
        return _nearest_of_sequence(execution, graph, names, tuple(sequence))
    if section is not None:
        _require_occurs(graph, names, section)
        section = after_setting(graph, section)
    # The transient may have Zeno points that the orbit lacks.
    half = execution.end_time / 2
    late = {orbit_event_name(event) for event in execution.events if event.time > half}
    limit = accumulating_events(names).get(section or "")
    if limit in late:
        raise InputError(
            f"Argument `section` must not be `{section}`, whose events accumulate: take `{limit}`."
        )
    scale = largest_states(execution.arcs, graph)
    lasting = tuple(event for event in execution.events if orbit_event_name(event) in late)
    settled = replace(execution, events=lasting)
    choices = event_sections(settled, graph) if section is None else [section]
    # Early, the best section may only lag behind another.
    for chosen in choices[:1] if within < _NEAR else choices:
        found = _near_return_to(execution, chosen, scale, within)
        if found is not None:
            return found
    raise UnsettledError(
        "The motion does not nearly repeat: simulate for longer (`until`), or start "
        "nearer to an orbit (`start`)",
        time=execution.end_time,
        state=tuple(execution.end_state.tolist()),
    )


def _require_occurs(graph: GraphDynamics, names: Sequence[str], section: str) -> None:
    """Refuse a section whose event does not occur in a motion.

    Raises:
        InputError: If it does not, or is a Zeno point of a stop with elastic impacts.
    """
    if section in names:
        return
    kind, _, stop = section.partition(" ")
    if kind == "zeno" and stop in graph.stop_names:
        view = graph.view(graph.open_mode, graph.stop_names.index(stop))
        require_zeno_points(view.restitution, stop)
    known = ", ".join(sorted(set(names))) or "none"
    raise InputError(
        f"Argument `section` must be an event of the motion ({known}), but it is `{section}`."
    )


def _near_return_to(
    execution: Execution, section: str, scale: Vector, within: float
) -> NearReturn | None:
    """Return the last event of a section with the earlier one that is nearest, if it is near."""
    marks = [event for event in execution.events if orbit_event_name(event) == section]
    *earlier, last = marks[-1 - _MOST_RETURNS :]
    earlier = [one for one in reversed(earlier) if one.time < last.time]
    states = np.array([state_after(one) for one in earlier]).reshape(-1, len(scale))
    away = np.max(np.abs(states - state_after(last)) / scale, axis=1)
    if not np.min(away, initial=np.inf) < within:
        return None
    n = int(np.argmax(away <= max(_NEARER * np.min(away), _SETTLED)))
    if within < _NEAR and away[n] > _THERE:
        before = states[2 * n + 1 :][:1]
        if not np.max(np.abs(before - states[n]) / scale, initial=0.0) > away[n]:
            return None
    return NearReturn(
        state=state_after(last),
        mode=SectionMode.after(execution, section, last.time, earlier[n].time),
        section=section,
        n_returns=n + 1,
        period=last.time - earlier[n].time,
    )


def _nearest_of_sequence(
    execution: Execution, graph: GraphDynamics, names: Sequence[str], sequence: tuple[str, ...]
) -> NearReturn:
    """Return the return of an event sequence that came nearest to repeating.

    Raises:
        SimulationError: If none did.
    """
    scale, section = largest_states(execution.arcs, graph), sequence[-1]
    n, best, least = sequence.count(section), None, _ANY
    places = [k for k, name in enumerate(names) if name == section]
    for first, last in zip(places, places[n:], strict=False):
        begin, end = execution.events[first], execution.events[last]
        away = float(np.max(np.abs(state_after(end) - state_after(begin)) / scale))
        if away < least and sequence_of(names[first + 1 : last + 1]) == sequence:
            mode = SectionMode.after(execution, section, end.time, begin.time)
            best, least = (end, mode, end.time - begin.time), away
    if best is None:
        raise UnsettledError(
            f"No period with the events `{', '.join(sequence)}` nearly repeats",
            time=execution.end_time,
            state=tuple(execution.end_state.tolist()),
        )
    return NearReturn(
        state=state_after(best[0]), mode=best[1], section=section, n_returns=n, period=best[2]
    )


_STILL, _LOOKS = 1e-4, 7
"""Relative change of the states of a motion at rest, and the number of states per arc."""


def _is_at_rest(execution: Execution, graph: GraphDynamics, since: float) -> bool:
    """Return True if all states but those of the clock stay the same from a time on."""
    last = [arc for arc in execution.arcs if arc.end_time > since]
    # A motion that has decayed is measured by what it was.
    sizes = np.maximum(largest_states(execution.arcs, graph), np.abs(execution.arcs[0].start_state))
    moving = [k for k in range(len(sizes)) if k not in graph.first.clock]
    ends = np.array([arc.end_state for arc in last])
    if np.any((np.ptp(ends, axis=0) / sizes)[moving] >= _STILL):
        # The states at events are known, those between them cost an evaluation of the flow.
        return False
    starts = [max(arc.start_time, since) for arc in last]
    states = np.concatenate(
        [
            arc.states_at(np.linspace(start, arc.end_time, _LOOKS))
            for arc, start in zip(last, starts, strict=True)
        ]
    )
    return bool(np.all((np.ptp(states, axis=0) / sizes)[moving] < _STILL))


def settles_at(execution: Execution, graph: GraphDynamics, section: str | None) -> float | None:
    """Return the time at which a motion is near an orbit, extrapolated from its returns [s].

    The distances of successive returns fall by the largest multiplier that is seen. The distance
    from the orbit is their sum.

    Args:
        execution: An execution that may settle.
        graph: The graph of modes.
        section: Name of the event of the section. By default it is chosen.

    Returns:
        The time, or ``None`` if the distances do not fall clearly in the second half.
    """
    late = [one for one in execution.events if one.time > execution.end_time / 2]
    sections = event_sections(replace(execution, events=tuple(late)), graph)
    chosen = section or next(iter(sections), "")
    marks = [one for one in late if orbit_event_name(one) == chosen]
    if len(marks) < _SEEN:
        return None
    scale = largest_states(execution.arcs, graph)
    states = np.array([state_after(one) for one in marks]) / scale
    most = min(_MOST_RETURNS, len(marks) // 3)
    apart = np.max(np.abs(states[-1 - most : -1] - states[-1]), axis=1)[::-1]
    n = 1 + int(np.argmin(apart))
    away = np.log(np.max(np.abs(states[n:] - states[:-n]), axis=1).clip(_SETTLED**2))
    since = [one.time - marks[-1].time for one in marks[n:]]
    slope, level = linear_regression(since, away.tolist())
    rough = float(np.std(away - level - slope * np.array(since)))
    fallen = slope * (marks[n].time - marks[-1].time)
    if not fallen > max(_CLEARLY, rough):
        return None
    period = marks[-1].time - marks[-1 - n].time
    distance = level - math.log(-math.expm1(slope * period))
    return marks[-1].time + max(distance - math.log(_CLOSE), 0.0) / -slope


def _is_armed_again(graph: GraphDynamics, event: SwitchEvent) -> bool:
    """Return True if the reset of a declared switch leaves it armed, with its guard at zero."""
    k = graph.switch_names.index(event.name)
    guards, levels, armed = graph.guards(((), graph.open_mode[1]), event.state_plus)
    return bool(abs(guards[k]) <= levels[k] and armed[k] > 0.0)


def event_sections(execution: Execution, graph: GraphDynamics) -> list[str]:
    """Return the events that may serve as a section, the best first.

    A switch that is armed on its guard after its reset would occur again at the start. An impact
    that opens another stop comes last: the release follows at once, in the next period.

    Args:
        execution: The execution.
        graph: The graph of modes.
    """
    declared = graph.switch_names[: graph.n_declared]
    passed = [orbit_event_name(event) for event in execution.events]
    names, limits = list(dict.fromkeys(passed)), accumulating_events(passed)
    switches = [
        orbit_event_name(event)
        for event in execution.switches
        if event.name in declared
        and np.any(event.state_minus != event.state_plus)
        and not _is_armed_again(graph, event)
    ]
    zenos = [name for name in names if name.startswith("zeno ")]
    impacts = [name for name in names if name.startswith("impact ") and name not in limits]
    others = [name for name in names if name.startswith("switch ") and name not in limits]
    opening = {
        orbit_event_name(event)
        for event, following in pairwise(execution.events)
        if isinstance(following, Release) and following.time == event.time
    }
    whole = [name for name in (*zenos, *impacts) if name not in opening]
    # A period of one stop alone consists of phases, each of which ends with a release.
    alone = len(graph.stop_names) == 1 and not graph.switch_names and zenos
    releases = [f"release {graph.stop_names[0]}"] if alone else []
    first = [name for name in releases if name in names]
    return list(dict.fromkeys([*switches, *first, *whole, *zenos, *impacts, *others]))
