r"""Machines with elastic stops: closed forms, and an event loop over SciPy's integrator.

Two blocks of the masses 1 and `M` on a line with a wall. An elastic impact reflects
:math:`(\sqrt M\,V, v)` at a line, so every block impact and the next wall impact together turn that
vector by :math:`2\theta`, :math:`\tan\theta = 1 / \sqrt M`. The impacts end when :math:`n\theta`
reaches :math:`\pi`: there are :math:`\lceil \pi / \theta \rceil - 1` of them.

A chain of masses on a line has a wall at its lower end. The mass `k` has a spring to its own place
and a damper, and a force :math:`A_k \cos \omega t`. Between impacts the chain is linear.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from scipy.integrate import solve_ivp

_TOLERANCE = 1e-12
_STARTED = 1e-9
"""Time after an impact in which the gap of its stop is not watched."""


def blocks_impacts(mass: float) -> int:
    """Return the number of impacts of two elastic blocks and a wall.

    Args:
        mass: Mass of the outer block over the mass of the inner block.
    """
    return math.ceil(math.pi / math.atan(1.0 / math.sqrt(mass))) - 1


def blocks_speeds(mass: float, n_impacts: int, speed: float) -> tuple[float, float]:
    """Return the velocities of inner and outer block after the first impacts.

    Args:
        mass: Mass of the outer block over the mass of the inner block.
        n_impacts: Number of impacts. The first impact is between the blocks.
        speed: Initial speed of the outer block towards the wall. The inner block is at rest.
    """
    angle = 2.0 * math.ceil(n_impacts / 2) * math.atan(1.0 / math.sqrt(mass))
    inner = -math.sqrt(mass) * math.sin(angle) * speed
    return inner if n_impacts % 2 else -inner, -math.cos(angle) * speed


@dataclass(frozen=True, slots=True, kw_only=True)
class Chain:
    """A chain of masses over a wall.

    Attributes:
        mass: Masses, ``(n,)``.
        stiffness: Stiffness of the springs, ``(n,)``.
        place: Positions at which the springs are relaxed, ``(n,)``.
        damping: Of the dampers to the ground, ``(n,)``.
        amplitude: Of the forces, ``(n,)``.
        omega: Their frequency.
        restitution: Of the wall, then between neighbours, ``(n,)``.
        start: Initial positions and velocities, ``(2 n,)``.
    """

    mass: Any
    stiffness: Any
    place: Any
    damping: Any
    amplitude: Any
    omega: float
    restitution: Any
    start: Any

    @property
    def n(self) -> int:
        """Number of masses."""
        return len(self.mass)

    @property
    def is_conservative(self) -> bool:
        """True if nothing changes the energy."""
        still = not np.any(self.damping) and not np.any(self.amplitude)
        return still and bool(np.all(self.restitution == 1.0))

    def energy(self, x: Any) -> float:
        """Return the energy of a state."""
        q, v = x[: self.n], x[self.n : 2 * self.n]
        return float(self.mass @ v**2 + self.stiffness @ (q - self.place) ** 2) / 2

    def rate(self, time: float, x: Any) -> Any:
        """Return the rate of a state between impacts."""
        q, v = x[: self.n], x[self.n :]
        force = self.amplitude * math.cos(self.omega * time)
        force = force - self.stiffness * (q - self.place) - self.damping * v
        return np.concatenate([v, force / self.mass])

    def gap(self, k: int, x: Any) -> float:
        """Return the gap of a stop."""
        return float(x[k] - (x[k - 1] if k else 0.0))

    def struck(self, k: int, x: Any) -> Any:
        """Return the state after an impact: momentum is kept, except at the wall."""
        after, n, e = x.copy(), self.n, self.restitution[k]
        if k == 0:
            after[n] = -e * x[n]
            return after
        m, other = self.mass[k - 1], self.mass[k]
        pull = (1 + e) * (x[n + k] - x[n + k - 1]) * m * other / (m + other)
        after[n + k - 1] += pull / m
        after[n + k] -= pull / other
        return after

    def impacts(self, until: float, most: int, shortest: float) -> list[tuple[float, int]]:
        """Return time and stop of the first impacts, until a flight is short.

        Args:
            until: End time.
            most: Largest number of impacts.
            shortest: The list ends at an impact that follows another impact sooner.
        """
        found: list[tuple[float, int]] = []
        time, x, last = 0.0, self.start, -1
        while len(found) < most:
            events = [_Gap(self, k, time + _STARTED if k == last else -1.0) for k in range(self.n)]
            # SciPy calls functions, and reads whether they end the integration and in which way.
            solution = cast("Any", solve_ivp)(
                self.rate,
                (time, until),
                x,
                method="DOP853",
                rtol=_TOLERANCE,
                atol=_TOLERANCE,
                max_step=0.02,
                events=events,
            )
            hits = [(float(t[0]), k) for k, t in enumerate(solution.t_events) if len(t)]
            if not hits:
                break
            before = time
            time, last = min(hits)
            if found and time - before < shortest:
                break
            found.append((time, last))
            x = self.struck(last, solution.y_events[last][0])
        return found


@dataclass(frozen=True, slots=True)
class _Gap:
    """The gap of a stop, as an event of SciPy.

    Attributes:
        chain: The chain.
        stop: Index of the stop.
        since: The gap counts as open before this time.
    """

    chain: Chain
    stop: int
    since: float
    terminal: bool = True
    direction: float = -1.0

    def __call__(self, time: float, x: Any) -> float:
        return self.chain.gap(self.stop, x) if time > self.since else 1e-3


def chain(rng: np.random.Generator) -> Chain:
    """Return a chain with an elastic stop, drawn at random."""
    n = int(rng.integers(1, 4))
    restitution = np.where(rng.random(n) < 0.5, 1.0, rng.uniform(0.4, 0.95, n))
    restitution[rng.integers(n)] = 1.0
    kept = rng.random() < 0.4
    if kept:
        restitution[:] = 1.0
    place = 0.4 * (1 + np.arange(n)) + rng.uniform(-0.1, 0.1, n)
    return Chain(
        mass=rng.uniform(0.3, 3.0, n),
        stiffness=rng.uniform(1.0, 20.0, n),
        place=place,
        damping=np.zeros(n) if kept else rng.uniform(0.0, 0.3, n),
        amplitude=np.zeros(n) if kept else rng.uniform(0.0, 4.0, n),
        omega=float(rng.uniform(1.0, 6.0)),
        restitution=restitution,
        start=np.concatenate([place, rng.uniform(-3.0, 3.0, n)]),
    )
