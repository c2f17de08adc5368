"""The orbit near the returns of a machine with one stop, by Newton's method in the compiled loop.

The loop closes the return and has its derivatives. The orbit is told by them as `newton` tells it
by the reference, which serves all other machines and whatever the loop leaves to it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np

from zeno_orbits.arrays import Vector, eigenvalues
from zeno_orbits.errors import SimulationError
from zeno_orbits.loop import ClosedRecord, binding
from zeno_orbits.maps.attractors import Attractor, AttractorClass
from zeno_orbits.model import GraphDynamics
from zeno_orbits.orbits import (
    Section,
    SectionMode,
    extrapolated,
    inverse_where_moved,
    kept_section,
    kind_of_events,
    orbit_event_name,
    phases_of_events,
    sequence_of,
)
from zeno_orbits.simulation import (
    Event,
    Impact,
    Release,
    SimulationSettings,
    SimulationTask,
    ZenoPoint,
    closed_by_loop,
    state_after,
)

_MODE, _START, _END, _ENDING = 0, 1, 2, 5
"""Columns of an arc's row: mode, times of its start and end, event at its end."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClosedOrbit:
    """A periodic orbit near a motion.

    Attributes:
        attractor: The orbit.
        n_returns: Events of the section in a period.
        chart: Chart around its state on the section.
        slope: Derivative of the return in the chart, ``(d, d)``.
    """

    attractor: Attractor
    n_returns: int
    chart: Section
    slope: Vector


def orbit_by_loop(
    graph: GraphDynamics,
    x: Vector,
    *,
    section: str,
    n_returns: int,
    guess: float,
    mode: SectionMode,
    settings: SimulationSettings,
    exact: float,
    starts: Sequence[str],
) -> ClosedOrbit | None:
    """Return the orbit near a state of a section, or ``None`` if the reference has to look for it.

    Args:
        graph: The graph of modes.
        x: The state just after the event of the section, ``(n_x,)``.
        section: Name of the event.
        n_returns: Number of such events in a period.
        guess: Approximate period [s].
        mode: The mode just after the event.
        settings: Accuracy.
        exact: Largest relative correction of the orbit.
        starts: Events at which a period starts, the best first.

    Raises:
        SimulationError: If no orbit is found nearby.
        LinAlgError: If the eigenvalues of its return do not converge.
    """
    if not graph.has_one_guard or not starts or mode != _mode_after(graph, section):
        return None
    if any(view.restitution == 0.0 for view in graph.open_views):
        return None
    one_by_one = _resolving(settings)
    task = SimulationTask(dynamics=graph, state=x, until=guess, settings=one_by_one)
    closed = closed_by_loop(task, section=section, n_returns=n_returns, guess=guess, exact=exact)
    if closed is not None and n_returns > 1:
        closed = _shortest(graph, *closed, one_by_one)
    if closed is None:
        return None
    found, events = closed
    names = [orbit_event_name(event) for event in events]
    chart = kept_section(graph, found.end, mode, found.scale)
    slope = chart.components(found.by_state @ chart.lift)
    off = chart.components(found.end - found.start)
    change = chart.lift @ (inverse_where_moved(np.eye(len(slope)) - slope) @ off)
    least = min(len(slope), _least_dimension(graph, found, events, names))
    multipliers = eigenvalues(slope)[:least]
    best = next(one for one in starts if one in names)
    return ClosedOrbit(
        attractor=replace(
            orbit_from(graph, events, best, lambda k: _after(found, events[k])[2:] @ change),
            period=found.period + float(_after(found, events[-1])[0] @ change),
            multipliers=multipliers,
            margins=_margins(graph, found.period, events),
        ),
        n_returns=names.count(section),
        chart=replace(chart, centre=found.start + change),
        slope=slope,
    )


@lru_cache(maxsize=64)
def _resolving(settings: SimulationSettings) -> SimulationSettings:
    """Return settings that resolve impacts."""
    return replace(settings, completion=extrapolated(settings))


def _mode_after(graph: GraphDynamics, section: str) -> SectionMode:
    """Return the mode just after an event that no other event causes, of the only stop."""
    kind, _, stop = section.partition(" ")
    return SectionMode(
        closed=(stop,) if kind == "zeno" else (),
        sides=graph.open_mode[1],
        stop=stop if kind == "impact" else "",
        released=stop if kind == "release" else "",
    )


_NEAR, _APART, _ONE_START = 0.05, 1e-4, 2e-6
"""Relative distances of starts: below which an orbit may close after fewer returns, beyond which a
step of Newton's method leads to another orbit, and below which both are one orbit."""
_EXACT = 3e-13
"""Relative correction of an orbit over fewer returns."""


def _shortest(
    graph: GraphDynamics, found: ClosedRecord, events: list[Event], settings: SimulationSettings
) -> tuple[ClosedRecord, list[Event]] | None:
    """Return an orbit over its shortest period, or ``None`` if the reference has to look for it.

    Args:
        graph: The graph of modes.
        found: The orbit, over any number of its periods.
        events: Its events.
        settings: Accuracy.
    """
    section = orbit_event_name(events[-1])
    marks = [event for event in events if orbit_event_name(event) == section]
    chart = kept_section(graph, found.end, _mode_after(graph, section), found.scale)
    for k, event in enumerate(marks[:-1], start=1):
        if len(marks) % k or not _leads_back(found, chart, event):
            continue
        time = event.time
        task = SimulationTask(dynamics=graph, state=found.start, until=time, settings=settings)
        try:
            shorter = closed_by_loop(task, section=section, n_returns=k, guess=time, exact=_EXACT)
        except SimulationError:
            continue
        if shorter is None:
            return None
        if np.max(np.abs(shorter[0].start - found.start) / found.scale) < _ONE_START:
            return shorter
    return found, events


def _leads_back(found: ClosedRecord, chart: Section, event: Event) -> bool:
    """Return True if a step of Newton's method from an earlier return stays at the start."""
    away = (state_after(event) - found.start) / found.scale
    if not np.max(np.abs(away)) < _NEAR:
        return False
    slope = chart.components(_after(found, event)[2:] @ chart.lift)
    moved = np.linalg.lstsq(np.eye(len(slope)) - slope, chart.tangent.T @ away, rcond=None)[0]
    return not np.max(np.abs(chart.tangent @ moved), initial=0.0) > _APART


def _least_dimension(
    graph: GraphDynamics, found: ClosedRecord, events: Sequence[Event], names: Sequence[str]
) -> int:
    """Return the least dimension of the sections of earlier events."""
    ends = {names[phase[-1]]: events[phase[-1]] for phase in phases_of_events(names)}
    return min(
        (
            kept_section(graph, state_after(one), _mode_after(graph, name), found.scale).dimension
            for name, one in ends.items()
            if name != names[-1]
        ),
        default=len(found.start),
    )


def orbit_from(
    graph: GraphDynamics,
    events: Sequence[Event],
    section: str,
    moved: Callable[[int], Vector],
    begin: int = 0,
) -> Attractor:
    """Return the kind, start and sequence of an orbit, from the last event of a section.

    Args:
        graph: The graph of modes.
        events: The events of a return near the orbit.
        section: Name of an event among them.
        moved: Function from the index of an event to the correction of the state after it,
            ``(n_x,)``.
        begin: Number of events at the start itself, which the end repeats.
    """
    names = [orbit_event_name(event) for event in events]
    place = max(k for k, one in enumerate(names) if one == section)
    state = state_after(events[place]) + moved(place)
    kind = kind_of_events([(one, event.time) for one, event in zip(names, events, strict=True)])
    return Attractor(
        fate=AttractorClass(kind),
        returns=names[begin:].count(section),
        state=dict(zip(graph.state_names, state.tolist(), strict=True)),
        sequence=sequence_of([*names[place + 1 :], *names[begin : place + 1]]),
    )


def _after(found: ClosedRecord, event: Event) -> Vector:
    """Return the derivatives after an event, ``(2 + n_x, n_x)``."""
    if isinstance(event, ZenoPoint):
        begins = (found.arcs[:, _MODE] == binding.LOCKED) & (found.arcs[:, _START] == event.time)
        return found.shifts[int(np.flatnonzero(begins)[0]), 0]
    ending = binding.IMPACT if isinstance(event, Impact) else binding.RELEASE
    ends = (found.arcs[:, _END] == event.time) & (found.arcs[:, _ENDING] == ending)
    return found.shifts[int(np.flatnonzero(ends)[0]), 2]


def _margins(graph: GraphDynamics, period: float, events: Sequence[Event]) -> Mapping[str, float]:
    """Return the smallest margins over the contact phases and impacts of an orbit."""
    # An impact is the first of its sequence if none comes between it and the end of contact.
    cyclic, view = [events[-1], *events], graph.first
    phases = phases_of_events([orbit_event_name(event) for event in events])
    first = [events[phase[0]] for phase in phases]
    speeds = [-event.approach_rate for event in first if isinstance(event, Impact)]
    margins = {"first_impact_speed": min(speeds)} if speeds else {}
    for k, (zeno, release) in enumerate(pairwise(cyclic)):
        if not isinstance(zeno, ZenoPoint) or not isinstance(release, Release):
            continue
        own = {
            "gap_acceleration": -view.gap_acceleration(zeno.state),
            "release_transversality": -view.multiplier_rate(release.state),
            "locked_time": release.time - zeno.time + (0.0 if k else period),
        }
        margins |= {name: min(value, margins.get(name, value)) for name, value in own.items()}
    return margins
