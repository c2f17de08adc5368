r"""Fits of one touch, one rebound and one opening of a recorded gap, against the orbit's own.

What is fitted is what the samples have beyond the orbit's own flight: in a copy of the orbit that
is noise, in another motion it is smooth, and a polynomial of low degree takes it up (theory (56)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.estimate import UNKNOWN, Estimate
from zeno_orbits.experiment.comparison.gap_model import GapModel

LEAST = 6
"""Samples that a fit needs."""
_RESOLVED = 10
"""Samples of a rebound from which on its length is known."""
_LAST = 3
"""Last samples of a flight that may belong to the next one."""
_SURE = 4.0
"""Standard errors by which such a sample is too high."""
_WINDOW = 0.08
"""Part of a period before an impact whose samples tell of it."""
_OPENED = 0.08
"""An opening is seen up to this part of the greatest gap."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GapSamples:
    """A recorded gap over one cycle.

    Attributes:
        t: Times since its release, ``(n,)`` [s].
        h: Gaps above the stop, ``(n,)``.
        noise: Standard deviation of the gap.
        model: The orbit's gap.
    """

    t: Vector
    h: Vector
    noise: float
    model: GapModel


@dataclass(frozen=True, slots=True, kw_only=True)
class ImpactFit:
    """A gap that closes.

    Attributes:
        time: When [s].
        rate: Gap rate just before, negative.
    """

    time: Estimate
    rate: Estimate


@dataclass(frozen=True, slots=True, kw_only=True)
class Rebound:
    """A flight between two impacts that rises above the noise.

    Attributes:
        length: [s].
        up: Gap rate at its start.
        down: Gap rate at its end, negative.
    """

    length: Estimate
    up: Estimate
    down: float


def fit_impact(seen: GapSamples, apex: int, at: int) -> ImpactFit | None:
    """Return the touch that ends the orbit's first flight, or nothing if the samples do not tell.

    Args:
        seen: The samples.
        apex: Number of the highest one before.
        at: Number of the first one that may lie behind the touch.
    """
    t, h, model = seen.t, seen.h, seen.model
    crossing, unit = float(t[at]), _WINDOW * model.period
    near = slice(int(np.searchsorted(t, max(crossing - unit, t[apex]))), at)
    t, h = t[near], h[near]
    if len(t) < LEAST or crossing - t[-1] > 0.25 * unit or t[0] > crossing - 0.7 * unit:
        return None
    columns, rest = _square(t, crossing, unit), h - model.flight(0, t)[0]
    own = _samples_of_flight(columns, rest, seen.noise)
    if own < LEAST or crossing - t[own - 1] > 0.25 * unit:
        return None
    fit, covariance = _fitted(columns[:own], rest[:own], seen.noise)
    impact, speed = crossing, math.nan
    for _ in range(8):
        gap, rate = model.flight(0, np.array([impact]))
        value = float(gap[0]) + float(_square(impact, crossing, unit) @ fit)
        speed = float(rate[0]) + float(_square_slope(impact, crossing, unit) @ fit)
        if not speed < 0.0:
            return None
        impact -= float(np.clip(value / speed, -0.2 * unit, 0.2 * unit))
    row, slope = _square(impact, crossing, unit), _square_slope(impact, crossing, unit)
    return ImpactFit(
        time=Estimate(value=impact, error=math.sqrt(float(row @ covariance @ row)) / -speed),
        rate=Estimate(value=speed, error=math.sqrt(float(slope @ covariance @ slope))),
    )


def fit_rebound(seen: GapSamples, number: int, length: float) -> Rebound | None:
    """Return a rebound, the orbit's own and a cubic that is zero at its start.

    Args:
        seen: Its samples, the times since its start.
        number: Its number, from 1.
        length: A first value [s].

    Returns:
        Nothing if the samples are too few.
    """
    s, h, model = seen.t, seen.h, seen.model
    if len(s) < _RESOLVED or max(float(s[0]), float(np.max(np.diff(s)))) > 0.3 * length:
        return None
    x = s / length
    columns, rest = np.stack([x, x**2, x**3], axis=1), h - model.flight(number, s)[0]
    own = _samples_of_flight(columns, rest, seen.noise)
    fit, covariance = _fitted(columns[:own], rest[:own], seen.noise)
    end, down = 1.0, math.nan
    for _ in range(12):
        gap, rate = model.flight(number, np.array([end * length]))
        value = float(gap[0] + fit @ [end, end**2, end**3])
        down = float(rate[0] * length + fit @ [1.0, 2 * end, 3 * end**2])
        if not down < 0.0:
            return None
        end -= float(np.clip(value / down, -0.2, 0.2))
    up = float(model.flight(number, np.zeros(1))[1][0]) + float(fit[0]) / length
    if not (0.5 < end < 1.5 and up > 0.0):
        return None
    row = np.array([end, end**2, end**3])
    unsure = math.sqrt(float(row @ covariance @ row)) / -down * length
    return Rebound(
        length=Estimate(value=end * length, error=unsure),
        up=Estimate(value=up, error=math.sqrt(float(covariance[0, 0])) / length),
        down=down / length,
    )


def fit_release(seen: GapSamples, after: int) -> Estimate:
    """Return when a gap begins to open.

    Args:
        seen: The samples since the release before it.
        after: Number of the last one at rest.
    """
    t, h, model = seen.t, seen.h, seen.model
    period = model.period
    begin = int(np.searchsorted(t, float(t[after]) - 0.05 * period))
    opened = np.flatnonzero(h[after:] > _OPENED * float(np.max(h)))
    if not len(opened) or opened[0] < 3 or after + opened[0] - begin < 2 * LEAST:
        return UNKNOWN
    stop = after + int(opened[0])
    t, h, rising = t[begin:stop] - period, h[begin:stop], stop - after
    if float(np.max(np.diff(t[-rising:]))) > 0.02 * period:
        return UNKNOWN
    shift, size = 0.0, 1.0
    columns = np.zeros((len(t), 2))
    for _ in range(20):
        gap, rate = model.opening(t - shift)
        columns = np.stack([gap, -size * rate], axis=1)
        step = np.linalg.lstsq(columns, h - size * gap, rcond=1e-12)[0]
        size += float(np.clip(step[0], -0.5 * size, size))
        shift += float(np.clip(step[1], -0.03 * period, 0.03 * period))
        if not (0.05 < size < 20.0 and abs(shift) < 0.25 * period):
            return UNKNOWN
    _, covariance = _fitted(columns, h - size * model.opening(t - shift)[0], seen.noise)
    return Estimate(value=period + shift, error=math.sqrt(max(float(covariance[1, 1]), 0.0)))


def _samples_of_flight(columns: Vector, values: Vector, noise: float) -> int:
    """Return how many samples belong to a flight.

    A rebound of a few samples may hide between the flight and the first sample at the stop. Its
    samples are higher than the flight predicts.

    Args:
        columns: Of the fit of the flight, ``(n, m)``.
        values: What is fitted, ``(n,)``.
        noise: Standard deviation of the gap.
    """
    n = len(values) - _LAST
    if n <= columns.shape[1]:
        return len(values)
    fit, covariance = _fitted(columns[:n], values[:n], noise)
    variance = noise**2 + np.einsum("ni,ij,nj->n", columns[n:], covariance, columns[n:])
    high = np.flatnonzero(values[n:] - columns[n:] @ fit > _SURE * np.sqrt(variance))
    return n + int(high[0]) if len(high) else len(values)


def _square(t: Vector | float, origin: float, unit: float) -> Vector:
    s = (np.asarray(t) - origin) / unit
    return np.stack([np.ones_like(s), s, s**2], axis=-1)


def _square_slope(t: float, origin: float, unit: float) -> Vector:
    return np.array([0.0, 1.0, 2 * (t - origin) / unit]) / unit


def _fitted(columns: Vector, values: Vector, noise: float) -> tuple[Vector, Vector]:
    """Return the least-squares fit and its covariance, with the scatter that is seen."""
    fit: Vector = np.asarray(np.linalg.lstsq(columns, values, rcond=1e-12)[0], dtype=np.float64)
    rest = values - columns @ fit
    spare = max(len(values) - columns.shape[1], 1)
    variance = max(float(rest @ rest) / spare, noise**2)
    normal = np.asarray(np.linalg.pinv(columns.T @ columns), dtype=np.float64)
    return fit, variance * normal
