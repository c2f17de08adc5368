r"""Flights that are lower than the rounding of the gap: a multiplier that is hardly below zero.

With the multiplier :math:`-w`, its rate :math:`-r` and its second derivative :math:`c`, the gap
acceleration of the flight is :math:`(w + r t - c t^2 / 2) / m_n`. So the gap closes again at
:math:`T = 2 (r + \sqrt{r^2 + 3 w c}) / c`. At a release :math:`w` is zero, and the height is of
order :math:`r^4 / c^3`.

After a plastic impact the multiplier may rise instead, :math:`r < 0`, as a current layer decays.
It then turns positive if :math:`c \ge 0`, or by an exponential law if :math:`r^2 > w |c|`. The gap
closes after a time of order :math:`3 w / |r|`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from zeno_orbits.arrays import Vector
from zeno_orbits.model import HybridDynamics
from zeno_orbits.simulation.event_rules import ROUNDING, rounding_of

_PART = 1e-5
"""Of the problem's own time, over which the rate of the multiplier is differentiated."""
_PART_OF_HOP = 1e-2
"""Of the duration of a flight in which the multiplier rises, over which it is at most."""
_TURNS = 1.05
"""Least :math:`r^2 / (w |c|)` of a multiplier that surely turns positive."""
_LOW, _LOW_RISING = 1e-8, 1e-6
"""Largest height, relative to the size of the gap in the problem, also if the multiplier rises."""


class SmallHop(NamedTuple):
    """A flight lower than the rounding of the gap.

    Attributes:
        duration: About how long it takes [s], the unit of time of its rescaled flight.
        error: Local error of its scaled gap rate, not below what rounding permits.
        launch: Scaled gap rate at its start. On the stop it is far below this error: at zero, the
            rounding of the acceleration would decide whether the gap opens.
        height: Scaled gap at its start: above zero if another event meets the flight under way.
    """

    duration: float
    error: float
    launch: float
    height: float = 0.0


def small_hop(dynamics: HybridDynamics, state: Vector, relative: float) -> SmallHop | None:
    """Return the flight from a state on the stop, or ``None`` if it is not as low.

    Args:
        dynamics: The system.
        state: The state, ``(n_x,)``.
        relative: Relative local error of its steps.
    """
    fall, time = -dynamics.multiplier_rate(state), _PART * dynamics.own.time
    inertia = dynamics.normal_inertia(state)
    push = max(dynamics.gap_acceleration(state), 0.0) * inertia
    rises = fall < 0.0 < push
    if rises:
        time = min(time, _PART_OF_HOP * (3.0 * push / -fall))
    shift = time * dynamics.locked.rate(state)
    ahead, behind = (dynamics.multiplier_rate(state + sign * shift) for sign in (1.0, -1.0))
    turn = (ahead - behind) / (2 * time)
    duration = 0.0
    if rises and fall * fall > _TURNS * push * -turn:
        # Without the difference of nearly equal numbers that the other form has.
        duration = 6.0 * push / (math.sqrt(fall * fall + 3.0 * push * max(turn, 0.0)) - fall)
    elif turn > 0.0:
        duration = 2.0 * (fall + math.sqrt(fall * fall + 3.0 * push * turn)) / turn
    if not duration > 0.0:
        return None
    highest = (push + abs(fall) * duration) / inertia
    low = _LOW_RISING if rises else _LOW
    if not highest * duration**2 <= low * dynamics.own.gap:
        return None
    error = max(relative * highest, ROUNDING * dynamics.own.gap_acceleration)
    launch, height = error * math.sqrt(error / highest), 0.0
    rate = dynamics.gap_rate(state)
    if rate > rounding_of(dynamics.gap_rate, state):
        launch = max(launch, rate / duration)
        height = max(dynamics.gap(state), 0.0) / (duration * duration)
    return SmallHop(duration=duration, error=error, launch=launch, height=height)
