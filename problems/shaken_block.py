r"""A block that stands against a wall and rocks away from it under a ground record.

The block of half diagonal `R` and slenderness ``alpha`` turns by the angle :math:`\theta \ge 0`
about its foot. On the ground that accelerates by `a`,

.. math:: \ddot\theta = -p^2 \left(\sin(\alpha - \theta) + \frac{a}{g} \cos(\alpha - \theta)\right),
    \qquad p^2 = \frac{3 g}{4 R}

It lifts off where :math:`-a > g \tan\alpha`, and falls back on its base with a restitution, so its
impacts accumulate. The ground is a record of 40 s, sampled 50 times per second, which is repeated.
Here it is simulated: three tones under an envelope.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np

from zeno_orbits import (
    Clock,
    CompletedSystem,
    HybridLagrangian,
    Problem,
    Quantity,
    hybrid_system,
    no_drive,
    record,
)

TIME = np.arange(2000) / 50.0
ENVELOPE = np.sin(np.pi * TIME / 40.0) ** 2
TONES = sum(
    size * np.sin(2.0 * np.pi * tone * TIME / 40.0)
    for size, tone in ((1.0, 39.0), (0.6, 71.0), (0.3, 163.0))
)
GROUND = record(TIME, ENVELOPE * TONES, period=40.0, name="ground")
"""Ground acceleration per its size [1]."""


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: angle, its rate and the clock of the record."""
    angle, rate = ca.SX.sym("angle"), ca.SX.sym("rate")
    clock = Clock.at(ca.SX(GROUND.frequency))
    inertia, tilt = 4 * p["m"] * p["R"] ** 2 / 3, p["alpha"] - angle
    block = HybridLagrangian.from_energies(
        q=angle,
        v=rate,
        kinetic=inertia * rate**2 / 2,
        potential=p["m"] * p["g"] * p["R"] * ca.cos(tilt),
        gap=angle,
        applied_force=-p["m"] * p["R"] * p["size"] * GROUND.at(clock) * ca.cos(tilt),
        clock=clock,
    )
    return hybrid_system(block, no_drive(block), p["restitution"])


PROBLEM = Problem(
    name="shaken_block",
    title="block against a wall, rocked by a ground record",
    source="Housner 1963 for the equation; simulated record, declared here",
    state_names=("angle", "rate", "cosine", "sine"),
    state_units=("rad", "rad/s", "1", "1"),
    parameters=(
        Quantity.positive("m", 100.0, "kg", "mass"),
        Quantity.positive("R", 0.6, "m", "half of the diagonal"),
        Quantity(
            name="alpha",
            unit="rad",
            meaning="angle between the diagonal and the vertical",
            default=0.25,
            lower=0.05,
            upper=1.0,
        ),
        Quantity.positive("g", 9.81, "m/s^2", "gravity"),
        Quantity(
            name="size",
            unit="m/s^2",
            meaning="size of the ground acceleration",
            default=2.0,
            lower=0.0,
        ),
        Quantity.restitution(0.6),
    ),
    gains=(),
    model=model,
    starts=({"cosine": 1.0},),
    portraits=(("angle", "rate"),),
    amplitude_of="angle",
)
