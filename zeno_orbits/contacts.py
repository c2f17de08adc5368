r"""Impacts, the locked phase and the release in a recorded gap, cycle by cycle.

The stop is the lowest level at which the gap rests, and the scatter there is the noise. The first
impact is where the gap comes down on the stop, found from the samples of the flight before it; the
hops after it are cubics through zero; what is left of the chatter when hops drown in noise is the
geometric series :math:`\Delta t_n\,e / (1 - e)`; and the release, where the gap grows like the
third power of the time, is found by the shape that the orbit's own gap has there (theory (56)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.cycle_tables import Nodes

Vector = NDArray[np.float64]

_BAND = 5.0
"""A gap within so many standard deviations of the noise counts as closed."""
_FINEST = 1e-4
"""The same for a record without noise, in parts of the range of the gap."""
_LOW = 0.2
"""The level of the stop is looked for in this part of the range above the lowest gap."""
_RESTING = 0.05
"""Part of the samples that rest at the stop at least, for a level to be seen."""
_LOCKED = 0.02
"""A rest is a locked phase from this part of a period on."""
_SHARE = 0.25
"""And from this part of the orbit's own: a gap that only turns lingers, too."""
_WINDOW = 0.08
"""Part of a period before an impact whose samples tell of it."""
_LEAST = 6
"""Samples that a fit needs."""
_MOST_CYCLES = 200
_MOST_HOPS = 6
_UNKNOWN = (math.nan, math.nan, math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop:
    """The stop as a recorded gap shows it.

    Attributes:
        level: Gap at rest; what it is off zero is an offset of the instruments.
        noise: Standard deviation of the gap there.
        band: A gap this near to the level counts as closed.
    """

    level: float
    noise: float
    band: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CycleEvents:
    """What one recorded cycle shows; times count from the orbit's release as aligned [s].

    What the data hide, in a gap for instance, is NaN.

    Attributes:
        first_impact: When the gap closes first.
        speed: Gap rate just before, negative.
        restitution: Speed after over speed before.
        hops: Hops that rise above the noise.
        chatter_end: Where the hops end, those in the noise summed.
        rest_start: When the gap is seen to stay closed.
        release: When it begins to open.
        rest_end: When it is seen to open.
        errors: Standard errors of first impact, speed, restitution, chatter end and release from
            the noise alone.
    """

    first_impact: float = math.nan
    speed: float = math.nan
    restitution: float = math.nan
    hops: int = 0
    chatter_end: float = math.nan
    rest_start: float = math.nan
    release: float = math.nan
    rest_end: float = math.nan
    errors: tuple[float, float, float, float, float] = _UNKNOWN


@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """A flight of the orbit from one touch of the stop to the next; the first from the release.

    Attributes:
        start: Time since the release [s].
        end: Of the impact that ends it [s].
        rate: Gap rate before that.
        acceleration: Of the gap there.
    """

    start: float
    end: float
    rate: float
    acceleration: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GapModel:
    """The orbit's own gap, stretched to the period of the record.

    Attributes:
        nodes: Gap over time from release to release, and its rate.
        flights: Its flights, the hops among them.
        restitution: Of the orbit.
        zeno_time: [s].
        period: [s].
    """

    nodes: Nodes
    flights: tuple[Flight, ...]
    restitution: float
    zeno_time: float
    period: float

    def flight(self, number: int, since: Vector) -> tuple[Vector, Vector]:
        """Return gap and rate of a flight, followed through the stop as if it were not there.

        Args:
            number: Of the flight; without such a one all is zero.
            since: Times since its start [s].
        """
        if number >= len(self.flights):
            return np.zeros_like(since), np.zeros_like(since)
        one = self.flights[number]
        length = one.end - one.start
        inside, slope = self.nodes.with_slopes(
            one.start + np.clip(since, 0.0, length * (1.0 - 1e-9))
        )
        beyond = np.maximum(since - length, 0.0)
        gap = inside[:, 0] + beyond * (one.rate + beyond * one.acceleration / 2)
        return gap, slope[:, 0] + beyond * one.acceleration

    def opening(self, times: Vector) -> tuple[Vector, Vector]:
        """Return gap and rate after the release; before it they are zero."""
        inside, slope = self.nodes.with_slopes(np.clip(times, 0.0, self.flights[0].end / 2))
        after = times > 0.0
        return np.where(after, inside[:, 0], 0.0), np.where(after, slope[:, 0], 0.0)

    def tail(self, hop: int) -> tuple[float, float]:
        """Return the length of a hop, and by what its tail differs from a geometric series.

        Args:
            hop: Its number from 1.
        """
        e = self.restitution
        if hop >= len(self.flights) or e == 0.0:
            return math.nan, 1.0
        one = self.flights[hop]
        length = one.end - one.start
        return length, (self.zeno_time - one.end) * (1 - e) / (length * e)


def stop_level(gap: Vector) -> Stop | None:
    """Return the level at which a gap rests, or nothing if it rests nowhere.

    Args:
        gap: The gap in order of time, NaN where it was not taken.
    """
    seen = gap[np.isfinite(gap)]
    if len(seen) < 50:
        return None
    low, high = (float(v) for v in np.quantile(seen, [0.002, 0.998]))
    extent = high - low
    if not extent > 0.0:
        return None
    candidates = np.sort(seen[(seen < low + _LOW * extent)])
    needed = max(int(_RESTING * len(seen)), 10)
    if len(candidates) <= needed:
        return None
    widths = candidates[needed:] - candidates[:-needed]
    at = int(np.argmin(widths))
    core = candidates[at : at + needed + 1]
    level, width = float(np.median(core)), float(widths[at])
    # The scatter of neighbours is noise, whatever slow motion there is besides.
    near = np.abs(gap - level) < max(3 * width, _FINEST * extent)
    triples = near[:-2] & near[1:-1] & near[2:]
    second = (gap[1:-1] - (gap[:-2] + gap[2:]) / 2)[triples]
    noise = 1.4826 * float(np.median(np.abs(second))) / math.sqrt(1.5) if len(second) else 0.0
    steps = np.abs(np.diff(seen))
    quantum = float(np.min(steps[steps > 1e-9 * extent], initial=math.inf))
    if math.isfinite(quantum) and np.mean(steps <= 1e-9 * extent) > 0.2:
        # An encoder: its values repeat, and their scatter hides in the last digit.
        noise = max(noise, quantum / math.sqrt(12.0))
    noise = max(noise, width / 8)
    for _ in range(3):
        inside = seen[np.abs(seen - level) < _BAND * noise]
        if len(inside) > needed:
            level = float(np.mean(inside[np.abs(inside - level) < 2.5 * noise]))
    return Stop(level=level, noise=noise, band=max(_BAND * noise, _FINEST * extent))


def cycle_events(
    time: Vector, gap: Vector, stop: Stop, model: GapModel, release: float
) -> tuple[CycleEvents, ...]:
    """Return what each whole cycle of a record shows, of very many evenly chosen ones.

    Args:
        time: Increasing, ``(n_t,)`` [s].
        gap: ``(n_t,)``, NaN where it was not taken.
        stop: The stop.
        model: The orbit's gap, in the period of the record.
        release: A time of the orbit's release in the record [s].
    """
    seen = np.isfinite(gap)
    t, h = time[seen], gap[seen] - stop.level
    if len(t) < _LEAST:
        return ()
    period = model.period
    first = math.ceil((t[0] - release) / period - 0.02)
    last = math.floor((t[-1] - release) / period - 1.15)
    numbers = list(range(first, last + 1))
    if len(numbers) > _MOST_CYCLES:
        step = (last - first) / (_MOST_CYCLES - 1)
        numbers = [first + round(k * step) for k in range(_MOST_CYCLES)]
    found: list[CycleEvents] = []
    for number in numbers:
        start = release + number * period
        a, b = np.searchsorted(t, [start - 0.1 * period, start + 1.25 * period])
        found.append(_Seen(t[a:b] - start, h[a:b], stop, model).events())
    return tuple(found)


def refined_stop(
    time: Vector,
    gap: Vector,
    stop: Stop,
    events: tuple[CycleEvents, ...],
    release: float,
    period: float,
) -> Stop:
    """Return the stop as the early half of every rest shows it, far from where the gap opens.

    Args:
        time: Increasing, ``(n_t,)`` [s].
        gap: ``(n_t,)``.
        stop: A first value.
        events: What the cycles show with it.
        release: A time of the orbit's release in the record [s].
        period: [s].
    """
    whole = [one for one in events if math.isfinite(one.rest_start)]
    if not whole:
        return stop
    start = float(np.median([one.rest_start for one in whole]))
    end = float(np.median([one.rest_end for one in whole]))
    since = np.mod(time - release, period)
    early = (since > start + 0.1 * (end - start)) & (since < start + 0.5 * (end - start))
    resting = gap[early & (np.abs(gap - stop.level) < 2 * stop.band)]
    if len(resting) < 10:
        return stop
    level, noise = float(np.mean(resting)), max(float(np.std(resting)), 0.3 * stop.noise)
    finest = stop.band if stop.band > _BAND * stop.noise else 0.0
    return Stop(level=level, noise=noise, band=max(_BAND * noise, finest))


class _Seen:
    """The samples of one cycle, and what is found in them."""

    def __init__(self, t: Vector, h: Vector, stop: Stop, model: GapModel) -> None:
        self.t, self.h, self.stop, self.model = t, h, stop, model
        self.period = model.period

    def events(self) -> CycleEvents:
        """Return what is found; what is not is NaN."""
        if len(self.t) < 4 * _LEAST:
            return CycleEvents()
        rest = self.rest()
        start = self.t[rest[0]] if rest else self.period
        touch = self.touch(start)
        if touch is None:
            if rest is None:
                return CycleEvents()
            return CycleEvents(rest_start=float(start), rest_end=float(self.t[rest[1]]))
        impact, speed, impact_error, speed_error = touch
        hops = self.hops(impact, float(start) if rest else impact + 0.3 * self.period)
        restitution, restitution_error = math.nan, math.nan
        end, end_error = math.nan, math.nan
        if hops:
            restitution = hops[0].up / -speed
            restitution_error = math.hypot(hops[0].up_error, restitution * speed_error) / -speed
            end, end_error = self.chatter_end(impact, impact_error, hops, speed)
        elif start - impact < 0.01 * self.period:
            # It stays where it fell.
            restitution, restitution_error, end, end_error = 0.0, 0.0, impact, impact_error
        release = (math.nan, math.nan) if rest is None else self.release(rest[1])
        if rest is None:
            end, end_error = math.nan, math.nan
        return CycleEvents(
            first_impact=impact,
            speed=speed,
            restitution=restitution,
            hops=len(hops),
            chatter_end=end,
            rest_start=float(start) if rest else math.nan,
            release=release[0],
            rest_end=float(self.t[rest[1]]) if rest else math.nan,
            errors=(impact_error, speed_error, restitution_error, end_error, release[1]),
        )

    def rest(self) -> tuple[int, int] | None:
        """Return the first and the last sample of the longest rest after the flight."""
        inside = np.abs(self.h) < self.stop.band
        # One stray sample does not end a rest, nor does it make one.
        inside[1:-1] |= inside[:-2] & inside[2:]
        late = self.t > 0.1 * self.period
        whole = inside & late
        padded = np.zeros(len(whole) + 2)
        padded[1:-1] = whole
        edges = [int(k) for k in np.flatnonzero(np.diff(padded))]
        best: tuple[int, int] | None = None
        own = self.period - self.model.zeno_time
        longest = max(_LOCKED * self.period, _SHARE * own)
        for a, after in zip(edges[::2], edges[1::2], strict=True):
            b = after - 1
            # Where nothing was recorded nobody knows whether it rested.
            if b - a + 1 >= _LEAST and self.t[b] - self.t[a] > longest:
                if float(np.max(np.diff(self.t[a : b + 1]))) > 0.25 * (self.t[b] - self.t[a]):
                    continue
                best, longest = (a, b), float(self.t[b] - self.t[a])
        return best

    def fall(self, apex: int, until: float) -> int | None:
        """Return the first sample that may lie behind the touch after an apex.

        Where no sample falls into the band, the gap's turn tells that it has touched.
        """
        lowest, at = math.inf, apex
        for k in range(apex, len(self.t)):
            if self.t[k] > until + 1e-12:
                break
            if self.h[k] < self.stop.band:
                return k
            if self.h[k] < lowest:
                lowest, at = float(self.h[k]), k
            elif self.h[k] > lowest + 1.5 * self.stop.band and lowest < _LOW * self.h[apex]:
                # It turned near the lowest sample, on either side of it.
                return at
        return None

    def touch(self, before: float) -> tuple[float, float, float, float] | None:
        """Return time and rate of the first impact, and their errors.

        The samples of the flight are held against the orbit's; what is between them is smooth.
        """
        flying = (self.t > 0.0) & (self.t < before + 1e-12)
        if not flying.any():
            return None
        apex = int(np.argmax(np.where(flying, self.h, -np.inf)))
        at = self.fall(apex, before)
        if at is None:
            return None
        crossing, unit = float(self.t[at]), _WINDOW * self.period
        near = slice(int(np.searchsorted(self.t, max(crossing - unit, self.t[apex]))), at)
        t, h = self.t[near], self.h[near]
        if len(t) < _LEAST or crossing - t[-1] > 0.25 * unit or t[0] > crossing - 0.7 * unit:
            return None
        fit, covariance = _fitted(_square(t, crossing, unit), self.residual(0, t, h), self.noise)
        impact, speed = crossing, math.nan
        for _ in range(8):
            gap, rate = self.model.flight(0, np.array([impact]))
            value = float(gap[0]) + float(_square(impact, crossing, unit) @ fit)
            speed = float(rate[0]) + float(_square_slope(impact, crossing, unit) @ fit)
            if not speed < 0.0:
                return None
            impact -= float(np.clip(value / speed, -0.2 * unit, 0.2 * unit))
        row, slope = _square(impact, crossing, unit), _square_slope(impact, crossing, unit)
        impact_error = math.sqrt(float(row @ covariance @ row)) / -speed
        return impact, speed, impact_error, math.sqrt(float(slope @ covariance @ slope))

    @property
    def noise(self) -> float:
        """Standard deviation of the noise."""
        return self.stop.noise

    def residual(self, flight: int, since: Vector, h: Vector) -> Vector:
        """Return what the samples have beyond the orbit's own flight."""
        return h - self.model.flight(flight, since)[0]

    def hops(self, impact: float, end: float) -> list[_Hop]:
        """Return each hop that rises above the noise."""
        found: list[_Hop] = []
        start = impact
        for number in range(1, _MOST_HOPS + 1):
            inside = (self.t > start) & (self.t < end)
            if not inside.any():
                break
            apex = int(np.argmax(np.where(inside, self.h, -np.inf)))
            at = self.fall(apex, end)
            if self.h[apex] < 1.5 * self.stop.band or at is None:
                break
            chosen = (self.t > start) & (np.arange(len(self.t)) < at)
            t, h = self.t[chosen] - start, self.h[chosen]
            length = float(self.t[at]) - start
            if len(t) < _LEAST or max(float(t[0]), float(np.max(np.diff(t)))) > 0.3 * length:
                break
            hop = self.hop(number, t, h, length)
            if hop is None:
                break
            found.append(hop)
            start += hop.length
        return found

    def hop(self, number: int, s: Vector, h: Vector, length: float) -> _Hop | None:
        """Return a hop: the orbit's own and a cubic, zero at its start together."""
        x = s / length
        columns = np.stack([x, x**2, x**3], axis=1)
        fit, covariance = _fitted(columns, self.residual(number, s, h), self.noise)
        end, down = 1.0, math.nan
        for _ in range(12):
            gap, rate = self.model.flight(number, np.array([end * length]))
            value = float(gap[0] + fit @ [end, end**2, end**3])
            down = float(rate[0] * length + fit @ [1.0, 2 * end, 3 * end**2])
            if not down < 0.0:
                return None
            end -= float(np.clip(value / down, -0.2, 0.2))
        up = float(self.model.flight(number, np.zeros(1))[1][0]) + float(fit[0]) / length
        if not (0.5 < end < 1.5 and up > 0.0):
            return None
        row = np.array([end, end**2, end**3])
        return _Hop(
            length=end * length,
            up=up,
            down=down / length,
            up_error=math.sqrt(float(covariance[0, 0])) / length,
            length_error=math.sqrt(float(row @ covariance @ row)) / -down * length,
        )

    def chatter_end(
        self, impact: float, impact_error: float, hops: list[_Hop], speed: float
    ) -> tuple[float, float]:
        """Return where the hops end, and the error of that."""
        speeds = [-speed, *(-hop.down for hop in hops)]
        ratios = [hop.up / before for hop, before in zip(hops, speeds, strict=False)]
        e = float(np.clip(np.average(ratios, weights=speeds[: len(hops)]), 0.0, 0.95))
        last = hops[-1]
        own, factor = self.model.tail(len(hops))
        tail = factor * last.length * e / (1 - e)
        e_error = min(hop.up_error / before for hop, before in zip(hops, speeds, strict=False))
        noise = math.hypot(impact_error, *(hop.length_error for hop in hops))
        noise = math.hypot(noise, factor * last.length * e_error / (1 - e) ** 2)
        # The factor is the orbit's; the less the hop is the orbit's, the less it is known.
        other = min(1.0, abs(last.length / own - 1.0)) if own > 0.0 else 1.0
        doubt = abs(factor - 1.0) * tail / factor * other
        return impact + sum(hop.length for hop in hops) + tail, math.hypot(noise, doubt)

    def release(self, after: int) -> tuple[float, float]:
        """Return where the gap begins to open, and the error of that."""
        t, h = self.t - self.period, self.h
        top = 0.08 * float(np.max(self.h))
        begin = int(np.searchsorted(self.t, float(self.t[after]) - 0.05 * self.period))
        opened = np.flatnonzero(h[after:] > top)
        stop = after + int(opened[0]) if len(opened) else len(t)
        if stop - after < 3 or stop - begin < 2 * _LEAST or not len(opened):
            return math.nan, math.nan
        t, h = t[begin:stop], h[begin:stop]
        if float(np.max(np.diff(t[-(stop - after) :]))) > 0.02 * self.period:
            return math.nan, math.nan
        shift, size = 0.0, 1.0
        columns = np.zeros((len(t), 2))
        for _ in range(20):
            gap, rate = self.model.opening(t - shift)
            columns = np.stack([gap, -size * rate], axis=1)
            step = np.linalg.lstsq(columns, h - size * gap, rcond=1e-12)[0]
            size += float(np.clip(step[0], -0.5 * size, size))
            shift += float(np.clip(step[1], -0.03 * self.period, 0.03 * self.period))
            if not (0.05 < size < 20.0 and abs(shift) < 0.25 * self.period):
                return math.nan, math.nan
        _, covariance = _fitted(columns, h - size * self.model.opening(t - shift)[0], self.noise)
        return self.period + shift, math.sqrt(max(float(covariance[1, 1]), 0.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Hop:
    """A hop that rises above the noise.

    Attributes:
        length: [s].
        up: Gap rate at its start.
        down: Gap rate at its end, negative.
        up_error: Standard error of ``up``.
        length_error: Standard error of ``length`` [s].
    """

    length: float
    up: float
    down: float
    up_error: float
    length_error: float


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
