"""Gaps of recorded coordinates during the contacts of a channel, which must be closed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.contact_edges import SeenContact, seen_contacts
from zeno_orbits.experiment.comparison.event_contacts import SeenEvents
from zeno_orbits.experiment.recordings.recording import Recording
from zeno_orbits.model import ParameterValues, Problem

_OPEN = 0.05
"""Largest mean gap of a closed stop in a tenth of its contacts, in units of the largest gap."""
_SAMPLES = 200
"""Number of samples of a mean gap."""


def contradictions(
    problem: Problem,
    values: ParameterValues,
    recording: Recording,
    names: Sequence[str],
    seen: SeenEvents,
    channels: Mapping[str, Vector],
) -> tuple[str, ...]:
    """Return the stops whose channel shows contact although their gap is open.

    A stop whose gap depends on coordinates that were not recorded is left out.

    Args:
        problem: The problem.
        values: Values of every gain and parameter.
        recording: The recording.
        names: Names of the recorded states and outputs.
        seen: The contacts of the channels.
        channels: Contact channels by the name of their stop.
    """
    graph = problem.graph_dynamics(values)
    columns = {name: recording.signal(name).values for name in names}
    missing = np.full(len(recording.time), np.nan)
    states = np.column_stack([columns.get(name, missing) for name in problem.state_names])
    found: list[str] = []
    for stop in seen.stops:
        # The guard of the free flow is the gap.
        gap = graph.view(graph.open_mode, graph.stop_names.index(stop.name)).free.guards
        size = float(np.nanmax(gap(_chosen(states)), initial=0.0))
        contacts = seen_contacts(recording.time, channels[stop.name])
        parts = [gap(_chosen(states[places])) for places in _parts_of(contacts, recording.time)]
        parts = [part[np.isfinite(part)] for part in parts]
        open_by = max((float(np.mean(part)) for part in parts if len(part)), key=abs, default=0.0)
        if abs(open_by) > _OPEN * size:
            found.append(
                f"the contact `{stop.name}` is 1 at a mean gap of {open_by:.3g}, and the largest "
                f"gap is {size:.3g}: channel and signals contradict each other"
            )
    return tuple(found)


def _parts_of(contacts: Sequence[SeenContact], time: Vector) -> list[list[int]]:
    """Return the samples in the first, the middle and the last tenth of the longest contacts."""
    longest = max((one.samples for one in contacts), default=0)
    parts: list[list[int]] = [[], [], []]
    for one in contacts:
        first = 0 if one.begin is None else int(np.searchsorted(time, one.begin.high))
        end = len(time) if one.end is None else int(np.searchsorted(time, one.end.high))
        tenth = (end - first) // 10
        if one.samples > longest / 2 and tenth:
            middle = (first + end - tenth) // 2
            for part, begin in zip(parts, (first, middle, end - tenth), strict=True):
                part += range(begin, begin + tenth)
    return parts


def _chosen(states: Vector) -> Vector:
    """Return evenly spaced rows, at most twice as many as a mean gap needs."""
    return states[:: max(len(states) // _SAMPLES, 1)]
