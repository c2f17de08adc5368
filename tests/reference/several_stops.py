r"""Closed forms of machines with several stops, switches and kinks, drawn at random.

Two-sided oscillator, ``x'' + c x' + x = A cos(w t)``, ``|x| <= d``. The symmetric orbit satisfies
``x(t + pi / w) = -x(t)``. Let ``P`` be the forced vibration at the impact on the upper stop and `E`
the flow of the free oscillator over half a period. Then ``E ((d, -e V) - P) - P = (-d, -V)``, a
linear problem for ``P`` at a given impact speed `V`, and `A` and the phase follow from ``P``.

Impact pair: a free mass between ends ``A sin t`` and ``A sin t + d``. Its speed between impacts
is constant, and ``V = (1 + e) / (1 - e) A cos p``, ``pi V = d - 2 A sin p`` at the phase `p` of the
impact on the lower end.

Hopper, ``h'' = a - g`` while it rises below `s`, else ``-g``: ``v^2`` after the next flight is
``e^2 v^2 + 2 a s``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

_SLOWEST = 0.05
"""Speed of an impact whose next flight is long compared with the grid of roots."""


@dataclass(frozen=True, kw_only=True)
class TwoSided:
    """A two-sided oscillator on its symmetric orbit.

    Attributes:
        c: Damping.
        omega: Frequency of the force.
        stop: Distance of both stops from the centre.
        restitution: Of both stops.
        speed: Before every impact.
        amplitude: Of the force.
        phase: Of the force, ``omega t``, at the impact on the upper stop.
        multipliers: Of half a period with the sign of the state changed.
    """

    c: float
    omega: float
    stop: float
    restitution: float
    speed: float
    amplitude: float
    phase: float
    multipliers: np.ndarray

    @property
    def half(self) -> float:
        """Half a period."""
        return math.pi / self.omega

    def state(self, time: float) -> tuple[float, float]:
        """Return position and speed at a time since the impact on the upper stop."""
        vibration = self.response() * np.exp(1j * (self.omega * time + self.phase))
        start = self.response() * np.exp(1j * self.phase)
        own = expm(np.array([[0, 1], [-1, -self.c]]) * time) @ np.array(
            [
                self.stop - start.real,
                -self.restitution * self.speed - (1j * self.omega * start).real,
            ]
        )
        return own[0] + vibration.real, own[1] + (1j * self.omega * vibration).real

    def response(self) -> complex:
        """Return the complex amplitude of the forced vibration."""
        return self.amplitude / complex(1 - self.omega**2, self.c * self.omega)


def two_sided(rng: np.random.Generator) -> TwoSided:
    """Return an oscillator whose orbit has two impacts per period and a moderate sensitivity."""
    while True:
        c, omega, stop = rng.uniform(0.02, 0.5), rng.uniform(0.3, 3.0), rng.uniform(0.2, 2.0)
        e, speed = rng.uniform(0.3, 0.95), rng.uniform(0.3, 3.0)
        flow = expm(np.array([[0, 1], [-1, -c]]) * math.pi / omega)
        start = np.array([stop, -e * speed])
        forced = np.linalg.solve(flow + np.eye(2), flow @ start + np.array([stop, speed]))
        # The vibration is Re(Z exp(i w t)) with Z = x - i x' / w, and A = Z (1 - w^2 + i c w).
        force = complex(forced[0], -forced[1] / omega) * complex(1 - omega**2, c * omega)
        amplitude, phase = abs(force), float(np.angle(force)) % (2 * math.pi)
        before = amplitude * math.cos(phase) - stop - c * speed
        after = amplitude * math.cos(phase) - stop + c * e * speed
        saltation = np.array([[-e, 0.0], [(after + e * before) / speed, -e]])
        # Half a period maps deviations by the flow and the saltation, up to the sign.
        multipliers = np.linalg.eigvals(-saltation @ flow)
        found = TwoSided(
            c=c,
            omega=omega,
            stop=stop,
            restitution=e,
            speed=speed,
            amplitude=amplitude,
            phase=phase,
            multipliers=multipliers,
        )
        times = np.linspace(0.0, found.half, 400)[1:-1]
        inside = all(abs(found.state(t)[0]) < stop for t in times)
        if inside and max(abs(multipliers)) < 3.0 and amplitude < 30.0:
            return found


@dataclass(frozen=True, kw_only=True)
class ImpactPair:
    """A free mass between two moving ends.

    Attributes:
        amplitude: Of the ends.
        restitution: Of both.
        phase: At which the mass leaves the lower end.
        speed: Of the mass.
        length: Between the ends.
    """

    amplitude: float
    restitution: float
    phase: float
    speed: float
    length: float


def impact_pair(rng: np.random.Generator) -> ImpactPair:
    """Return an impact pair whose mass strikes each end once per period."""
    while True:
        amplitude, e, phase = rng.uniform(0.2, 2.0), rng.uniform(0.2, 0.8), rng.uniform(-1.2, 1.2)
        speed = (1 + e) / (1 - e) * amplitude * math.cos(phase)
        length = math.pi * speed + 2 * amplitude * math.sin(phase)
        times = np.linspace(0.0, math.pi, 400)[1:-1]
        above = amplitude * math.sin(phase) + speed * times - amplitude * np.sin(phase + times)
        if length > 0.1 and np.all(above > 0.0) and np.all(above < length):
            return ImpactPair(
                amplitude=amplitude, restitution=e, phase=phase, speed=speed, length=length
            )


def hopper_speeds(speed: float, n: int, *, thrust: float, rise: float, e: float) -> list[float]:
    """Return the speeds before `n` impacts after one: ``v^2 -> e^2 v^2 + 2 a s``."""
    speeds = []
    for _ in range(n):
        speed = math.sqrt(e**2 * speed**2 + 2 * thrust * rise)
        speeds.append(speed)
    return speeds


@dataclass(frozen=True, kw_only=True)
class ClippedMotor:
    """A mass on a spring, moved by a motor with a clipped voltage, over a stop.

    ``m q'' = -k q - c q' + K i``, ``L i' = clip(V) - R i - K q'``,
    ``V = -p q - d q' + A cos(w t + f)``, ``q <= s``.
    """

    m: float
    k: float
    c: float
    K: float
    L: float
    R: float
    p: float
    d: float
    A: float
    omega: float
    limit: float
    stop: float
    restitution: float

    def matrix(self, side: int) -> np.ndarray:
        """Return the rate of ``(q, q', i, cos, sin, 1)`` with the voltage on one of three sides."""
        A = np.zeros((6, 6))
        A[0, 1] = 1.0
        A[1, :3] = np.array([-self.k, -self.c, self.K]) / self.m
        A[2, 1:3] = np.array([-self.K, -self.R]) / self.L
        A[2] += (self.voltage() if side == 0 else np.array([0, 0, 0, 0, 0, side * self.limit])) / (
            self.L
        )
        A[3, 4], A[4, 3] = -self.omega, self.omega
        return A

    def voltage(self) -> np.ndarray:
        """Return the row of the voltage before it is clipped."""
        return np.array([-self.p, -self.d, 0.0, self.A, 0.0, 0.0])

    def events(self, until: float) -> list[tuple[str, float, np.ndarray]]:
        """Return the events of the motion from rest at zero, by matrix exponentials.

        Each is ``impact`` or ``switch``, its time, and the state ``(q, q', i, cos, sin)`` before
        it. Roots are bracketed on a grid of 4000 points per run, so the list ends before the first
        slow impact.
        """
        t, x = 0.0, np.array([0.0, 0.0, 0.0, 1.0, 0.0, 1.0])
        found: list[tuple[str, float, np.ndarray]] = []
        step, row = until / 4000, self.voltage()

        def side_of(x: np.ndarray) -> int:
            return 1 if row @ x > self.limit else -1 if row @ x < -self.limit else 0

        side = side_of(x)
        while t < until:
            A = self.matrix(side)
            tick = expm(A * step)
            guards = [np.array([-1.0, 0, 0, 0, 0, self.stop])]
            if side >= 0:
                guards.append(np.array([0, 0, 0, 0, 0, self.limit]) - row)
            if side <= 0:
                guards.append(np.array([0, 0, 0, 0, 0, self.limit]) + row)
            signs = [1.0 if g @ x > -1e-12 or i == 0 else -1.0 for i, g in enumerate(guards)]
            if side:
                signs[1] = -1.0
            past, y, s = [False] * len(guards), x, 0.0
            event: tuple[float, int] | None = None
            while t + s < until and event is None:
                z = tick @ y
                for i, (g, sign) in enumerate(zip(guards, signs, strict=True)):
                    if past[i] and sign * (g @ z) <= 0.0:
                        root = _root_of(g, A, y, step)
                        if event is None or s + root < event[0]:
                            event = (s + root, i)
                    past[i] = sign * (g @ z) > 1e-14
                y, s = z, s + step
            if event is None:
                return found
            s, i = event
            x = expm(A * s) @ x
            t += s
            if i == 0:
                if x[1] < _SLOWEST:
                    return found
                found.append(("impact", t, x[:5].copy()))
                x[1] *= -self.restitution
                side = side_of(x)
            else:
                found.append(("switch", t, x[:5].copy()))
                outward = i == 1 if side == 0 else None
                side = 0 if side else (1 if outward else -1)
        return found


def _root_of(guard: np.ndarray, A: np.ndarray, y: np.ndarray, step: float) -> float:
    """Return the time at which ``guard exp(A t) y`` is zero, within a step."""
    return float(brentq(lambda t: guard @ expm(A * t) @ y, 0.0, step, xtol=1e-15))


def clipped_motor(rng: np.random.Generator) -> ClippedMotor:
    """Return a motor whose voltage is clipped and whose mass strikes its stop."""
    return ClippedMotor(
        m=rng.uniform(0.5, 2.0),
        k=rng.uniform(0.5, 5.0),
        c=rng.uniform(0.05, 0.5),
        K=rng.uniform(0.5, 2.0),
        L=rng.uniform(0.2, 1.0),
        R=rng.uniform(0.5, 2.0),
        p=rng.uniform(0.0, 3.0),
        d=rng.uniform(0.0, 1.0),
        A=rng.uniform(3.0, 6.0),
        omega=rng.uniform(0.5, 2.5),
        limit=rng.uniform(1.0, 2.5),
        stop=rng.uniform(0.3, 1.0),
        restitution=rng.uniform(0.3, 0.8),
    )
