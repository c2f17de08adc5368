"""Problems with circuits and further states, beside equations derived by hand."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq

from tests.reference.reference_orbit import PERIOD
from tests.support.cases import fast
from zeno_orbits import (
    Circuit,
    Gear,
    HBridge,
    HybridLagrangian,
    Problem,
    PwmSettings,
    Quantity,
    circuit_drive,
    hybrid_system,
    write_orbit,
)
from zeno_orbits.arrays import Vector
from zeno_orbits.cli import main
from zeno_orbits.experiment import run_rig
from zeno_orbits.model import Contact, Controller, Rig, load_problem, load_reference
from zeno_orbits.orbits import Orbit
from zeno_orbits.search import orbit_at_gains
from zeno_orbits.simulation import simulate
from zeno_orbits.verification import verify

FINE: dict[str, Any] = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-15}
SLOWEST = 1e-5
"""Speed at which the sequences by hand end, as a part of the first one."""

Field = Callable[[float, Vector], Any]


@cache
def _orbit(name: str, **numbers: float) -> Orbit:
    problem = load_problem(name)
    return orbit_at_gains(problem, problem.values(numbers=numbers)).unwrap()


def _zeno_point(field: Field, x: Vector, e: float, pull: Callable[[float, Vector], float]) -> Any:
    """Return time, state and first impact of a sequence by hand; the gap is ``x[0]``.

    The tail is that of theory (2.7), in the flow on the stop: first order in a speed that has
    fallen so far that its square is rounding.
    """
    time, first, fastest = 0.0, 0.0, 0.0

    def gap(_: float, y: Vector) -> float:
        return y[0]

    struck: Any = gap
    struck.terminal, struck.direction = True, -1
    start = x.copy()
    while True:
        # Away from the stop first: a release touches it with a third-order contact.
        step = 1e-3 if first == 0.0 else 0.25 * 2 * start[1] / pull(time, start)
        away: Any = solve_ivp(field, (time, time + step), start, **FINE)
        run: Any = solve_ivp(field, (time + step, time + 10), away.y[:, -1], events=struck, **FINE)
        time, start = float(run.t_events[0][0]), run.y_events[0][0].copy()
        speed = -start[1]
        first, fastest = (first or time), max(fastest, speed)
        start[0], start[1] = 0.0, e * speed
        if speed < SLOWEST * fastest:
            rest = start.copy()
            rest[1] = 0.0
            tail = 2 * start[1] / (pull(time, rest) * (1 - e))
            rate = np.array(field(time, rest))
            rate[:2] = 0.0
            return time + tail, rest + tail * rate, first


# The relief valve: `y1'' = -k y1' - (y1 + d) + y3`, `y3' = b (q - y1 sqrt(y3))`.


def _valve(q: float, restitution: float = 0.2) -> Any:
    def field(_: float, y: Vector) -> Any:
        return y[1], -1.25 * y[1] - (y[0] + 10) + y[2], 20 * (q - y[0] * math.sqrt(y[2]))

    start = np.array([0.0, 0.0, 10.0])
    return _zeno_point(field, start, restitution, lambda _, y: 10 - y[2])


def test_the_orbit_of_the_relief_valve_has_the_period_of_another_program() -> None:
    orbit = _orbit("relief_valve")
    assert orbit.period == pytest.approx(2.432309875742, abs=1e-10)
    # The pressure rises by b q until it carries the preload, exactly.
    assert orbit.release_state["pressure"] == pytest.approx(10.0, abs=1e-12)
    certificate = verify(orbit, load_problem("relief_valve"))
    assert certificate.stable
    assert certificate.multipliers == ()


def test_a_start_from_an_empty_vessel_has_the_same_orbit(
    capsys: pytest.CaptureFixture[str],
) -> None:
    # The root of the pressure has no slope there. Closed, the pressure rises by b q to the preload.
    assert main(["search", "relief_valve", "--start", "pressure=0", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["period"] == pytest.approx(2.432309875742, abs=1e-10)


def test_the_relief_valve_obeys_equations_by_hand_under_another_integrator() -> None:
    orbit = _orbit("relief_valve")
    time, state, first = _valve(0.3)
    # SciPy's local errors of 1e-13 over some hundred steps, and the tail of first order.
    assert orbit.impacts[0].time == pytest.approx(first, abs=1e-10)
    assert orbit.zeno_time == pytest.approx(time, abs=1e-9)
    assert orbit.zeno_state is not None
    assert orbit.zeno_state["pressure"] == pytest.approx(state[2], abs=1e-9)
    assert orbit.period == pytest.approx(time + (10 - state[2]) / (20 * 0.3), abs=1e-9)


@pytest.mark.slow
def test_the_family_of_the_relief_valve_ends_where_it_no_longer_rests(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "family.json"
    words = [
        "continue",
        "relief_valve",
        "--parameter",
        "q=0.25:2",
        "-o",
        str(file),
        "--workers",
        "1",
    ]
    assert main(words) == 0
    assert "contact phase vanishes" in capsys.readouterr().out
    family = json.loads(file.read_text())
    ends = [
        point["value"]
        for one in family["families"]
        for point in one["ends"]
        if point["kind"] == "contact phase vanishes"
    ]
    # By hand the pressure at the Zeno point nears the preload by a power of the distance.
    flows = np.array([0.9, 0.902, 0.903])
    left = np.array([np.log(10 - _valve(q)[1][2]) for q in flows])

    def off_line(end: float) -> float:
        near, middle, far = np.log(end - flows)
        return float((left[1] - left[0]) * (far - middle) - (left[2] - left[1]) * (middle - near))

    end: Any = brentq(off_line, 0.9031, 0.906)
    # Seen: 6e-7, from the next power.
    assert ends == pytest.approx([end], abs=5e-6)


# The solenoid.


def _solenoid(p: dict[str, float], time: float, x: Vector) -> Any:
    q, v, i = x
    grown = 1 + p["slope"] * q
    inductance, change = p["L0"] / grown, -p["L0"] * p["slope"] / grown**2
    force = p["push"] - p["k"] * q - p["c"] * v + change * i**2 / 2
    voltage = p["V0"] + p["V1"] * math.cos(p["omega"] * time)
    return v, force / p["m"], (voltage - p["R"] * i - change * v * i) / inductance


def test_the_solenoid_lets_go_at_its_current_and_obeys_equations_by_hand() -> None:
    orbit = _orbit("solenoid")
    p = {**orbit.parameters, **orbit.gains}
    release = orbit.release_state
    held = math.sqrt(2 * p["push"] / (p["L0"] * p["slope"]))
    assert release["current"] == pytest.approx(held, rel=1e-12)
    assert orbit.period == pytest.approx(2 * math.pi / p["omega"], rel=1e-12)
    shift = math.atan2(release["sine"], release["cosine"]) / p["omega"]

    def field(t: float, x: Vector) -> Any:
        return _solenoid(p, t + shift, x)

    def pull(_: float, x: Vector) -> float:
        return (p["L0"] * p["slope"] * x[2] ** 2 / 2 - p["push"]) / p["m"]

    time, state, first = _zeno_point(field, np.array([0.0, 0.0, held]), p["restitution"], pull)
    assert orbit.impacts[0].time == pytest.approx(first, rel=1e-9)
    assert orbit.zeno_time == pytest.approx(time, rel=1e-8)
    # On the stop the circuit is linear: a decay beside the forced answer.
    decay, turn = p["R"] / p["L0"], p["omega"]
    left = orbit.period - time

    def forced(t: float) -> float:
        angle = turn * (t + shift)
        wave = (decay * math.cos(angle) + turn * math.sin(angle)) / (decay**2 + turn**2)
        return p["V0"] / p["R"] + p["V1"] / p["L0"] * wave

    end = forced(orbit.period) + (state[2] - forced(time)) * math.exp(-decay * left)
    assert end == pytest.approx(held, rel=1e-8)


def test_a_solenoid_with_a_constant_inductance_is_the_motor_valve() -> None:
    valve, solenoid = load_problem("motor_valve"), load_problem("solenoid")
    ours = solenoid.values(
        numbers={
            "m": 2e-4,
            "k": 0.01,
            "push": -0.05,
            "c": 2e-4,
            "L0": 0.1,
            "slope": 0.0,
            "K": 0.05,
            "R": 0.5,
            "V0": 0.2,
            "V1": 0.0,
        }
    )
    theirs = valve.values(numbers={"V0": 0.2, "Kp": 0.0, "Kd": 0.0})
    one = simulate(solenoid.dynamics(ours), (0.3, 0.0, 0.1, 1.0, 0.0), until=1.0)
    other = simulate(valve.dynamics(theirs), (0.3, 0.0, 0.1), until=1.0)
    # The clock may ask for one impact more before the limit is known.
    assert len(other.impacts) > 5
    for mine, known in zip(one.impacts, other.impacts, strict=False):
        assert mine.time == pytest.approx(known.time, rel=1e-12)
        assert mine.state_minus[:3] == pytest.approx(known.state_minus, abs=1e-12)
    assert one.zeno_points[0].time == pytest.approx(other.zeno_points[0].time, rel=1e-12)
    assert one.end_state[:3] == pytest.approx(other.end_state, abs=1e-12)


# The pendulum behind a filter.


@pytest.mark.slow
def test_the_filtered_pendulum_obeys_circuit_equations_by_hand() -> None:
    problem, pendulum = load_problem("filtered_pendulum"), load_problem("motor_pendulum")
    p = dict(problem.values().numbers)
    links = load_reference(pendulum).dynamics(pendulum.values())

    def field(_: float, x: Vector) -> Any:
        q1, q2, v1, v2, feed, current, capacitor, integral = x
        motion = links.free.rate(np.array([q1, q2, v1, v2, current]))[:4]
        asked = -p["Kp"] * q1 - p["Kd"] * v1 - p["Ki"] * integral
        return [
            *motion,
            (asked - p["R_filter"] * feed - capacitor) / p["L_filter"],
            (capacitor - p["R"] * current - p["K"] * v1) / p["L"],
            (feed - current - p["G_filter"] * capacitor) / p["C_filter"],
            q1 - p["leak"] * integral,
        ]

    start = np.array([0.6, 1.0, 0.5, 0.2, 0.1, -0.2, 0.3, 0.05])
    until = 0.2
    expected: Any = solve_ivp(field, (0.0, until), start, **FINE)
    run = simulate(problem.dynamics(problem.values()), start, until=until)
    assert not run.impacts
    # The calibrated numbers are declared to fourteen digits.
    assert run.end_state == pytest.approx(expected.y[:, -1], rel=1e-10, abs=1e-10)


@pytest.mark.slow
def test_a_vanishing_filter_leaves_the_reference_orbit_at_first_order() -> None:
    # R, L_f and C enter the slow motion linearly: each halving halves what they change.
    first_impact, zeno_angle = 0.9809551249210, 1.236168909791
    errors: list[Vector] = []
    for part in (0.5, 0.25, 0.125):
        orbit = _orbit(
            "filtered_pendulum",
            Ki=0.0,
            L_filter=5e-4 * part,
            C_filter=1e-4 * part,
            R_filter=0.1 * part,
        )
        assert orbit.zeno_state is not None
        seen = (orbit.period, orbit.impacts[0].time, orbit.zeno_state["theta1"])
        errors.append(np.array(seen) - np.array([PERIOD, first_impact, zeno_angle]))
    for larger, smaller in pairwise(errors):
        # Within a twentieth: what is left is of second order in a tenth.
        assert larger / smaller == pytest.approx(np.full(3, 2.0), rel=0.05)
    assert np.max(np.abs(errors[-1])) < 4e-3


@pytest.mark.parametrize(
    "name", ["relief_valve", "solenoid", pytest.param("filtered_pendulum", marks=pytest.mark.slow)]
)
def test_fields_sources_and_further_states_balance_over_a_period(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "orbit.json"
    assert main(["search", name, "-o", str(file)]) == 0
    capsys.readouterr()
    assert main(["verify", str(file), "--json"]) == 0
    certificate = json.loads(capsys.readouterr().out)
    assert certificate["residuals"]["energy_balance"] < 1e-10
    assert min(certificate["energies"][one] for one in ("input_work", "impact_loss")) > 0.0


# A state that impacts change.

OBSERVED = Path(__file__).parents[1] / "support" / "machines" / "observed_valve.py"


@pytest.mark.slow
def test_an_observer_that_is_told_of_impacts_forgets_its_error_at_its_own_rate() -> None:
    problem = load_problem(OBSERVED)
    orbit = orbit_at_gains(problem, problem.values()).unwrap()
    valve = _orbit("motor_valve")
    # Nothing acts back on the valve, and its own section is a point.
    assert orbit.period == pytest.approx(valve.period, rel=1e-10)
    (multiplier,) = verify(orbit, problem).multipliers
    assert multiplier == pytest.approx(math.exp(-3.0 * orbit.period), rel=1e-10)
    # On the orbit the observer has no error, on the seat it has no rate.
    assert orbit.zeno_state is not None
    assert orbit.zeno_state["observed"] == pytest.approx(0.0, abs=1e-9)
    for impact in orbit.impacts:
        seen = impact.state_minus
        assert seen["observed"] == pytest.approx(seen["rate"], abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("offset", fast(1, [0.0, 30.0]))
def test_the_energy_that_impacts_add_to_a_further_state_is_counted(
    offset: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """On the orbit the observed rate is the rate, so all of its energies are known.

    With ``E = c (z + a)^2 / 2`` and ``z' = f`` the power ``c (z + a) f`` feeds it.
    """
    text = OBSERVED.read_text()
    assert "        after_impact=" in text
    share = 1.5
    further = text.replace(
        "        after_impact=",
        f"        stored_energy={share} * p['J'] * (observed + {offset}) ** 2 / 2,\n"
        f"        input_power={share} * p['J'] * (observed + {offset})\n"
        "        * (torque / p['J'] + p['gain'] * (rate - observed)),\n"
        "        after_impact=",
    )
    file, orbit_file = tmp_path / "observed_valve.py", tmp_path / "orbit.json"
    file.write_text(further)
    assert main(["search", str(file), "-o", str(orbit_file)]) == 0
    capsys.readouterr()
    assert main(["verify", str(orbit_file), "--problem", str(file), "--json"]) == 0
    certificate = json.loads(capsys.readouterr().out)
    assert certificate["residuals"]["energy_balance"] < 1e-10
    valve = verify(_orbit("motor_valve"), load_problem("motor_valve"))
    e, inertia = 0.3, 2e-4
    mechanical = valve.energies["impact_loss"]
    # An impact at the speed w turns z = -w into e w, and w falls by e each time.
    speeds = [abs(one.approach_rate) for one in _resolved_impacts("motor_valve")]
    impulse = (1 + e) * (sum(speeds) + e * speeds[-1] / (1 - e))
    expected = (1 + share) * mechanical - share * inertia * offset * impulse
    # The tail is a geometric series to first order in its first speed, 1e-5 of the largest.
    assert certificate["energies"]["impact_loss"] == pytest.approx(expected, rel=1e-8)


def _resolved_impacts(name: str) -> Any:
    """Return the impacts of a period that a simulation resolves."""
    problem, orbit = load_problem(name), _orbit(name)
    start = problem.state_vector(orbit.release_state)
    run = simulate(problem.dynamics(problem.values()), start, until=orbit.zeno_time * 1.0001)
    return run.impacts


@pytest.mark.slow
def test_the_orbit_of_the_relief_valve_is_proved_and_checked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    orbit, proof = str(tmp_path / "orbit.json"), str(tmp_path / "proof.json")
    assert main(["search", "relief_valve", "-o", orbit]) == 0
    assert main(["prove", orbit, "-o", proof]) == 0
    assert main(["prove", "--check", proof]) == 0
    out = capsys.readouterr().out
    assert "every claim holds" in out
    assert "2.43230987574203" in out


# The rig of such problems.


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["relief_valve", pytest.param(str(OBSERVED), marks=pytest.mark.slow)]
)
def test_a_rig_whose_stop_grows_stiff_tends_to_the_orbit(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    problem = load_problem(name)
    orbit = orbit_at_gains(problem, problem.values()).unwrap()
    file = tmp_path / "orbit.json"
    write_orbit(orbit, file)
    misses: list[float] = []
    for stiffness in ("1e6", "1e8"):
        part = f"contact.stiffness={stiffness}"
        words = ["rig", str(file), "--problem", name, "--cycles", "2", "--only", "contact"]
        assert main([*words, "--part", part, "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        misses.append(abs(found["mean"]["period"] - orbit.period))
    # A stop a hundred times as stiff gives way by less, whatever the exponent.
    assert misses[1] < misses[0] / 3
    assert misses[1] < 1e-3 * orbit.period


@pytest.mark.slow
def test_a_gear_on_a_coil_that_turns_no_motor_is_refused(
    capsys: pytest.CaptureFixture[str],
) -> None:
    # The flux of the solenoid grows with the opening at a rate that depends on both.
    words = ["rig", "solenoid", "--until", "0.1", "--part", "gears.1.rotor_inertia=1e-3"]
    assert main(words) == 2
    refusal = capsys.readouterr().err
    assert "must stand on a motor: the flux of current 1" in refusal
    assert "\n" not in refusal.strip()


def test_a_bridge_without_a_source_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["rig", "relief_valve", "--until", "0.1", "--part", "bridge.supply=24"]
    assert main(words) == 2
    assert "must have motors for a bridge" in capsys.readouterr().err


FILTER = {"L": 0.5, "C": 0.4, "R": 0.3, "G": 0.1, "V": 5.0, "drop": 0.2}


def _filter_of_a_far_mass() -> Problem:
    """Return a loop of source, coil and capacitor beside a mass that it does not touch."""

    def model(p: Any) -> Any:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        mass = HybridLagrangian.from_energies(
            q=q, v=v, kinetic=p["m"] * v**2 / 2, potential=p["m"] * q**2 / 2, gap=q + 100
        )
        i, u = ca.SX.sym("i"), ca.SX.sym("u")
        circuit = Circuit(
            currents=i,
            voltages=u,
            coenergy=FILTER["L"] * i**2 / 2 + FILTER["C"] * u**2 / 2,
            resistance=ca.SX(FILTER["R"]),
            conductance=ca.SX(FILTER["G"]),
            incidence=ca.SX(-1),
            source=ca.SX(FILTER["V"]),
        )
        return hybrid_system(mass, circuit_drive(mass, circuit), p["restitution"])

    return Problem(
        name="far_mass",
        title="a filter beside a mass",
        source="test",
        state_names=("q", "v", "i", "u"),
        state_units=("m", "m/s", "A", "V"),
        parameters=(Quantity.positive("m", 1.0, "kg", "mass"), Quantity.restitution(0.5)),
        gains=(),
        model=model,
        starts=({"q": 0.0},),
        portraits=(("q", "v"),),
        amplitude_of="q",
    )


def test_a_bridge_pulses_the_source_of_a_filter_as_matrix_exponentials_do() -> None:
    problem, supply, frequency, periods = _filter_of_a_far_mass(), 12.0, 50.0, 40
    bridge = HBridge(
        supply=supply,
        frequency=frequency,
        resistance=FILTER["drop"],
        dead_time=0.0,
        switching=PwmSettings.EXACT,
    )
    rig = Rig(contact=Contact(stiffness=1e3), bridge=bridge)
    run = run_rig(problem, problem.values(), rig, (0.0,) * 4, periods / frequency)
    # L i' = V - (R + drop) i - u, C u' = i - G u: on for the part V / supply of every period.
    coil, capacity = FILTER["L"], FILTER["C"]
    matrix = np.array(
        [
            [-(FILTER["R"] + FILTER["drop"]) / coil, -1 / coil],
            [1 / capacity, -FILTER["G"] / capacity],
        ]
    )
    on = FILTER["V"] / supply / frequency
    x, pushed = np.zeros(2), np.linalg.solve(matrix, [-supply / coil, 0.0])
    for _ in range(periods):
        x = pushed + expm(matrix * on) @ (x - pushed)
        x = expm(matrix * (1 / frequency - on)) @ x
    assert run.states[-1, 2:4] == pytest.approx(x, rel=1e-9)


def _bank_as_circuit(p: Any) -> Any:
    """Return `motor_valve` with its motor as a circuit of its coenergy."""
    opening, rate, current = ca.SX.sym("opening"), ca.SX.sym("rate"), ca.SX.sym("current")
    valve = HybridLagrangian.from_energies(
        q=opening,
        v=rate,
        kinetic=p["J"] * rate**2 / 2,
        potential=p["preload"] * opening + p["k"] * opening**2 / 2,
        gap=opening,
        passive_force=-p["c"] * rate,
    )
    circuit = Circuit(
        currents=current,
        coenergy=p["L"] * current**2 / 2 + p["K_emf"] * opening * current,
        resistance=p["R"],
        source=p["V0"] - p["Kp"] * opening - p["Kd"] * rate,
    )
    return hybrid_system(valve, circuit_drive(valve, circuit), p["restitution"])


@pytest.mark.parametrize("switching", [PwmSettings.AVERAGED, PwmSettings.EXACT])
def test_bridge_gear_and_controller_take_a_circuit_as_the_bank_that_it_is(
    switching: PwmSettings,
) -> None:
    bank = load_problem("motor_valve")
    names = [one.name for one in bank.parameters]
    assert {"J", "k", "preload", "c", "R", "L", "K_emf", "V0"} <= set(names)
    circuit = replace(bank, model=_bank_as_circuit, name="circuit_valve")
    rig = Rig(
        contact=Contact(stiffness=1e3),
        gears={1: Gear(rotor_inertia=1e-4, play=1e-3, stiffness=50.0)},
        bridge=HBridge(
            supply=6.0, frequency=2000.0, resistance=0.1, dead_time=0.0, switching=switching
        ),
        controller=Controller(period=1e-3, delay=2e-4),
    )
    runs = [run_rig(one, one.values(), rig, (0.0, 0.0, 1.2), 0.1) for one in (bank, circuit)]
    assert len(runs[0].states[0]) == 5
    assert max(np.ptp(runs[0].states[:, 0]), np.ptp(runs[0].states[:, 3])) > 0.1
    assert runs[1].states[-1] == pytest.approx(runs[0].states[-1], rel=1e-8, abs=1e-8)


@pytest.mark.slow
def test_a_filtered_motor_behind_a_gear_obeys_equations_by_hand() -> None:
    problem, pendulum = load_problem("filtered_pendulum"), load_problem("motor_pendulum")
    p, stiffness, inertia = dict(problem.values().numbers), 40.0, 0.01
    # Half of the rotor is on the motor's side of the teeth: the links lose its inertia.
    links = load_reference(pendulum).dynamics(
        pendulum.values(
            parameters={
                "J_rotor": p["J_rotor"] - inertia,
                "K_torque": p["K"],
                "K_emf": p["K"],
            }
        )
    )

    def field(_: float, x: Vector) -> Any:
        q1, q2, v1, v2, feed, current, capacitor, integral, angle, rate = x
        teeth = stiffness * (angle - q1)
        motion = links.free.rate(np.array([q1, q2, v1, v2, teeth / p["K"]]))[:4]
        asked = -p["Kp"] * q1 - p["Kd"] * v1 - p["Ki"] * integral
        return [
            *motion,
            (asked - p["R_filter"] * feed - capacitor) / p["L_filter"],
            (capacitor - p["R"] * current - p["K"] * rate) / p["L"],
            (feed - current - p["G_filter"] * capacitor) / p["C_filter"],
            q1 - p["leak"] * integral,
            rate,
            (p["K"] * current - teeth) / inertia,
        ]

    start = np.array([0.6, 1.0, 0.5, 0.2, 0.1, -0.2, 0.3, 0.05])
    until = 0.2
    whole = [*start, 0.6, 0.5]
    expected: Any = solve_ivp(field, (0.0, until), whole, **FINE)
    gear = Gear(rotor_inertia=inertia, play=0.0, stiffness=stiffness, loss=0.0)
    rig = Rig(contact=Contact(stiffness=1e6), gears={2: gear})
    run = run_rig(problem, problem.values(), rig, start, until)
    assert not run.touches
    assert run.states[-1] == pytest.approx(expected.y[:, -1], rel=1e-7, abs=1e-7)
    # The teeth give way, by much more than the tolerance.
    assert abs(expected.y[8, -1] - expected.y[0, -1]) > 1e-4


def test_a_controller_holds_the_source_of_a_circuit() -> None:
    # The held voltage lags by half a period of the controller, so the miss is of first order.
    problem = load_problem("filtered_pendulum")
    values, start = problem.values(), (0.6, 1.0, *[0.0] * 6)
    exact = simulate(problem.dynamics(values), start, until=0.1)
    misses: list[float] = []
    for period in (1e-3, 2.5e-4):
        rig = Rig(contact=Contact(stiffness=1e6), controller=Controller(period=period))
        run = run_rig(problem, values, rig, start, 0.1)
        assert not run.touches
        misses.append(float(run.states[-1, 0] - exact.end_state[0]))
    assert misses[0] / misses[1] == pytest.approx(4.0, rel=0.1)
