r"""Flights that are lower than the rounding of the gap: a multiplier that is hardly below zero.

With the multiplier :math:`-w`, its rate :math:`-r` and its second derivative :math:`c`, the gap
acceleration of the flight is :math:`(w + r t - c t^2 / 2) / m_n`. So the gap closes again at
:math:`T = 2 (r + \sqrt{r^2 + 3 w c}) / c`. At a release :math:`w` is zero, and the height is of
order :math:`r^4 / c^3`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from zeno_orbits.arrays import Vector
from zeno_orbits.model import HybridDynamics
from zeno_orbits.simulation.event_rules import ROUNDING

_PART = 1e-5
"""Of the problem's own time, over which the rate of the multiplier is differentiated."""


_LOW = 1e-8
"""Largest height, relative to the size of the gap in the problem."""


class SmallHop(NamedTuple):
    """A flight lower than the rounding of the gap.

    Attributes:
        duration: About how long it takes [s], the unit of time of its rescaled flight.
        error: Local error of its scaled gap rate, not below what rounding permits.
        launch: Scaled gap rate at its start, far below this error. At zero, the rounding of the
            acceleration would decide whether the gap opens.
    """

    duration: float
    error: float
    launch: float


def small_hop(dynamics: HybridDynamics, state: Vector, relative: float) -> SmallHop | None:
    """Return the flight from a state on the stop, or ``None`` if it is not as low.

    Args:
        dynamics: The system.
        state: The state, ``(n_x,)``.
        relative: Relative local error of its steps.
    """
    fall = -dynamics.multiplier_rate(state)
    time = _PART * dynamics.own.time
    shift = time * dynamics.locked.rate(state)
    ahead, behind = (dynamics.multiplier_rate(state + sign * shift) for sign in (1.0, -1.0))
    turn = (ahead - behind) / (2 * time)
    lift, inertia = max(dynamics.gap_acceleration(state), 0.0), dynamics.normal_inertia(state)
    if not turn > 0.0:
        return None
    duration = 2.0 * (fall + math.sqrt(fall * fall + 3.0 * (lift * inertia) * turn)) / turn
    if not duration > 0.0:
        return None
    highest = lift + abs(fall) / inertia * duration
    if not highest * duration**2 <= _LOW * dynamics.own.gap:
        return None
    error = max(relative * highest, ROUNDING * dynamics.own.gap_acceleration)
    return SmallHop(duration=duration, error=error, launch=error * math.sqrt(error / highest))
