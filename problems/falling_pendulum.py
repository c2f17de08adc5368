r"""A pendulum that falls on a stop: every flight is an elliptic integral.

The angle is measured from the stop, which stands at ``stop`` from the downward vertical on the
side where gravity presses the rod on it. Between impacts the energy keeps, so a flight that turns
round at the angle ``phi`` from the vertical takes ``2 (K(k) - F(asin(sin(stop / 2) / k), k)) / w0``
with ``k = sin(phi / 2)`` and ``w0`` the frequency of small swings. At the end it rests for good:
it has a Zeno point and no periodic orbit.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from zeno_orbits import (
    CompletedSystem,
    HybridLagrangian,
    Problem,
    Quantity,
    hybrid_system,
    no_drive,
)


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: the angle from the stop and its rate."""
    angle, rate = ca.SX.sym("angle"), ca.SX.sym("rate")
    rod = HybridLagrangian.from_energies(
        q=angle,
        v=rate,
        kinetic=(p["I"] + p["m"] * p["lc"] ** 2) * rate**2 / 2,
        potential=-p["m"] * p["g"] * p["lc"] * ca.cos(angle + p["stop"]),
        gap=angle,
    )
    return hybrid_system(rod, no_drive(rod), p["restitution"])


PROBLEM = Problem(
    name="falling_pendulum",
    title="pendulum that falls on a stop, no motor",
    source="textbook; the period of a pendulum in elliptic integrals, with numbers declared here",
    state_names=("angle", "rate"),
    state_units=("rad", "rad/s"),
    parameters=(
        Quantity.positive("m", 0.2, "kg", "mass"),
        Quantity.positive("lc", 0.25, "m", "pivot to the centre of mass"),
        Quantity.positive("I", 0.004, "kg m^2", "inertia about the centre of mass"),
        Quantity(
            name="stop",
            unit="rad",
            meaning="where the stop is, from the downward vertical",
            default=0.4,
            lower=0.0,
            upper=3.0,
        ),
        Quantity.positive("g", 9.81, "m/s^2", "gravity"),
        Quantity.restitution(0.6),
    ),
    gains=(),
    model=model,
    starts=({"angle": 1.8},),
    portraits=(("angle", "rate"),),
    amplitude_of="angle",
)
