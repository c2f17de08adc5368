"""Laws of the impact speed in fits and rigs."""

from __future__ import annotations

import pytest

import zeno_orbits as zo
from tests.support.recordings_of import recorded
from zeno_orbits.experiment import tabulate_orbit

TRUTH = {"restitution": 0.55, "fall": 0.3}


def _recording(seed: int) -> zo.Recording:
    problem = zo.load_problem("marble_table")
    orbit = zo.find_orbit(problem, parameters=TRUTH).unwrap()
    table = tabulate_orbit(orbit, problem, ("height", "speed"))
    return recorded(table, problem, n_cycles=10, rate=2000.0, noise=3e-3, seed=seed, start=0.4)


@pytest.mark.slow
def test_the_parameters_of_a_law_are_found_from_an_orbit() -> None:
    found = zo.identify(
        "marble_table", _recording(0), {"restitution": (0.2, 0.9), "fall": (0.0, 1.0)}
    )
    for one in found.fitted:
        true = TRUTH[one.unknown.label]
        assert abs(one.value - true) < 5 * one.error < 0.3 * true, one
    # The recording excludes a constant restitution.
    fall = found.fitted[1]
    assert fall.low > 0.0
    constant = zo.identify(
        "marble_table", _recording(0), {"restitution": (0.2, 0.9)}, parameters={"fall": 0.0}
    )
    assert constant.misfit > 3 * found.misfit


def test_a_compliant_stop_is_damped_for_the_restitution_at_each_speed() -> None:
    problem = zo.load_problem("marble_table")
    orbit = zo.find_orbit(problem).unwrap()
    rig = zo.Rig(contact=zo.Contact(stiffness=1e8, slowest=1e-6))
    run = zo.simulate_rig(problem, rig, until=orbit.period, start=orbit.start_state)
    fast = [one for one in run.touches if -one.approach_rate > 0.1]
    assert len(fast) >= 2
    speeds = [-one.approach_rate for one in fast]
    assert max(speeds) > 1.5 * min(speeds)
    for touch, speed in zip(fast, speeds, strict=True):
        # The load of the contact, 20 m/s^2 for 0.07 ms, lowers the ratio by a part of 0.3 %.
        expected = 0.5 - 0.2 * speed
        assert touch.depart_rate / speed == pytest.approx(expected, abs=0.005 * expected)
