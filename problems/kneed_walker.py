r"""A walker with knees on a slope: a knee stop, and a heel strike at which the legs change names.

Point feet and no motor. The stance leg is straight, with the angle ``q1`` from the vertical, and
the hip at ``L (-sin q1, cos q1)``. The swing leg has the thigh ``q2`` and the shank ``q3``. The
knee stop is ``q2 - q3 >= 0``. At heel strike the straight swing leg becomes the stance leg: the
foot stays, both knees are rigid, and the new swing knee is free.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import casadi as ca

from zeno_orbits import (
    CompletedSystem,
    Drawing,
    HybridLagrangian,
    Problem,
    Quantity,
    Stop,
    Switch,
    hybrid_system,
    no_drive,
)

Point = tuple[ca.SX, ca.SX]
"""A mass and its place."""


def along(angle: ca.SX) -> ca.SX:
    """Return the direction from the foot to the hip of a leg."""
    return ca.vertcat(-ca.sin(angle), ca.cos(angle))


def leg(p: Mapping[str, ca.SX], hip: ca.SX, thigh: ca.SX, shank: ca.SX) -> list[Point]:
    """Return the masses of a leg that hangs from the hip."""
    knee = hip - p["l_thigh"] * along(thigh)
    upper = hip - (p["l_thigh"] - p["b_thigh"]) * along(thigh)
    return [
        (p["m_thigh"], upper),
        (p["m_shank"], knee - (p["l_shank"] - p["b_shank"]) * along(shank)),
    ]


def energies(masses: Sequence[Point], q: ca.SX, v: ca.SX, g: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the kinetic and the potential energy of point masses."""
    kinetic = potential = ca.SX(0)
    for mass, place in masses:
        velocity = ca.jtimes(place, q, v)
        kinetic += mass * ca.dot(velocity, velocity) / 2
        potential += mass * g * place[1]
    return kinetic, potential


def after_heel_strike(p: Mapping[str, ca.SX], q: ca.SX, v: ca.SX) -> ca.SX:
    """Return the rates of both straight legs after a plastic impact of the swing foot."""
    foot, stance, swing, rates = (ca.SX.sym("r", n) for n in (2, 1, 1, 4))
    state = ca.vertcat(foot, stance, swing)
    length = p["l_thigh"] + p["l_shank"]
    # In units of the leg the foot has the scale of an angle, so rounding does not depend on units.
    hip = length * (foot + along(stance))
    masses = [*leg(p, hip, stance, stance), *leg(p, hip, swing, swing), (p["m_hip"], hip)]
    mass = ca.hessian(energies(masses, state, rates, p["g"])[0], rates)[0]
    held = ca.jacobian(hip - length * along(swing), state)
    # v+ = v- - M^-1 J' (J M^-1 J')^-1 J v-, with the Jacobian J of the foot that strikes.
    before = ca.vertcat(0, 0, v[0], v[1])
    response = ca.mtimes(ca.inv(mass), held.T)
    impulse = ca.mtimes(ca.inv(ca.mtimes(held, response)), ca.mtimes(held, before))
    after = (before - ca.mtimes(response, impulse))[2:4]
    return ca.substitute(after, state, ca.vertcat(0, 0, q[0], q[1]))


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: ``q = (q1, q2, q3)``, angles from the vertical."""
    q, v = ca.SX.sym("q", 3), ca.SX.sym("v", 3)
    length = p["l_thigh"] + p["l_shank"]
    hip = length * along(q[0])
    masses = [*leg(p, hip, q[0], q[0]), *leg(p, hip, q[1], q[2]), (p["m_hip"], hip)]
    kinetic, potential = energies(masses, q, v, p["g"])
    knee = Stop(name="knee", gap=q[1] - q[2], restitution=p["restitution"])
    walker = HybridLagrangian.from_energies(
        q=q, v=v, kinetic=kinetic, potential=potential, stops=(knee,)
    )
    rates = after_heel_strike(p, q, v)
    strike = Switch(
        name="heel strike",
        guard=q[0] + q[1] + 2 * p["slope"],
        armed=q[1] + p["slope"] - p["ahead"],
        q_after=ca.vertcat(q[1], q[0], q[0]),
        v_after=ca.vertcat(rates[1], rates[0], rates[0]),
    )
    return hybrid_system(walker, no_drive(walker), switches=(strike,))


def drawing(x: Mapping[str, ca.SX], p: Mapping[str, ca.SX]) -> Drawing:
    """Return both legs on the slope, with the stance foot at the origin [m]."""
    length = p["l_thigh"] + p["l_shank"]
    hip = length * along(x["q1"])
    stance_knee = p["l_shank"] * along(x["q1"])
    knee = hip - p["l_thigh"] * along(x["q2"])
    foot = knee - p["l_shank"] * along(x["q3"])
    # The slope falls in the direction of the walk. It is far longer than a frame.
    slope = ca.vertcat(ca.cos(p["slope"]), -ca.sin(p["slope"]))
    points = {
        "ground": [-20 * length * slope, 20 * length * slope],
        "stance leg": [ca.SX.zeros(2), stance_knee, hip],
        "swing leg": [foot, knee, hip],
        "stance knee": [stance_knee],
        "swing knee": [knee],
        "hip": [hip],
    }
    return {name: [(one[0], one[1]) for one in line] for name, line in points.items()}


PROBLEM = Problem(
    name="kneed_walker",
    title="walker with bouncing knees on a slope, heel strike as a switch, no motor",
    source="McGeer, Passive walking with knees (1990); numbers of V. F. Hsu Chen, MIT (2007)",
    state_names=("q1", "q2", "q3", "dq1", "dq2", "dq3"),
    state_units=("rad", "rad", "rad", "rad/s", "rad/s", "rad/s"),
    parameters=(
        Quantity.positive("l_thigh", 0.5, "m", "length of the thigh"),
        Quantity.positive("l_shank", 0.5, "m", "length of the shank"),
        Quantity.positive("m_hip", 0.5, "kg", "mass at the hip"),
        Quantity.positive("m_thigh", 0.5, "kg", "mass of a thigh"),
        Quantity.positive("m_shank", 0.05, "kg", "mass of a shank"),
        Quantity.positive("b_thigh", 0.175, "m", "knee to the mass of the thigh"),
        Quantity.positive("b_shank", 0.375, "m", "foot to the mass of the shank"),
        Quantity.positive("slope", math.asin(7.25 / 144), "rad", "angle of the slope"),
        Quantity(
            name="ahead",
            unit="rad",
            meaning="angle of the swing leg beyond the slope's normal, above which it may strike",
            default=0.02,
            lower=0.0,
        ),
        Quantity.restitution(0.2),
        Quantity.positive("g", 9.8, "m/s^2", "gravity"),
    ),
    gains=(),
    model=model,
    starts=({"q1": 0.188, "q2": -0.289, "q3": -0.289, "dq1": -1.11, "dq2": -0.06, "dq3": -0.06},),
    portraits=(("q1", "dq1"), ("q2", "dq2")),
    amplitude_of="q2",
    drawing=drawing,
)
