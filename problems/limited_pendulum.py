"""The motor pendulum with a supply that limits the voltage: each limit is a switch.

Within the limit the law is the law of `motor_pendulum`. At the limit the voltage is constant.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import casadi as ca

from zeno_orbits import CompletedSystem, Quantity, full_drive, hybrid_system, load_problem

UNLIMITED = load_problem("motor_pendulum")


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: the states of `motor_pendulum`."""
    unlimited = UNLIMITED.model(p)
    mechanism, motors = unlimited.mechanism, unlimited.drive.motors
    assert motors is not None
    limited = ca.fmin(p["U"], ca.fmax(-p["U"], motors.voltage))
    drive = full_drive(mechanism, replace(motors, voltage=limited))
    # An empty tuple makes the limits switches.
    return hybrid_system(mechanism, drive, p["restitution"], switches=())


PROBLEM = replace(
    UNLIMITED,
    name="limited_pendulum",
    title="motor_pendulum with a voltage limit",
    model=model,
    parameters=(*UNLIMITED.parameters, Quantity.positive("U", 5.0, "V", "limit of the voltage")),
    fidelities={},
    reference=None,
    rig=None,
)
