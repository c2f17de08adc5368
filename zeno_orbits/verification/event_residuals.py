r"""Residuals of an orbit of events: its data, the laws of impact, and the guards between events.

Laws are stated here again, by other formulas than those of the simulator: the impulses of an impact
follow from the changes of all gap rates,

.. math:: G\,p = \dot h^+ - \dot h^-, \qquad G = J W J^\top,

its loss from kinetic energies, and the guards are sampled between the events.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import finite_number
from zeno_orbits.model import GraphDynamics, Problem, constraint_sizes
from zeno_orbits.orbits import (
    Orbit,
    OrbitEvent,
    events_as_listed,
    lasting_events,
    orbit_event_name,
    phases_of_events,
    sequence_of,
)
from zeno_orbits.simulation import (
    Arc,
    Event,
    Impact,
    Release,
    ZenoPoint,
    scale_of,
    state_before,
)
from zeno_orbits.verification.event_energies import kept_stops, struck_view
from zeno_orbits.verification.integration import distance
from zeno_orbits.verification.residuals import impact_laws, unseen_misses
from zeno_orbits.verification.second_net import GuardRanges

_SAMPLES = 24
"""Samples of every arc, in addition to the steps of the integrator."""

Claimed = tuple[str, float, Vector]
"""Name, time [s] and state of an event."""


@dataclass(frozen=True, slots=True, kw_only=True)
class IntegratedPeriod:
    """One integrated period.

    Attributes:
        events: Its events.
        opened: Releases that its last event causes, at the start of the next period.
        arcs: Its arcs.
        start: When it starts [s].
        end: When it ends [s].
        state: State just after its last event, ``(n_x,)``.
    """

    events: tuple[Event, ...]
    opened: tuple[Release, ...]
    arcs: tuple[Arc, ...]
    start: float
    end: float
    state: Vector


def sizes_along(period: IntegratedPeriod, graph: GraphDynamics, problem: Problem) -> Vector:
    """Return the size of each state along a period, ``(n_x,)``.

    A state that nearly vanishes has a part of the size of the others of its unit.

    Args:
        period: The period.
        graph: The graph of modes.
        problem: The problem, for the units of the states.
    """
    n_x = len(graph.state_names)
    along = [np.max(np.abs(arc.flow_states[:, :n_x]), axis=0) for arc in period.arcs]
    return scale_of(along, problem.state_units, graph.own.states(n_x))


def claimed(problem: Problem, event: OrbitEvent) -> Claimed:
    """Return an event of an orbit as vectors.

    Raises:
        InputError: If its names or its time do not fit.
    """
    state = np.array(problem.state_vector(event.state))
    return event.name, finite_number("time", event.time), state


def event_misses(
    graph: GraphDynamics,
    orbit: Orbit,
    said: Sequence[Claimed],
    first: IntegratedPeriod,
    scale: Vector,
) -> float:
    """Return the largest deviation of an event, infinite if the event sequence differs.

    Kinks in the flights of impacts that accumulate do not belong to the event sequence. Claimed
    impacts after the last that is resolved obey the law of the tail.

    Args:
        graph: The graph of modes.
        orbit: The orbit.
        said: Its events.
        first: The first integrated period.
        scale: Size of each state, ``(n_x,)``.
    """
    events = events_as_listed(first.events, orbit.sequence)
    if sequence_of([orbit_event_name(event) for event in events]) != orbit.sequence:
        return math.inf
    found, claims = [0.0], _lasting_phases([name for name, _, _ in said])
    phases = _lasting_phases([orbit_event_name(event) for event in events])
    for seen, listed in zip(phases, claims, strict=True):
        *before, end = (events[k] for k in seen)
        *claimed_before, last = (said[k] for k in listed)
        pairs = [*zip(before, claimed_before, strict=False), (end, last)]
        found += [_miss(event, one, first, orbit.period, scale) for event, one in pairs]
        # All events before a Zeno point are impacts on its stop.
        impacts = [event for event in before if isinstance(event, Impact)]
        if bool(impacts) != bool(claimed_before):
            return math.inf
        if isinstance(end, ZenoPoint) and len(claimed_before) > len(impacts):
            e = graph.open_views[graph.stop_names.index(end.stop)].restitution
            unseen = [(time + first.start, x) for _, time, x in claimed_before[len(impacts) :]]
            found += unseen_misses(e, impacts, end, unseen, orbit.period, scale)
    return max(found)


def _lasting_phases(names: Sequence[str]) -> list[list[int]]:
    """Return the indices of the lasting events of each phase."""
    lasting = {*lasting_events(names)}
    return [[k for k in phase if k in lasting] for phase in phases_of_events(names)]


def _miss(
    event: Event, said: Claimed, first: IntegratedPeriod, period: float, scale: Vector
) -> float:
    name, time, x = said
    if name != orbit_event_name(event):
        return math.inf
    late = abs(event.time - first.start - time) / period
    return max(late, distance(np.asarray(state_before(event)), x, scale))


def event_impact_laws(graph: GraphDynamics, period: IntegratedPeriod) -> dict[str, float]:
    """Return the deviations of impacts from Newton's law and its loss, and the largest pull.

    Args:
        graph: The graph of modes.
        period: The period.
    """
    impacts = [event for event in period.events if isinstance(event, Impact)]
    if not impacts:
        return {}
    pull, n, fastest = 0.0, len(graph.stop_names), max(abs(one.approach_rate) for one in impacts)
    for impact in impacts:
        before, after = (
            np.array([view.gap_rate(x) for view in graph.open_views])
            for x in (impact.state_minus, impact.state_plus)
        )
        impulses = _impulses(graph, period, impact, after - before)
        largest = float(np.max(np.abs(impulses)))
        if largest > 0.0 and np.linalg.matrix_rank(graph.delassus(impact.state_minus)) == n:
            pull = max(pull, float(np.max(-impulses)) * abs(impact.approach_rate) / largest)
    struck = [(struck_view(graph, period.arcs, impact), impact) for impact in impacts]
    return {**impact_laws(struck), "impulses": pull / fastest}


def _impulses(
    graph: GraphDynamics, period: IntegratedPeriod, impact: Impact, change: Vector
) -> Vector:
    """Return the impulses of all stops that change the gap rates as an impact does.

    The current layer of a corrected drive lasts too long to open a stop that a force holds closed.
    A stop that stays closed then has its impulse by the masses alone.
    """
    x, k = impact.state_minus, graph.stop_names.index(impact.stop)
    impulses: Vector = np.linalg.lstsq(graph.delassus(x), change, rcond=1e-9)[0].astype(np.float64)
    if graph.has_current_layers:
        kept, _ = graph.mode_of(kept_stops(graph, period.arcs, impact), ())
        coupling = graph.coupling(x)
        share = np.linalg.solve(coupling[np.ix_(kept, kept)], coupling[list(kept), k])
        impulses[list(kept)] = -share * impulses[k]
    return impulses


def guards_along(graph: GraphDynamics, period: IntegratedPeriod) -> dict[str, float]:
    """Return the largest violation of gaps, multipliers and switches between the events.

    Args:
        graph: The graph of modes.
        period: The period.
    """
    ranges, constraints = GuardRanges(graph), 0.0
    for arc in period.arcs:
        if arc.trajectory is None:
            continue
        n_x, span = len(arc.start_state), arc.end_time - arc.start_time
        inside = arc.start_time + np.linspace(0.0, span, _SAMPLES + 2)[1:-1]
        ranges.meet(arc, arc.flow_states[1:-1, :n_x])
        ranges.meet(arc, arc.states_at(inside))
        x = arc.end_state
        held = np.abs(graph.first.holonomic(x))
        if held.size:
            constraints = max(constraints, float(np.max(held / constraint_sizes(graph.first, x))))
    found = ranges.residuals()
    return found | ({"holonomic": constraints} if graph.first.holonomic(period.state).size else {})
