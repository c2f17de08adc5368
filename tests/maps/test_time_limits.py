"""Attractors of motions whose time limit ends before they settle.

A bouncing ball comes to rest. The mass on the vibrating table accumulates impacts once a period.
Neither has an orbit without a Zeno point.
"""

from __future__ import annotations

import numpy as np
import pytest

import zeno_orbits as zo
from zeno_orbits.maps import AttractorClass, attractors_at


@pytest.mark.parametrize("until", [1.5, 2.0, 3.0])
def test_impacts_that_accumulate_are_no_periodic_orbit(until: float) -> None:
    problem = zo.load_problem("bouncing_ball")
    (found,) = attractors_at(problem, [problem.values()], until=until)
    assert found.fate in {AttractorClass.UNSETTLED, AttractorClass.REST}
    assert np.isnan(found.period)


@pytest.mark.parametrize("part", [0.2, 0.45, 0.7, 0.8, 1.3])
def test_a_limit_before_the_motion_repeats_hides_no_zeno_point(part: float) -> None:
    problem = zo.load_problem("vibrating_table")
    period = zo.find_orbit(problem).unwrap().period
    (found,) = attractors_at(problem, [problem.values()], until=part * period)
    assert found.fate in {AttractorClass.UNSETTLED, AttractorClass.ZENO}
    if found.fate is AttractorClass.ZENO:
        assert found.period == pytest.approx(period, rel=1e-6)


@pytest.mark.slow
def test_a_motion_that_stays_in_contact_after_its_impacts_is_held() -> None:
    # The leg turns about its hip with the knee closed.
    start = {"q1": 3.315, "q2": 0.456, "q3": 0.456, "dq1": 2.384, "dq2": 5.12298, "dq3": 5.12296}
    problem = zo.load_problem("kneed_walker")
    values = problem.values(parameters={"restitution": 0.1})
    (found,) = attractors_at(problem, [values], start=start, until=0.01)
    assert found.fate is AttractorClass.HELD
