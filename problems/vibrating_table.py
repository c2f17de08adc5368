r"""A ball on a table that shakes: impacts accumulate, the ball sticks, and is thrown again.

The table moves as ``A sin(omega t)``; the coordinate is the ball's height above it, so the stop
stands still and the table's acceleration is an applied force. On the table the ball is carried
until ``sin(omega t) = g / (A omega^2)``, where it takes off at rest; the flight is a parabola less
the table's motion. If the ball comes to rest before the next take-off, the period is the table's;
if a flight outlasts a turn, a multiple of it.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from zeno_orbits import (
    Clock,
    CompletedSystem,
    Drawing,
    HybridLagrangian,
    Output,
    Problem,
    Quantity,
    hybrid_system,
    no_drive,
)


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: two states of the ball, two of the table's clock."""
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


def drawing(x: Mapping[str, ca.SX], p: Mapping[str, ca.SX]) -> Drawing:
    """Return the ball as a point, and the table [m]."""
    table = p["A"] * x["sine"]
    return {"ball": [(0, x["height"] + table)], "stop": [(-p["A"], table), (p["A"], table)]}


PROBLEM = Problem(
    name="vibrating_table",
    title="ball on a table that shakes up and down, no motor",
    source="textbook; the sticking orbits of a bouncing ball, with its numbers declared here",
    state_names=("height", "speed", "cosine", "sine"),
    state_units=("m", "m/s", "1", "1"),
    parameters=(
        Quantity.positive("m", 0.05, "kg", "mass of the ball"),
        Quantity(name="A", unit="m", meaning="amplitude of the table", default=0.015, lower=0.0),
        Quantity.positive("omega", 30.0, "rad/s", "frequency of the table"),
        Quantity.positive("g", 9.81, "m/s^2", "gravity"),
        Quantity.restitution(0.3),
    ),
    gains=(),
    model=model,
    starts=({"cosine": 1.0},),
    portraits=(("height", "speed"),),
    amplitude_of="height",
    outputs=(
        Output(name="table", unit="m", formula=lambda x, p: p["A"] * x["sine"]),
        Output(name="ball", unit="m", formula=lambda x, p: x["height"] + p["A"] * x["sine"]),
    ),
    drawing=drawing,
)
