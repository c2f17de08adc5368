"""A ball that falls on the floor: the Zeno execution of every textbook.

Its impacts are geometric and end at ``sqrt(2 h0 / g) (1 + e) / (1 - e)``; then it rests for good,
so it has a Zeno point and no periodic orbit.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from zeno_orbits import (
    CompletedSystem,
    HybridLagrangian,
    Problem,
    Quantity,
    hybrid_system,
    no_drive,
)


def lagrangian(p: Mapping[str, ca.SX]) -> HybridLagrangian:
    """Return the ball: one coordinate, its height above the floor."""
    height, speed = ca.SX.sym("height"), ca.SX.sym("speed")
    return HybridLagrangian.from_energies(
        q=height,
        v=speed,
        kinetic=p["m"] * speed**2 / 2,
        potential=p["m"] * p["g"] * height,
        gap=height,
    )


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system, with two states."""
    ball = lagrangian(p)
    return hybrid_system(ball, no_drive(ball), p["restitution"])


PROBLEM = Problem(
    name="bouncing_ball",
    title="ball under gravity on a hard floor, no motor",
    source="textbook; the standard first example of a Zeno execution",
    state_names=("height", "speed"),
    state_units=("m", "m/s"),
    parameters=(
        Quantity.positive("m", 1.0, "kg", "mass"),
        Quantity.positive("g", 9.81, "m/s^2", "gravity"),
        Quantity.restitution(0.8),
    ),
    gains=(),
    model=model,
    starts=({"height": 1.0},),
    portraits=(("height", "speed"),),
    amplitude_of="height",
)
