"""One stop is a case of several stops: both roads of the package give the same events and orbits.

Runs are one program, for formulas that are built in two ways. Searches and checks of orbits are two
programs, so each is the reference of the other.
"""

from __future__ import annotations

import numpy as np
import pytest

import zeno_orbits as zo
from zeno_orbits.model import bundled_problems, load_problem
from zeno_orbits.simulation import simulate, state_after, state_before

ONE_STOP = tuple(name for name in bundled_problems() if not load_problem(name).has_graph)
WITHOUT_ORBIT = frozenset({"bouncing_ball", "falling_pendulum"})


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


@pytest.mark.slow
@pytest.mark.parametrize("name", [one for one in ONE_STOP if one not in WITHOUT_ORBIT])
def test_an_orbit_of_a_machine_with_one_stop_is_that_of_its_graph(name: str) -> None:
    one, other = zo.find_orbit(name).unwrap(), zo.find_orbit(name).unwrap()
    assert other.period == pytest.approx(one.period, rel=1e-9)
    checks = zo.verify(one), zo.verify(other)
    assert all(check.passed for check in checks)
    # A multiplier below the errors of both differs.
    found, wanted = (
        sorted(size for size in np.abs(check.multipliers) if size > 1e-6) for check in checks
    )
    np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-7)
