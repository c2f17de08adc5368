"""Two machines under a feedback once per period, by equations that share no code with the package.

The juggled ball flies along parabolas, and its impacts are roots of the table's motion. The walker
is integrated by SciPy.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

Vector = NDArray[np.float64]
Law = Callable[[Vector], float]
"""Input from the measured coordinates of a return."""


@dataclass(frozen=True, kw_only=True)
class Juggler:
    """A ball on a table that moves as ``A sin(omega t)``.

    Attributes:
        amplitude: Amplitude of the table [m].
        omega: Frequency of the table [rad/s].
        restitution: Coefficient of restitution.
        g: Gravity [m/s^2].
    """

    amplitude: float
    omega: float = 30.0
    restitution: float = 0.8
    g: float = 9.81

    def orbit(self, *, rises: bool) -> tuple[float, float]:
        """Return phase and relative speed after the impact of one impact per turn.

        Args:
            rises: True for the impact on a table that decelerates, False for the saddle.
        """
        e, fall = self.restitution, math.pi * self.g / self.omega
        table = fall * (1 - e) / (1 + e)
        phase = math.acos(table / (self.amplitude * self.omega))
        return (phase if rises else -phase), fall - table

    def multipliers(self, *, rises: bool) -> Any:
        """Return the multipliers of that orbit, the largest first."""
        e, (phase, _) = self.restitution, self.orbit(rises=rises)
        lift = self.amplitude * self.omega**2 * math.sin(phase) / self.g
        values = np.roots([1.0, -(1 + e**2 - (1 + e) ** 2 * lift), e**2])
        return values[np.argsort(-np.abs(values))]

    def returned(self, phase: float, speed: float, pull: float) -> tuple[float, float, float]:
        """Return phase and speed after the next impact, and the time until then [s]."""
        a, w, g = self.amplitude, self.omega, self.g + pull
        rise = speed + a * w * math.cos(phase)

        def height(s: float) -> float:
            table = 2 * a * math.cos(phase + w * s / 2) * math.sin(w * s / 2)
            return rise * s - g * s**2 / 2 - table

        end = 1e-3 * speed / g
        while height(end) > 0.0:
            end += 1e-3 * speed / g
        time = float(brentq(height, end / 2, end, xtol=1e-16, rtol=1e-15))
        landing = rise - g * time - a * w * math.cos(phase + w * time)
        return phase + w * time, -self.restitution * landing, time

    def held(self, start: Vector, law: Law, n: int) -> Vector:
        """Return speed and cosine of the phase after each impact, ``(n + 1, 2)``.

        Args:
            start: Phase and speed after an impact.
            law: Pull from speed and cosine.
            n: Number of impacts.
        """
        phase, speed = start.tolist()
        points = [np.array([speed, math.cos(phase)])]
        for _ in range(n):
            phase, speed, _ = self.returned(phase, speed, law(points[-1]))
            points.append(np.array([speed, math.cos(phase)]))
        return np.array(points)


def walked(slope: float, start: Vector, law: Law, n: int, precision: float = 1e-12) -> Vector:
    """Return the states just before each heel strike of the simplest walker, ``(n, 4)``.

    Args:
        slope: Angle of the slope [rad].
        start: Stance, swing and their rates just before a heel strike.
        law: Torque of the hip from this state.
        n: Number of strikes.
        precision: Relative and absolute local error.
    """

    def rate(_: float, x: Vector, hip: float) -> list[float]:
        stance, swing, turn, swung = x
        fall = math.sin(stance - slope)
        leg = fall + (turn**2 - math.cos(stance - slope)) * math.sin(swing) + hip
        return [turn, swung, fall, leg]

    def strike(_: float, x: Vector, __: float) -> float:
        return 2 * x[0] - x[1] if x[0] < -0.02 else -1.0

    strike.terminal = True  # type: ignore[attr-defined]
    points, before = list[Vector](), start
    settings: dict[str, Any] = {"method": "DOP853", "rtol": precision, "atol": precision}
    for _ in range(n):
        hip, kept = law(before), math.cos(2 * before[0])
        after = [-before[0], -2 * before[0], kept * before[2], kept * (1 - kept) * before[2]]
        # The foot passes the slope at mid-stance, so the first part of a step has no event.
        middle: Any = solve_ivp(rate, (0, 2.5), after, args=(hip,), **settings)
        found: Any = solve_ivp(
            rate, (0, 10), middle.y[:, -1], args=(hip,), events=strike, max_step=0.1, **settings
        )
        if not found.t_events[0].size:
            break
        before = np.asarray(found.y_events[0][0])
        points.append(before)
    return np.array(points)
