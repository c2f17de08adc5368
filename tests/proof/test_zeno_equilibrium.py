"""Theorem 1 at a state: the neighbourhood holds what it promises, and points that are none."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.cases import fast
from tests.support.impact_laws import LAWS, ball
from zeno_orbits.cli import main
from zeno_orbits.errors import InputError
from zeno_orbits.model import HybridDynamics
from zeno_orbits.proof import ZenoNeighbourhood, equilibrium_report
from zeno_orbits.simulation import simulate

POINTS: dict[str, tuple[dict[str, float], dict[str, float]]] = {
    "bouncing_ball": ({}, {}),
    "relief_valve": ({}, {"pressure": 5.0}),
    "motor_valve": ({"restitution": 0.8}, {"current": 0.4}),
    "solenoid": ({}, {"current": 0.3, "cosine": 1.0}),
    "motor_pendulum": ({}, {"theta1": 1.2, "dtheta1": 1.7, "current": -0.46}),
}
"""Problem to parameters that differ, and to a state on the stop that holds it."""


def _states(dynamics: HybridDynamics, found: ZenoNeighbourhood, number: int) -> list[np.ndarray]:
    """Return states drawn from a neighbourhood, every second one from its edges."""
    random = np.random.default_rng(7)
    states: list[np.ndarray] = []
    while len(states) < number:
        share = random.uniform(-1.0, 1.0, len(found.centre))
        shares = np.sign(share) if len(states) % 2 else share
        x = np.array(found.centre) + 0.999 * shares * np.array(found.radii)
        for k, other in [dynamics.clock] if dynamics.clock else []:
            x[k], x[other] = np.array([x[k], x[other]]) / math.hypot(x[k], x[other])
        x = dynamics.on_stop(x)
        height, rate = random.uniform(0.0, 1.0), random.uniform(-1.0, 1.0)
        if len(states) % 4 == 3:
            height, rate = 1.0, random.choice([-1.0, 1.0])
        direction, n_q = dynamics.impulse_direction(x), dynamics.n_q
        x[:n_q] += 0.999 * height * found.gap * direction[n_q : 2 * n_q]
        x += 0.999 * rate * found.gap_rate * direction
        if found.contains(dynamics, x):
            states.append(x)
    return states


@pytest.mark.parametrize("name", fast(2, POINTS))
def test_impacts_accumulate_in_time_from_every_state_of_the_neighbourhood(name: str) -> None:
    parameters, at = POINTS[name]
    problem = zo.load_problem(name)
    values = problem.values(parameters=parameters)
    report = equilibrium_report(problem, values, problem.state_vector(at))
    found, dynamics = report.neighbourhood, problem.dynamics(values)
    assert report.has_zeno_executions
    assert found is not None
    assert min(found.radii) > 0.0 < found.gap_rate
    for x in _states(dynamics, found, 500):
        run = simulate(dynamics, x, until=found.duration)
        assert run.zeno_points, x
        assert run.zeno_points[0].time <= found.duration
        pull = -dynamics.gap_acceleration(run.zeno_points[0].state)
        assert found.pull[0] <= pull <= found.pull[1]


def test_the_bound_of_a_ball_is_the_closed_form() -> None:
    # Thrown up at V from H = V^2 / (2 g): down after V (1 + sqrt 2) / g at the speed sqrt(2) V.
    # Then the impacts take 2 e sqrt(2) V / (g (1 - e)).
    problem = zo.load_problem("bouncing_ball")
    values = problem.values()
    found = equilibrium_report(problem, values, (0.0, 0.0)).neighbourhood
    assert found is not None
    e, g, rate = values.number("restitution"), 9.81, found.gap_rate
    first, speed = rate * (1 + math.sqrt(2)) / g, math.sqrt(2) * rate
    exact = first + 2 * e * speed / (g * (1 - e))
    # The bounds are widened by parts in 1e9, which 1 / (1 - e) magnifies.
    assert found.duration == pytest.approx(exact, rel=1e-7)
    assert found.duration > exact
    assert found.gap == pytest.approx(rate**2 / (2 * g), rel=1e-7)


@pytest.mark.parametrize("fall", [-0.3, 0.2])
def test_a_law_of_the_speed_counts_with_its_largest_restitution(fall: float) -> None:
    problem = ball(LAWS["linear"])
    values = problem.values(parameters={"e0": 0.6, "c": fall})
    found = equilibrium_report(problem, values, (0.0, 0.0)).neighbourhood
    assert found is not None
    # As for a constant restitution, with that at the largest speed, or at zero if it falls.
    g, rate = values.number("g"), found.gap_rate
    speed = math.sqrt(2) * rate
    e = 0.6 + max(-fall, 0.0) * speed
    assert 0.0 < e < 1.0
    exact = rate * (1 + math.sqrt(2)) / g + 2 * e * speed / (g * (1 - e))
    assert found.duration == pytest.approx(exact, rel=1e-6)
    dynamics = problem.dynamics(values)
    for x in _states(dynamics, found, 40):
        run = simulate(dynamics, x, until=found.duration)
        assert run.zeno_points
        assert run.zeno_points[0].time <= found.duration


@pytest.mark.slow
def test_a_law_without_bounds_has_no_neighbourhood() -> None:
    root, capped = ball(LAWS["root"]), ball(LAWS["capped power"])
    report = equilibrium_report(root, root.values(), (0.0, 0.0))
    assert report.has_zeno_executions
    assert report.neighbourhood is None
    with pytest.raises(InputError, match="the operation `fmin` is not known to be analytic"):
        equilibrium_report(capped, capped.values(), (0.0, 0.0))


def _answer(capsys: pytest.CaptureFixture[str], code: int, *words: str) -> Any:
    assert main(["zeno-condition", *words, "--json"]) == code
    return json.loads(capsys.readouterr().out)["at"]


@pytest.mark.slow
def test_the_command_answers_yes_with_a_neighbourhood(capsys: pytest.CaptureFixture[str]) -> None:
    at = _answer(capsys, 0, "relief_valve", "--at", "pressure=5")
    assert at["has_zeno_executions"] is True
    # The spring's preload is 10.
    assert at["gap_acceleration"] == pytest.approx(-5.0, rel=1e-15)
    assert main(["zeno-condition", "relief_valve", "--at", "pressure=5"]) == 0
    assert "Theorem 1 holds." in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "phrase"),
    [
        (["bouncing_ball", "--at", "height=0.1"], "does not rest on the stop"),
        (["relief_valve", "--at", "pressure=5", "--at", "rate=0.1"], "does not rest on the stop"),
        (["relief_valve", "--at", "pressure=12"], "Theorem 1 does not apply"),
    ],
)
def test_a_state_without_the_conditions_gets_no(
    words: list[str], phrase: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["zeno-condition", *words]) == 1
    assert phrase in capsys.readouterr().out


@pytest.mark.slow
def test_a_state_where_the_flow_stands_still_is_no_zeno_equilibrium(
    capsys: pytest.CaptureFixture[str],
) -> None:
    # The seat without preload, the motor without a voltage: f = 0 on the stop.
    words = ["motor_pendulum", "--at", "theta1=0"]
    assert main(["zeno-condition", *words]) == 1
    assert "f = 0" in capsys.readouterr().out


def test_a_clock_off_its_circle_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["zeno-condition", "solenoid", "--at", "cosine=0.5"]) == 2
    assert "--at: must keep the constraints" in capsys.readouterr().err


def test_a_state_where_the_equations_have_no_value_is_refused(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["zeno-condition", "relief_valve", "--at", "pressure=-5"]) == 2
    assert "a rate that is not finite" in capsys.readouterr().err


PUSHED = """
import casadi as ca
from zeno_orbits import HybridLagrangian, Problem, Quantity, hybrid_system, no_drive


def model(p):
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    mass = HybridLagrangian.from_energies(
        q=q, v=v, kinetic=p["m"] * v**2 / 2, potential=p["m"] * p["g"] * q, gap=q,
        passive_force={force} - 0 * v,
    )
    return hybrid_system(mass, no_drive(mass), p["restitution"])


PROBLEM = Problem(
    name="pushed", title="ball with a force of its height", source="this test",
    state_names=("height", "speed"), state_units=("m", "m/s"),
    parameters=(Quantity.positive("m", 2.0, "kg", "mass"),
                Quantity.positive("g", 9.81, "m/s^2", "gravity"),
                Quantity.restitution(0.5)),
    gains=(), model=model, starts=({{"height": 1.0}},), portraits=(("height", "speed"),),
    amplitude_of="height",
)
"""


@pytest.mark.parametrize(
    ("force", "at_rest"),
    fast(
        6,
        [
            ("ca.cosh(q + 1)", math.cosh(1)),
            ("ca.sinh(q + 1)", math.sinh(1)),
            ("ca.tanh(q + 1)", math.tanh(1)),
            ("ca.asin(q / 4 + 0.5)", math.asin(0.5)),
            ("ca.acos(q / 4 + 0.5)", math.acos(0.5)),
            ("ca.asinh(q + 1)", math.asinh(1)),
            ("ca.acosh(q + 2)", math.acosh(2)),
            ("ca.atanh(q / 4 + 0.5)", math.atanh(0.5)),
            ("ca.atan2(q + 1, -1)", math.atan2(1, -1)),
            ("ca.log1p(q + 1)", math.log(2)),
            ("ca.expm1(q + 1)", math.e - 1),
            ("ca.hypot(q + 3, 4)", 5.0),
        ],
    ),
)
def test_forces_of_analytic_functions_have_a_neighbourhood(
    force: str, at_rest: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "pushed.py"
    path.write_text(PUSHED.format(force=force))
    at = _answer(capsys, 0, str(path), "--at", "height=0")
    expected = -9.81 + at_rest / 2
    assert at["gap_acceleration"] == pytest.approx(expected, rel=1e-14)
    low, high = at["neighbourhood"]["pull"]
    assert low <= -expected <= high


@pytest.mark.parametrize(
    ("force", "operation"),
    [
        ("ca.fabs(q)", "fabs"),
        ("ca.fmax(q, 0)", "fmax"),
        ("ca.fmin(q, 0)", "fmin"),
        ("ca.erf(q)", "erf"),
        ("ca.if_else(q < 0, q, 2 * q)", "lt"),
        ("ca.floor(q)", "floor"),
        ("ca.sign(q)", "sign"),
        ("ca.fmod(q, 2)", "fmod"),
    ],
)
def test_other_functions_are_refused_by_their_name_in_one_line(
    force: str, operation: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "pushed.py"
    path.write_text(PUSHED.format(force=force))
    assert main(["zeno-condition", str(path), "--at", "height=0"]) == 2
    told = capsys.readouterr().err.strip()
    assert len(told.splitlines()) == 1
    assert f"`{operation}`" in told
    assert "internal error" not in told


def test_the_hopf_point_of_the_relief_valve_has_its_closed_form(
    capsys: pytest.CaptureFixture[str],
) -> None:
    # lift y with pressure y + d: the polynomial s^3 + (k + a) s^2 + (1 + k a) s + a + c, with
    # a = b y / (2 sqrt(y + d)) and c = b sqrt(y + d), has the roots +- i sqrt(1 + k a).
    q, lift, frequency = 8.49111763518332712, 2.41031323768665, 3.09070884797434
    words = ["relief_valve", "--set", "k=1.25", "--set", f"q={q!r}"]
    at = ["--at", f"lift={lift!r}", "--at", f"pressure={lift + 10.0!r}"]
    found = _answer(capsys, 1, *words, *at)
    roots = sorted((complex(*one) for one in found["eigenvalues"]), key=lambda one: one.imag)
    assert roots[0].real == pytest.approx(0.0, abs=1e-12)
    assert roots[2] == pytest.approx(1j * frequency, abs=1e-12)
    assert roots[1].real < -1.0
