"""Feedback once per period: closed forms, held orbits that repel, and wrong input."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.cases import fast
from tests.support.commands import MISUSE, YES, ask
from tests.support.orbits import event_orbit, shot_orbit
from tests.support.repelling import KD
from zeno_orbits.errors import InputError

MU = 2.910917734
"""The multiplier of the reference pendulum at this gain, with 12 digits by other programs."""


@pytest.fixture(name="here")
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def _away(found: zo.Feedback, motion: zo.HeldMotion) -> Any:
    """Return the distance of each return from the orbit, in sizes of the coordinates."""
    return np.max(np.abs(motion.points - found.returns.fixed_point) / found.returns.sizes, axis=1)


def test_the_least_effort_mirrors_the_multiplier_that_repels(repelling: zo.Orbit) -> None:
    found = zo.design_feedback(repelling, {"Kd": (-1.9, -1.3)}, weight=0.0)
    assert abs(found.returns.multipliers[0]) == pytest.approx(MU, rel=1e-9)
    assert abs(found.multipliers[0]) == pytest.approx(1 / MU, rel=1e-9)
    motion = found.run(found.returns.fixed_point * [1.003, 1.0], 25)
    away = _away(found, motion)
    assert motion.lost == ""
    assert away[-1] < 1e-11
    ratios = away[10:15] / away[9:14]
    assert ratios == pytest.approx(np.full(5, 1 / MU), rel=1e-3)


def test_without_feedback_the_orbit_is_lost(repelling: zo.Orbit) -> None:
    nothing = zo.design_feedback(repelling, {"Kd": (KD, KD)})
    motion = nothing.run(nothing.returns.fixed_point * [1.0001, 1.0], 20)
    assert "does not follow" in motion.lost
    assert len(motion.points) < 10
    away = _away(nothing, motion)
    assert away[3] / away[2] == pytest.approx(MU, rel=0.05)


def test_the_loop_is_what_simulate_does_with_the_same_gains(repelling: zo.Orbit) -> None:
    found = zo.design_feedback(repelling, {"Kd": (-1.9, -1.3)})
    motion = found.run(found.returns.fixed_point * [1.01, 0.995], 4)
    state = found.returns.state(motion.points[0])
    for k, used in enumerate(motion.inputs[:, 0]):
        assert used == pytest.approx(found.inputs_at(motion.points[k])[0], rel=1e-14)
        gains = {"Kp": 2.5, "Kd": used}
        run = zo.simulate("motor_pendulum", until=3.5, gains=gains, start=state)
        release = next(one for one in run.releases if one.time > 0.6)
        names = zo.load_problem("motor_pendulum").state_names
        state = dict(zip(names, release.state, strict=True))
        assert found.returns.point(state) == pytest.approx(motion.points[k + 1], rel=1e-8)
        assert motion.times[k + 1] - motion.times[k] == pytest.approx(release.time, rel=1e-9)


@pytest.mark.slow
def test_a_repelling_orbit_is_held_for_a_thousand_periods(repelling: zo.Orbit) -> None:
    found = zo.design_feedback(repelling, {"Kd": (KD - 0.25, KD + 0.25)})
    motion = found.run(found.returns.fixed_point * [1.001, 1.0], 1000)
    assert (motion.lost, len(motion.points)) == ("", 1001)
    assert _away(found, motion)[30:].max() < 1e-12


@pytest.mark.slow
def test_the_range_of_disturbances_is_that_of_single_runs(repelling: zo.Orbit) -> None:
    found = zo.design_feedback(repelling, {"Kd": (KD - 0.25, KD + 0.25)})
    low, high = found.extent("dtheta1")
    centre, size = found.returns.fixed_point, found.returns.sizes[0]
    # The rate is negative. Its modulus returns from 3 % above and 10 % below at least.
    assert low * size < -0.03 * abs(centre[0])
    assert high * size > 0.1 * abs(centre[0])
    for part, comes in ((0.98 * low, True), (1.02 * low, False), (0.98 * high, True)):
        motion = found.run(centre + np.array([part * size, 0.0]), 60)
        back = motion.lost == "" and _away(found, motion)[-1] < 1e-6
        assert back == comes


def test_least_squares_of_a_single_coordinate_has_a_closed_form() -> None:
    found = zo.design_feedback(event_orbit("hopper"), ["a"], weight=2.0)
    known = found.returns
    (speed,), (size,) = known.fixed_point, known.sizes
    # The next speed is e sqrt(w^2 + 2 a s).
    e, s, push = 0.5, 0.1, 20.0
    down = np.sqrt(speed**2 + 2 * push * s)
    a, b = e * speed / down, e * s / down * push / size
    # P = w + a^2 P / (1 + b^2 P).
    p, q = 1 - a**2 - 2.0 * b**2, 2.0
    cost = (-p + np.sqrt(p**2 + 4 * b**2 * q)) / (2 * b**2)
    gain = a * b * cost / (1 + b**2 * cost) * push / size
    assert found.gain == pytest.approx(np.array([[gain]]), rel=1e-9)
    assert found.multipliers[0] == pytest.approx(a / (1 + b**2 * cost), rel=1e-9)


PENDULUM: dict[str, Any] = {"gains": {"Kp": 2.5, "Kd": -1.0}}
DEADBEAT: dict[str, tuple[dict[str, Any], tuple[str, ...], float]] = {
    "hopper": ({}, ("a",), 1e-4),
    "motor_pendulum": (PENDULUM, ("Kd",), 1e-4),
    "torque_pendulum": ({}, ("b2",), 1e-4),
    "two_motors": ({}, ("Kd",), 1e-4),
    "motor_cart": ({}, ("Kp",), 1e-4),
    "limited_pendulum": ({}, ("Kp", "Kd"), 1e-4),
    "table_juggler": ({}, ("pull",), 1e-5),
    "slope_walker": ({}, ("hip",), 1e-5),
    "powered_walker": ({}, ("Kp", "Kd"), 1e-5),
    "impact_oscillator": ({}, ("A",), 5e-7),
}
"""Inputs, and the disturbance from which the rest is below 1e-8. It is of the second order, so the
curvature of the map decides."""


@pytest.mark.parametrize("name", fast(2, DEADBEAT))
def test_deadbeat_takes_as_many_periods_as_coordinates(name: str) -> None:
    how, inputs, size = DEADBEAT[name]
    limits = dict.fromkeys(inputs, (-1e9, 1e9))
    found = zo.design_feedback(zo.find_orbit(name, **how).unwrap(), limits, method="deadbeat")
    d = len(found.returns.coordinates)
    assert max(map(abs, found.returns.multipliers)) > 1e-3
    along = np.random.default_rng(5).normal(size=d)

    def left(size: float) -> float:
        start = found.returns.fixed_point + size * found.returns.sizes * along
        return float(_away(found, found.run(start, d))[d])

    assert left(size) < 1e-8
    # What is left is of the second order.
    assert left(size / 10) < 0.02 * left(size) + 1e-12
    assert max(map(abs, found.multipliers)) < 1e-3


def test_placed_multipliers_are_the_rates_of_decay() -> None:
    orbit = event_orbit("hopper")
    found = zo.design_feedback(orbit, ["a"], method="place", multipliers=[0.6])
    away = _away(found, found.run(found.returns.fixed_point * 1.001, 12))
    assert away[6:] / away[5:-1] == pytest.approx(np.full(7, 0.6), rel=1e-4)
    slow = zo.design_feedback(orbit, ["a"], method="place", multipliers=[0.5, 0.7], delay=True)
    motion = slow.run(slow.returns.fixed_point * 1.001, 30)
    assert motion.inputs[0] == pytest.approx([20.0])
    away = _away(slow, motion)
    assert away[-1] / away[-2] == pytest.approx(0.7, rel=1e-3)
    assert slow.measured == ("speed", "a")


def _noisy(found: zo.Feedback, errors: Any) -> tuple[Any, Any]:
    """Return points and inputs of the loop whose readings have errors, from return to return."""
    known, point, used = found.returns, found.returns.fixed_point, found.centre
    points, inputs = list[Any](), list[Any]()
    for error in errors:
        told = (
            found.inputs_at(point + error, used) if found.delay else found.inputs_at(point + error)
        )
        used, waiting = (used, told) if found.delay else (told, told)
        points.append(point)
        inputs.append(used)
        point, used = known.map(point, parameters={"a": used[0]}), waiting
    return np.array(points), np.array(inputs)


@pytest.mark.slow
@pytest.mark.parametrize("delay", fast(1, [False, True]))
def test_errors_of_readings_act_as_in_a_loop_that_has_them(delay: bool) -> None:
    found = zo.design_feedback(zo.find_orbit("hopper").unwrap(), ["a"], weight=2.0, delay=delay)
    size = 1e-4
    points, inputs = _noisy(found, np.full((20, 1), size))
    shift = found.offset({"speed": size})
    # The second order is a part 1e-4 of the first one.
    assert points[-1] - found.returns.fixed_point == pytest.approx([shift["speed"]], rel=1e-3)
    assert inputs[-1] - found.centre == pytest.approx([shift["a"]], rel=1e-3)
    points, inputs = _noisy(found, np.random.default_rng(7).normal(0.0, size, (150, 1)))
    spread = found.scatter({"speed": size})
    # Four standard errors of a standard deviation from 150 nearly independent draws.
    assert np.std(points) == pytest.approx(spread["speed"], rel=0.23)
    assert np.std(inputs) == pytest.approx(spread["a"], rel=0.23)


def test_errors_of_readings_have_closed_forms_of_one_coordinate() -> None:
    found = zo.design_feedback(zo.find_orbit("hopper").unwrap(), ["a"], weight=2.0)
    known = found.returns
    a, b = known.jacobian[0, 0], known.parameter_jacobian[0, known.parameter_names.index("a")]
    k, rest, size = found.gain[0, 0], a - b * found.gain[0, 0], 0.01
    shift, spread = found.offset({"speed": -size}), found.scatter({"speed": size})
    assert shift["speed"] == pytest.approx(b * k * size / (1 - rest), rel=1e-12)
    assert shift["a"] == pytest.approx(-k * (shift["speed"] - size), rel=1e-12)
    assert spread["speed"] == pytest.approx(abs(b * k) * size / np.sqrt(1 - rest**2), rel=1e-12)
    assert spread["a"] == pytest.approx(k * np.hypot(spread["speed"], size), rel=1e-12)
    assert found.offset({}) == {"speed": 0.0, "a": 0.0}
    for errors, told in (
        ({"sped": 1.0}, "Did you mean `speed`"),
        ({"speed": float("nan")}, "must be a finite"),
        ({"speed": -1.0}, "must not be negative"),
    ):
        with pytest.raises(InputError, match=told):
            found.scatter(errors)


def test_inputs_stay_in_their_ranges() -> None:
    found = zo.design_feedback(event_orbit("hopper"), {"a": (19.5, 20.5)}, weight=1e3)
    assert found.inputs_at([0.0]) == pytest.approx([20.5])
    assert found.inputs_at([5.0]) == pytest.approx([19.5])
    motion = found.run([1.0], 10)
    assert np.all((motion.inputs >= 19.5) & (motion.inputs <= 20.5))


@pytest.mark.parametrize(
    ("inputs", "how", "told"),
    [
        ([], {}, "`inputs` must name at least one gain or parameter"),
        (["b"], {}, "unknown gain or parameter `b`"),
        (["a", "a"], {}, "names `a` twice"),
        (["m"], {"method": "deadbeat"}, "`m` does not change the multiplier 0.25"),
        ({"a": (25.0, 30.0)}, {}, "range 25:30 of `a` lacks its value 20 in the orbit"),
        (["a"], {"method": "pole"}, "`method` must be one of lqr, place, deadbeat"),
        (["a"], {"weight": -1.0}, "`weight` must be a finite number of at least 0"),
        (["a"], {"weight": float("nan")}, "`weight` must be a finite number of at least 0"),
        (["a"], {"weight": 1.0, "method": "deadbeat"}, "`weight` belongs to the methods `lqr`"),
        ({"a": (3000.0, -3000.0)}, {}, "LOW <= HIGH for `a`, but it is 3000:-3000"),
        ({"a": (float("nan"), 1.0)}, {}, "LOW <= HIGH for `a`, but it is nan:1"),
        (["a"], {"method": "place"}, "`multipliers` is needed by the method `place`"),
        (["a"], {"multipliers": [0.1]}, "`multipliers` belongs to the method `place`"),
        (["a"], {"method": "place", "multipliers": [1.5]}, "inside the unit circle"),
        (["a"], {"method": "place", "multipliers": [0.1, 0.2]}, "must hold 1 numbers"),
        (["a"], {"method": "place", "multipliers": [0.1j]}, "conjugate pairs"),
        (["a"], {"section": "release stop"}, "must be an event of the orbit"),
    ],
)
def test_wrong_input_is_named(inputs: Any, how: dict[str, Any], told: str) -> None:
    with pytest.raises(InputError) as error:
        zo.design_feedback(event_orbit("hopper"), inputs, **how)
    assert told in str(error.value)


def test_an_input_that_moves_the_section_is_refused() -> None:
    orbit = shot_orbit("forced_oscillator")
    with pytest.raises(InputError, match="`A` moves the section `release stop`"):
        zo.design_feedback(orbit, ["A"])


def test_plain_data_and_command_agree(repelling: zo.Orbit, here: Path) -> None:
    zo.write_orbit(repelling, "orbit.json")
    words = ("feedback", "orbit.json", "--input", "Kd=-1.9:-1.3")
    answer = ask(*words)
    assert answer.code == YES
    assert "Feedback of motor_pendulum by Kd at `release stop`: keeps the orbit" in answer.out
    assert "Multipliers without it: 2.91092, 0 (below rounding)" in answer.out
    assert "Multipliers with it:    0.343624, 0 (below rounding)" in answer.out
    found = zo.design_feedback("orbit.json", {"Kd": (-1.9, -1.3)})
    data = ask(*words, "--json", "-o", "feedback.json").data
    assert data == found.as_json() == json.loads((here / "feedback.json").read_text())
    told = ask(*words, "--error", "dtheta1=0.1", "--json").data
    assert told["reading_errors"]["scatter"] == found.scatter({"dtheta1": 0.1})
    assert told["reading_errors"]["offset"] == found.offset({"dtheta1": 0.1})
    assert "scatter, if random" in ask(*words, "--error", "dtheta1=0.1").out
    assert "at an end of its range" in ask("feedback", "orbit.json", "--input", "Kd").out


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((), "Missing: --input"),
        (("--input", "Kd=2"), "must be NAME=LOW:HIGH"),
        (("--input", "kd"), "unknown gain or parameter `kd`"),
        (("--input", "Kd", "--method", "place", "--multipliers", "x"), "must be numbers such as"),
        (("--input", "Kd", "--weight", "-1"), "--weight -1: must be a finite number of at least 0"),
        (("--input", "Kd", "--input", "Kd"), "--input: must name `Kd` once, not twice"),
        (("--input", "Kd", "--error", "dtheta1=nan"), "--error dtheta1=nan: must be a finite"),
        (
            ("--input", f"Kd={KD}:{KD}", "--error", "dtheta1=1"),
            "the loop does not keep the orbit (multiplier 2.91092)",
        ),
        (("--input", "Kd", "--error", "dtheta=0.1"), "--error dtheta=0.1: unknown name `dtheta`"),
    ],
)
@pytest.mark.usefixtures("here")
def test_wrong_words_end_in_one_line(
    repelling: zo.Orbit, words: tuple[str, ...], told: str
) -> None:
    zo.write_orbit(repelling, "orbit.json")
    answer = ask("feedback", "orbit.json", *words)
    assert answer.code == MISUSE
    assert told in answer.err
    assert answer.err.count("\n") == 1


@pytest.mark.usefixtures("here")
def test_the_command_takes_a_method(repelling: zo.Orbit) -> None:
    zo.write_orbit(repelling, "orbit.json")
    answer = ask("feedback", "orbit.json", "--input", "Kd", "--method", "deadbeat")
    assert answer.code == YES
    assert "Multipliers with it:    2 x 0 (below rounding)" in answer.out
    words = ("--method", "place", "--multipliers", "0.2", "--delay")
    answer = ask("feedback", "orbit.json", "--input", "Kd", *words)
    assert "must hold 3 numbers" in answer.err
