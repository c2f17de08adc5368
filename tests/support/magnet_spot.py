"""The ball on a shaking table, past a magnet: a spot of 4 mm on a path of 1 m pulls it off.

The table turns once a period along a circle of 1 m. At the place ``spot`` of a turn [rad] a magnet
pulls with ``pull exp(-(d / 2 mm)^2 / 2)``, with the distance ``d`` straight through the circle.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import casadi as ca

from zeno_orbits import (
    Clock,
    CompletedSystem,
    HybridLagrangian,
    Problem,
    Quantity,
    hybrid_system,
    no_drive,
)

WIDTH = 2 * math.pi * 0.002
"""Half of the spot, 2 mm of 1 m, in the angle of a turn [rad]."""


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: two states of the ball, two of the clock."""
    height, speed = ca.SX.sym("height"), ca.SX.sym("speed")
    clock = Clock.at(p["omega"])
    away = (clock.cosine - ca.cos(p["spot"])) ** 2 + (clock.sine - ca.sin(p["spot"])) ** 2
    magnet = p["pull"] * ca.exp(-away / 2 / WIDTH**2)
    lift = p["A"] * p["omega"] ** 2 * clock.sine + magnet
    ball = HybridLagrangian.from_energies(
        q=height,
        v=speed,
        kinetic=speed**2 / 2,
        potential=p["g"] * height,
        gap=height,
        applied_force=lift,
        clock=clock,
    )
    return hybrid_system(ball, no_drive(ball), p["restitution"])


PROBLEM = Problem(
    name="magnet_spot",
    title="ball on a shaking table that passes a narrow magnet",
    source="made for a test: a feature far narrower than a step",
    state_names=("height", "speed", "cosine", "sine"),
    state_units=("m", "m/s", "1", "1"),
    parameters=(
        Quantity(name="A", unit="m", meaning="amplitude of the table", default=0.015),
        Quantity(name="omega", unit="rad/s", meaning="frequency of the table", default=30.0),
        Quantity(name="g", unit="m/s^2", meaning="gravity", default=9.81),
        Quantity(name="pull", unit="N", meaning="force of the magnet on 1 kg", default=12.0),
        Quantity(name="spot", unit="rad", meaning="place of the magnet", default=0.3),
        Quantity.restitution(0.3),
    ),
    gains=(),
    model=model,
    starts=({"cosine": 1.0},),
    portraits=(("height", "speed"),),
    amplitude_of="height",
)
