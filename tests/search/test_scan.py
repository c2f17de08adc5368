"""A scan of the box puts the starts of a search in order: the best valleys first."""

from __future__ import annotations

from typing import Any

import pytest

from zeno_orbits import MinSpectralRadius, NearestGains, TargetPeriod
from zeno_orbits.model import Problem
from zeno_orbits.search import SearchStatus, search_orbits

# The motor pendulum.


@pytest.mark.slow
def test_the_fastest_contraction_of_the_whole_box_is_found_beyond_a_hill(problem: Problem) -> None:
    # From the end of the box at -1.2 all ways lead up to 0.42 before they lead down to 0.
    result = search_orbits(
        problem,
        problem.values(),
        free={"Kd": (-1.9, -1.2)},
        objective=MinSpectralRadius(),
    )
    assert result.candidates[0].score == MinSpectralRadius().least
    # A scan in steps of 1e-4 by simulation: the multiplier passes zero between -1.5658 and -1.5657.
    assert result.unwrap().gains["Kd"] == pytest.approx(-1.5658, abs=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("objective", [NearestGains(target={}), TargetPeriod(target=1.9)])
def test_a_box_is_answered_whose_start_lies_outside_where_no_orbit_is(
    problem: Problem, objective: Any
) -> None:
    values = problem.values(gains={"Kd": -2.5})
    result = search_orbits(problem, values, free={"Kd": (-1.9, -1.2)}, objective=objective)
    assert result.status is SearchStatus.FOUND
    assert [attempt.status for attempt in result.attempts] == [
        SearchStatus.NO_GUESS,
        SearchStatus.FOUND,
    ]


# By hand.
