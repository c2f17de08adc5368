"""The compiled loop and the reference in Python, which agree in every bit for explicit steps."""

from __future__ import annotations

import numpy as np

import zeno_orbits as zo
from tests.loop.agreement import followed, looped
from zeno_orbits.integrators import RungeKutta
from zeno_orbits.simulation import Execution, SimulationSettings, SimulationTask


def agreed(
    problem: zo.Problem, until: float, settings: SimulationSettings | None = None
) -> Execution:
    """Require that loop and reference agree in every bit and step, and return the execution.

    Args:
        problem: The problem, from its first start.
        until: End time [s].
        settings: The default has explicit steps.
    """
    return same_bits(
        SimulationTask(
            dynamics=problem.graph_dynamics(problem.values()),
            state=np.array(problem.state_vector(problem.starts[0])),
            until=until,
            settings=settings or SimulationSettings(engine=RungeKutta()),
        )
    )


def same_bits(task: SimulationTask) -> Execution:
    """Require that loop and reference agree in every bit and step, and return the execution."""
    found, wanted = looped(task).execution, followed(task).execution
    assert found is not None
    assert wanted is not None
    assert [type(one) for one in found.events] == [type(one) for one in wanted.events]
    assert [one.time for one in found.events] == [one.time for one in wanted.events]
    assert np.array_equal(found.end_state, wanted.end_state)
    for one, other in zip(found.arcs, wanted.arcs, strict=True):
        assert np.array_equal(one.flow_times, other.flow_times)
    return found
