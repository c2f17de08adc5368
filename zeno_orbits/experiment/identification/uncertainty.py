r"""Uncertainty of fitted numbers with correlated residuals, and combinations that a fit cannot see.

With residuals `r`, their derivative `J` and :math:`H = J^\top J` the numbers err like

.. math:: H^{-1} \Bigl(\sum_{i,j} J_i^\top \operatorname{cov}(r_i, r_j) J_j\Bigr) H^{-1}.

The covariance is seen twice: as the scatter of whole cycles, which need not be alike inside, and
as the autocorrelation along the phase of what all cycles have in common, which a model that is
wrong leaves behind. The largest error counts: of these
two, and of independent noise (theory (59)).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.identification.folding import Folded

_BINS = 240
_REACH = 30
"""Bins over which residuals may be correlated."""
_LASTING = 0.1
"""Part of a period over which noise may be correlated."""
_LEAST_GROUPS = 6
_FREEDOM = 60
"""Degrees of freedom of an estimate from all samples together."""
_LEVEL = 0.95
_TOLD = 0.5
"""A combination whose 95 % interval is wider than this, relative, is not determined."""
_EXACT = 0.5
"""Mean square of the residuals below which they are smaller than the least noise."""
_PART = 0.1
_ROUND = 0.05


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spread:
    """Uncertainty of fitted numbers.

    Attributes:
        errors: Standard errors, ``(k,)``.
        half: Half lengths of the 95 % intervals, ``(k,)``.
        correlation: ``(k, k)``.
        information: :math:`H` without what the shift in phase takes, ``(k, k)``.
        inflation: Factor of the errors over those of independent residuals.
        misfit: What repeats of the residuals, over what noise makes repeat, as variances.
        common: Size of what repeats without noise's part, in units of the residuals' own.
    """

    errors: Vector
    half: Vector
    correlation: Vector
    information: Vector
    inflation: float
    misfit: float
    common: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Unseen:
    """A combination of numbers that a recording does not tell.

    Attributes:
        direction: Name to relative change of each number, of length one together.
        text: In words.
    """

    direction: Mapping[str, float]
    text: str


def spread_of(jacobian: Vector, residuals: Vector, data: Folded) -> Spread:
    """Return how sure the numbers of a fit are.

    Args:
        jacobian: Of the residuals by the numbers, then by the shift in phase; the last row is the
            period's, ``(n n_s + 1, k + 1)``.
        residuals: In units of their noise, ``(n n_s + 1,)``.
        data: The samples that they belong to.
    """
    from scipy.stats import t as student

    n, n_s = data.seen.shape
    k = jacobian.shape[1] - 1
    samples = jacobian[:-1].reshape(n, n_s, k + 1)
    rest = residuals[:-1].reshape(n, n_s)
    information = jacobian.T @ jacobian
    inverse = np.linalg.pinv(information, rcond=1e-14, hermitian=True)
    own = np.outer(jacobian[-1], jacobian[-1])
    together, misfit, common = _along_phase(samples, rest, data)
    n_groups = int(data.groups.max()) + 1
    # Both that follow are estimates, and may come out too small; independent noise is the least.
    options = [
        (inverse @ (together + own) @ inverse, float(student.ppf(_TAIL, _FREEDOM))),
        (inverse, float(student.ppf(_TAIL, _FREEDOM))),
        (
            inverse @ (_along_time(samples, rest, data) + own) @ inverse,
            float(student.ppf(_TAIL, _FREEDOM)),
        ),
    ]
    if n_groups >= _LEAST_GROUPS:
        apart = _by_groups(samples, rest, data, n_groups)
        factor = float(student.ppf(_TAIL, n_groups - 1))
        options.append((inverse @ (apart + own) @ inverse, factor))
    variances = [np.maximum(np.diag(covariance)[:k], 0.0) for covariance, _ in options]
    errors = np.sqrt(np.max(variances, axis=0))
    halves = [
        factor * np.sqrt(variance) for variance, (_, factor) in zip(variances, options, strict=True)
    ]
    plain = np.sqrt(np.maximum(np.diag(inverse)[:k], np.finfo(float).tiny))
    size = np.sqrt(np.maximum(np.diag(options[0][0])[:k], np.finfo(float).tiny))
    reduced = information[:k, :k]
    if information[k, k] > 0.0:
        across = information[:k, k]
        reduced = reduced - np.outer(across, across) / information[k, k]
    return Spread(
        errors=errors,
        half=np.max(halves, axis=0),
        correlation=options[0][0][:k, :k] / np.outer(size, size),
        information=reduced,
        inflation=float(np.max(errors / plain)),
        misfit=misfit,
        common=common,
    )


_TAIL = 1 - (1 - _LEVEL) / 2


def _along_phase(samples: Vector, rest: Vector, data: Folded) -> tuple[Vector, float, float]:
    """Return the covariance of the gradient, from the residuals' autocorrelation along the phase.

    Residuals count as weighted, so that a mean of many samples weighs as much as they do.
    """
    m = samples.shape[2]
    bins = np.minimum((data.phases * _BINS).astype(np.int64), _BINS - 1)
    total = np.zeros((m, m))
    repeated, expected, excess, heavy = 0.0, 0.0, 0.0, 0.0
    square = float(np.sum(rest[data.seen] ** 2)) / max(int(data.seen.sum()), 1)
    # Weights end at the least noise: what residuals are smaller than that is granted as noise.
    granted = 1.0 - square if square < _EXACT else 0.0
    taper = 1.0 - np.arange(_REACH + 1) / (_REACH + 1)
    for s in range(samples.shape[1]):
        seen = data.seen[:, s]
        here = bins[seen]
        root = np.sqrt(data.counts[seen, s])
        weight = np.bincount(here, weights=root**2, minlength=_BINS)
        known = weight > 0.0
        mean = np.bincount(here, weights=root * rest[seen, s], minlength=_BINS)
        mean = np.where(known, mean / np.maximum(weight, 1.0), 0.0)
        gradient = np.stack(
            [
                np.bincount(here, weights=root * samples[seen, s, j], minlength=_BINS)
                for j in range(m)
            ],
            axis=1,
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
    """Return the variance of a sum of weighted residuals, per weight, between cycles.

    Args:
        places: Cycle and bin of each, as `bin + _BINS cycle`.
        root: Their root weights.
        rest: The residuals.
        mean: Over all cycles in each bin.
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


def _by_groups(samples: Vector, rest: Vector, data: Folded, n_groups: int) -> Vector:
    """Return the covariance of the gradient, from its scatter over cycles."""
    m = samples.shape[2]
    terms = np.where(data.seen[:, :, None], samples * rest[:, :, None], 0.0).sum(axis=1)
    each = np.stack(
        [np.bincount(data.groups, weights=terms[:, j], minlength=n_groups) for j in range(m)],
        axis=1,
    )
    around = each - each.mean(axis=0)
    return n_groups / (n_groups - 1) * around.T @ around


def _positive(matrix: Vector) -> Vector:
    """Return the nearest matrix that can be a covariance."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    return (vectors * np.maximum(values, 0.0)) @ vectors.T


def unseen_combinations(
    names: Sequence[str], information: Vector, inflation: float
) -> tuple[Unseen, ...]:
    """Return the combinations of numbers that are not determined.

    Args:
        names: Of the numbers.
        information: :math:`H` of their relative changes, ``(k, k)``.
        inflation: Factor of the errors over those of independent residuals.
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
        found.append(Unseen(direction=direction, text=_in_words(involved)))
    return tuple(found)


def _in_words(involved: Sequence[tuple[str, float]]) -> str:
    if len(involved) == 1:
        return f"`{involved[0][0]}` is not seen"
    changes = ", ".join(f"`{name}` by {part:+.2g} %" for name, part in involved)
    text = f"not seen is a change of {changes} together"
    if len(involved) != 2:
        return text
    (first, a), (second, b) = involved
    # What such a change leaves alone is first^b / second^a, to first order.
    ratio = a / b
    if abs(ratio - 1.0) < _ROUND:
        return f"{text}: only `{first}/{second}` is seen"
    if abs(ratio + 1.0) < _ROUND:
        return f"{text}: only the product of `{first}` and `{second}` is seen"
    return f"{text}: only `{first}` over `{second}` to the power {ratio:.2g} is seen"
