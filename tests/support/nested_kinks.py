"""A problem file of a mass on a spring, whose force nests kinks of a clock.

On each half of a period the force is linear in the position. So the state is a product of matrix
exponentials.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.linalg import expm

from zeno_orbits.arrays import Vector

WAVE = "ca.if_else(clock.sine > 0, {}, {})"
TABLE = f"table(ca.fmin(1, {WAVE.format(4, 0)} * (1 + q**2)))"
FORCES: dict[str, tuple[str, tuple[tuple[float, float], tuple[float, float]]]] = {
    "limit": (f"ca.fmin(12, {WAVE.format(40, 0)} - 0.1 * q)", ((12, 0), (0, -0.1))),
    "two limits": (
        f"ca.fmax(-3, ca.fmin(12, {WAVE.format(40, -40)} - 0.1 * q))",
        ((12, 0), (-3, 0)),
    ),
    "size": (f"ca.fabs({WAVE.format(40, -20)} - 0.01 * q)", ((40, -0.01), (20, 0.01))),
    "table": (TABLE, ((1.5, 0), (0.3, 0))),
    "waveform": (
        "ca.fmin(12, zo.piecewise(clock, (40, 0), (clock.period / 2,)) - 0.1 * q)",
        ((12, 0), (0, -0.1)),
    ),
}
"""Force, and its constant part and slope on both halves of a period."""

_PROBLEM = """
import casadi as ca
import zeno_orbits as zo

table = ca.interpolant("table", "linear", [[-1.0, 0.0, 1.0, 2.0]], [0.0, 0.3, 1.5, 1.5])


def model(p):
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    clock = zo.Clock.at(ca.SX(1.0))
    mass = zo.HybridLagrangian.from_energies(
        q=q, v=v, kinetic=v**2 / 2, potential=q**2 / 2, passive_force=-0.25 * v,
        applied_force=FORCE, clock=clock,
        stops=(zo.Stop(name="floor", gap=q + 500, restitution=p["restitution"]),),
    )
    return zo.hybrid_system(mass, zo.no_drive(mass))


PROBLEM = zo.Problem(
    name="nested",
    title="mass on a limited wave",
    source="closed form",
    state_names=("q", "v", "cosine", "sine"),
    state_units=("m", "m/s", "1", "1"),
    parameters=(zo.Quantity.restitution(0.5),),
    gains=(),
    model=model,
    starts=({"cosine": 1.0},),
    portraits=(("q", "v"),),
    amplitude_of="q",
)
"""


def nested_problem(force: str = TABLE) -> str:
    """Return the text of the problem file with a force."""
    return _PROBLEM.replace("FORCE", force)


def half_periods(name: str) -> tuple[Vector, Vector]:
    """Return the flow over each half of a period, as a matrix of ``(q, v, 1)``."""
    halves: list[Any] = [
        expm(np.array([[0, 1, 0], [slope - 1, -0.25, constant], [0, 0, 0]]) * math.pi)
        for constant, slope in FORCES[name][1]
    ]
    return halves[0], halves[1]
