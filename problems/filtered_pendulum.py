r"""The double pendulum of the paper, its motor fed through an LC filter by a PI controller.

The amplifier charges a capacitor through a coil, and the capacitor feeds the motor: three loops of
paper eq. (2) with two currents and a capacitor voltage. The controller adds the integral of the
angle, which leaks. Where the filter vanishes and ``Ki = 0`` the links move as those of
``motor_pendulum``; the two calibrated numbers are declared here to fourteen digits.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from zeno_orbits import (
    Auxiliary,
    Circuit,
    CompletedSystem,
    HybridLagrangian,
    Problem,
    Quantity,
    StateLimit,
    circuit_drive,
    hybrid_system,
)


def lagrangian(p: Mapping[str, ca.SX]) -> HybridLagrangian:
    """Return the links: ``q = (theta1, theta2)``, the stop keeps ``theta2 >= 0``."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    rate1, rate2 = v[0], v[0] + v[1]
    centre2_speed_squared = (
        (p["L1"] * rate1) ** 2
        + (p["lc2"] * rate2) ** 2
        + 2 * p["L1"] * p["lc2"] * rate1 * rate2 * ca.cos(q[1])
    )
    inertia1 = p["I1"] + p["J_rotor"] + p["m1"] * p["lc1"] ** 2
    kinetic = (inertia1 * rate1**2 + p["m2"] * centre2_speed_squared + p["I2"] * rate2**2) / 2
    height1 = -p["lc1"] * ca.cos(q[0])
    height2 = -p["L1"] * ca.cos(q[0]) - p["lc2"] * ca.cos(q[0] + q[1])
    potential = p["g"] * (p["m1"] * height1 + p["m2"] * height2)
    return HybridLagrangian.from_energies(q=q, v=v, kinetic=kinetic, potential=potential, gap=q[1])


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: links, both currents, the capacitor and the integral."""
    links = lagrangian(p)
    angle, rate = links.q[0], links.v[0]
    feed, current = ca.SX.sym("feed"), ca.SX.sym("current")
    capacitor, integral = ca.SX.sym("capacitor"), ca.SX.sym("integral")
    circuit = Circuit(
        currents=ca.vertcat(feed, current),
        voltages=capacitor,
        coenergy=(
            p["L_filter"] * feed**2 / 2
            + p["L"] * current**2 / 2
            + p["K"] * angle * current
            + p["C_filter"] * capacitor**2 / 2
        ),
        resistance=ca.diag(ca.vertcat(p["R_filter"], p["R"])),
        conductance=p["G_filter"],
        incidence=ca.SX([-1, 1]),
        source=ca.vertcat(-p["Kp"] * angle - p["Kd"] * rate - p["Ki"] * integral, 0),
    )
    controller = Auxiliary(states=integral, rate=angle - p["leak"] * integral)
    return hybrid_system(links, (circuit_drive(links, circuit), controller), p["restitution"])


def _gain(
    name: str, default: float, lower: float, upper: float, unit: str, meaning: str
) -> Quantity:
    return Quantity(
        name=name, unit=unit, meaning=meaning, default=default, lower=lower, upper=upper
    )


PROBLEM = Problem(
    name="filtered_pendulum",
    title="double pendulum with a stop, motor behind an LC filter, PI control",
    source="motor_pendulum with another supply; filter and integral declared here",
    state_names=(
        "theta1",
        "theta2",
        "dtheta1",
        "dtheta2",
        "feed",
        "current",
        "capacitor",
        "integral",
    ),
    state_units=("rad", "rad", "rad/s", "rad/s", "A", "A", "V", "rad s"),
    parameters=(
        Quantity.positive("L1", 0.20, "m", "length of link 1"),
        Quantity.positive("lc1", 0.06, "m", "shoulder to the centre of mass of link 1"),
        Quantity.positive("m1", 0.30, "kg", "mass of link 1"),
        Quantity.positive("I1", 0.001, "kg m^2", "inertia of link 1 about its centre of mass"),
        Quantity.positive("lc2", 0.15, "m", "knee to the centre of mass of link 2"),
        Quantity.positive("m2", 0.10, "kg", "mass of link 2"),
        Quantity.positive("I2", 0.00075, "kg m^2", "inertia of link 2 about its centre of mass"),
        Quantity(
            name="J_rotor",
            unit="kg m^2",
            meaning="inertia of the rotor at the shoulder",
            default=0.01792808647924,
            lower=0.0,
        ),
        Quantity.positive("R", 3.0, "ohm", "resistance of the motor"),
        Quantity.positive("L", 0.002, "H", "inductance of the motor"),
        Quantity.positive("K", 0.03071770892865, "N m/A", "torque and back-EMF constant"),
        Quantity.positive("L_filter", 5e-4, "H", "inductance of the filter"),
        Quantity.positive("C_filter", 1e-4, "F", "capacitance of the filter"),
        Quantity(
            name="R_filter", unit="ohm", meaning="resistance of the filter", default=0.1, lower=0.0
        ),
        Quantity(
            name="G_filter",
            unit="A/V",
            meaning="conductance beside the capacitor, which damps the filter",
            default=0.2,
            lower=0.0,
        ),
        Quantity(name="leak", unit="1/s", meaning="leak of the integral", default=1.0, lower=0.0),
        Quantity.positive("g", 9.81, "m/s^2", "gravity"),
        Quantity.restitution(0.2),
    ),
    gains=(
        _gain("Kp", 2.5, 1.0, 6.0, "V/rad", "proportional gain"),
        _gain("Kd", -1.0, -1.5, -0.4, "V s/rad", "derivative gain; below zero it feeds energy in"),
        _gain("Ki", 0.5, 0.0, 2.0, "V/rad s", "integral gain"),
    ),
    model=model,
    starts=({"theta1": 0.6}, {"theta1": 1.2}, {"theta1": -0.8, "theta2": 0.3}),
    portraits=(("theta1", "dtheta1"), ("theta2", "dtheta2")),
    amplitude_of="theta1",
    escapes={
        "theta1": StateLimit(beyond=6.283185307179586, phrase="link 1 rotates"),
        "theta2": StateLimit(beyond=6.283185307179586, phrase="link 2 goes over the top"),
    },
)
