"""Small mechanisms that the tests share, at fixed numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import casadi as ca
import numpy as np

import zeno_orbits as zo
from tests.reference.closed_forms import StoppedOscillator
from zeno_orbits import HybridLagrangian, hybrid_system, no_drive
from zeno_orbits.arrays import Vector
from zeno_orbits.model import (
    CompletedSystem,
    Drive,
    HybridDynamics,
    Problem,
    Quantity,
    bind,
    compile_system,
)

Numbers = Sequence[float] | Vector

PENDULUM_MASS, PENDULUM_LENGTH, TILT, GRAVITY = 0.7, 0.4, 0.6, 9.81


def numeric(
    lagrangian: HybridLagrangian, *, restitution: float, drive: Drive | None = None
) -> HybridDynamics:
    """Return a mechanism without named parameters as numeric functions."""
    return bound(hybrid_system(lagrangian, drive or no_drive(lagrangian), ca.SX(restitution)))


def bound(system: CompletedSystem) -> HybridDynamics:
    """Return a completed system without named parameters as numeric functions."""
    names = [f"x{k}" for k in range(system.state.numel())]
    return bind(compile_system(system, {}, names), ())


def evaluated(expression: ca.SX, values: Mapping[str, Numbers], **symbols: ca.SX) -> Vector:
    """Return an expression at numbers for its named symbols."""
    function = ca.Function("expression", list(symbols.values()), [expression])
    return np.array(function(*(values[name] for name in symbols)).full())


def slider(lift: Callable[[ca.SX], ca.SX | float], restitution: float = 0.3) -> HybridDynamics:
    """Return a mass of 1 kg that slides along a stop, with the multiplier ``-lift(x)``."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    mass = HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=ca.sumsqr(v) / 2,
        potential=ca.SX(0),
        gap=q[1],
        applied_force=ca.vertcat(0, lift(q[0])),
    )
    return numeric(mass, restitution=restitution)


def forced_oscillator(oscillator: StoppedOscillator, restitution: float) -> HybridDynamics:
    """Return ``x'' + c x' + x = cos t`` with its stop, time carried by ``y'' = -y``.

    States ``(x, y, dx, dy)``; ``y = cos t``, and nothing acts back on it.
    """
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    mechanism = HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=ca.sumsqr(v) / 2,
        potential=ca.sumsqr(q) / 2,
        gap=oscillator.stop - q[0],
        passive_force=ca.vertcat(q[1] - oscillator.damping * v[0], 0),
    )
    return numeric(mechanism, restitution=restitution)


def oscillator_state(time: float, position: float, velocity: float) -> tuple[float, ...]:
    """Return the state of the forced oscillator at a time."""
    return position, math.cos(time), velocity, -math.sin(time)


def polar_pendulum(gap: Callable[[ca.SX], ca.SX]) -> HybridLagrangian:
    """Return a pendulum in its angle from the stop, where ``m g sin(TILT)`` presses it on."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    height = -PENDULUM_LENGTH * ca.cos(q + TILT)
    return HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=PENDULUM_MASS * (PENDULUM_LENGTH * v) ** 2 / 2,
        potential=PENDULUM_MASS * GRAVITY * height,
        gap=gap(q),
    )


def cartesian_pendulum() -> HybridLagrangian:
    """Return the same pendulum in ``(x, y)`` on a circle, with the stop ``x >= 0``.

    ``x = l sin(angle)``, ``y = -l cos(angle)``; gravity is tilted by ``TILT`` against ``-y``.
    """
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    height = q[0] * math.sin(TILT) + q[1] * math.cos(TILT)
    return HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=PENDULUM_MASS * ca.sumsqr(v) / 2,
        potential=PENDULUM_MASS * GRAVITY * height,
        gap=q[0],
        holonomic=ca.sumsqr(q) - PENDULUM_LENGTH**2,
    )


def on_circle(angle: float, rate: float) -> tuple[float, ...]:
    """Return the Cartesian state of the pendulum at an angle and its rate."""
    length, sine, cosine = PENDULUM_LENGTH, math.sin(angle), math.cos(angle)
    return length * sine, -length * cosine, length * cosine * rate, length * sine * rate


def bead_on_disc(restitution: float) -> HybridDynamics:
    """Return a bead of 1 kg outside the unit disc, gap ``x^2 + y^2 - 1``, gravity along ``-y``."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    mechanism = HybridLagrangian.from_energies(
        q=q, v=v, kinetic=ca.sumsqr(v) / 2, potential=GRAVITY * q[1], gap=ca.sumsqr(q) - 1
    )
    return numeric(mechanism, restitution=restitution)


def fading_ball(g: float, b: float, restitution: float) -> HybridDynamics:
    """Return ``x'' = -(g - b y)`` with the gap ``x`` and a clock ``y``; ``(x, y, dx, dy)``."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    mechanism = HybridLagrangian.from_energies(
        q=q,
        v=v,
        kinetic=ca.sumsqr(v) / 2,
        potential=g * q[0],
        gap=q[0],
        passive_force=ca.vertcat(b * q[1], 0),
    )
    return numeric(mechanism, restitution=restitution)


def spring_mass(stop: float, restitution: float) -> HybridDynamics:
    """Return ``x'' = -x`` with the gap ``x + stop``."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    mechanism = HybridLagrangian.from_energies(
        q=q, v=v, kinetic=v**2 / 2, potential=q**2 / 2, gap=q + stop
    )
    return numeric(mechanism, restitution=restitution)


def _kept(q: ca.SX, v: ca.SX) -> ca.SX:
    return v[1] * (1 - q[1] ** 2 - v[1] ** 2)


def clocked_oscillator(oscillator: StoppedOscillator, *, attracting: bool) -> Problem:
    """Return the forced oscillator as a problem: gap ``stop - x``, forced by a clock ``y = cos t``.

    Args:
        oscillator: Its numbers.
        attracting: Whether the clock comes back to ``y^2 + y'^2 = 1`` when it is off it.
    """

    def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
        q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        mechanism = HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=ca.sumsqr(v) / 2,
            potential=ca.sumsqr(q) / 2,
            gap=oscillator.stop - q[0],
            passive_force=ca.vertcat(
                q[1] - oscillator.damping * v[0], _kept(q, v) if attracting else 0
            ),
        )
        return hybrid_system(mechanism, no_drive(mechanism), p["restitution"])

    return Problem(
        name="clocked_oscillator",
        title="oscillator with a stop, forced by a clock",
        source="arXiv:1302.4402, section V-A",
        state_names=("x", "y", "dx", "dy"),
        state_units=("m", "m", "m/s", "m/s"),
        parameters=(Quantity.restitution(oscillator.restitution),),
        gains=(),
        model=model,
        starts=({"x": oscillator.stop, "y": 1.0},),
        portraits=(("x", "dx"),),
        amplitude_of="x",
    )


def falling_away(acceleration: float) -> HybridDynamics:
    """Return a mass that a constant force pulls off its stop, gap ``x``."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    mechanism = HybridLagrangian.from_energies(
        q=q, v=v, kinetic=v**2 / 2, potential=-acceleration * q, gap=q
    )
    return numeric(mechanism, restitution=0.5)


def oscillator(damping: float = 0.1, stiffness: float = 1.0, *, named: bool = False) -> Problem:
    """``x'' + c x' + k x = 0`` above a stop at ``x = -10``, far below where it starts, 1.

    Args:
        damping: `c`.
        stiffness: `k`.
        named: Whether the stop is declared by its name, as one of several.
    """

    def model(p: Mapping[str, ca.SX]) -> CompletedSystem:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        stop = zo.Stop(name="floor", gap=q + 10, restitution=p["restitution"])
        mechanism = HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=v**2 / 2,
            potential=p["k"] * q**2 / 2,
            gap=None if named else q + 10,
            stops=(stop,) if named else (),
            passive_force=-p["c"] * v,
        )
        restitution = () if named else (p["restitution"],)
        return hybrid_system(mechanism, no_drive(mechanism), *restitution)

    quantities = (
        Quantity(name="c", unit="1/s", meaning="damping", default=damping),
        Quantity(name="k", unit="1/s^2", meaning="stiffness", default=stiffness),
    )
    return Problem(
        name="oscillator",
        title="oscillator far from its stop",
        source="textbook",
        state_names=("x", "dx"),
        state_units=("m", "m/s"),
        parameters=(*quantities, Quantity.restitution(0.5)),
        gains=(),
        model=model,
        starts=({"x": 1.0},),
        portraits=(("x", "dx"),),
        amplitude_of="x",
    )


Model = Callable[[Mapping[str, ca.SX]], CompletedSystem]


def walled_oscillator(p: Mapping[str, ca.SX], **walls: int) -> CompletedSystem:
    """Return ``x'' + c x' + x = A cos(omega t)`` with walls at ``x = d`` and ``x = -d``.

    Args:
        p: The parameters.
        walls: Name of each wall to the sign of its place.
    """
    x, v, clock = ca.SX.sym("x"), ca.SX.sym("v"), zo.Clock.at(p["omega"])
    mechanism = HybridLagrangian.from_energies(
        q=x,
        v=v,
        kinetic=v**2 / 2,
        potential=x**2 / 2,
        passive_force=-p["c"] * v,
        applied_force=p["A"] * clock.cosine,
        clock=clock,
        stops=tuple(
            zo.Stop(name=name, gap=p["d"] - sign * x, restitution=p["restitution"])
            for name, sign in walls.items()
        ),
    )
    return hybrid_system(mechanism, no_drive(mechanism))


def machine_of(
    model: Model, states: Mapping[str, str], parameters: Mapping[str, float] | None = None
) -> Problem:
    """Return a problem of states with their units, and of parameters without a unit."""
    names = tuple(states)
    return Problem(
        name="machine",
        title="machine of a test",
        source="a test",
        state_names=names,
        state_units=tuple(states.values()),
        parameters=tuple(
            Quantity.restitution(default)
            if name == "restitution"
            else Quantity(name=name, unit="1", meaning=name, default=default)
            for name, default in (parameters or {}).items()
        ),
        gains=(),
        model=model,
        starts=({"cosine": 1.0} if "cosine" in states else {},),
        portraits=((names[0], names[1]),),
        amplitude_of=names[0],
    )
