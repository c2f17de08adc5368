"""A hammer that a crank lifts by a spring; the crank stalls where its drive equals its load.

The crank's angle has the rate ``drive - load sin(angle)``, so a turn takes
``2 pi / sqrt(drive^2 - load^2)`` and no turn is completed at ``drive = load``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from zeno_orbits import Clock, HybridLagrangian, Problem, Quantity, hybrid_system, no_drive


def model(p: Mapping[str, ca.SX]) -> Any:
    """Return the completed system."""
    height, speed = ca.SX.sym("height"), ca.SX.sym("speed")
    cosine, sine = ca.SX.sym("cosine"), ca.SX.sym("sine")
    clock = Clock(cosine=cosine, sine=sine, frequency=p["drive"] - p["load"] * sine)
    hammer = HybridLagrangian.from_energies(
        q=height,
        v=speed,
        kinetic=p["m"] * speed**2 / 2,
        potential=p["m"] * p["g"] * height,
        gap=height,
        applied_force=p["F"] * cosine,
        clock=clock,
    )
    return hybrid_system(hammer, no_drive(hammer), p["restitution"])


PROBLEM = Problem(
    name="stalling_crank",
    title="hammer on an anvil, lifted by a crank that stalls",
    source="these tests",
    state_names=("height", "speed", "cosine", "sine"),
    state_units=("m", "m/s", "1", "1"),
    parameters=(
        Quantity.positive("m", 2.0, "kg", "mass of the hammer"),
        Quantity.positive("g", 9.81, "m/s^2", "gravity"),
        Quantity.positive("F", 30.0, "N", "amplitude of the lifting force"),
        Quantity.positive("drive", 12.0, "rad/s", "rate of the crank without load"),
        Quantity.positive("load", 7.9, "rad/s", "loss of rate under the largest load"),
        Quantity.restitution(0.35),
    ),
    gains=(),
    model=model,
    starts=({"cosine": 1.0},),
    portraits=(("height", "speed"),),
    amplitude_of="height",
)
