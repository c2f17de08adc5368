r"""The double pendulum of the paper with a second DC motor, at the knee: two currents.

Both motors have matrices of their own: resistance, inductance and constants are diagonal, and the
selection names the joints. The knee's motor pulls towards ``rest``. Where its constants are zero
the links move as those of ``motor_pendulum``; the shoulder's two calibrated numbers are declared
here to fourteen digits.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from zeno_orbits import (
    CompletedSystem,
    HybridLagrangian,
    MotorBank,
    Problem,
    Quantity,
    full_drive,
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
    links = inertia1 * rate1**2 + p["m2"] * centre2_speed_squared + p["I2"] * rate2**2
    # The knee's rotor turns against its housing, which link 1 carries.
    rotor = p["J_rotor2"] * v[1] ** 2
    height1 = -p["lc1"] * ca.cos(q[0])
    height2 = -p["L1"] * ca.cos(q[0]) - p["lc2"] * ca.cos(q[0] + q[1])
    return HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=(links + rotor) / 2,
        potential=p["g"] * (p["m1"] * height1 + p["m2"] * height2),
        gap=q[1],
    )


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: four states of the links and two currents."""
    links = lagrangian(p)
    voltage = ca.vertcat(
        -p["Kp"] * links.q[0] - p["Kd"] * links.v[0],
        -p["Kp2"] * (links.q[1] - p["rest"]) - p["Kd2"] * links.v[1],
    )
    motors = MotorBank(
        selection=ca.SX.eye(2),
        resistance=ca.diag(ca.vertcat(p["R"], p["R2"])),
        inductance=ca.diag(ca.vertcat(p["L"], p["L_coil2"])),
        torque_constant=ca.diag(ca.vertcat(p["K_torque"], p["K_torque2"])),
        emf_constant=ca.diag(ca.vertcat(p["K_emf"], p["K_emf2"])),
        voltage=voltage,
    )
    return hybrid_system(links, full_drive(links, motors), p["restitution"])


def _gain(
    name: str, default: float, lower: float, upper: float, unit: str, meaning: str
) -> Quantity:
    return Quantity(
        name=name, unit=unit, meaning=meaning, default=default, lower=lower, upper=upper
    )


PROBLEM = Problem(
    name="two_motors",
    title="double pendulum with a stop, DC motors at the shoulder and at the knee",
    source="motor_pendulum with a second motor; the knee's numbers declared here",
    state_names=("theta1", "theta2", "dtheta1", "dtheta2", "current1", "current2"),
    state_units=("rad", "rad", "rad/s", "rad/s", "A", "A"),
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
        Quantity(
            name="J_rotor2",
            unit="kg m^2",
            meaning="inertia of the rotor at the knee",
            default=0.0,
            lower=0.0,
        ),
        Quantity.positive("R", 3.0, "ohm", "resistance at the shoulder"),
        Quantity.positive("R2", 3.0, "ohm", "resistance at the knee"),
        Quantity.positive("L", 0.002, "H", "inductance at the shoulder"),
        Quantity.positive("L_coil2", 0.002, "H", "inductance at the knee"),
        Quantity.positive("K_torque", 0.03071770892865, "N m/A", "torque constant at the shoulder"),
        Quantity(
            name="K_torque2",
            unit="N m/A",
            meaning="torque constant at the knee",
            default=0.01,
            lower=0.0,
        ),
        Quantity(
            name="K_emf",
            unit="V s/rad",
            meaning="back-EMF constant at the shoulder",
            default=0.03071770892865,
            lower=0.0,
        ),
        Quantity(
            name="K_emf2",
            unit="V s/rad",
            meaning="back-EMF constant at the knee",
            default=0.01,
            lower=0.0,
        ),
        Quantity(
            name="rest", unit="rad", meaning="angle that the knee's motor pulls to", default=-1.0
        ),
        Quantity.positive("g", 9.81, "m/s^2", "gravity"),
        Quantity.restitution(0.2),
    ),
    gains=(
        _gain("Kp", 2.5, 1.0, 6.0, "V/rad", "proportional gain at the shoulder"),
        _gain("Kd", -1.0, -1.5, -0.4, "V s/rad", "derivative gain at the shoulder"),
        _gain("Kp2", 1.0, 0.0, 4.0, "V/rad", "proportional gain at the knee"),
        _gain("Kd2", 0.1, 0.0, 0.5, "V s/rad", "derivative gain at the knee"),
    ),
    model=model,
    starts=({"theta1": 0.6}, {"theta1": 1.2}, {"theta1": -0.8, "theta2": 0.3}),
    portraits=(("theta1", "dtheta1"), ("theta2", "dtheta2")),
    amplitude_of="theta1",
)
