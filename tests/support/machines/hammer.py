"""A hammer that an oscillating force drives against its anvil, several hits a period."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from zeno_orbits import Clock, HybridLagrangian, Problem, Quantity, hybrid_system, no_drive


def model(p: Mapping[str, ca.SX]) -> Any:
    """Return the completed system."""
    height, speed = ca.SX.sym("height"), ca.SX.sym("speed")
    clock = Clock.at(p["omega"])
    hammer = HybridLagrangian.from_energies(
        q=height,
        v=speed,
        kinetic=p["m"] * speed**2 / 2,
        potential=p["m"] * p["g"] * height,
        gap=height,
        applied_force=p["F"] * clock.cosine,
        clock=clock,
    )
    return hybrid_system(hammer, no_drive(hammer), p["restitution"])


PROBLEM = Problem(
    name="hammer",
    title="hammer on an anvil, driven by an oscillating force",
    source="these tests",
    state_names=("height", "speed", "cosine", "sine"),
    state_units=("m", "m/s", "1", "1"),
    parameters=(
        Quantity.positive("m", 2.0, "kg", "mass of the hammer"),
        Quantity.positive("g", 9.81, "m/s^2", "gravity"),
        Quantity.positive("F", 55.0, "N", "amplitude of the force"),
        Quantity.positive("omega", 25.0, "rad/s", "its frequency"),
        Quantity.restitution(0.35),
    ),
    gains=(),
    model=model,
    starts=({"cosine": 1.0},),
    portraits=(("height", "speed"),),
    amplitude_of="height",
)
