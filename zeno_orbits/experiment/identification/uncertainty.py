r"""Uncertainty of fitted values with correlated residuals, and undetermined combinations.

With residuals `r`, their derivative `J` and :math:`H = J^\top J` the covariance of the fitted
values is

.. math:: H^{-1} \Bigl(\sum_{i,j} J_i^\top \operatorname{cov}(r_i, r_j) J_j\Bigr) H^{-1}.

The covariance is estimated in two ways. The first estimate is the scatter of whole cycles, which
may vary within a cycle. The second estimate is the autocorrelation along the phase of the common
residual of all cycles, which results from an inadequate model. The largest error counts: from these
two estimates, or from independent noise (theory (6.12)).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.folding import Folded

_BINS = 240
_REACH = 30
"""Bins over which residuals may be correlated."""
_LASTING = 0.1
"""Part of a period over which noise may be correlated."""
_LEAST_GROUPS = 6
_FREEDOM = 60
"""Degrees of freedom of an estimate from all samples together."""
LEVEL = 0.95
"""Probability with which an interval holds the truth."""
_TOLD = 0.5
"""A combination whose 95 % interval is wider than this, relative, is not determined."""
_EXACT = 0.5
"""Mean square of the residuals below which they are smaller than the least noise."""
_PART = 0.1
_ROUND = 0.05
_CHANCE = 0.01
"""Chance below which the residuals of contact channels are larger than their errors explain."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spread:
    """Uncertainty of fitted values.

    Attributes:
        errors: Standard errors, ``(k,)``.
        half: Half lengths of the 95 % intervals, ``(k,)``.
        correlation: Correlation matrix, ``(k, k)``.
        information: :math:`H` after elimination of the shift in phase, ``(k, k)``.
        inflation: Ratio of the errors to the errors for independent residuals.
        misfit: Ratio of the variance of the periodic part of the residuals to its value from noise.
        common: Size of the periodic part without the contribution of noise, relative to the
            residuals.
        edge_excess: Ratio of the variance of the residuals of contact channels to that of their
            errors. It is 1 unless the ratio is significantly larger.
    """

    errors: Vector
    half: Vector
    correlation: Vector
    information: Vector
    inflation: float
    misfit: float
    common: float
    edge_excess: float = 1.0

    def apart(self, step: Vector, limit: float) -> bool:
        """Return True if two sets of unknowns differ by more than some standard errors.

        Along a combination that the recording does not determine, no step is too long.

        Args:
            step: Their difference, ``(k + 1,)``.
            limit: Number of standard errors.
        """
        own = step[:-1]
        far = bool(np.any(np.abs(own) > limit * np.maximum(self.errors, 1e-12)))
        return far and float(own @ self.information @ own) > (limit * self.inflation) ** 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Unseen:
    """A combination of parameters that a recording does not determine.

    Attributes:
        direction: Relative change of each parameter by name, with a total length of one.
        text: Description of the combination.
    """

    direction: Mapping[str, float]
    text: str


def spread_of(jacobian: Vector, residuals: Vector, data: Folded) -> Spread:
    """Return the uncertainty of the fitted values.

    Args:
        jacobian: Derivatives of the residuals with respect to the parameters and then the phase
            shift, ``(n_r, k + 1)``. The rows after the ``n n_s`` samples have independent errors:
            those of contact channels, and the last one of the period.
        residuals: Residuals in units of their noise, ``(n_r,)``.
        data: The samples of the residuals.
    """
    from scipy.stats import t as student

    n, n_s = data.seen.shape
    k = jacobian.shape[1] - 1
    samples, rest = jacobian[: n * n_s].reshape(n, n_s, k + 1), residuals[: n * n_s]
    rest = rest.reshape(n, n_s)
    information = jacobian.T @ jacobian
    inverse: Vector = np.asarray(
        np.linalg.pinv(information, rcond=1e-14, hermitian=True), dtype=np.float64
    )
    edges = jacobian[n * n_s : -1]
    edge_excess = _excess(edges, residuals[n * n_s : -1], inverse)
    own = edge_excess * edges.T @ edges + np.outer(jacobian[-1], jacobian[-1])
    together, misfit, common = _along_phase(samples, rest, data)
    # The other two values are estimates and may be too small. Independent noise is the lower bound.
    # Files on their own clocks have independent noise.
    parts = [_part_of(samples, rest, data, clock) for clock in range(data.n_clocks)]
    along = np.sum([_along_time(*part) for part in parts], axis=0)
    scatters = [(together, _FREEDOM), (along, _FREEDOM)]
    n_groups = min(part.n_groups for _, _, part in parts)
    if n_groups >= _LEAST_GROUPS:
        between = np.sum([_by_groups(*part) for part in parts], axis=0)
        scatters.append((between, n_groups - 1))
    covariances = [inverse, *(inverse @ (gradient + own) @ inverse for gradient, _ in scatters)]
    freedoms = [_FREEDOM, *(freedom for _, freedom in scatters)]
    sizes = np.sqrt([np.maximum(np.diag(one)[:k], 0.0) for one in covariances])
    errors = np.max(sizes, axis=0)
    plain, size = (
        np.sqrt(np.maximum(np.diag(one)[:k], np.finfo(float).tiny)) for one in covariances[:2]
    )
    reduced = information[:k, :k]
    if information[k, k] > 0.0:
        across = information[:k, k]
        reduced = reduced - np.outer(across, across) / information[k, k]
    factors = np.array([float(student.ppf((1 + LEVEL) / 2, freedom)) for freedom in freedoms])
    return Spread(
        errors=errors,
        half=np.max(factors[:, None] * sizes, axis=0),
        correlation=covariances[1][:k, :k] / np.outer(size, size),
        information=reduced,
        inflation=float(np.max(errors / plain)),
        misfit=misfit,
        common=common,
        edge_excess=edge_excess,
    )


def _part_of(
    samples: Vector, rest: Vector, data: Folded, clock: int
) -> tuple[Vector, Vector, Folded]:
    """Return derivatives, residuals and samples of one file."""
    own, m = data.part(clock), samples.shape[2]
    shape = own.values.shape
    slopes = data.entries(clock, samples.reshape(-1, m)).reshape(*shape, m)
    return slopes, data.entries(clock, rest.ravel()).reshape(shape), own


def _excess(edges: Vector, rest: Vector, inverse: Vector) -> float:
    """Return the variance of residuals relative to their degrees of freedom, if it is significant.

    Rows without a derivative are not observations. The leverage of the others is lost to the fit.
    """
    from scipy.stats import chi2

    seen = np.any(edges != 0.0, axis=1)
    edges, rest = edges[seen], rest[seen]
    freedom = len(rest) - float(np.einsum("ij,jk,ik->", edges, inverse, edges))
    square = float(rest @ rest)
    if freedom < 0.5 or chi2.sf(square, freedom) > _CHANCE:
        return 1.0
    return square / freedom


def _along_phase(samples: Vector, rest: Vector, data: Folded) -> tuple[Vector, float, float]:
    """Return the covariance of the gradient, from the residuals' autocorrelation along the phase.

    Residuals count as weighted, so that a mean of many samples weighs as much as they do.
    """
    m = samples.shape[2]
    bins = np.minimum((data.phases * _BINS).astype(np.int64), _BINS - 1)
    total = np.zeros((m, m))
    repeated, expected, excess, heavy = 0.0, 0.0, 0.0, 0.0
    square = float(np.sum(rest[data.seen] ** 2)) / max(int(data.seen.sum()), 1)
    # Weights are limited by the smallest noise: a smaller residual is treated as noise.
    granted = 1.0 - square if square < _EXACT else 0.0
    taper = 1.0 - np.arange(_REACH + 1) / (_REACH + 1)
    for s in range(samples.shape[1]):
        seen = data.seen[:, s]
        here = bins[seen]
        root = np.sqrt(data.counts[seen, s])
        weight = np.bincount(here, weights=root**2, minlength=_BINS)
        known = weight > 0.0
        if not known.any():
            continue
        mean = np.bincount(here, weights=root * rest[seen, s], minlength=_BINS)
        mean = np.where(known, mean / np.maximum(weight, 1.0), 0.0)
        columns = (root[:, None] * samples[seen, s]).T
        gradient = np.stack(
            [np.bincount(here, weights=column, minlength=_BINS) for column in columns], axis=1
        )
        noise = granted + _scatter(here + _BINS * data.groups[seen], root, rest[seen, s], mean)
        repeated += float(np.mean(weight[known] * mean[known] ** 2))
        expected += noise
        excess += float(np.sum(weight[known] * mean[known] ** 2 - noise))
        heavy += float(weight.sum())
        for lag in range(_REACH + 1):
            both = known & np.roll(known, -lag)
            if not both.any():
                continue
            gamma = float(np.mean((mean * np.roll(mean, -lag))[both])) * taper[lag]
            product = gradient.T @ np.roll(gradient, -lag, axis=0)
            total += gamma * (product if lag == 0 else product + product.T)
    misfit = repeated / expected if expected > 0.0 else 1.0
    return _positive(total), misfit, math.sqrt(max(excess, 0.0) / max(heavy, 1.0))


def _scatter(places: NDArray[np.int64], root: Vector, rest: Vector, mean: Vector) -> float:
    """Return the variance of a sum of weighted residuals between cycles, relative to the weights.

    The index of a residual is `bin + _BINS cycle`. Its weight is the square of `root`, and `mean`
    is the mean over all cycles.
    """
    weight = np.bincount(places, weights=root**2)
    sums = np.bincount(places, weights=root * rest)
    found = np.flatnonzero(weight > 0.0)
    bins, weight = found % _BINS, weight[found]
    apart = sums[found] / weight - mean[bins]
    n_free = float(np.sum(np.maximum(np.bincount(bins, minlength=_BINS) - 1, 0)))
    return float(np.sum(weight * apart**2)) / max(n_free, 1.0)


def _along_time(samples: Vector, rest: Vector, data: Folded) -> Vector:
    """Return the covariance of the gradient, from the residuals' autocorrelation in time.

    Weights are one up to half of the reach and then fall to zero: a sensor that forgets well
    within it is counted whole.
    """
    n, n_s, m = samples.shape
    reach = max(round(_LASTING * n / float(np.ptp(data.groups + data.phases))), 1)
    total = np.zeros((m, m))
    for s in range(n_s):
        seen = data.seen[:, s].astype(np.float64)
        own, gradient = rest[:, s] * seen, samples[:, s] * seen[:, None]
        for lag in range(reach + 1):
            pairs = float(seen[lag:] @ seen[: n - lag])
            gamma = float(own[lag:] @ own[: n - lag]) / max(pairs, 1.0)
            gamma *= min(1.0, 2.0 * (1.0 - lag / (reach + 1)))
            product = gradient[lag:].T @ gradient[: n - lag]
            total += gamma * (product if lag == 0 else product + product.T)
    return _positive(total)


def _by_groups(samples: Vector, rest: Vector, data: Folded) -> Vector:
    """Return the covariance of the gradient, from its scatter over cycles."""
    n_groups = data.n_groups
    terms = np.where(data.seen[:, :, None], samples * rest[:, :, None], 0.0).sum(axis=1)
    each = np.stack(
        [np.bincount(data.groups, weights=column, minlength=n_groups) for column in terms.T],
        axis=1,
    )
    around = each - each.mean(axis=0)
    return n_groups / (n_groups - 1) * around.T @ around


def _positive(matrix: Vector) -> Vector:
    """Return the nearest matrix that can be a covariance."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    return (vectors * np.maximum(values, 0.0)) @ vectors.T


def unseen_combinations(
    names: Sequence[str], information: Vector, inflation: float, additive: Collection[str] = ()
) -> tuple[Unseen, ...]:
    """Return the undetermined combinations of parameters.

    Args:
        names: Names of the parameters.
        information: :math:`H` of their relative changes, ``(k, k)``.
        inflation: Ratio of the errors to the errors for independent residuals.
        additive: Names of values without a scale of their own, such as offsets.
    """
    values, vectors = np.linalg.eigh(information)
    found: list[Unseen] = []
    for value, vector in zip(values, vectors.T, strict=True):
        error = inflation / math.sqrt(value) if value > 0.0 else math.inf
        if 1.96 * error < _TOLD:
            continue
        lead = vector / vector[int(np.argmax(np.abs(vector)))]
        direction = {name: float(part) for name, part in zip(names, vector, strict=True)}
        involved = [
            (name, float(part)) for name, part in zip(names, lead, strict=True) if abs(part) > _PART
        ]
        found.append(Unseen(direction=direction, text=_in_words(involved, additive)))
    return tuple(found)


def _in_words(involved: Sequence[tuple[str, float]], additive: Collection[str]) -> str:
    if len(involved) == 1:
        return f"`{involved[0][0]}` is not seen"
    changes = ", ".join(f"`{name}` by {part:+.2g} %" for name, part in involved)
    text = f"not seen is a change of {changes} together"
    if len(involved) != 2 or any(name in additive for name, _ in involved):
        return text
    (first, a), (second, b) = involved
    # To first order, such a change does not affect first^b / second^a.
    ratio = a / b
    if abs(ratio - 1.0) < _ROUND:
        return f"{text}: only `{first}/{second}` is seen"
    if abs(ratio + 1.0) < _ROUND:
        return f"{text}: only the product of `{first}` and `{second}` is seen"
    return f"{text}: only `{first}` over `{second}` to the power {ratio:.2g} is seen"
