"""Machines with elastic stops."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

import zeno_orbits as zo
from tests.support.mechanisms import machine_of


def line(n: int) -> dict[str, str]:
    """Return the states of masses on a line."""
    return {f"q{k}": "m" for k in range(n)} | {f"v{k}": "m/s" for k in range(n)}


def blocks(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return two blocks on a line with a wall. Each stop has its own restitution."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    mechanism = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=(v[0] ** 2 + p["M"] * v[1] ** 2) / 2,
        potential=ca.SX(0),
        stops=(
            zo.Stop(name="wall", gap=q[0], restitution=1.0),
            zo.Stop(name="block", gap=q[1] - q[0], restitution=1 - p["loss"]),
        ),
    )
    return zo.hybrid_system(mechanism, zo.no_drive(mechanism))


BLOCKS = machine_of(blocks, line(2), {"M": 100.0, "loss": 0.0})
