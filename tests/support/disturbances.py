"""Pushes and recoveries made by hand: no two of their values are equal."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping, Sequence

import numpy as np

from zeno_orbits.maps import Push, Pushes, PushSettings, Recovery, RecoverySettings
from zeno_orbits.model import Problem
from zeno_orbits.orbits import Orbit


def pushes_of(
    orbit: Orbit,
    *,
    seed: int = 0,
    phases: int = 5,
    directions: Sequence[Mapping[str, float]] = ({"theta1": 1.0}, {"theta2": 1.0}),
    lost: float = 0.7,
) -> Pushes:
    """Return random pushes of an orbit of the pendulum.

    Args:
        orbit: The orbit.
        seed: Seed of the values.
        phases: Number of phases.
        directions: Directions in their positive sense.
        lost: Part of the pushes with a loss.
    """
    drawn = random.Random(seed)
    found: list[Push] = []
    for direction in directions:
        for k in range(phases):
            for sense in (1.0, -1.0):
                searched = drawn.uniform(0.5, 1.0)
                loses = drawn.random() < lost
                largest = drawn.uniform(0.01, 0.4)
                found.append(
                    Push(
                        phase=k / phases,
                        direction={name: sense * entry for name, entry in direction.items()},
                        mode="locked" if k in (0, phases - 1) else "free",
                        largest=largest if loses else math.nan,
                        error=1e-3 * largest if loses else math.nan,
                        beyond=f"motion {len(found)}" if loses else "",
                        searched=searched,
                        unit="N m s",
                    )
                )
    return Pushes(
        problem=orbit.problem,
        gains=dict(orbit.gains),
        parameters=dict(orbit.parameters),
        period=orbit.period,
        spectral_radius=0.125,
        settings=PushSettings(phases=phases, steps=7, reach=1.5, error=1e-3, until=77.5),
        until=77.5,
        pushes=tuple(found),
        versions={"numpy": "1.2"},
    )


def recovery_of(orbit: Orbit, problem: Problem, *, radius: float = 0.25, size: int = 2) -> Recovery:
    """Return a recovery with two section coordinates, or with the given number of them.

    Args:
        orbit: The orbit.
        problem: Its problem.
        radius: Radius of the ball.
        size: Number of section coordinates.
    """
    states = problem.state_names
    directions = np.zeros((len(states), size))
    for k in range(size):
        directions[2 * k, k] = 1.0 + k
    norm = np.array([[2.0, 0.5], [0.5, 3.0]])[:size, :size]
    # The largest of `d y` with `y M y = r^2` is `r (d M^-1 d)^(1/2)`.
    widths = np.sqrt(np.sum(directions @ np.linalg.inv(norm) * directions, axis=1))
    return Recovery(
        problem=orbit.problem,
        gains=dict(orbit.gains),
        parameters=dict(orbit.parameters),
        period=orbit.period,
        spectral_radius=0.375,
        contraction=0.4375,
        periods=6,
        norm=norm,
        directions=directions,
        radius=radius,
        extents={
            name: radius * float(width) if width > 0.0 else 0.0
            for name, width in zip(states, widths, strict=True)
        },
        units=dict(zip(states, problem.state_units, strict=True)),
        tests=2,
        settings=RecoverySettings(part=0.02, samples=130, confidence=0.9, error=0.05, seed=3),
        versions={"numpy": "1.2"},
    )
