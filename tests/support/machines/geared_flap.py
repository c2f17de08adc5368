"""A flap that a geared motor opens against a spring; its stop stands at an angle of its own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from zeno_orbits import HybridLagrangian, MotorBank, Problem, Quantity, full_drive, hybrid_system


def model(p: Mapping[str, ca.SX]) -> Any:
    """Return the flap, its stop at ``rest``; the motor turns ``ratio`` times as fast."""
    angle, rate = ca.SX.sym("angle"), ca.SX.sym("rate")
    flap = HybridLagrangian.from_energies(
        q=angle,
        v=rate,
        kinetic=p["J"] * rate**2 / 2,
        potential=p["k"] * (angle - p["rest"] + p["preload"]) ** 2 / 2,
        gap=angle - p["rest"],
        passive_force=-p["c"] * rate,
    )
    motor = MotorBank(
        selection=ca.SX(p["ratio"]),
        resistance=p["R"],
        inductance=p["L"],
        torque_constant=p["K_motor"],
        emf_constant=p["K_motor"],
        voltage=p["V0"] - p["Kp"] * (angle - p["rest"]),
    )
    return hybrid_system(flap, full_drive(flap, motor), p["restitution"])


PROBLEM = Problem(
    name="geared_flap",
    title="flap, opened by a geared motor against a spring",
    source="these tests",
    state_names=("angle", "rate", "current"),
    state_units=("rad", "rad/s", "A"),
    parameters=(
        Quantity.positive("J", 2e-4, "kg m^2", "inertia of flap, gear and rotor"),
        Quantity.positive("k", 0.01, "N m/rad", "stiffness of the spring"),
        Quantity.positive("preload", 5.0, "rad", "turn of the spring at the stop"),
        Quantity.positive("rest", 0.4, "rad", "angle of the stop"),
        Quantity(name="c", unit="N m s/rad", meaning="friction", default=2e-4, lower=0.0),
        Quantity.positive("R", 0.5, "ohm", "resistance of the motor circuit"),
        Quantity.positive("L", 0.1, "H", "inductance of the motor circuit"),
        Quantity.positive("K_motor", 0.025, "N m/A", "torque constant, and the back-EMF constant"),
        Quantity.positive("ratio", 2.0, "1", "turns of the motor a turn of the flap"),
        Quantity.positive("V0", 2.0, "V", "voltage at the stop"),
        Quantity.restitution(0.3),
    ),
    gains=(
        Quantity(
            name="Kp", unit="V/rad", meaning="taken back", default=10.0, lower=6.0, upper=20.0
        ),
    ),
    model=model,
    starts=({"angle": 0.4},),
    portraits=(("angle", "rate"), ("angle", "current")),
    amplitude_of="angle",
)
