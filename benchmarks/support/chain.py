"""Three masses in a row, shaken: a spring holds a hammer on the stop of the last one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from zeno_orbits import Clock, HybridLagrangian, Problem, Quantity, hybrid_system, no_drive


def model(p: Mapping[str, ca.SX]) -> Any:
    """Return the completed system: base, carriage, and the hammer's opening from the carriage."""
    q, v = ca.SX.sym("q", 3), ca.SX.sym("v", 3)
    clock = Clock.at(p["omega"])
    base, carriage, opening = q[0], q[1], q[2]
    chain = HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=p["M"] * (v[0] ** 2 + v[1] ** 2) / 2 + p["m"] * (v[1] + v[2]) ** 2 / 2,
        potential=p["K"] * (base**2 + (carriage - base) ** 2) / 2
        + p["k"] * (opening + p["preload"]) ** 2 / 2,
        gap=opening,
        passive_force=ca.vertcat(-p["c"] * v[0], -p["c"] * v[1], 0),
        applied_force=ca.vertcat(p["F"] * clock.cosine, 0, 0),
        clock=clock,
    )
    return hybrid_system(chain, no_drive(chain), p["restitution"])


PROBLEM = Problem(
    name="chain",
    title="hammer on the last of two shaken masses",
    source="this benchmark",
    state_names=(
        *("base", "carriage", "opening", "dbase", "dcarriage", "dopening"),
        *("cosine", "sine"),
    ),
    state_units=("m", "m", "m", "m/s", "m/s", "m/s", "1", "1"),
    parameters=(
        Quantity.positive("M", 2.0, "kg", "mass of base and carriage"),
        Quantity.positive("m", 0.2, "kg", "mass of the hammer"),
        Quantity.positive("K", 400.0, "N/m", "stiffness of the springs between the masses"),
        Quantity.positive("k", 30.0, "N/m", "stiffness that holds the hammer"),
        Quantity.positive("preload", 0.05, "m", "stretch of that on the stop"),
        Quantity.positive("c", 4.0, "N s/m", "damping of base and carriage"),
        Quantity.positive("F", 12.0, "N", "amplitude of the shaking force"),
        Quantity.positive("omega", 20.0, "rad/s", "its frequency"),
        Quantity.restitution(0.3),
    ),
    gains=(),
    model=model,
    starts=({"cosine": 1.0},),
    portraits=(("opening", "dopening"),),
    amplitude_of="opening",
)
