"""Impacts that a program resolves before the Zeno limit, and those that the limit is told by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.model import HybridDynamics
from zeno_orbits.orbits import Cycle
from zeno_orbits.simulation import Impact, TailEstimate, estimate_tail, extrapolate, spread_nodes


@dataclass(frozen=True, slots=True, kw_only=True)
class Closure:
    """Impacts that are resolved before the Zeno limit, and those that determine it.

    Attributes:
        n_impacts: Impacts resolved one by one.
        nodes: Index of each impact that the extrapolation uses, the first impact being 0.
        error: Estimated error of the limit, relative to ``1 + |x|``.
    """

    n_impacts: int
    nodes: tuple[int, ...]
    error: float


def closures_of(cycle: Cycle, dynamics: HybridDynamics, tolerance: float) -> tuple[Closure, ...]:
    """Return the closure of each phase; one impact that does not hold closes without an error.

    Args:
        cycle: One period of a simulation.
        dynamics: The system.
        tolerance: Largest relative error of a Zeno point.
    """
    return tuple(
        Closure(n_impacts=1, nodes=(), error=0.0)
        if phase.zeno is None
        else closure_of(phase.impacts, dynamics, tolerance)
        for phase in cycle.phases
    )


def closure_of(impacts: Sequence[Impact], dynamics: HybridDynamics, tolerance: float) -> Closure:
    """Return the shortest closure whose estimated error is below a tolerance.

    Args:
        impacts: The impacts of a phase.
        dynamics: The system that made them.
        tolerance: Largest estimated error; all impacts are used if none reaches it.
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
