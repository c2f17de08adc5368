"""Machines with several stops or switches whose motions are refused, each for another reason."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import casadi as ca

import zeno_orbits as zo
from tests.laws.test_several_stops import LINE, braked, dropped, two_floors
from tests.support.mechanisms import machine_of

Formula = Callable[[ca.SX, ca.SX], ca.SX]


def ball(
    force: Formula, guard: Formula | None = None, armed: Formula | None = None, floor: float = 0.0
) -> zo.Problem:
    """Return a ball over a floor, with a force, and a switch that throws it up.

    Args:
        force: Force of height and speed.
        guard: Guard of the switch, by default without a switch.
        armed: Where the switch is armed.
        floor: Height of the floor [m].
    """

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        mechanism = zo.HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=v**2 / 2,
            potential=9.81 * q,
            passive_force=force(q, v),
            stops=(zo.Stop(name="floor", gap=q - floor, restitution=p["restitution"]),),
        )
        switches = ()
        if guard is not None and armed is not None:
            switches = (
                zo.Switch(name="throw", guard=guard(q, v), armed=armed(q, v), v_after=-v / 2),
            )
        return zo.hybrid_system(mechanism, zo.no_drive(mechanism), switches=switches)

    return machine_of(model, LINE, {"restitution": 0.5})


def corner(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    """Return a ball that bounces into the corner of two slopes."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    mechanism = zo.HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=ca.sumsqr(v) / 2,
        potential=9.81 * q[1],
        stops=(
            zo.Stop(name="left", gap=q[1] + 0.7 * q[0], restitution=p["restitution"]),
            zo.Stop(name="right", gap=q[1] - 0.5 * q[0], restitution=p["restitution"]),
        ),
    )
    return zo.hybrid_system(mechanism, zo.no_drive(mechanism))


def _from(problem: zo.Problem, **start: float) -> zo.Problem:
    return replace(problem, starts=(start,))


def _none(q: ca.SX, v: ca.SX) -> ca.SX:
    return 0 * q * v


def _falling(_: ca.SX, v: ca.SX) -> ca.SX:
    return -v


PLANE = {"x": "m", "y": "m", "dx": "m/s", "dy": "m/s"}
REFUSED: dict[str, tuple[zo.Problem, str]] = {
    "a logarithm at its kink": (
        _from(ball(lambda q, _: ca.if_else(q > 0.2, ca.log(q - 0.2), 0.0)), x=1.0),
        "the passive force is not finite ahead (q = 0.2): `log((q-0.2))` is `log` of ",
    ),
    "impacts in a corner": (
        _from(machine_of(corner, PLANE, {"restitution": 0.6}), x=0.2, y=1.0),
        "Impacts accumulate on the stop",
    ),
    "impacts at the same time": (
        _from(two_floors(0.2), left=0.5, right=0.5),
        "Two events coincide to rounding: impact left and impact right",
    ),
    "impacts that lift a closed stop": (
        _from(two_floors(-0.4), left=0.1),
        "Impacts accumulate on the stop",
    ),
    "events of a switch that accumulate": (
        _from(ball(_none, lambda q, _: q - 0.2, _falling, floor=-1.0), x=1.0),
        "Events of the switch `throw` accumulate",
    ),
    "a guard that is no number": (
        _from(ball(_none, lambda q, _: ca.sqrt(q - 0.2), _falling), x=1.0),
        "The guard of the switch `throw` must be a number",
    ),
    "a switch that is armed at the start": (
        _from(ball(_none, lambda q, _: q - 1.0, lambda q, _: 1 + 0 * q), x=1.0),
        "The switch `throw` is armed at its start",
    ),
    "a reset into a stop": (
        _from(machine_of(dropped, LINE, {"restitution": 0.5}), x=1.0),
        "The reset of the switch `drop` sends the state into the stop `floor`",
    ),
    "sliding": (
        _from(machine_of(braked, LINE, {"f": 1.5, "restitution": 0.5}), dx=3.0),
        "The motion slides along the switch `kink 1`",
    ),
}
"""Name to a machine, and words of its refusal."""
