"""Two blocks, one on the other, on a shaken table: both stops are closed at the same time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

import zeno_orbits as zo
from zeno_orbits.model import CompletedSystem, Problem

GRAVITY = 9.81


def _blocks(p: Mapping[str, Any], kinetic: Any, push: Any, gap: Any) -> CompletedSystem:
    """Return blocks with forces on the lower and on the upper one."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    clock = zo.Clock.at(p["omega"])
    blocks = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=kinetic(v),
        potential=ca.SX(0),
        applied_force=push(clock),
        clock=clock,
        stops=(
            zo.Stop(name="table", gap=q[0], restitution=p["restitution"]),
            zo.Stop(name="block", gap=gap(q), restitution=0.3),
        ),
    )
    return zo.hybrid_system(blocks, zo.no_drive(blocks))


def _problem(name: str, model: Any, parameters: tuple[zo.Quantity, ...], **start: float) -> Problem:
    return zo.Problem(
        name=name,
        title="two blocks on a shaken table, one on the other",
        source="written here",
        state_names=("lower", "upper", "dlower", "dupper", "cosine", "sine"),
        state_units=("m", "m", "m/s", "m/s", "1", "1"),
        parameters=(zo.Quantity.positive("omega", 20.0, "rad/s", "shaking"), *parameters),
        gains=(),
        model=model,
        starts=(start,),
        portraits=(("lower", "dlower"),),
        amplitude_of="lower",
    ).checked()


def stacked_blocks() -> Problem:
    """Return blocks that leave the table together, and of which the upper one then jumps alone.

    Per unit of mass, ``A cos(omega t) - g`` acts on the lower block of 2 kg, and
    ``-B cos(omega t) - g`` on the upper one of 1 kg.
    """

    def model(p: Mapping[str, Any]) -> CompletedSystem:
        def push(clock: zo.Clock) -> ca.SX:
            lower, upper = p["A"] * clock.cosine, -p["B"] * clock.cosine
            return ca.vertcat(2 * (lower - GRAVITY), upper - GRAVITY)

        return _blocks(p, lambda v: v[0] ** 2 + v[1] ** 2 / 2, push, lambda q: q[1] - q[0])

    numbers = (
        zo.Quantity.positive("A", 21.7, "m/s^2", "acceleration of the lower block"),
        zo.Quantity.positive("B", 11.0, "m/s^2", "acceleration of the upper block"),
        zo.Quantity.restitution(0.2),
    )
    return _problem("stacked_blocks", model, numbers, sine=1.0)


def pressed_pair() -> Problem:
    """Return blocks of which the upper one always lies on the lower one, and plastic impacts.

    The pair of ``M + m + 2 c = 4`` is shaken by ``48 cos(omega t) - 40``. A magnet of force ``P``
    between the blocks changes nothing but the force of their contact, as does the coupling ``c`` of
    their inertias. ``side = -1`` puts the upper block below the lower one.
    """

    def model(p: Mapping[str, Any]) -> CompletedSystem:
        def kinetic(v: ca.SX) -> ca.SX:
            return (p["M"] * v[0] ** 2 + p["m"] * v[1] ** 2) / 2 + p["c"] * v[0] * v[1]

        def push(clock: zo.Clock) -> ca.SX:
            return ca.vertcat(48 * clock.cosine - 40 + p["P"], -p["P"])

        return _blocks(p, kinetic, push, lambda q: p["side"] * (q[1] - q[0]))

    free = {"lower": -1e3, "unit": "1", "meaning": "a number"}
    numbers = (
        zo.Quantity(name="M", default=2.0, **free),
        zo.Quantity(name="m", default=2.0, **free),
        zo.Quantity(name="c", default=0.0, **free),
        zo.Quantity(name="P", default=64.0, **free),
        zo.Quantity(name="side", default=1.0, **free),
        zo.Quantity.restitution(0.0),
    )
    return _problem("pressed_pair", model, numbers, sine=1.0)
