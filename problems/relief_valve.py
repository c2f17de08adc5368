r"""A pressure relief valve that chatters on its seat, scaled to a mass and a stiffness of 1.

A vessel is filled at the rate ``q``, and its pressure lifts the disc of a valve against a spring.
The flow through the gap grows with the lift and the root of the pressure, the pressure falls, and
the disc comes down on its seat. While it rests there the pressure rises at the constant rate
``b q``, and the valve opens where it reaches the preload ``d``: always the same state, so the orbit
has no multipliers. The pressure is a further state: the compression of the spring that it
balances. The fluid stores ``stiffness pressure^2 / 2``.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from zeno_orbits import (
    Auxiliary,
    CompletedSystem,
    HybridLagrangian,
    Problem,
    Quantity,
    hybrid_system,
)


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: lift, its rate and the pressure."""
    lift, rate, pressure = ca.SX.sym("lift"), ca.SX.sym("rate"), ca.SX.sym("pressure")
    valve = HybridLagrangian.from_energies(
        q=lift,
        v=rate,
        kinetic=p["m"] * rate**2 / 2,
        potential=p["stiffness"] * (p["d"] * lift + lift**2 / 2),
        gap=lift,
        passive_force=-p["m"] * p["k"] * rate,
    )
    root = ca.sqrt(pressure / p["reference"])
    vessel = Auxiliary(
        states=pressure,
        rate=p["b"] * (p["q"] - lift * root),
        force=p["stiffness"] * pressure,
        input_power=p["stiffness"] * pressure * (p["b"] * p["q"] + rate),
        loss=p["stiffness"] * p["b"] * lift * pressure * root,
        stored_energy=p["stiffness"] * pressure**2 / 2,
    )
    return hybrid_system(valve, vessel, p["restitution"])


PROBLEM = Problem(
    name="relief_valve",
    title="pressure relief valve that chatters on its seat",
    source="Hos and Champneys 2012, Licsko, Champneys and Hos 2009; restitution declared here",
    state_names=("lift", "rate", "pressure"),
    state_units=("m", "m/s", "m"),
    parameters=(
        Quantity.positive("m", 1.0, "kg", "mass of the disc"),
        Quantity.positive("stiffness", 1.0, "N/m", "stiffness of the spring"),
        Quantity.positive("k", 1.25, "1/s", "damping, per mass"),
        Quantity.positive("d", 10.0, "m", "compression of the spring on the seat"),
        Quantity.positive("b", 20.0, "1/s", "rate at which the vessel fills"),
        Quantity.positive(
            "reference", 1.0, "m", "pressure at which a unit of lift lets a unit flow"
        ),
        Quantity.restitution(0.2),
    ),
    gains=(
        Quantity(
            name="q",
            unit="m",
            meaning="flow into the vessel",
            default=0.3,
            lower=0.1,
            upper=2.0,
        ),
    ),
    model=model,
    starts=({"pressure": 10.5},),
    portraits=(("lift", "rate"), ("pressure", "lift")),
    amplitude_of="lift",
)
