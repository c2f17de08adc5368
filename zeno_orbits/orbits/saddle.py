r"""The saddle at which a motion stalls: its period grows as the logarithm of a distance.

Near a homoclinic orbit the motion passes a saddle with the slowest rates :math:`\lambda_u > 0` and
:math:`-\lambda_s < 0`. With :math:`\lambda = \min(\lambda_u, \lambda_s)` the period at a distance
:math:`\delta` of the parameter is

.. math:: T = -\frac{\ln \delta}{\lambda} + O(1), \qquad \delta \sim e^{-\lambda T}

Source: [Kuznetsov2004]_, chapter 6.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import FlowWithEvent
from zeno_orbits.simulation import Arc

_MOST_ITERATIONS, _EXACT = 20, 1e-12
"""Newton iterations to a rest point, and a correction that is rounding, in sizes of states."""
_NEAR = 1.0
"""Largest distance of a rest point from the slowest state of a motion, in sizes of states."""
_SLOW = 1e-6
"""Part of the fastest rate below which a rate is zero, as along a constraint."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Saddle:
    """A rest point with directions that approach and leave it.

    Attributes:
        state: The rest point, ``(n_x,)``.
        rate: The slower of the slowest rates of approach and departure [1/s].
    """

    state: Vector
    rate: float


def nearest_saddle(
    arcs: Sequence[Arc], flow_of: Callable[[Arc], FlowWithEvent], sizes: Vector
) -> Saddle | None:
    """Return the saddle near the slowest state of a motion, or ``None``.

    Args:
        arcs: The arcs of the motion.
        flow_of: From an arc to the flow of its mode.
        sizes: Size of each state, ``(n_x,)``.
    """
    n_x, slowest = sizes.size, np.inf
    found: tuple[FlowWithEvent, Vector] | None = None
    for arc in arcs:
        if arc.trajectory is None:
            continue
        flow, states = flow_of(arc), arc.flow_states[:, :n_x]
        speeds = np.max(np.abs(flow.rates(states)) / sizes, axis=1)
        k = int(np.argmin(speeds))
        if speeds[k] < slowest:
            slowest, found = float(speeds[k]), (flow, states[k])
    if found is None:
        return None
    flow, start = found
    x = start
    for _ in range(_MOST_ITERATIONS):
        jacobian = flow.jacobian(x) * sizes[None, :]
        change = np.linalg.lstsq(jacobian, -flow.rate(x), rcond=_SLOW)[0]
        x = x + sizes * change
        if not np.max(np.abs(x - start) / sizes) < _NEAR:
            return None
        if np.max(np.abs(change)) < _EXACT:
            return _saddle(flow, x)
    return None


def _saddle(flow: FlowWithEvent, x: Vector) -> Saddle | None:
    rates = np.linalg.eigvals(flow.jacobian(x)).real
    zero = _SLOW * float(np.max(np.abs(rates)))
    leaving, approaching = rates[rates > zero], -rates[rates < -zero]
    if not (leaving.size and approaching.size):
        return None
    return Saddle(state=x, rate=float(min(np.min(leaving), np.min(approaching))))
