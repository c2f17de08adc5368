"""From one release to the next: the execution that the return map is made of."""

from __future__ import annotations

from zeno_orbits.dynamics import HybridDynamics, Vector
from zeno_orbits.execution import Execution, Mode, Release
from zeno_orbits.simulate import SimulationSettings, simulate


def to_next_release(
    dynamics: HybridDynamics, x: Vector, *, horizon: float, settings: SimulationSettings
) -> Execution:
    """Return the execution from a release until the next one, or to the horizon without any.

    A start that is locked a little, by rounding or as it belongs to other parameters, is released
    first and flies then: that release is not the next one.

    Args:
        dynamics: The system.
        x: A release state, on the stop, ``(n_x,)``.
        horizon: Longest time to wait [s].
        settings: Accuracy.

    Raises:
        SimulationError: If the execution cannot be continued so far.
    """
    execution = simulate(dynamics, x, until=horizon, releases=1, settings=settings)
    if execution.releases and first_return(execution) is None:
        execution = simulate(dynamics, x, until=horizon, releases=2, settings=settings)
    return execution


def first_return(execution: Execution) -> Release | None:
    """Return the first release that comes after a flight, if there is one."""
    flight = next((arc for arc in execution.arcs if arc.mode is Mode.FREE), None)
    if flight is None:
        return None
    return next((r for r in execution.releases if r.time > flight.start_time), None)
