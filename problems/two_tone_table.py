r"""A ball on a table that shakes in two tones: it is thrown twice a turn, by different amounts.

The table moves as ``A sin(omega t) + B sin(2 omega t)``; the coordinate is the ball's height above
it, so the stop stands still and the table's acceleration is an applied force. Where the table
accelerates downwards faster than `g` the ball is thrown, twice a turn if the second tone is strong,
and both times it comes to rest again by impacts that accumulate: two Zeno points a period. The
flights are parabolas less the table's motion.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from zeno_orbits import (
    Clock,
    CompletedSystem,
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
    twice = 2 * clock.sine * clock.cosine
    pull = p["omega"] ** 2 * (p["A"] * clock.sine + 4 * p["B"] * twice)
    ball = HybridLagrangian.from_energies(
        q=height,
        v=speed,
        kinetic=p["m"] * speed**2 / 2,
        potential=p["m"] * p["g"] * height,
        gap=height,
        applied_force=p["m"] * pull,
        clock=clock,
    )
    return hybrid_system(ball, no_drive(ball), p["restitution"])


PROBLEM = Problem(
    name="two_tone_table",
    title="ball on a table that shakes in two tones, thrown twice a turn, no motor",
    source="ours; the sticking orbits of a bouncing ball, with two throws a period",
    state_names=("height", "speed", "cosine", "sine"),
    state_units=("m", "m/s", "1", "1"),
    parameters=(
        Quantity.positive("m", 0.05, "kg", "mass of the ball"),
        Quantity(name="A", unit="m", meaning="amplitude of the table", default=0.002, lower=0.0),
        Quantity(
            name="B", unit="m", meaning="amplitude of its second tone", default=0.0035, lower=0.0
        ),
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
        Output(
            name="table",
            unit="m",
            formula=lambda x, p: x["sine"] * (p["A"] + 2 * p["B"] * x["cosine"]),
        ),
        Output(
            name="ball",
            unit="m",
            formula=lambda x, p: x["height"] + x["sine"] * (p["A"] + 2 * p["B"] * x["cosine"]),
        ),
    ),
)
