"""The bundled problems: each goes all the way, and what is known of it comes out."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.reference import library_truth as truth
from tests.reference.reference_orbit import PERIOD
from tests.support.cases import fast
from tests.support.one_stop import one_stop_problems
from zeno_orbits import orbit_from_json, write_orbit
from zeno_orbits.cli import main
from zeno_orbits.model import bind, load_problem, powers_of
from zeno_orbits.orbits import Orbit
from zeno_orbits.report.plots import has_zeno_region, plot_outputs
from zeno_orbits.search import orbit_at_gains
from zeno_orbits.simulation import simulate

NO_ORBIT = {"bouncing_ball", "falling_pendulum"}
"""Nothing drives these: they come to rest."""

CLOSED_FORM = 1e-10
"""What every published figure of a problem in closed form has to agree to, relative to its size."""

PROBLEMS = [
    fidelity.name for name in one_stop_problems() for fidelity in load_problem(name).ladder()
]


@cache
def _orbit(name: str) -> Orbit:
    """Return a problem's orbit at its own numbers, found once."""
    problem = load_problem(name)
    return orbit_at_gains(problem, problem.values()).unwrap()


def _answer(capsys: pytest.CaptureFixture[str], *words: str) -> Any:
    """Return what a command prints for programs."""
    assert main([*words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def _parameters(name: str, **changes: float) -> Mapping[str, float]:
    return load_problem(name).values(parameters=changes).parameters


def _marked(name: str) -> Any:
    slow = name.startswith(("motor_pendulum", "motor_cart", "two_motors"))
    return pytest.param(name, marks=[pytest.mark.slow] if slow else [])


# Every problem, every command.


@pytest.mark.parametrize("name", [_marked(name) for name in PROBLEMS])
@pytest.mark.slow
def test_every_problem_goes_through_every_command(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "orbit.json"
    # No formula names a table.
    assert main(["zeno-condition", name]) == (2 if name == "measured_valve" else 0)
    assert ("d2h/dt2 = " in capsys.readouterr().out) == (name != "measured_valve")
    run = ["--plot", str(tmp_path / "run.png"), "-o", str(tmp_path / "run.csv")]
    assert main(["simulate", name, "--until", "1", *run]) == 0
    found = main(["search", name, "-o", str(file)])
    assert found == (1 if name in NO_ORBIT else 0)
    assert file.exists() == (name not in NO_ORBIT)
    if name in NO_ORBIT:
        assert "comes to rest" in capsys.readouterr().out
        return
    assert main(["verify", str(file)]) == 0
    assert main(["plot", str(file), "-o", str(tmp_path)]) == 0
    pictures = {"portraits", "time", "run"}
    problem = load_problem(name)
    dynamics = problem.dynamics(problem.values())
    if _orbit(name).shape.n_releases:
        pictures |= {"zeno", "region"} if has_zeno_region(dynamics) else {"zeno"}
    pictures |= {"outputs"} if problem.outputs else set()
    assert {path.stem for path in tmp_path.glob("*.png")} == pictures


@pytest.mark.parametrize(
    "name", fast(4, [one for one in PROBLEMS if "omega" in load_problem(one).names])
)
def test_a_forced_orbit_has_the_period_of_its_forcing(name: str) -> None:
    orbit = _orbit(name)
    turn = 2 * math.pi / orbit.parameters["omega"]
    # The solver's own agreement is 3e-10 at worst.
    assert orbit.period == pytest.approx(turn, rel=1e-9)


# The closed forms, from the command line.


def _hold(times: Sequence[float], speeds: Sequence[float], known: truth.Sequence) -> None:
    assert len(times) >= 6
    for seen, exact in zip(times, known.times, strict=False):
        assert seen == pytest.approx(float(exact), rel=CLOSED_FORM)
    fastest = float(max(known.speeds))
    for seen, exact in zip(speeds, known.speeds, strict=False):
        assert seen == pytest.approx(float(exact), abs=CLOSED_FORM * fastest)


def _hold_orbit(found: Any, speed: str, known: truth.Sequence, period: float) -> None:
    orbit = orbit_from_json(found, Path("orbit.json"))
    impacts = orbit.impacts
    _hold([i.time for i in impacts], [-i.state_minus[speed] for i in impacts], known)
    assert orbit.zeno_time == pytest.approx(float(known.zeno_time), rel=CLOSED_FORM)
    assert found["period"] == pytest.approx(period, rel=CLOSED_FORM)


def _hold_run(run: Any, known: truth.Sequence) -> None:
    impacts = [event for event in run["events"] if event["event"] == "impact"]
    _hold([i["time"] for i in impacts], [-i["approach_rate"] for i in impacts], known)
    (zeno,) = (event for event in run["events"] if event["event"] == "zeno_point")
    assert zeno["time"] == pytest.approx(float(known.zeno_time), rel=CLOSED_FORM)


@pytest.mark.parametrize(("amplitude", "turns"), [(0.015, 1), (0.012, 1), (0.05, 2)])
def test_the_ball_on_the_table_flies_and_bounces_as_its_closed_form(
    amplitude: float, turns: int, capsys: pytest.CaptureFixture[str]
) -> None:
    found = _answer(capsys, "search", "vibrating_table", "--set", f"A={amplitude}")
    p = _parameters("vibrating_table", A=amplitude)
    _hold_orbit(found, "speed", truth.vibrating_table(p), turns * 2 * math.pi / p["omega"])
    # Where the table falls away as fast as the ball would.
    take_off = p["g"] / (p["A"] * p["omega"] ** 2)
    assert found["start_state"]["sine"] == pytest.approx(take_off, rel=CLOSED_FORM)
    assert found["start_state"]["cosine"] == pytest.approx(
        math.sqrt(1 - take_off**2), rel=CLOSED_FORM
    )


@pytest.mark.parametrize(("fall", "amplitude"), [(0.2, 0.015), (0.4, 0.013), (0.0, 0.014)])
def test_the_marble_flies_and_bounces_as_its_recursion(
    fall: float, amplitude: float, capsys: pytest.CaptureFixture[str]
) -> None:
    changes = {"fall": fall, "A": amplitude}
    words = [part for name, value in changes.items() for part in ("--set", f"{name}={value}")]
    p = _parameters("marble_table", **changes)
    known = truth.vibrating_table(p)
    _hold_orbit(
        _answer(capsys, "search", "marble_table", *words), "speed", known, 2 * math.pi / p["omega"]
    )


def test_a_table_that_shakes_by_less_than_gravity_throws_no_ball(
    capsys: pytest.CaptureFixture[str],
) -> None:
    p = _parameters("vibrating_table", A=0.0108)
    assert p["A"] * p["omega"] ** 2 < p["g"]
    assert main(["search", "vibrating_table", "--set", "A=0.0108"]) == 1
    assert "comes to rest" in capsys.readouterr().out


@pytest.mark.parametrize(("angle", "e"), [(1.8, 0.6), (0.5, 0.2), (2.6, 0.8)])
def test_the_pendulum_falls_on_its_stop_in_elliptic_integrals(
    angle: float, e: float, capsys: pytest.CaptureFixture[str]
) -> None:
    run = _answer(
        capsys,
        *("simulate", "falling_pendulum", "--until", "30"),
        *("--start", f"angle={angle}", "--set", f"restitution={e}"),
    )
    known = truth.falling_pendulum(_parameters("falling_pendulum", restitution=e), angle)
    _hold_run(run, known)
    speeds = [-event["approach_rate"] for event in run["events"] if event["event"] == "impact"]
    for before, after in pairwise(speeds):
        # Energy keeps between impacts, so the ratio is the restitution.
        assert after / before == pytest.approx(e, rel=CLOSED_FORM)


@pytest.mark.parametrize(("x", "y", "dx"), [(0.03, 0.2, 0.1), (-0.05, 0.1, 0.0), (0.0, 0.1, 0.4)])
def test_the_ball_thrown_into_a_bowl_bounces_as_parabolas_do(
    x: float, y: float, dx: float, capsys: pytest.CaptureFixture[str]
) -> None:
    run = _answer(
        capsys,
        *("simulate", "curved_surface", "--until", "2", "--set", "A=0", "--set", "c=0"),
        *(
            "--start",
            f"x={x}",
            "--start",
            f"y={y}",
            "--start",
            f"dx={dx}",
            "--start",
            "cosine=1",
        ),
    )
    _hold_run(run, truth.bowl(_parameters("curved_surface", A=0, c=0), x, y, dx))


@pytest.mark.slow
def test_the_valve_flies_as_a_matrix_exponential_and_waits_as_a_coil_charges(
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = _answer(capsys, "search", "motor_valve")
    known, period = truth.valve(found["parameters"], found["gains"])
    _hold_orbit(found, "rate", known, float(period))
    p = found["parameters"]
    # The seat lets go where the torque of the current is the preload.
    release = p["preload"] / p["K_torque"]
    assert found["start_state"]["current"] == pytest.approx(release, rel=CLOSED_FORM)
    assert found["floquet_multipliers"] == []


# What is known of the others: their release by hand, a limit, and a second integration.


def _links(p: Mapping[str, float]) -> tuple[float, float, float, float, float]:
    """Return the letters `A` to `E` of theory (2.2)."""
    return (
        p["I1"] + p["m1"] * p["lc1"] ** 2 + p["m2"] * p["L1"] ** 2 + p.get("J_rotor", 0.0),
        p["I2"] + p["m2"] * p["lc2"] ** 2,
        p["m2"] * p["L1"] * p["lc2"],
        p["m1"] * p["lc1"] + p["m2"] * p["L1"],
        p["m2"] * p["lc2"],
    )


def _pull(p: Mapping[str, float], angle: float, torque1: float, torque2: float) -> float:
    """Return d2h/dt2 of the links at rest on their stop, torques at both joints."""
    a, b, c, d, e = _links(p)
    weight = p["g"] * ((a + c) * e - (b + c) * d) * math.sin(angle)
    return ((a + b + 2 * c) * torque2 - (b + c) * torque1 - weight) / (a * b - c**2)


def test_the_knee_of_the_torque_pendulum_lets_go_where_the_law_by_hand_vanishes() -> None:
    orbit = _orbit("torque_pendulum")
    p, x = orbit.parameters, orbit.release_state
    torque = p["A"] * x["cosine"] - p["b1"] * x["dtheta1"]
    # Of terms of some 30 rad/s^2.
    assert _pull(p, x["theta1"], torque, 0.0) == pytest.approx(0.0, abs=1e-8)


@pytest.mark.slow
def test_the_knee_of_two_motors_lets_go_where_the_law_by_hand_vanishes() -> None:
    orbit = _orbit("two_motors")
    p, x = orbit.parameters, orbit.release_state
    torques = p["K_torque"] * x["current1"], p["K_torque2"] * x["current2"]
    assert abs(p["K_torque2"] * x["current2"]) > 1e-4
    assert _pull(p, x["theta1"], *torques) == pytest.approx(0.0, abs=1e-8)


@pytest.mark.slow
def test_two_motors_one_of_which_is_powerless_move_as_the_motor_pendulum() -> None:
    problem = load_problem("two_motors")
    powerless = problem.values(parameters={"K_torque2": 0.0, "K_emf2": 0.0})
    orbit = orbit_at_gains(problem, powerless).unwrap()
    assert orbit.period == pytest.approx(PERIOD, rel=1e-9)


def test_the_link_of_the_cart_is_released_where_the_cart_accelerates_by_g_tan_tilt() -> None:
    orbit = _orbit("motor_cart")
    p, x = orbit.parameters, orbit.release_state
    mass = p["M"] + p["m"] + p["J_rotor"] / p["r"] ** 2
    # On the stop cart and link are one mass; beyond this the link would have to be pulled along.
    pushed = (p["K_torque"] * x["current"] / p["r"] - p["c"] * x["dx"]) / mass
    assert pushed == pytest.approx(-p["g"] * math.tan(p["tilt"]), rel=1e-9)


def _cart_rates(p: Mapping[str, float], gains: Mapping[str, float]) -> Any:
    inertia = p["I"] + p["m"] * p["lc"] ** 2
    mass = p["M"] + p["m"] + p["J_rotor"] / p["r"] ** 2

    def rates(_: float, z: Any) -> list[float]:
        x, angle, dx, dangle, current, cosine, sine = z
        phi = angle + p["tilt"]
        coupling = p["m"] * p["lc"] * math.cos(phi)
        along = p["K_torque"] * current / p["r"] - p["c"] * dx
        along += p["m"] * p["lc"] * math.sin(phi) * dangle**2
        about = -p["b"] * dangle - p["m"] * p["g"] * p["lc"] * math.sin(phi)
        determinant = mass * inertia - coupling**2
        voltage = gains["Kp"] * (p["A"] * sine - x) - gains["Kd"] * dx
        return [
            dx,
            dangle,
            (inertia * along - coupling * about) / determinant,
            (mass * about - coupling * along) / determinant,
            (voltage - p["R"] * current - p["K_emf"] * dx / p["r"]) / p["L"],
            -p["omega"] * sine,
            p["omega"] * cosine,
        ]

    return rates


def _torque_rates(p: Mapping[str, float], _: Mapping[str, float]) -> Any:
    a, b, c, d, e = _links(p)

    def rates(_: float, z: Any) -> list[float]:
        theta1, theta2, w1, w2, cosine, sine = z
        cos2, sin2 = math.cos(theta2), math.sin(theta2)
        m11, m12, m22 = a + b + 2 * c * cos2, b + c * cos2, b
        both = p["g"] * e * math.sin(theta1 + theta2)
        torque1 = p["A"] * cosine - p["b1"] * w1 + c * sin2 * (2 * w1 * w2 + w2**2)
        torque1 -= p["g"] * d * math.sin(theta1) + both
        torque2 = -p["b2"] * w2 - c * sin2 * w1**2 - both
        determinant = m11 * m22 - m12**2
        return [
            w1,
            w2,
            (m22 * torque1 - m12 * torque2) / determinant,
            (m11 * torque2 - m12 * torque1) / determinant,
            -p["omega"] * sine,
            p["omega"] * cosine,
        ]

    return rates


@pytest.mark.parametrize(
    ("name", "rates"), [("motor_cart", _cart_rates), ("torque_pendulum", _torque_rates)]
)
def test_equations_by_hand_and_another_integrator_lead_to_the_same_first_impact(
    name: str, rates: Any
) -> None:
    orbit = _orbit(name)
    first = orbit.impacts[0]
    run = solve_ivp(
        rates(orbit.parameters, orbit.gains),
        (0.0, first.time),
        list(orbit.release_state.values()),
        method="DOP853",
        rtol=1e-13,
        atol=1e-14,
    )
    # The solver's 3e-10, relative to the size of each state.
    size = np.max(np.abs(run.y), axis=1)
    expected = np.array(list(first.state_minus.values()))
    assert np.max(np.abs(run.y[:, -1] - expected) / size) < 1e-8


@pytest.mark.slow
def test_an_orbit_with_a_wrong_release_of_the_cart_is_refused(tmp_path: Path) -> None:
    orbit = _orbit("motor_cart").as_json()
    orbit["start_state"]["current"] *= 1.001
    file = tmp_path / "orbit.json"
    file.write_text(json.dumps(orbit))
    assert main(["verify", str(file)]) == 1
    write_orbit(_orbit("motor_cart"), file)
    assert main(["verify", str(file)]) == 0


# Units and outputs.

BASES = {"kg": 1e3, "m": 7.0, "s": 11.0, "A": 0.3}
"""How many of other units make one SI unit; the radian stays what it is."""


def _factor(unit: str) -> float:
    return math.prod(BASES.get(base, 1.0) ** power for base, power in powers_of(unit).items())


# The knots of a table are numbers, whose unit is that of its argument: they do not change with it.
@pytest.mark.parametrize("name", [_marked(name) for name in PROBLEMS if name != "measured_valve"])
def test_the_units_of_a_problem_are_those_of_its_equations(name: str) -> None:
    # In other units every number changes by its unit's factor, and so must every rate; the joule
    # of the energy, too. A unit that is declared falsely breaks it.
    problem = load_problem(name)
    values = problem.values()
    quantities = (*problem.gains, *problem.parameters)
    numbers = np.array(values.vector)
    changed = numbers * [_factor(quantity.unit) for quantity in quantities]
    sizes = np.array([_factor(unit) for unit in problem.state_units])
    compiled = problem.compiled()
    here, there = bind(compiled, numbers), bind(compiled, changed)
    random = np.random.default_rng(0)
    for _ in range(3):
        x = random.uniform(0.2, 0.8, sizes.size)
        rate, expected = there.free.rate(sizes * x), sizes / BASES["s"] * here.free.rate(x)
        assert rate == pytest.approx(expected, rel=1e-9, abs=1e-12 * np.max(np.abs(expected)))
        locked, expected = there.locked.rate(sizes * x), sizes / BASES["s"] * here.locked.rate(x)
        assert locked == pytest.approx(expected, rel=1e-9, abs=1e-12 * np.max(np.abs(expected)))
        assert there.energy(sizes * x) == pytest.approx(_factor("J") * here.energy(x), rel=1e-9)


def test_a_unit_that_is_declared_falsely_would_break_it() -> None:
    problem = load_problem("motor_valve")
    numbers = dict(problem.values().parameters)
    changed = {q.name: numbers[q.name] * _factor(q.unit) for q in problem.parameters}
    changed["J"] = numbers["J"] * _factor("kg m")
    compiled = problem.compiled()
    gains = [10.0 * _factor("V/rad"), 0.0]
    here = bind(compiled, problem.values().vector)
    there = bind(compiled, [*gains, *changed.values()])
    x, sizes = np.array([0.3, 0.4, 0.5]), np.array([_factor(u) for u in problem.state_units])
    expected = sizes / BASES["s"] * here.free.rate(x)
    assert there.free.rate(sizes * x)[1] != pytest.approx(expected[1], rel=0.5)


def test_outputs_are_what_their_formulas_say() -> None:
    problem = load_problem("vibrating_table")
    values = problem.values(parameters={"A": 0.02})
    states = np.array([[0.1, 0.0, 0.6, 0.8], [0.0, -1.0, 1.0, 0.0], [0.3, 0.0, 0.0, -1.0]])
    seen = problem.output_values(values, states)
    assert seen == pytest.approx(np.array([[0.016, 0.116], [0.0, 0.0], [-0.02, 0.28]]))


def test_outputs_are_drawn_over_the_whole_time_with_their_units() -> None:
    problem = load_problem("vibrating_table")
    values = problem.values()
    dynamics = problem.dynamics(values)
    run = simulate(dynamics, problem.state_vector(problem.starts[0]), until=0.5)
    panels = plot_outputs(problem, values, run).axes
    assert [ax.get_ylabel() for ax in panels] == ["table [m]", "ball [m]"]
    drawn = np.concatenate([line.get_xydata() for line in panels[0].lines if len(line.get_xdata())])
    assert drawn[:, 0].min() == 0.0
    assert drawn[:, 0].max() == pytest.approx(0.5)
    p = values.parameters
    known = p["A"] * np.sin(p["omega"] * drawn[:, 0])
    # Times of rescaled flights are rounded to 1e-15, and the integration has 1e-12.
    assert drawn[:, 1] == pytest.approx(known, abs=1e-10 * p["A"])


def test_an_output_of_a_problem_without_any_cannot_be_drawn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "orbit.json"
    write_orbit(_orbit("motor_valve"), file)
    assert main(["plot", str(file), "--kind", "outputs", "-o", str(tmp_path)]) == 2
    assert "`motor_valve` has, but it lacks outputs" in capsys.readouterr().err


def test_a_region_that_cannot_be_drawn_is_refused_before_anything_is_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["zeno-condition", "vibrating_table", "--plot", str(tmp_path / "region.png")]) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "has a clock or a holonomic constraint" in shown.err
