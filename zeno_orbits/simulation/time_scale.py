"""The time scale of a problem, in which waiting is counted whatever the units."""

from __future__ import annotations

import math

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model import HybridDynamics

_DAMPED = 1e-3
"""An eigenvalue whose imaginary part is less than this part of it does not oscillate."""


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
