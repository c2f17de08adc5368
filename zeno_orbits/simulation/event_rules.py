"""The rules by which an event decides what follows, on numbers or on rows of many motions alike."""

from __future__ import annotations

from typing import Any

from zeno_orbits.arrays import Vector
from zeno_orbits.simulation.attractor import Flags

_INSIDE = 1e-9
"""Gap rate after an impact below minus this part of the one before: the state enters the stop."""
_MAY_BEND = 0.1
"""Largest relative change of d2h/dt2 over a Zeno tail; beyond it the tail is not geometric yet."""
_ROUNDING = 4 * 2.0**-52
"""Of the largest coordinate: what the gap may be off by."""


def stop_holds(
    gap_acceleration: Vector | float, multiplier_rate: Vector | float, slack: Flags | bool
) -> Any:
    """Return where the stop holds a state at zero gap rate: locked if so, else released at once.

    Args:
        gap_acceleration: d2h/dt2 of the free flow; the stop holds where it is negative.
        multiplier_rate: Rate of the multiplier along the locked flow, which decides where `slack`.
        slack: Where the stop neither holds nor repels, to rounding.
    """
    return (slack & (multiplier_rate > 0.0)) | ((slack ^ True) & (gap_acceleration < 0.0))


def closes_at_once(
    gap_acceleration: float, multiplier_rate: float, normal_inertia: float, largest: float
) -> bool:
    """Return True if the gap opens by less than its rounding before it closes again: no flight.

    With ``a = d2h/dt2 > 0`` that falls at the rate ``b`` it would open to ``2 a^3 / (3 b^2)``.

    Args:
        gap_acceleration: `a`.
        multiplier_rate: Rate of the multiplier along the locked flow.
        normal_inertia: ``1 / (J W J^T)``, multiplier over acceleration of the gap.
        largest: Largest coordinate.
    """
    fall = multiplier_rate / normal_inertia
    lost = _ROUNDING * largest
    return (
        gap_acceleration > 0.0 and fall > 0.0 and 2.0 * gap_acceleration**3 <= 3.0 * lost * fall**2
    )


def enters_stop(rate_after: Any, approach_rate: Any, size: float) -> Any:
    """Return where a reset map sends a state into the stop.

    Args:
        rate_after: Gap rate of the state after the impact.
        approach_rate: The one before it, negative.
        size: Of the problem's gap rates.
    """
    return rate_after < -_INSIDE * (size - approach_rate)


def is_geometric(at_limit: Any, at_impact: Any) -> Any:
    """Return where d2h/dt2 hardly changes over a Zeno tail, so that its impacts are geometric.

    Args:
        at_limit: d2h/dt2 at the Zeno point.
        at_impact: d2h/dt2 at the impact that the tail begins with.
    """
    return abs(at_limit - at_impact) <= _MAY_BEND * abs(at_impact)
