"""Ends of paths of orbits: `search` and `continue` name the same end at the same value."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

import zeno_orbits as zo
from tests.support.commands import NO, YES, ask
from zeno_orbits.continuation import SpecialPointKind, family_of_orbit, start_orbit
from zeno_orbits.model import load_problem

MACHINES = Path(__file__).parents[1] / "support" / "machines"


@pytest.mark.slow
def test_a_table_that_just_lifts_its_load_ends_with_its_release() -> None:
    # The table's acceleration A omega^2 reaches gravity there.
    problem = load_problem("vibrating_table")
    numbers = problem.values().parameters
    lifts = numbers["g"] / numbers["omega"] ** 2
    detail = zo.find_orbit("vibrating_table", parameters={"A": 0.005}).detail
    assert f"followed to A = {lifts:.5g}, not beyond: there the release is not transver" in detail
    orbit = start_orbit(problem, problem.values(parameters={"A": 0.012}))
    (family,) = family_of_orbit(problem, orbit, "A", (0.005, 0.0125)).families
    assert family.first.kind is SpecialPointKind.RELEASE_LOST
    assert family.first.at.value == pytest.approx(lifts, rel=1e-9)


@pytest.mark.slow
def test_a_pendulum_whose_swing_dies_out_ends_with_its_amplitude() -> None:
    # The linearized pendulum neither grows nor shrinks at -0.186434258415.
    detail = ask("search", "motor_pendulum", "--set", "Kp=2.5", "--set", "Kd=0.5", "--json")
    assert detail.code == NO
    assert "there the amplitude is zero." in detail.data["detail"]
    reached = float(detail.data["detail"].split("Kd = ")[2].split(",")[0])
    assert reached == pytest.approx(-0.186434258415, abs=5e-5)


@pytest.mark.slow
def test_a_crank_that_stalls_ends_with_a_period_to_infinity(tmp_path: Path) -> None:
    # No turn is completed at drive = load, where 2 pi / sqrt(drive^2 - load^2) has its pole.
    output = tmp_path / "crank.json"
    machine, load = MACHINES / "stalling_crank.py", 7.9
    answer = ask("continue", machine, "--parameter", "drive=5:10", "--set", "drive=9", "-o", output)
    assert answer.code == YES
    assert "period to infinity" in answer.out
    (family,) = json.loads(output.read_text())["families"]
    end, _ = family["ends"]
    assert end["kind"] == "period to infinity"
    assert abs(end["value"] - load) < 10 * end["error"] < 1e-8
    assert end["period"] is None
    for point in family["points"]:
        exact = 2 * math.pi / math.sqrt(point["value"] ** 2 - load**2)
        # Rounding of the square root, which has few digits near the pole.
        assert point["period"] == pytest.approx(exact, rel=1e-9 + 1e-12 * exact**2)
    assert max(point["period"] for point in family["points"]) > 50 * family["points"][-1]["period"]
