r"""The sizes of a problem's own numbers, against which small numbers are small in any units.

Everything that counts as zero, and every local error, is a part of one of these. With the time
scale :math:`T` of `own_time` and :math:`|q|, |v|, |a|` where the problem starts, a coordinate has
the size :math:`\max(|q|, |v| T, |a| T^2)`, the largest among those of its unit, and the gap that
of its change over such a distance.
Sizes far from 1 are rounded to powers of a thousand, all others to 1: a machine of everyday size
has the size 1 in SI units.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.model.scale import USUAL, OwnScale

_DAMPED = 1e-3
"""An eigenvalue whose imaginary part is less than this part of it does not oscillate."""
_BAND, _WIDE = 3, 5
"""Decades around 1 in which a size is an everyday one; of accelerations and forces more."""
_DECADES = 3
"""Other sizes are rounded to powers of ten with exponents that this divides."""
_PHASES = 4
_FIXED = ("rad", "1")
"""Units of coordinates that have the size 1 whatever the problem."""


def own_time(dynamics: HybridDynamics, state: Vector) -> float:
    r"""Return the slowest time scale of a problem [s]: of its clock or its oscillations.

    It is :math:`2 \pi / |\mu|` with the smallest oscillating eigenvalue :math:`\mu` of the free
    flow, which has those of the clock. Where nothing oscillates it is
    :math:`2 \pi \sqrt{|q| / |\ddot q|}`.

    Args:
        dynamics: The system.
        state: Where to look, ``(n_x,)``.
    """
    n_q = dynamics.n_q
    eigenvalues = np.linalg.eigvals(dynamics.free.jacobian(state))
    turning = np.abs(eigenvalues[np.abs(eigenvalues.imag) > _DAMPED * np.abs(eigenvalues)])
    if turning.size:
        return float(2 * math.pi / np.min(turning))
    size = float(np.max(np.abs(state[:n_q])))
    pull = float(np.max(np.abs(dynamics.free.rate(state)[n_q : 2 * n_q])))
    return 2 * math.pi * math.sqrt(size / pull) if size > 0.0 and pull > 0.0 else 1.0


def own_scale(
    dynamics: HybridDynamics,
    starts: Sequence[Sequence[float]],
    units: Sequence[str],
    clock: Sequence[int] = (),
) -> OwnScale:
    """Return the sizes of a problem's numbers, from where it starts.

    Args:
        dynamics: The system.
        starts: States at which the problem starts, each ``(n_x,)``.
        units: Unit of each state; coordinates of one unit are measured alike.
        clock: Places of the clock in the state; it is looked at in four phases.
    """
    states = np.array(starts, dtype=np.float64)
    if clock:
        turned = [x for x in states for _ in range(_PHASES)]
        states = np.array(turned)
        turns = np.tile(2 * math.pi * np.arange(_PHASES) / _PHASES, len(starts))
        states[:, clock[0]], states[:, clock[1]] = np.cos(turns), np.sin(turns)
    n_q = dynamics.n_q
    try:
        time = own_time(dynamics, states[0]) / (2 * math.pi)
    except np.linalg.LinAlgError:
        return USUAL
    rates = np.array([dynamics.free.rate(x) for x in states])
    velocities, accelerations = rates[:, :n_q], rates[:, n_q : 2 * n_q]
    reach = [np.abs(states[:, :n_q]), np.abs(velocities) * time, np.abs(accelerations) * time**2]
    largest = np.max(np.array(reach), axis=(0, 1))
    for unit in dict.fromkeys(units[:n_q]):
        alike = [k for k in range(n_q) if units[k] == unit]
        largest[alike] = 1.0 if unit in _FIXED else np.max(largest[alike])
    gap = max(_gap_reach(dynamics, x, largest) for x in states)
    inertia = max(abs(dynamics.normal_inertia(x)) for x in states)
    return OwnScale(
        time=_rounded(time),
        gap=_rounded(gap),
        gap_rate=_rounded(gap / time),
        gap_acceleration=_rounded(gap / time**2, _WIDE),
        multiplier=_rounded(gap / time**2 * inertia, _WIDE),
        sizes=tuple(_rounded(size) for size in (*largest.tolist(), *(largest / time).tolist())),
    )


def _gap_reach(dynamics: HybridDynamics, x: Vector, sizes: Vector) -> float:
    """Return how far the gap goes if a coordinate goes as far as it does."""
    gap, moved = dynamics.gap(x), np.tile(x, (len(sizes), 1))
    moved[:, : len(sizes)] += np.diag(sizes)
    return max(abs(gap), *(abs(dynamics.gap(one) - gap) for one in moved))


def _rounded(size: float, band: int = _BAND) -> float:
    """Return 1 for an everyday size, else the nearest power of a thousand; 1 where there is none.

    Args:
        size: The size.
        band: Decades around 1 that are everyday ones.
    """
    if not (math.isfinite(size) and size > 0.0) or abs(math.log10(size)) <= band:
        return 1.0
    return 10.0 ** (_DECADES * round(math.log10(size) / _DECADES))
