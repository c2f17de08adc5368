"""Rules for the mode after an event, for single values or for rows of many motions."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from zeno_orbits.arrays import Vector
from zeno_orbits.simulation.attractor import Flags

_INSIDE = 1e-9
"""Negative gap rate after an impact relative to the rate before it, beyond which the state enters
the stop."""
_MAY_BEND = 0.1
"""Largest relative change of d2h/dt2 over a Zeno tail. Beyond it the tail is not yet geometric."""
ROUNDING = 4 * 2.0**-52
"""Rounding error of the gap relative to the largest coordinate, and of the gap acceleration
relative to its size in the problem."""
LATE = 4.0
"""Spacings of the numbers at the end of the time, within which no event before it counts."""


def rounding_of(formula: Callable[[Vector], float], x: Vector) -> float:
    """Return the rounding of a formula by the rounding of its states.

    Args:
        formula: The formula of the state.
        x: The state, ``(n_x,)``.
    """
    value, total = formula(x), 0.0
    for k in range(x.size):
        moved = x.copy()
        moved[k] += ROUNDING * x[k]
        total += abs(formula(moved) - value)
    return total


def late_before(until: float, apart: float = 0.0) -> float:
    """Return the time before the end in which no event counts [s].

    An arc from there would be shorter than the rounding of times.

    Args:
        until: The end [s].
        apart: Time by which two events differ at least [s].
    """
    return max(LATE * math.ulp(until), apart)


def stop_holds(
    gap_acceleration: Vector | float, multiplier_rate: Vector | float, slack: Flags | bool
) -> Any:
    """Test whether contact persists at zero gap rate: locked if True, else released at once.

    Args:
        gap_acceleration: d2h/dt2 of the free flow. Contact persists if it is negative.
        multiplier_rate: Rate of the contact force along the constrained flow, used if `slack`.
        slack: Whether the contact force is zero up to rounding.
    """
    return (slack & (multiplier_rate > 0.0)) | ((slack ^ True) & (gap_acceleration < 0.0))


def closes_at_once(
    gap_acceleration: float, multiplier_rate: float, normal_inertia: float, largest: float
) -> bool:
    """Return True if the gap opens by less than its rounding before it closes again: no flight.

    With ``a = d2h/dt2 > 0`` that falls at the rate ``b`` it would open to ``2 a^3 / (3 b^2)``.

    Args:
        gap_acceleration: `a`.
        multiplier_rate: Rate of the multiplier along the constrained flow.
        normal_inertia: ``1 / (J W J^T)``, multiplier over acceleration of the gap.
        largest: Largest coordinate.
    """
    fall = multiplier_rate / normal_inertia
    lost = ROUNDING * largest
    return (
        gap_acceleration > 0.0 and fall > 0.0 and 2.0 * gap_acceleration**3 <= 3.0 * lost * fall**2
    )


def enters_stop(rate_after: Any, approach_rate: Any, size: float) -> Any:
    """Return the mask of states that a reset map sends into the stop.

    Args:
        rate_after: Gap rate of the state after the impact.
        approach_rate: Gap rate before the impact, negative.
        size: Scale of the problem's gap rates.
    """
    return rate_after < -_INSIDE * (size - approach_rate)


def is_geometric(at_limit: Any, at_impact: Any) -> Any:
    """Test whether d2h/dt2 is nearly constant over a Zeno tail, so that it is geometric.

    Args:
        at_limit: d2h/dt2 at the Zeno point.
        at_impact: d2h/dt2 at the first impact of the tail.
    """
    return abs(at_limit - at_impact) <= _MAY_BEND * abs(at_impact)
