"""A ball that a hand throws straight up and catches again, once a turn of the hand."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from zeno_orbits import Clock, HybridLagrangian, Problem, Quantity, hybrid_system, no_drive


def model(p: Mapping[str, ca.SX]) -> Any:
    """Return the ball over the hand, which moves as ``A sin(omega t)``."""
    height, speed = ca.SX.sym("height"), ca.SX.sym("speed")
    clock = Clock.at(p["omega"])
    ball = HybridLagrangian.from_energies(
        q=height,
        v=speed,
        kinetic=p["m"] * speed**2 / 2,
        potential=p["m"] * p["g"] * height,
        gap=height,
        applied_force=p["m"] * p["A"] * p["omega"] ** 2 * clock.sine,
        clock=clock,
    )
    return hybrid_system(ball, no_drive(ball), p["restitution"])


PROBLEM = Problem(
    name="juggler",
    title="ball that a hand throws and catches",
    source="these tests",
    state_names=("height", "speed", "cosine", "sine"),
    state_units=("m", "m/s", "1", "1"),
    parameters=(
        Quantity.positive("m", 20.0, "kg", "mass of the ball"),
        Quantity.positive("g", 9.81, "m/s^2", "gravity"),
        Quantity(name="A", unit="m", meaning="amplitude of the hand", default=0.075, lower=0.0),
        Quantity.positive("omega", 15.0, "rad/s", "frequency of the hand"),
        Quantity.restitution(0.4),
    ),
    gains=(),
    model=model,
    starts=({"cosine": 1.0},),
    portraits=(("height", "speed"),),
    amplitude_of="height",
)
