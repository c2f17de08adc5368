r"""Test that all cycles of a recording give the same parameters, as in a settled machine.

Parts `A` and `B` of the cycles, with gradients :math:`g = \sum J^\top r` and information
:math:`H = \sum J^\top J` of their own, would each move the fitted unknowns by
:math:`\delta = -H^{-1} g`, and

.. math:: T^2 = (\delta_A - \delta_B)^\top (\varphi^2 (H_A^{-1} + H_B^{-1}))^{-1}
    (\delta_A - \delta_B)

is distributed like chi-square, if the noise variance is :math:`\varphi^2` times the variance of
independent samples (theory (6.12)). Three pairs of parts are compared: the first cycle with the
later cycles (a transient), the two halves (a drift), and even with odd cycles (a doubled period).

The residuals that all cycles have in common are a misfit of the model, and no difference between
cycles. So :math:`g` takes the residuals less their mean over the cycles at each phase. Cycles
sample a step of height :math:`d` of :math:`J^\top r` at different phases, which changes a sum by
:math:`d / 2` at most. The covariance contains the square of this change.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.folding import Folded
from zeno_orbits.experiment.identification.least_squares import Fit

_CHANCE = 1e-6
"""Chance by which noise alone makes a recording unsteady, for each of the comparisons."""
_REACH = 0.05
"""Part of a period over which noise may be correlated."""
_WHOLE = 0.5
"""Part of the usual samples that a cycle has at least, to count as one."""
_FEWEST = 3
"""Smallest number of pairs of cycles that determine the scatter between cycles."""
_LOUD = 1.5
"""Largest ratio of the deviations of a settled first cycle to the deviations of later cycles."""
_QUIET = 0.1
"""A usual residual at least, in units of its noise."""
_BINS = 120
_RANK = 1e-10


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Unsteady:
    """A difference between cycles that should agree up to noise.

    Attributes:
        reason: Description of the difference.
        first: Whether the beginning differs from the rest.
        skip: Number of cycles to omit then, including incomplete cycles.
        size: Relative difference between the parameters fitted to the parts. It is infinite if the
            deviations themselves differ in size.
    """

    reason: str
    first: bool
    skip: int
    size: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Cycles:
    """Parameter changes that fit each cycle separately.

    Attributes:
        numbers: Indices of the cycles that are long enough, ``(n_c,)``.
        gradients: ``(n_c, k + 1)``.
        information: ``(n_c, k + 1, k + 1)``.
        counts: Number of samples of each cycle, ``(n_c,)``.
        loud: Median of the absolute residuals of the first cycle, relative to that of later cycles
            at the same phases.
        noise: Ratio of the variance to the variance of independent samples.
        steps: Covariance of the sum over one cycle by the phases of its samples, which many cycles
            may have in common, ``(k + 1, k + 1)``.
    """

    numbers: NDArray[np.int64]
    gradients: Vector
    information: Vector
    counts: Vector
    loud: float
    noise: float
    steps: Vector

    def apart(self, one: NDArray[np.bool_], other: NDArray[np.bool_]) -> tuple[float, float]:
        """Return the difference of two parts of the cycles, as chi-square and in parameters."""
        moves: list[Vector] = []
        spread = np.zeros(self.information.shape[1:])
        for part in (one, other):
            inverse = _inverse(self.information[part].sum(axis=0))
            moves.append(-inverse @ self.gradients[part].sum(axis=0))
            spread += self.noise * inverse
            spread += part.sum() ** 2 * inverse @ self.steps @ inverse
        gap = moves[0] - moves[1]
        return float(gap @ _inverse(spread) @ gap), float(np.max(np.abs(gap[:-1])))

    def scatter(self, step: int) -> float:
        """Return the ratio to noise of the difference between cycles some steps apart."""
        n, freedom = len(self.numbers), self.gradients.shape[1]
        # The first cycle is the cycle under test.
        places = range(1, n - step)
        if len(places) < _FEWEST:
            return 1.0
        own = np.arange(n)
        found = [self.apart(own == k, own == k + step)[0] for k in places]
        return max(float(np.median(found)) / freedom, 1.0)

    def first_is_loud(self) -> bool:
        """Return True if the first cycle has significantly larger residuals than later cycles.

        With the noise of the later cycles, half of the first cycle's samples would have to exceed
        their own median (a sign test).
        """
        from scipy.stats import binom, norm

        n = max(round(float(self.counts[0]) / self.noise), 1)
        share = 2.0 * norm.sf(float(norm.isf(0.25)) * self.loud)
        return self.loud > _LOUD and bool(binom.sf(math.ceil(n / 2) - 1, n, share) < _CHANCE)


def unsteady(found: Fit) -> Unsteady | None:
    """Return the difference between the cycles of a recording, ``None`` if insignificant."""
    from scipy.stats import chi2

    if not found.data.seen.any():
        return None
    cycles = _cycles(found)
    n = len(cycles.numbers)
    if n < 2:
        return None
    least = float(chi2.isf(_CHANCE, cycles.gradients.shape[1]))
    place = np.arange(n)
    skip = int(cycles.numbers[0]) + 1
    loud = cycles.first_is_loud()
    most = least * cycles.scatter(1)
    begins, early = cycles.apart(place == 0, place > 0)
    halves, later = cycles.apart(place < n // 2, place >= n // 2)
    if loud or begins > max(most, halves if n > 3 else 0.0):
        reason = "its first cycle differs from the later cycles: the motion is still settling"
        size = math.inf if loud else early
        return Unsteady(reason=reason, first=True, skip=skip, size=size)
    if halves > most:
        reason = "its two halves give different parameters: the motion may not have settled, "
        skip = int(cycles.numbers[n // 2])
        return Unsteady(reason=reason + "or the machine drifted", first=True, skip=skip, size=later)
    odd = cycles.numbers % 2 == 1
    if n > 2 and not np.any(found.data.span) and 0 < odd.sum() < n:
        turns, size = cycles.apart(odd, ~odd)
        if turns > least * cycles.scatter(2):
            reason = "every other cycle gives different parameters: the period is doubled"
            return Unsteady(reason=reason, first=False, skip=0, size=size)
    return None


def _cycles(found: Fit) -> _Cycles:
    data, k = found.data, found.jacobian.shape[1]
    n, n_s = data.seen.shape
    slopes = found.jacobian[: n * n_s].reshape(n, n_s, k)
    rest = found.residuals[: n * n_s].reshape(n, n_s)
    count = np.array([data.seen[data.groups == g].sum() for g in range(data.n_groups)])
    numbers = np.flatnonzero(count > _WHOLE * np.median(count))
    bins, n_bins = _bins(data, count[numbers])
    common = np.where(data.seen, _means(rest, data.seen, bins, n_bins)[bins], 0.0)
    own = np.where(data.seen, rest - common, 0.0)
    pulls = np.einsum("nsk,ns->nk", slopes, common)
    course = _means(pulls, np.full((n, k), True), bins, n_bins)[np.unique(bins)]
    steps = np.diff(course, axis=0, append=course[:1])
    # The bins in which the recording begins and ends have samples of one part only.
    place = data.groups * n_bins + bins
    whole = (place != place[0]) & (place != place[-1])
    parts = [whole & (data.groups == g) for g in numbers]
    gradients = [np.einsum("nsk,ns->k", slopes[part], own[part]) for part in parts]
    information = [np.einsum("nsk,nsl->kl", slopes[part], slopes[part]) for part in parts]
    return _Cycles(
        numbers=numbers,
        gradients=np.array(gradients),
        information=np.array(information),
        counts=count[numbers],
        loud=_loudness(data, rest, bins, parts[0]),
        noise=_correlated(data, rest, data.groups >= numbers[len(numbers) // 2]),
        steps=steps.T @ steps / 4.0,
    )


def _bins(data: Folded, counts: Vector) -> tuple[NDArray[np.int64], int]:
    """Return the phase bin of each row, and the number of bins: two samples of a cycle in each.

    Args:
        data: The samples.
        counts: Number of values of each whole cycle, ``(n_c,)``.
    """
    rows = float(np.median(counts)) / data.seen.shape[1]
    n_bins = int(np.clip(rows / 2.0, 1, _BINS))
    return np.minimum((data.phases * n_bins).astype(np.int64), n_bins - 1), n_bins


def _means(values: Vector, seen: NDArray[np.bool_], bins: NDArray[np.int64], n_bins: int) -> Vector:
    """Return the mean of the seen values of each bin, 0 without a value, ``(n_bins, n_s)``."""
    means = np.zeros((n_bins, values.shape[1]))
    for s in range(values.shape[1]):
        own = bins[seen[:, s]]
        count = np.maximum(np.bincount(own, minlength=n_bins), 1)
        means[:, s] = np.bincount(own, values[seen[:, s], s], minlength=n_bins) / count
    return means


def _loudness(
    data: Folded, rest: Vector, bins: NDArray[np.int64], first: NDArray[np.bool_]
) -> float:
    """Return the ratio of the first cycle's median residual to that of later cycles.

    The later cycles count where the first cycle has samples: elsewhere a misfit may be smaller.
    """
    later = (
        data.seen & (np.isin(bins, bins[first]) & (data.groups > data.groups[first][0]))[:, None]
    )
    if not later.any():
        return 0.0
    begin = float(np.median(np.abs(rest[data.seen & first[:, None]])))
    # Residuals that are smaller than the least noise are rounding, and loud in no cycle.
    return begin / max(float(np.median(np.abs(rest[later]))), _QUIET)


def _correlated(data: Folded, rest: Vector, later: NDArray[np.bool_]) -> float:
    """Return the factor by which correlation of the noise increases the variance of a sum.

    The noise is the deviation of the cycles from their mean, taken from the later cycles, which
    have settled best.
    """
    bins = np.minimum((data.phases * _BINS).astype(np.int64), _BINS - 1)
    means = _means(rest, data.seen, bins, _BINS)
    reach = max(round(_REACH * float(np.median(np.bincount(data.groups[later])[-2:]))), 1)
    taper = 1.0 - np.arange(1, reach + 1) / (reach + 1)
    sums = np.zeros(reach + 1)
    for s in range(rest.shape[1]):
        seen = data.seen[:, s]
        own = np.where(seen, rest[:, s] - means[bins, s], 0.0)[later]
        sums += [float(own[lag:] @ own[: len(own) - lag]) for lag in range(reach + 1)]
    if not sums[0] > 0.0:
        return 1.0
    return max(1.0 + 2.0 * float(taper @ sums[1:]) / float(sums[0]), 1.0)


def _inverse(matrix: Vector) -> Vector:
    found = np.linalg.pinv(matrix, rcond=_RANK, hermitian=True)
    return np.asarray(found, dtype=np.float64)
