r"""Deviations of a recorded cycle from an orbit's, phase by phase, with their errors.

What is averaged over the cycles are the deviations :math:`r = y - Y(\varphi)`, in bins of the
phase, not the signals: they vary little within a bin, so a bin blurs nothing. Errors are those of
the jackknife over groups of cycles, or of samples where there are few cycles: a number computed
with each group left out, :math:`u^2 = \frac{G-1}{G} \sum_g (\theta_g - \bar\theta)^2`
(theory (57)).

Numbers of the deviations of a recording from an orbit: sizes, extremes, delays, distances.

Source: theory (57).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.alignment import Alignment
from zeno_orbits.experiment.orbit_table import OrbitTable, beside_jumps, jump_width

N_BINS = 240
"""Bins of the phase."""
_FINE = 12
"""Points of the orbit in a bin."""
_MOST_GROUPS = 40
_FEW_CYCLES = 4
_PIECE = 1 << 20
"""Samples that are folded at a time."""
_SLOPE = 2
"""Bins on either side that tell the slope of a deviation."""
LEVER = math.sqrt(sum(2.0 * k * k for k in range(1, _SLOPE + 1)))
"""Noise of such a slope, in noises of a bin over its length, inverted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A number and its standard error."""

    value: float
    error: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Deviations:
    """Deviations of a record from an orbit, by phase.

    Attributes:
        table: The orbit.
        period: Of the record [s].
        sums: Of the deviations in each group and bin, ``(n_groups, N_BINS, n_s)``.
        squares: Of their squares, alike.
        counts: How many there are, alike.
        by_cycles: Whether the groups are cycles, or samples of few cycles.
    """

    table: OrbitTable
    period: float
    sums: Vector
    squares: Vector
    counts: Vector
    by_cycles: bool

    @property
    def phases(self) -> Vector:
        """Middle of each bin, ``(N_BINS,)``."""
        return (np.arange(N_BINS) + 0.5) / N_BINS

    @cached_property
    def fine(self) -> Vector:
        """The orbit's signals in each bin, ``(N_BINS, _FINE + 1, n_s)``."""
        places = (np.arange(N_BINS)[:, None] + np.linspace(0, 1 - 1e-9, _FINE + 1)) / N_BINS
        return self.table.at(places.ravel()).reshape(N_BINS, _FINE + 1, -1)

    @cached_property
    def orbit(self) -> Vector:
        """The orbit's signals in the middle of each bin, ``(N_BINS, n_s)``."""
        return self.table.at(self.phases)

    @cached_property
    def average(self) -> Vector:
        """Mean deviation in each bin, NaN where nothing was recorded, ``(N_BINS, n_s)``."""
        return self._mean(self.sums.sum(axis=0), self.counts.sum(axis=0))

    @cached_property
    def spread(self) -> Vector:
        """Standard deviation of the deviations in each bin, ``(N_BINS, n_s)``."""
        count = self.counts.sum(axis=0)
        square = self._mean(self.squares.sum(axis=0), count)
        return np.sqrt(np.maximum(square - self.average**2, 0.0))

    @cached_property
    def noise(self) -> Vector:
        """Standard error of the mean deviation of a bin, typical of each signal, ``(n_s,)``."""
        counts = self.counts.sum(axis=0)
        square = np.where(counts > 1.5, self.spread**2 / np.maximum(counts - 1.0, 1.0), np.nan)
        known = np.isfinite(square).any(axis=0)
        mean = np.nanmean(np.where(known, square, 0.0), axis=0)
        return np.where(known, np.sqrt(mean), 0.0)

    def sizes_in_turn(self) -> Vector:
        """Return how far each cycle is from the middle one of all, if each is a group."""
        if not self.by_cycles or len(self.sums) >= _MOST_GROUPS:
            return np.zeros(0)
        each = self._mean(self.sums, self.counts)
        known = np.isfinite(each).all(axis=(0, 2))
        if not known.any():
            return np.zeros(0)
        each = each[:, known]
        size = np.ptp(self.orbit[:, : each.shape[2]], axis=0)
        around = (each - np.median(each, axis=0)) / np.where(size > 0.0, size, 1.0)
        return np.sqrt(np.mean(around**2, axis=(1, 2)))

    def estimate(self, number: Callable[[Vector], float]) -> Estimate:
        """Return a number of the mean deviations and its error by the jackknife.

        Args:
            number: From mean deviations ``(N_BINS, n_s)`` to the number.
        """
        return self.estimates(lambda average: (number(average),))[0]

    def estimates(self, numbers: Callable[[Vector], Sequence[float]]) -> tuple[Estimate, ...]:
        """Return several numbers of the mean deviations and their errors by the jackknife."""
        values = numbers(self.average)
        sums, counts = self.sums.sum(axis=0), self.counts.sum(axis=0)
        n = len(self.sums)
        left = np.array(
            [numbers(self._mean(sums - self.sums[g], counts - self.counts[g])) for g in range(n)]
        )
        around = np.sum((left - left.mean(axis=0)) ** 2, axis=0)
        errors = np.sqrt((n - 1) / n * around) if n > 1 else np.full(len(values), np.nan)
        return tuple(
            Estimate(value=float(value), error=float(error))
            for value, error in zip(values, errors, strict=True)
        )

    def portrait(self, pair: Sequence[int], rate_of: int | None) -> Vector:
        """Return the mean recorded cycle in the plane of two signals, ``(N_BINS, 2)``.

        Args:
            pair: Numbers of the signals.
            rate_of: The signal whose slope stands for the second one, if that was not recorded.
        """
        return self.points(self.average, pair, rate_of)

    def points(self, average: Vector, pair: Sequence[int], rate_of: int | None) -> Vector:
        """Return a cycle of given mean deviations in the plane of two signals, ``(N_BINS, 2)``."""
        points = self.orbit[:, list(pair)]
        points[:, 0] += average[:, pair[0]]
        if rate_of is None:
            points[:, 1] += average[:, pair[1]]
            return points
        slopes = _slopes(average[:, rate_of], self.period / N_BINS)
        points[:, 1] = self.table.period / self.period * points[:, 1] + slopes
        return points

    @staticmethod
    def _mean(sums: Vector, counts: Vector) -> Vector:
        return np.where(counts > 0.5, sums / np.maximum(counts, 1.0), np.nan)


def deviations(table: OrbitTable, time: Vector, values: Vector, where: Alignment) -> Deviations:
    """Return how a record deviates from an orbit.

    Args:
        table: The orbit, its first signals in the order of the rows.
        time: Increasing, ``(n_t,)`` [s].
        values: One row a signal, ``(n_s, n_t)``, NaN where one was not taken.
        where: Where the orbit is in the record.
    """
    width = jump_width(where.phase_error)
    first = math.floor((time[0] - where.release) / where.period)
    n_cycles = math.floor((time[-1] - where.release) / where.period) - first + 1
    by_cycles = n_cycles > _FEW_CYCLES
    n_groups = min(n_cycles, _MOST_GROUPS) if by_cycles else 8
    n_s = len(values)
    sums, squares, counts = (np.zeros((n_groups * N_BINS, n_s)) for _ in range(3))
    for at in range(0, len(time), _PIECE):
        piece = slice(at, at + _PIECE)
        phases = where.phases(time[piece])
        cycles = np.floor(phases)
        inside = phases - cycles
        rest = values[:, piece].T - table.at(inside)[:, :n_s]
        rest[beside_jumps(table, inside, width)[:, :n_s]] = np.nan
        number = cycles - first if by_cycles else np.arange(at, at + len(phases))
        bins = np.minimum((inside * N_BINS).astype(np.int64), N_BINS - 1)
        places = np.mod(number, n_groups).astype(np.int64) * N_BINS + bins
        for k in range(n_s):
            seen = np.isfinite(rest[:, k])
            here, r = places[seen], rest[seen, k]
            counts[:, k] += np.bincount(here, minlength=len(counts))
            sums[:, k] += np.bincount(here, weights=r, minlength=len(counts))
            squares[:, k] += np.bincount(here, weights=r**2, minlength=len(counts))
    shape = (n_groups, N_BINS, n_s)
    return Deviations(
        table=table,
        period=where.period,
        sums=sums.reshape(shape),
        squares=squares.reshape(shape),
        counts=counts.reshape(shape),
        by_cycles=by_cycles,
    )


def _slopes(row: Vector, step: float) -> Vector:
    """Return the slopes of a periodic row by straight lines through neighbours."""
    above = np.zeros_like(row)
    for k in range(1, _SLOPE + 1):
        above += k * (np.roll(row, -k) - np.roll(row, k))
    return above / (LEVER**2 * step)


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
    """Return the highest or lowest value of a signal over the cycle.

    Args:
        found: The deviations.
        signal: Its number.
        sign: 1 for the highest, -1 for the lowest.
    """
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
