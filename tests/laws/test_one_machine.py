"""One stop is a case of several stops: formulas that are built in two ways give the same events."""

from __future__ import annotations

import numpy as np
import pytest

from zeno_orbits.model import bundled_problems, load_problem
from zeno_orbits.simulation import simulate, state_after, state_before

ONE_STOP = tuple(name for name in bundled_problems() if not load_problem(name).has_graph)


@pytest.mark.slow
@pytest.mark.parametrize("name", ONE_STOP)
def test_events_of_a_machine_with_one_stop_are_those_of_its_graph(name: str) -> None:
    problem = load_problem(name)
    values = problem.values()
    systems = problem.dynamics(values), problem.graph_dynamics(values)
    start, until = problem.initial_state(None), 10 * systems[0].own.time
    ones, others = (simulate(system, start, until=until).events for system in systems)
    assert len(ones) == len(others)
    for one, other in zip(ones, others, strict=True):
        assert type(one) is type(other)
        assert one.time == other.time
        np.testing.assert_array_equal(state_before(one), state_before(other))
        np.testing.assert_array_equal(state_after(one), state_after(other))
