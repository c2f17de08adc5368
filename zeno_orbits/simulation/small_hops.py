r"""Flights that are lower than the rounding of the gap: a multiplier that only just reaches zero.

If the multiplier falls through zero at the rate :math:`-r` and turns with the second derivative
:math:`c`, the gap acceleration of the flight is :math:`(r t - c t^2 / 2) / m_n`. So the gap closes
again at :math:`T = 4 r / c`, from a height of order :math:`r^4 / c^3`.
"""

from __future__ import annotations

from zeno_orbits.arrays import Vector
from zeno_orbits.model import HybridDynamics

_PART = 1e-5
"""Of the problem's own time, over which the rate of the multiplier is differentiated."""


def hop_duration(dynamics: HybridDynamics, state: Vector) -> float | None:
    """Return about how long the flight from a release takes, if the multiplier turns round [s].

    Args:
        dynamics: The system.
        state: The release, ``(n_x,)``.
    """
    fall = -dynamics.multiplier_rate(state)
    shift = _PART * dynamics.own.time * dynamics.locked.rate(state)
    ahead, behind = (dynamics.multiplier_rate(state + sign * shift) for sign in (1.0, -1.0))
    turn = (ahead - behind) / (2 * _PART * dynamics.own.time)
    return 4.0 * fall / turn if fall > 0.0 and turn > 0.0 else None
