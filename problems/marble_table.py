r"""A marble on a table that shakes, whose restitution falls with the speed of an impact.

The law ``e(v) = restitution - fall * v`` is what drops of glass marbles show over a decade of
speeds. Its limit at ``v = 0`` is below 1, so impacts accumulate, in the end by the factor
``restitution``. Everything else is `vibrating_table`: on the table the marble is carried until
``sin(omega t) = g / (A omega^2)``, where it takes off at rest.
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
    impact_speed,
    no_drive,
)


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: two states of the marble, two of the table's clock."""
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
    law = p["restitution"] - p["fall"] * impact_speed
    return hybrid_system(ball, no_drive(ball), law)


def drawing(x: Mapping[str, ca.SX], p: Mapping[str, ca.SX]) -> Drawing:
    """Return the marble as a point, and the table [m]."""
    table = p["A"] * x["sine"]
    return {"marble": [(0, x["height"] + table)], "stop": [(-p["A"], table), (p["A"], table)]}


PROBLEM = Problem(
    name="marble_table",
    title="marble on a table that shakes, restitution falls with the speed, no motor",
    source="textbook ball on a table with a linear law of impact, its numbers declared here",
    state_names=("height", "speed", "cosine", "sine"),
    state_units=("m", "m/s", "1", "1"),
    parameters=(
        Quantity.positive("m", 0.05, "kg", "mass of the marble"),
        Quantity(name="A", unit="m", meaning="amplitude of the table", default=0.015, lower=0.0),
        Quantity.positive("omega", 30.0, "rad/s", "frequency of the table"),
        Quantity.positive("g", 9.81, "m/s^2", "gravity"),
        Quantity.restitution(0.5),
        Quantity(
            name="fall",
            unit="s/m",
            meaning="fall of the restitution with the impact speed",
            default=0.2,
            lower=0.0,
        ),
    ),
    gains=(),
    model=model,
    starts=({"cosine": 1.0},),
    portraits=(("height", "speed"),),
    amplitude_of="height",
    outputs=(
        Output(name="table", unit="m", formula=lambda x, p: p["A"] * x["sine"]),
        Output(name="marble", unit="m", formula=lambda x, p: x["height"] + p["A"] * x["sine"]),
    ),
    drawing=drawing,
)
