r"""Test that all cycles of a recording give the same parameters, as in a settled machine.

Parts `A` and `B` of the cycles, with gradients :math:`g = \sum J^\top r` and information
:math:`H = \sum J^\top J` of their own, would each move the fitted unknowns by
:math:`\delta = -H^{-1} g`, and

.. math:: T^2 = (\delta_A - \delta_B)^\top (\varphi^2 (H_A^{-1} + H_B^{-1}))^{-1}
    (\delta_A - \delta_B)

is distributed like chi-square, if the noise variance is :math:`\varphi^2` times the variance of
independent samples (theory (6.12)). Three pairs of parts are compared: the first cycle with the
later cycles (a transient), the two halves (a drift), and even with odd cycles (a doubled period).
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
        sizes: Median of the absolute residuals of each cycle, ``(n_c,)``.
        noise: Ratio of the variance to the variance of independent samples.
    """

    numbers: NDArray[np.int64]
    gradients: Vector
    information: Vector
    counts: Vector
    sizes: Vector
    noise: float

    def apart(self, one: NDArray[np.bool_], other: NDArray[np.bool_]) -> tuple[float, float]:
        """Return the difference of two parts of the cycles, as chi-square and in parameters."""
        moves: list[Vector] = []
        spread = np.zeros(self.information.shape[1:])
        for part in (one, other):
            inverse = _inverse(self.information[part].sum(axis=0))
            moves.append(-inverse @ self.gradients[part].sum(axis=0))
            spread += self.noise * inverse
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

        # Residuals that are smaller than the least noise are rounding, and loud in no cycle.
        loud = float(self.sizes[0]) / max(float(np.median(self.sizes[1:])), _QUIET)
        n = max(round(float(self.counts[0]) / self.noise), 1)
        share = 2.0 * norm.sf(float(norm.isf(0.25)) * loud)
        return loud > _LOUD and bool(binom.sf(math.ceil(n / 2) - 1, n, share) < _CHANCE)


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
    if n > 2 and not found.data.span and 0 < odd.sum() < n:
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
    parts = [data.groups == g for g in numbers]
    gradients = [np.einsum("nsk,ns->k", slopes[own], rest[own]) for own in parts]
    information = [np.einsum("nsk,nsl->kl", slopes[own], slopes[own]) for own in parts]
    # The median: a single sample on the other side of a jump makes no cycle loud.
    sizes = [float(np.median(np.abs(rest[own][data.seen[own]]))) for own in parts]
    return _Cycles(
        numbers=numbers,
        gradients=np.array(gradients),
        information=np.array(information),
        counts=count[numbers],
        sizes=np.array(sizes),
        noise=_correlated(data, rest, data.groups >= numbers[len(numbers) // 2]),
    )


def _correlated(data: Folded, rest: Vector, later: NDArray[np.bool_]) -> float:
    """Return the factor by which correlation of the noise increases the variance of a sum.

    The noise is the deviation of the cycles from their mean, taken from the later cycles, which
    have settled best.
    """
    bins = np.minimum((data.phases * _BINS).astype(np.int64), _BINS - 1)
    reach = max(round(_REACH * float(np.median(np.bincount(data.groups[later])[-2:]))), 1)
    taper = 1.0 - np.arange(1, reach + 1) / (reach + 1)
    sums = np.zeros(reach + 1)
    for s in range(rest.shape[1]):
        seen = data.seen[:, s]
        count = np.maximum(np.bincount(bins[seen], minlength=_BINS), 1)
        mean = np.bincount(bins[seen], weights=rest[seen, s], minlength=_BINS) / count
        own = np.where(seen, rest[:, s] - mean[bins], 0.0)[later]
        sums += [float(own[lag:] @ own[: len(own) - lag]) for lag in range(reach + 1)]
    if not sums[0] > 0.0:
        return 1.0
    return max(1.0 + 2.0 * float(taper @ sums[1:]) / float(sums[0]), 1.0)


def _inverse(matrix: Vector) -> Vector:
    found = np.linalg.pinv(matrix, rcond=_RANK, hermitian=True)
    return np.asarray(found, dtype=np.float64)
