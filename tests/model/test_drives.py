"""Drives at three fidelities: matrices for several motors, and the limit of no inductance."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from tests.support.mechanisms import bound, evaluated
from zeno_orbits import (
    HybridLagrangian,
    MotorBank,
    full_drive,
    hybrid_system,
    ideal_torque_drive,
    no_drive,
    quasi_static_drive,
)
from zeno_orbits.simulation import simulate

SELECTION = np.array([[1.0, 0.0], [0.0, 3.0], [-1.0, 0.5]])
RESISTANCE = np.array([[2.0, 0.3], [0.3, 4.0]])
INDUCTANCE = np.array([[0.02, 0.004], [0.004, 0.05]])
TORQUE = np.array([[0.5, 0.1], [-0.2, 0.7]])
EMF = np.array([[0.4, -0.1], [0.15, 0.6]])
Q, V, CURRENT = np.array([0.3, -1.2, 0.8]), np.array([2.0, -0.7, 1.1]), np.array([0.9, -1.6])
ROUNDING = 1e-12
"""A solve with matrices of condition number below 10 on numbers of size 1 to 100."""


@pytest.fixture(name="mechanism")
def _mechanism() -> HybridLagrangian:
    q, v = ca.SX.sym("q", 3), ca.SX.sym("v", 3)
    return HybridLagrangian.from_energies(
        q=q, v=v, kinetic=ca.sumsqr(v) / 2, potential=ca.sumsqr(q) / 2, gap=q[0] + 100
    )


@pytest.fixture(name="motors")
def _motors(mechanism: HybridLagrangian) -> MotorBank:
    q, v = mechanism.q, mechanism.v
    return MotorBank(
        selection=ca.SX(SELECTION),
        resistance=ca.SX(RESISTANCE),
        inductance=ca.SX(INDUCTANCE),
        torque_constant=ca.SX(TORQUE),
        emf_constant=ca.SX(EMF),
        voltage=ca.vertcat(-3 * q[0] - v[0], 5 - 2 * q[1]),
    )


VOLTAGE = np.array([-3 * Q[0] - V[0], 5 - 2 * Q[1]])


def test_two_motors_obey_the_matrix_form_of_the_circuit_law(
    mechanism: HybridLagrangian, motors: MotorBank
) -> None:
    drive = full_drive(mechanism, motors)
    symbols = {"q": mechanism.q, "v": mechanism.v, "i": drive.states}
    values = {"q": Q, "v": V, "i": CURRENT}

    def number(expression: ca.SX) -> np.ndarray:
        return evaluated(expression, values, **symbols).squeeze()

    speed = SELECTION.T @ V
    rate = np.linalg.solve(INDUCTANCE, VOLTAGE - RESISTANCE @ CURRENT - EMF @ speed)
    assert number(drive.rates) == pytest.approx(rate, rel=ROUNDING)
    assert number(drive.force) == pytest.approx(SELECTION @ TORQUE @ CURRENT, rel=ROUNDING)
    assert number(drive.input_power) == pytest.approx(VOLTAGE @ CURRENT, rel=ROUNDING)
    assert number(drive.copper_loss) == pytest.approx(CURRENT @ RESISTANCE @ CURRENT, rel=ROUNDING)
    stored = CURRENT @ INDUCTANCE @ CURRENT / 2
    assert number(drive.stored_energy) == pytest.approx(stored, rel=ROUNDING)


def test_the_source_pays_for_heat_for_the_field_and_for_the_mechanics(
    mechanism: HybridLagrangian, motors: MotorBank
) -> None:
    drive = full_drive(mechanism, motors)
    stored_rate = ca.jtimes(drive.stored_energy, drive.states, drive.rates)
    mechanical = ca.dot(drive.force, mechanism.v)
    spent = drive.copper_loss + stored_rate + drive.other_loss + mechanical
    residual = evaluated(
        drive.input_power - spent,
        {"q": Q, "v": V, "i": CURRENT},
        q=mechanism.q,
        v=mechanism.v,
        i=drive.states,
    )
    assert abs(residual[0, 0]) < 100 * ROUNDING


def test_the_quasi_static_current_balances_the_circuit_without_inductance(
    mechanism: HybridLagrangian, motors: MotorBank
) -> None:
    drive = quasi_static_drive(mechanism, motors)
    current = np.linalg.solve(RESISTANCE, VOLTAGE - EMF @ SELECTION.T @ V)
    values = {"q": Q, "v": V}
    force = evaluated(drive.force, values, q=mechanism.q, v=mechanism.v)[:, 0]
    assert force == pytest.approx(SELECTION @ TORQUE @ current, rel=ROUNDING)
    stored = evaluated(drive.stored_energy, values, q=mechanism.q, v=mechanism.v)
    assert stored[0, 0] == 0.0


def test_only_the_full_drive_has_current_states(
    mechanism: HybridLagrangian, motors: MotorBank
) -> None:
    torque = motors.voltage
    drives = {
        8: full_drive(mechanism, motors),
        6: quasi_static_drive(mechanism, motors),
    }
    for n_x, drive in drives.items():
        assert hybrid_system(mechanism, drive, ca.SX(0.5)).state.numel() == n_x
    ideal = ideal_torque_drive(mechanism, selection=motors.selection, torque=torque)
    assert hybrid_system(mechanism, ideal, ca.SX(0.5)).state.numel() == 6
    assert hybrid_system(mechanism, no_drive(mechanism), ca.SX(0.5)).state.numel() == 6


def test_an_ideal_torque_acts_through_the_selection(
    mechanism: HybridLagrangian, motors: MotorBank
) -> None:
    drive = ideal_torque_drive(mechanism, selection=motors.selection, torque=motors.voltage)
    values = {"q": Q, "v": V}
    force = evaluated(drive.force, values, q=mechanism.q, v=mechanism.v)[:, 0]
    assert force == pytest.approx(SELECTION @ VOLTAGE, rel=ROUNDING)
    power = evaluated(drive.input_power, values, q=mechanism.q, v=mechanism.v)
    assert power[0, 0] == pytest.approx(V @ SELECTION @ VOLTAGE, rel=ROUNDING)


def test_without_a_drive_nothing_acts(mechanism: HybridLagrangian) -> None:
    drive = no_drive(mechanism)
    assert drive.force.shape == (3, 1)
    assert drive.force.is_zero()


def _motorized_rotor(inductance: float | None) -> tuple[float, ...]:
    """Return the state after 1 s of a sprung rotor with a motor; ``None`` drops the inductance."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    rotor = HybridLagrangian.from_energies(
        q=q, v=v, kinetic=v**2 / 2, potential=2 * q**2, gap=q + 100
    )
    motors = MotorBank(
        selection=ca.SX(1),
        resistance=ca.SX(2),
        inductance=ca.SX(inductance or 1.0),
        torque_constant=ca.SX(0.6),
        emf_constant=ca.SX(0.6),
        voltage=4 - 3 * q - v,
    )
    drive = (quasi_static_drive if inductance is None else full_drive)(rotor, motors)
    start = (1.0, 0.0) if inductance is None else (1.0, 0.0, 0.0)
    dynamics = bound(hybrid_system(rotor, drive, ca.SX(0.5)))
    return tuple(simulate(dynamics, start, until=1.0).end_state)


def test_the_quasi_static_drive_is_the_limit_of_the_full_one() -> None:
    limit = np.array(_motorized_rotor(None))
    largest = 4e-3
    errors = [
        float(np.max(np.abs(np.array(_motorized_rotor(largest / k)[:2]) - limit)))
        for k in (1, 2, 4)
    ]
    # First order in L: halving it halves the distance, up to a term of second order in L / R.
    second_order = 10 * largest / 2
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=second_order)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=second_order)


def test_the_full_current_falls_onto_the_slow_manifold() -> None:
    inductance, resistance = 1e-3, 2.0
    angle, rate, current = _motorized_rotor(inductance)
    balanced = (4 - 3 * angle - rate - 0.6 * rate) / resistance
    acceleration = 0.6 * current - 4 * angle
    # After 2000 time constants only the lag L/R di/dt is left, again up to second order.
    lag = inductance / resistance * (-3 * rate - 1.6 * acceleration) / resistance
    assert current == pytest.approx(balanced - lag, abs=20 * (inductance / resistance) ** 2)
    assert abs(current - balanced) > abs(lag) / 2


def test_matrices_that_do_not_fit_the_number_of_motors_are_refused() -> None:
    one = ca.SX(1)
    with pytest.raises(ValueError, match=r"`inductance` must be of shape \(1, 1\)"):
        MotorBank(
            selection=ca.SX([1, 0]),
            resistance=one,
            inductance=ca.SX(2, 2),
            torque_constant=one,
            emf_constant=one,
            voltage=one,
        )
    with pytest.raises(
        ValueError, match="`voltage` must have 1 entries, one per motor, but it has 2"
    ):
        MotorBank(
            selection=ca.SX([1, 0]),
            resistance=one,
            inductance=one,
            torque_constant=one,
            emf_constant=one,
            voltage=ca.SX([1, 2]),
        )


def test_a_selection_that_does_not_fit_the_torque_is_refused(mechanism: HybridLagrangian) -> None:
    with pytest.raises(ValueError, match=r"`selection` must be of shape \(3, 2\)"):
        ideal_torque_drive(mechanism, selection=ca.SX(3, 1), torque=ca.SX([1, 2]))
