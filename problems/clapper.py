r"""A mass on a spring between two stops, forced by a cosine: it comes to rest at both in turn.

``m x'' + c x' + k x = A cos(omega t)``, ``|x| <= d``. The slow force presses the mass on a stop
long enough for the impacts to accumulate, and pulls it off again.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from zeno_orbits import (
    Clock,
    CompletedSystem,
    Drawing,
    HybridLagrangian,
    Problem,
    Quantity,
    Stop,
    hybrid_system,
    no_drive,
)


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: the place of the mass, its rate, and the clock."""
    place, speed = ca.SX.sym("place"), ca.SX.sym("speed")
    clock = Clock.at(p["omega"])
    mass = HybridLagrangian.from_energies(
        q=place,
        v=speed,
        kinetic=p["m"] * speed**2 / 2,
        potential=p["k"] * place**2 / 2,
        passive_force=-p["c"] * speed,
        applied_force=p["A"] * clock.cosine,
        clock=clock,
        stops=(
            Stop(name="upper", gap=p["d"] - place, restitution=p["restitution"]),
            Stop(name="lower", gap=p["d"] + place, restitution=p["restitution"]),
        ),
    )
    return hybrid_system(mass, no_drive(mass))


def drawing(x: Mapping[str, ca.SX], p: Mapping[str, ca.SX]) -> Drawing:
    """Return the mass between the walls of its frame [m]."""
    side = p["d"] / 8
    left, right, wall = x["place"] - side, x["place"] + side, p["d"] + side
    return {
        "stop": [(-wall, 4 * side), (-wall, -side), (wall, -side), (wall, 4 * side)],
        "mass": [(left, -side), (right, -side), (right, side), (left, side), (left, -side)],
    }


PROBLEM = Problem(
    name="clapper",
    title="mass on a spring between two stops, forced by a cosine, no motor",
    source="the two-sided oscillator of Shaw and Holmes (1983), J. Sound Vib. 90; numbers declared",
    state_names=("place", "speed", "cosine", "sine"),
    state_units=("m", "m/s", "1", "1"),
    parameters=(
        Quantity.positive("m", 1.0, "kg", "mass"),
        Quantity(name="c", unit="N s/m", meaning="damping", default=0.1, lower=0.0),
        Quantity(name="k", unit="N/m", meaning="stiffness of the spring", default=1.0, lower=0.0),
        Quantity(name="A", unit="N", meaning="amplitude of the force", default=5.0, lower=0.0),
        Quantity.positive("omega", 0.3, "rad/s", "frequency of the force"),
        Quantity.positive("d", 1.0, "m", "distance of both stops from the relaxed spring"),
        Quantity.restitution(0.3),
    ),
    gains=(),
    model=model,
    starts=({"cosine": 1.0},),
    portraits=(("place", "speed"),),
    amplitude_of="place",
    drawing=drawing,
)
