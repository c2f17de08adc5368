r"""Period and repeatability of recorded signals, from the signals alone.

The first estimate of the period is the first large peak of the joint autocorrelation of all
signals. Then harmonics :math:`y(t) \approx \sum_{k \le K} a_k \cos k\omega t + b_k \sin k\omega t`
are fitted by least squares, with the period as an unknown. The fit is repeated over longer and
longer stretches, so that no cycle is miscounted. A period of few samples may be a multiple of the
true one, so its parts are fitted too. The delay of each cycle against the average gives the
standard error of the period (theory (6.7)).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.recordings.delays import delays_of, period_error

_MOST_BINS, _FINEST = 1 << 15, 1 << 19
"""Bins of a record, and of one with thousands of cycles: 16 harmonics over the latter take 300 MB.
"""
_PER_CYCLE = 16
"""Bins of a cycle, at least."""
_PEAK = 0.9
"""A peak of the autocorrelation counts from this part of the greatest on."""
_OVERLAP = 0.15
"""Part of a record that must overlap with itself, shifted, for the autocorrelation to count."""
_HARMONICS = 16
_GROWTH = 2.5
"""Each stretch that a period is fitted over is longer by this factor."""
_STEPS = 3
_LEAST, _FEW = 4, 4 * _HARMONICS
"""Samples in a period below which no period is seen, or its multiples may correlate better."""
_EACH = 8
"""Samples for each harmonic, at least."""
_MOST_PARTS = 10
"""Largest multiple of the true period that may be found first."""
_COMPARED, _SLOWER = 4, 0.45
"""Harmonics with which periods are compared, and their largest number per bin."""
_AS_WELL = 1.02
"""Ratio of what two periods leave of a record, below which the smaller period fits it as well."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Periodicity:
    """Period of recorded signals and their average over a period.

    Attributes:
        period: [s].
        error: Standard error of the period [s]. It is infinite for a record shorter than two
            periods.
        n_cycles: Length of the record in periods.
        repeats: Part of the variance of the signals that repeats, at most 1.
        alternation: Size of the component with twice the period, in standard deviations of the
            signals.
        alternation_noise: The size of this component from noise alone.
        paired: True if the samples of every other period resolve all harmonics. Otherwise unlike
            phases of the samples may look like this component.
        template: Complex amplitudes of the harmonics of each signal, ``(n_s, K + 1)``, in phases
            that count from the first time of the record.
    """

    period: float
    error: float
    n_cycles: float
    repeats: float
    alternation: float
    alternation_noise: float
    paired: bool
    template: NDArray[np.complex128]
    noise: Vector

    @property
    def n_harmonics(self) -> int:
        """Number of harmonics in the template."""
        return self.template.shape[1] - 1

    def average(self, phases: Vector) -> Vector:
        """Return the periodic part of the signals, ``(n, n_s)``.

        Args:
            phases: Phases in periods since the first time of the record, ``(n,)``.
        """
        order = np.arange(self.template.shape[1], dtype=np.float64)
        waves = np.exp(2j * np.pi * np.outer(phases, order))
        return np.real(waves @ self.template.T)


def periodicity(time: Vector, values: Vector, *, near: float | None = None) -> Periodicity | None:
    """Return the period of signals, or ``None`` if the record is too short or not periodic.

    Args:
        time: Increasing times, ``(n_t,)`` [s].
        values: One row per signal, ``(n_s, n_t)``. A missing sample is NaN.
        near: Value that the period is near, by default the first large peak of the
            autocorrelation or a part of it [s].
    """
    grid = _gathered(time, values, _bins(time, values))
    period = _first_period(grid) if near is None else near
    if period is None:
        return None
    longest = grid.times[-1]
    stretch = 2.5 * period
    while True:
        period = _refined(grid, min(stretch, longest), period)
        if period is None:
            return None
        if stretch >= longest:
            break
        stretch *= _GROWTH
    return _described(grid, period if near is not None else _undivided(grid, period))


def _bins(time: Vector, values: Vector) -> int:
    """Return the number of bins of a record: more than usual if it has thousands of cycles.

    Bins longer than a cycle average it away, and the rest seems to repeat at another period. The
    beginning of the record shows the cycles sample by sample.
    """
    if len(time) <= _MOST_BINS:
        return _MOST_BINS
    begin = _gathered(time[:_MOST_BINS], values[:, :_MOST_BINS], _MOST_BINS)
    period = _first_period(begin)
    if period is None:
        return _MOST_BINS
    return int(np.clip(_PER_CYCLE * (time[-1] - time[0]) / period, _MOST_BINS, _FINEST))


def _undivided(grid: _Grid, period: float) -> float:
    """Return the whole part of a period whose harmonics fit the record best.

    The autocorrelation is known at shifts by whole bins. If a period is not a whole number of few
    bins, a multiple that nearly is correlates better. Its first harmonics leave more of the record.
    Harmonics faster than the bins are not fitted: they would be taken for slower ones.
    """
    found = [(period, _left(grid, period))]
    for divisor in range(2, _MOST_PARTS + 1):
        if _LEAST * divisor <= period / grid.step < _FEW * divisor:
            part = _refined(grid, grid.times[-1], period / divisor)
            if part is not None:
                found.append((part, _left(grid, part)))
    least = min(left for _, left in found)
    return min(part for part, left in found if left <= _AS_WELL * least)


def _left(grid: _Grid, period: float) -> float:
    """Return the sum of squares that the first harmonics of a period leave of a record."""
    n_harmonics = int(np.clip(_SLOWER * period / grid.step, 1, _COMPARED))
    return sum(float(one.rest @ one.rest) for one in _fits(grid, period, n_harmonics, math.inf))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Grid:
    """A record gathered in bins of one length.

    Attributes:
        step: Length of a bin [s].
        times: Mean time of the samples in each bin, from the first time of the record [s].
        values: Mean of each signal per bin minus the overall mean, in standard deviations, ``(n_s,
            n)``. It is 0 in empty bins.
        mask: Mask of the bins with samples.
        centre: Mean of each signal.
        scale: Standard deviation of each signal.
    """

    step: float
    times: Vector
    values: Vector
    mask: NDArray[np.bool_]
    centre: Vector
    scale: Vector


def _gathered(time: Vector, values: Vector, n_bins: int) -> _Grid:
    # One sample a bin, if they are even: empty bins would hide a period of few samples.
    n = int(np.clip(len(time), 2, n_bins))
    since = time - time[0]
    step = since[-1] / (n - 1) if since[-1] > 0.0 else 1.0
    places = np.minimum(np.rint(since / step).astype(np.int64), n - 1)
    counts = np.bincount(places, minlength=n)
    times = np.where(
        counts > 0,
        np.bincount(places, weights=since, minlength=n) / np.maximum(counts, 1),
        step * np.arange(n),
    )
    mask = np.zeros((len(values), n), dtype=np.bool_)
    means, (centre, scale) = np.zeros(mask.shape), np.zeros((2, len(values)))
    for k, row in enumerate(values):
        seen = np.isfinite(row)
        if not seen.any():
            continue
        here = places[seen]
        count = np.bincount(here, minlength=n)
        mask[k] = count > 0
        # One far value must not drown all others in the sums.
        middle = float(np.median(row[seen]))
        mean = np.bincount(here, weights=row[seen] - middle, minlength=n) / np.maximum(count, 1)
        shift = float(np.mean(mean[mask[k]]))
        centre[k], scale[k] = middle + shift, float(np.std(mean[mask[k]]))
        means[k] = np.where(mask[k], mean - shift, 0.0)
    scale[scale == 0.0] = 1.0
    return _Grid(
        step=step,
        times=times,
        values=means / scale[:, None],
        mask=mask,
        centre=centre,
        scale=scale,
    )


def _autocorrelation(grid: _Grid) -> tuple[Vector, NDArray[np.bool_]]:
    """Return the autocorrelation of a record at shifts by whole bins, and the mask of known shifts.

    The sum over the overlap is divided by the geometric mean of the two energies there. The result
    is at most one, and one for a whole number of periods, even if the overlap is small.
    """
    n = grid.values.shape[1]
    size = 2 * n
    products, before, after, seen = (np.zeros(n + 1, dtype=np.complex128) for _ in range(4))
    for row, mask in zip(grid.values, grid.mask, strict=True):
        wave, there = np.fft.rfft(row, size), np.fft.rfft(mask.astype(np.float64), size)
        energy = np.fft.rfft(row**2, size)
        products += np.abs(wave) ** 2
        seen += np.abs(there) ** 2
        before += np.conj(energy) * there
        after += np.conj(there) * energy
    overlap, energies = np.fft.irfft(seen, size)[:n], np.ones(n)
    for one in (before, after):
        energies *= np.maximum(np.fft.irfft(one, size)[:n], 0.0)
    known = (overlap > _OVERLAP * overlap[0]) & (energies > 1e-18 * energies[0])
    size_of = np.sqrt(np.where(known, energies, 1.0))
    return np.where(known, np.fft.irfft(products, size)[:n] / size_of, -1.0), known


def _first_period(grid: _Grid) -> float | None:
    """Return the first large peak of the autocorrelation, or ``None`` if every peak is small."""
    correlation, known = _autocorrelation(grid)
    below = np.flatnonzero(known & (correlation < 0.0))
    if not len(below) or not known[below[0] + 1 :].any():
        return None
    inside = correlation[below[0] :].copy()
    greatest = float(np.max(inside))
    if greatest <= 0.0:
        return None
    peaks = np.flatnonzero(
        (inside[1:-1] >= _PEAK * greatest)
        & (inside[1:-1] >= inside[:-2])
        & (inside[1:-1] >= inside[2:])
    )
    if not len(peaks):
        return None
    # A maximum at the edge of the known range is a truncated slope and not a peak.
    first = int(peaks[0]) + 1
    crest = first + int(np.argmax(inside[first : first + max(first // 20, 1)]))
    return float(crest + below[0]) * grid.step


def _waves(phases: Vector, n_harmonics: int) -> Vector:
    """Return a constant, cosines and sines of phases, ``(n, 2 n_harmonics + 1)``."""
    first = np.exp(2j * np.pi * phases)
    powers = [np.ones(len(phases), dtype=np.complex128)]
    for _ in range(n_harmonics):
        powers.append(powers[-1] * first)
    return np.stack([*(p.real for p in powers), *(p.imag for p in powers[1:])], axis=1)


def _projected(waves: Vector, row: Vector) -> Vector:
    """Return the least-squares amplitudes of waves. The normal equations are well conditioned."""
    found = np.linalg.lstsq(waves.T @ waves, waves.T @ row, rcond=1e-9)[0]
    return np.asarray(found, dtype=np.float64)


class _Wave(NamedTuple):
    """Harmonics fitted to the bins of one signal, their derivative by phase, and the residual."""

    mask: NDArray[np.bool_]
    phases: Vector
    waves: Vector
    amplitudes: Vector
    slope: Vector
    rest: Vector


def _fits(grid: _Grid, period: float, n_harmonics: int, until: float) -> Iterator[_Wave]:
    """Yield the fit of each signal over the beginning of a record."""
    order = 2 * np.pi * np.arange(1, n_harmonics + 1, dtype=np.float64)
    for row, seen in zip(grid.values, grid.mask, strict=True):
        mask = seen & (grid.times <= until)
        phases = grid.times[mask] / period
        waves = _waves(phases, n_harmonics)
        found = _projected(waves, row[mask])
        cosines, sines = found[1 : n_harmonics + 1], found[n_harmonics + 1 :]
        slope = waves[:, 1:] @ np.concatenate([order * sines, -order * cosines])
        yield _Wave(mask, phases, waves, found, slope, row[mask] - waves @ found)


def _harmonics(grid: _Grid, period: float) -> int:
    """Return the number of harmonics that the bins resolve."""
    return int(np.clip(0.25 * period / grid.step, 1, _HARMONICS))


def _resolved(grid: _Grid, period: float) -> int:
    """Return the number of harmonics that all samples resolve, by their phases.

    Samples of many periods resolve more harmonics than samples of one period.
    """
    most = min(_HARMONICS, int(np.count_nonzero(np.any(grid.mask, axis=0))) // _EACH)
    return max(int(min(0.25 / _widest(grid, period), most)), _harmonics(grid, period))


def _widest(grid: _Grid, period: float) -> float:
    """Return the largest distance of neighbouring phases of the samples, in periods."""
    phases = np.sort(grid.times[np.any(grid.mask, axis=0)] / period % 1.0)
    return float(np.max(np.diff(phases, append=phases[0] + 1.0)))


def _refined(grid: _Grid, length: float, period: float) -> float | None:
    """Return the period that fits the beginning of a record best, near a first value."""
    n_harmonics = _harmonics(grid, period)
    for _ in range(_STEPS):
        above, below = 0.0, 0.0
        for wave in _fits(grid, period, n_harmonics, length):
            if len(wave.rest) < 4 * n_harmonics + 4:
                continue
            # A longer period moves later samples by more: d(phase)/dT = -phase / T.
            moved = -wave.slope * wave.phases / period
            moved = moved - wave.waves @ _projected(wave.waves, moved)
            above += float(moved @ wave.rest)
            below += float(moved @ moved)
        if not (below > 0.0 and abs(above / below) < 0.2 * period):
            return None
        period += above / below
    return period


def _described(grid: _Grid, period: float) -> Periodicity:
    """Return the periodicity of a record with a given period."""
    n_s, length = len(grid.values), float(grid.times[-1])
    n_harmonics = _resolved(grid, period)
    fits = list(_fits(grid, period, n_harmonics, math.inf))
    amplitudes = np.array([one.amplitudes for one in fits])
    waves = amplitudes[:, 1 : n_harmonics + 1] - 1j * amplitudes[:, n_harmonics + 1 :]
    constant = grid.centre + grid.scale * amplitudes[:, 0]
    rest = np.concatenate([one.rest for one in fits])
    total, left = float(np.sum(grid.values**2)), float(rest @ rest)
    times = np.concatenate([grid.times[one.mask] for one in fits])
    late = np.concatenate([-one.slope / period for one in fits])
    delays = delays_of(np.floor(times / period).astype(np.int64), late, rest)
    n_slow = _harmonics(grid, period)
    odd, noise = np.sum([_alternation(one, n_slow) for one in fits], axis=0) / n_s
    return Periodicity(
        period=period,
        error=period_error(delays, left / max(len(rest), 1)),
        n_cycles=length / period,
        repeats=1.0 - left / total if total > 0.0 else 0.0,
        alternation=math.sqrt(max(odd, 0.0)),
        alternation_noise=math.sqrt(max(noise, 0.0)),
        paired=_widest(grid, 2.0 * period) <= 0.25 / (2 * _HARMONICS),
        template=np.column_stack([constant, grid.scale[:, None] * waves]).astype(np.complex128),
        noise=grid.scale * [_noise_of(one) for one in fits],
    )


def _noise_of(wave: _Wave) -> float:
    """Return the root mean square of the fitted harmonics of white noise like the residual."""
    n, n_waves = len(wave.rest), len(wave.amplitudes)
    return math.sqrt(float(wave.rest @ wave.rest) / max(n - n_waves, 1) * n_waves / max(n, 1))


def _alternation(wave: _Wave, n_harmonics: int) -> tuple[float, float]:
    """Return the mean square of half-integer harmonics in a residual, and that for noise."""
    if wave.phases[-1] - wave.phases[0] < 3.0:
        return 0.0, math.inf
    doubled = _waves(wave.phases / 2, 2 * n_harmonics)[:, 1 : 4 * n_harmonics + 1 : 2]
    found = _projected(doubled, wave.rest)
    unexplained = wave.rest - doubled @ found
    white = float(np.mean(unexplained**2)) * 2 * n_harmonics / len(wave.rest)
    return float(np.sum(found**2)) / 2, white
