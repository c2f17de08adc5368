"""A recording folded into one period: samples by phase, or few means of very many of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.alignment import Alignment
from zeno_orbits.experiment.orbit_table import ROUGHLY, PeriodTable, beside_jumps, in_layers

MOST = 40_000
"""Largest number of samples that are kept. More samples are averaged in bins."""
_GATHERED = 400
"""Bins of the phase that more samples are gathered in, for each group of cycles."""
MOST_GROUPS = 60
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(3)
"""Quadrature nodes of a mean over a stretch, exact for polynomials of degree five."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fold:
    """An orbit at the phases of samples.

    Attributes:
        times: Times since the release, ``(n,)`` [s].
        values: Its signals, ``(n, n_s)``.
        slopes: Their time derivatives, ``(n, n_s)``.
    """

    times: Vector
    values: Vector
    slopes: Vector


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Folded:
    """Samples by phase.

    Attributes:
        phases: Phases in periods since the release, in [0, 1), ``(n,)``.
        values: Values of the signals, ``(n, n_s)``.
        counts: Number of samples in each mean value, ``(n, n_s)``.
        seen: Mask of the values that have samples and count, ``(n, n_s)``.
        groups: Index of the cycle, or of the group of cycles, of each row, ``(n,)``.
        turns: Mean index of the cycle, counted from the middle of the recording, ``(n,)``.
        span: Length of the stretch averaged in a value, in periods. It is 0 for a single sample.
        clocks: 0 for the rows of a first file, and 1 for those of a second file on another clock,
            which has its own channels, ``(n,)``. ``None`` for a single file.
        slower: Ratio of the second file's period to the one at which it was folded.
    """

    phases: Vector
    values: Vector
    counts: Vector
    seen: NDArray[np.bool_]
    groups: NDArray[np.int64]
    turns: Vector
    span: float | Vector = 0.0
    clocks: NDArray[np.int64] | None = None
    slower: float = 1.0

    @property
    def n_clocks(self) -> int:
        """Number of files, each with its clock."""
        return 1 if self.clocks is None else 2

    @property
    def n_groups(self) -> int:
        """Number of cycles, or of groups of cycles."""
        return int(self.groups.max()) + 1

    def stretched(self, *factors: float) -> Folded:
        """Return the samples by the phases of periods that are longer by factors, one per clock."""
        by = np.array(factors)[0 if self.clocks is None else self.clocks]
        phases = (self.turns + self.phases) / by - self.turns
        return replace(self, phases=np.mod(phases, 1.0), slower=self.slower * factors[-1])

    def part(self, clock: int) -> Folded:
        """Return the rows and channels of one clock."""
        if self.clocks is None:
            return self
        rows, channels = self._own(clock)
        groups, span = self.groups[rows], np.broadcast_to(self.span, len(rows))[rows]
        return Folded(
            phases=self.phases[rows],
            values=self.values[rows][:, channels],
            counts=self.counts[rows][:, channels],
            seen=self.seen[rows][:, channels],
            groups=groups - groups.min(initial=self.n_groups),
            turns=self.turns[rows],
            span=span if np.any(span) else 0.0,
        )

    def entries(self, clock: int, values: Vector) -> Vector:
        """Return the entries of `part` among values of all samples, ``(n n_s, ...)``."""
        if self.clocks is None:
            return values
        rows, channels = self._own(clock)
        whole = values.reshape(*self.values.shape, *values.shape[1:])
        return whole[rows][:, channels].reshape(-1, *values.shape[1:])

    def _own(self, clock: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        rows = self.clocks == clock
        return rows, np.any(self.counts[rows] > 0.0, axis=0)

    def late(self, delay: float) -> float | Vector:
        """Return the further shift of the rows of a second clock, in periods."""
        return 0.0 if self.clocks is None else delay * self.clocks.astype(np.float64)

    def without_jumps(self, table: PeriodTable) -> Folded:
        """Return the samples away from jumps and layers of an orbit with roughly equal phases."""
        steep = beside_jumps(table, self.phases, ROUGHLY) | in_layers(table, self.phases, ROUGHLY)
        return self.without(steep)

    def without(self, left_out: NDArray[np.bool_]) -> Folded:
        """Return it without some of its values, ``(n, n_s)``."""
        return replace(self, seen=self.seen & ~left_out)

    def predicted(self, table: PeriodTable, shift: float | Vector) -> Fold:
        """Return the predictions of an orbit for the samples, or for their means.

        Args:
            table: The orbit.
            shift: Delay of the orbit, in periods, of each row or of all.
        """
        phases = self.phases - shift
        times = np.mod(phases, 1.0) * table.period
        values, slopes = table.nodes.with_slopes(times)
        if np.any(self.span):
            values = self._mean(table, phases, 1)
        return Fold(times=times, values=values, slopes=slopes)

    def bends(self, table: PeriodTable, shift: float | Vector) -> Vector:
        """Return the uncertainty of the predicted means of a signal that is curved within a bin."""
        if not np.any(self.span):
            return np.zeros_like(self.values)
        phases = self.phases - shift
        return np.abs(self._mean(table, phases, 2) - self._mean(table, phases, 1))

    def _mean(self, table: PeriodTable, phases: Vector, parts: int) -> Vector:
        """Return the mean of the signals over each stretch, cut into parts, ``(n, n_s)``."""
        total = np.zeros_like(self.values)
        for part in range(parts):
            centre = (part + 0.5) / parts - 0.5
            for point, weight in zip(_POINTS, _WEIGHTS, strict=True):
                here = phases + self.span * (centre + 0.5 * point / parts)
                total += weight / (2 * parts) * table.at(here)
        return total


def folded_together(first: Folded, second: Folded) -> Folded:
    """Return the samples of two files on their own clocks, each with its own channels."""
    n, n_s = first.values.shape
    m, m_s = second.values.shape
    blocks = {
        name: np.block([[one, np.zeros((n, m_s))], [np.zeros((m, n_s)), other]])
        for name in ("values", "counts", "seen")
        for one, other in [(getattr(first, name), getattr(second, name))]
    }
    spans = np.concatenate([np.broadcast_to(one.span, len(one.phases)) for one in (first, second)])
    return Folded(
        phases=np.concatenate([first.phases, second.phases]),
        values=blocks["values"],
        counts=blocks["counts"],
        seen=blocks["seen"] > 0.5,
        groups=np.concatenate([first.groups, second.groups + first.n_groups]),
        turns=np.concatenate([first.turns, second.turns]),
        span=spans if np.any(spans) else 0.0,
        clocks=np.repeat(np.array([0, 1]), [n, m]),
    )


def folded(
    time: Vector, values: Vector, where: Alignment, *, most: int = MOST, least_bins: int = _GATHERED
) -> Folded:
    """Return a recording folded by its own period.

    Args:
        time: Increasing times, ``(n_t,)`` [s].
        values: One row per signal, ``(n_s, n_t)``. A missing sample is NaN.
        where: Alignment of the recording.
        most: Largest number of samples that are kept. More samples are averaged in bins.
        least_bins: Number of phase bins per group of cycles if samples are averaged.
    """
    whole = where.phases(time)
    cycles = np.floor(whole).astype(np.int64)
    first = int(cycles[0])
    if len(time) <= most:
        seen = np.isfinite(values.T)
        return Folded(
            phases=whole - cycles,
            values=np.where(seen, values.T, 0.0),
            counts=seen.astype(np.float64),
            seen=seen,
            groups=cycles - first,
            turns=cycles.astype(np.float64),
        )
    n_cycles = int(cycles[-1]) - first + 1
    n_groups = min(n_cycles, MOST_GROUPS)
    groups = (cycles - first) * n_groups // n_cycles
    n_bins = max(least_bins, math.ceil(MOST / n_groups / 2))
    places = groups * n_bins + np.minimum(((whole - cycles) * n_bins).astype(np.int64), n_bins - 1)
    n = n_groups * n_bins
    count = np.bincount(places, minlength=n)
    phases, turns = (
        np.bincount(places, weights=row, minlength=n) / np.maximum(count, 1)
        for row in (whole - cycles, cycles)
    )
    means, counts = [np.zeros((n, len(values))) for _ in range(2)]
    for k, row in enumerate(values):
        known = np.isfinite(row)
        counts[:, k] = np.bincount(places[known], minlength=n)
        sums = np.bincount(places[known], weights=row[known], minlength=n)
        means[:, k] = sums / np.maximum(counts[:, k], 1.0)
    kept = count > 0
    return Folded(
        phases=phases[kept],
        values=means[kept],
        counts=counts[kept],
        seen=counts[kept] > 0.5,
        groups=np.arange(n)[kept] // n_bins,
        turns=turns[kept],
        span=1.0 / n_bins,
    )
