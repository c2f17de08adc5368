r"""The simplest walker: two straight legs without mass on a slope, a hip with mass and point feet.

``stance`` is the angle of the stance leg from the slope's normal, and ``swing`` that of the swing
leg from the stance leg. Time is in units of :math:`\sqrt{l/g}`:

.. math:: \ddot\theta = \sin(\theta - \gamma), \qquad
    \ddot\phi = \ddot\theta + (\dot\theta^2 - \cos(\theta - \gamma)) \sin\phi + u

The feet are much lighter than the hip, so the torque of the hip moves the swing leg alone. It is
`hip` per moment of inertia of a leg, and zero for a passive walker. The swing foot passes below
the slope at mid-stance without a strike. At heel strike the legs change names.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import casadi as ca

from zeno_orbits import (
    CompletedSystem,
    HybridLagrangian,
    Problem,
    Quantity,
    Switch,
    hybrid_system,
    no_drive,
)


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: ``q = (stance, swing)``."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    stance, swing = q[0], q[1]
    fall = ca.sin(stance - p["slope"])
    swung = fall + (v[0] ** 2 - ca.cos(stance - p["slope"])) * ca.sin(swing) + p["hip"]
    walker = HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=ca.sumsqr(v) / 2,
        potential=ca.SX(0),
        applied_force=ca.vertcat(fall, swung),
    )
    kept = ca.cos(2 * stance)
    strike = Switch(
        name="heel strike",
        guard=2 * stance - swing,
        armed=-stance - p["ahead"],
        # On the guard this is -2 stance, and the guard keeps its value, which a proof needs.
        q_after=ca.vertcat(-stance, swing - 4 * stance),
        v_after=ca.vertcat(kept * v[0], kept * (1 - kept) * v[0]),
    )
    return hybrid_system(walker, no_drive(walker), switches=(strike,))


def stride(p: Mapping[str, float]) -> float:
    """Return the angle of the stance leg after a heel strike, as a series in the slope."""
    square = p["slope"] ** (2 / 3)
    return p["slope"] ** (1 / 3) * (0.97095 + square * (-0.18584 + 0.0479 * square))


def swing(p: Mapping[str, float]) -> float:
    """Return the angle of the swing leg from the stance leg: both feet are on the slope."""
    return 2 * stride(p)


def turn(p: Mapping[str, float]) -> float:
    """Return the rate of the stance leg after a heel strike, as a series in the slope."""
    square = p["slope"] ** (2 / 3)
    return p["slope"] ** (1 / 3) * (-1.01483 + square * (1.25665 - 0.1295 * square))


def swung(p: Mapping[str, float]) -> float:
    """Return the rate of the swing leg after a heel strike."""
    return turn(p) * (1 - math.cos(2 * stride(p)))


PROBLEM = Problem(
    name="slope_walker",
    title="walker with legs without mass on a slope, no motor",
    source="Garcia, Chatterjee, Ruina and Coleman, The simplest walking model (1998)",
    state_names=("stance", "swing", "dstance", "dswing"),
    state_units=("rad", "rad", "rad/s", "rad/s"),
    parameters=(
        Quantity(name="slope", unit="rad", meaning="angle of the slope", default=0.009, lower=0.0),
        Quantity(
            name="hip",
            unit="rad/s^2",
            meaning="torque of the hip per inertia",
            default=0.0,
        ),
        Quantity(
            name="ahead",
            unit="rad",
            meaning="angle of the stance leg beyond the normal, above which the foot may strike",
            default=0.02,
            lower=0.0,
        ),
    ),
    gains=(),
    model=model,
    starts=({"stance": stride, "swing": swing, "dstance": turn, "dswing": swung},),
    portraits=(("stance", "dstance"), ("swing", "dswing")),
    amplitude_of="swing",
)
