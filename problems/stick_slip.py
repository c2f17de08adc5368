r"""A block on a moving belt, held by a spring: it sticks, is carried along, and slips back.

``m x'' + k x = -T sign(x' - belt)``. While the block sticks, the belt carries it from
``x1 = 2 T / k - T_static / k`` to ``x2 = T_static / k``. Then it slips about ``T / k`` until it has
the speed of the belt again. With ``w = sqrt(k / m)`` and ``b = (x2 - T / k) w`` the limit cycle
lasts ``(x2 - x1) / belt + 2 (pi - arctan(b / belt)) / w``.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from zeno_orbits import (
    CompletedSystem,
    DryFriction,
    HybridLagrangian,
    Problem,
    Quantity,
    hybrid_system,
    no_drive,
)


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: place, speed, and the side of the pad on the belt."""
    x, v = ca.SX.sym("x"), ca.SX.sym("v")
    block = HybridLagrangian.from_energies(
        q=x, v=v, kinetic=p["m"] * v**2 / 2, potential=p["k"] * x**2 / 2
    )
    pad = DryFriction("pad", rate=v - p["belt"], torque=p["T"], static=p["T_static"])
    return hybrid_system(block, (no_drive(block), pad))


PROBLEM = Problem(
    name="stick_slip",
    title="block on a moving belt, held by a spring, with dry friction, no motor",
    source="Leine and Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems, 2004",
    state_names=("x", "v", "side_pad"),
    state_units=("m", "m/s", "1"),
    parameters=(
        Quantity.positive("m", 1.0, "kg", "mass"),
        Quantity.positive("k", 4.0, "N/m", "stiffness of the spring"),
        Quantity.positive("belt", 0.3, "m/s", "speed of the belt"),
        Quantity(
            name="T", unit="N", meaning="friction while the block slips", default=1.0, lower=0.0
        ),
        Quantity(
            name="T_static",
            unit="N",
            meaning="largest friction while it sticks",
            default=1.5,
            lower=0.0,
        ),
    ),
    gains=(),
    model=model,
    starts=({"x": 0.2, "v": 0.3},),
    portraits=(("x", "v"),),
    amplitude_of="x",
)
