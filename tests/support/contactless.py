"""Machines whose orbits touch no stop, and their motions by SciPy or in closed form.

`wheel` is a rimless wheel on a slope: a pendulum with a reset at every new spoke. `escapement` is
an oscillator with a push in the direction of its velocity. `duffing` is a driven oscillator with
quadratic drag and two wells, in each of which an orbit of the same period exists. `wheel` has no
stop, and the stops of the others are out of reach.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

import zeno_orbits as zo
from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ZenoOrbitsError

Q = zo.Quantity
Motion = Callable[[Vector], Vector]
"""Function from times to states, ``(n, n_x)``."""


def _wheel_model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    rim = zo.HybridLagrangian.from_energies(
        q=q, v=v, kinetic=v**2 / 2, potential=p["g"] / p["l"] * ca.cos(q)
    )
    half = math.pi / 8
    strike = zo.Switch(
        name="strike",
        guard=p["slope"] + half - q,
        armed=v,
        q_after=q - 2 * half,
        v_after=v * math.cos(2 * half),
    )
    return zo.hybrid_system(rim, zo.no_drive(rim), switches=(strike,))


def wheel() -> zo.Problem:
    """Return the rimless wheel with eight spokes."""
    return zo.Problem(
        name="wheel",
        title="rimless wheel",
        source="McGeer 1990",
        state_names=("q", "v"),
        state_units=("rad", "rad/s"),
        parameters=(
            Q.positive("l", 1.0, "m", "length of a spoke"),
            Q.positive("g", 9.81, "m/s^2", "gravity"),
            Q.positive("slope", 0.08, "rad", "slope"),
        ),
        gains=(),
        model=_wheel_model,
        starts=({"q": 0.0, "v": 1.0},),
        portraits=(("q", "v"),),
        amplitude_of="q",
    )


def wheel_motion(slope: float = 0.08, length: float = 1.0, g: float = 9.81) -> tuple[float, Motion]:
    """Return period and orbit of the rimless wheel by its energy balance and SciPy."""
    half, square = math.pi / 8, math.cos(math.pi / 4) ** 2
    # A step adds 2 g/l (cos(begin) - cos(end)) to the squared speed, and an impact keeps `square`.
    gained = 2 * g / length * (math.cos(slope - half) - math.cos(slope + half))
    begin = math.sqrt(square * gained / (1 - square))
    return _cyclic(
        lambda _, y: [y[1], g / length * math.sin(y[0])],
        [slope - half, begin],
        lambda _, y: y[0] - slope - half,
    )


def _escapement_model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    x, v = ca.SX.sym("x"), ca.SX.sym("v")
    push = ca.if_else(v > 0, p["F"], -p["F"])
    pallet = zo.HybridLagrangian.from_energies(
        q=x,
        v=v,
        kinetic=v**2 / 2,
        potential=p["k"] * x**2 / 2,
        passive_force=push - p["c"] * v,
        gap=x + 100,
    )
    return zo.hybrid_system(pallet, zo.no_drive(pallet), p["restitution"])


def escapement() -> zo.Problem:
    """Return the oscillator with a push along its velocity."""
    return zo.Problem(
        name="escapement",
        title="oscillator with a push along its velocity",
        source="closed form",
        state_names=("x", "v"),
        state_units=("m", "m/s"),
        parameters=(
            Q.positive("k", 9.0, "1/s^2", "stiffness over mass"),
            Q.positive("c", 0.4, "1/s", "damping over mass"),
            Q.positive("F", 1.0, "m/s^2", "push over mass"),
            Q.restitution(0.0),
        ),
        gains=(),
        model=_escapement_model,
        starts=({"x": 1.0, "v": 0.01},),
        portraits=(("x", "v"),),
        amplitude_of="x",
    )


def escapement_motion(k: float = 9.0, c: float = 0.4, push: float = 1.0) -> tuple[float, Motion]:
    """Return period and orbit of the escapement, from its turning point at the left."""
    d = c / 2
    w = math.sqrt(k - d**2)
    half, middle = math.pi / w, push / k
    # In half a period the distance from the middle shrinks by exp(-d half).
    shrunk = math.exp(-d * half)
    largest = middle * (1 + shrunk) / (1 - shrunk)

    def motion(times: Vector) -> Vector:
        turns = np.floor(times / half)
        s, side = times - turns * half, np.where(turns % 2 == 0, 1.0, -1.0)
        size = -(largest + middle)
        fall = np.exp(-d * s) * size
        x = middle + fall * (np.cos(w * s) + d / w * np.sin(w * s))
        v = -fall * (w + d**2 / w) * np.sin(w * s)
        return np.column_stack([side * x, side * v])

    return 2 * half, motion


def _duffing_model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
    x, v = ca.SX.sym("x"), ca.SX.sym("v")
    clock = zo.Clock.at(p["omega"])
    beam = zo.HybridLagrangian.from_energies(
        q=x,
        v=v,
        kinetic=v**2 / 2,
        potential=x**4 / 4 - x**2 / 2,
        passive_force=p["A"] * clock.cosine - p["c"] * ca.fabs(v) * v,
        gap=x + 100,
        clock=clock,
    )
    return zo.hybrid_system(beam, zo.no_drive(beam), p["restitution"])


def duffing(side: float = 1.0) -> zo.Problem:
    """Return the driven oscillator with two wells, which starts in the well at one side."""
    return zo.Problem(
        name="duffing",
        title="driven oscillator with two wells",
        source="Moon and Holmes 1979",
        state_names=("x", "v", "cosine", "sine"),
        state_units=("m", "m/s", "1", "1"),
        parameters=(
            Q.positive("c", 1.5, "1/m", "quadratic drag"),
            Q.positive("A", 0.2, "m/s^2", "size of the drive"),
            Q.positive("omega", 1.1, "rad/s", "frequency"),
            Q.restitution(0.0),
        ),
        gains=(),
        model=_duffing_model,
        starts=({"x": side, "v": 0.0, "cosine": 1.0, "sine": 0.0},),
        portraits=(("x", "v"),),
        amplitude_of="x",
    )


def duffing_motion(
    side: float = 1.0, c: float = 1.5, amplitude: float = 0.2, omega: float = 1.1
) -> tuple[float, Motion]:
    """Return period and orbit in a well, by SciPy after 40 periods."""

    def rates(t: float, y: Vector) -> list[float]:
        return [y[1], y[0] - y[0] ** 3 - c * abs(y[1]) * y[1] + amplitude * math.cos(omega * t)]

    period = 2 * math.pi / omega
    options = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-12}
    settled = solve_ivp(rates, (0.0, 40 * period), [side, 0.0], **options).y[:, -1]
    found = solve_ivp(rates, (0.0, period), settled, dense_output=True, **options)

    def motion(times: Vector) -> Vector:
        x, v = found.sol(times % period)
        angle = omega * times
        return np.column_stack([x, v, np.cos(angle), np.sin(angle)])

    return period, motion


def _cyclic(
    rates: Callable[[float, Vector], list[float]],
    start: list[float],
    guard: Callable[[float, Vector], float],
) -> tuple[float, Motion]:
    """Return the motion from a start until a guard rises through zero, again and again."""
    guard.terminal, guard.direction = True, 1  # type: ignore[attr-defined]
    found = solve_ivp(
        rates,
        (0.0, 100.0),
        start,
        method="DOP853",
        events=guard,
        dense_output=True,
        rtol=1e-11,
        atol=1e-13,
    )
    if not found.t_events[0].size:
        raise ZenoOrbitsError("The motion does not come to its next cycle.")
    period = float(found.t_events[0][0])

    def motion(times: Vector, sol: Callable[[Vector], Vector]) -> Vector:
        return np.asarray(sol(times % period)).T

    return period, partial(motion, sol=found.sol)
