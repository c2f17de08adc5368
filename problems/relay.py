r"""A relay whose armature bounces at both stops, with a saturating coil under a square wave.

    N dphi/dt = u - R i,    N i = phi (S0 / (1 - (phi/phi_s)^2) + S1 z)
    m dw/dt = ks (zs - z) - b w - S1 phi^2 / 2,    0 <= z <= d

``z`` is the opening and ``phi`` the flux. The voltage ``u`` is `U` in the first half of the period
and zero in the second. The relay closes and opens once a period, and bounces each time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import casadi as ca

from zeno_orbits import (
    Auxiliary,
    Clock,
    CompletedSystem,
    Drawing,
    HybridLagrangian,
    Output,
    Problem,
    Quantity,
    Stop,
    hybrid_system,
)


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: opening, its rate, flux and clock."""
    opening, rate, flux = ca.SX.sym("z"), ca.SX.sym("dz"), ca.SX.sym("flux")
    clock = Clock.at(p["omega"])
    armature = HybridLagrangian.from_energies(
        q=opening,
        v=rate,
        kinetic=p["m"] * rate**2 / 2,
        potential=p["ks"] * (p["zs"] - opening) ** 2 / 2,
        passive_force=-p["b"] * rate,
        clock=clock,
        stops=(
            Stop(name="closed", gap=opening, restitution=p["restitution"]),
            Stop(name="open", gap=p["d"] - opening, restitution=p["restitution"]),
        ),
    )
    current = coil_current({"z": opening, "flux": flux}, p)
    voltage = ca.if_else(clock.sine > 0, p["U"], 0)
    # The energy of the field: the integral of the magnetomotive force over the flux.
    iron = -p["S0"] * p["phi_s"] ** 2 / 2 * ca.log(1 - (flux / p["phi_s"]) ** 2)
    coil = Auxiliary(
        states=flux,
        rate=(voltage - p["R"] * current) / p["N"],
        force=-p["S1"] * flux**2 / 2,
        input_power=voltage * current,
        loss=p["R"] * current**2,
        stored_energy=iron + p["S1"] * opening * flux**2 / 2,
    )
    return hybrid_system(armature, coil)


def coil_current(x: Mapping[str, ca.SX], p: Mapping[str, ca.SX]) -> ca.SX:
    """Return the current of the coil [A]."""
    reluctance = p["S0"] / (1 - (x["flux"] / p["phi_s"]) ** 2) + p["S1"] * x["z"]
    return x["flux"] * reluctance / p["N"]


def drawing(x: Mapping[str, ca.SX], p: Mapping[str, ca.SX]) -> Drawing:
    """Return the armature between the core and the open stop [m]."""
    side = p["d"] / 8
    low, high, wide = x["z"], x["z"] + side, 5 * side
    top = p["d"] + side
    return {
        "stop": [(wide, 0), (-1.2 * wide, 0), (-1.2 * wide, top), (-0.6 * wide, top)],
        "armature": [(-wide, low), (wide, low), (wide, high), (-wide, high), (-wide, low)],
    }


PROBLEM = Problem(
    name="relay",
    title="relay that bounces at both stops, its coil under a square wave",
    source="Ramirez-Laboreo, Moya-Lasheras and Sagues (2016-2024); numbers declared here",
    state_names=("z", "dz", "flux", "cosine", "sine"),
    state_units=("m", "m/s", "Wb", "1", "1"),
    parameters=(
        Quantity.positive("m", 1.6e-3, "kg", "mass of the armature"),
        Quantity.positive("ks", 55.0, "N/m", "stiffness of the spring"),
        Quantity.positive("zs", 0.0159, "m", "opening at which the spring is relaxed"),
        Quantity.positive("b", 0.05, "N s/m", "damping"),
        Quantity.positive("S0", 6e6, "1/H", "reluctance of the iron"),
        Quantity.positive("S1", 2.2e10, "1/H m", "reluctance of the gap over the opening"),
        Quantity.positive("phi_s", 3.6e-5, "Wb", "flux at saturation"),
        Quantity.positive("N", 1200.0, "1", "turns of the coil"),
        Quantity.positive("R", 50.0, "ohm", "resistance of the coil"),
        Quantity.positive("U", 24.0, "V", "voltage in the first half of the period"),
        Quantity.positive("d", 9e-4, "m", "opening at the open stop"),
        Quantity.restitution(0.3),
        Quantity.positive("omega", 2 * math.pi / 0.04, "rad/s", "frequency of the voltage"),
    ),
    gains=(),
    model=model,
    starts=({"z": lambda p: p["d"], "cosine": 1.0},),
    portraits=(("z", "dz"), ("z", "flux")),
    amplitude_of="z",
    outputs=(
        Output(name="current", unit="A", formula=coil_current),
        Output(
            name="voltage",
            unit="V",
            formula=lambda x, p: ca.if_else(x["sine"] > 0, p["U"], 0),
        ),
    ),
    drawing=drawing,
)
