r"""A hopping mass that pushes off below a height while it rises: a switched force.

``h'' = -g + a`` while ``h`` rises below ``s``, and ``-g`` otherwise. The push gives the energy that
the impact takes. At the impact of its orbit ``v^2 = 2 a s / (1 - e^2)``.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from zeno_orbits import (
    CompletedSystem,
    Drawing,
    HybridLagrangian,
    Problem,
    Quantity,
    hybrid_system,
    no_drive,
)


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: the height of the mass and its rate."""
    height, speed = ca.SX.sym("height"), ca.SX.sym("speed")
    pushes = ca.logic_and(speed > 0, height < p["s"])
    mass = HybridLagrangian.from_energies(
        q=height,
        v=speed,
        kinetic=p["m"] * speed**2 / 2,
        potential=p["m"] * p["g"] * height,
        gap=height,
        applied_force=ca.if_else(pushes, p["m"] * p["a"], 0),
    )
    # An empty tuple makes the conditions of the force switches.
    return hybrid_system(mass, no_drive(mass), p["restitution"], switches=())


def drawing(x: Mapping[str, ca.SX], p: Mapping[str, ca.SX]) -> Drawing:
    """Return the mass above the floor [m]."""
    side, low = p["s"] / 4, x["height"]
    high = low + 2 * side
    return {
        "stop": [(-4 * side, 0), (4 * side, 0)],
        "mass": [(-side, low), (side, low), (side, high), (-side, high), (-side, low)],
    }


PROBLEM = Problem(
    name="hopper",
    title="hopping mass with a switched push, no motor",
    source="docs/several_stops.md",
    state_names=("height", "speed"),
    state_units=("m", "m/s"),
    parameters=(
        Quantity.positive("m", 1.0, "kg", "mass"),
        Quantity.positive("a", 20.0, "m/s^2", "acceleration of the push"),
        Quantity.positive("s", 0.1, "m", "height below which it pushes"),
        Quantity.restitution(0.5),
        Quantity.positive("g", 9.81, "m/s^2", "gravity"),
    ),
    gains=(),
    model=model,
    starts=({"height": 0.0, "speed": 1.0},),
    portraits=(("height", "speed"),),
    amplitude_of="height",
    drawing=drawing,
)
