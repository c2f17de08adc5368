r"""A mass on a spring with negative damping that a weight presses on a stop: two basins.

.. math:: \ddot x - 2 a \dot x + x = -m, \qquad x \ge 0, \qquad v^+ = -e v^-.

Rest on the stop attracts every start on it whose speed is below :math:`v^*`. A faster one grows. At
the threshold one flight and one impact give the speed back (two equations in :math:`T, v^*`):

.. math:: x(T; v^*) = 0, \qquad -e\,\dot x(T; v^*) = v^*,

    x(t; v) = -m + e^{at} (m \cos\omega t + B \sin\omega t), \qquad
    \omega^2 = 1 - a^2, \quad \omega B = v - a m .

There is one if :math:`e\,e^{a\pi/\omega} > 1`, the growth over a long flight.

A second machine has the same mass, and a short force of a slow clock that lifts it once per turn:

.. math:: \ddot x - 2 a \dot x + x = -m + \tfrac32 m\,e^{k (\cos\Omega t - 1)}

Between two lifts the force vanishes to all digits. The rest becomes a Zeno periodic orbit with a
long contact phase, and a push in this phase is lost if its speed is above :math:`v^*`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import casadi as ca
from scipy.optimize import brentq

import zeno_orbits as zo

SETS = (
    (0.10, 1.0, 0.80),
    (0.10, 2.0, 0.90),
    (0.15, 1.0, 0.70),
    (0.15, 0.5, 0.85),
    (0.20, 1.0, 0.60),
    (0.20, 3.0, 0.75),
    (0.25, 1.0, 0.50),
    (0.25, 0.2, 0.80),
    (0.30, 1.5, 0.45),
    (0.05, 1.0, 0.92),
)
"""Ten values of ``(a, m, e)``."""


def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    x, v = ca.SX.sym("x"), ca.SX.sym("v")
    mass = zo.HybridLagrangian.from_energies(
        q=x,
        v=v,
        kinetic=v**2 / 2,
        potential=x**2 / 2 + p["weight"] * x,
        gap=x,
        passive_force=2 * p["a"] * v,
    )
    return zo.hybrid_system(mass, zo.no_drive(mass), p["restitution"])


PROBLEM = zo.Problem(
    name="antidamped_spring",
    title="mass on a spring with negative damping, on a stop",
    source="closed form in this file",
    state_names=("x", "v"),
    state_units=("m", "m/s"),
    parameters=(
        zo.Quantity(name="a", unit="1/s", meaning="negative damping", default=0.1),
        zo.Quantity.positive("weight", 1.0, "N", "weight"),
        zo.Quantity.restitution(0.8),
    ),
    gains=(),
    model=model,
    starts=({"v": 1.0},),
    portraits=(("x", "v"),),
    amplitude_of="x",
    escapes={"x": zo.StateLimit(beyond=1e4, phrase="the oscillation grows")},
)


def lifted_model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    x, v = ca.SX.sym("x"), ca.SX.sym("v")
    clock = zo.Clock.at(p["turn"])
    # The force exceeds the weight for half a second: k (turn t)^2 / 2 = ln 1.5 at t = 1/4 s.
    steep = 32 * ca.log(1.5) / p["turn"] ** 2
    lift = 1.5 * p["weight"] * ca.exp(steep * (clock.cosine - 1))
    mass = zo.HybridLagrangian.from_energies(
        q=x,
        v=v,
        kinetic=p["mass"] * v**2 / 2,
        potential=p["mass"] * x**2 / 2 + p["mass"] * p["weight"] * x,
        gap=x,
        passive_force=2 * p["mass"] * p["a"] * v,
        applied_force=p["mass"] * lift,
        clock=clock,
    )
    return zo.hybrid_system(mass, zo.no_drive(mass), p["restitution"])


LIFTED = replace(
    PROBLEM,
    name="lifted_spring",
    state_names=("x", "v", "cosine", "sine"),
    state_units=("m", "m/s", "1", "1"),
    parameters=(
        *PROBLEM.parameters,
        zo.Quantity.positive("mass", 1.0, "kg", "mass"),
        zo.Quantity.positive("turn", 0.005, "rad/s", "frequency of the clock"),
    ),
    model=lifted_model,
    starts=({"cosine": 1.0},),
)
"""The mass that a clock lifts for a moment once per turn."""


def numbers(a: float, weight: float, restitution: float) -> dict[str, float]:
    """Return parameters by name."""
    return {"a": a, "weight": weight, "restitution": restitution}


def threshold(a: float, weight: float, restitution: float) -> float:
    """Return the speed after an impact that one flight and one impact give back."""
    w = math.sqrt(1 - a * a)

    def place(t: float, v: float) -> float:
        b = (v - a * weight) / w
        return -weight + math.exp(a * t) * (weight * math.cos(w * t) + b * math.sin(w * t))

    def speed(t: float, v: float) -> float:
        b = (v - a * weight) / w
        slope_cos, slope_sin = a * weight + w * b, a * b - w * weight
        return math.exp(a * t) * (slope_cos * math.cos(w * t) + slope_sin * math.sin(w * t))

    def flight(v: float) -> float:
        """Return the time of the flight: it is falling from the apex on."""
        apex = brentq(lambda t: speed(t, v), 1e-12, math.pi / w, xtol=1e-15, rtol=1e-14)
        return brentq(lambda t: place(t, v), apex, apex + math.pi / w, xtol=1e-15, rtol=1e-14)

    def excess(v: float) -> float:
        return -restitution * speed(flight(v), v) - v

    low = high = 0.01 * weight
    while excess(high) < 0.0:
        low, high = high, 1.3 * high
    return brentq(excess, low, high, xtol=1e-15, rtol=1e-14)
