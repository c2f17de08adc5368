r"""The orbit near the returns of a motion, by Newton's method (theory (4.7)).

The start is the limit of the last returns. The returns and their exact derivatives are those of
`zeno_orbits.orbits`. The last correction is applied to first order, so its square is the error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector, eigenvalues, spectral_radius
from zeno_orbits.errors import SimulationError
from zeno_orbits.maps.approach import Accuracy
from zeno_orbits.maps.attractors import Attractor
from zeno_orbits.maps.closing import ClosedOrbit, orbit_by_loop, orbit_from
from zeno_orbits.model import GraphDynamics
from zeno_orbits.orbits import (
    EventReturn,
    Section,
    SectionMode,
    closed_return,
    contact_view,
    contacts_of,
    derivative_of_return,
    event_return,
    event_sections,
    inverse_of_closing,
    inverse_where_moved,
    kept_section,
    largest_states,
    multipliers_of_return,
    orbit_event_name,
    phases_of_events,
    shortest_return,
)
from zeno_orbits.simulation import (
    Event,
    Execution,
    Impact,
    state_after,
    transient_settings,
)

_AT_ONCE = 1e-9
"""Part of the period in which an event belongs to the start."""
_VANISHED = 0.02
"""Part of its size below which a motion decays to an equilibrium, if returns contract."""
_FALLS, _STEPS = 0.8, 8
"""Largest ratio of successive amplitudes on the way to an equilibrium, and most steps to it."""


def limit_of_steps(last: Vector, before: Vector, earlier: Vector, scale: Vector) -> Vector:
    r"""Return the limit of a motion by its last two steps, ``(n_x,)``.

    With the steps :math:`u_1`, then :math:`u_0` to the last state :math:`x`, it is
    :math:`x - \vartheta u_0,\ \vartheta = u_0 \cdot (u_0 - u_1) / |u_0 - u_1|^2`, which is exact
    for a linear map with one multiplier along these steps. It is the last state if the steps do not
    become shorter.

    Args:
        last: The last return, ``(n_x,)``.
        before: The return before, ``(n_x,)``.
        earlier: The return before that, ``(n_x,)``.
        scale: Size of each state, ``(n_x,)``.
    """
    step, first = (last - before) / scale, (before - earlier) / scale
    change = step - first
    if not step @ step < first @ first:
        return last
    return last - float(step @ change) / float(change @ change) * scale * step


def orbit_near(
    graph: GraphDynamics,
    x: Vector,
    *,
    section: str,
    n_returns: int,
    guess: float,
    mode: SectionMode,
    accuracy: Accuracy,
    starts: Sequence[str] = (),
) -> ClosedOrbit | None:
    """Return the orbit near a state of a section, or ``None`` if none is found.

    Args:
        graph: The graph of modes.
        x: The state just after the event of the section, ``(n_x,)``.
        section: Name of the event.
        n_returns: Number of such events in a period.
        guess: Approximate period [s].
        mode: The mode just after the event.
        accuracy: Accuracy of the orbit.
        starts: Events at which a period starts, the best first. By default the usual sections.
    """
    settings = transient_settings(accuracy.orbit)
    same: Any = {"section": section, "n_returns": n_returns, "settings": settings, "mode": mode}
    try:
        told = orbit_by_loop(graph, x, guess=guess, exact=accuracy.exact, starts=starts, **same)
        if told is not None:
            return told
        found = closed_return(graph, x, guess=guess, is_near=True, exact=accuracy.exact, **same)
        found = shortest_return(graph, found, settings)
        multipliers = multipliers_of_return(graph, found)
        chart, slope = _linear(graph, found)
        off = chart.components(found.end - found.start)
        missed = inverse_where_moved(np.eye(len(slope)) - slope) @ off
    except (SimulationError, np.linalg.LinAlgError):
        return None
    change = chart.lift @ missed
    return ClosedOrbit(
        attractor=_attractor(graph, found, multipliers, change, starts),
        n_returns=sum(orbit_event_name(one) == section for one in found.events[_begin(found) :]),
        chart=replace(chart, centre=found.start + change),
        slope=slope,
    )


def fades(
    graph: GraphDynamics, x: Vector, *, section: str, guess: float, mode: SectionMode, error: float
) -> bool:
    """Return True if Newton's steps lead to an amplitude of zero, and returns contract on the way.

    Near a rest on a stop, a return is linear in the state up to terms of third order.

    Args:
        graph: The graph of modes.
        x: The state just after the event of the section, ``(n_x,)``.
        section: Name of the event.
        guess: Approximate time of a return [s].
        mode: The mode just after the event.
        error: Relative local error of a step.
    """
    settings, largest = transient_settings(error), np.zeros(len(x))
    try:
        for _ in range(_STEPS):
            found = event_return(
                graph, x, section=section, n_returns=1, guess=guess, settings=settings, mode=mode
            )
            _, slope = _linear(graph, found)
            if not spectral_radius(eigenvalues(slope)) < 1.0:
                return False
            largest = np.maximum(largest, largest_states(found.execution.arcs, graph))
            before, guess = float(np.max(np.abs(x) / largest)), found.period
            x = found.start + inverse_of_closing(graph, found) @ (found.end - found.start)
            now = float(np.max(np.abs(x) / largest))
            if now < _VANISHED:
                return True
            if not now < _FALLS * before:
                return False
    except (SimulationError, np.linalg.LinAlgError):
        return False
    return False


def _linear(graph: GraphDynamics, found: EventReturn) -> tuple[Section, Vector]:
    """Return a chart around the start of a return, and the derivative in it.

    It is the chart of the section, or of all admissible states after a switch, whose section lies
    before its reset.
    """
    name, section, slope = derivative_of_return(graph, found)
    if name == orbit_event_name(found.events[-1]) and not name.startswith("switch "):
        return section, slope
    scale = largest_states(found.execution.arcs, graph)
    chart = kept_section(graph, found.start, found.mode, scale)
    return chart, chart.components(found.by_state @ chart.lift)


def _attractor(
    graph: GraphDynamics,
    found: EventReturn,
    multipliers: tuple[complex, ...],
    change: Vector,
    starts: Sequence[str],
) -> Attractor:
    """Return an orbit from its best section, so that one orbit has one start.

    Args:
        graph: The graph of modes.
        found: A return near the orbit.
        multipliers: The Floquet multipliers.
        change: Correction of its start, ``(n_x,)``.
        starts: Events at which a period starts, the best first.
    """
    names = {orbit_event_name(event) for event in found.events}
    told = [one for one in starts if one in names]
    name = (told or usual_sections(graph, found.events))[0]
    n_x, n = len(change), len(found.events)
    after = [one[2] for passage in found.passages for one in passage.crossings][:n]

    def moved(place: int) -> Vector:
        return after[place].state[:, :n_x] @ change

    return replace(
        orbit_from(graph, found.events, name, moved, _begin(found)),
        period=found.period + float(after[-1].time[:n_x] @ change),
        multipliers=multipliers,
        margins=_margins(graph, found),
    )


def _begin(found: EventReturn) -> int:
    """Return the number of events at the start itself, which the end repeats.

    Rounding has then put the start in contact.
    """
    return sum(event.time <= _AT_ONCE * found.period for event in found.events[:-1])


def usual_sections(graph: GraphDynamics, events: Sequence[Event]) -> list[str]:
    """Return the sections of some events, the best first.

    Those of one kind are in the order of their names, so an orbit has one section, whichever of its
    events the motion met first.

    Args:
        graph: The graph of modes.
        events: The events.
    """
    run = Execution(state_names=graph.state_names, arcs=(), events=tuple(events))
    kinds = groupby(event_sections(run, graph), key=lambda name: name.partition(" ")[0])
    return [name for _, names in kinds for name in sorted(names)]


def _margins(graph: GraphDynamics, found: EventReturn) -> Mapping[str, float]:
    """Return the smallest margins over the contact phases and impacts of an orbit."""
    phases = phases_of_events([orbit_event_name(event) for event in found.events])
    first = [found.events[phase[0]] for phase in phases]
    speeds = [-event.approach_rate for event in first if isinstance(event, Impact)]
    margins = {"first_impact_speed": min(speeds)} if speeds else {}
    for contact in contacts_of(found):
        view, release = contact_view(graph, found, contact), phases[contact.place][-1]
        own = {
            "gap_acceleration": -view.gap_acceleration(contact.zeno.state),
            "release_transversality": -view.multiplier_rate(state_after(found.events[release])),
            "locked_time": contact.duration,
        }
        margins |= {name: min(value, margins.get(name, value)) for name, value in own.items()}
    return margins
