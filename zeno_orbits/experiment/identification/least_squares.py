r"""Least squares of a recording by the closed orbit, over what the orbit says in straight lines.

Intervals come from derivatives, and so from samples whose prediction is a straight line over the
interval itself. Behind an impact a current runs through a layer of width `L/R`: there a sample's
slope promises to tell the impact's time much better than a sample can whose layer may as well be
elsewhere, and it makes false minima. So the first fit keeps away from jumps and layers; then
samples count whose residual bends by less than a part of its noise anywhere in the interval that
the first fit has left (theory (59)).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.experiment.identification.folding import Folded
from zeno_orbits.experiment.identification.predictions import Predictions
from zeno_orbits.experiment.identification.uncertainty import Spread, spread_of
from zeno_orbits.experiment.orbit_table import beside_jumps, jump_width
from zeno_orbits.experiment.recordings.delays import delays_of, period_error
from zeno_orbits.experiment.recordings.periodicity import Periodicity
from zeno_orbits.work import Progress

_FAR = 1e3
"""Residuals of unknowns that have no orbit: a trust region turns back from them."""
_TRIALS = 40
_LEAST_NOISE = 1e-6
"""Noise of a signal at least, in parts of its range: a table of an orbit is as exact as that."""
_SETTLED = (1e-6, 1e-6, 1e-8)
"""Relative change of unknowns and of the sum of squares that ends each round of the fit."""
_ASIDE = 3.0
"""Standard errors to either side over which a prediction has to be straight."""
_FARTHEST = 0.05
"""Relative change of a number, to look at its bend, at most; a phase moves a fifth of it."""
_BENT = 0.3
"""Bend of a residual that counts as none, in units of its noise."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit:
    """Unknowns at which an orbit is nearest to a recording.

    Attributes:
        x: The unknowns, ``(k + 1,)``.
        data: The samples that count.
        jacobian: Derivatives of the residuals by the unknowns, the period's in the last row,
            ``(n n_s + 1, k + 1)``.
        residuals: In units of their noise, ``(n n_s + 1,)``.
        spread: How sure the unknowns are.
        before: Root mean square deviation at the start, in parts of the ranges.
        after: The same after the fit.
        repeating: What of it all cycles have in common, without noise's own part.
        converged: Whether the last fit came to its end.
    """

    x: Vector
    data: Folded
    jacobian: Vector
    residuals: Vector
    spread: Spread
    before: float
    after: float
    repeating: float
    converged: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Weighed:
    """Residuals in units of their noise, of a round of the fit.

    Attributes:
        orbits: What orbits say.
        data: The samples that count.
        found: The period of the recording.
        weights: One over the noise, ``(n, n_s)``.
    """

    orbits: Predictions
    data: Folded
    found: Periodicity
    weights: Vector

    def residuals(self, x: Vector) -> Vector:
        """Return the residuals, far ones where there is no orbit, ``(n n_s + 1,)``."""
        try:
            fold = self.orbits.fold(x, self.data)
            period = self.orbits.table(x).period
        except (SimulationError, InputError):
            return np.full(self.data.values.size + 1, _FAR)
        rest = np.where(self.data.seen, (self.data.values - fold.values) * self.weights, 0.0)
        return np.append(rest.ravel(), (self.found.period - period) / self.found.error)

    def jacobian(self, x: Vector) -> Vector:
        """Return their exact derivatives, ``(n n_s + 1, k + 1)``."""
        # What is accepted is where the next orbits are looked for.
        self.orbits.accept(x)
        slopes = self.orbits.slopes(x, self.data)
        whole = -slopes.signals * self.weights[:, :, None]
        whole = np.where(self.data.seen[:, :, None], whole, 0.0)
        return np.concatenate([whole.reshape(-1, len(x)), -slopes.period[None] / self.found.error])


def fit(
    orbits: Predictions,
    samples: Folded,
    found: Periodicity,
    on_progress: Progress,
) -> Fit:
    """Return the unknowns at which an orbit is nearest to samples.

    Args:
        orbits: What orbits say at unknowns.
        samples: The recording, folded.
        found: Its period.
        on_progress: Called with each stage and the part that is done.
    """
    first, converged = orbits.unknowns.first, True
    x, start = first, samples.without_jumps(orbits.table(first))
    data, stage = start, weighed(orbits, start, found, first)
    # Each round has the weights of the residuals that the one before it left.
    for number, change in enumerate(_SETTLED):
        on_progress("fitting", number / len(_SETTLED))
        x, converged = _nearest(stage, x, change)
        bent = _bent(stage, x, samples) if number == 0 else ~data.seen
        if number < len(_SETTLED) - 1:
            factor, error, width = _stretch(stage, x)
            samples = samples.stretched(factor)
            found = replace(found, period=found.period * factor, error=found.period * error)
            phases = samples.phases - float(x[-1])
            data = samples.without(bent | beside_jumps(orbits.table(x), phases, width))
        stage = weighed(orbits, data, found, x)
    on_progress("computing the intervals", 0.95)
    jacobian, residuals = stage.jacobian(x), stage.residuals(x)
    spread = spread_of(jacobian, residuals, data)
    # Both figures are of the same samples, beside no jump of either orbit.
    plain = data.without(~start.seen).without_jumps(orbits.table(x))
    before, after = (deviation(orbits, plain, at) for at in (first, x))
    return Fit(
        x=x,
        data=data,
        jacobian=jacobian,
        residuals=residuals,
        spread=spread,
        before=before,
        after=after,
        repeating=after * spread.common,
        converged=converged,
    )


def _stretch(stage: Weighed, x: Vector) -> tuple[float, float, float]:
    """Return the period that the samples ask for, its error, and how unsure their phases are.

    The orbit itself tells the period better than harmonics do, which cut its kinks off.

    Args:
        stage: The residuals.
        x: The unknowns.

    Returns:
        Factor of the period, its standard error, and a width in periods.
    """
    data = stage.data
    jacobian, residuals = stage.jacobian(x)[:-1], stage.residuals(x)[:-1]
    since = np.repeat(data.turns + data.phases, data.seen.shape[1])
    late = jacobian[:, -1]
    columns = np.column_stack([jacobian, late * since])
    change = np.linalg.lstsq(columns, -residuals, rcond=None)[0]
    rest = residuals + columns @ change
    white = max(float(np.sum(rest**2)) / max(int(data.seen.sum()), 1), 1.0)
    covariance = white * np.linalg.pinv(columns.T @ columns, rcond=1e-14, hermitian=True)
    groups = np.repeat(data.groups, data.seen.shape[1])
    delays = delays_of(groups, late, rest)
    delays = replace(delays, numbers=delays_of(groups, late, late * since).values)
    error = max(math.sqrt(float(covariance[-1, -1])), period_error(delays, white))
    ends = math.sqrt(float(covariance[-2, -2])) + error * float(np.max(np.abs(since)))
    return 1.0 + float(change[-1]), error, jump_width(ends)


def deviation(orbits: Predictions, data: Folded, x: Vector) -> float:
    """Return the root mean square deviation of all signals, in parts of their ranges.

    Args:
        orbits: Predictions.
        data: The samples that count.
        x: The unknowns, ``(k + 1,)``.
    """
    fold = orbits.fold(x, data)
    extent = np.ptp(fold.values, axis=0)
    rest = (data.values - fold.values) / np.where(extent > 0.0, extent, 1.0)
    counts = np.where(data.seen, data.counts, 0.0)
    square = float(np.sum(counts * np.where(data.seen, rest, 0.0) ** 2))
    return math.sqrt(square / max(float(counts.sum()), 1.0))


def weighed(orbits: Predictions, data: Folded, found: Periodicity, x: Vector) -> Weighed:
    """Return the residuals in units of their size at some unknowns, signal by signal.

    Args:
        orbits: Predictions.
        data: The samples that count.
        found: The period of the recording.
        x: The unknowns, ``(k + 1,)``.
    """
    fold = orbits.fold(x, data)
    weights = np.empty_like(data.values)
    for k in range(weights.shape[1]):
        seen = data.seen[:, k]
        rest, count = (data.values[:, k] - fold.values[:, k])[seen], data.counts[seen, k]
        size = float(np.sqrt(np.sum(count * rest**2) / max(float(count.sum()), 1.0)))
        extent = float(np.ptp(fold.values[:, k]))
        noise = max(size, _LEAST_NOISE * extent, np.finfo(float).tiny)
        weights[:, k] = np.sqrt(data.counts[:, k]) / noise
    return Weighed(orbits=orbits, data=data, found=found, weights=weights)


def _nearest(stage: Weighed, x: Vector, settled: float) -> tuple[Vector, bool]:
    """Return the unknowns of the least squares, and whether the search came to its end."""
    from scipy.optimize import least_squares

    answer = least_squares(
        stage.residuals,
        x,
        jac=stage.jacobian,
        bounds=stage.orbits.unknowns.bounds,
        method="trf",
        x_scale="jac",
        xtol=settled,
        ftol=settled,
        gtol=1e-12,
        max_nfev=_TRIALS,
    )
    return np.asarray(answer.x, dtype=np.float64), int(answer.status) > 0


def _bent(stage: Weighed, x: Vector, samples: Folded) -> NDArray[np.bool_]:
    """Return which of all samples are not predicted in a straight line, ``(n, n_s)``."""
    jacobian = stage.jacobian(x)
    spread = spread_of(jacobian, stage.residuals(x), stage.data)
    whole = replace(stage, data=samples)
    here, slopes = whole.residuals(x), whole.jacobian(x)
    shape = samples.values.shape
    n_groups = samples.n_groups
    # What a mean does not say of a bend inside it is the same in all groups.
    inside = samples.bends(stage.orbits.table(x), float(x[-1])) * whole.weights
    bend = math.sqrt(n_groups) * inside
    for step in _steps(jacobian, spread.inflation):
        there = np.clip(x + step, *stage.orbits.unknowns.bounds)
        off = whole.residuals(there) - here - slopes @ (there - x)
        bend = np.maximum(bend, np.abs(off[:-1].reshape(shape)))
    return bend > _BENT


def _steps(jacobian: Vector, inflation: float) -> Iterator[Vector]:
    """Yield the half axes of the region where the unknowns may be, to both sides."""
    values, vectors = np.linalg.eigh(jacobian.T @ jacobian)
    farthest = np.full(len(values), _FARTHEST)
    farthest[-1] /= 5.0
    for value, vector in zip(values, vectors.T, strict=True):
        size = _ASIDE * inflation / math.sqrt(value) if value > 0.0 else math.inf
        size = min(size, float(np.min(farthest / np.maximum(np.abs(vector), 1e-12))))
        yield from (size * vector, -size * vector)
