"""All commands tell the same story of a problem: bundled ones, and machines made for this test.

The truths are those of the machines: the clock's period, the state in which a stop lets go, or
another problem that is the same one in other coordinates.
"""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import pytest

import zeno_orbits as zo
from tests.support.cases import often
from tests.support.one_stop import one_stop_problems
from tests.support.one_story import Story, data_story_of, story_of

MACHINES = Path(__file__).parents[1] / "support" / "machines"
WITH_AN_ORBIT = sorted(set(one_stop_problems()) - {"bouncing_ball", "falling_pendulum"})
FOLLOWED = {*WITH_AN_ORBIT} - {"two_tone_table"}
"""`continue` follows one release, or one impact, a period."""
RECORDED = [name for name in WITH_AN_ORBIT if name != "filtered_pendulum"]
"""The filtered pendulum takes minutes, and is the pendulum with a lag in its law."""
OWN = map(str, sorted(MACHINES.glob("[a-z]*.py")))


def require_one(story: Story) -> None:
    """Demand that search, simulation, map and family name the same stable orbit."""
    assert story.verified
    # The map's own tolerance is the loosest.
    assert story.spread() < 1e-8
    assert len(story.fates) == 1


@pytest.mark.slow
def test_a_follower_with_a_dashpot() -> None:
    story = story_of(MACHINES / "eccentric_cam.py")
    require_one(story)
    assert story.period == pytest.approx(2 * math.pi / 120.0, rel=1e-11)
    orbit = zo.find_orbit(MACHINES / "eccentric_cam.py").unwrap()
    # The cam falls away as fast as the spring pushes: k (l0 + a c) = m omega^2 a c.
    lets_go = 1500.0 * 0.006 / (0.005 * (0.3 * 120.0**2 - 1500.0))
    assert orbit.phases[0].start_state["cosine"] == pytest.approx(lets_go, rel=1e-9)


@pytest.mark.slow
def test_a_flap_with_a_gear_and_an_offset_stop_is_the_motor_valve() -> None:
    story = story_of(MACHINES / "geared_flap.py")
    require_one(story)
    valve = zo.find_orbit("motor_valve").unwrap()
    assert story.period == pytest.approx(valve.period, rel=1e-9)


@pytest.mark.slow
def test_a_flap_under_an_alternating_voltage() -> None:
    story = story_of(MACHINES / "buzzer.py")
    require_one(story)
    assert story.period == pytest.approx(2 * math.pi / 20.0, rel=1e-11)
    orbit = zo.find_orbit(MACHINES / "buzzer.py").unwrap()
    # The stop lets go where the motor just carries the spring: K i = k preload.
    lifts = 0.05 * 0.2 / 0.03
    assert orbit.phases[0].start_state["current"] == pytest.approx(lifts, rel=1e-10)


@pytest.mark.slow
def test_a_hammer_that_repeats_after_three_turns_of_its_force() -> None:
    story = story_of(MACHINES / "hammer.py", follow=False)
    require_one(story)
    assert story.period == pytest.approx(3 * 2 * math.pi / 25.0, rel=1e-10)
    orbit = zo.find_orbit(MACHINES / "hammer.py").unwrap()
    assert orbit.phases[0].start_state["cosine"] == pytest.approx(2.0 * 9.81 / 55.0, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "omega"), [("shaken_pair", 16.0), ("twin_actuators", 30.0)])
def test_two_degrees_of_freedom_shaken(name: str, omega: float) -> None:
    story = story_of(MACHINES / f"{name}.py")
    require_one(story)
    assert story.period == pytest.approx(2 * math.pi / omega, rel=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("name", WITH_AN_ORBIT)
def test_a_bundled_problem(name: str) -> None:
    require_one(story_of(name, follow=name in FOLLOWED))


@pytest.mark.slow
@pytest.mark.parametrize("name", often(6, [*RECORDED, *OWN]))
def test_a_stiff_machine_and_a_recording_tell_the_same_orbit(name: str) -> None:
    told = data_story_of(name)
    # `rig` takes one Zeno point a period, and `identify` an orbit that tells its restitution.
    refused = {"impact_oscillator", "table_juggler", "two_tone_table"}
    assert math.isnan(told.rig) == math.isnan(told.identified) == (name in refused)
    if name not in refused:
        # A contact lasts 3e-5 of the period, and the machine is off by as much at most.
        assert told.rig < 3e-5
        # The table of an orbit is exact to 1e-6 of its signals, and so are the numbers.
        assert told.identified < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("options", [(), ("--with-motor",), ("--with-circuit",)])
def test_a_new_problem_as_it_is_written(options: tuple[str, ...], tmp_path: Path) -> None:
    words = [sys.executable, "-m", "zeno_orbits", "new", "mine", *options]
    subprocess.run(words, cwd=tmp_path, check=True, capture_output=True)
    (path,) = tmp_path.rglob("mine*.py")
    require_one(story_of(path))
