r"""A walker with two straight legs on flat ground, and a torque at the hip by feedback.

``hip`` is the angle of the swing leg ahead of the stance leg, and ``stance`` that of the stance leg
from the vertical, as encoders show them. At heel strike the legs change names. A boom carries a
part of the hip, so another mass weighs than is inert. The controller's torque is
:math:`push + K_{hip}\,hip + K_{stance}\,stance`.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

import zeno_orbits as zo


def after_heel_strike(p: Mapping[str, ca.SX], hip: ca.SX, ds: ca.SX, dw: ca.SX) -> ca.SX:
    """Return the rates of the new stance leg and the new swing leg, if the swing foot stays.

    The angular momentum of both legs about that foot is kept, and that of the leg that lifts off
    about the hip. Their values before are those of the rates `ds` and `dw`.
    """
    length, moment, cosine = p["l"], p["m"] * p["lc"] * p["l"], ca.cos(hip)
    weight = (2 * p["m"] + p["m_hip"]) * length**2
    inertia = p["J"] + weight - 2 * moment
    both = (p["J"] - moment) * (ds + dw) + (weight - 2 * moment) * cosine * ds
    rows = [[inertia - moment * cosine, p["J"] - moment * cosine], [-moment * cosine, p["J"]]]
    return ca.solve(ca.blockcat(rows), ca.vertcat(both, (p["J"] - moment) * ds))


def torque(x: Mapping[str, ca.SX], p: Mapping[str, ca.SX]) -> ca.SX:
    """Return the torque of the controller [N m]."""
    return p["push"] + p["K_hip"] * x["hip"] + p["K_stance"] * x["stance"]


def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return the completed system: ``q = (hip, stance)``."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    hip, stance, ds, dw = q[0], q[1], v[1], v[1] - v[0]
    moment, legs = p["m"] * p["lc"], 2 * p["m"] * p["l"]
    inertia = p["J"] + (legs + p["m_hip"] * p["l"] - 2 * moment) * p["l"]
    weight = legs + p["m_weight"] * p["l"] - moment
    walker = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=(inertia * ds**2 + p["J"] * dw**2) / 2 - moment * p["l"] * ca.cos(hip) * ds * dw,
        potential=p["g"] * (weight * ca.cos(stance) - moment * ca.cos(stance - hip)),
        passive_force=ca.vertcat(-p["viscous"] * v[0] - p["dry"] * ca.tanh(v[0] / 0.05), 0),
        applied_force=ca.vertcat(torque({"hip": hip, "stance": stance}, p), 0),
    )
    rates = after_heel_strike(p, hip, ds, dw)
    strike = zo.Switch(
        name="heel strike",
        guard=hip - 2 * stance,
        armed=hip - p["ahead"],
        q_after=ca.vertcat(-hip, stance - hip),
        v_after=ca.vertcat(rates[0] - rates[1], rates[0]),
    )
    return zo.hybrid_system(walker, zo.no_drive(walker), switches=(strike,))


def within(lower: float, upper: float, name: str, default: float, *words: str) -> zo.Quantity:
    """Return a gain or a parameter with its range, unit and meaning."""
    unit, meaning = words
    return zo.Quantity(
        name=name, unit=unit, meaning=meaning, default=default, lower=lower, upper=upper
    )


PROBLEM = zo.Problem(
    name="compass_walker",
    title="walker with straight legs on flat ground, torque at the hip by feedback",
    source="masses of the Sydney compass-gait robot, I. R. Manchester (2017); gains declared here",
    state_names=("hip", "stance", "dhip", "dstance"),
    state_units=("rad", "rad", "rad/s", "rad/s"),
    parameters=(
        zo.Quantity.positive("l", 0.2778, "m", "length of a leg"),
        zo.Quantity.positive("m", 0.7, "kg", "mass of a leg"),
        zo.Quantity.positive("lc", 0.0475, "m", "hip to the mass centre of a leg"),
        zo.Quantity.positive("J", 0.0043466, "kg m^2", "inertia of a leg about the hip"),
        zo.Quantity.positive("m_hip", 2.0, "kg", "inert mass at the hip"),
        within(-1.2, 9.0, "m_weight", -0.409, "kg", "mass at the hip that weighs"),
        within(0.0, 1.0, "viscous", 0.00156, "N m s/rad", "viscous friction of the hip"),
        within(0.0, 1.0, "dry", 0.00611, "N m", "dry friction of the hip"),
        within(0.0, 1.0, "ahead", 0.02, "rad", "least angle of the legs at a strike"),
        zo.Quantity.positive("g", 9.81, "m/s^2", "gravity"),
    ),
    gains=(
        within(-0.1, 0.1, "push", 0.0327, "N m", "torque at vertical legs"),
        within(-1.0, 1.0, "K_hip", -0.155, "N m/rad", "torque per angle between the legs"),
        within(-2.0, 2.0, "K_stance", 0.512, "N m/rad", "torque per angle of the stance leg"),
    ),
    model=model,
    starts=({"hip": -0.28, "stance": -0.14, "dhip": 0.1, "dstance": 0.71},),
    portraits=(("hip", "dhip"), ("stance", "dstance")),
    amplitude_of="hip",
    outputs=(zo.Output(name="torque", unit="N m", formula=torque),),
)
