"""A double pendulum with a stop at the knee and a DC motor at the shoulder (paper, section IV).

The paper publishes two numbers of its machine, the coefficients of Theorem 1's acceleration
``d2h/dt2 = -2.92437 i - 27.5697 sin(theta1)``, and no masses or lengths. This problem declares a
set of plausible ones and solves the rotor inertia and the torque constant for the two numbers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import casadi as ca

from zeno_orbits import (
    CompletedSystem,
    Contact,
    Controller,
    Drawing,
    Friction,
    Gear,
    HBridge,
    HybridLagrangian,
    InputError,
    MotorBank,
    Output,
    Problem,
    Quantity,
    Rig,
    Sensors,
    StateLimit,
    corrected_drive,
    full_drive,
    hybrid_system,
    quasi_static_drive,
)

CURRENT_COEFFICIENT = 2.92437
"""Published: minus the factor of the current in d2h/dt2 [rad/(s^2 A)]."""
GRAVITY_COEFFICIENT = 27.5697
"""Published: minus the factor of sin(theta1) in d2h/dt2 [rad/s^2]."""


def lagrangian(p: Mapping[str, ca.SX]) -> HybridLagrangian:
    """Return the mechanism: ``q = (theta1, theta2)``, the stop keeps ``theta2 >= 0``.

    ``theta1`` is measured from the downward vertical, ``theta2`` from link 1.
    """
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    rate1, rate2 = v[0], v[0] + v[1]
    centre2_speed_squared = (
        (p["L1"] * rate1) ** 2
        + (p["lc2"] * rate2) ** 2
        + 2 * p["L1"] * p["lc2"] * rate1 * rate2 * ca.cos(q[1])
    )
    link1_inertia = p["I1"] + p["J_rotor"] + p["m1"] * p["lc1"] ** 2
    kinetic = (link1_inertia * rate1**2 + p["m2"] * centre2_speed_squared + p["I2"] * rate2**2) / 2
    height1 = -p["lc1"] * ca.cos(q[0])
    height2 = -p["L1"] * ca.cos(q[0]) - p["lc2"] * ca.cos(q[0] + q[1])
    potential = p["g"] * (p["m1"] * height1 + p["m2"] * height2)
    return HybridLagrangian.from_energies(q=q, v=v, kinetic=kinetic, potential=potential, gap=q[1])


def motor(mechanism: HybridLagrangian, p: Mapping[str, ca.SX]) -> MotorBank:
    """Return the shoulder motor under ``V = -Kp theta1 - Kd dtheta1`` (paper eq. 9)."""
    return MotorBank(
        selection=ca.SX([1, 0]),
        resistance=p["R"],
        inductance=p["L"],
        torque_constant=p["K_torque"],
        emf_constant=p["K_emf"],
        voltage=-p["Kp"] * mechanism.q[0] - p["Kd"] * mechanism.v[0],
    )


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system with the motor's current dynamics: five states."""
    mechanism = lagrangian(p)
    return hybrid_system(mechanism, full_drive(mechanism, motor(mechanism, p)), p["restitution"])


def quasi_static(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system in the limit ``L = 0``: four states."""
    mechanism = lagrangian(p)
    # The limit does not ask for an inductance, but a bank of motors has one.
    drive = quasi_static_drive(mechanism, motor(mechanism, {**p, "L": ca.SX(0)}))
    return hybrid_system(mechanism, drive, p["restitution"])


def corrected(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system with the inductance to first order: four states."""
    mechanism = lagrangian(p)
    return hybrid_system(
        mechanism, corrected_drive(mechanism, motor(mechanism, p)), p["restitution"]
    )


def tip_height(x: Mapping[str, ca.SX], p: Mapping[str, ca.SX]) -> ca.SX:
    """Return how high the tip of link 2 is above the shoulder [m]."""
    return -p["L1"] * ca.cos(x["theta1"]) - p["L2"] * ca.cos(x["theta1"] + x["theta2"])


def drawing(x: Mapping[str, ca.SX], p: Mapping[str, ca.SX]) -> Drawing:
    """Return both links with their joints, and the stop that link 1 carries below the knee [m]."""
    knee = (p["L1"] * ca.sin(x["theta1"]), -p["L1"] * ca.cos(x["theta1"]))
    hand = x["theta1"] + x["theta2"]
    tip = (knee[0] + p["L2"] * ca.sin(hand), knee[1] - p["L2"] * ca.cos(hand))

    def beside(along: ca.SX, aside: ca.SX) -> tuple[ca.SX, ca.SX]:
        turn, lift = ca.sin(x["theta1"]), ca.cos(x["theta1"])
        return knee[0] + along * turn - aside * lift, knee[1] - along * lift - aside * turn

    stop = [beside(0.1 * p["L2"], 0.08 * p["L2"]), beside(0.25 * p["L2"], 0.03 * p["L2"])]
    links = {"link 1": [(0, 0), knee], "link 2": [knee, tip], "stop": [knee, *stop]}
    return links | {"shoulder": [(0, 0)], "knee": [knee]}


def calibrate(values: Mapping[str, float]) -> dict[str, float]:
    r"""Return ``J_rotor``, ``K_torque`` and ``K_emf`` where they are not given.

    At a Zeno equilibrium, with :math:`\Delta = AB - C^2`,

    .. math:: \ddot h = -\frac{(B+C) K_\varphi}{\Delta}\,\imath
        - g\,\frac{(A+C) E - (B+C) D}{\Delta} \sin\theta_1

    so the second published number fixes :math:`A`, which holds the rotor inertia, and the first
    then fixes :math:`K_\varphi`. The back-EMF constant is the torque constant.

    Raises:
        InputError: If no rotor inertia gives the published numbers; it names the broken bound.
    """
    known = dict(values)
    g = known["g"]
    b = known["I2"] + known["m2"] * known["lc2"] ** 2
    c = known["m2"] * known["L1"] * known["lc2"]
    d = known["m1"] * known["lc1"] + known["m2"] * known["L1"]
    e = known["m2"] * known["lc2"]
    bare = known["I1"] + known["m1"] * known["lc1"] ** 2 + known["m2"] * known["L1"] ** 2
    if "J_rotor" not in known:
        known["J_rotor"] = _rotor_inertia(g, bare, b, c, d, e)
    a = bare + known["J_rotor"]
    if "K_torque" not in known:
        known["K_torque"] = CURRENT_COEFFICIENT * (a * b - c**2) / (b + c)
    return {
        "J_rotor": known["J_rotor"],
        "K_torque": known["K_torque"],
        "K_emf": known.get("K_emf", known["K_torque"]),
    }


def _rotor_inertia(g: float, bare: float, b: float, c: float, d: float, e: float) -> float:
    numerator = g * ((b + c) * d - c * e) - GRAVITY_COEFFICIENT * c**2
    denominator = g * e - GRAVITY_COEFFICIENT * b
    limit = g / GRAVITY_COEFFICIENT
    inertia = numerator / denominator - bare if denominator != 0 else math.nan
    if inertia >= 0:
        return inertia
    bound = (
        f"(I2 + m2 lc2^2) / (m2 lc2) must be below g / 27.5697 = {limit:.6g} m, "
        f"but it is {b / e:.6g} m"
        if denominator <= 0
        else f"J_rotor must not be negative, but it would be {inertia:.6g} kg m^2"
    )
    raise InputError(
        "Argument `parameters` must allow the published 27.5697, "
        f"but no rotor inertia does: {bound}."
    )


def _gain(
    name: str, default: float, lower: float, upper: float, unit: str, meaning: str
) -> Quantity:
    return Quantity(
        name=name, unit=unit, meaning=meaning, default=default, lower=lower, upper=upper
    )


MACHINE = Rig(
    # A rubber ball as stop: it gives way by one or two degrees, for five milliseconds.
    contact=Contact(stiffness=1.5e4, exponent=1.5, slowest=1e-3),
    friction={
        "theta1": Friction(coulomb=5e-4, viscous=5e-5),
        "theta2": Friction(coulomb=1e-4, viscous=1e-5),
    },
    gears={1: Gear(rotor_inertia=0.0175, play=math.radians(0.2), stiffness=3000.0, loss=5.0)},
    bridge=HBridge(supply=12.0, resistance=0.05, frequency=20e3, dead_time=5e-7, diode_drop=0.7),
    controller=Controller(period=1e-3, delay=1e-3),
    sensors=Sensors(
        resolution=2 * math.pi / 8192, noise=1e-4, filter_time=2e-3, current_noise=0.01
    ),
)
"""What a small machine of this kind may have. Declared here as the masses are, not measured."""

FULL = Problem(
    name="motor_pendulum",
    title="double pendulum with a stop, DC motor at the shoulder, PD control",
    source="Nadubettu Yadukumar, Kothapalli and Ames, section IV; masses and lengths declared here",
    state_names=("theta1", "theta2", "dtheta1", "dtheta2", "current"),
    state_units=("rad", "rad", "rad/s", "rad/s", "A"),
    parameters=(
        Quantity.positive("L1", 0.20, "m", "length of link 1"),
        Quantity.positive("lc1", 0.06, "m", "shoulder to the centre of mass of link 1"),
        Quantity.positive("m1", 0.30, "kg", "mass of link 1"),
        Quantity.positive("I1", 0.001, "kg m^2", "inertia of link 1 about its centre of mass"),
        Quantity.positive("L2", 0.30, "m", "length of link 2; for pictures only"),
        Quantity.positive("lc2", 0.15, "m", "knee to the centre of mass of link 2"),
        Quantity.positive("m2", 0.10, "kg", "mass of link 2"),
        Quantity.positive("I2", 0.00075, "kg m^2", "inertia of link 2 about its centre of mass"),
        Quantity(
            name="J_rotor",
            unit="kg m^2",
            meaning="inertia of rotor and gears at the shoulder; calibrated",
            default=None,
            lower=0.0,
        ),
        Quantity.positive("R", 3.0, "ohm", "resistance of the motor circuit"),
        Quantity.positive(
            "L",
            0.002,
            "H",
            "inductance of the motor circuit",
            instead="For L = 0 take `motor_pendulum@quasi_static`.",
        ),
        Quantity.positive("K_torque", None, "N m/A", "torque constant at the shoulder; calibrated"),
        Quantity(
            name="K_emf",
            unit="V s/rad",
            meaning="back-EMF constant at the shoulder; equal to K_torque",
            default=None,
            lower=0.0,
        ),
        Quantity.restitution(0.2),
        Quantity(
            name="g", unit="m/s^2", meaning="gravity", default=9.81, lower=0.0, excluded=(0.0,)
        ),
    ),
    gains=(
        _gain("Kp", 2.5, 1.0, 6.0, "V/rad", "proportional gain"),
        _gain("Kd", -1.0, -1.5, -0.4, "V s/rad", "derivative gain; below zero it feeds energy in"),
    ),
    model=model,
    starts=({"theta1": 0.6}, {"theta1": 1.2}, {"theta1": -0.8, "theta2": 0.3}),
    portraits=(("theta1", "dtheta1"), ("theta2", "dtheta2")),
    amplitude_of="theta1",
    derive=calibrate,
    # Link 2 swings to half a turn and comes back; after a whole one it meets the stop from behind.
    # Link 1 never came back from the top in what was tried, but only a whole turn is beyond doubt.
    escapes={
        "theta1": StateLimit(beyond=2 * math.pi, phrase="link 1 rotates"),
        "theta2": StateLimit(beyond=2 * math.pi, phrase="link 2 goes over the top"),
    },
    outputs=(Output(name="tip_height", unit="m", formula=tip_height),),
    drawing=drawing,
    reference=Path(__file__).with_name("reference.py"),
    rig=MACHINE,
)

WITHOUT_CURRENT = replace(
    FULL,
    state_names=FULL.state_names[:4],
    state_units=FULL.state_units[:4],
    rig=None,
    reference=Path(__file__).with_name("reduced_reference.py"),
)

PROBLEM = replace(
    FULL,
    fidelities={
        "corrected": replace(
            WITHOUT_CURRENT,
            title=f"{FULL.title}; its inductance to first order",
            model=corrected,
            parameters=tuple(
                replace(quantity, excluded=(), instead="") if quantity.name == "L" else quantity
                for quantity in FULL.parameters
            ),
        ),
        "quasi_static": replace(
            WITHOUT_CURRENT,
            title=f"{FULL.title}; no inductance",
            model=quasi_static,
            parameters=tuple(quantity for quantity in FULL.parameters if quantity.name != "L"),
        ),
    },
)
