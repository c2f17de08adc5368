"""A flap on a spring that a motor under an alternating voltage lifts off its stop."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from zeno_orbits import (
    Clock,
    HybridLagrangian,
    MotorBank,
    Problem,
    Quantity,
    full_drive,
    hybrid_system,
)


def model(p: Mapping[str, ca.SX]) -> Any:
    """Return the completed system: the flap, the current and the clock of the voltage."""
    angle, rate = ca.SX.sym("angle"), ca.SX.sym("rate")
    clock = Clock.at(p["omega"])
    flap = HybridLagrangian.from_energies(
        q=angle,
        v=rate,
        kinetic=p["J"] * rate**2 / 2,
        potential=p["k"] * (angle + p["preload"]) ** 2 / 2,
        gap=angle,
        passive_force=-p["c"] * rate,
        clock=clock,
    )
    motor = MotorBank(
        selection=ca.SX(1),
        resistance=p["R"],
        inductance=p["L"],
        torque_constant=p["K"],
        emf_constant=p["K"],
        voltage=p["Kp"] * clock.cosine - p["Kd"] * rate,
    )
    return hybrid_system(flap, full_drive(flap, motor), p["restitution"])


PROBLEM = Problem(
    name="buzzer",
    title="flap under an alternating voltage",
    source="these tests",
    state_names=("angle", "rate", "current", "cosine", "sine"),
    state_units=("rad", "rad/s", "A", "1", "1"),
    parameters=(
        Quantity.positive("J", 1e-4, "kg m^2", "inertia of flap and rotor"),
        Quantity.positive("k", 0.05, "N m/rad", "stiffness of the spring"),
        Quantity.positive("preload", 0.2, "rad", "turn of the spring at the stop"),
        Quantity.positive("c", 1e-4, "N m s/rad", "friction"),
        Quantity.positive("R", 1.0, "ohm", "resistance"),
        Quantity.positive("L", 0.02, "H", "inductance"),
        Quantity.positive("K", 0.03, "N m/A", "torque and back-EMF constant"),
        Quantity.positive("omega", 20.0, "rad/s", "frequency of the voltage"),
        Quantity.restitution(0.3),
    ),
    gains=(
        Quantity(
            name="Kp", unit="V", meaning="amplitude of the voltage", default=4.0, lower=1, upper=9
        ),
        Quantity(name="Kd", unit="V s/rad", meaning="damping", default=0.0, lower=-0.05, upper=0.5),
    ),
    model=model,
    starts=({"cosine": 1.0},),
    portraits=(("angle", "rate"),),
    amplitude_of="angle",
)
