"""A slide and a pusher, each with a linear motor under PD control, forced by a clock."""

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
    """Return the completed system."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    clock = Clock.at(p["omega"])
    slide, opening = q[0], q[1]
    machine = HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=p["M"] * v[0] ** 2 / 2 + p["m"] * (v[0] + v[1]) ** 2 / 2,
        potential=p["K"] * slide**2 / 2 + p["m"] * p["g"] * (slide + opening),
        gap=opening,
        passive_force=ca.vertcat(-p["c"] * v[0], 0),
        clock=clock,
    )
    wanted = p["stroke"] * clock.cosine
    bank = MotorBank(
        selection=ca.SX.eye(2),
        resistance=p["R"] * ca.SX.eye(2),
        inductance=p["L"] * ca.SX.eye(2),
        torque_constant=p["k_F"] * ca.SX.eye(2),
        emf_constant=p["k_E"] * ca.SX.eye(2),
        voltage=ca.vertcat(-p["Kp"] * (slide - wanted), -p["Kd"] * v[1]),
    )
    return hybrid_system(machine, full_drive(machine, bank), p["restitution"])


PROBLEM = Problem(
    name="twin_actuators",
    title="slide and pusher, each with a linear motor",
    source="these tests",
    state_names=(
        *("slide", "opening", "dslide", "dopening", "slide_current", "pusher_current"),
        *("cosine", "sine"),
    ),
    state_units=("m", "m", "m/s", "m/s", "A", "A", "1", "1"),
    parameters=(
        Quantity.positive("M", 1.5, "kg", "mass of the slide"),
        Quantity.positive("m", 0.3, "kg", "mass of the pusher"),
        Quantity.positive("K", 900.0, "N/m", "stiffness that holds the slide"),
        Quantity.positive("g", 9.81, "m/s^2", "gravity"),
        Quantity.positive("c", 5.0, "N s/m", "damping of the slide"),
        Quantity.positive("stroke", 0.02, "m", "amplitude that is asked of the slide"),
        Quantity.positive("omega", 30.0, "rad/s", "frequency of that"),
        Quantity.positive("R", 2.0, "ohm", "resistance of each coil"),
        Quantity.positive("L", 0.002, "H", "inductance of each coil"),
        Quantity.positive("k_F", 8.0, "N/A", "force constant"),
        Quantity.positive("k_E", 8.0, "V s/m", "back-EMF constant"),
        Quantity.restitution(0.3),
    ),
    gains=(
        Quantity(name="Kp", unit="V/m", meaning="slide", default=400.0, lower=200.0, upper=800.0),
        Quantity(name="Kd", unit="V s/m", meaning="pusher", default=-7.0, lower=-7.5, upper=0.0),
    ),
    model=model,
    starts=({"cosine": 1.0},),
    portraits=(("opening", "dopening"), ("slide", "dslide")),
    amplitude_of="opening",
)
