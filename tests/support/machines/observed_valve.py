r"""A valve that a motor lifts, with an observer of its rate that is told of impacts.

The observer follows ``z' = a + gain (rate - z)`` with the valve's free acceleration ``a``, and it
jumps as the rate does. So its error decays at the rate ``gain`` in flight, through every impact and
on the seat, where it needs the contact force: the orbit has the multiplier ``exp(-gain period)``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from zeno_orbits import (
    Auxiliary,
    HybridLagrangian,
    MotorBank,
    Problem,
    Quantity,
    full_drive,
    hybrid_system,
)


def model(p: Mapping[str, ca.SX]) -> Any:
    """Return the completed system: the valve, the current and the observed rate."""
    opening, rate = ca.SX.sym("opening"), ca.SX.sym("rate")
    current, observed = ca.SX.sym("current"), ca.SX.sym("observed")
    torque = p["K"] * current - p["preload"] - p["k"] * opening - p["c"] * rate
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
        torque_constant=p["K"],
        emf_constant=p["K"],
        voltage=p["V0"] - p["Kp"] * opening,
        current=current,
    )
    observer = Auxiliary(
        states=observed,
        rate=torque / p["J"] + p["gain"] * (rate - observed),
        after_impact=observed - (1 + p["restitution"]) * rate,
    )
    return hybrid_system(valve, (full_drive(valve, motor), observer), p["restitution"])


PROBLEM = Problem(
    name="observed_valve",
    title="valve lifted by a motor, with an observer",
    source="motor_valve with an observer",
    state_names=("opening", "rate", "current", "observed"),
    state_units=("rad", "rad/s", "A", "rad/s"),
    parameters=(
        Quantity.positive("J", 2e-4, "kg m^2", "inertia of valve and rotor"),
        Quantity.positive("k", 0.01, "N m/rad", "stiffness of the spring"),
        Quantity.positive("preload", 0.05, "N m", "torque of the spring at the seat"),
        Quantity(name="c", unit="N m s/rad", meaning="friction", default=2e-4, lower=0.0),
        Quantity.positive("R", 0.5, "ohm", "resistance of the motor circuit"),
        Quantity.positive("L", 0.1, "H", "inductance of the motor circuit"),
        Quantity.positive("K", 0.05, "N m/A", "torque and back-EMF constant"),
        Quantity.positive("V0", 2.0, "V", "voltage at the seat"),
        Quantity.positive("gain", 3.0, "1/s", "gain of the observer"),
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
    ),
    model=model,
    starts=({"observed": 1.0},),
    portraits=(("opening", "rate"), ("observed", "rate")),
    amplitude_of="opening",
)
