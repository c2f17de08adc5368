"""Samples of a recorded gap: folded into one period, and the level at which they rest."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.alignment import Alignment
from zeno_orbits.experiment.comparison.folding import MOST_GROUPS, folded

_LOW = 0.2
"""The level is searched in this part of the range above the lowest gap."""
_RESTING = 0.05
"""Part of the samples that rest at the level at least."""
_FEWEST = 50
_BINS = 2000
"""Bins of the phase in which samples of a group of cycles are gathered, if there are more."""
_SAME = 1e-3
"""Phases that differ by less than this part of a period show the same."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GapSamples:
    """Samples of a gap by the time since the release.

    Attributes:
        since: Times since the release, in [0, period), ``(n,)`` [s].
        gap: ``(n,)``.
        counts: Number of samples in each mean, ``(n,)``.
        groups: Number of the cycle, or group of cycles, of each, ``(n,)``.
        period: [s].
    """

    since: Vector
    gap: Vector
    counts: Vector
    groups: NDArray[np.int64]
    period: float

    def chosen(self, which: NDArray[np.bool_]) -> GapSamples:
        """Return some of the samples."""
        return replace(
            self,
            since=self.since[which],
            gap=self.gap[which],
            counts=self.counts[which],
            groups=self.groups[which],
        )

    def within(self, start: float, end: float) -> float:
        """Return the number of samples between two times since the release."""
        s = np.mod(self.since - start, self.period)
        return float(np.sum(self.counts[s < end - start]))

    def distinct(self, start: float, end: float) -> int:
        """Return at how many distinct phases the gap was sampled between two times."""
        s = np.mod(self.since - start, self.period)
        places = np.floor(s[s < end - start] / (_SAME * self.period))
        return len(np.unique(places))

    def by_phase(self, values: Vector, n: int) -> tuple[Vector, Vector]:
        """Return counts and means of values in bins of the phase, each ``(n,)``."""
        bins = np.minimum((self.since / self.period * n).astype(np.int64), n - 1)
        weight: Vector = np.bincount(bins, weights=self.counts, minlength=n).astype(np.float64)
        sums = np.bincount(bins, weights=self.counts * values, minlength=n)
        return weight, sums / np.maximum(weight, 1e-300)

    def averaged(self, n: int) -> GapSamples:
        """Return the mean cycle in bins of the phase."""
        weight, gap = self.by_phase(self.gap, n)
        since = self.by_phase(self.since, n)[1]
        kept = weight > 0.0
        return GapSamples(
            since=since[kept],
            gap=gap[kept],
            counts=weight[kept],
            groups=np.zeros(int(kept.sum()), dtype=np.int64),
            period=self.period,
        )


def gather(time: Vector, gap: Vector, where: Alignment) -> GapSamples:
    """Return a recorded gap by the time since the release.

    Args:
        time: Increasing times, ``(n_t,)`` [s].
        gap: Recorded gap, ``(n_t,)``. A missing sample is NaN, and at least some samples exist.
        where: Alignment of the orbit with the record.
    """
    seen = np.isfinite(gap)
    n_cycles = int(np.ptp(np.floor(where.phases(time[seen])))) + 1
    n_groups = min(n_cycles, MOST_GROUPS)
    most = _BINS * n_groups
    data = folded(time[seen], gap[None, seen], where, most=most, least_bins=_BINS)
    return GapSamples(
        since=data.phases * where.period,
        gap=data.values[:, 0],
        counts=data.counts[:, 0],
        groups=data.groups * n_groups // data.n_groups,
        period=where.period,
    )


def stop_level(gap: Vector) -> float | None:
    """Return the middle of the narrowest interval that holds a twentieth of all samples.

    Args:
        gap: ``(n,)``, NaN where it was not taken.

    Returns:
        Nothing if the samples are too few, or the gap does not move.
    """
    seen = gap[np.isfinite(gap)]
    if len(seen) < _FEWEST:
        return None
    low, high = (float(v) for v in np.quantile(seen, [0.002, 0.998]))
    if not high > low:
        return None
    lowest = np.sort(seen[seen < low + _LOW * (high - low)])
    needed = max(int(_RESTING * len(seen)), 10)
    if len(lowest) <= needed:
        return None
    at = int(np.argmin(lowest[needed:] - lowest[:-needed]))
    return float(np.median(lowest[at : at + needed + 1]))
