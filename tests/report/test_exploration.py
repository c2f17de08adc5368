"""Live exploration: the widget follows the attractor and shows what the other commands compute."""

from __future__ import annotations

import json
import math
import random
import sys
from pathlib import Path
from typing import Any

import pytest

import zeno_orbits as zo

pytest.importorskip("anywidget")

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def pendulum() -> Any:
    """Return the widget of the reference problem."""
    return zo.explore("motor_pendulum")


def test_a_slider_gives_the_orbit_that_find_orbit_verifies(pendulum: Any) -> None:
    pendulum.values = {"Kp": 3.0, "Kd": -1.1}
    found = zo.find_orbit("motor_pendulum", gains={"Kp": 3.0, "Kd": -1.1}).unwrap()
    shown = pendulum.attractor
    assert pendulum.view["name"] == "Stable Zeno periodic orbit"
    # The widget's orbit comes from the simulator, the other one from collocation: 1e-10 s each.
    assert shown.orbit.period == pytest.approx(found.period, abs=1e-9)
    assert dict(pendulum.view["facts"])["period"] == f"{found.period:.9g} s"
    radius = max(map(abs, found.floquet_multipliers))
    assert shown.multipliers.spectral_radius == pytest.approx(radius, abs=1e-6)


@pytest.mark.slow
def test_the_widget_follows_one_of_two_stable_orbits() -> None:
    # At Kp = 4.2, Kd = -1.55 a motion from the default start reaches an orbit of 2.03 s instead.
    widget = zo.explore("motor_pendulum", vary={"Kd": (-2.0, -0.5)}, gains={"Kp": 4.2})
    for kd in (-1.0, -1.3, -1.5, -1.53, -1.55):
        widget.values = {"Kd": kd}
    followed = widget.attractor.orbit
    assert zo.verify(followed).passed
    other = zo.find_orbit("motor_pendulum", gains={"Kp": 4.2, "Kd": -1.55}).unwrap()
    assert followed.period < 1.95 < other.period


@pytest.mark.slow
def test_the_widget_follows_an_orbit_with_two_zeno_points_per_period() -> None:
    widget = zo.explore("two_tone_table", vary={"restitution": (0.2, 0.4)})
    for restitution in (0.25, 0.3):
        widget.values = {"restitution": restitution}
        assert dict(widget.view["facts"])["event sequence"] == "zeno*2"
        assert zo.verify(widget.attractor.orbit).passed


@pytest.mark.slow
def test_a_motion_that_dies_out_is_named_and_left_again(pendulum: Any) -> None:
    pendulum.values = {"Kp": 2.5, "Kd": 0.5}
    assert "decays" in pendulum.view["name"]
    assert pendulum.view["facts"] == []
    assert pendulum.view["panels"]
    pendulum.values = {"Kp": 2.5, "Kd": -1.0}
    assert pendulum.view["name"] == "Stable Zeno periodic orbit"


def test_the_view_is_finite_json_with_a_panel_per_portrait(pendulum: Any) -> None:
    pendulum.values = {"Kp": 2.5, "Kd": -1.0}
    view = json.loads(json.dumps(pendulum.view, allow_nan=False))
    problem = zo.load_problem("motor_pendulum")
    assert len(view["panels"]) == len(problem.portraits)
    for panel in view["panels"]:
        assert {path["kind"] for path in panel["paths"]} >= {"free", "locked"}
        assert len(panel["zeno"]) == 1
        assert len(panel["release"]) >= 1
        points = [point for path in panel["paths"] for point in path["points"]]
        assert all(math.isfinite(number) for point in points for number in point)


def test_a_forced_orbit_keeps_the_period_of_its_clock_and_forgets_its_start() -> None:
    widget = zo.explore("forced_oscillator", vary={"c": (0.05, 0.4)})
    for damping in (0.1, 0.2):
        widget.values = {"c": damping}
        orbit = widget.attractor.orbit
        # The contact force fixes the phase of the release: the section of one clock is a point.
        assert orbit is not None
        assert orbit.period == pytest.approx(2 * math.pi, abs=1e-9)
        assert widget.attractor.multipliers.spectral_radius < 1e-6


@pytest.mark.slow
def test_every_change_of_a_forced_problem_gives_its_orbit() -> None:
    widget = zo.explore("forced_oscillator", vary={"A": (0.9, 1.4), "restitution": (0.1, 0.5)})
    chance = random.Random(0)
    for _ in range(12):
        widget.values = {"A": chance.uniform(0.9, 1.4), "restitution": chance.uniform(0.1, 0.5)}
        # In contact the force fixes the phase of the release, so every period is a turn.
        assert widget.attractor.orbit.period == pytest.approx(2 * math.pi, abs=1e-9)
        assert zo.verify(widget.attractor.orbit).passed


def test_derived_parameters_follow_a_slider_as_in_every_search() -> None:
    # The problem solves rotor inertia and torque constant for the published coefficients.
    mass = 1.05 * zo.load_problem("motor_pendulum").values().parameters["m2"]
    widget = zo.explore("motor_pendulum", vary={"m2": (0.9 * mass, 1.1 * mass)})
    widget.values = {"m2": mass}
    found = zo.find_orbit("motor_pendulum", parameters={"m2": mass}).unwrap()
    assert widget.attractor.orbit.parameters == found.parameters
    assert widget.attractor.orbit.period == pytest.approx(found.period, abs=1e-9)


def test_a_problem_is_explored_from_its_file(tmp_path: Path) -> None:
    file = tmp_path / "oscillator.py"
    file.write_text((ROOT / "problems" / "forced_oscillator.py").read_text())
    widget = zo.explore(file, vary={"A": (0.9, 1.4)})
    assert widget.attractor.orbit.period == pytest.approx(2 * math.pi, abs=1e-9)


@pytest.mark.parametrize(
    ("problem", "arguments", "message"),
    [
        ("bouncing_ball", {}, "`bouncing_ball` lacks gains"),
        ("motor_pendulum", {"vary": {"Kq": (1, 2)}}, "Argument `vary`: unknown name `Kq`"),
        (
            "motor_pendulum",
            {"vary": {"Kp": (3, 2)}},
            "must have finite bounds LOWER < UPPER for `Kp`, but they are 3:2",
        ),
        ("motor_pendulum", {"vary": {"Kp": (2, math.inf)}}, "must have finite bounds"),
        ("motor_pendulum", {"vary": {"m1": (-1.0, 1.0)}}, "m1"),
        ("motor_pendulum", {"gains": {"Kq": 1.0}}, "Kq"),
        ("motor_pendulm", {}, "motor_pendulum"),
    ],
)
def test_a_wrong_argument_is_refused_in_one_line(
    problem: str, arguments: dict[str, Any], message: str
) -> None:
    with pytest.raises(zo.InputError) as refusal:
        zo.explore(problem, **arguments)
    assert message in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_without_the_extra_the_refusal_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "anywidget", None)
    monkeypatch.delitem(sys.modules, "zeno_orbits.report.exploration.widget", raising=False)
    with pytest.raises(zo.InputError, match=r"pip install 'zeno_orbits\[explore\]'"):
        zo.explore("motor_pendulum")
