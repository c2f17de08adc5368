"""Impact sequences known in closed form; `README.md` beside this file derives them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from scipy.optimize import brentq

N_TERMS = 40
"""Terms of the power series of a flight; flights of 0.5 s need fewer than 20."""
ROUNDING = 2.0**-52
END = 1e-16
"""Part of the first speed at which a sequence is at its end."""


def ball_fall_time(height: float, g: float) -> float:
    """Return the time of the first impact of a ball dropped at rest [s]."""
    return math.sqrt(2 * height / g)


def ball_impact_time(height: float, g: float, restitution: float, index: int) -> float:
    """Return the time of impact ``index`` (0 is the first) of a dropped ball [s]."""
    bounces = sum(restitution**k for k in range(1, index + 1))
    return ball_fall_time(height, g) * (1 + 2 * bounces)


def ball_impact_speed(height: float, g: float, restitution: float, index: int) -> float:
    """Return the speed just before impact ``index`` of a dropped ball [m/s]."""
    return math.sqrt(2 * g * height) * restitution**index


def ball_zeno_time(height: float, g: float, restitution: float) -> float:
    """Return when the impacts of a dropped ball accumulate [s]."""
    return ball_fall_time(height, g) * (1 + restitution) / (1 - restitution)


@dataclass(frozen=True, slots=True, kw_only=True)
class StoppedOscillator:
    """The oscillator ``x'' + c x' + x = cos t`` with the stop ``x <= stop``.

    Attributes:
        damping: ``c``, positive and below 2.
        stop: Position of the stop.
        restitution: ``e``.
    """

    damping: float
    stop: float
    restitution: float

    @property
    def release_time(self) -> float:
        """When the stop lets go of a locked mass, in the first half turn of the forcing [s]."""
        return math.acos(self.stop)

    def motion(self, time: float, start: float, velocity: float) -> tuple[float, float]:
        """Return position and velocity at ``time`` after leaving the stop at ``start``."""
        decay = self.damping / 2
        frequency = math.sqrt(1 - decay**2)
        a = self.stop - math.sin(start) / self.damping
        b = (velocity - math.cos(start) / self.damping + decay * a) / frequency
        elapsed = time - start
        cosine, sine = math.cos(frequency * elapsed), math.sin(frequency * elapsed)
        shrink = math.exp(-decay * elapsed)
        position = math.sin(time) / self.damping + shrink * (a * cosine + b * sine)
        swing = (frequency * b - decay * a) * cosine - (frequency * a + decay * b) * sine
        return position, math.cos(time) / self.damping + shrink * swing

    def next_impact(self, start: float, velocity: float) -> tuple[float, float]:
        """Return time and velocity of the impact that ends a long flight from the stop."""
        width = 1e-2
        left = start + 10 * width
        while self.motion(left + width, start, velocity)[0] < self.stop:
            left += width
        time = float(
            brentq(
                lambda t: self.motion(t, start, velocity)[0] - self.stop,
                left,
                left + width,
                xtol=4 * ROUNDING,
                rtol=4 * ROUNDING,
            )
        )
        return time, self.motion(time, start, velocity)[1]

    def short_flight(self, start: float, speed: float) -> tuple[float, float]:
        """Return duration and final approach speed of a flight that leaves the stop at ``speed``.

        The power series of ``(stop - x) / time`` has no cancellation, however short the flight.
        """
        derivatives = [self.stop, -speed]
        for n in range(N_TERMS):
            forcing = math.cos(start + n * math.pi / 2)
            derivatives.append(forcing - self.damping * derivatives[-1] - derivatives[-2])
        mean = [-d / math.factorial(n) for n, d in enumerate(derivatives)][1:]
        duration = -mean[0] / mean[1]
        for _ in range(50):
            value = sum(c * duration**n for n, c in enumerate(mean))
            slope = sum(n * c * duration ** (n - 1) for n, c in enumerate(mean) if n)
            change = value / slope
            duration -= change
            if abs(change) <= 2 * ROUNDING * duration:
                break
        approach = -sum((n + 1) * c * duration**n for n, c in enumerate(mean))
        return duration, approach

    def impacts(self) -> Iterator[tuple[float, float]]:
        """Yield time and approach speed of every impact after the release, without end."""
        time, approach = self.next_impact(self.release_time, 0.0)
        while True:
            yield time, approach
            duration, approach = self.short_flight(time, self.restitution * approach)
            time += duration

    def zeno_time(self) -> float:
        """Return when the impacts after the release accumulate [s]."""
        last = -math.inf
        for time, _ in self.impacts():
            if time == last:
                return time
            last = time
        return last


@dataclass(frozen=True, slots=True, kw_only=True)
class FadingBall:
    """A ball on a floor whose weight changes with time, ``x'' = -(g - b t)``.

    Attributes:
        g: Its weight for a unit of mass at time 0.
        b: How fast it fades.
        restitution: ``e``.
    """

    g: float
    b: float
    restitution: float

    def zeno_time(self, speed: float) -> float:
        """Return when the impacts accumulate after a start from the floor; infinity if never."""
        times, time, speed_now = [0.0], 0.0, speed
        while speed_now > END * speed:
            half = (self.g - self.b * time) / 2
            inside = half**2 - 2 * self.b * speed_now / 3
            if half <= 0.0 or inside < 0.0:
                return math.inf
            duration = 2 * speed_now / (half + math.sqrt(inside))
            times.append(duration)
            approach = speed_now - 2 * half * duration + self.b * duration**2 / 2
            time, speed_now = time + duration, -self.restitution * approach
        return math.fsum(times)


@dataclass(frozen=True, slots=True, kw_only=True)
class SlidingBead:
    """A bead that bounces on the outside of the unit disc, gap ``x^2 + y^2 - 1``.

    Attributes:
        g: Its weight along ``-y``, for a unit of mass.
        restitution: ``e``.
    """

    g: float
    restitution: float

    def zeno_point(self, angle: float, turn: Any, speed: float) -> tuple[Any, list[Any]]:
        """Return time and state ``(x, y, dx, dy)`` at which the impacts accumulate.

        Args:
            angle: Of the start on the disc, from its top.
            turn: Velocity along the disc; its type, `float` or `mpf`, is the arithmetic.
            speed: Gap rate at the start, twice the velocity off the disc.
        """
        one = turn * 0 + 1
        x, y = math.sin(angle) * one, math.cos(angle) * one
        size = (x * x + y * y) ** (one / 2)
        x, y = x / size, y / size
        w, time = speed * one, 0 * one
        vx, vy = turn * y + w / 2 * x, -turn * x + w / 2 * y
        while w > END * speed:
            # The gap over the time: w + c2 s + c3 s^2 + c4 s^3, without cancellation.
            c2, c3, c4 = vx * vx + vy * vy - self.g * y, -self.g * vy, self.g**2 / 4
            s = -w / c2
            for _ in range(60):
                value = w + s * (c2 + s * (c3 + s * c4))
                change = value / (c2 + s * (2 * c3 + 3 * s * c4))
                s -= change
                if abs(change) <= 4 * ROUNDING * s:
                    break
            approach = w + s * (2 * c2 + s * (3 * c3 + 4 * s * c4))
            x, y = x + s * vx, y + s * (vy - s * self.g / 2)
            vy -= self.g * s
            impulse = (1 + self.restitution) * approach / 2
            vx, vy = vx - impulse * x, vy - impulse * y
            time, w = time + s, -self.restitution * approach
        return time, [x, y, vx - w / 2 * x, vy - w / 2 * y]


FORCED = StoppedOscillator(damping=1.9, stop=-0.8, restitution=0.5)
"""The Zeno periodic orbit of arXiv:1302.4402, section V-A."""
COCO = StoppedOscillator(damping=0.1, stop=1.0, restitution=0.8)
"""The impact oscillator of Recipes for Continuation, chapter 15."""
