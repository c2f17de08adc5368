"""Circuits and further states: closed forms, equations derived by hand, energy, refusals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import zeno_orbits as zo
from tests.support.mechanisms import bound
from zeno_orbits import (
    Auxiliary,
    Circuit,
    CompletedSystem,
    HybridLagrangian,
    MotorBank,
    circuit_drive,
    full_drive,
    hybrid_system,
    no_drive,
)
from zeno_orbits.simulation import simulate

EXACT = 1e-12
"""Integration at 1e-13 a step over less than a hundred steps, on states of size 1."""


def _mass(*, gap: float = 100.0, gravity: float = 0.0) -> HybridLagrangian:
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    return HybridLagrangian.from_energies(
        q=q, v=v, kinetic=v**2 / 2, potential=gravity * q + q**2 / 2, gap=q + gap
    )


def _end(system: CompletedSystem, start: list[float], until: float = 1.0) -> np.ndarray:
    return np.array(simulate(bound(system), start, until=until).end_state)


def _positive(random: np.random.Generator, n: int) -> np.ndarray:
    root = random.uniform(-1.0, 1.0, (n, n))
    return root @ root.T + np.eye(n)


@pytest.mark.parametrize("seed", range(6))
def test_a_random_circuit_without_a_force_moves_by_a_matrix_exponential(seed: int) -> None:
    random = np.random.default_rng(seed)
    n_i, n_u = int(random.integers(1, 4)), int(random.integers(1, 4))
    inductance, capacitance = _positive(random, n_i), _positive(random, n_u)
    resistance, conductance = 0.3 * _positive(random, n_i), 0.2 * _positive(random, n_u)
    incidence = random.uniform(-1.0, 1.0, (n_i, n_u))
    i, u = ca.SX.sym("i", n_i), ca.SX.sym("u", n_u)
    mass = _mass()
    circuit = Circuit(
        currents=i,
        voltages=u,
        coenergy=(ca.dot(i, inductance @ i) + ca.dot(u, capacitance @ u)) / 2,
        resistance=ca.SX(resistance),
        conductance=ca.SX(conductance),
        incidence=ca.SX(incidence),
        source=ca.SX.zeros(n_i),
    )
    matrix = np.block([[-resistance, incidence], [-incidence.T, -conductance]])
    fields = np.block([[inductance, np.zeros((n_i, n_u))], [np.zeros((n_u, n_i)), capacitance]])
    start = random.uniform(-1.0, 1.0, n_i + n_u)
    expected = expm(np.linalg.solve(fields, matrix)) @ start
    system = hybrid_system(mass, circuit_drive(mass, circuit), ca.SX(0.5))
    end = _end(system, [0.4, 0.0, *start])
    assert end[2:] == pytest.approx(expected, abs=EXACT)
    # Nothing acts back: the mass swings by itself.
    assert end[:2] == pytest.approx([0.4 * np.cos(1.0), -0.4 * np.sin(1.0)], abs=EXACT)


def test_a_loop_of_coil_and_capacitor_keeps_its_closed_form() -> None:
    coil, capacity, resistance, voltage = 0.5, 0.4, 0.3, 2.0
    i, u = ca.SX.sym("i"), ca.SX.sym("u")
    mass = _mass()
    circuit = Circuit(
        currents=i,
        voltages=u,
        coenergy=coil * i**2 / 2 + capacity * u**2 / 2,
        resistance=ca.SX(resistance),
        incidence=ca.SX(1),
        source=ca.SX(voltage),
    )
    # L di/dt = V - R i + u, C du/dt = -i: damped to u = -V.
    damping = resistance / (2 * coil)
    rate = np.sqrt(1 / (coil * capacity) - damping**2)
    t = 1.7
    turn = np.cos(rate * t) + damping / rate * np.sin(rate * t)
    expected_u = -voltage + voltage * np.exp(-damping * t) * turn
    expected_i = voltage / (coil * rate) * np.exp(-damping * t) * np.sin(rate * t)
    end = _end(hybrid_system(mass, circuit_drive(mass, circuit), ca.SX(0.5)), [0.0] * 4, t)
    assert end[2:] == pytest.approx([expected_i, expected_u], abs=EXACT)


def _magnet(mass: HybridLagrangian) -> tuple[Circuit, ca.SX, ca.SX]:
    """Return a coil, a capacitor whose plate moves, and a term that couples all three."""
    i, u, q = ca.SX.sym("i"), ca.SX.sym("u"), mass.q
    circuit = Circuit(
        currents=i,
        voltages=u,
        coenergy=i**2 / (2 * (1 + q**2)) + i**4 / 20 + (2 + q) * u**2 / 2 + 0.3 * q * i * u,
        resistance=ca.SX(0.4),
        conductance=ca.SX(0.1),
        incidence=ca.SX(-1),
        source=1.5 - 0.2 * i - q,
    )
    return circuit, i, u


def _magnet_by_hand(_: float, x: np.ndarray) -> np.ndarray:
    q, v, i, u = x
    size = 1 + q**2
    # phi = i / (1 + q^2) + i^3 / 5 + 0.3 q u,  Q = (2 + q) u + 0.3 q i
    matrix = np.array([[1 / size + 0.6 * i**2, 0.3 * q], [0.3 * q, 2 + q]])
    loop = 1.5 - 0.2 * i - q - 0.4 * i - u - (-2 * q * i / size**2 + 0.3 * u) * v
    node = i - 0.1 * u - (u + 0.3 * i) * v
    force = -q * i**2 / size**2 + u**2 / 2 + 0.3 * i * u
    return np.array([v, force - q, *np.linalg.solve(matrix, [loop, node])])


def test_a_coenergy_of_currents_voltages_and_position_obeys_equations_derived_by_hand() -> None:
    mass = _mass()
    start = [0.3, -0.2, 0.5, 0.7]
    system = hybrid_system(mass, circuit_drive(mass, _magnet(mass)[0]), ca.SX(0.5))
    expected: Any = solve_ivp(
        _magnet_by_hand, (0.0, 2.0), start, method="DOP853", rtol=3e-14, atol=1e-14
    )
    # SciPy's own error adds to ours.
    assert _end(system, start, 2.0) == pytest.approx(expected.y[:, -1], abs=10 * EXACT)


def test_source_heat_field_and_motion_share_the_energy() -> None:
    mass = _mass(gap=0.2, gravity=6.0)
    system = hybrid_system(mass, circuit_drive(mass, _magnet(mass)[0]), ca.SX(0.6))
    ledger = ca.SX.sym("ledger", 3)
    powers = ca.vertcat(system.input_power, system.copper_loss, system.other_loss)
    audited = replace(
        system,
        state=ca.vertcat(system.state, ledger),
        free_flow=ca.vertcat(system.free_flow, powers),
        locked_flow=ca.vertcat(system.locked_flow, powers),
        impulse_direction=ca.vertcat(system.impulse_direction, ca.SX.zeros(3)),
    )
    dynamics = bound(audited)
    run = simulate(dynamics, [0.3, -0.2, 0.5, 0.7, 0.0, 0.0, 0.0], until=3.0)
    lost = sum(
        (1 - 0.6**2) / 2 * dynamics.normal_inertia(one.state_minus) * one.approach_rate**2
        for one in run.impacts
    )
    lost += sum(
        dynamics.normal_inertia(one.state) * one.last_speed**2 / 2 for one in run.zeno_points
    )
    end = run.end_state
    gained = dynamics.energy(end) - dynamics.energy(np.array(run.arcs[0].start_state))
    assert len(run.impacts) > 3
    assert run.zeno_points
    assert end[-3] == pytest.approx(end[-2] + end[-1] + lost + gained, abs=1e-10)
    assert min(end[-3], end[-2], lost) > 0.01


def _valve(circuit: Callable[[HybridLagrangian], zo.CompletedSystem]) -> np.ndarray:
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    valve = HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=2e-4 * v**2 / 2,
        potential=0.05 * q + 0.01 * q**2 / 2,
        gap=q,
        passive_force=-2e-4 * v,
    )
    return _end(circuit(valve), [0.0, 0.0, 0.0], 1.0)


def test_a_bank_of_motors_is_the_circuit_of_its_coenergy() -> None:
    def by_bank(valve: HybridLagrangian) -> CompletedSystem:
        bank = MotorBank(
            selection=ca.SX(1),
            resistance=ca.SX(0.5),
            inductance=ca.SX(0.1),
            torque_constant=ca.SX(0.05),
            emf_constant=ca.SX(0.05),
            voltage=2.0 - 10.0 * valve.q,
        )
        return hybrid_system(valve, full_drive(valve, bank), ca.SX(0.3))

    def by_coenergy(valve: HybridLagrangian) -> CompletedSystem:
        i = ca.SX.sym("i")
        circuit = Circuit(
            currents=i,
            coenergy=0.1 * i**2 / 2 + 0.05 * i * valve.q,
            resistance=ca.SX(0.5),
            source=2.0 - 10.0 * valve.q,
        )
        return hybrid_system(valve, circuit_drive(valve, circuit), ca.SX(0.3))

    assert _valve(by_bank) == pytest.approx(_valve(by_coenergy), abs=EXACT, rel=EXACT)


def test_the_voltage_of_a_bank_may_depend_on_its_current() -> None:
    # V = V0 - r i adds r to the resistance.
    def valve_with(resistance: float, fed_back: float) -> np.ndarray:
        def system(valve: HybridLagrangian) -> CompletedSystem:
            current = ca.SX.sym("i")
            bank = MotorBank(
                selection=ca.SX(1),
                resistance=ca.SX(resistance),
                inductance=ca.SX(0.1),
                torque_constant=ca.SX(0.05),
                emf_constant=ca.SX(0.05),
                voltage=2.0 - 10.0 * valve.q - fed_back * current,
                current=current,
            )
            return hybrid_system(valve, full_drive(valve, bank), ca.SX(0.3))

        return _valve(system)

    assert valve_with(0.3, 0.2) == pytest.approx(valve_with(0.5, 0.0), abs=EXACT, rel=EXACT)


def test_further_states_follow_their_own_law_beside_a_motor() -> None:
    # z' = -2 z + q integrates q = cos t: z = (2 cos t + sin t - 2 exp(-2 t)) / 5.
    mass = _mass()
    bank = MotorBank(
        selection=ca.SX(1),
        resistance=ca.SX(1),
        inductance=ca.SX(1),
        torque_constant=ca.SX(0),
        emf_constant=ca.SX(0),
        voltage=ca.SX(1),
    )
    z = ca.SX.sym("z")
    further = Auxiliary(states=z, rate=-2 * z + mass.q)
    drives = (full_drive(mass, bank), further)
    end = _end(hybrid_system(mass, drives, ca.SX(0.5)), [1.0, 0.0, 0.0, 0.0], 1.3)
    t = 1.3
    expected = (2 * np.cos(t) + np.sin(t) - 2 * np.exp(-2 * t)) / 5
    assert end[2:] == pytest.approx([1 - np.exp(-t), expected], abs=EXACT)


def _copy(mass: HybridLagrangian, restitution: float) -> Auxiliary:
    """Return a state that copies the velocity: its force is integrated, its jumps are made."""
    z = ca.SX.sym("z")
    return Auxiliary(states=z, rate=-9.81 - mass.q, after_impact=z - (1 + restitution) * mass.v)


def test_a_state_that_jumps_with_the_velocity_stays_the_velocity() -> None:
    # The ball bounces, passes its Zeno point and rests: the copy follows all of it.
    mass = _mass(gap=0.0, gravity=9.81)
    system = hybrid_system(mass, _copy(mass, 0.6), ca.SX(0.6))
    for until in (0.3, 0.9, 1.5, 3.0):
        run = simulate(bound(system), [1.0, 0.0, 0.0], until=until)
        assert run.end_state[2] == pytest.approx(run.end_state[1], abs=1e-10)
    assert run.zeno_points
    assert any(abs(one.state_plus[2]) > 1.0 for one in run.impacts)


def test_a_jump_at_an_impact_of_no_speed_is_refused() -> None:
    mass = _mass(gap=0.0, gravity=9.81)
    z = ca.SX.sym("z")
    v = mass.v
    # The last five are one law with others at impacts, and another one on the stop.
    kinked = (ca.fabs(v), -ca.fmin(v, 0), v < 0, ca.fmin(v, 0) ** 2, ca.sqrt(v**2))
    # Another law below the stop alone, where values of about 1 are not.
    below = z + 0.2 * v + ca.fmax(-mass.q, 0)
    # A jump in a small unit is held against its own size, not against one.
    hybrid_system(mass, Auxiliary(states=z, rate=-z, after_impact=z + 1e-12 * v), ca.SX(0.5))
    for jump in (
        ca.SX(0),
        z + v**2,
        z + 1e-12 * v**2,
        z + 1,
        *(z + 0.2 * one for one in kinked),
        below,
    ):
        further = Auxiliary(states=z, rate=-z, after_impact=jump)
        with pytest.raises(ValueError, match="`after_impact` must change the states in proportion"):
            hybrid_system(mass, further, ca.SX(0.5))


def test_a_force_without_powers_leaves_the_balance_open_and_the_certificate_says_so() -> None:
    problem = zo.load_problem("relief_valve")

    def without_powers(p: Any) -> CompletedSystem:
        lift, rate, pressure = ca.SX.sym("lift"), ca.SX.sym("rate"), ca.SX.sym("pressure")
        valve = HybridLagrangian.from_energies(
            q=lift,
            v=rate,
            kinetic=rate**2 / 2,
            potential=p["d"] * lift + lift**2 / 2,
            gap=lift,
            passive_force=-p["k"] * rate,
        )
        vessel = Auxiliary(
            states=pressure,
            rate=p["b"] * (p["q"] - lift * ca.sqrt(pressure)),
            force=pressure,
        )
        return hybrid_system(valve, vessel, p["restitution"])

    unknown = replace(problem, model=without_powers, name="unknown")
    certificate = zo.verify(zo.find_orbit(unknown).unwrap(), problem=unknown)
    assert certificate.passed
    assert certificate.open_balance
    assert "energy balance is open" in certificate.verdict()
    assert certificate.as_json()["open_balance"] is True
    assert "energy_balance" not in certificate.residuals


COIL, PLATE = ca.SX.sym("coil"), ca.SX.sym("plate")


def _circuit(**changes: Any) -> Circuit:
    usual = {
        "currents": COIL,
        "voltages": PLATE,
        "coenergy": COIL**2 / 2 + PLATE**2 / 2,
        "resistance": ca.SX(1),
        "source": ca.SX(1),
    }
    return Circuit(**{**usual, **changes})


@pytest.mark.parametrize(
    ("changes", "refusal"),
    [
        ({"incidence": ca.SX(2, 1)}, r"`incidence` must be of shape \(1, 1\), but it is \(2, 1\)"),
        ({"resistance": ca.SX(2, 2)}, r"`resistance` must be of shape \(1, 1\)"),
        ({"conductance": ca.SX(1, 2)}, r"`conductance` must be of shape \(1, 1\)"),
        ({"source": ca.SX([1, 2])}, "`source` must have 1 entries, one per current, but it has 2"),
        ({"currents": 2 * COIL}, "`currents` must hold symbols"),
        ({"currents": ca.SX(0, 1), "voltages": ca.SX(0, 1)}, "`currents` must hold the symbol"),
        ({"coenergy": ca.SX([1, 2])}, "`coenergy` must be one energy"),
    ],
)
def test_a_circuit_that_cannot_be_is_refused(changes: dict[str, Any], refusal: str) -> None:
    with pytest.raises(ValueError, match=refusal):
        _circuit(**changes)


def test_a_state_without_inductance_or_charge_is_refused() -> None:
    mass = _mass()
    for coenergy, refusal in (
        (COIL**2 / 2, "every voltage a charge that grows with it, but `plate` lacks it"),
        (PLATE**2 / 2, "every current a flux that grows with it, but `coil` lacks it"),
        (COIL**2 + PLATE**2 + mass.v, "it depends on the velocity"),
    ):
        with pytest.raises(ValueError, match=refusal):
            circuit_drive(mass, _circuit(coenergy=coenergy))


def test_a_state_without_an_equation_is_refused() -> None:
    z = ca.SX.sym("z", 2)
    with pytest.raises(ValueError, match="`rate` must have 2 entries, one per state, but it has 1"):
        Auxiliary(states=z, rate=-z[0])


def test_a_force_of_another_number_of_coordinates_is_refused() -> None:
    z = ca.SX.sym("z")
    with pytest.raises(ValueError, match="`force` must have 1 entries, one per coordinate"):
        hybrid_system(_mass(), Auxiliary(states=z, rate=-z, force=ca.SX([1, 2])), ca.SX(0.5))


def test_drives_that_share_a_state_or_are_none_are_refused() -> None:
    mass, z = _mass(), ca.SX.sym("z")
    one = Auxiliary(states=z, rate=-z)
    with pytest.raises(ValueError, match="`drive` must hold symbols, but it holds the same"):
        hybrid_system(mass, (one, one), ca.SX(0.5))
    wrong: Any = (no_drive(mass), _circuit())
    with pytest.raises(ValueError, match="but it holds a `Circuit`; see `circuit_drive`"):
        hybrid_system(mass, wrong, ca.SX(0.5))


def _problem(coenergy: Callable[[ca.SX, ca.SX], ca.SX], **changes: Any) -> zo.Problem:
    def model(p: Any) -> CompletedSystem:
        mass = _mass(gap=0.0, gravity=9.81)
        i, u = ca.SX.sym("i"), ca.SX.sym("u")
        circuit = Circuit(
            currents=i,
            voltages=u,
            coenergy=coenergy(i, u),
            resistance=p["R"] * changes.get("resistance", 1.0),
            conductance=changes.get("conductance"),
            incidence=ca.SX(1),
            source=changes.get("source", ca.SX(1)),
        )
        return hybrid_system(mass, circuit_drive(mass, circuit), p["restitution"])

    return zo.Problem(
        name="trial",
        title="trial",
        source="test",
        state_names=("q", "v", "i", "u"),
        state_units=changes.get("units", ("m", "m/s", "A", "V")),
        parameters=(
            zo.Quantity.positive("R", 1.0, changes.get("ohm", "ohm"), "resistance"),
            zo.Quantity.restitution(0.5),
        ),
        gains=(),
        model=model,
        starts=({"q": 1.0},),
        portraits=(("q", "v"),),
        amplitude_of="q",
    )


def _fields(i: ca.SX, u: ca.SX) -> ca.SX:
    return i**2 / 2 + 1e-6 * u**2 / 2


def test_a_coenergy_that_is_not_convex_is_refused_when_it_is_loaded() -> None:
    assert _problem(_fields).checked()
    others: list[Callable[[ca.SX, ca.SX], ca.SX]] = [
        lambda i, u: -(i**2) / 2 + u**2 / 2,
        lambda i, u: i**2 / 2 - 1e-9 * u**2 / 2,
        lambda i, u: i**2 / 2 + u**2 / 2 + 2 * i * u,
    ]
    for coenergy in others:
        with pytest.raises(ValueError, match="`coenergy` must be convex in the currents"):
            _problem(coenergy).checked()


def test_an_unknown_symbol_is_refused_by_the_name_of_its_entry() -> None:
    with pytest.raises(ValueError, match=r"`source` must use states.* another symbol, `stray`"):
        _problem(_fields, source=ca.SX.sym("stray")).checked()


def test_the_units_of_currents_and_voltages_are_checked() -> None:
    for units, refusal in (
        (("m", "m/s", "V", "V"), "the current `i` the unit A, but it is `V`"),
        (("m", "m/s", "A", "C"), "the voltage `u` the unit V, but it is `C`"),
        (("m", "m/s", "A", "voltz"), "`voltz`"),
    ):
        with pytest.raises(ValueError, match=refusal):
            _problem(_fields, units=units).checked()
    small = ("mm", "mm/s", "A", "kg mm^2/s^3 A")
    assert _problem(_fields, units=small, ohm="kg mm^2/s^3 A^2").checked()


NO_FORMULAS: list[Any] = [None, ca.MX.sym("z"), "z", 1j, [ca.SX.sym("z")], float("nan")]


@pytest.mark.parametrize("given", NO_FORMULAS, ids=lambda given: type(given).__name__)
@pytest.mark.parametrize("name", ["coenergy", "resistance", "source"])
def test_what_is_no_formula_is_refused_by_the_name_of_its_entry(name: str, given: Any) -> None:
    i, z = ca.SX.sym("i"), ca.SX.sym("z")
    parts: dict[str, Any] = {"currents": i, "coenergy": i**2 / 2, "resistance": 1.0, "source": 0.0}
    changes: dict[str, Any] = {**parts, name: given}
    with pytest.raises(ValueError, match=f"^Argument `{name}` must be a number or a formula"):
        Circuit(**changes)
    further: dict[str, Any] = {"states": z, "rate": -z}
    for entry in ("states", "rate", "force", "loss"):
        if given is None and entry in ("force", "loss"):
            continue
        changed: dict[str, Any] = {**further, entry: given}
        with pytest.raises(ValueError, match=f"^Argument `{entry}` must be a number or a formula"):
            Auxiliary(**changed)


def test_a_state_of_the_mechanism_is_no_further_state() -> None:
    mass = _mass()
    for symbol, what in ((mass.q, "a coordinate"), (mass.v, "a velocity")):
        further = Auxiliary(states=symbol, rate=-symbol)
        with pytest.raises(ValueError, match=f"`states` must hold .* one is {what} of the mech"):
            hybrid_system(mass, further, ca.SX(0.5))


def test_a_resistance_that_feeds_energy_in_is_refused_when_it_is_loaded() -> None:
    assert _problem(_fields, conductance=ca.SX(0.5)).checked()
    with pytest.raises(ValueError, match=r"`resistance` must lose energy.* eigenvalue is -3: .*"):
        _problem(_fields, resistance=-3.0).checked()
    with pytest.raises(ValueError, match=r"`conductance` must lose energy.* eigenvalue is -0.5"):
        _problem(_fields, conductance=ca.SX(-0.5)).checked()


def test_a_field_that_loses_its_convexity_on_the_way_is_refused() -> None:
    # Convex at the start, where no current flows, and up to a current of 1 / sqrt(3) only.
    def saturating(i: ca.SX, u: ca.SX) -> ca.SX:
        return i**2 / 2 - i**4 / 4 + u**2 / 2

    with pytest.raises(ValueError, match=r"`coenergy` must be convex .* state near it"):
        _problem(saturating, source=ca.SX(5.0)).checked()
