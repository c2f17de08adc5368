r"""The relay under a voltage that is cut and applied again before its contact closes.

The voltage `u` is `U` until `t1`, zero until `t2`, `U` until half the period, then zero. Both times
are gains: well chosen, they take most of the speed from the closing impact.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import casadi as ca

from zeno_orbits import (
    Auxiliary,
    Clock,
    CompletedSystem,
    Quantity,
    hybrid_system,
    load_problem,
    piecewise,
)

RELAY = load_problem("relay")


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: the states of `relay`."""
    armature, flux = RELAY.model(p).mechanism, ca.SX.sym("flux")
    opening, clock = armature.q, armature.clock
    assert isinstance(clock, Clock)
    times = (p["t1"], p["t2"], clock.period / 2)
    voltage = piecewise(clock, (p["U"], 0, p["U"], 0), times)
    saturation = 1 - (flux / p["phi_s"]) ** 2
    current = flux * (p["S0"] / saturation + p["S1"] * opening) / p["N"]
    iron = -p["S0"] * p["phi_s"] ** 2 / 2 * ca.log(saturation)
    coil = Auxiliary(
        states=flux,
        rate=(voltage - p["R"] * current) / p["N"],
        force=-p["S1"] * flux**2 / 2,
        input_power=voltage * current,
        loss=p["R"] * current**2,
        stored_energy=iron + p["S1"] * opening * flux**2 / 2,
    )
    return hybrid_system(armature, coil)


PROBLEM = replace(
    RELAY,
    name="relay_soft",
    title="relay whose voltage is cut and applied again before its contact closes",
    model=model,
    outputs=RELAY.outputs[:1],
    gains=(
        Quantity(
            name="t1",
            unit="s",
            meaning="time at which the voltage is cut",
            default=1.2e-3,
            lower=5e-4,
            upper=1.6e-3,
        ),
        Quantity(
            name="t2",
            unit="s",
            meaning="time at which it is applied again",
            default=2.5e-3,
            lower=1.7e-3,
            upper=5e-3,
        ),
    ),
)
