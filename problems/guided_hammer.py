r"""A hammer that a magnet lifts in a guide with dry friction, above an anvil on a spring.

``m x'' = -m g + A cos(omega t) - T sign(x')`` in flight, and ``M y'' = -M g - k y - c y'`` for the
anvil, with ``x >= y``. After the impacts have accumulated, the hammer lies on the anvil, and sticks
in its guide until the magnet pulls more than weight and ``T_static``. The friction acts along
``x'`` and the stop along ``x' - y'``, so both hold the hammer at the same time.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from zeno_orbits import (
    Clock,
    CompletedSystem,
    Drawing,
    DryFriction,
    HybridLagrangian,
    Problem,
    Quantity,
    hybrid_system,
    no_drive,
)


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: hammer and anvil, their speeds, the side of the guide, time."""
    q = ca.vertcat(ca.SX.sym("hammer"), ca.SX.sym("anvil"))
    v = ca.vertcat(ca.SX.sym("dhammer"), ca.SX.sym("danvil"))
    clock = Clock.at(p["omega"])
    pair = HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=(p["m"] * v[0] ** 2 + p["M"] * v[1] ** 2) / 2,
        potential=p["g"] * (p["m"] * q[0] + p["M"] * q[1]) + p["k"] * q[1] ** 2 / 2,
        gap=q[0] - q[1],
        passive_force=ca.vertcat(0, -p["c"] * v[1]),
        applied_force=ca.vertcat(p["A"] * clock.cosine, 0),
        clock=clock,
    )
    guide = DryFriction("guide", rate=v[0], torque=p["T"], static=p["T_static"])
    return hybrid_system(pair, (no_drive(pair), guide), p["restitution"])


def drawing(x: Mapping[str, ca.SX], _: Mapping[str, ca.SX]) -> Drawing:
    """Return the hammer, the anvil below it, and the guide [m]."""
    side, hammer, anvil = 0.02, x["hammer"], x["anvil"]
    low, high = anvil - side, hammer + 2 * side
    return {
        "guide": [(-side, -3 * side), (-side, 6 * side), (side, 6 * side), (side, -3 * side)],
        "hammer": [
            *((-side, hammer), (side, hammer), (side, high), (-side, high), (-side, hammer)),
        ],
        "anvil": [(-side, anvil), (side, anvil), (side, low), (-side, low), (-side, anvil)],
    }


PROBLEM = Problem(
    name="guided_hammer",
    title="hammer in a guide with dry friction, lifted by a magnet above an anvil on a spring",
    source="declared; the law of friction of Leine and Nijmeijer (2004)",
    state_names=("hammer", "anvil", "dhammer", "danvil", "side_guide", "cosine", "sine"),
    state_units=("m", "m", "m/s", "m/s", "1", "1", "1"),
    parameters=(
        Quantity.positive("m", 0.5, "kg", "mass of the hammer"),
        Quantity.positive("M", 2.0, "kg", "mass of the anvil"),
        Quantity.positive("k", 2e4, "N/m", "stiffness of the anvil's spring"),
        Quantity(name="c", unit="N s/m", meaning="damping of the anvil", default=80.0, lower=0.0),
        Quantity(name="A", unit="N", meaning="amplitude of the magnet", default=7.0, lower=0.0),
        Quantity.positive("omega", 25.0, "rad/s", "frequency of the magnet"),
        Quantity(
            name="T", unit="N", meaning="friction while the hammer slips", default=1.0, lower=0.0
        ),
        Quantity(
            name="T_static",
            unit="N",
            meaning="largest friction while it sticks",
            default=1.5,
            lower=0.0,
        ),
        Quantity.restitution(0.4),
        Quantity.positive("g", 9.81, "m/s^2", "gravity"),
    ),
    gains=(),
    model=model,
    starts=({"hammer": 0.01, "cosine": 1.0},),
    portraits=(("hammer", "dhammer"),),
    amplitude_of="hammer",
    drawing=drawing,
)
