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
from itertools import pairwise

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.estimate import Estimate
from zeno_orbits.experiment.comparison.event_alignment import EventPlace
from zeno_orbits.experiment.comparison.event_contacts import SeenEvents
from zeno_orbits.experiment.comparison.event_reference import EventTable
from zeno_orbits.experiment.comparison.metrics import Metric, metric
from zeno_orbits.experiment.orbit_table import measurable
from zeno_orbits.experiment.recordings.periodicity import Periodicity
from zeno_orbits.experiment.recordings.recording import Recording
from zeno_orbits.model import HybridDynamics

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
        view = graph.view(graph.open_mode, graph.stop_names.index(stop.name))
        size = float(np.max(_gaps(view, states, range(len(states))), initial=0.0))
        parts = [_gaps(view, states, part) for part in _parts_of_contacts(channels[stop.name])]
        open_by = max((float(np.mean(part)) for part in parts if len(part)), key=abs, default=0.0)
        if abs(open_by) > _OPEN * size:
            found.append(
                f"the contact `{stop.name}` is 1 at a mean gap of {open_by:.3g}, and the largest "
                f"gap is {size:.3g}: channel and signals contradict each other"
            )
    return tuple(found)


def _parts_of_contacts(channel: Vector) -> list[list[int]]:
    """Return the samples in the first, the middle and the last tenth of the longest contacts."""
    on = channel == 1.0
    turns = [0, *(np.flatnonzero(on[1:] != on[:-1]) + 1).tolist(), len(on)]
    spans = [(a, b) for a, b in pairwise(turns) if on[a]]
    longest = max((b - a for a, b in spans), default=0)
    parts: list[list[int]] = [[], [], []]
    for a, b in spans:
        tenth = (b - a) // 10
        if b - a > longest / 2 and tenth:
            for part, first in zip(parts, (a, (a + b - tenth) // 2, b - tenth), strict=True):
                part += range(first, first + tenth)
    return parts


def _gaps(view: HybridDynamics, states: Vector, places: Sequence[int]) -> Vector:
    """Return the known gaps at evenly spaced places, at most twice as many as a mean gap needs."""
    chosen = places[:: max(len(places) // _SAMPLES, 1)]
    values = np.array([view.gap(states[k]) for k in chosen])
    return values[np.isfinite(values)]
