r"""Impacts, the locked phase and the release in a recorded gap, cycle by cycle.

The stop is the lowest level at which the gap rests, and the scatter there is the noise. The first
impact is where the gap comes down on the stop, found from the samples of the flight before it; the
rebounds after it are cubics through zero; what is left of the chatter when rebounds drown in noise
is the geometric series :math:`\Delta t_n\,e / (1 - e)`; and the release, where the gap grows like
the third power of the time, is found by the shape that the orbit's own gap has there (theory (56)).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.comparison.contact_fits import (
    LEAST,
    GapSamples,
    ImpactFit,
    Rebound,
    fit_impact,
    fit_rebound,
    fit_release,
)
from zeno_orbits.experiment.comparison.estimate import UNKNOWN, Estimate
from zeno_orbits.experiment.comparison.gap_model import GapModel
from zeno_orbits.experiment.comparison.stop_level import Stop

_LOW = 0.2
"""A gap that turns below this part of its height has touched the stop."""
_LOCKED = 0.02
"""A rest is a locked phase from this part of a period on."""
_SHARE = 0.25
"""And from this part of the orbit's own: a gap that only turns lingers, too."""
_LONGER = 1.3
"""A flight has its highest point within this multiple of the orbit's own."""
_AT_ONCE = 0.01
"""Part of a period within which a gap that rests has stayed where it fell."""
_UNSEEN = 0.05
"""Part of the time of rebounds that are too small to be seen by which that may be off."""
_MOST_CYCLES = 200
_MOST_REBOUNDS = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class CycleEvents:
    """Events of one recorded cycle; times count from the orbit's release as aligned [s].

    What the data hide, in a gap for instance, is NaN. Errors are those of the noise alone.

    Attributes:
        closed: Whether the gap is seen to close, resolved or not.
        first_impact: When the gap closes first.
        speed: Gap rate just before, negative.
        restitution: Speed after over speed before.
        chatter_end: Where the rebounds end, those in the noise summed.
        release: When the gap begins to open.
        rest: When it is seen to stay closed, from and to.
        hidden: By how much rebounds that the samples hide may change restitution and chatter end
            [s]. A mean over cycles does not make that smaller.
    """

    closed: bool = False
    first_impact: Estimate = UNKNOWN
    speed: Estimate = UNKNOWN
    restitution: Estimate = UNKNOWN
    chatter_end: Estimate = UNKNOWN
    release: Estimate = UNKNOWN
    rest: tuple[float, float] = (math.nan, math.nan)
    hidden: tuple[float, float] = (0.0, 0.0)

    @property
    def rested(self) -> bool:
        """True if the gap is seen to stay closed."""
        return math.isfinite(self.rest[0])


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
        own = GapSamples(t=t[a:b] - start, h=h[a:b], noise=stop.noise, model=model)
        found.append(_Seen(own, stop.band).events())
    return tuple(found)


class _Seen:
    """The samples of one cycle, and what is found in them."""

    def __init__(self, samples: GapSamples, band: float) -> None:
        self.samples, self.band, self.model = samples, band, samples.model
        self.t, self.h, self.period = samples.t, samples.h, samples.model.period

    def events(self) -> CycleEvents:
        """Return what is found; what is not is NaN."""
        if len(self.t) < 4 * LEAST:
            return CycleEvents()
        rest = self.rest()
        start = float(self.t[rest[0]]) if rest else self.period
        seen = CycleEvents() if rest is None else CycleEvents(rest=(start, float(self.t[rest[1]])))
        apex, at = self.fallen(0, 0.0, start)
        impact = None if at is None else fit_impact(self.samples, apex, at)
        if impact is None:
            return replace(seen, closed=at is not None)
        restitution, end, hidden = self.chatter(impact, start, rested=rest is not None)
        return replace(
            seen,
            closed=True,
            first_impact=impact.time,
            speed=impact.rate,
            restitution=restitution,
            chatter_end=UNKNOWN if rest is None else end,
            release=UNKNOWN if rest is None else fit_release(self.samples, rest[1]),
            hidden=hidden,
        )

    def chatter(
        self, impact: ImpactFit, start: float, *, rested: bool
    ) -> tuple[Estimate, Estimate, tuple[float, float]]:
        """Return restitution and end of the chatter, and by how much what is hidden changes both.

        Args:
            impact: The first impact.
            start: When the gap rests, if it does.
            rested: Whether it does.
        """
        landing, speed = impact.time, -impact.rate.value
        until = start if rested else landing.value + 0.3 * self.period
        rebounds = self.rebounds(landing.value, until)
        if rebounds:
            e = rebounds[0].up.value / speed
            error = math.hypot(rebounds[0].up.error, e * impact.rate.error) / speed
            end, tail = self.chatter_end(impact, rebounds)
            return Estimate(value=e, error=error), end, (0.0, _UNSEEN * tail)
        if start - landing.value >= _AT_ONCE * self.period:
            return UNKNOWN, UNKNOWN, (0.0, 0.0)
        hidden = self.hidden(speed)
        if not math.isfinite(hidden[1]):
            return UNKNOWN, UNKNOWN, hidden
        return Estimate(value=0.0, error=0.0), landing, hidden

    def rest(self) -> tuple[int, int] | None:
        """Return the first and the last sample of the longest rest after the flight."""
        inside = np.abs(self.h) < self.band
        # One stray sample does not end a rest, nor does it make one.
        inside[1:-1] |= inside[:-2] & inside[2:]
        padded = np.zeros(len(inside) + 2)
        padded[1:-1] = inside & (self.t > 0.1 * self.period)
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
            if self.h[k] < self.band:
                return k
            if self.h[k] < lowest:
                lowest, at = float(self.h[k]), k
            elif self.h[k] > lowest + 1.5 * self.band and lowest < _LOW * self.h[apex]:
                # It turned near the lowest sample, on either side of it.
                return at
        return None

    def fallen(self, number: int, start: float, before: float) -> tuple[int, int | None]:
        """Return the highest sample of a flight, and the first behind the touch that ends it.

        Later flights may be higher: the orbit's own flight tells where this one is looked for.

        Args:
            number: Of the flight, 0 for the first one.
            start: When it starts [s].
            before: When all flights are over [s].
        """
        flights = self.model.flights
        until = before
        if number < len(flights):
            until = start + _LONGER * (flights[number].end - flights[number].start)
        flying = (self.t > start) & (self.t < min(before, until) + 1e-12)
        if not flying.any():
            return 0, None
        apex = int(np.argmax(np.where(flying, self.h, -np.inf)))
        return apex, self.fall(apex, before)

    def rebounds(self, impact: float, end: float) -> list[Rebound]:
        """Return each rebound that rises above the noise."""
        found: list[Rebound] = []
        start = impact
        for number in range(1, _MOST_REBOUNDS + 1):
            apex, at = self.fallen(number, start, end)
            if at is None or self.h[apex] < 1.5 * self.band:
                break
            chosen = (self.t > start) & (np.arange(len(self.t)) < at)
            own = replace(self.samples, t=self.t[chosen] - start, h=self.h[chosen])
            rebound = fit_rebound(own, number, float(self.t[at]) - start)
            if rebound is None:
                break
            found.append(rebound)
            start += rebound.length.value
        return found

    def hidden(self, landing: float) -> tuple[float, float]:
        """Return restitution and length of the greatest rebounds that noise or sampling hides.

        A rebound of the speed `e v` under the acceleration `a` rises by :math:`(e v)^2 / 2a` and
        lasts :math:`2 e v / a`; all that follow it last as long over `1 - e`.

        Args:
            landing: The speed `v`.
        """
        acceleration = abs(self.model.flights[0].acceleration)
        step = float(np.median(np.diff(self.t)))
        speed = max(math.sqrt(3.0 * self.band * acceleration), step * acceleration)
        restitution = speed / landing
        if not (acceleration > 0.0 and restitution < 1.0):
            return math.inf, math.inf
        return restitution, 2.0 * speed / acceleration / (1.0 - restitution)

    def chatter_end(self, impact: ImpactFit, rebounds: Sequence[Rebound]) -> tuple[Estimate, float]:
        """Return where the rebounds end, and how long those last that are unseen."""
        speeds = [-impact.rate.value, *(-one.down for one in rebounds)]
        ratios = [one.up.value / before for one, before in zip(rebounds, speeds, strict=False)]
        e = float(np.clip(np.average(ratios, weights=speeds[: len(rebounds)]), 0.0, 0.95))
        last = rebounds[-1].length.value
        own, factor = self.model.tail(len(rebounds))
        tail = factor * last * e / (1 - e)
        e_error = min(one.up.error / before for one, before in zip(rebounds, speeds, strict=False))
        noise = math.hypot(impact.time.error, *(one.length.error for one in rebounds))
        noise = math.hypot(noise, factor * last * e_error / (1 - e) ** 2)
        # The factor is the orbit's; the less the rebound is the orbit's, the less it is known.
        other = min(1.0, abs(last / own - 1.0)) if own > 0.0 else 1.0
        doubt = abs(factor - 1.0) * tail / factor * other
        end = impact.time.value + sum(one.length.value for one in rebounds) + tail
        return Estimate(value=end, error=math.hypot(noise, doubt)), tail
