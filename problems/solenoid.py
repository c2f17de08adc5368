r"""A contactor: a coil holds its armature on a stop, a spring pushes it off, a clock feeds it.

The opening lengthens the path of the flux through air, so the inductance falls as
``L0 / (1 + slope opening)``: variable reluctance. The field energy ``L(opening) current^2 / 2``
alone gives the circuit and the pull, ``-L0 slope current^2 / (2 (1 + slope opening)^2)``. The stop
lets go where the current falls to ``sqrt(2 push / (L0 slope))``. A permanent magnet beside the coil
has the constant ``K``.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from zeno_orbits import (
    Circuit,
    Clock,
    CompletedSystem,
    HybridLagrangian,
    Problem,
    Quantity,
    circuit_drive,
    hybrid_system,
)


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: opening, its rate, the current and the clock."""
    opening, rate, current = ca.SX.sym("opening"), ca.SX.sym("rate"), ca.SX.sym("current")
    clock = Clock.at(p["omega"])
    armature = HybridLagrangian.from_energies(
        q=opening,
        v=rate,
        kinetic=p["m"] * rate**2 / 2,
        potential=-p["push"] * opening + p["k"] * opening**2 / 2,
        gap=opening,
        passive_force=-p["c"] * rate,
        clock=clock,
    )
    inductance = p["L0"] / (1 + p["slope"] * opening)
    coil = Circuit(
        currents=current,
        coenergy=inductance * current**2 / 2 + p["K"] * opening * current,
        resistance=p["R"],
        source=p["V0"] + p["V1"] * clock.cosine,
    )
    return hybrid_system(armature, circuit_drive(armature, coil), p["restitution"])


PROBLEM = Problem(
    name="solenoid",
    title="contactor with variable reluctance, its coil fed by a clock",
    source="declared here; release at a current in closed form",
    state_names=("opening", "rate", "current", "cosine", "sine"),
    state_units=("m", "m/s", "A", "1", "1"),
    parameters=(
        Quantity.positive("m", 0.05, "kg", "mass of the armature"),
        Quantity.positive("k", 2000.0, "N/m", "stiffness of the spring"),
        Quantity(name="push", unit="N", meaning="push of the spring at the stop", default=4.0),
        Quantity(name="c", unit="N s/m", meaning="friction", default=4.0, lower=0.0),
        Quantity.positive("L0", 0.5, "H", "inductance on the stop"),
        Quantity(
            name="slope",
            unit="1/m",
            meaning="growth of the reluctance with the opening, relative",
            default=500.0,
            lower=0.0,
        ),
        Quantity(name="K", unit="V s/m", meaning="constant of a permanent magnet", default=0.0),
        Quantity.positive("R", 20.0, "ohm", "resistance of the coil"),
        Quantity.positive("omega", 60.0, "rad/s", "frequency of the voltage"),
        Quantity.restitution(0.3),
    ),
    gains=(
        Quantity(name="V0", unit="V", meaning="mean voltage", default=5.0, lower=2.0, upper=10.0),
        Quantity(
            name="V1",
            unit="V",
            meaning="amplitude of the voltage",
            default=5.0,
            lower=2.0,
            upper=10.0,
        ),
    ),
    model=model,
    starts=({"cosine": 1.0},),
    portraits=(("opening", "rate"), ("current", "opening")),
    amplitude_of="opening",
)
