"""Random machines with nested limits, waveforms, tables and angles, and their motion by SciPy.

The motion is integrated from the formulas as they are written, with short steps. It knows neither
conditions nor modes: a kink only costs it steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi
import numpy as np
from scipy.integrate import solve_ivp

import zeno_orbits as zo
from tests.support.random_formulas import table
from zeno_orbits.arrays import Vector

ca: Any = casadi

SPEED, FAR, E = math.pi / 2, 0.6, 0.7
"""Frequency of the clock, distance of the stop, and its restitution."""
NAMES = ("q", "v", "current", "cosine", "sine")
Law = Callable[[Any], Any]
"""Two formulas, a force and a voltage, of the states."""


def _law(seed: int) -> Law:
    """Return the formulas of a machine, as a function of its states."""

    def law(x: Any) -> Any:
        random = np.random.default_rng(seed)
        nodes: list[Any] = [x[0], x[1], x[2], x[3], x[4]]

        def some() -> Any:
            weights = np.arange(3.0, len(nodes) + 3.0)
            return nodes[int(random.choice(len(nodes), p=weights / weights.sum()))]

        def number() -> float:
            return float(random.uniform(-1.5, 1.5))

        lines = table(random)
        made: list[Callable[[], Any]] = [
            lambda: number() * some() + number() * some() + number(),
            lambda: ca.sin(number() * some()) * some(),
            lambda: ca.fmin(abs(number()), some()),
            lambda: ca.fmax(-abs(number()), some()),
            lambda: ca.fmax(-0.7, ca.fmin(0.7, 2 * some())),
            lambda: ca.fmin(some(), some()),
            lambda: ca.fabs(some()),
            lambda: number() * ca.fabs(some() + number()),
            lambda: ca.if_else(x[4] > number() / 2, number(), some()),
            lambda: ca.if_else(x[3] + number() * x[4] < number() / 2, some(), some()),
            lambda: ca.if_else(some() < some(), number(), number()) * 0.2,
            lambda: ca.atan2(ca.sin(some() + number()), ca.cos(some())),
            lambda: lines(some()),
            lambda: ca.tanh(some()),
            lambda: 0.5 * ca.copysign(some(), x[4] + number() / 2),
            lambda: ca.fmin(ca.fmax(some() + number() / 2, 0), 2) ** 1.5,
            lambda: ca.sqrt(ca.fabs(some() + number() / 2)),
            lambda: ca.if_else(x[0] > number() / 4, ca.fabs(some()) ** 1.3, number()),
        ]
        for k in random.integers(len(made), size=int(random.integers(4, 11))):
            nodes += [made[int(k)]()]
        force, voltage = 0.5 * nodes[-1], nodes[-2]
        return ca.vertcat(ca.fmax(-2, ca.fmin(2, force)), ca.fmax(-2.5, ca.fmin(2.5, voltage)))

    return law


@dataclass(frozen=True, kw_only=True)
class RandomMachine:
    """A mass on a spring with a coil, a force and a voltage of random formulas, above a stop."""

    seed: int

    @property
    def start(self) -> dict[str, float]:
        """An initial state."""
        random = np.random.default_rng((self.seed, 1))
        q, v, current, phase = random.uniform(-0.5, 1.5, 4)
        names = {"q": q, "v": v, "current": current}
        return names | {"cosine": math.cos(phase), "sine": math.sin(phase)}

    def problem(self, *, with_switches: bool = True) -> zo.Problem:
        """Return the machine as a problem."""

        def model(p: Any) -> zo.CompletedSystem:
            q, v, current = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("current")
            clock = zo.Clock.at(ca.SX(SPEED))
            formulas = _law(self.seed)(ca.vertcat(q, v, current, clock.cosine, clock.sine))
            mass = zo.HybridLagrangian.from_energies(
                q=q,
                v=v,
                kinetic=v**2 / 2,
                potential=q**2 / 2,
                passive_force=-0.2 * v,
                applied_force=formulas[0],
                gap=q + FAR,
                clock=clock,
            )
            one = ca.SX(1)
            motor = zo.MotorBank(
                selection=one,
                resistance=one,
                inductance=one,
                torque_constant=one,
                emf_constant=one,
                voltage=formulas[1],
                current=current,
            )
            drive = zo.full_drive(mass, motor)
            given: dict[str, Any] = {"switches": ()} if with_switches else {}
            return zo.hybrid_system(mass, drive, p["restitution"], **given)

        return zo.Problem(
            name=f"random{self.seed}",
            title="random machine",
            source="generated",
            state_names=NAMES,
            state_units=("m", "m/s", "A", "1", "1"),
            parameters=(zo.Quantity.restitution(E),),
            gains=(),
            model=model,
            starts=(self.start,),
            portraits=(("q", "v"),),
            amplitude_of="q",
        )

    def motion(self, until: float, most_impacts: int = 12) -> Vector | None:
        """Return the state at a time, or ``None`` after too many impacts."""
        x = ca.SX.sym("x", 5)
        formulas = ca.Function("law", [x], [_law(self.seed)(x)])

        def rate(_: float, y: Any) -> list[float]:
            force, voltage = formulas(y).full().ravel()
            q, v, i, c, s = y
            return [v, -q - 0.2 * v + i + force, voltage - i - v, -SPEED * s, SPEED * c]

        def gap(_: float, y: Any) -> float:
            return float(y[0]) + FAR

        falls: Any = gap
        falls.terminal, falls.direction = True, -1
        time, y = 0.0, np.array([self.start[name] for name in NAMES])
        for _ in range(most_impacts):
            found: Any = solve_ivp(
                rate, (time, until), y, "DOP853", events=gap, rtol=1e-10, atol=1e-12, max_step=0.02
            )
            time, y = found.t[-1], found.y[:, -1].copy()
            if found.status == 0:
                return y
            y[1] *= -E
            y[0] = -FAR + 1e-15
        return None
