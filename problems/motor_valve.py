r"""A valve on its seat, lifted by a DC motor against a spring: an orbit of a single state.

While the seat holds, the current rises towards ``V0 / R``; where its torque exceeds the spring's
preload the valve leaves, always in the same state, so the orbit has no multipliers. The coil is
slow: the voltage that takes the lift back acts late, and the valve falls on its seat again. In
flight the three equations are linear and the motion is a matrix exponential.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from zeno_orbits import (
    CompletedSystem,
    HybridLagrangian,
    MotorBank,
    Problem,
    Quantity,
    full_drive,
    hybrid_system,
)


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: opening angle, its rate and the current."""
    opening, rate = ca.SX.sym("opening"), ca.SX.sym("rate")
    valve = HybridLagrangian.from_energies(
        q=opening,
        v=rate,
        kinetic=p["J"] * rate**2 / 2,
        potential=p["preload"] * opening + p["k"] * opening**2 / 2,
        gap=opening,
        passive_force=-p["c"] * rate,
    )
    motor = MotorBank(
        selection=ca.SX(1),
        resistance=p["R"],
        inductance=p["L"],
        torque_constant=p["K_torque"],
        emf_constant=p["K_emf"],
        voltage=p["V0"] - p["Kp"] * opening - p["Kd"] * rate,
    )
    return hybrid_system(valve, full_drive(valve, motor), p["restitution"])


PROBLEM = Problem(
    name="motor_valve",
    title="valve with its seat, opened by a DC motor against a spring",
    source="declared here; linear between impacts",
    state_names=("opening", "rate", "current"),
    state_units=("rad", "rad/s", "A"),
    parameters=(
        Quantity.positive("J", 2e-4, "kg m^2", "inertia of valve and rotor"),
        Quantity.positive("k", 0.01, "N m/rad", "stiffness of the spring"),
        Quantity.positive("preload", 0.05, "N m", "torque of the spring at the seat"),
        Quantity(name="c", unit="N m s/rad", meaning="friction", default=2e-4, lower=0.0),
        Quantity.positive("R", 0.5, "ohm", "resistance of the motor circuit"),
        Quantity.positive("L", 0.1, "H", "inductance of the motor circuit"),
        Quantity.positive("K_torque", 0.05, "N m/A", "torque constant"),
        Quantity.positive("K_emf", 0.05, "V s/rad", "back-EMF constant"),
        Quantity.positive("V0", 2.0, "V", "voltage at the seat"),
        Quantity.restitution(0.3),
    ),
    gains=(
        Quantity(
            name="Kp",
            unit="V/rad",
            meaning="voltage taken back per angle",
            default=10.0,
            lower=6.0,
            upper=20.0,
        ),
        Quantity(
            name="Kd",
            unit="V s/rad",
            meaning="voltage taken back per rate",
            default=0.0,
            lower=-0.05,
            upper=0.05,
        ),
    ),
    model=model,
    starts=({},),
    portraits=(("opening", "rate"), ("opening", "current")),
    amplitude_of="opening",
)
