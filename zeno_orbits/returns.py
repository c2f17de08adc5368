"""From one release to the next: the execution that the return map is made of."""

from __future__ import annotations

from zeno_orbits.dynamics import HybridDynamics, Vector
from zeno_orbits.execution import Execution
from zeno_orbits.simulate import SimulationSettings, simulate


def to_next_release(
    dynamics: HybridDynamics, x: Vector, *, horizon: float, settings: SimulationSettings
) -> Execution:
    """Return the execution from a release until the next one, or to the horizon without any.

    Args:
        dynamics: The system.
        x: A release state, on the stop, ``(n_x,)``.
        horizon: Longest time to wait [s].
        settings: Accuracy.

    Raises:
        SimulationError: If the execution cannot be continued so far.
    """
    execution = simulate(dynamics, x, until=horizon, releases=1, settings=settings)
    if execution.releases and not execution.returns(horizon):
        # The start was locked by a rounding error and released at once: the next one is meant.
        execution = simulate(dynamics, x, until=horizon, releases=2, settings=settings)
    return execution
