r"""A ball that a shaken table juggles, once a turn of the table, and that a coil pulls down.

The table moves as ``A sin(omega t)``, and the coordinate is the ball's height above it. A coil
below the table adds the acceleration `pull` to gravity. If the table moves up with
:math:`A \omega \cos\varphi = \frac{(g + pull)\,T}{2}\,\frac{1 - e}{1 + e}` at the impact, the ball
returns after a turn `T`. Its two multipliers have the product :math:`e^2` and the sum
:math:`1 + e^2 - (1 + e)^2 A \omega^2 \sin\varphi / (g + pull)`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import casadi as ca

from zeno_orbits import (
    Clock,
    CompletedSystem,
    HybridLagrangian,
    Quantity,
    hybrid_system,
    load_problem,
    no_drive,
)

TABLE = load_problem("vibrating_table")
DEFAULTS = {"A": 0.0067, "restitution": 0.8}


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
        applied_force=p["m"] * (p["A"] * p["omega"] ** 2 * clock.sine - p["pull"]),
        clock=clock,
    )
    return hybrid_system(ball, no_drive(ball), p["restitution"])


PROBLEM = replace(
    TABLE,
    name="table_juggler",
    title="ball that a shaken table juggles and a coil pulls, no motor",
    source="textbook; the bouncing ball of one impact per turn, with numbers declared here",
    model=model,
    parameters=(
        *(replace(one, default=DEFAULTS.get(one.name, one.default)) for one in TABLE.parameters),
        Quantity(name="pull", unit="m/s^2", meaning="acceleration by the coil", default=0.0),
    ),
    starts=({"speed": 0.9, "cosine": 0.6, "sine": 0.8},),
)
