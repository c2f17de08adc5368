"""A contact of a micro relay: a beam a micrometre above its seat, which a force drives."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from zeno_orbits import Clock, HybridLagrangian, Problem, Quantity, hybrid_system, no_drive


def model(p: Mapping[str, ca.SX]) -> Any:
    """Return the beam as one mass on a spring that is bent by ``bend`` where the contact closes."""
    gap, speed = ca.SX.sym("gap"), ca.SX.sym("speed")
    clock = Clock.at(p["omega"])
    beam = HybridLagrangian.from_energies(
        q=gap,
        v=speed,
        kinetic=p["m"] * speed**2 / 2,
        potential=p["k"] * (gap + p["bend"]) ** 2 / 2,
        gap=gap,
        applied_force=p["F"] * clock.sine - p["c"] * speed,
        clock=clock,
    )
    return hybrid_system(beam, no_drive(beam), p["restitution"])


PROBLEM = Problem(
    name="micro_relay",
    title="contact of a micro relay",
    source="these tests",
    state_names=("gap", "speed", "cosine", "sine"),
    state_units=("m", "m/s", "1", "1"),
    parameters=(
        Quantity.positive("m", 1e-12, "kg", "mass of the beam"),
        Quantity.positive("k", 0.1, "N/m", "stiffness of the beam"),
        Quantity.positive("bend", 1e-6, "m", "bend of the beam where the contact closes"),
        Quantity.positive("c", 5e-8, "N s/m", "damping of the air"),
        Quantity.positive("F", 1.7e-7, "N", "amplitude of the force"),
        Quantity.positive("omega", 1e5, "rad/s", "its frequency"),
        Quantity.restitution(0.35),
    ),
    gains=(),
    model=model,
    starts=({"cosine": 1.0},),
    portraits=(("gap", "speed"),),
    amplitude_of="gap",
)
