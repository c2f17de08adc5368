r"""What a ball on a shaken table settles to, by exact flights: parabolas and the roots of sines.

In units of the table, with the phase :math:`\phi = \omega t`, lengths in :math:`g / \omega^2` and
:math:`\Gamma = A \omega^2 / g`, a ball that leaves the table at the phase :math:`\phi` with the
relative speed :math:`w` has the gap, after :math:`s`,

.. math:: h(s) = s\,m(s),\qquad m(s) = w - \frac{s}{2} + 2 \Gamma \sin(\phi + s/4) \sin(s/4)
    + \Gamma \cos(\phi + s/2) \left(1 - \frac{\sin(s/2)}{s/2}\right)

This sum of small terms does not cancel however short the flight. A ball at rest is thrown where
:math:`\sin\phi = 1/\Gamma`, always in the same state: once it comes to rest a second time, its
motion repeats for ever. Nothing here knows the package.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

TURN = 2 * math.pi
_AT_REST = 1e-11
"""Relative speed below which impacts on a table that presses are taken to their limit."""
_SAME, _CLOSE, _LOOK = 1e-9, 1e-3, 40
"""Impacts that differ by less are the same, or nearly; periods that have to tell it.

After 10 000 radians, rounding leaves some 1e-10 of a motion that repeats."""
_ARRIVED = 1e-8
"""Change over a period of a motion that repeats; one that changes more is still on its way."""
_SLOW = 1e-6
"""Slower impacts belong to a sequence that ends at rest, or at a throw."""
_LONGEST = 64
"""Turns of a period beyond which none is looked for."""
_CHANGES = (1e-11, -1e-11)
"""Relative changes of the acceleration that a clear motion does not feel."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """What the motion of a ball from rest settles to.

    Attributes:
        turns: Turns after which it repeats; 0 if it has not repeated.
        rests: Whether the ball comes to rest on the table in every period.
        arrived: Whether it repeats already, or only comes ever nearer to it.
    """

    turns: int
    rests: bool
    arrived: bool = True


def clearly_settled(acceleration: float, restitution: float, most_turns: int) -> Truth | None:
    """Return what `settled` does, if motions right beside this one settle to the same.

    Args:
        acceleration: As for `settled`.
        restitution: As for `settled`.
        most_turns: As for `settled`.
    """
    found = settled(acceleration, restitution, most_turns)
    beside = [settled((1 + part) * acceleration, restitution, most_turns) for part in _CHANGES]
    return found if all(one == found for one in beside) else None


def settled(acceleration: float, restitution: float, most_turns: int) -> Truth:
    """Return what the ball does that rests at the phase 0.

    Args:
        acceleration: :math:`\\Gamma`, above 1.
        restitution: :math:`e`.
        most_turns: When to give up.
    """
    thrown = math.asin(1 / acceleration)
    phase, speed = thrown, 0.0
    seen: list[tuple[float, float]] = []
    while phase < most_turns * TURN:
        flight = flight_time(acceleration, phase, speed)
        phase += flight
        landing = _landing_speed(acceleration, phase, flight, speed)
        speed = restitution * landing
        presses = 1.0 - acceleration * math.sin(phase)
        if presses > 0.0 and speed <= _AT_REST:
            tail = 2 * speed / (presses * (1 - restitution))
            return Truth(turns=math.ceil((phase + tail - thrown) / TURN), rests=True)
        if landing > _SLOW:
            seen.append((phase, speed))
    turns, change = _repeats(seen)
    return Truth(turns=turns, rests=False, arrived=change <= _ARRIVED)


def _landing_speed(acceleration: float, end: float, flight: float, speed: float) -> float:
    """Return the relative speed downwards, from the one with which the ball left."""
    begin = end - flight
    # cos(end) - cos(begin) as a product: it does not cancel.
    turned = -2 * math.sin(begin + flight / 2) * math.sin(flight / 2)
    return flight - speed + acceleration * turned


def flight_time(acceleration: float, phase: float, speed: float) -> float:
    """Return how long a flight lasts, in phase.

    No root of the mean gap rate is passed over: a step is no longer than its slope allows.
    """

    def mean(s: float) -> float:
        part = 1.0 - math.sin(s / 2) / (s / 2) if s > 1e-3 else (s / 2) ** 2 / 6
        bends = 2 * math.sin(phase + s / 4) * math.sin(s / 4) + math.cos(phase + s / 2) * part
        return speed - s / 2 + acceleration * bends

    steepest = 0.5 + acceleration
    s = speed / steepest if speed > 0.0 else _first_rise(mean)
    for _ in range(100_000):
        step = mean(s) / steepest
        if step <= 1e-15 * s:
            return s
        s += step
        slope = (mean(s * (1 + 1e-7)) - mean(s)) / (1e-7 * s)
        if mean(s) < 1e-6 * s and slope < -1e-3:
            # One root is left of where the mean falls so steeply: Newton's method ends it.
            for _ in range(6):
                s -= mean(s) / ((mean(s * (1 + 1e-7)) - mean(s)) / (1e-7 * s))
            return s
    return s


def _first_rise(mean: Callable[[float], float]) -> float:
    """Return a time soon after a throw from rest, at which the ball has left the table."""
    s = 1e-3
    while s < 1.0 and not mean(s) > 0.0:
        s *= 2
    return s


def _repeats(seen: list[tuple[float, float]]) -> tuple[int, float]:
    """Return after how many turns impacts repeat, or come ever nearer to it, and the last change.

    There are 0 turns if they do not. Changes have to be small along some forty periods, and shrink.
    """
    phases, speeds = zip(*seen, strict=True)
    for m in range(1, len(seen) // (_LOOK + 1)):
        turns = round((phases[-1] - phases[-1 - m]) / TURN)
        if turns > _LONGEST:
            break
        changes = [
            max(
                abs(phases[-1 - j] - phases[-1 - j - m] - turns * TURN),
                abs(speeds[-1 - j] - speeds[-1 - j - m]),
            )
            for j in range(0, _LOOK * m, m)
        ]
        if turns > 0 and max(changes) < _CLOSE and changes[0] <= max(changes[-1], _SAME):
            return turns, changes[0]
    return 0, math.inf
