"""A disc that a motor turns, with its stop far away."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from zeno_orbits import HybridLagrangian, MotorBank, full_drive, hybrid_system
from zeno_orbits.model import CompletedSystem, Problem, Quantity

INERTIA, _FAR = 0.02, 1e6
ELECTRIC = {"R": 2.0, "L": 3e-3, "K": 0.05}


def _disc(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return a disc on a motor, its stop far away, under a law of angle, rate and current."""
    angle, rate, current = (ca.SX.sym(one) for one in ("angle", "rate", "current"))
    disc = HybridLagrangian.from_energies(
        q=angle, v=rate, kinetic=INERTIA * rate**2 / 2, potential=ca.SX(0), gap=_FAR - angle
    )
    motor = MotorBank(
        selection=ca.SX(1),
        resistance=ca.SX(ELECTRIC["R"]),
        inductance=ca.SX(ELECTRIC["L"]),
        torque_constant=p["K"],
        emf_constant=p["K"],
        voltage=p["V0"] - p["Kp"] * angle - p["Kd"] * rate - p["Ki"] * current,
        current=current,
    )
    return hybrid_system(disc, full_drive(disc, motor), p["restitution"])


def _gain(name: str) -> Quantity:
    return Quantity(name=name, unit="1", meaning=name, default=0.0, lower=-9.0, upper=9.0)


DISC = Problem(
    name="disc",
    title="disc on a motor",
    source="here",
    state_names=("angle", "rate", "current"),
    state_units=("rad", "rad/s", "A"),
    parameters=(
        Quantity(name="K", unit="N m/A", meaning="motor constant", default=ELECTRIC["K"]),
        Quantity.restitution(0.2),
    ),
    gains=(_gain("V0"), _gain("Kp"), _gain("Kd"), _gain("Ki")),
    model=_disc,
    starts=({},),
    portraits=(("angle", "rate"),),
    amplitude_of="angle",
)
