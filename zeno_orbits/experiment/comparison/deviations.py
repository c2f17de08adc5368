r"""Deviations of a recorded cycle from an orbit's, phase by phase, with their errors.

The average over the cycles is taken of the deviations :math:`r = y - Y(\varphi)`, in bins of the
phase, and not of the signals. Deviations vary little within a bin, so a bin blurs nothing. Errors
are jackknife estimates over groups of cycles, or over groups of samples if the cycles are few. A
value is computed with each group left out, and
:math:`u^2 = \frac{G-1}{G} \sum_g (\theta_g - \bar\theta)^2` is multiplied by Student's factor for
`G` groups (theory (6.10)).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.alignment import Alignment
from zeno_orbits.experiment.comparison.estimate import Estimate, step_of
from zeno_orbits.experiment.orbit_table import PeriodTable, beside_jumps, jump_width

N_BINS = 240
"""Bins of the phase."""
FINE = 12
"""Points of the orbit in a bin."""
_MOST_GROUPS = 40
_FEW_CYCLES = 4
_WHOLE = 0.5
"""Part of its bins that a cycle shows at least, to be held against the others."""
_PIECE = 1 << 20
"""Samples that are folded at a time."""
_INSIDE = 0.975
"""Probability below the upper end of an interval of 95 %."""
_SLOPE = 2
"""Number of bins on either side that determine the slope of a deviation."""
LEVER = math.sqrt(sum(2.0 * k * k for k in range(1, _SLOPE + 1)))
"""Noise of such a slope, in noises of a bin over its length, inverted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Portrait:
    """A plane in which a recorded cycle can be drawn.

    Attributes:
        signals: Names of the signals on both axes.
        rate_of: The recorded signal whose slope replaces the second signal, or an empty string if
            the second signal was recorded.
    """

    signals: tuple[str, str]
    rate_of: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Deviations:
    """Deviations of a record from an orbit, by phase.

    Attributes:
        table: The orbit.
        period: Period of the record [s].
        sums: Sums of the deviations in each group and bin, ``(n_groups, N_BINS, n_s)``.
        squares: Sums of the squared deviations, in the same shape.
        counts: Numbers of the deviations, in the same shape.
        by_cycles: Whether the groups are cycles, or samples of few cycles.
        rounding: Largest rounding error of each signal, half its step, ``(n_s,)``.
    """

    table: PeriodTable
    period: float
    sums: Vector
    squares: Vector
    counts: Vector
    by_cycles: bool
    rounding: Vector

    @property
    def phases(self) -> Vector:
        """Middle of each bin, ``(N_BINS,)``."""
        return (np.arange(N_BINS) + 0.5) / N_BINS

    @cached_property
    def fine(self) -> Vector:
        """The orbit's signals in each bin, ``(N_BINS, FINE + 1, n_s)``."""
        places = (np.arange(N_BINS)[:, None] + np.linspace(0, 1 - 1e-9, FINE + 1)) / N_BINS
        return self.table.at(places.ravel()).reshape(N_BINS, FINE + 1, -1)

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

    @cached_property
    def noises(self) -> Vector:
        """Standard error of the mean deviation of each bin, ``(N_BINS, n_s)``.

        The variance of a sample is estimated from all bins together. A bin without samples counts
        as a bin with a single sample.
        """
        counts = self.counts.sum(axis=0)
        seen = np.where(counts > 0.5, self.spread, 0.0)
        free = np.maximum(np.sum(np.maximum(counts - 1.0, 0.0), axis=0), 1.0)
        return np.sqrt(np.sum(counts * seen**2, axis=0) / free / np.maximum(counts, 1.0))

    def sizes_in_turn(self) -> Vector:
        """Return the distance of each cycle from the median cycle, if each cycle is a group.

        Cycles with less than half of their samples are NaN, because a few bins show noise alone.
        """
        if not self.by_cycles or len(self.sums) >= _MOST_GROUPS:
            return np.zeros(0)
        each = self._mean(self.sums, self.counts)
        seen: NDArray[np.bool_] = np.asarray(np.isfinite(each).all(axis=2))
        whole = seen.mean(axis=1) > _WHOLE
        known: NDArray[np.bool_] = np.asarray(seen[whole].all(axis=0))
        if not (whole.any() and known.any()):
            return np.zeros(0)
        each = np.where(whole[:, None, None], each, np.nan)[:, known]
        size = np.ptp(self.orbit[:, : each.shape[2]], axis=0)
        around = (each - np.nanmedian(each, axis=0)) / np.where(size > 0.0, size, 1.0)
        return np.sqrt(np.mean(around**2, axis=(1, 2)))

    def estimate(self, number: Callable[[Vector], float]) -> Estimate:
        """Return a number of the mean deviations and its error by the jackknife.

        Args:
            number: Function from mean deviations ``(N_BINS, n_s)`` to the measures.
        """
        return self.estimates(lambda average: (number(average),))[0]

    def estimates(self, numbers: Callable[[Vector], Sequence[float]]) -> tuple[Estimate, ...]:
        """Return several measures of the mean deviations and their errors by the jackknife."""
        values = numbers(self.average)
        sums, counts = self.sums.sum(axis=0), self.counts.sum(axis=0)
        n = len(self.sums)
        left = np.array(
            [numbers(self._mean(sums - self.sums[g], counts - self.counts[g])) for g in range(n)]
        )
        around = np.sum((left - left.mean(axis=0)) ** 2, axis=0)
        errors = np.full(len(values), np.nan)
        if n > 1:
            # Few groups give a poor error estimate. Student's factor keeps 95 % within two errors.
            student = float(stdtrit(n - 1, _INSIDE) / ndtri(_INSIDE))
            errors = student * np.sqrt((n - 1) / n * around)
        return tuple(
            Estimate(value=float(value), error=float(error))
            for value, error in zip(values, errors, strict=True)
        )

    def columns(self, portrait: Portrait) -> tuple[list[int], int | None]:
        """Return the indices of the signals on a portrait's axes and of the slope."""
        number = self.table.measured.names.index
        axes = [number(name) for name in portrait.signals]
        return axes, number(portrait.rate_of) if portrait.rate_of else None

    def curve(self, portrait: Portrait, average: Vector | None = None) -> Vector:
        """Return the recorded cycle in the plane of a portrait, ``(N_BINS, 2)``.

        Args:
            portrait: The portrait.
            average: Mean deviations of the cycle, by default the mean over all cycles.
        """
        mean = self.average if average is None else average
        axes, rate_of = self.columns(portrait)
        points = self.orbit[:, axes]
        points[:, 0] += mean[:, axes[0]]
        if rate_of is None:
            points[:, 1] += mean[:, axes[1]]
            return points
        slopes = _slopes(mean[:, rate_of], self.period / N_BINS)
        points[:, 1] = self.table.period / self.period * points[:, 1] + slopes
        return points

    @staticmethod
    def _mean(sums: Vector, counts: Vector) -> Vector:
        return np.where(counts > 0.5, sums / np.maximum(counts, 1.0), np.nan)


def deviations(table: PeriodTable, time: Vector, values: Vector, where: Alignment) -> Deviations:
    """Return the deviations of a record from an orbit.

    Args:
        table: The orbit, its first signals in the order of the rows.
        time: Increasing times, ``(n_t,)`` [s].
        values: One row per signal, ``(n_s, n_t)``. A missing sample is NaN.
        where: Alignment of the orbit with the record.
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
        rounding=np.array([step_of(row) / 2.0 for row in values]),
    )


def deviations_between(row: Vector) -> tuple[Vector, Vector]:
    """Return a periodic row without gaps, and the difference of the values at each gap's ends.

    Args:
        row: Values, NaN where nothing was recorded, ``(n,)``. At least one value is known.
    """
    places, known = np.arange(len(row)), np.flatnonzero(np.isfinite(row))
    filled = np.interp(places, known, row[known], period=len(row))
    after = np.searchsorted(known, places) % len(known)
    apart = np.abs(row[known[after]] - row[known[after - 1]])
    return filled, np.where(np.isfinite(row), 0.0, apart)


def slope_noises(noises: Vector, step: float) -> Vector:
    """Return the standard errors of slopes of a row of bins, ``(N_BINS,)``.

    Args:
        noises: Standard error of each bin, ``(N_BINS,)``.
        step: Length of a bin.
    """
    square = np.zeros_like(noises)
    for k in range(1, _SLOPE + 1):
        square += k**2 * (np.roll(noises, -k) ** 2 + np.roll(noises, k) ** 2)
    return np.sqrt(square) / (LEVER**2 * step)


def _slopes(row: Vector, step: float) -> Vector:
    """Return the slopes of a periodic row by straight lines through neighbours."""
    above = np.zeros_like(row)
    for k in range(1, _SLOPE + 1):
        above += k * (np.roll(row, -k) - np.roll(row, k))
    return above / (LEVER**2 * step)
