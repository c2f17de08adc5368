"""A heavy block that rocks about one edge on a shaken floor, and falls back onto its base."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from zeno_orbits import Clock, HybridLagrangian, Problem, Quantity, hybrid_system, no_drive


def model(p: Mapping[str, ca.SX]) -> Any:
    """Return the block: its tilt, ``I q'' = -m g r sin(s - q) + m r a(t) cos(s - q)``."""
    tilt, rate = ca.SX.sym("tilt"), ca.SX.sym("rate")
    clock = Clock.at(p["omega"])
    slope = p["slenderness"] - tilt
    block = HybridLagrangian.from_energies(
        q=tilt,
        v=rate,
        kinetic=p["m"] * (2 * p["r"]) ** 2 / 3 * rate**2 / 2,
        potential=p["m"] * p["g"] * p["r"] * (ca.cos(slope) - ca.cos(p["slenderness"])),
        gap=tilt,
        applied_force=p["m"] * p["r"] * p["A"] * clock.cosine * ca.cos(slope),
        clock=clock,
    )
    return hybrid_system(block, no_drive(block), p["restitution"])


PROBLEM = Problem(
    name="rocking_block",
    title="block that rocks about one edge on a shaken floor",
    source="these tests; Housner's block on one edge, with a restitution",
    state_names=("tilt", "rate", "cosine", "sine"),
    state_units=("rad", "rad/s", "1", "1"),
    parameters=(
        Quantity.positive("m", 4e5, "kg", "mass"),
        Quantity.positive("r", 10.0, "m", "distance of the centre of mass from the edge"),
        Quantity.positive("g", 9.81, "m/s^2", "gravity"),
        Quantity(
            name="slenderness",
            unit="rad",
            meaning="angle of the centre of mass over the edge, from the vertical, at rest",
            default=0.15,
            lower=0.0,
        ),
        Quantity(name="A", unit="m/s^2", meaning="acceleration of the floor", default=2.0, lower=0),
        Quantity.positive("omega", 4.0, "rad/s", "its frequency"),
        Quantity.restitution(0.5),
    ),
    gains=(),
    model=model,
    starts=({"cosine": 1.0},),
    portraits=(("tilt", "rate"),),
    amplitude_of="tilt",
)
