"""Machines of one mass, by formulas: a force, stops at places, and switches."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

import zeno_orbits as zo


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """The symbols of which the formulas of a machine consist.

    Attributes:
        x: Place.
        v: Speed.
        cosine: Cosine of the clock's phase. 0 without a clock.
        sine: Its sine.
        clock: The clock, or ``None``.
        p: The parameters.
    """

    x: ca.SX
    v: ca.SX
    cosine: ca.SX
    sine: ca.SX
    clock: zo.Clock | None
    p: Mapping[str, ca.SX]


def one_mass(
    force: Callable[[Motion], ca.SX],
    *,
    stops: Callable[[Motion], Sequence[zo.Stop]],
    switches: Callable[[Motion], Sequence[zo.Switch]] = lambda _: (),
    has_clock: bool = True,
    start: Mapping[str, float],
    **parameters: float,
) -> zo.Problem:
    """Return the machine of a unit mass with a force.

    Args:
        force: The force on the mass. It need not be linear or smooth.
        stops: Its stops.
        switches: Its switches.
        has_clock: Whether it has a clock, of angular frequency `omega`.
        start: Start of a motion that settles.
        **parameters: Name to value.
    """

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        x, v = ca.SX.sym("x"), ca.SX.sym("v")
        clock = zo.Clock.at(p["omega"]) if has_clock else None
        zero = ca.SX(0.0)
        motion = Motion(
            x=x,
            v=v,
            cosine=zero if clock is None else clock.cosine,
            sine=zero if clock is None else clock.sine,
            clock=clock,
            p=p,
        )
        mass = zo.HybridLagrangian.from_energies(
            q=x,
            v=v,
            kinetic=v**2 / 2,
            potential=ca.SX(0.0),
            passive_force=ca.SX(0.0),
            applied_force=ca.SX(force(motion)),
            clock=clock,
            stops=tuple(stops(motion)),
        )
        return zo.hybrid_system(mass, zo.no_drive(mass), switches=tuple(switches(motion)))

    turning = ("cosine", "sine") if has_clock else ()
    return zo.Problem(
        name="one_mass",
        title="One mass",
        source="tests",
        state_names=("x", "v", *turning),
        state_units=("m", "m/s", *("1" for _ in turning)),
        parameters=tuple(
            zo.Quantity(name=name, unit="1", meaning=name, default=value)
            for name, value in parameters.items()
        ),
        gains=(),
        model=model,
        starts=(start,),
        portraits=(("x", "v"),),
        amplitude_of="x",
    )
