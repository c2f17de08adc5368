"""The command `search`: the orbit, its file, and why there is none."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

import zeno_orbits as zo
from tests.reference.many_digits.fixed_point import ExtendedOrbit, extended_orbit
from tests.reference.reference_orbit import ORBIT_KEYS, PERIOD, RELEASE
from tests.support.commands import (
    INTERRUPTED,
    NO,
    PUBLISHED_GAINS,
    YES,
    Answer,
    ask,
    contents,
    error_said,
    raising,
)
from zeno_orbits.model import load_problem
from zeno_orbits.verification import OrbitCertificate

pytestmark = pytest.mark.usefixtures("here")


def test_search_at_the_published_gains_finds_the_orbit_and_writes_what_it_prints(
    searched: tuple[Answer, Path],
) -> None:
    answer, path = searched
    assert answer.code == YES
    assert answer.data == json.loads(path.read_text())
    assert set(answer.data) == {*ORBIT_KEYS, "problem_digest"}
    assert answer.data["format"] == 3
    assert answer.data["problem"] == "motor_pendulum"
    assert answer.data["gains"] == {"Kp": 2.5, "Kd": -1.0}
    # The reference closes to 6e-15; the search promises 3e-10, relative.
    assert answer.data["period"] == pytest.approx(PERIOD, rel=3e-10)
    assert set(answer.data["events"][0]) == {"name", "time", "state"}
    assert {"passed", "residuals", "margins"} <= set(answer.data["certificate"])
    assert answer.data["certificate"]["passed"] is True
    assert all(len(pair) == 2 for pair in answer.data["floquet_multipliers"])
    assert {"python", "casadi", "numpy", "scipy"} <= set(answer.data["versions"])


def test_search_with_free_gains_finds_the_orbit_nearest_to_the_problems_own(here: Path) -> None:
    answer = ask("search", "motor_pendulum", "-o", "found.json")
    assert answer.code == YES
    assert answer.out.startswith("Found: stable Zeno periodic orbit of motor_pendulum at Kp = ")
    assert "Verified: a stable Zeno periodic orbit" in answer.out
    assert "Written: found.json" in answer.out
    data = json.loads((here / "found.json").read_text())
    assert data["gains"] == pytest.approx({"Kp": 2.5, "Kd": -1.0})


@pytest.mark.slow
def test_search_keeps_a_bound_and_says_what_is_asked_and_reached() -> None:
    keep = ("--set", "Kp=2.5", "--vary", "Kd=-1.1:-0.8", "--bounds", "theta2=:1.95")
    answer = ask(
        "search", "motor_pendulum", *keep, "--candidates", "2", "--n-starts", "1", "--json"
    )
    assert answer.code == YES
    (asked,) = answer.data["certificate"]["asked"]
    assert (asked["quantity"], asked["lower"], asked["upper"]) == ("theta2", None, 1.95)
    assert 1.94 < asked["highest"] <= 1.95 + 1e-9
    assert asked["kept"] is True
    scores = [one["score"] for one in answer.data["candidates"]]
    assert scores == sorted(scores)
    assert answer.data["candidates"][0]["orbit"]["period"] == answer.data["period"]
    assert answer.data["failures"] == []


@pytest.mark.slow
def test_search_for_a_parameter_says_what_stays_and_what_is_reached(orbit_file: Path) -> None:
    free = (*PUBLISHED_GAINS, "--vary", "L1=0.198:0.202", "--objective", "peak=current")
    near = ("--near", orbit_file, "--candidates", "1")
    answer = ask("search", "motor_pendulum", *free, *near, "-o", "best.json")
    assert answer.code == YES
    assert "Derived, and held at their initial values: J_rotor, K_torque, K_emf." in answer.out
    reached = re.search(r"^Asked for the least peak of current: ([\d.]+)\.$", answer.out, re.M)
    assert reached is not None
    best = zo.read_orbit("best.json")
    own: dict[str, Any] = {
        "gains": best.gains,
        "parameters": best.parameters,
        "start": best.start_state,
    }
    _, states = zo.simulate("motor_pendulum", until=best.period, **own).sampled(1000)
    simulated = abs(states[:, list(best.start_state).index("current")]).max()
    assert float(reached[1]) == pytest.approx(simulated, rel=1e-6)
    assert re.search(r"^Found: .*, L1 = 0\.\d+ m$", answer.out, re.MULTILINE)
    rows = [line for line in answer.out.splitlines() if re.search(r"\S  +\S", line)]
    assert max(map(len, rows), default=0) <= 80


@pytest.mark.slow
def test_search_at_gains_without_an_orbit_answers_no_with_the_reason(here: Path) -> None:
    gains = ("--set", "Kp=2.5", "--set", "Kd=1")
    answer = ask("search", "motor_pendulum", *gains, "-o", "f.json")
    assert answer.code == NO
    assert "No simulation settled" in answer.out
    assert "the motion decays" in answer.out
    assert ".." not in answer.out
    assert contents(here) == {}


def test_search_as_json_says_no_in_json(here: Path) -> None:
    answer = ask("search", "bouncing_ball", "--json", "-o", "ball.json")
    assert answer.code == NO
    assert answer.data["found"] is False
    assert answer.data["status"]
    assert contents(here) == {}


def assert_says_what_was_missed(answer: Answer, wish: str) -> None:
    """Check the sentence of a search that could not meet a wish."""
    said = " ".join(answer.out.split())
    assert answer.code == NO
    assert "The conditions of the orbit could not be met." in said
    assert "The nearest that was reached has a period of" in said
    assert wish in said
    # A row is named with the place where it stands; rows without a place are named alone.
    assert re.search(r"missed: `[^`]+` by \d", said)
    assert "`continuity`" not in said


@pytest.mark.slow
def test_a_search_that_misses_says_which_conditions_by_name(here: Path) -> None:
    """One gain, a narrow box: a quick no, with all that a long one says."""
    answer = ask(
        *("search", "motor_pendulum", "--set", "Kd=-1", "--vary", "Kp=2.49:2.51"),
        *("--objective", "period=1.95", "--n-starts", "1", "-o", "f.json"),
    )
    assert_says_what_was_missed(answer, "missed: `a period of 1.95 s` by 0.1")
    assert contents(here) == {}


@pytest.mark.weekly
@pytest.mark.slow
def test_a_period_that_no_orbit_has_ends_in_a_no_that_says_what_was_tried(here: Path) -> None:
    answer = ask("search", "motor_pendulum", "--objective", "period=5", "-o", "f.json")
    assert_says_what_was_missed(answer, "The nearest that was reached has a period of")
    assert contents(here) == {}


@pytest.fixture(name="exact", scope="module")
def _exact() -> ExtendedOrbit:
    """The orbit at the published gains, to 25 digits."""
    problem = load_problem("motor_pendulum")
    return extended_orbit(problem, problem.values(), RELEASE)


def orbit_miss(data: Mapping[str, Any], exact: ExtendedOrbit) -> float:
    """Return how far an orbit file is off, in the units of its residuals.

    The largest values of the states on the orbit: 1.2 rad, 17 rad/s and more.
    """
    sizes = {"theta1": 1.2, "theta2": 1.0, "dtheta1": 8.0, "dtheta2": 16.9, "current": 3.0}
    period, zeno = float(exact.period), exact.zeno_points[0]
    orbit = zo.orbit_from_json(data, Path("orbit.json"))
    times = [(orbit.period, exact.period), (orbit.zeno_time, zeno.time)]
    times += [(i.time, true.time) for i, true in zip(orbit.impacts, exact.impacts, strict=False)]
    misses = [abs(time - float(true)) / period for time, true in times]
    for found, true in (
        (orbit.release_state, exact.release_state),
        (orbit.zeno_state, zeno.state),
    ):
        for name, value in zip(exact.state_names, true, strict=True):
            misses.append(abs(found[name] - float(value)) / sizes[name])
    return max(misses)


@pytest.mark.parametrize("wanted", [1e-4, 1e-6, 1e-10])
@pytest.mark.slow
def test_a_search_to_an_accuracy_keeps_it_and_bounds_its_error(
    wanted: float, here: Path, exact: ExtendedOrbit
) -> None:
    accuracy = f"--accuracy={wanted}"
    answer = ask("search", "motor_pendulum", *PUBLISHED_GAINS, accuracy, "-o", "o.json")
    assert answer.code == YES
    said = error_said(answer)
    data = json.loads((here / "o.json").read_text())
    # Two digits of the estimate are printed, and the sizes above are rounded.
    assert orbit_miss(data, exact) < 1.1 * said
    assert said <= wanted
    checked = ask("verify", "o.json", accuracy)
    assert checked.code == YES
    assert error_said(checked) <= wanted


@pytest.mark.slow
def test_an_orbit_that_is_not_the_one_is_seen_to_miss_it(
    orbit_data: dict[str, Any], exact: ExtendedOrbit
) -> None:
    assert orbit_miss(orbit_data, exact) < 1e-9
    orbit_data["events"][-2]["state"]["current"] += 1e-5
    assert orbit_miss(orbit_data, exact) > 1e-6


def test_an_accuracy_that_the_orbit_misses_is_a_no_of_the_search(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every residual passes; the orbit attracts so weakly that its numbers are worse than that."""
    weak = property(lambda _certificate: 3e-4)
    monkeypatch.setattr(OrbitCertificate, "orbit_error", weak)
    search = ("search", "motor_pendulum", *PUBLISHED_GAINS, "-o", "o.json")
    answer = ask(*search, "--accuracy", "1e-4")
    assert answer.code == NO
    assert "certain to 3.0e-04 only" in answer.out
    assert contents(here) == {}


@pytest.mark.parametrize("where", ["search.search.search_orbits", "verification.verifier.verify"])
def test_an_interrupted_search_says_so_and_writes_nothing(
    where: str, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(f"zeno_orbits.{where}", raising(KeyboardInterrupt()))
    answer = ask("search", "motor_pendulum", *PUBLISHED_GAINS, "-o", "f.json")
    assert answer.code == INTERRUPTED
    assert answer.out == ""
    assert answer.err == "zeno-orbits: interrupted, nothing was written\n"
    assert contents(here) == {}
