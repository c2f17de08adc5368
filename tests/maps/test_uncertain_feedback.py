"""A loop at the corners of uncertain parameters: closed forms, other programs, and wrong input."""

from __future__ import annotations

import json
import math
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

import zeno_orbits as zo
from tests.reference.held_by_hand import Juggler
from tests.support.commands import MISUSE, NO, YES, ask
from tests.support.orbits import event_orbit
from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError

AMPLITUDE, BOX = 0.015, {"A": (0.013, 0.017)}


def _hopping(k: float, e: float, s: float, centre: float) -> tuple[float, float]:
    """Return the speed of a hopper whose push is 20 - k (w - centre), and its multiplier.

    The next speed is e sqrt(w^2 + 2 a s).
    """

    def after(w: float) -> float:
        return e * math.sqrt(w**2 + 2 * s * (20 - k * (w - centre)))

    w = float(brentq(lambda w: after(w) - w, 0.3, 3.0, xtol=1e-15, rtol=1e-15))
    return w, e * (w - k * s) / math.sqrt(w**2 + 2 * s * (20 - k * (w - centre)))


@pytest.mark.parametrize("method", ["lqr", pytest.param("robust", marks=pytest.mark.slow)])
def test_the_loop_of_a_hopper_at_the_corners_has_a_closed_form(method: str) -> None:
    box = {"restitution": (0.42, 0.55), "s": (0.09, 0.12)}
    found = zo.design_feedback(
        event_orbit("hopper"), {"a": (-900.0, 900.0)}, method=method, uncertain=box
    )
    centre, k = float(found.returns.fixed_point[0]), float(found.gain[0, 0])
    assert [tuple(one.parameters.values()) for one in found.corners] == [
        (e, s) for e in box["restitution"] for s in box["s"]
    ]
    for one in found.corners:
        e, s = one.parameters.values()
        w, mu = _hopping(k, e, s, centre)
        assert one.fixed_point == pytest.approx([w], rel=1e-9)
        assert one.inputs == pytest.approx([20 - k * (w - centre)], rel=1e-9)
        assert one.multipliers == pytest.approx([mu], abs=1e-8)
    if method == "lqr":
        return

    def worst(k: float) -> float:
        every = [(0.5, 0.1), *((e, s) for e in box["restitution"] for s in box["s"])]
        return max(abs(_hopping(k, e, s, centre)[1]) for e, s in every)

    best: Any = minimize_scalar(worst, bounds=(1.0, 40.0), method="bounded")
    assert found.worst == pytest.approx(worst(k), abs=1e-8)
    assert found.worst == pytest.approx(best.fun, abs=1e-5)
    assert k == pytest.approx(best.x, rel=1e-3)
    assert found.robust


def test_a_clipped_input_acts_on_nothing_at_a_corner() -> None:
    found = zo.design_feedback(
        event_orbit("hopper"),
        {"a": (19.0, 21.0)},
        method="deadbeat",
        uncertain={"restitution": (0.5, 0.6)},
    )
    first, last = found.corners
    assert first.multipliers == pytest.approx(found.multipliers, abs=1e-8)
    # The push is at its lower end: w^2 = e^2 (w^2 + 2 19 s), and its multiplier is e^2.
    assert last.inputs == pytest.approx([19.0])
    assert last.fixed_point == pytest.approx([math.sqrt(0.36 * 3.8 / 0.64)], rel=1e-9)
    assert last.multipliers == pytest.approx([0.36], rel=1e-8)
    assert found.worst_at == {"restitution": 0.6}


def test_with_a_delay_the_loop_has_the_inputs_as_states() -> None:
    found = zo.design_feedback(
        event_orbit("hopper"), ["a"], weight=2.0, delay=True, uncertain={"s": (0.08, 0.1)}
    )
    one, centre = found.corners[0], float(found.returns.fixed_point[0])
    (by_speed, by_input) = found.gain[0].tolist()
    # In the fixed point u = u* - K_y (y - y*) - K_u (u - u*).
    k = by_speed / (1 + by_input)
    w, _ = _hopping(k, 0.5, 0.08, centre)
    assert one.fixed_point == pytest.approx([w], rel=1e-9)
    a, b = 0.25, 0.25 * 0.08 / w
    loop = np.array([[a, b], [-by_speed, -by_input]])
    assert sorted(map(abs, one.multipliers)) == pytest.approx(
        sorted(np.abs(np.linalg.eigvals(loop)).tolist()), rel=1e-7
    )


@cache
def _wild() -> zo.Orbit:
    phase, speed = Juggler(amplitude=AMPLITUDE).orbit(rises=True)
    start = {"speed": speed, "cosine": math.cos(phase), "sine": math.sin(phase)}
    parameters = {"A": AMPLITUDE}
    return zo.find_orbit_by_shooting("table_juggler", parameters=parameters, start=start).unwrap()


@cache
def _juggled(method: str) -> zo.Feedback:
    return zo.design_feedback(_wild(), ["pull"], method=method, weight=0.0, uncertain=BOX)


def _by_parabolas(amplitude: float, gain: Vector, centre: Vector) -> tuple[Vector, float]:
    """Return speed and cosine of the loop, and its spectral radius, by parabolas in closed form."""
    ball = Juggler(amplitude=amplitude)

    def after(x: Vector) -> Vector:
        law = float(-gain @ (np.array([x[1], math.cos(x[0])]) - centre))
        phase, speed, _ = ball.returned(x[0], x[1], law)
        return np.array([phase - 2 * math.pi, speed])

    def slopes(x: Vector) -> Vector:
        steps = 1e-5 * np.eye(2)
        return np.stack([(after(x + e) - after(x - e)) / 2e-5 for e in steps], axis=1)

    x: Vector = np.array(ball.orbit(rises=True))
    for _ in range(12):
        x = x + np.asarray(np.linalg.solve(np.eye(2) - slopes(x), after(x) - x))
    assert after(x) == pytest.approx(x, abs=1e-12)
    radius = float(np.max(np.abs(np.linalg.eigvals(slopes(x)))))
    return np.array([x[1], math.cos(x[0])]), radius


@pytest.mark.slow
def test_least_squares_of_the_orbit_lose_a_juggled_ball_at_a_corner() -> None:
    found = _juggled("lqr")
    assert found.stable
    assert not found.robust
    assert found.worst_at == {"A": 0.017}
    for one in found.corners:
        point, radius = _by_parabolas(one.parameters["A"], found.gain[0], found.returns.fixed_point)
        assert one.fixed_point == pytest.approx(point, rel=1e-9)
        assert one.spectral_radius == pytest.approx(radius, rel=1e-7)
    assert found.worst == pytest.approx(1.19859, abs=1e-5)


@pytest.mark.weekly
@pytest.mark.slow
def test_the_robust_gain_of_a_juggled_ball_is_the_best_near_it() -> None:
    found = _juggled("robust")
    centre = found.returns.fixed_point

    def worst(gain: Any) -> float:
        return max(_by_parabolas(a, gain, centre)[1] for a in (*BOX["A"], AMPLITUDE))

    assert found.robust
    assert found.worst == pytest.approx(worst(found.gain[0]), rel=1e-7)
    assert found.worst < 0.45 * _juggled("lqr").worst
    rng = np.random.default_rng(3)
    for size in (1e-2, 0.1):
        for _ in range(8):
            other = found.gain[0] * (1 + size * rng.normal(size=2))
            assert worst(other) > found.worst - 1e-4


@pytest.mark.slow
@pytest.mark.parametrize(("method", "keeps"), [("lqr", False), ("robust", True)])
def test_a_simulation_at_the_corner_keeps_or_leaves_the_ball(method: str, keeps: bool) -> None:
    found, amplitude = _juggled(method), 0.017
    corner = found.corners[1]
    machine = found.machine()
    speed, cosine = corner.fixed_point
    start = {"speed": speed + 1e-5, "cosine": cosine, "sine": math.sqrt(1 - cosine**2)}
    start |= {"height": 0.0, "held_pull": float(found.inputs_at([speed + 1e-5, cosine])[0])}
    known = {name: start[name] for name in machine.state_names if name in start}
    run = zo.simulate(machine, parameters={"A": amplitude}, start=known, until=60 * 2 * np.pi / 30)
    place = machine.state_names.index("speed")
    away = [abs(one.state_plus[place] - speed) for one in run.impacts if one.time > 1e-6]
    if keeps:
        assert len(away) == 59
        assert away[30] < 1e-10
        ratios = [b / a for a, b in pairwise(away[4:12])]
        assert float(np.mean(ratios)) == pytest.approx(corner.spectral_radius, abs=0.05)
    else:
        assert away[8] / away[4] == pytest.approx(corner.spectral_radius**4, rel=0.02)
        assert max(away) > 1e-2


def test_a_corner_without_an_orbit_is_named() -> None:
    # A table whose largest speed is below W = 0.114 m/s does not return the ball in a turn.
    found = zo.design_feedback(_wild(), {"pull": (-1e-6, 1e-6)}, uncertain={"A": (0.003, 0.016)})
    assert found.corners[0].lost
    assert found.worst == math.inf
    assert found.worst_at == {"A": 0.003}
    assert not found.robust
    assert json.loads(json.dumps(found.as_json()))["corners"][0]["lost"]


def test_parameters_that_are_derived_from_an_uncertain_one_are_derived(repelling: zo.Orbit) -> None:
    found = zo.design_feedback(repelling, ["Kd"], uncertain={"m1": (0.3, 0.301)})
    problem, corner = found.returns.problem, found.corners[1]
    values = problem.values(parameters={"m1": 0.301}).parameters
    assert values["J_rotor"] != found.returns.values.parameters["J_rotor"]
    point, gains = corner.fixed_point, {"Kd": float(corner.inputs[0])}
    assert found.returns.map(point, gains, dict(values)) == pytest.approx(point, rel=1e-9)
    alone = found.returns.map(point, gains, {"m1": 0.301})
    assert abs(alone[0] / point[0] - 1) > 1e-5


@pytest.mark.parametrize(
    ("how", "told"),
    [
        ({"method": "robust"}, "`uncertain` is needed by the method `robust`"),
        ({"uncertain": {"a": (19.0, 21.0)}}, "must not name the input `a`"),
        ({"uncertain": {"e": (0.4, 0.6)}}, "unknown name `e`"),
        ({"uncertain": {"restitution": (0.6, 0.7)}}, "lacks its value 0.5 in the orbit"),
        ({"uncertain": {"restitution": (0.6, 0.4)}}, "a lower end below its upper end"),
        ({"uncertain": {"restitution": (0.4, 1.4)}}, "`restitution` must lie in [0, 1]"),
        ({"uncertain": {"s": (0.05, math.inf)}}, "`s` must be a finite number"),
        ({"uncertain": {"s": (math.nan, 0.2)}}, "a lower end below its upper end"),
        ({"uncertain": {"s": 0.2}}, "must hold a lower and an upper end for `s`"),
        ({"uncertain": [0.2]}, "`uncertain` must map names to values"),
    ],
)
def test_wrong_ranges_are_named(how: dict[str, Any], told: str) -> None:
    with pytest.raises(InputError) as error:
        zo.design_feedback(event_orbit("hopper"), ["a"], **how)
    assert told in str(error.value)
    assert "\n" not in str(error.value)


def test_the_command_has_the_corners(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    zo.write_orbit(_wild(), "wild.json")
    words = ("feedback", "wild.json", "--input", "pull", "--weight", "0")
    answer = ask(*words, "--uncertain", "A=0.013:0.017")
    assert answer.code == NO
    assert "Multipliers with it:    -0.415455, -0.265891" in answer.out
    assert "Worst case: modulus 1.1985" in answer.out
    assert "at A = 0.017. The loop does not keep an orbit there." in answer.out
    data = ask(*words, "--uncertain", "A=0.013:0.017", "--json").data
    assert data["corners"] == _juggled("lqr").as_json()["corners"]
    assert ask(*words, "--uncertain", "A=0.0149:0.0151").code == YES
    for more, told in (
        (("--uncertain", "B=1:2"), "--uncertain B=1:2: unknown name `B`"),
        (("--method", "robust"), "--method robust: must have --uncertain NAME=LOW:HIGH"),
        (("--method", "place"), "--method place: must have --multipliers"),
        (("--uncertain", "A=1"), "must be NAME=LOW:HIGH"),
    ):
        refused = ask(*words, *more)
        assert refused.code == MISUSE
        assert told in refused.err
        assert refused.err.count("\n") == 1
