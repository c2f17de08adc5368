r"""Alignment of an orbit with a recording, and a check that both show the same motion.

The first estimate of the shift maximises the correlation of all signals together. Each signal is in
units of its own spread, so that a wrong unit does not hide the maximum. The final value is the
least-squares shift of the record against the orbit (theory (6.8)). Then every signal is compared
with the orbit's signal. A reversed sign or a factor equal to the factor of a unit is a mistake in
the file and not a deviation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.estimate import step_of
from zeno_orbits.experiment.orbit_table import ROUGHLY, PeriodTable, beside_jumps
from zeno_orbits.experiment.recordings.delays import delays_of
from zeno_orbits.experiment.recordings.periodicity import Periodicity

_PHASES = 720
_MOST_ROWS = 60_000
_STEPS = 12
_TELLING = 4
"""Smallest number of cycles from which their scatter gives an error estimate."""
_BINS = 240
"""Bins of the phase at most, over which repeating residuals are averaged."""
_TURNED = 0.95
"""All signs as they are count as best from this part of the best with signs turned on."""
_OPPOSED = -0.4
"""A correlation below this value indicates a signal with its sign reversed."""

_FACTORS: tuple[tuple[float, str], ...] = (
    (180.0 / math.pi, "degrees labelled as radians"),
    (math.pi / 180.0, "radians labelled as degrees"),
    (1.0 / (2.0 * math.pi), "revolutions labelled as radians"),
    (2.0 * math.pi, "radians labelled as revolutions"),
    (30.0 / math.pi, "rpm labelled as rad/s"),
    (math.pi / 30.0, "rad/s labelled as rpm"),
    (1e3, "a thousandth of its unit labelled as the unit"),
    (1e-3, "its unit labelled as a thousandth of it"),
    (1e2, "a hundredth of its unit labelled as the unit"),
    (1e6, "a millionth of its unit labelled as the unit"),
    (1e-6, "its unit labelled as a millionth of it"),
)
_TIME_FACTORS: tuple[tuple[float, str], ...] = (
    (1e3, "milliseconds labelled as seconds"),
    (1e-3, "seconds labelled as milliseconds"),
    (1e6, "microseconds labelled as seconds"),
    (1e-6, "seconds labelled as microseconds"),
    (60.0, "seconds labelled as minutes"),
    (1.0 / 60.0, "minutes labelled as seconds"),
)
_LIKE, _ALIKE = 0.25, 0.05
"""Largest relative distance to a unit's factor at which a large or a smaller factor is suspect."""
_LARGE = 20.0
"""A smaller factor may as well come from another machine."""
_SAME = 0.9
"""A signal in another unit correlates at least so with the orbit's."""
_STRIDE = 1e-3
"""Largest step of the fit that is taken without a look at the samples near jumps, in periods."""
_WORSE = 1.5
"""Ratio of two sums of squares from which the position of the smaller one is kept."""
_NOTICED = 4.0
"""Standard errors of a mean cycle from which its shape is another one."""
_BACKWARD = 1e-3
"""Correlation by which a recording must be more like the orbit reversed in time."""
_EXCHANGED = 0.9
"""Correlation of every signal with the orbit's, at least, after two names are exchanged."""
_DIRECTED = 8
"""Harmonics that a record resolves at least, if its direction in time is judged."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Likeness:
    """Likeness of a recorded signal to the signal of the orbit.

    Attributes:
        name: Name of the signal.
        correlation: Correlation of its average over a cycle with the orbit's signal, 1 for the same
            shape.
        gain: Ratio of the recorded signal to the orbit's signal.
        suspicion: Probable mistake in the file, or an empty string.
        differs: Whether the shapes differ by more than noise and rounding.
    """

    name: str
    correlation: float
    gain: float
    suspicion: str
    differs: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Alignment:
    """Position of the orbit in a recording.

    Attributes:
        release: A time at which the orbit's release falls, near the middle of the record [s].
        error: Standard error of the release time [s].
        period: Period of the record, from a fit of the orbit's shape [s].
        period_error: Standard error of the period [s]. It is infinite for a record shorter than two
            periods.
        phase_error: Standard error of the phases at both ends of the record [periods].
        likeness: Likeness of each signal.
        time_suspicion: Probable mistake in the unit of time, or an empty string.
        backward: Whether the signals correlate better with the orbit reversed in time.
        swapped: The two signals that fit the orbit if their names are exchanged, or nothing.
    """

    release: float
    error: float
    period: float
    period_error: float
    phase_error: float
    likeness: tuple[Likeness, ...]
    time_suspicion: str
    backward: bool
    swapped: tuple[str, ...] = ()

    def phases(self, time: Vector) -> Vector:
        """Return times in periods since the release."""
        return (time - self.release) / self.period


def aligned(
    table: PeriodTable, time: Vector, values: Vector, found: Periodicity, names: Sequence[str]
) -> Alignment:
    """Return the position of the orbit in a recording.

    Args:
        table: The orbit, its first signals in the order of the rows.
        time: Increasing, ``(n_t,)`` [s].
        values: One row a signal, ``(n_s, n_t)``.
        found: How they repeat.
        names: Names of the signals.
    """
    grid = np.arange(_PHASES) / _PHASES
    data = found.average(grid)
    # The orbit's harmonics that the record does not resolve are no difference.
    waves = np.fft.rfft(table.at(grid)[:, : data.shape[1]], axis=0)
    waves[found.n_harmonics + 1 :] = 0.0
    model = np.asarray(np.fft.irfft(waves, _PHASES, axis=0), dtype=np.float64)
    noticed = [_NOTICED * float(found.noise[k]) + step_of(values[k]) / 2 for k in range(len(names))]
    shift, alike, likeness = _compared(names, model, data, noticed)
    ratio = found.period / table.period
    release = time[0] - shift / _PHASES * found.period
    # A false unit or sign must not pull at the shift.
    trusted = np.array([not one.suspicion for one in likeness])
    weight = trusted if trusted.any() else np.ones_like(trusted)
    # In the middle of the record an error of the period moves it least.
    release += found.period * round((0.5 * (time[0] + time[-1]) - release) / found.period)
    scale = np.std(data, axis=0)
    scale = np.where((scale > 0.0) & weight, scale, np.inf)
    fine = _fine(table, time, values, scale, _Place(release, np.inf, found.period, found.error))
    half = max(time[-1] - fine.release, fine.release - time[0]) / fine.period
    return Alignment(
        release=fine.release,
        error=fine.error,
        period=fine.period,
        period_error=fine.period_error,
        phase_error=(fine.error + half * fine.period_error) / fine.period,
        likeness=tuple(likeness),
        time_suspicion=_like_factor(ratio, _TIME_FACTORS),
        backward=found.n_harmonics >= _DIRECTED
        and _is_backward(alike, likeness, _compared(names, model[::-1], data, noticed)),
        swapped=_swapped(names, model, data, noticed, likeness),
    )


def _compared(
    names: Sequence[str], model: Vector, data: Vector, noticed: Sequence[float]
) -> tuple[int, float, list[Likeness]]:
    """Return the best shift of the data, the likeness of all signals and of each.

    Args:
        names: Names of the signals.
        model: Signals of the orbit at even phases, ``(n, n_s)``.
        data: Recorded signals at even phases, ``(n, n_s)``.
        noticed: Least difference of each signal that counts.
    """
    shift, signs, alike = _coarse(model, data)
    likeness = [
        _likeness(name, model[:, k], np.roll(data[:, k], shift), bool(signs[k] < 0), noticed[k])
        for k, name in enumerate(names)
    ]
    return shift, alike, likeness


def _is_backward(
    alike: float, likeness: Sequence[Likeness], back: tuple[int, float, list[Likeness]]
) -> bool:
    """Return whether the orbit reversed in time is more like a recording than the orbit is."""
    only_back = any(one.differs for one in likeness) and not any(one.differs for one in back[2])
    return only_back or back[1] > alike + _BACKWARD


def _swapped(
    names: Sequence[str],
    model: Vector,
    data: Vector,
    noticed: Sequence[float],
    likeness: Sequence[Likeness],
) -> tuple[str, ...]:
    """Return two signals after whose exchange all signals are like the orbit's, or nothing."""
    unlike = [
        k for k, one in enumerate(likeness) if one.suspicion or abs(one.correlation) < _EXCHANGED
    ]
    for pair in combinations(unlike, 2):
        order = list(range(len(names)))
        order[pair[0]], order[pair[1]] = pair[1], pair[0]
        exchanged = _compared(names, model, data[:, order], [noticed[k] for k in order])[2]
        if all(not one.suspicion and one.correlation > _EXCHANGED for one in exchanged):
            return names[pair[0]], names[pair[1]]
    return ()


def _coarse(model: Vector, data: Vector) -> tuple[int, Vector, float]:
    """Return the grid points to roll the data by, the signals' signs, and their correlation."""
    a = model - model.mean(axis=0)
    b = data - data.mean(axis=0)
    size = np.linalg.norm(a, axis=0) * np.linalg.norm(b, axis=0)
    spectra = np.fft.rfft(a, axis=0) * np.conj(np.fft.rfft(b, axis=0))
    products = np.asarray(np.fft.irfft(spectra, _PHASES, axis=0), dtype=np.float64)
    together: Vector = products / np.where(size > 0.0, size, 1.0)
    plain, turned = together.sum(axis=1), np.abs(together).sum(axis=1)
    best, other = int(np.argmax(plain)), int(np.argmax(turned))
    if plain[best] >= _TURNED * turned[other]:
        return best, np.ones(len(model[0])), float(plain[best]) / len(model[0])
    signs: Vector = np.ones(len(model[0]))
    for k in range(len(signs)):
        if float(together[other, k]) < _OPPOSED:
            signs[k] = -1.0
    return other, signs, float(turned[other]) / len(model[0])


def _likeness(name: str, model: Vector, data: Vector, opposed: bool, noise: float) -> Likeness:
    a, b = model - model.mean(), data - data.mean()
    own = float(a @ a)
    gain = float(a @ b) / own if own > 0.0 else 0.0
    size = math.sqrt(own * float(b @ b))
    correlation = float(a @ b) / size if size > 0.0 else 0.0
    suspicion = _like_factor(abs(gain), _FACTORS) if abs(correlation) > _SAME else ""
    if opposed:
        suspicion = " and ".join(filter(None, ("its sign reversed", suspicion)))
    return Likeness(
        name=name,
        correlation=correlation,
        gain=gain,
        suspicion=suspicion,
        differs=float(np.std(b - a)) > noise,
    )


def _like_factor(factor: float, known: Sequence[tuple[float, str]]) -> str:
    """Return the unit mistake that matches a factor, or an empty string for a factor near one."""
    if not 0.0 < factor < math.inf or 0.5 < factor < 2.0:
        return ""
    distances = [abs(math.log(factor / one)) for one, _ in known]
    nearest = int(np.argmin(distances))
    large = abs(math.log(known[nearest][0])) > math.log(_LARGE)
    return known[nearest][1] if distances[nearest] < (_LIKE if large else _ALIKE) else ""


class _Place(NamedTuple):
    """A release and a period in the record, and their standard errors [s]."""

    release: float
    error: float
    period: float
    period_error: float


def _fine(table: PeriodTable, time: Vector, values: Vector, scale: Vector, at: _Place) -> _Place:
    """Return the least-squares position of the orbit, near a first estimate."""
    rows = np.unique(np.linspace(0, len(time) - 1, min(len(time), _MOST_ROWS)).astype(np.int64))
    t, y, n_s = time[rows], values[:, rows].T, len(values)
    # Thinned rows contain less information than all rows.
    thinned = math.sqrt(len(t) / len(time))
    release, error, period, unsure = at
    best, least, refused = at, math.inf, False
    nearest, lowest = at, math.inf
    for _ in range(_STEPS):
        turns, stretch = (t - release) / period, table.period / period
        nodes = table.nodes.with_slopes(np.mod(turns, 1.0) * table.period)
        model, slope = (columns[:, :n_s] for columns in nodes)
        whole = np.where(np.isfinite(y), y - model, np.nan) / scale
        cost = float(np.nansum(np.nanvar(whole, axis=0)))
        refused = cost > least and abs(release - best.release) > _STRIDE * period
        if refused:
            # The slopes alone would move the orbit beyond its jumps.
            release = (release + best.release) / 2
            continue
        least = cost
        # A slope does not include a jump, so samples near a jump would shift the fit the wrong way.
        seen = np.isfinite(y) & ~beside_jumps(table, turns, ROUGHLY)[:, :n_s]
        count = np.maximum(seen.sum(axis=0), 1)
        rest = np.where(seen, y - model, 0.0)
        # An offset of an encoder does not shift the time.
        rest = np.where(seen, rest - rest.sum(axis=0) / count, 0.0) / scale
        # The mean slope of a signal that jumps is not zero, and acts as an offset.
        moved = np.where(seen, -slope * stretch, 0.0)
        moved = np.where(seen, moved - moved.sum(axis=0) / count, 0.0) / scale
        below = float(np.sum(moved**2))
        if not below > 0.0:
            return _Place(release, math.inf, period, unsure)
        late = float(np.sum(moved * rest)) / below
        # Signals differ in their noise, and the signals with steep slopes determine the shift.
        noise = np.sum((rest - moved * late) ** 2, axis=0) / count
        white = math.sqrt(float(noise @ np.sum(moved**2, axis=0))) / below
        cycles = np.floor(turns).astype(np.int64)
        cycles -= cycles[0]
        numbers = np.repeat(cycles, n_s)
        scatter = delays_of(numbers, moved.ravel(), rest.ravel()).scatter
        error = max(thinned * white, scatter)
        best = _Place(release, error, period, unsure)
        if cost < lowest:
            nearest, lowest = best, cost
        release += float(np.clip(late, -0.1 * period, 0.1 * period))
        # The periodic part is equal in all cycles, except at an incomplete cycle.
        n_bins = int(np.clip(len(turns) / (cycles[-1] + 1) / 2, 1, _BINS))
        bins = np.minimum((np.mod(turns, 1.0) * n_bins).astype(np.int64), n_bins - 1)
        freedom = np.maximum(count - n_bins, 1)
        whole = _less_means(moved, bins, seen)
        left, longer = (
            _without(_less_means(row, bins, seen), whole)
            for row in (rest, moved * (cycles - cycles.mean())[:, None])
        )
        below = float(np.sum(longer**2))
        if below > 0.0:
            change = float(np.sum(longer * left)) / below
            left = left - longer * change
            noise = np.sum(left**2, axis=0) / freedom
            variance = thinned**2 * float(noise @ np.sum(longer**2, axis=0))
            if cycles[-1] >= _TELLING:
                each = np.bincount(numbers, weights=(longer * left).ravel())
                variance = max(variance, float(np.sum(each**2)))
            unsure = math.sqrt(variance) / below
            period += float(np.clip(change, -0.1 * period, 0.1 * period))
        best = best._replace(period_error=unsure)
    if refused or least > _WORSE * lowest:
        return nearest._replace(period=period, period_error=unsure)
    return _Place(release, error, period, unsure)


def _without(values: Vector, direction: Vector) -> Vector:
    """Return the component of values orthogonal to a direction."""
    length = float(np.sum(direction**2))
    return values - direction * (float(np.sum(values * direction)) / length if length else 0.0)


def _less_means(values: Vector, bins: NDArray[np.int64], seen: NDArray[np.bool_]) -> Vector:
    """Return values less their mean over the cycles, bin by bin, ``(n, n_s)``."""
    found = np.zeros_like(values)
    for k, (here, row) in enumerate(zip(seen.T, values.T, strict=True)):
        count = np.maximum(np.bincount(bins[here], minlength=int(bins.max()) + 1), 1)
        sums = np.bincount(bins[here], weights=row[here], minlength=len(count))
        found[:, k] = np.where(here, row - (sums / count)[bins], 0.0)
    return found
