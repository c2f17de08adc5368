"""Balls on shaken tables in many digits: what is thrown, when it lands, and whether it stays."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from mpmath import mp, mpf

DIGITS = 40
SCAN = 4000
"""Places a turn at which a sign change is looked for; a flight lasts a hundred of them at least."""
END = mpf(10) ** -16
"""Part of the first speed at which an accumulation is at its end; what follows is summed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """A table that moves as a sum of sines of multiples of its frequency.

    Attributes:
        g: Gravity [m/s^2].
        omega: Frequency [rad/s].
        tones: Amplitude of each multiple, from the first [m].
    """

    g: Any
    omega: Any
    tones: tuple[Any, ...]

    @classmethod
    def of(cls, p: Mapping[str, float]) -> Table:
        """Return the table of a problem's parameters."""
        tones = (mpf(p["A"]), *((mpf(p["B"]),) if "B" in p else ()))
        return cls(g=mpf(p["g"]), omega=mpf(p["omega"]), tones=tones)

    @property
    def turn(self) -> Any:
        """Its period [s]."""
        return 2 * mp.pi / self.omega

    def place(self, t: Any) -> Any:
        """Return where it is [m]."""
        return sum(a * mp.sin(n * self.omega * t) for n, a in enumerate(self.tones, start=1))

    def velocity(self, t: Any) -> Any:
        """Return how fast it moves [m/s]."""
        w = self.omega
        return sum(n * w * a * mp.cos(n * w * t) for n, a in enumerate(self.tones, start=1))

    def lifts(self, t: Any) -> Any:
        """Return the acceleration of a ball at rest on it, positive where it is thrown."""
        w = self.omega
        falls = sum((n * w) ** 2 * a * mp.sin(n * w * t) for n, a in enumerate(self.tones, start=1))
        return falls - self.g

    def throw_after(self, t: Any) -> Any:
        """Return when a ball that rests is thrown next."""
        step = self.turn / SCAN
        right = t + step
        while self.lifts(right) <= 0:
            right += step
        return _bisected(lambda at: self.lifts(at) <= 0, right - step, right)

    def landing_speed(self, t: Any, speed: Any, end: Any) -> Any:
        """Return the speed relative to the table with which it lands, positive downwards."""
        return self.velocity(end) - (self.velocity(t) + speed - self.g * (end - t))


def _bisected(is_before: Callable[[Any], bool], left: Any, right: Any) -> Any:
    """Return where something begins that is not yet so on the left and is so on the right."""
    # Times are not told more finely than this.
    narrow = mpf(10) ** (3 - DIGITS) * right
    while right - left > narrow:
        middle = (left + right) / 2
        if is_before(middle):
            left = middle
        else:
            right = middle
    return (left + right) / 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Throw:
    """A throw and the accumulation that ends it, times from the throw.

    Attributes:
        start: When [s].
        times: Of its impacts [s].
        speeds: Of these.
        zeno_time: Where they accumulate [s].
    """

    start: Any
    times: tuple[Any, ...]
    speeds: tuple[Any, ...]
    zeno_time: Any


def throw(table: Table, after: Any, restitution: Any) -> Throw:
    """Return the next throw after a time at which the ball rests."""
    start = table.throw_after(after)
    t, speed, step = start, mpf(0), table.turn / SCAN
    times, speeds = list[Any](), list[Any]()
    while not speeds or speeds[-1] > END * speeds[0]:
        end = _landing(table, t, speed, step)
        times.append(end - start)
        speeds.append(table.landing_speed(t, speed, end))
        t, speed = end, restitution * speeds[-1]
        step = 2 * speed / -table.lifts(t) / 50
    tail = 2 * speed / (-table.lifts(t) * (1 - restitution))
    return Throw(start=start, times=tuple(times), speeds=tuple(speeds), zeno_time=times[-1] + tail)


def _landing(table: Table, t: Any, speed: Any, step: Any) -> Any:
    """Return the landing, not the start: the mean gap rate is positive at first."""
    up, start = table.velocity(t) + speed, table.place(t)

    def mean(end: Any) -> Any:
        s = end - t
        return up - table.g * s / 2 - (table.place(end) - start) / s

    right = t + step
    while mean(right) > 0:
        right += step
    return _bisected(lambda at: bool(mean(at) > 0), t + (right - t) / 1000, right)


@dataclass(frozen=True, slots=True, kw_only=True)
class Fall:
    """A fall on a plastic table.

    Attributes:
        time: When [s].
        speed: Relative to the table.
        thrown: When the ball is thrown next: at once, or when the table lets go [s].
    """

    time: Any
    speed: Any
    thrown: Any

    @property
    def stays(self) -> bool:
        """Whether the table holds it for a while."""
        return bool(self.thrown > self.time)


def plastic_falls(table: Table, count: int) -> list[Fall]:
    """Return the falls of a ball that rests at time 0."""
    falls: list[Fall] = []
    t = table.throw_after(mpf(0))
    for _ in range(count):
        end = _landing(table, t, mpf(0), table.turn / SCAN)
        speed = table.landing_speed(t, mpf(0), end)
        t = end if table.lifts(end) > 0 else table.throw_after(end)
        falls.append(Fall(time=end, speed=speed, thrown=t))
    return falls
