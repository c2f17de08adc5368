"""The motion of an orbit: its periods, simulated from the numbers of the orbit alone."""

from __future__ import annotations

import numpy as np

from zeno_orbits.model import HybridDynamics, Problem
from zeno_orbits.orbits import ZenoOrbit, placed
from zeno_orbits.simulation import Execution, simulate

_LONGER = 1e-6
"""Part of the duration to follow a motion longer, so that rounding cuts off no release."""


def motion_of(
    orbit: ZenoOrbit, problem: Problem, dynamics: HybridDynamics, *, periods: int = 1
) -> Execution:
    """Simulate periods of an orbit from its start.

    Args:
        orbit: The orbit.
        problem: Its problem.
        dynamics: The problem at the orbit's numbers.
        periods: Number of periods.

    Raises:
        SimulationError: If the execution cannot be continued: a false orbit may run anywhere.
    """
    start = np.array(problem.state_vector(orbit.start_state))
    shape = orbit.shape.at_restitution(dynamics.restitution)
    # The verifier refuses a start off the section; the simulator must not.
    start = placed(dynamics, shape, start)
    return simulate(dynamics, start, until=periods * orbit.period * (1 + _LONGER))
