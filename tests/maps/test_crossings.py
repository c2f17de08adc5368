"""The events at which a motion crosses its sections."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
import pytest

from zeno_orbits.maps.crossings import Follower, Released, Struck
from zeno_orbits.model import load_problem


@pytest.mark.parametrize("name", ["motor_pendulum", "vibrating_table"])
def test_releases_are_the_same_where_impacts_are_no_crossings(name: str) -> None:
    problem = load_problem(name)
    follower = Follower(dynamics=problem.dynamics(problem.values()))
    start = np.array(problem.state_vector(problem.starts[0]))
    told = [
        list(follower.crossings(start, until=6.0, error=1e-8, goes_on=False, strikes=strikes))
        for strikes in (True, False)
    ]
    every, releases = ([one for one in row if isinstance(one, Released)] for row in told)
    assert any(isinstance(one, Struck) for one in told[0])
    assert not any(isinstance(one, Struck) for one in told[1])
    assert len(releases) > 2
    assert repr([astuple(one) for one in every]) == repr([astuple(one) for one in releases])
    assert repr(told[0][-1]) == repr(told[1][-1])
