"""The numbers of recorded signals and portraits beside an orbit's (theory (57))."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.deviations import (
    LEVER,
    N_BINS,
    Deviations,
    Portrait,
    between,
)
from zeno_orbits.experiment.comparison.estimate import UNKNOWN, Estimate
from zeno_orbits.experiment.comparison.metrics import Metric, metric
from zeno_orbits.experiment.orbit_table import measurable
from zeno_orbits.experiment.polyline import Polyline, telling_corners
from zeno_orbits.model import Problem


def signal_metrics(problem: Problem, found: Deviations, names: Sequence[str]) -> Iterator[Metric]:
    """Yield extremes, sizes of the deviation and the delay of every signal.

    Args:
        problem: The problem.
        found: The deviations.
        names: Of the signals, in order.
    """
    units, table = measurable(problem), found.table
    share = found.phases * table.period
    parts = {
        "in flight": share < table.first_impact,
        "in chatter": (share >= table.first_impact) & (share < table.zeno_time),
        "locked": share >= table.zeno_time,
    }
    for k, name in enumerate(names):
        own, unit = found.fine[:, :, k], units[name]
        yield metric(f"highest of {name}", unit, float(own.max()), apex(found, k, 1.0))
        yield metric(f"lowest of {name}", unit, float(own.min()), apex(found, k, -1.0))
        for part, chosen in parts.items():
            if chosen.any() and np.isfinite(found.average[chosen, k]).any():
                size = root_mean_square(found, k, chosen)
                yield metric(f"rms deviation {part} of {name}", unit, 0.0, size)
        yield metric(f"greatest deviation of {name}", unit, 0.0, greatest(found, k))
        yield metric(f"delay of {name}", "s", 0.0, delay(found, k))


def recorded_portraits_of(problem: Problem, names: Sequence[str]) -> tuple[Portrait, ...]:
    """Return the portraits of a problem that recorded signals can be drawn in.

    Args:
        problem: The problem.
        names: Of the recorded signals.
    """
    n_q = problem.compiled().n_q
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
    """Return the size of a signal's deviation over chosen bins, that of the noise taken away.

    Args:
        found: The deviations.
        signal: Its number.
        chosen: Which bins count, ``(N_BINS,)``.
    """
    counts: Vector = found.counts.sum(axis=0)[chosen, signal]
    white = 0.0
    if float(np.max(counts)) > 1.0:
        noise = found.spread[chosen, signal] ** 2 / np.maximum(counts - 1.0, 1.0)
        white = float(np.nanmean(noise))

    def size(average: Vector) -> float:
        square = float(np.nanmean(average[chosen, signal] ** 2))
        return math.sqrt(max(square - white, 0.0))

    one = found.estimate(size)
    # Near zero the root hides what the square does: noise of this size is not told from nothing.
    floor = math.sqrt(white) * (2.0 / max(len(counts), 1)) ** 0.25
    return _at_least(one, floor) if one.value < 2 * floor else one


def greatest(found: Deviations, signal: int) -> Estimate:
    """Return the greatest mean deviation of a signal, with its sign.

    A bin that one group alone has seen tells no error and does not count.
    """
    seen = np.sum(found.counts[:, :, signal] > 0.0, axis=0) > 1
    if not seen.any():
        return UNKNOWN
    at = int(np.argmax(np.where(seen, np.abs(found.average[:, signal]), -1.0)))
    one = found.estimate(lambda average: float(average[at, signal]))
    return _at_least(one, _of_many(found.noise[signal], N_BINS))


def _at_least(one: Estimate, error: float) -> Estimate:
    return Estimate(value=one.value, error=max(one.error, error))


def apex(found: Deviations, signal: int, sign: float) -> Estimate:
    """Return the highest or lowest value of a signal over the cycle.

    Args:
        found: The deviations.
        signal: Its number.
        sign: 1 for the highest, -1 for the lowest.
    """
    values: Vector = sign * found.fine[:, :, signal]
    mean: Vector = values.mean(axis=1)
    own: Vector = values.max(axis=1)

    def rows(average: Vector) -> Vector:
        row = sign * between(average[:, signal])[0]
        # How the orbit rises within a bin tells of the recording only while both are alike there.
        return np.where(own - mean > np.abs(row), own, mean) + row

    one = found.estimate(lambda average: float(sign * np.max(rows(average))))
    noise = float(found.noise[signal])
    # Of many bins that are as high as each other, noise lifts the highest.
    rivals = int(np.sum(own > np.max(own) - 3 * noise))
    # Where no sample falls, the deviation is anything from that before to that after.
    unseen = float(between(found.average[:, signal])[1][np.argmax(rows(found.average))])
    return _at_least(one, math.hypot(_of_many(noise, rivals), unseen))


def _of_many(noise: float, n: int) -> float:
    """Return how far the greatest of many numbers is from zero by noise alone."""
    return float(noise) * math.sqrt(2.0 * math.log(max(n, 2)))


def delay(found: Deviations, signal: int) -> Estimate:
    """Return by how much later than all signals together one of them comes [s]."""
    table = found.table
    stretch = found.period / table.period

    def shift(average: Vector) -> float:
        seen = np.isfinite(average[:, signal])
        data = (found.orbit[:, signal] + average[:, signal])[seen]
        times = found.phases[seen] * table.period
        late = 0.0
        for _ in range(8):
            model, slope = table.nodes.with_slopes(np.mod(times - late, table.period))
            y, f = model[:, signal], slope[:, signal]
            f = f - f.mean()
            rest = data - y
            below = float(f @ f)
            if below == 0.0:
                return math.nan
            late -= float(f @ (rest - rest.mean())) / below
        return late * stretch

    return found.estimate(shift)


def portrait_distance(found: Deviations, portrait: Portrait) -> tuple[Estimate, Estimate]:
    """Return mean and greatest distance of the recorded closed curve from the orbit's.

    Each axis counts in parts of the orbit's range on it. Time does not matter.

    Args:
        found: The deviations.
        portrait: The plane of the curves.
    """
    axes, rate_of = found.columns(portrait)
    own = found.fine[:, :, axes].reshape(-1, 2)
    size = np.ptp(own, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    closed = np.concatenate([own, own[:1]]) / size
    line = Polyline(corners=closed[telling_corners(closed)])

    def both(average: Vector) -> tuple[float, float]:
        points = found.curve(portrait, average)
        apart = line.distances(points[np.all(np.isfinite(points), axis=1)] / size)
        return float(np.mean(apart)), float(np.max(apart))

    mean, largest = found.estimates(both)
    noises = found.noise[[axes[0], axes[1] if rate_of is None else rate_of]]
    if rate_of is not None:
        noises[1] /= LEVER * found.period / N_BINS
    # A distance is never negative: noise alone gives some.
    floor = float(np.linalg.norm(noises / size)) / math.sqrt(2.0)
    return _at_least(mean, floor), _at_least(largest, _of_many(floor, N_BINS))
