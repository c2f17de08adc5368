r"""One fit of a recorded gap: level of the stop, release, flight, impact, rebounds and contact.

The orbit's gap :math:`H` is deformed until it fits the recording. With the time :math:`s` since the
release, flight 0 is stretched to its fitted length and multiplied by a quadratic. Rebound 1 is
stretched and multiplied by a straight line. Rebound `k` is stretched by :math:`\lambda q^{k-1}` and
multiplied by :math:`(1 + a) q^{2(k-1)}`, so `q` is the ratio of the two restitutions. The level is
an unknown. All cycles are fitted at once, because a fit of a single cycle is biased by its noise.
In a copy of the orbit the deformation vanishes (theory (6.9)).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.alignment import Alignment
from zeno_orbits.experiment.comparison.estimate import UNKNOWN, Estimate
from zeno_orbits.experiment.comparison.gap_model import GapModel
from zeno_orbits.experiment.comparison.gap_samples import GapSamples, gather

LEVEL, RELEASE, LENGTH, SIZE, TILT, BEND, STRETCH, HEIGHT, LEAN, RATIO = range(10)
"""The unknowns: changes relative to the orbit, times in periods, the level in its highest gap."""

_PRIOR = np.array([1.0, 0.3, 0.3, 10.0, 1.0, 1.0, 0.5, 0.5, 0.2, 0.05])
"""Prior standard deviation of each unknown. It matters only for unknowns without samples.

The guesses are the orbit's values, with two exceptions. The height of a rebound of another length
follows from the same gap acceleration. All impacts have the restitution of the first impact, up to
5 %."""

_LEAST = 6
"""Distinct phases at which a flight must be sampled for its shape to be known."""
_STARTS = (1.0, 0.5, 1.6, 0.25)
"""Trial lengths of the first rebound, relative to the orbit's first rebound."""
_COARSE = 400
"""Bins of the phase in which the starts are compared."""
_LOBE = 0.25
"""Part of the highest gap above which the longest flight is searched."""
_OUTLIER = 8.0
"""Standard deviations beyond which a sample does not count."""
_LEAN = 0.6
"""Slope of the factor of a rebound at most."""
_TAIL = 0.15
"""Relative change of the later rebounds that gives the uncertainty of their end."""
_SURE = 0.5
"""Relative standard error above which a number counts as not resolved."""
_BINS = 120
_SIGNIFICANT = 4.0
"""Standard deviations from which a part of the residuals that repeats is not noise."""
_ENDS = 4.0
"""Slope of a parabola at its ends over its height and length. A rebound off a compliant stop is no
parabola, and the slopes at its ends are as uncertain as its shape."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ContactFit:
    """Contacts of a recorded gap, with times since the aligned release of the orbit.

    Attributes:
        level: Gap in contact, the offset of the instruments.
        noise: Standard deviation of a sample.
        landing: First impact [s].
        speed: Gap rate before it, negative.
        restitution: Speed after the impact divided by the speed before it. It is unknown if no
            rebound is resolved.
        chatter_end: End of the rebounds, including the sum of the rebounds hidden by the noise [s].
        chatter: Time from the first impact to the end of the rebounds [s].
        contact: Time from the end of the rebounds to the release [s].
        release: Time at which the gap begins to open [s].
        misfit: Root mean square of the periodic part of the residuals, relative to the range.
        rebound_share: Part of the mean squared gap in the first rebound that the fit does not
            explain. It is NaN without a rebound.
        rebound_doubt: Further standard error of the restitution, from a first rebound that is no
            flight off a hard stop.
        resting: Time in which the mean gap is at the level [s].
        resolved: Whether the samples resolve the contact, the flight, and a short rebound.
    """

    level: Estimate
    noise: float
    landing: Estimate
    speed: Estimate
    restitution: Estimate
    chatter_end: Estimate
    chatter: Estimate
    contact: Estimate
    release: Estimate
    misfit: float
    rebound_share: float
    rebound_doubt: float
    resting: float
    resolved: Resolved


@dataclass(frozen=True, slots=True, kw_only=True)
class Resolved:
    """Whether the sampling rate and noise level resolve the parts of the orbit's own gap.

    Attributes:
        contact: Whether the contact phase is resolved.
        flight: Whether the end of the first flight is resolved.
        short_rebounds: Whether a rebound of a quarter of the length of the first rebound is
            resolved.
    """

    contact: bool
    flight: bool
    short_rebounds: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Deformed:
    """The orbit's gap, deformed."""

    model: GapModel
    height: float
    n: int

    def gap(self, x: Vector, since: Vector) -> Vector:
        """Return the gap at times since the aligned release, ``(n,)``."""
        model, period = self.model, self.model.period
        edges, scale = self.edges(x)
        s: Vector = np.mod(since - float(x[RELEASE]) * period, period)
        number: Any = np.searchsorted(edges, s, side="right")
        found: NDArray[np.int64] = np.asarray(number, dtype=np.int64) - 1
        flying: NDArray[np.bool_] = found < len(model.flights)
        k: NDArray[np.int64] = np.minimum(found, len(model.flights) - 1)
        starts = np.array([one.start for one in model.flights])
        ends = np.array([one.end for one in model.flights])
        part = (s - edges[k]) / np.maximum(edges[k + 1] - edges[k], 1e-15 * period)
        own = starts[k] + np.clip(part, 0.0, 1.0 - 1e-9) * (ends[k] - starts[k])
        first = 2.0 * part - 1.0
        shape = 1.0 + x[SIZE] + x[TILT] * first + x[BEND] * (1.5 * first**2 - 0.5)
        leaning = 1.0 + self.lean(x) * first
        size = np.where(k == 0, shape, scale[k] * np.where(k == 1, leaning, 1.0))
        values = model.nodes.at(own)[:, 0] * size
        return x[LEVEL] * self.height + np.where(flying, values, 0.0)

    def edges(self, x: Vector) -> tuple[Vector, Vector]:
        """Return release, impacts and end of the chatter since the release, and rebound heights."""
        lengths = np.array([one.end - one.start for one in self.model.flights])
        number = np.arange(len(lengths) - 1)
        lengths[0] = lengths[0] * max(1.0 + x[LENGTH], 0.05)
        heights = np.ones(len(lengths))
        tail = self.model.zeno_time - self.model.flights[-1].end
        if self.n > STRETCH:
            ratio = np.clip(1.0 + x[RATIO], 0.02, 0.98 / max(self.model.restitution, 0.02))
            stretch = max(1.0 + x[STRETCH], 0.01)
            lengths[1:] *= stretch * ratio**number
            heights[1:] = (1.0 + x[HEIGHT]) * ratio ** (2 * number)
            tail *= stretch * ratio ** len(number)
        edges = np.concatenate([[0.0], np.cumsum(lengths)])
        edges[-1] += tail
        return edges, heights

    def lean(self, x: Vector) -> float:
        """Return the slope of the factor of rebound 1, which has to stay positive."""
        return _LEAN * math.tanh(x[LEAN] / _LEAN) if self.n > STRETCH else 0.0

    @property
    def tail(self) -> float:
        """The orbit's own time from the end of its first rebound to its Zeno point [s]."""
        return self.model.zeno_time - self.model.flights[1 if self.n > STRETCH else 0].end

    def speeds(self, x: Vector) -> tuple[float, float]:
        """Return the gap rates before and after the first impact."""
        flights, edges = self.model.flights, self.edges(x)[0]
        shape = 1.0 + x[SIZE] + x[TILT] + x[BEND]
        down = flights[0].rate * (flights[0].end - flights[0].start) / edges[1] * shape
        if self.n <= STRETCH:
            return down, 0.0
        up = -self.model.restitution * flights[0].rate
        return down, up * (1.0 + x[HEIGHT]) * (1.0 - self.lean(x)) / (1.0 + x[STRETCH])

    def ratio(self, x: Vector) -> float:
        """Return the restitution of the first impact over the orbit's."""
        down, up = self.speeds(x)
        return float(np.clip(-up / down / self.model.restitution, 0.02, 50.0))

    def prior(self, x: Vector) -> Vector:
        """Return the distances of the unknowns from their guesses, in prior standard deviations."""
        guess = np.zeros(self.n)
        if self.n > STRETCH:
            guess[HEIGHT] = (1.0 + x[STRETCH]) ** 2 - 1.0
            guess[RATIO] = self.ratio(x) - 1.0
        return (x - guess) / _PRIOR[: self.n]


def fit_contacts(
    time: Vector, gap: Vector, model: GapModel, where: Alignment, level: float
) -> ContactFit | None:
    """Return the contacts of a recorded gap, or ``None`` for too few samples.

    Args:
        time: Increasing times, ``(n_t,)`` [s].
        gap: Recorded gap, ``(n_t,)``. A missing sample is NaN.
        model: The orbit's gap, in the period of the record.
        where: Alignment of the orbit with the record.
        level: First estimate of the gap in contact.
    """
    samples = gather(time, gap, where)
    if len(samples.gap) < 4 * _LEAST:
        return None
    own = model.nodes.at(np.linspace(0.0, model.period, 2000))[:, 0]
    rebounds = len(model.flights) > 1 and model.restitution > 0.0
    shape = _Deformed(model=model, height=float(own.max()), n=10 if rebounds else 6)
    x = _start(shape, samples, level)
    x, samples, noise = _nearest(shape, samples, x)
    covariance = _covariance(shape, samples, x, noise)
    return _result(shape, samples, x, covariance, noise)


def _start(shape: _Deformed, samples: GapSamples, level: float) -> Vector:
    """Return the best of several first fits to the mean cycle."""
    mean = samples.averaged(_COARSE)
    model = shape.model
    grid = (np.arange(_COARSE) + 0.5) / _COARSE * model.period
    seen = np.interp(grid, mean.since, mean.gap, period=model.period) - level
    own = model.nodes.at(grid)[:, 0]
    (begin, length), (own_begin, own_length) = _lobe(seen), _lobe(own)
    longer = length / own_length
    begin -= longer * own_begin
    first = np.zeros(shape.n)
    first[LEVEL] = level / shape.height
    first[RELEASE] = (begin + 0.5) % 1.0 - 0.5
    first[LENGTH], first[SIZE] = longer - 1.0, seen.max() / own.max() - 1.0
    plain = np.zeros(shape.n)
    plain[LEVEL] = first[LEVEL]
    found: list[tuple[float, Vector]] = []
    spread = 1e-3 * max(float(np.ptp(mean.gap)), 1e-9 * shape.height)
    for number, stretch in enumerate((1.0, *_STARTS) if shape.n > STRETCH else (1.0, 1.0)):
        x = first.copy() if number else plain
        if shape.n > STRETCH:
            x[STRETCH] = stretch - 1.0
            x[HEIGHT] = stretch**2 - 1.0
            x[RATIO] = shape.ratio(x) - 1.0
        found.append(_solve(shape, mean, x, spread, 12))
    return min(found, key=lambda one: one[0])[1]


def _lobe(row: Vector) -> tuple[float, float]:
    """Return begin and length of the stretch around the highest value, in periods."""
    n, top = len(row), int(np.argmax(row))
    high = np.roll(row, -top) > _LOBE * row[top]
    after = int(np.argmin(high)) if not high.all() else n // 2
    before = int(np.argmin(high[::-1])) if not high.all() else n // 2
    return (top - before) / n, max(after + before, 1) / n


def _solve(
    shape: _Deformed, samples: GapSamples, x: Vector, noise: float, most: int
) -> tuple[float, Vector]:
    from scipy.optimize import least_squares

    weight = np.sqrt(samples.counts) / noise

    def rest(x: Vector) -> Vector:
        return np.concatenate(
            [weight * (samples.gap - shape.gap(x, samples.since)), shape.prior(x)]
        )

    answer = least_squares(rest, x, method="lm", max_nfev=most * (shape.n + 1), x_scale=1e-2)
    return float(answer.cost), np.asarray(answer.x, dtype=np.float64)


def _nearest(shape: _Deformed, samples: GapSamples, x: Vector) -> tuple[Vector, GapSamples, float]:
    """Return the least squares over all samples but outliers, and the noise of a sample."""
    for _ in range(2):
        noise = _noise(shape, samples, x)
        x = _solve(shape, samples, x, noise, 60)[1]
        rest = (samples.gap - shape.gap(x, samples.since)) * np.sqrt(samples.counts)
        usual = 1.4826 * float(np.median(np.abs(rest))) or noise
        stray = np.abs(rest) > _OUTLIER * max(usual, noise)
        if not stray.any() or stray.mean() > 0.02:
            break
        samples = samples.chosen(~stray)
    return x, samples, _noise(shape, samples, x)


def _noise(shape: _Deformed, samples: GapSamples, x: Vector) -> float:
    rest = samples.gap - shape.gap(x, samples.since)
    square = float(np.sum(samples.counts * rest**2)) / max(len(rest) - shape.n, 1)
    return max(math.sqrt(square), 1e-9 * shape.height)


def _jacobian(shape: _Deformed, samples: GapSamples, x: Vector) -> Vector:
    columns: list[Vector] = []
    for k in range(shape.n):
        step = np.zeros(shape.n)
        step[k] = 1e-5
        ahead, behind = (shape.gap(x + sign * step, samples.since) for sign in (1.0, -1.0))
        columns.append((ahead - behind) / 2e-5)
    return np.stack(columns, axis=1)


def _covariance(shape: _Deformed, samples: GapSamples, x: Vector, noise: float) -> Vector:
    """Return the covariance of the unknowns: the scatter of cycles, at least independent noise."""
    weight = samples.counts / noise**2
    slopes = _jacobian(shape, samples, x)
    prior = np.stack(
        [(shape.prior(x + step) - shape.prior(x - step)) / 2e-5 for step in 1e-5 * np.eye(shape.n)],
        axis=1,
    )
    granted = prior.T @ prior
    inverse = np.linalg.pinv((slopes.T * weight) @ slopes + granted, rcond=1e-15, hermitian=True)
    rest = samples.gap - shape.gap(x, samples.since)
    terms = slopes * (weight * rest)[:, None]
    n = int(samples.groups.max()) + 1
    each = np.stack([np.bincount(samples.groups, weights=row, minlength=n) for row in terms.T])
    scatter = n / max(n - 1, 1) * each @ each.T if n > 3 else np.zeros_like(inverse)
    plain = (slopes.T * weight) @ slopes
    found = inverse @ (scatter + granted) @ inverse
    least = inverse @ (plain + granted) @ inverse
    # The periodic part of the residuals is not noise and does not decrease with the number of
    # cycles.
    factor = max(_repeating(samples, rest, noise), 1.0)
    larger = np.sqrt(np.maximum(np.diag(least) / np.maximum(np.diag(found), 1e-300), 1.0))
    return factor * found * np.outer(larger, larger)


def _repeating(samples: GapSamples, rest: Vector, noise: float) -> float:
    """Return the variance of mean residuals by phase relative to noise, 1 if insignificant."""
    weight, mean = samples.by_phase(rest, _BINS)
    known = weight > 0.0
    ratio = float(np.mean(weight[known] * mean[known] ** 2)) / noise**2
    certain = _SIGNIFICANT * math.sqrt(2.0 / max(int(known.sum()), 1))
    return ratio if ratio > 1.0 + certain else 1.0


def _result(
    shape: _Deformed, samples: GapSamples, x: Vector, covariance: Vector, noise: float
) -> ContactFit:
    period = shape.model.period

    def estimate(number: Callable[[Vector], float], limit: float = math.inf) -> Estimate:
        value, steps = float(number(x)), 1e-5 * np.eye(shape.n)
        slope = np.array([(number(x + d) - number(x - d)) / 2e-5 for d in steps])
        error = math.sqrt(max(float(slope @ covariance @ slope), 0.0))
        return Estimate(value=value, error=error) if error < limit else UNKNOWN

    edges, _ = shape.edges(x)
    begin = x[RELEASE] * period
    seen = _resolved(shape, samples, noise)
    rebound = shape.n > STRETCH and samples.distinct(begin + edges[1], begin + edges[2]) >= _LEAST
    flight = samples.distinct(begin + 0.5 * edges[1], begin + edges[1]) >= _LEAST
    late = 0.05 * period
    landing = estimate(lambda x: x[RELEASE] * period + shape.edges(x)[0][1], late)
    speed = estimate(lambda x: shape.speeds(x)[0])
    down, up = shape.speeds(x)
    bounce = UNKNOWN
    if rebound:
        bounce = estimate(lambda x: -shape.speeds(x)[1] / shape.speeds(x)[0], 0.25)
        if bounce.known and bounce.error > _SURE * abs(bounce.value) and -up / down > 0.1:
            bounce = UNKNOWN
    # The tail of another motion is not quite the orbit's, stretched.
    doubt = _TAIL * abs(edges[-1] - edges[2 if rebound else 1] - shape.tail)
    ends = flight and (rebound or shape.n <= STRETCH)
    chatter_end = estimate(lambda x: x[RELEASE] * period + shape.edges(x)[0][-1], late)
    chatter = estimate(lambda x: shape.edges(x)[0][-1] - shape.edges(x)[0][1], late)
    contact = estimate(lambda x: period - shape.edges(x)[0][-1], late)
    landed = begin + edges[1]
    share, doubtful = math.nan, 0.0
    if shape.n > STRETCH:
        inside = (landed, landed + edges[2] - edges[1])
        share, is_sure = _left(shape, samples, x, noise, inside)
        doubtful = _ENDS * math.sqrt(share) * abs(bounce.value) if is_sure else 0.0
    return ContactFit(
        level=estimate(lambda x: x[LEVEL] * shape.height),
        noise=noise,
        landing=landing if flight else UNKNOWN,
        speed=speed if flight else UNKNOWN,
        restitution=bounce if flight else UNKNOWN,
        chatter_end=chatter_end.unsure(doubt) if ends else UNKNOWN,
        chatter=chatter.unsure(doubt) if ends else UNKNOWN,
        contact=contact.unsure(doubt) if ends else UNKNOWN,
        release=estimate(lambda x: (1.0 + x[RELEASE]) * period, late) if seen.contact else UNKNOWN,
        misfit=_misfit(shape, samples, x, noise),
        rebound_share=share,
        rebound_doubt=doubtful,
        resting=_resting(samples, x[LEVEL] * shape.height, noise),
        resolved=seen,
    )


def _misfit(shape: _Deformed, samples: GapSamples, x: Vector, noise: float) -> float:
    """Return the size of the periodic part of the residuals, without the contribution of noise."""
    weight, mean = samples.by_phase(samples.gap - shape.gap(x, samples.since), _BINS)
    known = weight > 0.0
    square = float(np.mean(mean[known] ** 2 - noise**2 / weight[known]))
    return math.sqrt(max(square, 0.0)) / max(float(np.ptp(samples.gap)), 1e-300)


def _left(
    shape: _Deformed, samples: GapSamples, x: Vector, noise: float, between: tuple[float, float]
) -> tuple[float, bool]:
    """Return the part of the mean gap's square between two times that the fit leaves.

    The second value is True if the part is more than noise.
    """
    mean = samples.averaged(_COARSE)
    inside = np.mod(mean.since - between[0], mean.period) < between[1] - between[0]
    gap = (mean.gap - x[LEVEL] * shape.height)[inside]
    rest = (mean.gap - shape.gap(x, mean.since))[inside]
    each = noise**2 / mean.counts[inside]
    white, spread = float(np.sum(each)), math.sqrt(2.0 * float(np.sum(each**2)))
    left = float(rest @ rest) - white
    return max(left, 0.0) / max(float(gap @ gap) - white, 1e-300), left > _SIGNIFICANT * spread


def _resolved(shape: _Deformed, samples: GapSamples, noise: float) -> Resolved:
    """Compute which contacts of the orbit the samples resolve."""
    model = shape.model
    first, short = model.flights[0], True
    if shape.n > STRETCH:
        second = model.flights[1]
        inside = np.linspace(second.start, second.end * (1 - 1e-12), 50)
        height = float(model.nodes.at(inside)[:, 0].max())
        seen = samples.distinct(second.start, second.end)
        quiet = 3.0 * noise / math.sqrt(max(samples.within(second.start, second.end), 1.0))
        # A quarter of the length has a sixteenth of the height and a quarter of the samples.
        short = seen >= 4 * _LEAST and height > 32.0 * quiet
    return Resolved(
        contact=samples.distinct(model.zeno_time, model.period) >= _LEAST,
        flight=samples.distinct(0.5 * first.end, first.end) >= _LEAST,
        short_rebounds=short,
    )


def _resting(samples: GapSamples, level: float, noise: float) -> float:
    """Return the longest time in which the mean gap stays at a level [s]."""
    weight, mean = samples.by_phase(samples.gap - level, 2 * _BINS)
    known = np.flatnonzero(weight > 0.0)
    finest = 1e-3 * float(np.ptp(samples.gap))
    still = np.abs(mean[known]) < np.maximum(4.0 * noise / np.sqrt(weight[known]), finest)
    if still.all():
        return samples.period
    turn = -int(np.argmin(still))
    edges = np.diff(np.roll(still, turn).astype(np.int64), append=0)
    begins, ends = np.flatnonzero(edges > 0) + 1, np.flatnonzero(edges < 0)
    places = np.roll(known, turn)
    spans = (places[ends] - places[begins]) % (2 * _BINS) + 1
    return float(np.max(spans, initial=0)) / (2 * _BINS) * samples.period
