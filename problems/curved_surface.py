r"""A ball over a bowl that shakes: the normal of the stop turns with the place.

The bowl is ``y = x^2 / (2 rho)`` and moves as ``A sin(omega t)`` along a direction that leans by
``lean`` from the vertical; the coordinates are relative to it, so it stands still and the shaking
is an applied force. The air slows the ball. Without shaking and air every flight is a parabola, the
gap along it a polynomial of second degree, and all impacts follow in closed form.
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
    """Return the completed system: ``q = (x, y)`` in the bowl's frame, and the clock."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    clock = Clock.at(p["omega"])
    # The bowl accelerates by minus this, so the ball feels it the other way round.
    shake = p["A"] * p["omega"] ** 2 * clock.sine
    ball = HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=p["m"] * ca.sumsqr(v) / 2,
        potential=p["m"] * p["g"] * q[1],
        gap=q[1] - q[0] ** 2 / (2 * p["rho"]),
        passive_force=-p["c"] * v,
        applied_force=p["m"] * shake * ca.vertcat(ca.sin(p["lean"]), ca.cos(p["lean"])),
        clock=clock,
    )
    return hybrid_system(ball, no_drive(ball), p["restitution"])


PROBLEM = Problem(
    name="curved_surface",
    title="ball over a bowl that shakes, no motor",
    source="declared here; parabolas over a parabola, in closed form where nothing shakes",
    state_names=("x", "y", "dx", "dy", "cosine", "sine"),
    state_units=("m", "m", "m/s", "m/s", "1", "1"),
    parameters=(
        Quantity.positive("m", 0.05, "kg", "mass of the ball"),
        Quantity.positive("rho", 0.1, "m", "radius of curvature at the bottom of the bowl"),
        Quantity(name="c", unit="N s/m", meaning="drag of the air", default=0.05, lower=0.0),
        Quantity(name="A", unit="m", meaning="amplitude of the bowl", default=0.015, lower=0.0),
        Quantity.positive("omega", 30.0, "rad/s", "frequency of the bowl"),
        Quantity(
            name="lean",
            unit="rad",
            meaning="direction of the shaking, from the vertical",
            default=0.3,
        ),
        Quantity.positive("g", 9.81, "m/s^2", "gravity"),
        Quantity.restitution(0.3),
    ),
    gains=(),
    model=model,
    starts=({"cosine": 1.0},),
    portraits=(("x", "y"), ("x", "dx")),
    amplitude_of="x",
    outputs=(
        Output(name="gap", unit="m", formula=lambda x, p: x["y"] - x["x"] ** 2 / (2 * p["rho"])),
    ),
)
