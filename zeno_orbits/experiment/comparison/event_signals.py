r"""Sizes of the signals of a recording beside an orbit of events, and gaps during contact.

The average :math:`y` of a signal over a cycle is fitted by its orbit :math:`Y`,

.. math:: y(\varphi) \approx o + g\, Y(\varphi)

The standard error of the fit counts all residuals as one deviation, since those of another machine
repeat in every cycle. Where the channel of a stop is 1, the gap of its recorded coordinates must
vanish: otherwise channel and signals contradict each other.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.contact_edges import SeenContact, seen_contacts
from zeno_orbits.experiment.comparison.estimate import Estimate
from zeno_orbits.experiment.comparison.event_alignment import EventPlace
from zeno_orbits.experiment.comparison.event_contacts import SeenEvents
from zeno_orbits.experiment.comparison.event_reference import EventTable
from zeno_orbits.experiment.comparison.metrics import Metric, metric
from zeno_orbits.experiment.orbit_table import measurable
from zeno_orbits.experiment.recordings.periodicity import Periodicity
from zeno_orbits.experiment.recordings.recording import Recording

_ALIEN = 10.0
"""Ratio of ranges from which a signal has another unit, or belongs to another machine."""
_OPEN = 0.05
"""Largest mean gap of a closed stop in a tenth of its contacts, in units of the largest gap."""
_SAMPLES = 200
"""Number of samples of a mean gap."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalFit:
    """A signal of the recording as a multiple of the orbit's.

    Attributes:
        name: Name of the signal.
        unit: Its unit.
        highest: Largest value over the cycle, by the fit, with its standard error.
        lowest: Smallest value.
        own_highest: Largest value of the orbit.
        own_lowest: Smallest value of the orbit.
        gain: Ratio of the ranges.
    """

    name: str
    unit: str
    highest: Estimate
    lowest: Estimate
    own_highest: float
    own_lowest: float
    gain: float

    def metrics(self) -> Iterator[Metric]:
        """Yield the highest and the lowest value."""
        yield metric(f"highest of {self.name}", self.unit, self.own_highest, self.highest)
        yield metric(f"lowest of {self.name}", self.unit, self.own_lowest, self.lowest)

    @property
    def objection(self) -> str:
        """Reason why the signal is none of this machine, or an empty text."""
        if 1.0 / _ALIEN < self.gain < _ALIEN:
            return ""
        return f"`{self.name}` has {self.gain:.3g} times the orbit's range: check its unit"


def signal_fits(
    table: EventTable, found: Periodicity, begin: float, place: EventPlace
) -> tuple[SignalFit, ...]:
    """Return the fits of all signals that vary in the orbit.

    Args:
        table: The orbit by phase.
        found: The average of the signals over a cycle.
        begin: First time of the recording [s].
        place: Position of the orbit.
    """
    n = len(table.values)
    phases = (place.start.value - begin) / found.period + np.arange(n) / n
    data, units = found.average(phases), measurable(table.problem)
    fits: list[SignalFit] = []
    for k, name in enumerate(table.names):
        own = table.values[:, k]
        smooth = table.is_smooth[:, k]
        if not np.ptp(own) > 0.0 or np.count_nonzero(smooth) < 2:
            continue
        columns = np.column_stack([np.ones(n), own])[smooth]
        (offset, gain), *_ = np.linalg.lstsq(columns, data[smooth, k], rcond=None)
        error = float(np.std(data[smooth, k] - columns @ (offset, gain)))
        ends = [
            Estimate(value=float(offset + gain * one), error=error)
            for one in (np.max(own), np.min(own))
        ]
        fits.append(
            SignalFit(
                name=name,
                unit=units[name],
                highest=ends[0],
                lowest=ends[1],
                own_highest=float(np.max(own)),
                own_lowest=float(np.min(own)),
                gain=float(gain),
            )
        )
    return tuple(fits)


def contradictions(
    table: EventTable,
    recording: Recording,
    names: Sequence[str],
    seen: SeenEvents,
    channels: Mapping[str, Vector],
) -> tuple[str, ...]:
    """Return the stops whose channel shows contact although their gap is open.

    A stop whose gap depends on coordinates that were not recorded is left out.

    Args:
        table: The orbit by phase.
        recording: The recording.
        names: Names of the recorded states and outputs.
        seen: The contacts of the channels.
        channels: Contact channels by the name of their stop.
    """
    problem, orbit = table.problem, table.orbit
    graph = problem.graph_dynamics(orbit.values(problem))
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
