"""States that an execution may start from."""

from __future__ import annotations

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.model import HybridDynamics, constraint_sizes

_OFF = 1e-9
"""Part of a constraint's size by which an admissible state may miss it."""


def require_admissible(dynamics: HybridDynamics, x: Vector, small_gap: float) -> float:
    """Return the gap of a state, and reject a state that is not admissible.

    Args:
        dynamics: The system.
        x: The state.
        small_gap: A gap of this size counts as zero.

    Raises:
        InputError: If the state is not admissible. The message contains the reason.
    """
    names = dynamics.state_names
    if x.shape != (len(names),):
        message = f"Argument `state` must have {len(names)} entries, but its shape is {x.shape}."
        raise InputError(message)
    if not np.all(np.isfinite(x)):
        raise InputError("Argument `state` must be finite, but it holds NaN or infinity.")
    _require_constraints(dynamics, x)
    gap = dynamics.gap(x)
    if gap < -small_gap:
        raise InputError(f"Argument `state` must have a gap >= 0, but it is {gap:.6g}.")
    return gap


def _require_constraints(dynamics: HybridDynamics, x: Vector) -> None:
    """Reject a state off its constraints, relative to the effect of the problem's scales on them.

    Raises:
        InputError: If the state violates its constraints. The message contains the deviation.
    """
    off = np.abs(dynamics.holonomic(x))
    if dynamics.own.least == 1.0 and not np.any(off > _OFF):
        return
    if not np.any(off > _OFF * constraint_sizes(dynamics, x)):
        return
    if dynamics.clock and off[-1] > _OFF:
        names = " and ".join(f"`{dynamics.state_names[k]}`" for k in dynamics.clock)
        seen = " and ".join(f"{x[k]:g}" for k in dynamics.clock)
        message = f"must have {names} on the unit circle, as a clock, but they are {seen}"
        first = dynamics.state_names[dynamics.clock[0]]
        raise InputError(f"Argument `state` {message}. A turn starts with {first}=1.")
    message = "Argument `state` must keep the holonomic constraints, but it is off by"
    raise InputError(f"{message} {float(np.max(off)):.3g}.")
