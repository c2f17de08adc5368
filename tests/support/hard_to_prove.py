"""Oscillators whose orbits are ordinary and whose formulas ask something special of a proof."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import casadi as ca

from zeno_orbits import (
    Clock,
    HybridLagrangian,
    MotorBank,
    Problem,
    Quantity,
    full_drive,
    hybrid_system,
    load_problem,
    no_drive,
)

Formula = Callable[[Mapping[str, ca.SX]], Any]


def _forced(name: str, states: tuple[str, ...], model: Formula, **others: Any) -> Problem:
    """Return a problem with the parameters of the forced oscillator."""
    published = load_problem("forced_oscillator")
    units = tuple("m/s" if state.startswith("d") else "m" for state in states)
    return replace(
        published,
        name=name,
        title=name,
        state_names=(*states, "cosine", "sine"),
        state_units=(*units, "1", "1"),
        model=model,
        portraits=(),
        amplitude_of=states[0],
        **others,
    )


def double_well() -> Problem:
    """Return the forced oscillator with a second mass in a double well, not coupled to it.

    The second mass is at rest at 0, which repels, and at 1 and -1, which attract.
    """

    def model(p: Mapping[str, ca.SX]) -> Any:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        clock = Clock.at(p["omega"])
        pair = HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=p["m"] * ca.sumsqr(v) / 2,
            potential=p["k"] * (p["stop"] - q[0]) ** 2 / 2 - q[1] ** 2 / 2 + q[1] ** 4 / 4,
            gap=q[0],
            passive_force=-p["c"] * v,
            applied_force=ca.vertcat(-p["A"] * clock.cosine, 0),
            clock=clock,
        )
        return hybrid_system(pair, no_drive(pair), p["restitution"])

    states = ("distance", "well", "dd", "dwell")
    return _forced("double_well", states, model, starts=({"cosine": 1.0},))


def two_masses() -> Problem:
    """Return the forced oscillator beside a second mass on a damped spring, not coupled to it.

    The numbers of each mass end in its number, and have either sign.
    """

    def model(p: Mapping[str, ca.SX]) -> Any:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        clock = Clock.at(p["omega"])
        pair = HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=p["m1"] * v[0] ** 2 / 2 + p["m2"] * v[1] ** 2 / 2,
            potential=p["k1"] * (p["stop"] - q[0]) ** 2 / 2 + p["k2"] * q[1] ** 2 / 2,
            gap=q[0],
            passive_force=ca.vertcat(-p["c1"] * v[0], -p["c2"] * v[1]),
            applied_force=ca.vertcat(-p["A1"] * clock.cosine, 0),
            clock=clock,
        )
        return hybrid_system(pair, no_drive(pair), p["restitution"])

    published = load_problem("forced_oscillator")
    kept = [one for one in published.parameters if one.name in ("omega", "stop", "restitution")]
    usual = {"m1": 1.0, "c1": 1.9, "k1": 1.0, "A1": 1.0, "m2": 2.0, "c2": 1.0, "k2": 3.0}
    given = [Quantity(name=n, unit="1", meaning=n, default=x) for n, x in usual.items()]
    states = ("distance", "beside", "dd", "dbeside")
    return _forced(
        "two_masses", states, model, starts=({"cosine": 1.0},), parameters=(*given, *kept)
    )


def with_gap(gap: Callable[[ca.SX], Any], name: str = "other_gap") -> Problem:
    """Return the forced oscillator with another formula of its gap, zero where the distance is."""
    return _oscillator(name, gap, lambda _: 0)


def with_force(force: Callable[[ca.SX], Any], name: str = "other_force") -> Problem:
    """Return the forced oscillator with a further force of its distance."""
    return _oscillator(name, lambda q: q, force)


def _oscillator(name: str, gap: Callable[[ca.SX], Any], force: Callable[[ca.SX], Any]) -> Problem:
    def model(p: Mapping[str, ca.SX]) -> Any:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        clock = Clock.at(p["omega"])
        mass = HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=p["m"] * v**2 / 2,
            potential=p["k"] * (p["stop"] - q) ** 2 / 2,
            gap=gap(q),
            passive_force=-p["c"] * v,
            applied_force=-p["A"] * clock.cosine + force(q),
            clock=clock,
        )
        return hybrid_system(mass, no_drive(mass), p["restitution"])

    return _forced(name, ("distance", "ddistance"), model, starts=({"cosine": 1.0},))


def curved_guide() -> Problem:
    """Return a bead on a parabola, a holonomic constraint, forced against a stop."""

    def model(p: Mapping[str, ca.SX]) -> Any:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        clock = Clock.at(p["omega"])
        bead = HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=p["m"] * ca.sumsqr(v) / 2,
            potential=p["k"] * (p["stop"] - q[0]) ** 2 / 2,
            gap=q[0],
            passive_force=-p["c"] * v,
            applied_force=ca.vertcat(-p["A"] * clock.cosine, 0),
            holonomic=q[1] - 0.3 * q[0] ** 2 - 0.1 * q[0],
            clock=clock,
        )
        return hybrid_system(bead, no_drive(bead), p["restitution"])

    states = ("distance", "height", "ddistance", "dheight")
    return _forced("curved_guide", states, model, starts=({"cosine": 1.0},))


_LENGTH = 10.0
"""Length of a pendulum whose weight is as large: nearly a spring of stiffness 1."""


def pendulum() -> Problem:
    """Return a pendulum in its angle, pushed by a clock against a stop beside its lowest place."""

    def model(p: Mapping[str, ca.SX]) -> Any:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        clock = Clock.at(p["omega"])
        bob = HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=p["m"] * _LENGTH**2 * v**2 / 2,
            potential=-p["k"] * _LENGTH**2 * ca.cos(q),
            gap=_LENGTH * ca.sin(q) + p["stop"],
            passive_force=-p["c"] * _LENGTH**2 * v,
            applied_force=-p["A"] * clock.cosine * _LENGTH * ca.cos(q),
            clock=clock,
        )
        return hybrid_system(bob, no_drive(bob), p["restitution"])

    start = {"angle": 0.1, "cosine": 1.0}
    return _forced("pendulum", ("angle", "dangle"), model, starts=(start,))


def cartesian_pendulum(tension: float = 1.0) -> Problem:
    """Return the same pendulum in Cartesian coordinates, its length a holonomic constraint.

    Args:
        tension: Tension of the rod, as a part of that which keeps the length.
    """

    def model(p: Mapping[str, ca.SX]) -> Any:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        clock = Clock.at(p["omega"])
        bob = HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=p["m"] * ca.sumsqr(v) / 2,
            potential=p["k"] * _LENGTH * q[1],
            gap=q[0] + p["stop"],
            passive_force=-p["c"] * v,
            applied_force=ca.vertcat(-p["A"] * clock.cosine, 0),
            holonomic=(ca.sumsqr(q) - _LENGTH**2) / 2,
            clock=clock,
        )
        system = hybrid_system(bob, no_drive(bob), p["restitution"])
        if tension == 1.0:
            return system
        loose = (1 - tension) * ca.vertcat(0, 0, q[0], q[1], 0, 0)
        return replace(system, free_flow=system.free_flow + loose * ca.sumsqr(v) / ca.sumsqr(q))

    start = {"x": 1.0, "y": -math.sqrt(_LENGTH**2 - 1.0), "cosine": 1.0}
    return _forced("cartesian_pendulum", ("x", "y", "dx", "dy"), model, starts=(start,))


def leg() -> Problem:
    """Return a leg of two links behind a rotor and a series spring, its voltage by a clock.

    Nine states: rotor, hip and knee with their rates, current, clock. The knee has the stop.
    """

    def model(p: Mapping[str, ca.SX]) -> Any:
        q, v = ca.SX.sym("q", 3), ca.SX.sym("v", 3)
        clock = Clock.at(p["omega"])
        rotor, hip, knee = q[0], q[1], q[2]
        shank = v[1] + v[2]
        turn = ca.cos(knee + p["bend"])
        kinetic = (
            p["J"] * v[0] ** 2
            + (p["I1"] + p["m2"] * p["L1"] ** 2) * v[1] ** 2
            + p["I2"] * shank**2
            + 2 * p["m2"] * p["L1"] * p["l2"] * v[1] * shank * turn
        ) / 2
        potential = (
            p["k"] * (rotor - hip) ** 2 / 2
            - p["g"] * (p["m1"] * p["l1"] + p["m2"] * p["L1"]) * ca.cos(hip)
            - p["g"] * p["m2"] * p["l2"] * ca.cos(hip + knee + p["bend"])
        )
        legs = HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=kinetic,
            potential=potential,
            gap=knee,
            passive_force=ca.vertcat(
                -p["c"] * (v[0] - v[1]), p["c"] * (v[0] - v[1]), -p["b"] * v[2]
            ),
            clock=clock,
        )
        motor = MotorBank(
            selection=ca.SX([1, 0, 0]),
            resistance=p["R"],
            inductance=p["L"],
            torque_constant=p["K"],
            emf_constant=p["K"],
            voltage=p["Kp"] * (p["A"] * clock.sine - rotor) - p["Kd"] * v[0],
        )
        return hybrid_system(legs, full_drive(legs, motor), p["restitution"])

    return Problem(
        name="leg",
        title="leg with a series spring",
        source="these tests",
        state_names=(
            *("rotor", "hip", "knee", "drotor", "dhip", "dknee"),
            *("current", "cosine", "sine"),
        ),
        state_units=("rad", "rad", "rad", "rad/s", "rad/s", "rad/s", "A", "1", "1"),
        parameters=(
            Quantity.positive("J", 0.01, "kg m^2", "inertia of the rotor behind its gear"),
            Quantity.positive("I1", 0.004, "kg m^2", "inertia of the thigh about the hip"),
            Quantity.positive("I2", 0.003, "kg m^2", "inertia of the shank about the knee"),
            Quantity.positive("m1", 0.3, "kg", "mass of the thigh"),
            Quantity.positive("m2", 0.1, "kg", "mass of the shank"),
            Quantity.positive("L1", 0.2, "m", "length of the thigh"),
            Quantity.positive("l1", 0.1, "m", "hip to the centre of the thigh"),
            Quantity.positive("l2", 0.15, "m", "knee to the centre of the shank"),
            Quantity.positive("bend", 0.3, "rad", "angle of the knee on its stop"),
            Quantity.positive("k", 20.0, "N m/rad", "series spring"),
            Quantity.positive("c", 0.05, "N m s/rad", "damping of the series spring"),
            Quantity.positive("b", 2e-4, "N m s/rad", "friction of the knee"),
            Quantity.positive("R", 1.0, "ohm", "resistance"),
            Quantity.positive("L", 0.002, "H", "inductance"),
            Quantity.positive("K", 0.1, "N m/A", "motor constant"),
            Quantity.positive("Kp", 60.0, "V/rad", "proportional gain"),
            Quantity.positive("Kd", 1.0, "V s/rad", "derivative gain"),
            Quantity.positive("A", 0.8, "rad", "amplitude that the voltage asks for"),
            Quantity.positive("omega", 6.0, "rad/s", "frequency"),
            Quantity.positive("g", 9.81, "m/s^2", "gravity"),
            Quantity.restitution(0.2),
        ),
        gains=(),
        model=model,
        starts=({"cosine": 1.0},),
        portraits=(("hip", "dhip"),),
        amplitude_of="hip",
    )
