r"""The motor pendulum with a sampled controller: the voltage is held between two samples.

At every sample the controller reads angle and rate, and applies the law of `motor_pendulum` until
the next sample. The held voltage is a state, and a switch of the clock changes it. An orbit has a
period of a whole number of samples.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import casadi as ca

from zeno_orbits import (
    Clock,
    CompletedSystem,
    Hold,
    Quantity,
    Switch,
    full_drive,
    hybrid_system,
    load_problem,
)

CONTINUOUS = load_problem("motor_pendulum")


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: the states of `motor_pendulum`, held voltage and clock."""
    continuous = CONTINUOUS.model(p)
    clock, held = Clock.at(2 * math.pi / p["sampling"]), ca.SX.sym("held")
    links, motors = replace(continuous.mechanism, clock=clock), continuous.drive.motors
    assert motors is not None
    motor = full_drive(links, replace(motors, voltage=held))
    # The sine rises through zero at the start of each turn, where the cosine is positive.
    sample = Switch(
        name="sample",
        guard=-clock.sine,
        armed=clock.cosine,
    )
    hold = Hold(states=held, at="switch sample", after=motors.voltage)
    return hybrid_system(links, (motor, hold), p["restitution"], switches=(sample,))


PROBLEM = replace(
    CONTINUOUS,
    name="sampled_pendulum",
    title="motor_pendulum with a sampled controller that holds its voltage",
    model=model,
    state_names=(*CONTINUOUS.state_names, "held", "cosine", "sine"),
    state_units=(*CONTINUOUS.state_units, "V", "1", "1"),
    parameters=(
        *CONTINUOUS.parameters,
        Quantity.positive("sampling", 0.156, "s", "time between two samples"),
    ),
    starts=({"theta1": 1.2, "dtheta1": 2.0, "cosine": -0.8, "sine": 0.6},),
    fidelities={},
    reference=None,
    rig=None,
)
