"""A mass on a spring, forced by a cosine against a stop: a Zeno periodic orbit in closed form.

``x'' + c x' + k x = A cos(omega t)``, ``x <= stop``, without motor and feedback. At the published
numbers the stop holds at ``t = 0`` and lets go at ``arccos(-0.8)``; the impacts accumulate at
``5.06454057578434876``, before it would let go again, so the period is exactly ``2 pi``.
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


def lagrangian(p: Mapping[str, ca.SX]) -> HybridLagrangian:
    """Return the mass: one coordinate, its distance from the stop, ``stop - x``."""
    distance, speed = ca.SX.sym("distance"), ca.SX.sym("speed")
    clock = Clock.at(p["omega"])
    return HybridLagrangian.from_energies(
        q=distance,
        v=speed,
        kinetic=p["m"] * speed**2 / 2,
        potential=p["k"] * (p["stop"] - distance) ** 2 / 2,
        gap=distance,
        passive_force=-p["c"] * speed,
        applied_force=-p["A"] * clock.cosine,
        clock=clock,
    )


def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
    """Return the completed system: two states of the mass, two of the clock."""
    oscillator = lagrangian(p)
    return hybrid_system(oscillator, no_drive(oscillator), p["restitution"])


PROBLEM = Problem(
    name="forced_oscillator",
    title="mass on a spring, forced by a cosine against a stop, no motor",
    source="Burden et al., arXiv:1302.4402, section V-A",
    state_names=("distance", "speed", "cosine", "sine"),
    state_units=("m", "m/s", "1", "1"),
    parameters=(
        Quantity.positive("m", 1.0, "kg", "mass"),
        Quantity(name="c", unit="N s/m", meaning="damping", default=1.9, lower=0.0),
        Quantity(name="k", unit="N/m", meaning="stiffness of the spring", default=1.0, lower=0.0),
        Quantity(name="A", unit="N", meaning="amplitude of the force", default=1.0, lower=0.0),
        Quantity.positive("omega", 1.0, "rad/s", "frequency of the force"),
        Quantity(
            name="stop",
            unit="m",
            meaning="where the stop is, from the relaxed spring",
            default=-0.8,
        ),
        Quantity.restitution(0.5),
    ),
    gains=(),
    model=model,
    starts=({"cosine": 1.0},),
    portraits=(("distance", "speed"),),
    amplitude_of="distance",
)
