r"""A pressure relief valve whose flow force was measured over its lift.

The valve is `relief_valve`, but the pressure does not act on a constant area: the jet below the
disc turns as the valve opens, and the force grows with the lift before it falls. The force per
pressure is a table of eight measured values. A cubic table has no events, so the machine has one
stop and no kink. Here the values are synthetic.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import casadi as ca

from zeno_orbits import (
    Auxiliary,
    CompletedSystem,
    Quantity,
    hybrid_system,
    load_problem,
    table,
)

RELIEF = load_problem("relief_valve")
LIFTS = (0.0, 0.05, 0.12, 0.2, 0.35, 0.6, 1.0, 2.5)
"""Lift of the disc [m]. The table goes on below it: a step of the flow looks below the seat."""
AREAS = (1.0, 1.02, 1.05, 1.07, 1.06, 1.0, 0.93, 0.85)
"""Measured force per pressure, relative to the closed valve [1]."""


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: the states of `relief_valve`."""
    valve, pressure = RELIEF.model(p).mechanism, ca.SX.sym("pressure")
    area = 1 + p["share"] * (
        table(valve.q, LIFTS, AREAS, "cubic", outside="extend", name="area") - 1
    )
    force, root = p["stiffness"] * pressure * area, ca.sqrt(pressure / p["reference"])
    vessel = Auxiliary(
        states=pressure,
        rate=p["b"] * (p["q"] - valve.q * root),
        force=force,
        input_power=p["stiffness"] * pressure * p["b"] * p["q"] + force * valve.v,
        loss=p["stiffness"] * p["b"] * valve.q * pressure * root,
        stored_energy=p["stiffness"] * pressure**2 / 2,
    )
    return hybrid_system(valve, vessel, p["restitution"])


PROBLEM = replace(
    RELIEF,
    name="measured_valve",
    title="pressure relief valve with a measured flow force",
    source="relief_valve; synthetic table of the flow force, declared here",
    parameters=(
        *RELIEF.parameters,
        Quantity(
            name="share",
            unit="1",
            meaning="share of the measured change of the force",
            default=1.0,
            lower=0.0,
        ),
    ),
    model=model,
)
