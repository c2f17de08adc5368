"""The events at which a motion crosses its sections."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
import pytest

from zeno_orbits.maps.crossings import Follower, ImpactRecord, ReleaseRecord
from zeno_orbits.model import load_problem


@pytest.mark.parametrize("bounded", [False, True])
@pytest.mark.parametrize("name", ["motor_pendulum", "vibrating_table"])
def test_releases_of_many_motions_are_those_of_each_motion(name: str, bounded: bool) -> None:
    problem = load_problem(name)
    dynamics = problem.dynamics(problem.values())
    start = np.array(problem.state_vector(problem.starts[0]))
    # Bounds of velocities are known to a motion that is followed event by event.
    bounds = np.full(start.size, 1e3) if bounded else None
    follower = Follower(dynamics=dynamics, bounds=bounds)
    states = np.array([start, start, start])
    states[1, dynamics.n_q - 1] += 0.01
    found = list(follower.releases(states, until=9.0, error=1e-8, count=3))
    assert [len(row) for row in found] == [3, 3, 3]
    assert repr([astuple(one) for one in found[0]]) == repr([astuple(one) for one in found[2]])
    for state, row in zip(states, found, strict=True):
        crossings = list(follower.crossings(state, until=9.0, error=1e-8))
        alone = [one for one in crossings if isinstance(one, ReleaseRecord)][:3]
        assert any(isinstance(one, ImpactRecord) for one in crossings)
        assert repr([astuple(one) for one in row]) == repr([astuple(one) for one in alone])


def test_a_motion_that_is_not_released_has_no_releases() -> None:
    problem = load_problem("bouncing_ball")
    follower = Follower(dynamics=problem.dynamics(problem.values()))
    start = np.array([problem.state_vector({"height": 1.0})])
    assert list(follower.releases(start, until=30.0, error=1e-8, count=1)) == [[]]
