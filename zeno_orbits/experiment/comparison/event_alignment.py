"""Position of an orbit of events in a recording: the start of its period and its likeness."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.estimate import Estimate
from zeno_orbits.experiment.comparison.event_contacts import SeenEvents
from zeno_orbits.experiment.comparison.event_reference import EventTable
from zeno_orbits.experiment.recordings.recording import Recording

LIKE = 0.6
"""Least correlation of a signal with the orbit's signal."""
_STEPS = 8
"""Steps of the least-squares fit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EventPlace:
    """Position of the orbit in a recording.

    Attributes:
        start: A time at which the orbit's period starts, with its standard error [s].
        likeness: Correlation of each signal with the orbit's.
    """

    start: Estimate
    likeness: Mapping[str, float] = field(default_factory=dict[str, float])


def placed_events(
    table: EventTable,
    recording: Recording,
    names: Sequence[str],
    channels: Sequence[str],
    seen: SeenEvents,
    period: float,
    average: Callable[[Vector], Vector],
) -> EventPlace:
    """Return the position of the orbit that fits the signals best, or the edges without signals.

    Args:
        table: The orbit at even phases.
        recording: The recording.
        names: Names of the signals of `table`.
        channels: Stops with a contact channel.
        seen: The contacts of the channels.
        period: Period of the recording [s].
        average: Function from phases to the mean cycle of signals and channels there.
    """
    n = len(table.values)
    grid = np.arange(n) / n
    data = average(grid)
    closed = [seen.model_channel(stop, n) for stop in channels]
    model = np.column_stack([table.values, *closed])
    a, b = (one - one.mean(axis=0) for one in (model, data))
    size = np.linalg.norm(a, axis=0) * np.linalg.norm(b, axis=0)
    spectra = np.fft.rfft(a, axis=0) * np.conj(np.fft.rfft(b, axis=0))
    together = np.fft.irfft(spectra, n, axis=0) / np.where(size > 0.0, size, 1.0)
    shift = int(np.argmax(together.sum(axis=1)))
    time = recording.time
    start = float(time[0] - shift / n * period)
    start += period * round((0.5 * (time[0] + time[-1]) - start) / period)
    likeness = {name: float(together[shift, k]) for k, name in enumerate(names)}
    known = {name: one for name, one in likeness.items() if one > LIKE}
    if not known:
        offset = seen.offset(start, period)
        moved = Estimate(value=start + offset.value, error=offset.error)
        return EventPlace(start=moved, likeness=likeness)
    chosen = [list(names).index(name) for name in known]
    values = np.stack([recording.signal(name).values for name in known], axis=1)
    fitted = _fitted(table, chosen, time, values, start, period)
    return EventPlace(start=fitted, likeness=likeness)


def _fitted(
    table: EventTable,
    chosen: Sequence[int],
    time: Vector,
    values: Vector,
    start: float,
    period: float,
) -> Estimate:
    """Return the least-squares start of the period, without samples near jumps."""
    n, error = len(table.values), math.inf
    model = table.values[:, chosen]
    slopes = (np.roll(model, -1, axis=0) - np.roll(model, 1, axis=0)) * n / (2 * period)
    smooth = table.is_smooth[:, chosen]
    scale = np.where(np.ptp(model, axis=0) > 0.0, np.ptp(model, axis=0), np.inf)
    for _ in range(_STEPS):
        place = (time - start) / period % 1.0 * n
        low = np.minimum(place.astype(np.int64), n - 1)
        part = (place - low)[:, None]
        high = (low + 1) % n
        fitted = model[low] * (1 - part) + model[high] * part
        used = np.isfinite(values) & smooth[low] & smooth[high]
        rest = np.where(used, (values - fitted) / scale, 0.0)
        rest = np.where(used, rest - rest.sum(axis=0) / np.maximum(used.sum(axis=0), 1), 0.0)
        moved = np.where(used, -slopes[low] / scale, 0.0)
        below = float(np.sum(moved**2))
        if not below > 0.0:
            break
        late = float(np.sum(moved * rest)) / below
        error = math.sqrt(float(np.sum((moved * rest) ** 2))) / below
        start += float(np.clip(late, -0.1 * period, 0.1 * period))
    return Estimate(value=start, error=error)
