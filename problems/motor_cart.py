r"""A cart that a motor drives to and fro, with a link hanging from it against a stop.

The link's angle counts from the stop, which leans by ``tilt`` from the vertical, so the weight
presses the link on it. The stop lets go exactly where the cart accelerates by ``g tan(tilt)``. The
voltage follows a sine of the cart's position, so time is a clock and the period is the sine's.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from zeno_orbits import (
    Clock,
    CompletedSystem,
    Drawing,
    HybridLagrangian,
    MotorBank,
    Problem,
    Quantity,
    full_drive,
    hybrid_system,
)


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: ``q = (x, angle)``, the motor's current and the clock."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    clock = Clock.at(p["omega"])
    lean = q[1] + p["tilt"]
    centre_speed_squared = (
        v[0] ** 2 + 2 * p["lc"] * v[0] * v[1] * ca.cos(lean) + (p["lc"] * v[1]) ** 2
    )
    cart = HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=(
            (p["M"] + p["J_rotor"] / p["r"] ** 2) * v[0] ** 2
            + p["m"] * centre_speed_squared
            + p["I"] * v[1] ** 2
        )
        / 2,
        potential=-p["m"] * p["g"] * p["lc"] * ca.cos(lean),
        gap=q[1],
        passive_force=ca.vertcat(-p["c"] * v[0], -p["b"] * v[1]),
        clock=clock,
    )
    motor = MotorBank(
        selection=ca.vertcat(1 / p["r"], 0),
        resistance=p["R"],
        inductance=p["L"],
        torque_constant=p["K_torque"],
        emf_constant=p["K_emf"],
        voltage=p["Kp"] * (p["A"] * clock.sine - q[0]) - p["Kd"] * v[0],
    )
    return hybrid_system(cart, full_drive(cart, motor), p["restitution"])


def drawing(x: Mapping[str, ca.SX], p: Mapping[str, ca.SX]) -> Drawing:
    """Return the cart, the link on its hinge to twice its centre of mass, and the stop [m]."""
    wide, lean = 0.4 * p["lc"], x["angle"] + p["tilt"]
    tip = (x["x"] + 2 * p["lc"] * ca.sin(lean), -2 * p["lc"] * ca.cos(lean))
    along, aside = (ca.sin(p["tilt"]), -ca.cos(p["tilt"])), 0.1 * p["lc"]
    start, end = (
        (x["x"] + part * along[0] + aside * along[1], part * along[1] - aside * along[0])
        for part in (0.0, 0.8 * p["lc"])
    )
    return {
        "cart": [(x["x"] - wide, 0), (x["x"] + wide, 0)],
        "link": [(x["x"], 0), tip],
        "stop": [start, end],
        "hinge": [(x["x"], 0)],
    }


PROBLEM = Problem(
    name="motor_cart",
    title="motor-driven cart with a hanging link and a stop",
    source="declared here; the release of the link is known in closed form",
    state_names=("x", "angle", "dx", "dangle", "current", "cosine", "sine"),
    state_units=("m", "rad", "m/s", "rad/s", "A", "1", "1"),
    parameters=(
        Quantity.positive("M", 0.8, "kg", "mass of the cart"),
        Quantity.positive("m", 0.1, "kg", "mass of the link"),
        Quantity.positive("lc", 0.15, "m", "hinge to the centre of mass of the link"),
        Quantity.positive("I", 0.00075, "kg m^2", "inertia of the link about its centre of mass"),
        Quantity(
            name="tilt",
            unit="rad",
            meaning="angle of the stop from the downward vertical",
            default=0.25,
            lower=0.0,
            upper=1.5,
        ),
        Quantity(name="c", unit="N s/m", meaning="friction of the cart", default=0.5, lower=0.0),
        Quantity(
            name="b", unit="N m s/rad", meaning="friction of the hinge", default=2e-4, lower=0.0
        ),
        Quantity.positive("r", 0.02, "m", "radius of the driving wheel"),
        Quantity(
            name="J_rotor", unit="kg m^2", meaning="inertia of the rotor", default=2e-5, lower=0.0
        ),
        Quantity.positive("R", 1.5, "ohm", "resistance of the motor circuit"),
        Quantity.positive("L", 0.002, "H", "inductance of the motor circuit"),
        Quantity.positive("K_torque", 0.04, "N m/A", "torque constant"),
        Quantity.positive("K_emf", 0.04, "V s/rad", "back-EMF constant"),
        Quantity.positive("A", 0.15, "m", "amplitude that the voltage asks for"),
        Quantity.positive("omega", 6.0, "rad/s", "frequency of what the voltage asks for"),
        Quantity.positive("g", 9.81, "m/s^2", "gravity"),
        Quantity.restitution(0.3),
    ),
    gains=(
        Quantity(
            name="Kp",
            unit="V/m",
            meaning="proportional gain",
            default=100.0,
            lower=60.0,
            upper=200.0,
        ),
        Quantity(
            name="Kd",
            unit="V s/m",
            meaning="derivative gain",
            default=1.0,
            lower=-1.0,
            upper=4.0,
        ),
    ),
    model=model,
    starts=({"cosine": 1.0},),
    portraits=(("x", "dx"), ("angle", "dangle")),
    amplitude_of="x",
    drawing=drawing,
)
