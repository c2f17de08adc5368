r"""Impacts and noise that a recording shows by itself, without a model.

The noise of a channel follows from its third differences, which vanish along a parabola. An impact
is a minimum of the gap near the stop, whose prominence exceeds the noise of a moving average. Its
time is the intersection of two one-sided parabolas.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.model import GraphDynamics

_PROMINENCE = 8.0
"""Standard deviations of the smoothed gap by which an impact stands out."""
_HEIGHT = 6.0
"""Standard deviations of the gap above the stop within which an impact may be sampled."""
_FLOOR = 1e-6
"""Least noise of a channel, relative to its range: files have finitely many digits."""
_AGAIN = 3
"""Further searches for impacts between slower and slower flights."""
_RESTS, _HALF, _HELD = 2e-3, 0.5, 0.15
"""Parts of the range of a channel that rests and of one that moves, and the part of the time until
then for which a channel was held."""
_FAR = 1e-4
"""Step of a state, relative to its scale, that shows whether the gap depends on it."""


def noise_of(values: Vector) -> float:
    """Return the standard deviation of the noise of a channel, by its third differences.

    Args:
        values: Samples, NaN where one is missing, ``(n,)``.
    """
    known = values[np.isfinite(values)]
    size = float(np.ptp(known)) if len(known) else 0.0
    if len(known) < 8:
        return max(_FLOOR * size, 1e-300)
    third = np.diff(known, 3)
    middle = float(np.median(np.abs(third - np.median(third))))
    return max(1.4826 * middle / np.sqrt(20.0), _FLOOR * size, 1e-300)


def recorded_gaps(
    graph: GraphDynamics, start: Vector, columns: dict[int, Vector]
) -> dict[str, Vector]:
    """Return the gaps of the stops that depend on recorded states alone, ``(n,)`` per stop.

    Args:
        graph: The machine at the initial values of the fit.
        start: Initial state, which stands for states that do not matter, ``(n_x,)``.
        columns: Index of a state to its samples.
    """
    found: dict[str, Vector] = {}
    if not columns or not graph.stop_names:
        return found
    n = len(next(iter(columns.values())))
    states = np.tile(start, (n, 1))
    for k, row in columns.items():
        states[:, k] = row
    for name, view in zip(graph.stop_names, graph.open_views, strict=True):
        if needed_states(view.gap, start) <= set(columns):
            found[name] = np.array(
                [view.gap(x) if np.isfinite(x).all() else np.nan for x in states]
            )
    return found


def needed_states(gap: Callable[[Vector], float], start: Vector) -> set[int]:
    """Return the indices of the states that a gap depends on."""
    here, needed = float(gap(start)), set[int]()
    for k in range(len(start)):
        other = start.copy()
        other[k] += _FAR * max(abs(start[k]), 1.0)
        if float(gap(other)) != here:
            needed.add(k)
    return needed


def impacts_in_gap(time: Vector, gap: Vector) -> Vector:
    """Return the times of the impacts that a recorded gap shows [s].

    Args:
        time: Increasing times, ``(n,)`` [s].
        gap: The gap, NaN where a sample is missing, ``(n,)``.
    """
    from scipy.signal import find_peaks

    known = np.isfinite(gap)
    time, gap = time[known], gap[known]
    if len(gap) < 12:
        return np.zeros(0)
    noise = noise_of(gap)
    speed = float(np.quantile(np.abs(np.diff(gap[::3])), 0.98)) / 3 + 1e-300
    width = int(np.clip(2 * round(((4 * noise / speed) ** (2 / 3) - 1) / 2) + 1, 1, 15))
    smooth = np.convolve(np.pad(gap, width // 2, "edge"), np.ones(width) / width, "valid")
    zero = float(np.quantile(gap, 0.02))
    peaks, _ = find_peaks(-smooth, prominence=_PROMINENCE * noise / np.sqrt(width))
    near = [
        int(i)
        for i in peaks
        if smooth[i] < zero + _HEIGHT * noise + 1.2 * _fall(smooth, int(i), float(np.ptp(gap)))
    ]
    step = float(np.median(np.diff(time)))
    return np.array([_refined(time, gap, near, j, width, step) for j in range(len(near))])


def all_impacts(time: Vector, gap: Vector) -> Vector:
    """Return the times of the impacts that a recorded gap shows, those between slow flights too.

    Slow flights bear a wider moving average, so the rest after the last impact is searched again.

    Args:
        time: Increasing times, ``(n,)`` [s].
        gap: The gap, NaN where a sample is missing, ``(n,)``.
    """
    found = impacts_in_gap(time, gap)
    step = float(np.median(np.diff(time)))
    for _ in range(_AGAIN):
        flights = np.diff(found)
        if len(flights) < 2 or not flights[-1] < 0.98 * flights[-2]:
            return found
        ratio = float(np.clip(flights[-1] / flights[-2], 0.3, 0.95))
        left = flights[-1] * ratio / (1.0 - ratio)
        rows = (time > found[-1] + 1.5 * step) & (time < found[-1] + 1.3 * left)
        more = impacts_in_gap(time[rows], gap[rows])
        if not len(more):
            return found
        found = np.concatenate([found, more])
    return found


def _fall(smooth: Vector, i: int, size: float) -> float:
    """Return by how much the gap falls within one sample at a minimum."""
    after = smooth[min(i + 1, len(smooth) - 1)] - smooth[i]
    return float(max(abs(after), abs(smooth[i] - smooth[i - 1]), 0.01 * size))


def _refined(time: Vector, gap: Vector, near: list[int], j: int, width: int, step: float) -> float:
    """Return the time of a minimum, by one-sided parabolas before and after it."""
    i = near[j]
    a = near[j - 1] if j else 0
    b = near[j + 1] if j + 1 < len(near) else min(len(gap) - 1, i + (i - a))
    before = slice(max(a + 1, i - max(4, int(0.45 * (i - a)))), i)
    after = slice(i + 1, i + 1 + max(4, int(0.45 * (b - i))))
    at = float(time[i])
    if len(time[before]) < 4 or len(time[after]) < 4:
        return at
    apart = np.polyfit(time[after] - at, gap[after], 2) - np.polyfit(
        time[before] - at, gap[before], 2
    )
    roots = np.roots(apart)
    real = roots[np.isreal(roots)].real
    real = real[np.abs(real) < 2.5 * max(1.0, width / 2) * step]
    return at + (float(real[np.argmin(np.abs(real))]) if len(real) else 0.0)


def beside_impacts(time: Vector, impacts: Vector, step: float) -> NDArray[np.bool_]:
    """Return the mask of samples beside seen impacts, where a velocity shows only which side it is.

    The mask reaches 1.5 sampling times before and 2 after an impact, and from the last flight of
    four samples to the end of the chatter that the flights predict.

    Args:
        time: ``(n,)`` [s].
        impacts: Times of the seen impacts in order, ``(k,)`` [s].
        step: Sampling time [s].
    """
    since = time[:, None] - impacts[None, :]
    masked = np.any((since > -1.5 * step) & (since < 2.0 * step), axis=1)
    flights = np.diff(impacts)
    for k in np.flatnonzero(flights[:-1] > 1.5 * flights[1:]).tolist():
        last = k + 2
        ends = last + 1 == len(impacts) or flights[last] > 1.5 * flights[last - 1]
        if ends:
            ratio = min(flights[k + 1] / flights[k], 0.95)
            left = flights[k + 1] * ratio / (1.0 - ratio)
            masked |= (time > impacts[last]) & (time < impacts[last] + 1.3 * left)
    return np.asarray(masked, dtype=np.bool_)


def rest_begins(time: Vector, values: Vector) -> float | None:
    """Return the time from which all channels rest, or ``None`` if they move to the end.

    Args:
        time: ``(n,)`` [s].
        values: Channels, ``(n, n_s)``.
    """
    latest = -np.inf
    for row in values.T:
        known = np.isfinite(row)
        if known.sum() < 20:
            return None
        size, noise = float(np.ptp(row[known])), noise_of(row)
        end = float(np.median(row[known][-max(len(row) // 50, 5) :]))
        moving = np.flatnonzero(known & (np.abs(row - end) > max(8.0 * noise, 2e-3 * size)))
        if len(moving):
            latest = max(latest, float(time[moving[-1]]))
    span = float(time[-1] - time[0])
    return latest if latest < time[-1] - 0.03 * span and np.isfinite(latest) else None


def held_until(time: Vector, values: Vector) -> float | None:
    r"""Return the time until which all channels rest, or ``None`` if they move from the beginning.

    A channel that leaves its rest at `h` with a constant acceleration crosses the part `f` of its
    range at :math:`h + \sqrt{f}\,T`. Two crossings give `h`.

    Args:
        time: ``(n,)`` [s].
        values: Channels, ``(n, n_s)``.
    """
    found: list[float] = []
    for row in values.T:
        known = np.isfinite(row)
        t, away = time[known], row[known]
        if len(t) < 20 or not np.ptp(away) > 0.0:
            continue
        size = float(np.ptp(away))
        part = max(8.0 * noise_of(row) / size, _RESTS)
        if part > _HALF / 2:
            return None
        away = np.abs(away - float(np.median(away[:5]))) / size
        # A single wild sample is no motion.
        leaves, half = (
            float(t[int(np.argmax((away > one) & (np.roll(away, -1) > one)))])
            for one in (part, _HALF)
        )
        low, high = np.sqrt(part), np.sqrt(_HALF)
        begin = (high * leaves - low * half) / (high - low)
        if begin - t[0] < max(_HELD * (half - t[0]), 4.0 * float(np.median(np.diff(t)))):
            return None
        found.append(begin)
    return min(found, default=None)
