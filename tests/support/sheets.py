"""Shaken masses on a stop with a state of several rest values: sections of several sheets.

The mass obeys ``m x'' = A cos(t) - c x' - k x + f(y)`` and the further state ``y' = r(y)``. At each
rest value of ``y`` the force ``f`` vanishes, so the masses at all rest values move alike: their
periodic orbits differ in ``y`` alone. Their releases are at ``cos(t) = k stop / A``, sine positive.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import casadi as ca

from zeno_orbits import (
    Auxiliary,
    Clock,
    CompletedSystem,
    HybridLagrangian,
    Problem,
    Quantity,
    hybrid_system,
    no_drive,
)

Formula = Callable[[Any], Any]


class Sheets(NamedTuple):
    """Numbers and formulas of a machine.

    Attributes:
        rest: Stable rest values of the further state.
        rate: Its rate.
        force: The force on the mass, zero at the rest values.
        gap: The gap as a function of the coordinate, zero at zero with the slope 1.
        restitution: Coefficient of restitution.
        length: Number of units of length per metre.
        inertia: Mass, stiffness, damping and forces are multiplied by this number.
        sense: 1, or -1 for a coordinate that falls as the gap opens.
    """

    rest: tuple[float, ...]
    rate: Formula
    force: Formula
    gap: Formula
    restitution: float = 0.0
    length: float = 1.0
    inertia: float = 1.0
    sense: int = 1


NARROW = 2.0**-10


def _plain(q: Any) -> Any:
    return q


def _bent(q: Any) -> Any:
    return q + q**2 / 8


def _rate_of_two(y: Any) -> Any:
    return 4 * (y - y**3)


def _force_of_two(y: Any) -> Any:
    return 5 * (y**2 - 1)


def _rate_of_three(y: Any) -> Any:
    return -y * (y**2 - 1) * (y**2 - 4) / 4


def _force_of_three(y: Any) -> Any:
    return y**3 - 4 * y


def _rate_of_near(y: Any) -> Any:
    return 1e6 * (y - 1) * (NARROW**2 - (y - 1) ** 2)


def _force_of_near(y: Any) -> Any:
    return 1e3 * ((y - 1) ** 2 - NARROW**2)


TWO = Sheets((1.0, -1.0), _rate_of_two, _force_of_two, gap=_plain)
THREE = Sheets((0.0, 2.0, -2.0), _rate_of_three, _force_of_three, gap=_plain)
MACHINES: Mapping[str, Sheets] = {
    "two sheets": TWO,
    "three sheets": THREE,
    "an elastic stop": TWO._replace(restitution=0.25),
    "many bounces": TWO._replace(restitution=0.4),
    "a hard stop": THREE._replace(restitution=0.7),
    "millimetres": TWO._replace(length=1e3),
    "micrometres and heavy": TWO._replace(length=1e6, inertia=1e3),
    "mirrored": TWO._replace(sense=-1, restitution=0.3),
    "a gap that is no coordinate": TWO._replace(gap=_bent),
    "sheets close together": TWO._replace(
        rest=(1 + NARROW, 1 - NARROW), rate=_rate_of_near, force=_force_of_near
    ),
}


def problem_of(name: str, rest: float) -> Problem:
    """Return a machine whose start has a rest value of the further state."""
    sheets = MACHINES[name]

    def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
        q, v, y = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("y")
        clock, away, sense = Clock.at(ca.SX(1)), sheets.length * -0.8, sheets.sense
        mass = HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=p["m"] * v**2 / 2,
            potential=p["k"] * (away - sense * q) ** 2 / 2,
            gap=sheets.gap(sense * q),
            passive_force=-p["c"] * v,
            applied_force=-sense * p["A"] * clock.cosine,
            clock=clock,
        )
        push = sense * p["m"] * sheets.length * sheets.force(y)
        further = Auxiliary(states=y, rate=sheets.rate(y), force=push)
        return hybrid_system(mass, (no_drive(mass), further), p["restitution"])

    scale = sheets.inertia
    return Problem(
        name="sheets",
        title="a shaken mass with a further state",
        source="made for a test",
        state_names=("q", "v", "y", "cosine", "sine"),
        state_units=("m", "m/s", "1", "1", "1"),
        parameters=(
            Quantity(name="m", unit="kg", meaning="mass", default=scale),
            Quantity(name="c", unit="N s/m", meaning="damping", default=1.9 * scale),
            Quantity(name="k", unit="N/m", meaning="stiffness", default=scale),
            Quantity(name="A", unit="N", meaning="force", default=scale * sheets.length),
            Quantity.restitution(sheets.restitution),
        ),
        gains=(),
        model=model,
        starts=({"cosine": 1.0, "y": rest},),
        portraits=(("q", "v"),),
        amplitude_of="q",
    )
