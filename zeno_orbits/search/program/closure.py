"""Impacts that a program resolves before the Zeno limit, and impacts that determine the limit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.model import HybridDynamics
from zeno_orbits.simulation import Impact, TailEstimate, estimate_tail, extrapolate, spread_nodes


@dataclass(frozen=True, slots=True, kw_only=True)
class Closure:
    """Impacts that are resolved before the Zeno limit, and impacts that determine the limit.

    Attributes:
        n_impacts: Number of resolved impacts.
        nodes: Index of each impact in the extrapolation. The first impact has index 0.
        error: Estimated error of the limit, relative to ``1 + |x|``.
    """

    n_impacts: int
    nodes: tuple[int, ...]
    error: float


def closure_of(impacts: Sequence[Impact], dynamics: HybridDynamics, tolerance: float) -> Closure:
    """Return the shortest closure whose estimated error is below a tolerance.

    Args:
        impacts: The impacts of a phase.
        dynamics: The system of the impacts.
        tolerance: Largest estimated error. If it is never reached, all impacts are used.
    """
    estimates: list[TailEstimate] = []
    first, best = 0, Closure(n_impacts=1, nodes=(0,), error=np.inf)
    for index, impact in enumerate(impacts):
        speed = dynamics.speed_after(impact.approach_rate)
        estimate = estimate_tail(dynamics, impact.time, impact.state_plus, speed)
        if estimate is None or (estimates and speed >= estimates[-1].speed):
            estimates = []
        if estimate is None:
            continue
        first = index if not estimates else first
        estimates.append(estimate)
        limit = extrapolate(dynamics, estimates)
        nodes = spread_nodes([one.speed for one in estimates])
        used = tuple(first + node for node in nodes)
        best = Closure(n_impacts=index + 1, nodes=used, error=limit.error)
        if limit.error <= tolerance:
            break
    return best
