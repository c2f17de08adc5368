"""A ball on a floor that a force pushes between two times of each period, by parabolas.

With gravity `g`, restitution `e` and the force `F` between `t1` and `t2` of a period `T`, let
:math:`J = F (t_2 - t_1)` and `m` be the middle of the pulse. A ball that leaves the floor at the
time `s` before `t1`, at the speed `v`, is back after `d` if

.. math:: v d - g d^2 / 2 + J (s + d - m - T [s > m]) = 0,\\qquad v^+ = -e (v - g d + J).

One impact per period needs :math:`v = (g T - J) e / (1 + e)`, and its multipliers have the product
:math:`e^2`.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

import zeno_orbits as zo

T, OMEGA = 0.2, 2 * math.pi / 0.2


def pushed_ball() -> zo.Problem:
    """Return the machine. Amplitude and times of its force are gains."""

    def model(p: Mapping[str, ca.SX]) -> zo.CompletedSystem:
        z, v, clock = ca.SX.sym("z"), ca.SX.sym("v"), zo.Clock.at(ca.SX(OMEGA))
        ball = zo.HybridLagrangian.from_energies(
            q=z,
            v=v,
            kinetic=v**2 / 2,
            potential=p["g"] * z,
            applied_force=zo.piecewise(clock, (0, p["F"], 0), (p["t1"], p["t2"])),
            clock=clock,
            gap=z,
        )
        return zo.hybrid_system(ball, zo.no_drive(ball), p["restitution"])

    def gain(name: str, unit: str, default: float, lower: float, upper: float) -> zo.Quantity:
        return zo.Quantity(
            name=name, unit=unit, meaning=name, default=default, lower=lower, upper=upper
        )

    return zo.Problem(
        name="pushed_ball",
        title="ball that a pulse pushes",
        source="tests/support/pushed_ball.py",
        state_names=("height", "speed", "cosine", "sine"),
        state_units=("m", "m/s", "1", "1"),
        parameters=(zo.Quantity.positive("g", 9.81, "m/s^2", "g"), zo.Quantity.restitution(0.8)),
        gains=(
            gain("F", "N/kg", 12.5, 0.0, 30.0),
            gain("t1", "s", 0.08, 0.06, 0.11),
            gain("t2", "s", 0.12, 0.112, 0.16),
        ),
        model=model,
        starts=(Ball().start,),
        portraits=(("height", "speed"),),
        amplitude_of="height",
    )


@dataclass(frozen=True, kw_only=True)
class Ball:
    """The parabolas of the ball, also for complex numbers."""

    F: complex = 12.5
    t1: complex = 0.08
    t2: complex = 0.12
    g: float = 9.81
    e: float = 0.8

    @property
    def _push(self) -> tuple[complex, complex]:
        return self.F * (self.t2 - self.t1), (self.t1 + self.t2) / 2

    @property
    def orbit(self) -> tuple[float, float]:
        """Time in the period and speed just after the impact of one impact per period."""
        push, middle = self._push
        speed = (self.g * T - push) * self.e / (1 + self.e)
        return (middle - T - (speed * T - self.g * T**2 / 2) / push).real, speed.real

    @property
    def start(self) -> dict[str, float]:
        """State just after this impact."""
        time, speed = self.orbit
        turn = OMEGA * time
        return {"height": 0.0, "speed": speed, "cosine": math.cos(turn), "sine": math.sin(turn)}

    def after(self, time: complex, speed: complex) -> tuple[complex, complex]:
        """Return time in the next period and speed just after the next impact."""
        push, middle = self._push
        # -g d^2 / 2 + (v + J) d + J (s - m) = 0, the later root.
        half, rest = (speed + push) / self.g, 2 * push * (time - middle) / self.g
        flight = half + cmath.sqrt(half**2 + rest)
        return time + flight - T, -self.e * (speed - self.g * flight + push)
