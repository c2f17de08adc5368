"""The least value that a function takes inside an arc."""

from __future__ import annotations

import numpy as np

from zeno_orbits.dynamics import Scalar, Vector
from zeno_orbits.execution import Arc

_SAMPLES = 60
_EDGE = 1e-3
"""Part of an arc at its ends that is none of its inside: a flight starts with its rate at zero."""


def least_inside(arc: Arc, value: Scalar, rate: Scalar) -> float | None:
    """Return the least local minimum of a function inside an arc, or ``None`` without any.

    Args:
        arc: An arc with a flow.
        value: The function of the state.
        rate: Its time derivative along the arc.
    """
    from scipy.optimize import brentq

    duration = arc.duration
    if duration <= 0.0:
        return None
    inside = np.linspace(_EDGE * duration, (1 - _EDGE) * duration, _SAMPLES)
    own = arc.flow_times
    inside = np.union1d(inside, own[(own > inside[0]) & (own < inside[-1])])
    n_x = len(arc.start_state)

    def state(t: float) -> Vector:
        return arc.flow_state_at(t)[:n_x]

    rates = [rate(state(float(t))) for t in inside]
    found: list[float] = []
    for k in range(len(inside) - 1):
        if rates[k] < 0.0 <= rates[k + 1]:
            left, right = float(inside[k]), float(inside[k + 1])
            root = float(brentq(lambda t: rate(state(t)), left, right, xtol=1e-14))
            found.append(value(state(root)))
    return min(found) if found else None
