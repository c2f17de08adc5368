"""Mechanisms with symbols for their numbers, compiled once and bound to any of them.

Each family names its parameters, with the dimensions of parameters, states and gap, so that the
same motion can be asked for in other units. `README.md` beside this file derives what is known.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from tests.support.units import Dimension
from zeno_orbits import HybridLagrangian, hybrid_system, no_drive
from zeno_orbits.model import CompiledSystem, HybridDynamics, bind, compile_system

Symbols = Mapping[str, ca.SX]

PURE: Dimension = (0, 0, 0)
MASS: Dimension = (1, 0, 0)
LENGTH: Dimension = (0, 1, 0)
SPEED: Dimension = (0, 1, -1)
RATE: Dimension = (0, 0, -1)
ACCELERATION: Dimension = (0, 1, -2)


@dataclass(frozen=True, kw_only=True)
class Family:
    """A mechanism without a drive, its numbers left open; one of them is the restitution ``e``.

    Attributes:
        parameters: Name to dimension.
        states: Dimension of each state, ``(n_x,)``.
        gap: Dimension of the gap.
        lagrangian: From the symbols to the mechanism.
    """

    parameters: Mapping[str, Dimension]
    states: Sequence[Dimension]
    gap: Dimension
    lagrangian: Callable[[Symbols], HybridLagrangian]

    @cached_property
    def compiled(self) -> CompiledSystem:
        """The functions of the family, built at the first use."""
        symbols = {name: ca.SX.sym(name) for name in self.parameters}
        mechanism = self.lagrangian(symbols)
        system = hybrid_system(mechanism, no_drive(mechanism), symbols["e"])
        return compile_system(system, symbols, [f"x{k}" for k in range(len(self.states))])

    def at(self, **numbers: float) -> HybridDynamics:
        """Return the mechanism at numbers for its parameters."""
        return bind(self.compiled, [numbers[name] for name in self.parameters])


def _ball(p: Symbols) -> HybridLagrangian:
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    return HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=p["m"] * v**2 / 2,
        potential=p["m"] * p["g"] * q,
        gap=q,
        passive_force=-p["m"] * p["c"] * v,
    )


BALL = Family(
    parameters={"m": MASS, "g": ACCELERATION, "c": RATE, "e": PURE},
    states=(LENGTH, SPEED),
    gap=LENGTH,
    lagrangian=_ball,
)
"""A ball on a table in air that takes `c` of its speed a second."""


def _bowl(p: Symbols) -> HybridLagrangian:
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    return HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=p["m"] * ca.sumsqr(v) / 2,
        potential=p["m"] * p["g"] * q[1],
        gap=q[1] - p["a"] * q[0] ** 2 / 2,
    )


BOWL = Family(
    parameters={"m": MASS, "g": ACCELERATION, "a": (0, -1, 0), "e": PURE},
    states=(LENGTH, LENGTH, SPEED, SPEED),
    gap=LENGTH,
    lagrangian=_bowl,
)
"""A ball over the curved surface ``y = a x^2 / 2``."""


def _cart(p: Symbols) -> HybridLagrangian:
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    bob_x, bob_y = q[0] + p["l"] * ca.sin(q[1]), -p["l"] * ca.cos(q[1])
    velocity = ca.jtimes(ca.vertcat(bob_x, bob_y), q, v)
    return HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=p["M"] * v[0] ** 2 / 2 + p["m"] * ca.sumsqr(velocity) / 2,
        potential=p["m"] * p["g"] * bob_y,
        gap=bob_x - p["wall"],
    )


CART = Family(
    parameters={"M": MASS, "m": MASS, "l": LENGTH, "g": ACCELERATION, "wall": LENGTH, "e": PURE},
    states=(LENGTH, PURE, SPEED, RATE),
    gap=LENGTH,
    lagrangian=_cart,
)
"""A cart with a pendulum whose bob strikes a wall."""


def _oscillator(p: Symbols) -> HybridLagrangian:
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    return HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=ca.sumsqr(v) / 2,
        potential=(p["k"] * q[0] ** 2 + p["omega"] ** 2 * q[1] ** 2) / 2,
        gap=p["stop"] - q[0],
        passive_force=ca.vertcat(p["force"] * q[1] - p["c"] * v[0], 0),
    )


OSCILLATOR = Family(
    parameters={
        "k": (0, 0, -2),
        "c": RATE,
        "force": ACCELERATION,
        "omega": RATE,
        "stop": LENGTH,
        "e": PURE,
    },
    states=(LENGTH, PURE, SPEED, RATE),
    gap=LENGTH,
    lagrangian=_oscillator,
)
"""``x'' + c x' + k x = force y``, ``x <= stop``, with ``y = cos(omega t)`` as second coordinate."""


def _circle(p: Symbols) -> HybridLagrangian:
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    return HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=p["m"] * ca.sumsqr(v) / 2,
        potential=p["m"] * p["g"] * (0.6 * q[0] + 0.8 * q[1]),
        gap=q[0],
        holonomic=ca.sumsqr(q) - p["l"] ** 2,
    )


CIRCLE = Family(
    parameters={"m": MASS, "l": LENGTH, "g": ACCELERATION, "e": PURE},
    states=(LENGTH, LENGTH, SPEED, SPEED),
    gap=LENGTH,
    lagrangian=_circle,
)
"""A bob in Cartesian coordinates on a circle, a holonomic constraint, with the stop ``x >= 0``."""
