"""The work that every competitor does, and how a script of this folder reports it.

Imports nothing but the standard library, because not every competitor lives in the same Python.

The problem is ``motor_pendulum`` at its reference numbers, the two calibrated ones solved once more
(docs/theory.md (10)). Its laws are written here as a user would write them, lean and for plain
floats; whoever brings another ``sin`` and ``cos`` gets the same laws for symbols.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

RELEASE = (0.1985068301199, 0.0, -5.2365375521764, 0.0, -1.8591703843225)
"""Release of the reference orbit: ``theta1, theta2, dtheta1, dtheta2, current``."""

ZENO_POINT = (1.236168909791, 0.0, 1.749207992260, 0.0, -0.460250671559)
"""Its Zeno point. The stop holds here whatever the inductance, so the sweep starts here."""

REFERENCE_RATE = 1500.0
"""``R / L`` of the reference problem [1/s]."""

HORIZON = 20.0
"""How long every motion is followed [s]."""

BALL_HEIGHT, BALL_GRAVITY, BALL_RESTITUTION = 1.0, 9.81, 0.8


@dataclass(frozen=True, kw_only=True)
class Pendulum:
    """The pendulum in the letters of docs/theory.md (10), with the motor and the gains."""

    A: float
    B: float
    C: float
    D: float
    E: float
    g: float
    torque_constant: float
    resistance: float
    inductance: float
    proportional: float
    derivative: float
    restitution: float

    def rates(self, x: Sequence[Any], sin: Any = math.sin, cos: Any = math.cos) -> tuple[Any, ...]:
        """Return ``dx/dt`` off the stop."""
        theta1, theta2, rate1, rate2, current = x
        coupling = self.C * cos(theta2)
        m11 = self.A + self.B + 2.0 * coupling
        m12 = self.B + coupling
        swirl = self.C * sin(theta2)
        pull2 = self.g * self.E * sin(theta1 + theta2)
        torque = self.torque_constant * current - self.g * self.D * sin(theta1) - pull2
        r1 = torque + swirl * (2.0 * rate1 + rate2) * rate2
        r2 = -swirl * rate1 * rate1 - pull2
        determinant = m11 * self.B - m12 * m12
        return (
            rate1,
            rate2,
            (self.B * r1 - m12 * r2) / determinant,
            (m11 * r2 - m12 * r1) / determinant,
            self.current_rate(theta1, rate1, current),
        )

    def locked_rates(self, x: Sequence[Any], sin: Any = math.sin) -> tuple[Any, Any, Any]:
        """Return the rates of ``theta1, dtheta1, current`` on the stop."""
        theta1, rate1, current = x
        pull = self.g * (self.D + self.E) * sin(theta1)
        inertia = self.A + self.B + 2.0 * self.C
        acceleration = (self.torque_constant * current - pull) / inertia
        return rate1, acceleration, self.current_rate(theta1, rate1, current)

    def current_rate(self, theta1: Any, rate1: Any, current: Any) -> Any:
        """Return the rate of the current under the PD voltage [A/s]."""
        voltage = -self.proportional * theta1 - self.derivative * rate1
        emf = self.torque_constant * rate1
        return (voltage - emf - self.resistance * current) / self.inductance

    def hold(self, theta1: Any, current: Any, sin: Any = math.sin) -> Any:
        """Return minus the gap acceleration on the stop, the multiplier up to a positive factor."""
        delta = self.A * self.B - self.C * self.C
        of_current = (self.B + self.C) * self.torque_constant / delta
        of_angle = self.g * ((self.A + self.C) * self.E - (self.B + self.C) * self.D) / delta
        return of_current * current + of_angle * sin(theta1)

    def impact(self, x: Sequence[Any], restitution: float) -> list[Any]:
        """Return the state after an impact; restitution 0 is the plastic reset."""
        theta1, _, rate1, rate2, current = x
        share = (self.B + self.C) / (self.A + self.B + 2.0 * self.C)
        jump = (1.0 + restitution) * share * rate2
        return [theta1, 0.0, rate1 + jump, -restitution * rate2, current]


def declared(rate: float) -> dict[str, float]:
    """Return all parameters of the problem at ``R / L = rate`` [1/s], the inductance adapted."""
    p = {"L1": 0.20, "lc1": 0.06, "m1": 0.30, "I1": 0.001, "L2": 0.30, "lc2": 0.15, "m2": 0.10}
    p |= {"I2": 0.00075, "R": 3.0, "L": 3.0 / rate, "restitution": 0.2, "g": 9.81}
    b, c = p["I2"] + p["m2"] * p["lc2"] ** 2, p["m2"] * p["L1"] * p["lc2"]
    d, e = p["m1"] * p["lc1"] + p["m2"] * p["L1"], p["m2"] * p["lc2"]
    g = p["g"]
    a = (g * ((b + c) * d - c * e) - 27.5697 * c**2) / (g * e - 27.5697 * b)
    p["J_rotor"] = a - p["I1"] - p["m1"] * p["lc1"] ** 2 - p["m2"] * p["L1"] ** 2
    p["K_torque"] = p["K_emf"] = 2.92437 * (a * b - c**2) / (b + c)
    return p


def pendulum(rate: float) -> Pendulum:
    """Return the pendulum at ``R / L = rate`` [1/s] and the published gains."""
    p = declared(rate)
    return Pendulum(
        A=p["I1"] + p["m1"] * p["lc1"] ** 2 + p["m2"] * p["L1"] ** 2 + p["J_rotor"],
        B=p["I2"] + p["m2"] * p["lc2"] ** 2,
        C=p["m2"] * p["L1"] * p["lc2"],
        D=p["m1"] * p["lc1"] + p["m2"] * p["L1"],
        E=p["m2"] * p["lc2"],
        g=p["g"],
        torque_constant=p["K_torque"],
        resistance=p["R"],
        inductance=p["L"],
        proportional=2.5,
        derivative=-1.0,
        restitution=p["restitution"],
    )


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Where a motion was at its end.

    Attributes:
        state: ``theta1, theta2, dtheta1, dtheta2, current``.
        impacts: How many were resolved, if the competitor can tell.
        locks: How often the stop caught the link, if it can tell.
    """

    state: Sequence[float]
    impacts: int | None = None
    locks: int | None = None


@dataclass(frozen=True, kw_only=True)
class Method:
    """One way of doing the work.

    Attributes:
        name: How the tables call it.
        accuracies: What to ask of it over 20 s, loosest first: a tolerance, or a step size.
        prepare: From ``R / L``, accuracy, start state and whether it starts on the stop to a
            function that follows the motion; whatever a user does once is done in here.
        sweep_accuracies: What to ask of it in the sweep over ``R / L``.
        ball: From an accuracy to a function that returns a Zeno time [s], if it does balls.
        grows: Its time grows like ``R / L``, so that a step of the sweep can be foreseen.
    """

    name: str
    accuracies: Sequence[float]
    prepare: Callable[[float, float, Sequence[float], bool], Callable[[], Motion]]
    sweep_accuracies: Sequence[float] = ()
    ball: Callable[[float], Callable[[], float]] | None = None
    grows: bool = False


class NotInstalledError(RuntimeError):
    """A competitor is missing; the text is the line for the table."""


def cut(accuracy: float) -> float:
    """Return the impact speed from which impacts are made plastic [rad/s].

    The paper's rule errs by about 1.5e-6 of the cube of this speed (docs/theory.md (11)), so a
    user who knows that takes no more impacts than the accuracy asks for.
    """
    return 10.0 * accuracy ** (1 / 3)


def clock(task: Callable[[], Any], runs: int) -> tuple[list[float], Any]:
    """Return the times of some runs [s] after one that does not count, and what the last gave.

    Times are the processor's for this process, which a busy machine changes little; nobody here
    uses more than one thread. Short tasks are run more often, for half a second, as their times
    scatter most. A first run of more than two seconds counts and stays the only one.
    """
    times: list[float] = []
    result: Any = None
    while len(times) <= runs or (sum(times) < 0.5 and len(times) <= 20 * runs):
        started = time.process_time()
        result = task()
        times.append(time.process_time() - started)
        if times[0] > 2.0:
            return times, result
    return times[1:], result


def measure(
    method: Method, rate: float, accuracy: float, start: Sequence[float], locked: bool, runs: int
) -> dict[str, Any]:
    """Return one row: what was asked, how long it took, and where the motion ended."""
    row: dict[str, Any] = {"method": method.name, "rate": rate, "accuracy": accuracy}
    try:
        started = time.perf_counter()
        task = method.prepare(rate, accuracy, start, locked)
        row["preparation"] = time.perf_counter() - started
        times, motion = clock(task, runs)
    except NotInstalledError:
        raise
    except Exception as error:  # noqa: BLE001  (whatever ends a competitor's run is its result)
        return row | {"failure": f"{type(error).__name__}: {str(error).splitlines()[0]}"}
    state = [float(value) for value in motion.state]
    if not all(math.isfinite(value) for value in state):
        return row | {"failure": "ended in NaN or infinity"}
    return row | {
        "seconds": times,
        "state": state,
        "impacts": motion.impacts,
        "locks": motion.locks,
    }


def follow(method: Method, options: argparse.Namespace) -> list[dict[str, Any]]:
    """Return the rows of the reference motion, one an accuracy."""
    return [
        measure(method, REFERENCE_RATE, accuracy, RELEASE, False, options.runs)
        for accuracy in method.accuracies
    ]


def sweep(method: Method, options: argparse.Namespace) -> list[dict[str, Any]]:
    """Return the rows of the sweep over ``R / L``; what would take too long is left out."""
    rows: list[dict[str, Any]] = []
    for accuracy in method.sweep_accuracies:
        foreseen, before = 0.0, 0.0
        for rate in options.rates:
            if method.grows and before and foreseen * rate / before > options.longest:
                left_out = f"left out, would take about {foreseen * rate / before:.0f} s"
                rows.append(
                    {"method": method.name, "rate": rate, "accuracy": accuracy}
                    | {"failure": left_out}
                )
                continue
            row = measure(method, rate, accuracy, ZENO_POINT, True, options.runs)
            rows.append(row)
            if "seconds" in row:
                foreseen, before = min(row["seconds"]), rate
    return rows


def ball(method: Method, options: argparse.Namespace) -> list[dict[str, Any]]:
    """Return the rows of the bouncing ball, whose Zeno time is known in closed form."""
    if method.ball is None:
        return []
    exact = math.sqrt(2 * BALL_HEIGHT / BALL_GRAVITY)
    exact *= (1 + BALL_RESTITUTION) / (1 - BALL_RESTITUTION)
    rows: list[dict[str, Any]] = []
    for accuracy in (1e-6, 1e-12):
        row: dict[str, Any] = {"method": method.name, "accuracy": accuracy}
        try:
            times, zeno_time = clock(method.ball(accuracy), options.runs)
        except Exception as error:  # noqa: BLE001  (as above)
            rows.append(row | {"failure": f"{type(error).__name__}: {error}"})
            continue
        rows.append(row | {"seconds": times, "error": abs(zeno_time - exact) / exact})
    return rows


WORKS = {"follow": follow, "sweep": sweep, "ball": ball}


def serve(description: str | None, methods: Sequence[Method], version: Callable[[], str]) -> int:
    """Run one competitor's script: do the work asked for and print it as JSON.

    Exit codes: 0, done; 3, the competitor is not there, and the only line says so.
    """
    parser = argparse.ArgumentParser(description=(description or "").partition("\n")[0])
    parser.add_argument(
        "work",
        choices=WORKS,
        help="`follow` the reference motion for 20 s, `sweep` R/L, or time the bouncing `ball`",
    )
    parser.add_argument("--runs", type=int, default=5, metavar="N", help="runs that count, of each")
    parser.add_argument(
        "--rates",
        type=float,
        nargs="+",
        default=[1e3, 1e4, 1e5, 1e6],
        metavar="X",
        help="R/L of the sweep [1/s], ascending",
    )
    parser.add_argument(
        "--longest",
        type=float,
        default=30.0,
        metavar="S",
        help="leave out runs of the sweep that are foreseen to take longer [s]",
    )
    options = parser.parse_args()
    if options.runs < 1:
        parser.error(f"--runs must be at least 1, but it is {options.runs}")
    try:
        found = version()
        rows = [row for method in methods for row in WORKS[options.work](method, options)]
    except NotInstalledError as error:
        print(error)
        return 3
    json.dump({"version": found, "rows": rows}, sys.stdout)
    print()
    return 0
