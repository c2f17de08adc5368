r"""Impacts, the locked phase and the release in a recorded gap, cycle by cycle.

The stop is the lowest level at which the gap rests, and the scatter there is the noise. The first
impact is where the gap comes down on the stop, found from the samples of the flight before it; the
hops after it are cubics through zero; what is left of the chatter when hops drown in noise is the
geometric series :math:`\Delta t_n\,e / (1 - e)`; and the release, where the gap grows like the
third power of the time, is found by the shape that the orbit's own gap has there (theory (56)).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.contact_fits import (
    LEAST,
    HopFit,
    ImpactFit,
    fit_hop,
    fit_impact,
    fit_release,
)
from zeno_orbits.experiment.comparison.gap_model import GapModel
from zeno_orbits.experiment.comparison.stop_level import Stop

_LOW = 0.2
"""A gap that turns below this part of its height has touched the stop."""
_LOCKED = 0.02
"""A rest is a locked phase from this part of a period on."""
_SHARE = 0.25
"""And from this part of the orbit's own: a gap that only turns lingers, too."""
_AT_ONCE = 0.01
"""Part of a period within which a gap that rests has stayed where it fell."""
_UNSEEN = 0.05
"""Part of the time of hops that are too small to be seen by which that may be off."""
_MOST_CYCLES = 200
_MOST_HOPS = 6
_UNKNOWN = (math.nan, math.nan, math.nan, math.nan, math.nan)


@dataclass(frozen=True, slots=True, kw_only=True)
class CycleEvents:
    """Events of one recorded cycle; times count from the orbit's release as aligned [s].

    What the data hide, in a gap for instance, is NaN.

    Attributes:
        closed: Whether the gap is seen to close, resolved or not.
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
        hidden: By how much hops that the samples hide may change restitution and chatter end [s].
            A mean over cycles does not make that smaller.
    """

    closed: bool = False
    first_impact: float = math.nan
    speed: float = math.nan
    restitution: float = math.nan
    hops: int = 0
    chatter_end: float = math.nan
    rest_start: float = math.nan
    release: float = math.nan
    rest_end: float = math.nan
    errors: tuple[float, float, float, float, float] = _UNKNOWN
    hidden: tuple[float, float] = (0.0, 0.0)


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
    if len(t) < LEAST:
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


class _Seen:
    """The samples of one cycle, and what is found in them."""

    def __init__(self, t: Vector, h: Vector, stop: Stop, model: GapModel) -> None:
        self.t, self.h, self.stop, self.model = t, h, stop, model
        self.period = model.period

    def events(self) -> CycleEvents:
        """Return what is found; what is not is NaN."""
        if len(self.t) < 4 * LEAST:
            return CycleEvents()
        rest = self.rest()
        start = float(self.t[rest[0]]) if rest else self.period
        seen = (start, float(self.t[rest[1]])) if rest else (math.nan, math.nan)
        apex, at = self.fallen(start)
        touch = None if at is None else self.touch(apex, at)
        if touch is None:
            return CycleEvents(closed=at is not None, rest_start=seen[0], rest_end=seen[1])
        hops = self.hops(touch.time, start if rest else touch.time + 0.3 * self.period)
        restitution, restitution_error, hidden = math.nan, math.nan, (0.0, 0.0)
        end, end_error = math.nan, math.nan
        if hops:
            restitution = hops[0].up / -touch.rate
            restitution_error = (
                math.hypot(hops[0].up_error, restitution * touch.rate_error) / -touch.rate
            )
            end, end_error, tail = self.chatter_end(touch, hops)
            hidden = (0.0, _UNSEEN * tail)
        elif start - touch.time < _AT_ONCE * self.period:
            hidden = self.hidden(touch)
            if math.isfinite(hidden[1]):
                restitution, restitution_error = 0.0, 0.0
                end, end_error = touch.time, touch.time_error
        if rest is None:
            end, end_error = math.nan, math.nan
        release = (math.nan, math.nan) if rest is None else self.release(rest[1])
        return CycleEvents(
            closed=True,
            first_impact=touch.time,
            speed=touch.rate,
            restitution=restitution,
            hops=len(hops),
            chatter_end=end,
            rest_start=seen[0],
            release=release[0],
            rest_end=seen[1],
            errors=(touch.time_error, touch.rate_error, restitution_error, end_error, release[1]),
            hidden=hidden,
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
            # A rest that was hardly recorded is not known to be one.
            if b - a + 1 >= LEAST and self.t[b] - self.t[a] > longest:
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

    def fallen(self, before: float) -> tuple[int, int | None]:
        """Return the highest sample before a time, and the first behind the touch after it."""
        flying = (self.t > 0.0) & (self.t < before + 1e-12)
        if not flying.any():
            return 0, None
        apex = int(np.argmax(np.where(flying, self.h, -np.inf)))
        return apex, self.fall(apex, before)

    def touch(self, apex: int, at: int) -> ImpactFit | None:
        """Return the first impact, if the samples resolve it."""
        return fit_impact(self.t, self.h, apex, at, self.stop.noise, self.model)

    def hops(self, impact: float, end: float) -> list[HopFit]:
        """Return each hop that rises above the noise."""
        found: list[HopFit] = []
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
            length = float(self.t[at]) - start
            since, h = self.t[chosen] - start, self.h[chosen]
            hop = fit_hop(number, since, h, length, self.stop.noise, self.model)
            if hop is None:
                break
            found.append(hop)
            start += hop.length
        return found

    def hidden(self, touch: ImpactFit) -> tuple[float, float]:
        """Return restitution and length of the greatest hops that noise or sampling hides.

        A hop of the speed `e v` under the acceleration `a` rises by :math:`(e v)^2 / 2a` and lasts
        :math:`2 e v / a`; all that follow it last as long over `1 - e`.
        """
        acceleration = abs(self.model.flights[0].acceleration)
        step = float(np.median(np.diff(self.t)))
        speed = max(math.sqrt(3.0 * self.stop.band * acceleration), step * acceleration)
        restitution = speed / -touch.rate
        if not (acceleration > 0.0 and restitution < 1.0):
            return math.inf, math.inf
        return restitution, 2.0 * speed / acceleration / (1.0 - restitution)

    def chatter_end(self, touch: ImpactFit, hops: Sequence[HopFit]) -> tuple[float, float, float]:
        """Return where the hops end, the error of that, and how long those last that are unseen."""
        speeds = [-touch.rate, *(-hop.down for hop in hops)]
        ratios = [hop.up / before for hop, before in zip(hops, speeds, strict=False)]
        e = float(np.clip(np.average(ratios, weights=speeds[: len(hops)]), 0.0, 0.95))
        last = hops[-1]
        own, factor = self.model.tail(len(hops))
        tail = factor * last.length * e / (1 - e)
        e_error = min(hop.up_error / before for hop, before in zip(hops, speeds, strict=False))
        noise = math.hypot(touch.time_error, *(hop.length_error for hop in hops))
        noise = math.hypot(noise, factor * last.length * e_error / (1 - e) ** 2)
        # The factor is the orbit's; the less the hop is the orbit's, the less it is known.
        other = min(1.0, abs(last.length / own - 1.0)) if own > 0.0 else 1.0
        doubt = abs(factor - 1.0) * tail / factor * other
        end = touch.time + sum(hop.length for hop in hops) + tail
        return end, math.hypot(noise, doubt), tail

    def release(self, after: int) -> tuple[float, float]:
        """Return where the gap begins to open behind a sample, and the error of that."""
        return fit_release(self.t, self.h, after, self.stop.noise, self.model)
