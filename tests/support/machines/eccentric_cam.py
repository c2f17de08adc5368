"""A follower with a dashpot on an eccentric cam, in the frame of the cam."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from zeno_orbits import Clock, HybridLagrangian, Problem, Quantity, hybrid_system, no_drive


def model(p: Mapping[str, ca.SX]) -> Any:
    """Return the completed system."""
    lift, speed = ca.SX.sym("lift"), ca.SX.sym("speed")
    clock = Clock.at(p["omega"])
    eccentric = p["m"] * p["omega"] ** 2 - p["k"]
    follower = HybridLagrangian.from_energies(
        q=lift,
        v=speed,
        kinetic=p["m"] * speed**2 / 2,
        potential=p["k"] * (lift + p["l0"]) ** 2 / 2,
        gap=lift,
        passive_force=-p["c"] * speed,
        applied_force=eccentric * p["a"] * clock.cosine,
        clock=clock,
    )
    return hybrid_system(follower, no_drive(follower), p["restitution"])


PROBLEM = Problem(
    name="eccentric_cam",
    title="follower with a dashpot on an eccentric cam",
    source="these tests",
    state_names=("lift", "speed", "cosine", "sine"),
    state_units=("m", "m/s", "1", "1"),
    parameters=(
        Quantity.positive("m", 0.3, "kg", "mass of the follower"),
        Quantity.positive("k", 1500.0, "N/m", "stiffness of the spring"),
        Quantity.positive("c", 3.0, "N s/m", "dashpot between follower and cam"),
        Quantity.positive("l0", 0.006, "m", "compression of the spring at the middle of the lift"),
        Quantity.positive("a", 0.005, "m", "eccentricity"),
        Quantity.positive("omega", 120.0, "rad/s", "speed of the cam"),
        Quantity.restitution(0.4),
    ),
    gains=(),
    model=model,
    starts=({"cosine": -1.0},),
    portraits=(("lift", "speed"),),
    amplitude_of="lift",
)
