"""The stop as a recorded gap shows it: the level at which the gap rests, and the noise there.

Source: theory (56).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.alignment import Alignment

_BAND = 5.0
"""A gap within so many standard deviations of the noise counts as closed."""
_FINEST = 1e-4
"""The same for a record without noise, in parts of the range of the gap."""
_LOW = 0.2
"""The level of the stop is looked for in this part of the range above the lowest gap."""
_RESTING = 0.05
"""Part of the samples that rest at the stop at least, for a level to be seen."""
_WIDENED = 8
"""Times that the noise is looked for: samples at rest a long time begin as a slice of it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop:
    """The stop as a recorded gap shows it.

    Attributes:
        level: Gap at rest; what it is off zero is an offset of the instruments.
        noise: Standard deviation of the gap there.
        band: A gap this near to the level counts as closed.
    """

    level: float
    noise: float
    band: float


def stop_level(gap: Vector) -> Stop | None:
    """Return the level at which a gap rests, or nothing if it rests nowhere.

    Args:
        gap: The gap in order of time, NaN where it was not taken.
    """
    seen = gap[np.isfinite(gap)]
    if len(seen) < 50:
        return None
    low, high = (float(v) for v in np.quantile(seen, [0.002, 0.998]))
    extent = high - low
    if not extent > 0.0:
        return None
    candidates = np.sort(seen[(seen < low + _LOW * extent)])
    needed = max(int(_RESTING * len(seen)), 10)
    if len(candidates) <= needed:
        return None
    widths = candidates[needed:] - candidates[:-needed]
    at = int(np.argmin(widths))
    core = candidates[at : at + needed + 1]
    level, width = float(np.median(core)), float(widths[at])
    noise = _noise(gap, seen, level, width, extent)
    for _ in range(3):
        inside = seen[np.abs(seen - level) < _BAND * noise]
        if len(inside) > needed:
            level = float(np.mean(inside[np.abs(inside - level) < 2.5 * noise]))
    return Stop(level=level, noise=noise, band=max(_BAND * noise, _FINEST * extent))


def _noise(gap: Vector, seen: Vector, level: float, width: float, extent: float) -> float:
    """Return the scatter of neighbours near a level: whatever moves slowly besides is no noise."""
    noise, reach = width / 8, max(3 * width, _FINEST * extent)
    for _ in range(_WIDENED):
        near = np.abs(gap - level) < max(reach, _BAND * noise)
        triples = near[:-2] & near[1:-1] & near[2:]
        second = (gap[1:-1] - (gap[:-2] + gap[2:]) / 2)[triples]
        if len(second):
            noise = max(noise, 1.4826 * float(np.median(np.abs(second))) / math.sqrt(1.5))
    steps = np.abs(np.diff(seen))
    quantum = float(np.min(steps[steps > 1e-9 * extent], initial=math.inf))
    if math.isfinite(quantum) and np.mean(steps <= 1e-9 * extent) > 0.2:
        # An encoder: its values repeat, and their scatter hides in the last digit.
        noise = max(noise, quantum / math.sqrt(12.0))
    return noise


def refined_stop(
    time: Vector, gap: Vector, stop: Stop, rests: Sequence[tuple[float, float]], where: Alignment
) -> Stop:
    """Return the stop as the early half of every rest shows it, far from where the gap opens.

    Args:
        time: Increasing, ``(n_t,)`` [s].
        gap: ``(n_t,)``.
        stop: A first value.
        rests: When each cycle is seen to rest with it, from and to, since its release [s].
        where: Where the orbit is in the record.
    """
    if not rests:
        return stop
    start, end = (float(np.median(times)) for times in zip(*rests, strict=True))
    since = np.mod(time - where.release, where.period)
    early = (since > start + 0.1 * (end - start)) & (since < start + 0.5 * (end - start))
    resting = gap[early & (np.abs(gap - stop.level) < 2 * stop.band)]
    if len(resting) < 10:
        return stop
    level, noise = float(np.mean(resting)), max(float(np.std(resting)), 0.3 * stop.noise)
    finest = stop.band if stop.band > _BAND * stop.noise else 0.0
    return Stop(level=level, noise=noise, band=max(_BAND * noise, finest))
