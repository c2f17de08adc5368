"""Quantities of recorded signals and portraits next to the orbit's quantities (theory (6.10))."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, ndtr, ndtri, stdtrit

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.deviations import (
    FINE,
    N_BINS,
    Deviations,
    Portrait,
    deviations_between,
    slope_noises,
)
from zeno_orbits.experiment.comparison.estimate import UNKNOWN, Estimate
from zeno_orbits.experiment.comparison.metrics import Metric, metric
from zeno_orbits.experiment.orbit_table import jump_bins, measurable
from zeno_orbits.experiment.polyline import line_distances
from zeno_orbits.model import Problem

_ASIDE = 3
"""Number of bins on either side of an extreme that determine the deviation there."""
_RARE = 0.05
"""Probability at which noise alone exceeds a bound: once in twenty times."""
_DRAWS = 40
"""Drawn curves of noise alone. Their mean distance has 16 % of its scatter as error."""


def signal_metrics(problem: Problem, found: Deviations, names: Sequence[str]) -> Iterator[Metric]:
    """Yield extremes, sizes of the deviation and the delay of every signal.

    Args:
        problem: The problem.
        found: The deviations.
        names: Names of the signals, in order.
    """
    units, table = measurable(problem), found.table
    late = delays(found)
    parts = table.parts(found.phases)
    for k, name in enumerate(names):
        own, unit = found.fine[:, :, k], units[name]
        # Rounding is no noise: samples at one phase of all cycles may be rounded alike.
        rounding = float(found.rounding[k])
        highest, lowest = (apex(found, k, sign).rounded(rounding) for sign in (1.0, -1.0))
        yield metric(f"highest of {name}", unit, float(own.max()), highest)
        yield metric(f"lowest of {name}", unit, float(own.min()), lowest)
        for part, chosen in parts.items():
            if chosen.any() and np.isfinite(found.average[chosen, k]).any():
                size = root_mean_square(found, k, chosen)
                yield metric(f"{f'rms deviation {part}'.rstrip()} of {name}", unit, 0.0, size)
        yield metric(f"greatest deviation of {name}", unit, 0.0, greatest(found, k))
        yield metric(f"delay of {name}", "s", 0.0, late[k])


def recorded_portraits_of(problem: Problem, names: Sequence[str]) -> tuple[Portrait, ...]:
    """Return the portraits of a problem that recorded signals can be drawn in.

    Args:
        problem: The problem.
        names: Names of the recorded signals.
    """
    n_q = problem.model(problem.symbols()).n_q
    rates = dict(zip(problem.state_names[n_q : 2 * n_q], problem.state_names[:n_q], strict=True))
    found: list[Portrait] = []
    for first, second in problem.portraits:
        rate_of = "" if second in names else rates.get(second, "")
        if first in names and (rate_of or second) in names:
            found.append(Portrait(signals=(first, second), rate_of=rate_of))
    return tuple(found)


def portrait_metrics(found: Deviations, portraits: Sequence[Portrait]) -> Iterator[Metric]:
    """Yield how far the closed curves are apart, in every portrait."""
    for portrait in portraits:
        first, second = portrait.signals
        of = f"distance in the portrait of {first} and {second}"
        mean, largest = portrait_distance(found, portrait)
        yield metric(f"mean {of}", "1", 0.0, mean)
        yield metric(f"greatest {of}", "1", 0.0, largest)


def root_mean_square(found: Deviations, signal: int, chosen: NDArray[np.bool_]) -> Estimate:
    """Return the root mean square of a signal's deviation over chosen bins, without the noise.

    Args:
        found: The deviations.
        signal: Index of the signal.
        chosen: Mask of the bins that count, ``(N_BINS,)``.
    """
    counts: Vector = found.counts.sum(axis=0)[chosen, signal]
    seen = counts > 0.5
    # Sums of squares over bins, with their degrees of freedom, determine the variance.
    parts = 1.0 / counts[seen]
    freedom = float(np.sum(counts[seen] - 1.0))
    white = limit = 0.0
    if freedom > 0.0:
        squares = counts[seen] * found.spread[chosen, signal][seen] ** 2
        white = float(np.sum(squares)) / freedom * float(np.mean(parts))
        n = 1.0 / (float(np.sum(parts**2)) / float(np.sum(parts)) ** 2 + 1.0 / freedom)
        # Noise alone leaves less than this limit in 95 % of the recordings.
        limit = math.sqrt(white * max(float(chdtri(n, _RARE)) / n - 1.0, 0.0))

    def size(average: Vector) -> float:
        known = average[chosen & np.isfinite(average[:, signal]), signal]
        if not len(known):
            return math.nan
        return math.sqrt(max(float(np.mean(known**2)) - white, 0.0))

    one = found.estimate(size)
    one = _at_least(one, limit / 2.0) if one.value < 2.0 * limit else one
    return one.rounded(float(found.rounding[signal]))


def greatest(found: Deviations, signal: int) -> Estimate:
    """Return the greatest mean deviation of a signal, with its sign.

    A bin with samples of a single group is excluded because its error is unknown.
    """
    seen = np.sum(found.counts[:, :, signal] > 0.0, axis=0) > 1
    if not seen.any():
        return UNKNOWN
    at = int(np.argmax(np.where(seen, np.abs(found.average[:, signal]), -1.0)))
    one = found.estimate(lambda average: float(average[at, signal]))
    one = _at_least(one, _of_many(found.noises[seen, signal]))
    return one.rounded(float(found.rounding[signal]))


def _at_least(one: Estimate, error: float) -> Estimate:
    return replace(one, error=max(one.error, error))


def apex(found: Deviations, signal: int, sign: float) -> Estimate:
    """Return the highest or lowest value of a signal over the cycle.

    It is the orbit's own with the deviation there, a straight line through the bins around it: the
    largest of all bins would be raised by noise. Only if another bin is higher beyond chance, the
    extreme is searched around that bin.

    Args:
        found: The deviations.
        signal: Its number.
        sign: 1 for the highest, -1 for the lowest.
    """
    fine: Vector = sign * found.fine[:, :, signal]
    own: Vector = fine.max(axis=1)
    noise = float(found.noise[signal])
    row, apart = deviations_between(found.average[:, signal])
    centre = _middle(own, noise)
    chosen = _around(found, signal, centre, fine)
    places = (chosen[:, None] - centre + (np.arange(FINE + 1) / FINE - 0.5)).ravel()
    curve: Vector = fine[chosen % N_BINS].ravel()
    # A bin is as high as its highest point: impacts touch the stop from which they rise.
    flat = float(np.ptp(own[chosen % N_BINS])) < 4.0 * noise or centre not in chosen

    def value(average: Vector) -> float:
        known = chosen[np.isfinite(average[chosen % N_BINS, signal])]
        if not len(known):
            return float(own[centre] + sign * row[centre])
        x: Vector = (known - centre).astype(np.float64)
        y: Vector = sign * average[known % N_BINS, signal]
        sloped = len(x) > 2 and (not flat or centre not in chosen)
        level, slope = _line(x, y) if sloped else (float(np.mean(y)), 0.0)
        if flat:
            return float(own[centre]) + level
        return float(np.max(curve + level + slope * places))

    def signed(average: Vector) -> float:
        return sign * value(average)

    # The jackknife may include few of the samples near a jump. White noise gives a lower bound.
    one = found.estimate(signed)
    one = _at_least(one, _white_error(found, signal, signed, chosen % N_BINS))
    heights: Vector = (
        np.where(own - fine.mean(axis=1) > np.abs(row), own, fine.mean(axis=1)) + sign * row
    )
    noises: Vector = found.noises[:, signal]
    beyond = heights - 4.0 * noises
    highest = int(np.argmax(beyond))
    if beyond[highest] > sign * one.value + _of_many(noises):
        # If the shape differs from the orbit's shape, use its own highest bin and the difference of
        # the neighbours.
        beside = float(heights[(highest - 1) % N_BINS] + heights[(highest + 1) % N_BINS]) / 2.0
        bend = (float(heights[highest]) - beside) / 2.0
        error = math.hypot(float(noises[highest]), bend)
        return Estimate(value=sign * float(heights[highest]), error=error)
    # If no sample falls at the extreme, the deviation lies between the deviations before and after
    # it. An extrapolated deviation from samples near the extreme is not reliable.
    seen = np.isfinite(found.average[centre, signal])
    unseen = 0.0 if seen else abs(one.value - sign * float(own[centre]))
    return _at_least(one, max(float(apart[centre]), unseen))


def _line(x: Vector, y: Vector) -> tuple[float, float]:
    """Return value at zero and slope of the straight line through points."""
    centred = x - np.mean(x)
    slope = float(centred @ y) / float(centred @ centred)
    return float(np.mean(y)) - slope * float(np.mean(x)), slope


def _white_error(
    found: Deviations,
    signal: int,
    number: Callable[[Vector], float],
    bins: NDArray[np.int64],
) -> float:
    """Return the error of a number by the noise of some bins alone, to first order."""
    average, usual = found.average, number(found.average)
    square = 0.0
    for k in bins[np.isfinite(average[bins, signal])]:
        moved = average.copy()
        moved[k, signal] += found.noises[k, signal]
        square += (number(moved) - usual) ** 2
    return math.sqrt(square)


def _middle(own: Vector, noise: float) -> int:
    """Return the middle of the bins around the highest one that are as high as it."""
    top = int(np.argmax(own))
    alike = np.roll(own > own[top] - max(1e-9 * float(np.ptp(own)), 0.1 * noise), -top)
    if alike.all():
        return top
    after, before = int(np.argmin(alike)) - 1, int(np.argmin(alike[::-1]))
    return (top + (after - before) // 2) % N_BINS


def _around(found: Deviations, signal: int, centre: int, fine: Vector) -> NDArray[np.int64]:
    """Return the bins around an extreme up to the next jumps. Indices continue beyond the cycle.

    If the extreme is at a jump, its own bin contains both sides of the jump and does not count.
    """
    stops = jump_bins(found.table, N_BINS)[:, signal]
    sides = [-1, 1]
    chosen = [centre]
    if stops[centre]:
        chosen, sides = [], [-1 if fine[centre, 0] > fine[centre, -1] else 1]
    own = fine.max(axis=1)
    high = own > own[centre] - float(found.noise[signal])
    for step in sides:
        for k in range(1, N_BINS // 2):
            at = centre + step * k
            if stops[at % N_BINS] or not (k <= _ASIDE or high[at % N_BINS]):
                break
            chosen.append(at)
    return np.array(sorted(chosen), dtype=np.int64)


def _of_many(noises: Vector) -> float:
    """Return half of the 95 % bound for the largest of many values that contain only noise.

    Args:
        noises: Standard error of each value.
    """
    errors = noises[noises > 0.0]
    if not len(errors):
        return 0.0
    # Between the limits of the least sure number alone and of as many alike.
    low = float(np.max(errors)) * float(ndtri(1.0 - _RARE / 2.0))
    high = float(np.max(errors)) * float(ndtri(1.0 - _RARE / 2.0 / len(errors)))

    def excess(limit: float) -> float:
        return float(np.sum(np.log1p(-2.0 * ndtr(-limit / errors)))) - math.log1p(-_RARE)

    from scipy.optimize import brentq

    # Bonferroni's limit is above the true one, unless there is one number.
    found: Any = brentq(excess, low, 1.01 * high)
    return float(found) / 2.0


def delays(found: Deviations) -> tuple[Estimate, ...]:
    r"""Return the delay of each signal relative to all signals together [s].

    All signals together are the alignment, at which the weighted mean of the delays is zero. So the
    delay of a signal also has the noise of the others: with the delays :math:`d_j` of the signals
    alone and the weights :math:`w_j` of the alignment, it is :math:`d_k - \sum_j w_j d_j`, with the
    variance :math:`u_k^2 + \sum_{j \ne k} w_j^2 u_j^2` at most. Samples and bins weigh a signal
    differently, so its own share is not subtracted.

    Args:
        found: The deviations.
    """
    n_s = found.average.shape[1]
    alone = [_delay_alone(found, k) for k in range(n_s)]
    slopes = np.ptp(found.fine[:, :, :n_s], axis=1)
    smooth = ~jump_bins(found.table, N_BINS)[:, :n_s]
    size = np.std(found.orbit[:, :n_s], axis=0)
    told = np.sum(np.where(smooth, slopes, 0.0) ** 2, axis=0)
    told /= np.where(size > 0.0, size, math.inf) ** 2
    weights = told / (float(told.sum()) or 1.0)
    errors = np.array([one.error for one in alone])
    shares = np.where(weights > 0.0, weights * errors, 0.0) ** 2
    return tuple(
        Estimate(
            value=one.value,
            error=math.sqrt(errors[k] ** 2 + float(shares.sum() - shares[k])),
        )
        for k, one in enumerate(alone)
    )


def _delay_alone(found: Deviations, signal: int) -> Estimate:
    """Return the delay of a signal, with the error of that signal alone [s]."""
    table = found.table
    stretch = found.period / table.period
    # At a jump of the signal a small delay causes a large deviation or no deviation.
    smooth = ~jump_bins(table, N_BINS)[:, signal]

    def sloped(times: Vector) -> tuple[Vector, Vector]:
        model, slope = table.nodes.with_slopes(np.mod(times, table.period))
        return model[:, signal], slope[:, signal] - slope[:, signal].mean()

    def shift(average: Vector) -> float:
        seen = np.isfinite(average[:, signal]) & smooth
        data = (found.orbit[:, signal] + average[:, signal])[seen]
        times = found.phases[seen] * table.period
        late = 0.0
        # A signal that jumps allows no shift beyond the bins of its jumps.
        for _ in range(8 if smooth.all() else 1):
            y, f = sloped(times - late)
            rest = data - y
            below = float(f @ f)
            if below == 0.0:
                return math.nan
            late -= float(f @ (rest - rest.mean())) / below
        return late * stretch

    one = found.estimate(shift)
    seen = np.isfinite(found.average[:, signal]) & smooth
    _, f = sloped(found.phases[seen] * table.period)
    below = float(f @ f)
    # Few cycles may scatter little by chance. White noise gives a lower bound.
    white = math.sqrt(float(f**2 @ found.noises[seen, signal] ** 2)) / below if below else 0.0
    half = float(found.rounding[signal])
    if not (below and half):
        return _at_least(one, white * stretch)
    # Rounding is alike in all cycles at equal phases, and between two steps of the signal.
    n = float(np.count_nonzero(seen))
    parts = min(float(np.ptp(found.fine[:, :, signal])) / half + 1.0, n)
    rounding = half / math.sqrt(3.0 * parts * below / n)
    return _at_least(one, white * stretch).unsure(rounding * stretch)


def portrait_distance(found: Deviations, portrait: Portrait) -> tuple[Estimate, Estimate]:
    """Return mean and greatest distance of the recorded closed curve from the orbit's.

    The mean is without the noise: the square of the mean distance that noise alone causes is
    subtracted. Each axis counts in parts of the orbit's range on it. Time does not matter.

    Args:
        found: The deviations.
        portrait: The plane of the curves.
    """
    axes, rate_of = found.columns(portrait)
    used = axes if rate_of is None else [axes[0], rate_of]
    own = found.fine[:, :, axes].reshape(-1, 2)
    size = np.ptp(own, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    line = np.concatenate([own, own[:1]]) / size

    def apart(average: Vector) -> Vector:
        points = found.curve(portrait, average)
        points = points[np.all(np.isfinite(points), axis=1)] / size
        return line_distances(line, points) if len(points) else np.full(1, np.nan)

    # A distance is never negative: noise alone gives some, which depends on the curve.
    random = np.random.default_rng(0)
    drawn = random.normal(size=(_DRAWS, *found.average.shape)) * found.noises
    known = np.where(np.isfinite(found.average), 0.0, np.nan)
    curves = np.array([found.curve(portrait, known + noise) for noise in drawn]) / size
    seen = np.all(np.isfinite(curves), axis=2)[0]
    alone, limit = 0.0, 0.0
    if seen.any():
        distances = line_distances(line, curves[:, seen].reshape(-1, 2))
        means = distances.reshape(_DRAWS, -1).mean(axis=1)
        alone = float(means.mean())
        # Draws are few, and the size of the noise is known from so many samples only.
        freedom = np.maximum(found.counts.sum(axis=0) - 1.0, 0.0).sum(axis=0)[used]
        scatter = float(np.std(means, ddof=1)) * math.sqrt(1.0 + 1.0 / _DRAWS)
        scatter = math.hypot(scatter, alone / math.sqrt(2.0 * max(float(freedom.min()), 1.0)))
        # Noise alone leaves less than this limit in 95 % of the recordings.
        most = alone + float(stdtrit(_DRAWS - 1, 1.0 - _RARE)) * scatter
        limit = math.sqrt(max(most**2 - alone**2, 0.0))

    def both(average: Vector) -> tuple[float, float]:
        distances = apart(average)
        square = float(np.mean(distances)) ** 2 - alone**2
        return math.sqrt(max(square, 0.0)), float(np.max(distances))

    mean, largest = found.estimates(both)
    if mean.value < 2.0 * limit:
        mean = _at_least(mean, limit / 2.0)
    across: Vector = found.noises[:, axes[0]] / size[0]
    coarse = found.rounding[used] / size
    if rate_of is None:
        upwards: Vector = found.noises[:, axes[1]] / size[1]
    else:
        upwards = slope_noises(found.noises[:, rate_of], found.period / N_BINS) / size[1]
        coarse[1] *= N_BINS / found.period
    rounding = float(np.hypot(*coarse))
    largest = _at_least(largest, _of_many(np.maximum(across, upwards)))
    return mean.rounded(rounding), largest.rounded(rounding)
