"""Two masses, shaken: a second spring holds a hammer on the stop of a carriage."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from zeno_orbits import Clock, HybridLagrangian, Problem, Quantity, hybrid_system, no_drive


def model(p: Mapping[str, ca.SX]) -> Any:
    """Return the completed system."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    clock = Clock.at(p["omega"])
    carriage, opening = q[0], q[1]
    pair = HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=p["M"] * v[0] ** 2 / 2 + p["m"] * (v[0] + v[1]) ** 2 / 2,
        potential=p["K"] * carriage**2 / 2 + p["k"] * (opening + p["preload"]) ** 2 / 2,
        gap=opening,
        passive_force=ca.vertcat(-p["c"] * v[0], 0),
        applied_force=ca.vertcat(p["F"] * clock.cosine, 0),
        clock=clock,
    )
    return hybrid_system(pair, no_drive(pair), p["restitution"])


PROBLEM = Problem(
    name="shaken_pair",
    title="hammer on a shaken carriage",
    source="these tests",
    state_names=("carriage", "opening", "dcarriage", "dopening", "cosine", "sine"),
    state_units=("m", "m", "m/s", "m/s", "1", "1"),
    parameters=(
        Quantity.positive("M", 2.0, "kg", "mass of the carriage"),
        Quantity.positive("m", 0.2, "kg", "mass of the hammer"),
        Quantity.positive("K", 400.0, "N/m", "stiffness that holds the carriage"),
        Quantity.positive("k", 30.0, "N/m", "stiffness that holds the hammer"),
        Quantity.positive("preload", 0.05, "m", "stretch of that on the stop"),
        Quantity.positive("c", 4.0, "N s/m", "damping of the carriage"),
        Quantity.positive("F", 6.0, "N", "amplitude of the shaking force"),
        Quantity.positive("omega", 16.0, "rad/s", "its frequency"),
        Quantity.restitution(0.3),
    ),
    gains=(),
    model=model,
    starts=({"cosine": 1.0},),
    portraits=(("opening", "dopening"), ("carriage", "dcarriage")),
    amplitude_of="opening",
)
