r"""What an oscillator that strikes a stop settles to, by exact flights: sums of exponentials.

The gap obeys :math:`\ddot q = -c \dot q - k q + k s - A \cos \omega t`, with mass 1, and
:math:`q \ge 0`. A flight is :math:`q = q_p(t) + e^{-ct/2} (a \cos \nu t + b \sin \nu t)`, its end
a root found by bisection. Where a slow impact meets a force that presses, the mass is held until
:math:`k s = A \cos \omega t`. The tangent of a flight is a matrix exponential, that of an impact
its saltation matrix; their product gives the largest Lyapunov exponent. Nothing here knows the
package.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

TURN = 2 * math.pi
State = Callable[[float], tuple[float, float]]
_SLOW = 1e-9
"""Speed after an impact below which a mass that is pressed is held."""
_SOON = 3e-4
"""Time after a release from which on a flight is followed; its start has an error of 1e-16."""
_LOOKS = 64
"""Looks at a flight in the shorter of its two periods."""
_SAME = 1e-9
"""Impacts that differ by less are the same."""
_FELT = 1e-6
"""Speed of the slowest impacts that count in a period."""
_TURNS_ALIKE = 100
"""Turns in which all impacts have to repeat."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Oscillator:
    """An oscillator of mass 1.

    Attributes:
        c: Damping.
        stop: Where the relaxed spring would be, from the stop.
        restitution: Of the stop.
        omega: Frequency of the force.
        amplitude: Of the force.
        k: Stiffness.
    """

    c: float
    stop: float
    restitution: float
    omega: float
    amplitude: float
    k: float = 1.0

    @property
    def own(self) -> float:
        """Its frequency when damped."""
        return math.sqrt(self.k - self.c**2 / 4)

    @property
    def response(self) -> complex:
        """Complex amplitude of its forced vibration."""
        return -self.amplitude / complex(self.k - self.omega**2, self.c * self.omega)

    def pull(self, t: float) -> float:
        """Return the acceleration on the stop, at rest."""
        return self.k * self.stop - self.amplitude * math.cos(self.omega * t)


@dataclass(slots=True)
class Flights:
    """Events of a motion.

    Attributes:
        impacts: Time, speed before, and whether the mass is held after it.
        growth: Sum of the logarithms by which a tangent vector grew.
        marks: Time and growth at every impact.
        last: State and time at the end.
    """

    impacts: list[tuple[float, float, bool]] = field(default_factory=list[Any])
    growth: float = 0.0
    marks: list[tuple[float, float]] = field(default_factory=list[Any])
    last: tuple[float, float, float] = (0.0, 0.0, 0.0)


def _state_of(o: Oscillator, t: float, q: float, v: float) -> State:
    """Return gap and speed of the flight from a state, by the time since then."""
    mu = complex(-o.c / 2, o.own)
    forced = o.response * cmath.exp(1j * o.omega * t)
    dq, dv = q - o.stop - forced.real, v - (1j * o.omega * forced).real
    free = complex(dq, -(dv + o.c / 2 * dq) / o.own)

    def state(s: float) -> tuple[float, float]:
        own, outer = free * cmath.exp(mu * s), forced * cmath.exp(1j * o.omega * s)
        return (own + outer).real + o.stop, (mu * own + 1j * o.omega * outer).real

    return state


def flights(o: Oscillator, q: float, v: float, until: float) -> Flights:
    """Return the impacts of a motion from ``q, v`` at time 0, up to a time."""
    seen, t, tangent = Flights(), 0.0, np.array([0.6, 0.8])
    step = TURN / max(o.omega, o.own) / _LOOKS
    while t < until:
        state = _state_of(o, t, q, v)

        end = _landing(state, step, until - t, v if q <= 0.0 else math.inf, o.pull(t))
        if end is None:
            q, v = state(until - t)
            t = until
            break
        _, speed = state(end)
        phi = _transition(o, end)
        t += end
        before, after = o.pull(t) - o.c * speed, o.pull(t) + o.c * o.restitution * speed
        e = o.restitution
        if speed < 0.0:
            jump = np.array([[-e, 0.0], [(after + e * before) / speed, -e]])
            tangent = jump @ phi @ tangent
        q, v = 0.0, -e * speed
        held = v < _SLOW and o.pull(t) < 0.0
        seen.impacts.append((t, -speed, held))
        size = float(np.linalg.norm(tangent))
        seen.growth += math.log(size) if size > 0.0 else -math.inf
        tangent = tangent / size if size > 0.0 else np.array([0.6, 0.8])
        seen.marks.append((t, seen.growth))
        if held:
            t = _release(o, t)
            if not math.isfinite(t):
                break
            # Rounding hides the first moments of a flight that begins with its third derivative.
            jerk = o.amplitude * o.omega * math.sin(o.omega * t)
            t, q, v = t + _SOON, jerk * _SOON**3 / 6, jerk * _SOON**2 / 2
    seen.last = (q, v, t)
    return seen


def _transition(o: Oscillator, s: float) -> np.ndarray:
    """Return the derivative of the state after a flight by that before it."""
    decay, angle = math.exp(-o.c * s / 2), o.own * s
    cosine, sine, half = math.cos(angle), math.sin(angle), o.c / 2
    return decay * np.array(
        [
            [cosine + half / o.own * sine, sine / o.own],
            [-o.k / o.own * sine, cosine - half / o.own * sine],
        ]
    )


def _landing(state: State, step: float, longest: float, speed: float, pull: float) -> float | None:
    """Return when the gap first closes, after the start."""
    # A slow flight under a pull lasts about 2 v / |a|: looks have to be finer than that.
    fine = step
    if speed < math.inf and pull < 0.0:
        fine = min(step, max(speed, 1e-300) / -pull / 4)
    s, rate, first = 0.0, math.inf, True
    while s < longest:
        size = fine if s < 16 * fine else step
        to = min(s + size, longest)
        q, v = state(to)
        if q < 0.0:
            low = s if not first else to * 1e-3
            return _bisected(state, low, to)
        if rate < 0.0 < v:
            lowest = _turning(state, s, to)
            if state(lowest)[0] < 0.0:
                return _bisected(state, s, lowest)
        s, rate, first = to, v, False
    return None


def _bisected(state: State, low: float, high: float) -> float:
    for _ in range(200):
        middle = (low + high) / 2
        if middle in (low, high):
            break
        if state(middle)[0] > 0.0:
            low = middle
        else:
            high = middle
    return high


def _turning(state: State, low: float, high: float) -> float:
    for _ in range(60):
        middle = (low + high) / 2
        if state(middle)[1] < 0.0:
            low = middle
        else:
            high = middle
    return (low + high) / 2


def _release(o: Oscillator, t: float) -> float:
    """Return when the force lets a held mass go."""
    part = o.k * o.stop / o.amplitude
    if not -1.0 < part < 1.0:
        return math.inf
    # It presses where cos > part, up to the phase arccos(part).
    turns = (o.omega * t - math.acos(part)) / TURN
    return (math.acos(part) + TURN * math.ceil(turns)) / o.omega


def repeats(o: Oscillator, seen: Flights) -> tuple[int, int, bool] | None:
    """Return impacts and turns of the period after which impacts repeat, and if one holds.

    Rounding of the time decides about the last, slowest impacts of a sequence: they do not count.
    """
    felt = [(t, speed) for t, speed, _ in seen.impacts if speed > _FELT]
    times = np.array([t for t, _ in felt])
    rows = np.column_stack(
        [
            [speed for _, speed in felt],
            np.cos(o.omega * times),
            np.sin(o.omega * times),
        ]
    )
    since = np.searchsorted(times, times[-1] - _TURNS_ALIKE * TURN / o.omega)
    near = np.flatnonzero(np.max(np.abs(rows[since:-1] - rows[-1]), axis=1) < _SAME)
    for n in (len(rows) - 1 - since - near[::-1]).tolist():
        if 2 * n < len(rows) - since and np.max(np.abs(rows[since + n :] - rows[since:-n])) < _SAME:
            turns = round((times[-1] - times[-1 - n]) * o.omega / TURN)
            return n, turns, any(held for t, _, held in seen.impacts if t > times[-1 - n])
    return None
