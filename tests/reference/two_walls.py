r"""A forced mass on a spring between two walls, by exact flights: what its motion settles to.

``x'' + c x' + x = A cos(w t)``, ``-lower <= x <= upper``. A flight is the sum of the forced motion
and of a free one, both in closed form. Impacts are found by steps that no second one hides in, and
by bisection. Slow impacts on a wall that the force presses on are taken to their limit. The mass
leaves the wall where the force turns. Nothing here knows the package.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count

TURN = 2 * math.pi
_SLOW = 1e-7
"""Speed after an impact from which the rest of a sequence is geometric."""
_SAME = 1e-7
"""Difference of states that repeat."""
_LEAVES = 1e-4
"""Time in which a released mass does not come back to its wall."""
_LONGEST = 48
"""Turns of a period beyond which none is looked for."""


@dataclass(frozen=True, kw_only=True)
class TwoWalls:
    """The machine.

    Attributes:
        c: Damping, below 2.
        force: Amplitude of the force.
        omega: Its frequency.
        walls: Upper and lower end of the way of the mass.
        restitutions: Restitution of each, at speed zero.
        falls: Fall of each with the impact speed.
    """

    c: float
    force: float
    omega: float
    walls: tuple[float, float]
    restitutions: tuple[float, float]
    falls: tuple[float, float] = (0.0, 0.0)

    def flown(self, t: float, x: float, v: float, s: float) -> tuple[float, float]:
        """Return the state after a flight of `s` from a state at `t`."""
        (x0, v0), (x1, v1) = self._forced(t), self._forced(t + s)
        half, own = self.c / 2, math.sqrt(1 - self.c**2 / 4)
        y, u = x - x0, v - v0
        a, b = y, (u + half * y) / own
        cosine, sine, decay = math.cos(own * s), math.sin(own * s), math.exp(-half * s)
        place = decay * (a * cosine + b * sine)
        rate = decay * (own * (b * cosine - a * sine)) - half * place
        return x1 + place, v1 + rate

    def pull(self, t: float, x: float) -> float:
        """Return the acceleration of a mass at rest."""
        return self.force * math.cos(self.omega * t) - x

    def _forced(self, t: float) -> tuple[float, float]:
        w = self.omega
        size = self.force / ((1 - w**2) ** 2 + (self.c * w) ** 2)
        even, odd = size * (1 - w**2), size * self.c * w
        return (
            even * math.cos(w * t) + odd * math.sin(w * t),
            w * (odd * math.cos(w * t) - even * math.sin(w * t)),
        )


@dataclass(frozen=True, kw_only=True)
class Truth:
    """What a motion settles to.

    Attributes:
        turns: Turns after which it repeats; 0 if it does not.
        strikes: Whether it strikes a wall in every period.
        holds: Whether it comes to rest on a wall in every period.
    """

    turns: int
    strikes: bool
    holds: bool


def settled(machine: TwoWalls, x: float, v: float, turns: int) -> Truth:
    """Return what the motion from a state at time 0 settles to.

    Args:
        machine: The machine.
        x: Place.
        v: Speed.
        turns: Turns of the force that are followed.
    """
    turn = TURN / machine.omega
    marks: list[tuple[float, float]] = []
    struck: list[float] = []
    held: list[float] = []
    for t, kind, state in _motion(machine, x, v):
        if t > turns * turn:
            break
        if kind == "mark":
            marks.append(state)
        (struck if kind == "impact" else held if kind == "hold" else []).append(t)
    late = marks[-3 * _LONGEST :]
    period = 0
    for n in range(1, _LONGEST + 1):
        pairs = zip(late[n:], late[:-n], strict=True)
        if max(max(abs(a - b) for a, b in zip(*pair, strict=True)) for pair in pairs) < _SAME:
            period = n
            break
    since = (turns - max(period, 1) - 0.5) * turn
    return Truth(
        turns=period,
        strikes=any(t > since for t in struck),
        holds=any(t > since for t in held),
    )


def _motion(
    machine: TwoWalls, x: float, v: float
) -> Iterator[tuple[float, str, tuple[float, float]]]:
    """Yield the impacts, the holds, and the states at turns of the force."""
    turn = TURN / machine.omega
    marks = (k * turn for k in count(1))
    t, mark, step = 0.0, next(marks), min(0.05, turn / 60)
    while True:
        wall, s, end = _flight(machine, t, x, v, mark - t, step)
        t, (x, v) = t + s, end
        if wall is None:
            yield t, "mark", (x, v)
            mark = next(marks)
            continue
        e, side = machine.restitutions[wall], 1.0 if wall == 0 else -1.0
        x, v = side * machine.walls[wall], -(e - machine.falls[wall] * abs(v)) * v
        yield t, "impact", (x, v)
        press = side * machine.pull(t, x)
        if press > 0.0 and abs(v) < _SLOW * press:
            t += 2 * abs(v) / press / (1 - e)
            yield t, "hold", (x, 0.0)
            leaves = _released(machine, t, x, side)
            while mark < leaves:
                yield mark, "mark", (x, 0.0)
                mark = next(marks)
            t, v = leaves, 0.0


def _released(machine: TwoWalls, t: float, x: float, side: float) -> float:
    """Return when the force no longer presses on a wall."""
    ratio = x / machine.force
    if abs(ratio) >= 1.0:
        return math.inf
    phase = math.acos(ratio)
    wanted = phase if side > 0.0 else TURN - phase
    now = machine.omega * t
    ahead = (wanted - now) % TURN
    return t + ahead / machine.omega


def _flight(
    machine: TwoWalls, t: float, x: float, v: float, longest: float, step: float
) -> tuple[int | None, float, tuple[float, float]]:
    """Return the wall that a flight ends at, if any, its time and the state there."""
    upper, lower = machine.walls
    # A mass that is released is off its wall by rounding only, until this time.
    s = _LEAVES if v == 0.0 else 0.0
    # A start on a wall leaves it first.
    first = min(step, abs(v) / (abs(machine.pull(t, x)) + 1.0) / 4)
    size = first if v != 0.0 and x in (upper, -lower) else step / 10
    while s < longest:
        before, s = s, min(s + size, longest)
        size = min(1.3 * size, step)
        place, _ = machine.flown(t, x, v, s)
        if -lower <= place <= upper:
            continue
        wall = 0 if place > upper else 1
        low, high = before, s
        for _ in range(60):
            middle = (low + high) / 2
            place, _ = machine.flown(t, x, v, middle)
            inside = place <= upper if wall == 0 else place >= -lower
            low, high = (middle, high) if inside else (low, middle)
        return wall, low, machine.flown(t, x, v, low)
    return None, longest, machine.flown(t, x, v, longest)
