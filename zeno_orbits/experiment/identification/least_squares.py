r"""Least-squares fit of periodic orbits to a recording, on samples with a linear prediction.

Intervals follow from derivatives, so they need samples whose prediction is linear in the parameters
over the interval itself. After an impact a current passes through a layer of width `L/R`. The slope
of a sample in this layer suggests a much better determination of the impact time than the sample
gives, because the layer may as well be elsewhere. It also causes spurious minima. So the first fit
excludes jumps and layers. Later fits use the samples whose residual has a curvature of less than a
part of its noise anywhere in the interval left by the first fit (theory (6.12)).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.experiment.comparison.folding import Folded
from zeno_orbits.experiment.identification.contact_rows import NO_CONTACTS, ContactRows
from zeno_orbits.experiment.identification.predictions import Predictions
from zeno_orbits.experiment.identification.uncertainty import Spread, spread_of
from zeno_orbits.experiment.orbit_table import beside_jumps, jump_width
from zeno_orbits.experiment.recordings.delays import delays_of, period_error
from zeno_orbits.experiment.recordings.periodicity import Periodicity
from zeno_orbits.work import Progress

_FAR = 1e3
"""Residuals of unknowns without an orbit, which make the trust region shrink."""
_TRIALS = 40
_LEAST_NOISE = 1e-6
"""Noise of a signal at least, in parts of its range: a table of an orbit is as exact as that."""
_SETTLED = (1e-6, 1e-6, 1e-8)
"""Relative change of unknowns and of the sum of squares that ends each round of the fit."""
_ROUGH, _FEW = (1e-2, 1e-3), 6
"""The same of the fits that look for optima, and their trials in each round."""
_REPEATS = 5
"""Largest number of fits, each of which starts from the result of the previous fit."""
_STAYS = 0.5
"""Standard errors by which the result of a repeated fit may move."""
_ASIDE = 3.0
"""Standard errors to either side over which a prediction has to be straight."""
_FARTHEST = 0.05
"""Largest relative change of a parameter for the measurement of curvature. A phase changes by a
fifth of it."""
_BENT = 0.3
"""Bend of a residual that counts as none, in units of its noise."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit:
    """Unknowns that minimise the distance of an orbit to a recording.

    Attributes:
        x: The unknowns, ``(k + 1,)``. With a second file its delay is the last but one.
        data: The samples that count.
        jacobian: Derivatives of the residuals with respect to the unknowns, ``(n_r, k + 1)``. The
            rows are those of the samples, of the contact channels, and of the period.
        residuals: Residuals in units of their noise, ``(n_r,)``.
        spread: Uncertainty of the unknowns.
        before: Root mean square deviation at the start, in parts of the ranges.
        after: The same after the fit.
        repeating: Common deviation of all cycles, without the contribution of noise.
        converged: Whether the last fit converged, with samples selected at its own orbit.
        stage: The residuals as functions of the unknowns.
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
    stage: Weighed | None = None

    def part(self, clock: int) -> Fit:
        """Return the samples of one file of two, whose delay is then the shift."""
        if self.data.clocks is None:
            return self
        data, n = self.data.part(clock), self.data.values.size
        rows = self.data.entries(clock, self.jacobian[:n])
        return replace(
            self,
            data=data,
            jacobian=np.delete(rows, -2, axis=1),
            residuals=self.data.entries(clock, self.residuals[:n]),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Weighed:
    """Residuals in units of their noise, for a round of the fit.

    Attributes:
        orbits: Predictions of orbits.
        data: The samples that count.
        found: The period of the recording.
        weights: Inverse standard deviation of the noise, ``(n, n_s)``.
        contacts: The edges of the contact channels.
    """

    orbits: Predictions
    data: Folded
    found: Periodicity
    weights: Vector
    contacts: ContactRows = NO_CONTACTS

    def residuals(self, x: Vector) -> Vector:
        """Return the residuals of samples, contact channels and period, ``(n_r,)``.

        Unknowns without an orbit have large residuals.
        """
        try:
            fold = self.orbits.fold(x, self.data)
            events = self.orbits.events(x)
        except SimulationError:
            return np.full(self.data.values.size + self.contacts.n_rows + 1, _FAR)
        rest = np.where(self.data.seen, (self.data.values - fold.values) * self.weights, 0.0)
        edges = self.contacts.residuals(events, float(x[-1]))
        late = (self.found.period - events.period) / self.found.error
        return np.concatenate([rest.ravel(), edges, [late]])

    def jacobian(self, x: Vector) -> Vector:
        """Return their exact derivatives, ``(n_r, k + 1)``."""
        # The next orbits are searched near the accepted unknowns.
        self.orbits.accept(x)
        slopes = self.orbits.slopes(x, self.data)
        whole = -slopes.signals * self.weights[:, :, None]
        whole = np.where(self.data.seen[:, :, None], whole, 0.0).reshape(-1, len(x))
        edges = self.contacts.jacobian(
            self.orbits.events(x), float(x[-1]), self.orbits.event_slopes(x), slopes.period
        )
        return np.concatenate([whole, edges, -slopes.period[None] / self.found.error])


def fit(
    orbits: Predictions,
    samples: Folded,
    found: Periodicity,
    first: Vector,
    on_progress: Progress,
    contacts: ContactRows = NO_CONTACTS,
) -> Fit:
    """Return the unknowns whose orbit fits samples best, near a start.

    The selection of the samples depends on the orbit, because samples near its jumps are excluded.
    So the fit is repeated from its own result until the selection does not change.

    Args:
        orbits: Predictions of orbits at unknowns.
        samples: The recording, folded.
        found: Period of the recording.
        first: Initial unknowns, ``(k + 1,)``.
        on_progress: Called with each stage and the part that is done.
        contacts: The edges of the contact channels.
    """
    x, ends, answer = first, False, None
    for number in range(_REPEATS):
        answer = _fitted_from(orbits, samples, found, x, on_progress, contacts)
        x, ends = answer.x, not answer.spread.apart(answer.x - x, _STAYS)
        if ends and number:
            break
    if answer is None:
        raise ValueError("Argument `_REPEATS` must be positive.")
    plain = samples.without_jumps(orbits.table(first)).without_jumps(orbits.table(x))
    before, after = (deviation(orbits, plain, at) for at in (first, x))
    return replace(
        answer,
        before=before,
        after=after,
        repeating=after * answer.spread.common,
        converged=answer.converged and ends,
    )


def _fitted_from(
    orbits: Predictions,
    samples: Folded,
    found: Periodicity,
    first: Vector,
    on_progress: Progress,
    contacts: ContactRows,
) -> Fit:
    """Return the result of fit rounds. The first round excludes samples near jumps of the start."""
    x, converged = first, True
    data = samples.without_jumps(orbits.table(first))
    stage = weighed(orbits, data, found, first, contacts)
    # Each round uses weights from the residuals of the previous round.
    for number, change in enumerate(_SETTLED):
        on_progress("fitting", number / len(_SETTLED))
        x, converged = _nearest(stage, x, change)
        bent = _bent(stage, x, samples) if number == 0 else ~data.seen
        if number < len(_SETTLED) - 1:
            stretches = [stretch_of(stage, x, clock) for clock in range(data.n_clocks)]
            factor, error, _ = stretches[0]
            width = max(one.width for one in stretches)
            samples = samples.stretched(*(one.factor for one in stretches))
            contacts = contacts.stretched(factor)
            found = replace(found, period=found.period * factor, error=found.period * error)
            phases = samples.phases - orbits.shift(x, samples)
            data = samples.without(bent | beside_jumps(orbits.table(x), phases, width))
        stage = weighed(orbits, data, found, x, contacts)
    on_progress("computing the intervals", 0.95)
    jacobian, residuals = stage.jacobian(x), stage.residuals(x)
    return Fit(
        x=x,
        data=data,
        jacobian=jacobian,
        residuals=residuals,
        spread=spread_of(jacobian, residuals, data),
        before=math.nan,
        after=math.nan,
        repeating=math.nan,
        converged=converged,
        stage=stage,
    )


def rough_fit(
    orbits: Predictions,
    samples: Folded,
    found: Periodicity,
    first: Vector,
    contacts: ContactRows = NO_CONTACTS,
) -> tuple[Vector, Weighed]:
    """Return unknowns of a fit of two short rounds, the samples chosen anew for the second one.

    Args:
        orbits: Predictions of orbits at unknowns.
        samples: The recording, folded.
        found: Period of the recording.
        first: Initial unknowns, ``(k + 1,)``.
        contacts: The edges of the contact channels.
    """
    x = first
    stage = weighed(orbits, samples.without_jumps(orbits.table(x)), found, x, contacts)
    for change in _ROUGH:
        x, _ = _nearest(stage, x, change, trials=_FEW)
        stage = weighed(orbits, samples.without_jumps(orbits.table(x)), found, x, contacts)
    return x, stage


class Stretch(NamedTuple):
    """Factor of a period, its standard error, and the uncertainty of phases in periods."""

    factor: float
    error: float
    width: float


def stretch_of(stage: Weighed, x: Vector, clock: int = 0) -> Stretch:
    """Return the period of a file from a fit to its samples, and the uncertainty of their phases.

    The orbit itself determines the period better than harmonics, which smooth its kinks.

    Args:
        stage: The residuals.
        x: The unknowns.
        clock: Index of the file.
    """
    whole, data = stage.data, stage.data.part(clock)
    jacobian, residuals = (
        whole.entries(clock, one[: whole.values.size])
        for one in (stage.jacobian(x), stage.residuals(x))
    )
    if whole.clocks is not None:
        # Within one file the delay is the shift.
        jacobian = np.delete(jacobian, -2, axis=1)
    if not data.seen.any():
        relative = stage.found.error / stage.found.period
        ends = relative * float(np.max(np.abs(data.turns), initial=0.0))
        return Stretch(1.0, relative, jump_width(ends))
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
    return Stretch(1.0 + float(change[-1]), error, jump_width(ends))


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


def weighed(
    orbits: Predictions,
    data: Folded,
    found: Periodicity,
    x: Vector,
    contacts: ContactRows = NO_CONTACTS,
) -> Weighed:
    """Return the residuals in units of their size at some unknowns, signal by signal.

    Args:
        orbits: Predictions.
        data: The samples that count.
        found: The period of the recording.
        x: The unknowns, ``(k + 1,)``.
        contacts: The edges of the contact channels.
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
    return Weighed(orbits=orbits, data=data, found=found, weights=weights, contacts=contacts)


def _nearest(
    stage: Weighed, x: Vector, settled: float, trials: int = _TRIALS
) -> tuple[Vector, bool]:
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
        max_nfev=trials,
    )
    return np.asarray(answer.x, dtype=np.float64), int(answer.status) > 0


def _bent(stage: Weighed, x: Vector, samples: Folded) -> NDArray[np.bool_]:
    """Return the mask of samples whose prediction is nonlinear in the unknowns, ``(n, n_s)``."""
    jacobian = stage.jacobian(x)
    spread = spread_of(jacobian, stage.residuals(x), stage.data)
    whole = replace(stage, data=samples)
    here, slopes = whole.residuals(x), whole.jacobian(x)
    shape = samples.values.shape
    n_groups = samples.n_groups
    # The error of a mean from the curvature inside its bin is the same in all groups.
    inside = stage.orbits.bends(x, samples) * whole.weights
    bend = math.sqrt(n_groups) * inside
    for step in _steps(jacobian, spread.inflation):
        there = np.clip(x + step, *stage.orbits.unknowns.bounds)
        off = whole.residuals(there) - here - slopes @ (there - x)
        bend = np.maximum(bend, np.abs(off[: samples.values.size].reshape(shape)))
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
