r"""A double pendulum with a stop at the knee that a slow periodic torque swings: no motor.

The torque acts at the shoulder as ``A cos(omega t)``. No current, no voltage and no feedback are
modelled: four states of the links and two of the clock. The period is that of the torque.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from zeno_orbits import (
    Clock,
    CompletedSystem,
    HybridLagrangian,
    Problem,
    Quantity,
    hybrid_system,
    no_drive,
)


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: ``q = (theta1, theta2)``, the stop keeps ``theta2 >= 0``."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    clock = Clock.at(p["omega"])
    rate1, rate2 = v[0], v[0] + v[1]
    centre2_speed_squared = (
        (p["L1"] * rate1) ** 2
        + (p["lc2"] * rate2) ** 2
        + 2 * p["L1"] * p["lc2"] * rate1 * rate2 * ca.cos(q[1])
    )
    inertia1 = p["I1"] + p["m1"] * p["lc1"] ** 2
    kinetic = (inertia1 * rate1**2 + p["m2"] * centre2_speed_squared + p["I2"] * rate2**2) / 2
    height1 = -p["lc1"] * ca.cos(q[0])
    height2 = -p["L1"] * ca.cos(q[0]) - p["lc2"] * ca.cos(q[0] + q[1])
    links = HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=kinetic,
        potential=p["g"] * (p["m1"] * height1 + p["m2"] * height2),
        gap=q[1],
        passive_force=ca.vertcat(-p["b1"] * v[0], -p["b2"] * v[1]),
        applied_force=ca.vertcat(p["A"] * clock.cosine, 0),
        clock=clock,
    )
    return hybrid_system(links, no_drive(links), p["restitution"])


PROBLEM = Problem(
    name="torque_pendulum",
    title="double pendulum with a stop, swung by a slow periodic torque, no motor",
    source="the class of Or and Ames, HSCC 2009; numbers declared here",
    state_names=("theta1", "theta2", "dtheta1", "dtheta2", "cosine", "sine"),
    state_units=("rad", "rad", "rad/s", "rad/s", "1", "1"),
    parameters=(
        Quantity.positive("L1", 0.20, "m", "length of link 1"),
        Quantity.positive("lc1", 0.06, "m", "shoulder to the centre of mass of link 1"),
        Quantity.positive("m1", 0.30, "kg", "mass of link 1"),
        Quantity.positive("I1", 0.019, "kg m^2", "inertia of link 1 about its centre of mass"),
        Quantity.positive("lc2", 0.15, "m", "knee to the centre of mass of link 2"),
        Quantity.positive("m2", 0.10, "kg", "mass of link 2"),
        Quantity.positive("I2", 0.00075, "kg m^2", "inertia of link 2 about its centre of mass"),
        Quantity(
            name="b1", unit="N m s/rad", meaning="friction of the shoulder", default=0.1, lower=0.0
        ),
        Quantity(
            name="b2", unit="N m s/rad", meaning="friction of the knee", default=0.0, lower=0.0
        ),
        Quantity(name="A", unit="N m", meaning="amplitude of the torque", default=0.3, lower=0.0),
        Quantity.positive("omega", 3.0, "rad/s", "frequency of the torque"),
        Quantity.positive("g", 9.81, "m/s^2", "gravity"),
        Quantity.restitution(0.3),
    ),
    gains=(),
    model=model,
    starts=({"cosine": 1.0}, {"theta1": 0.6, "cosine": 1.0}),
    portraits=(("theta1", "dtheta1"), ("theta2", "dtheta2")),
    amplitude_of="theta1",
)
