r"""A mass on a spring, forced by a cosine, that strikes a stop and never comes to rest on it.

``m x'' + c x' + k x = A cos(omega t)``, ``x <= stop``, without motor and feedback. At the published
numbers it strikes the stop once a turn of the force, so its orbit has no Zeno point: the section
is the states just after the impact. Elsewhere it strikes it several times a turn, or once in two.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from zeno_orbits import (
    Clock,
    CompletedSystem,
    HybridLagrangian,
    Problem,
    Quantity,
    hybrid_system,
    no_drive,
)


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: the mass's distance from the stop, its rate, and the clock."""
    distance, speed = ca.SX.sym("distance"), ca.SX.sym("speed")
    clock = Clock.at(p["omega"])
    oscillator = HybridLagrangian.from_energies(
        q=distance,
        v=speed,
        kinetic=p["m"] * speed**2 / 2,
        potential=p["k"] * (p["stop"] - distance) ** 2 / 2,
        gap=distance,
        passive_force=-p["c"] * speed,
        applied_force=-p["A"] * clock.cosine,
        clock=clock,
    )
    return hybrid_system(oscillator, no_drive(oscillator), p["restitution"])


PROBLEM = Problem(
    name="impact_oscillator",
    title="mass on a spring, forced by a cosine, that strikes a stop once a turn, no motor",
    source="Dankowicz and Schilder, Recipes for Continuation, chapter 15 (COCO)",
    state_names=("distance", "speed", "cosine", "sine"),
    state_units=("m", "m/s", "1", "1"),
    parameters=(
        Quantity.positive("m", 1.0, "kg", "mass"),
        Quantity(name="c", unit="N s/m", meaning="damping", default=0.1, lower=0.0),
        Quantity(name="k", unit="N/m", meaning="stiffness of the spring", default=1.0, lower=0.0),
        Quantity(name="A", unit="N", meaning="amplitude of the force", default=1.0, lower=0.0),
        Quantity.positive("omega", 1.0, "rad/s", "frequency of the force"),
        Quantity(
            name="stop",
            unit="m",
            meaning="where the stop is, from the relaxed spring",
            default=1.0,
        ),
        Quantity.restitution(0.8),
    ),
    gains=(),
    model=model,
    starts=({"cosine": 1.0},),
    portraits=(("distance", "speed"),),
    amplitude_of="distance",
)
