r"""The motor pendulum with dry friction in the gear of its motor: the shoulder slips or sticks.

The friction acts on the rate of the shoulder, also while the stop of the knee is closed. At a small
torque the orbit slips through its turning points. At a larger one the shoulder sticks there, and
from some torque on the pendulum comes to rest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import casadi as ca

from zeno_orbits import CompletedSystem, DryFriction, Quantity, hybrid_system, load_problem

SMOOTH = load_problem("motor_pendulum")


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: the states of `motor_pendulum`, and the side of its gear."""
    smooth = SMOOTH.model(p)
    links = smooth.mechanism
    gear = DryFriction("gear", rate=links.v[0], torque=p["T_gear"], static=p["T_static"])
    return hybrid_system(links, (smooth.drive, gear), p["restitution"])


PROBLEM = replace(
    SMOOTH,
    name="sticking_pendulum",
    title="motor_pendulum with dry friction in the gear of its motor",
    model=model,
    state_names=(*SMOOTH.state_names, "side_gear"),
    state_units=(*SMOOTH.state_units, "1"),
    parameters=(
        *SMOOTH.parameters,
        Quantity(
            name="T_gear",
            unit="N m",
            meaning="friction torque of the gear while it slips",
            default=0.002,
            lower=0.0,
        ),
        Quantity(
            name="T_static",
            unit="N m",
            meaning="largest friction torque while it sticks",
            default=0.003,
            lower=0.0,
        ),
    ),
    fidelities={},
    reference=None,
    rig=None,
)
