"""Orbits with one impact a turn of a forced oscillator against a stop, in closed form.

Between impacts the motion is the particular solution plus ``exp(F t)`` of the rest. Around an orbit
that returns after ``T`` the monodromy is ``S exp(F T)`` with the saltation matrix of the impact,

``S = [[-e, 0], [(a_plus + e a_minus) / v_minus, -e]]``.

Nothing here simulates, and nothing is shared with the package.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import expm
from scipy.optimize import fsolve


@dataclass(frozen=True, slots=True, kw_only=True)
class ImpactOscillator:
    """``x'' + c x' + x = A cos(omega t)``, ``x <= stop``.

    Attributes:
        amplitude: ``A``.
        omega: Frequency of the force.
        damping: ``c``.
        stop: Position of the stop.
        restitution: ``e``.
    """

    amplitude: float
    omega: float
    damping: float
    stop: float
    restitution: float

    @property
    def period(self) -> float:
        """One turn of the force."""
        return 2 * math.pi / self.omega

    @property
    def free(self) -> Any:
        """The free motion's matrix."""
        return np.array([[0.0, 1.0], [-1.0, -self.damping]])

    def particular(self, time: float) -> Any:
        """Return the forced motion, position and velocity."""
        response = self.amplitude / complex(1 - self.omega**2, self.damping * self.omega)
        turned = response * np.exp(1j * self.omega * time)
        return np.array([turned.real, (1j * self.omega * turned).real])

    def miss(self, start: float, speed: float) -> Any:
        """Return what one turn from just after an impact misses, the reset included."""
        before = self.at_impact(start, speed)
        return np.array([before[0] - self.stop, -self.restitution * before[1] - speed])

    def at_impact(self, start: float, speed: float) -> Any:
        """Return the state one turn after an impact, before the reset."""
        left = np.array([self.stop, speed]) - self.particular(start)
        return self.particular(start) + expm(self.free * self.period) @ left

    def monodromy(self, start: float, speed: float) -> Any:
        """Return the monodromy of an orbit."""
        e, minus = self.restitution, self.at_impact(start, speed)[1]
        force = self.amplitude * math.cos(self.omega * start) - self.stop
        kick = (force - self.damping * speed) + e * (force - self.damping * minus)
        saltation = np.array([[-e, 0.0], [kick / minus, -e]])
        return saltation @ expm(self.free * self.period)


def critical(make: Any, multiplier: float, guess: tuple[float, float, float]) -> float:
    """Return the parameter at which an orbit has a multiplier of 1 or -1.

    Args:
        make: From the parameter to the oscillator.
        multiplier: 1 or -1.
        guess: Start of the flight, speed after the impact, parameter.
    """

    def equations(unknowns: Any) -> list[float]:
        start, speed, parameter = unknowns
        oscillator = make(parameter)
        m = oscillator.monodromy(start, speed)
        condition = np.linalg.det(m - multiplier * np.eye(2))
        return [*oscillator.miss(start, speed), condition]

    # It may end in the complaint that rounding lets it go no further.
    root = fsolve(equations, guess, xtol=1e-14, full_output=True)[0]
    assert np.max(np.abs(equations(root))) < 1e-12
    return float(root[2])
