"""Orbits with one impact a turn of a forced oscillator against a stop, in closed form.

Between impacts the motion is the particular solution plus ``exp(F t)`` of the rest. Around an orbit
that returns after ``T`` the monodromy is ``S exp(F T)`` with the saltation matrix of the impact,

``S = [[-e, 0], [(a_plus + e a_minus) / v_minus, -e]]``.

Nothing here simulates, and nothing is shared with the package.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq, fsolve


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


def grazing_stop(n: int, damping: float, restitution: float, above: float) -> float:
    """Return the stop at which a contact grazes after ``n`` impacts of a turn.

    It is a root of the flights in closed form, for ``A = omega = 1`` and ``c < 2``: the ``n``
    impacts of a turn, and a contact without speed before the first impact of the next turn.

    Args:
        n: Number of impacts.
        damping: ``c``.
        restitution: ``e``.
        above: A stop with ``n`` impacts per turn, not far above.
    """
    machine = ImpactOscillator(
        amplitude=1.0, omega=1.0, damping=damping, stop=above, restitution=restitution
    )

    def equations(unknowns: Any) -> list[float]:
        times, graze, speed, stop = unknowns[:n], unknowns[n], unknowns[n + 1], unknowns[n + 2]
        missed, w = list[float](), speed
        for begin, end in pairwise(times):
            place, rate = _flown(machine, (begin, stop, w), end)
            missed.append(place - stop)
            w = -restitution * rate
        place, rate = _flown(machine, (times[-1], stop, w), graze)
        last, before = _flown(machine, (times[-1], stop, w), times[0] + machine.period)
        return [*missed, place - stop, rate, last - stop, -restitution * before - speed]

    struck = _settled(machine, n)
    times = [time for time, _ in struck]
    ahead = np.linspace(times[-1], times[0] + machine.period, 4000)[1:-1]
    track = _flown(machine, (times[-1], above, struck[-1][1]), ahead)[0]
    humps = np.flatnonzero(np.diff(np.sign(np.diff(track))) < 0) + 1
    # Without a hump the next contact would come after about as long as the last one did.
    graze = ahead[humps[0]] if len(humps) else 1.5 * times[-1] - 0.5 * times[-2]
    guess: Any = np.array([*times, graze, struck[0][1], above])
    root: Any = fsolve(equations, guess, xtol=1e-14, full_output=True)[0]
    assert np.max(np.abs(equations(root))) < 1e-12
    assert np.all(np.diff(root[: n + 1]) > 0.0)
    return float(root[n + 2])


def _flown(machine: ImpactOscillator, start: tuple[float, float, float], time: Any) -> Any:
    """Return place and speed of a flight at one or many times.

    Args:
        machine: An oscillator with ``c < 2``.
        start: Time, place and speed at the start.
        time: The times.
    """
    begin, place, speed = start
    decay = machine.damping / 2
    turn = math.sqrt(1 - decay**2)
    left = np.array([place, speed]) - machine.particular(begin)
    times: Any = np.asarray(time)
    span = times - begin
    fade, c, s = np.exp(-decay * span), np.cos(turn * span), np.sin(turn * span) / turn
    forced = machine.particular(times)
    pushed = (machine.free + decay * np.eye(2)) @ left
    return [forced[k] + fade * (c * left[k] + s * pushed[k]) for k in range(2)]


def _over(machine: ImpactOscillator, start: tuple[float, float, float]) -> Any:
    """Return the place of a flight beyond the stop, as a function of time."""

    def gone(time: float) -> float:
        return float(_flown(machine, start, time)[0] - machine.stop)

    return gone


def _settled(machine: ImpactOscillator, n: int) -> list[tuple[float, float]]:
    """Return the impacts of a turn, from the first, each with its time and the speed after it."""
    struck = [(0.0, 1.0)]
    while struck[-1][0] < 12 * machine.period:
        time, speed = struck[-1]
        start = (time, machine.stop, speed)
        ahead = time + np.concatenate([[1e-4, 1e-3], np.arange(1, 9000) * 2e-3])
        gone = _flown(machine, start, ahead)[0] - machine.stop
        k = int(np.flatnonzero((gone[:-1] < 0.0) & (gone[1:] >= 0.0))[0])
        arrival = brentq(_over(machine, start), ahead[k], ahead[k + 1], xtol=1e-14)
        struck.append((arrival, -machine.restitution * _flown(machine, start, arrival)[1]))
    pauses = np.diff([time for time, _ in struck])
    first = 1 + max(range(len(struck) - 2 * n - 1, len(struck) - n - 1), key=lambda k: pauses[k])
    assert abs(struck[first + n][0] - struck[first][0] - machine.period) < 1e-6
    return struck[first : first + n]
