"""Numbers of the deviations of a recording from an orbit: sizes, extremes, delays, distances.

Source: theory (57).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.deviations import LEVER, N_BINS, Deviations, Estimate

Vector = NDArray[np.float64]


def root_mean_square(found: Deviations, signal: int, chosen: Vector) -> Estimate:
    """Return the size of a signal's deviation over chosen bins, that of the noise taken away.

    Args:
        found: The deviations.
        signal: Its number.
        chosen: Which bins count, ``(N_BINS,)``.
    """
    counts: Vector = found.counts.sum(axis=0)[:, signal]
    noise = found.spread[:, signal] ** 2 / np.maximum(counts - 1.0, 1.0)
    white = 0.0
    if float(np.max(counts[chosen > 0])) > 1.0:
        white = float(np.nanmean(noise[chosen > 0]))

    def size(average: Vector) -> float:
        square = float(np.nanmean(average[chosen > 0, signal] ** 2))
        return math.sqrt(max(square - white, 0.0))

    one = found.estimate(size)
    # Near zero the root hides what the square does: noise of this size is not told from nothing.
    n = max(int(np.sum(chosen > 0)), 1)
    floor = math.sqrt(white) * (2.0 / n) ** 0.25
    near_zero = one.value < 2 * floor
    return Estimate(value=one.value, error=max(one.error, floor) if near_zero else one.error)


def greatest(found: Deviations, signal: int) -> tuple[Estimate, float]:
    """Return the greatest mean deviation of a signal, with its sign, and its phase."""
    row = found.average[:, signal]
    at = int(np.nanargmax(np.abs(row)))
    one = found.estimate(lambda average: float(average[at, signal]))
    error = max(one.error, _of_many(found.noise[signal], N_BINS))
    return Estimate(value=one.value, error=error), float(found.phases[at])


def apex(found: Deviations, signal: int, sign: float) -> Estimate:
    """Return the highest (sign 1) or lowest (sign -1) value of a signal over the cycle."""
    values: Vector = sign * found.fine[:, :, signal]
    mean: Vector = values.mean(axis=1)
    own: Vector = values.max(axis=1)

    def extreme(average: Vector) -> float:
        row = sign * average[:, signal]
        # How the orbit rises within a bin tells of the recording only while both are alike there.
        within = np.where(own - mean > np.abs(row), own, mean)
        return float(sign * np.nanmax(within + row))

    one = found.estimate(extreme)
    noise = float(found.noise[signal])
    # Of many bins that are as high as each other, noise lifts the highest.
    rivals = int(np.sum(own > np.max(own) - 3 * noise))
    return Estimate(value=one.value, error=max(one.error, _of_many(noise, rivals)))


def _of_many(noise: float, n: int) -> float:
    """Return how far the greatest of many numbers is from zero by noise alone."""
    return float(noise) * math.sqrt(2.0 * math.log(max(n, 2)))


def delay(found: Deviations, signal: int) -> Estimate:
    """Return by how much later than all signals together one of them comes [s]."""
    table = found.table
    stretch = found.period / table.period

    def shift(average: Vector) -> float:
        seen = np.isfinite(average[:, signal])
        data = (found.orbit[:, signal] + average[:, signal])[seen]
        times = found.phases[seen] * table.period
        late = 0.0
        for _ in range(8):
            model, slope = table.nodes.with_slopes(np.mod(times - late, table.period))
            y, f = model[:, signal], slope[:, signal]
            f = f - f.mean()
            rest = data - y
            below = float(f @ f)
            if below == 0.0:
                return math.nan
            late -= float(f @ (rest - rest.mean())) / below
        return late * stretch

    return found.estimate(shift)


def portrait_distance(
    found: Deviations, pair: Sequence[int], rate_of: int | None
) -> tuple[Estimate, Estimate]:
    """Return mean and greatest distance of the recorded closed curve from the orbit's.

    Each axis counts in parts of the orbit's range on it. Time does not matter.

    Args:
        found: The deviations.
        pair: Numbers of the signals on both axes.
        rate_of: The signal whose slope stands for the second one, if that was not recorded.
    """
    curve = found.fine[:, :, list(pair)].reshape(-1, 2)
    size = np.ptp(curve, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    curve = curve / size

    def distances(average: Vector) -> Vector:
        points = found.points(average, pair, rate_of)
        points = points[np.all(np.isfinite(points), axis=1)] / size
        return _to_polyline(points, curve)

    def both(average: Vector) -> tuple[float, float]:
        all_distances = distances(average)
        return float(np.mean(all_distances)), float(np.max(all_distances))

    mean, largest = found.estimates(both)
    second = pair[1] if rate_of is None else rate_of
    noises = np.array([found.noise[pair[0]], found.noise[second]])
    if rate_of is not None:
        noises[1] /= LEVER * found.period / N_BINS
    # A distance is never negative: noise alone gives some.
    floor = float(np.linalg.norm(noises / size)) / math.sqrt(2.0)
    return (
        Estimate(value=mean.value, error=max(mean.error, floor)),
        Estimate(value=largest.value, error=max(largest.error, _of_many(floor, N_BINS))),
    )


def _to_polyline(points: Vector, curve: Vector) -> Vector:
    """Return the distance of each point from a closed polyline."""
    a, b = curve, np.roll(curve, -1, axis=0)
    along = b - a
    length = np.sum(along**2, axis=1)
    best = np.full(len(points), np.inf)
    for k in range(0, len(points), 64):
        p = points[k : k + 64, None, :] - a[None]
        s = np.clip(np.sum(p * along, axis=2) / np.where(length > 0.0, length, 1.0), 0.0, 1.0)
        best[k : k + 64] = np.min(np.sum((p - s[:, :, None] * along) ** 2, axis=2), axis=1)
    return np.sqrt(best)
