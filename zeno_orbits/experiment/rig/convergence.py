r"""Distance of a machine from the Zeno orbit of its model, as a power of its stiffness.

A distance `d` over stiffnesses `k` is fitted by :math:`d = c\,k^{-p}`. Theory (53) expects
:math:`p = 1/(n+1)` for a contact force of power `n`: 1/2 for a spring, as contacts last that long.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.rig.cycles import RigCycle, SettledRig
from zeno_orbits.model import Problem
from zeno_orbits.orbits import ZenoOrbit
from zeno_orbits.simulation import simulate

_SAMPLES = 1500
"""Points on every arc of the orbit; the chords between them miss it by some 1e-6 of its size."""
_SIDE = 3e-4
"""Length of a side of that line, in states over their ranges, where it is sampled so finely."""
_POSTS = 8
"""Places on the line whose sides are tried for a point."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OrbitDistance:
    """Distances of a machine's cycle from the Zeno orbit of its model; differences are signed.

    Attributes:
        impact_time: First contact less first impact, from release [s].
        impact_rate: Gap rate at the first contact less that at the first impact.
        lock_time: End of the chatter less Zeno time, from release [s].
        lock_angle: The same difference of the coordinate whose amplitude the problem measures.
        release: Largest difference of a state at release, over the state's range on the orbit.
        period: Of the cycle less that of the orbit [s].
        portrait: Largest distance of a point of the cycle from the orbit's curve, resets included
            as straight lines, in states over their ranges.
    """

    impact_time: float
    impact_rate: float
    lock_time: float
    lock_angle: float
    release: float
    period: float
    portrait: float


@dataclass(frozen=True, slots=True, kw_only=True)
class OrbitCurve:
    """An orbit as a closed line in the space of its states.

    Attributes:
        times: Since release, ``(n,)`` [s].
        states: ``(n, n_x)``; straight lines between them.
        ranges: Of every state along it, ``(n_x,)``; 1 where it does not move.
    """

    times: Vector
    states: Vector
    ranges: Vector

    def distances(self, states: Vector) -> Vector:
        """Return the distance of points from the line, in states over their ranges, ``(m,)``.

        Args:
            states: The points, ``(m, n_x)``.
        """
        # SciPy's trees take longer to import than most of the package, and few ask for a distance.
        from scipy.spatial import cKDTree

        line, points = self.states / self.ranges, states / self.ranges
        sides = np.diff(line, axis=0)
        # Posts stand as closely on long sides, the resets, as on short ones, so that the nearest
        # posts stand on the nearest side, up to a part of the square of their spacing.
        counts = np.ceil(np.sqrt(np.sum(sides**2, axis=1)) / _SIDE).astype(np.intp).clip(1)
        owner = np.repeat(np.arange(len(sides)), counts)
        step = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
        posts = line[owner] + sides[owner] * ((step + 0.5) / counts[owner])[:, None]
        _, nearest = cKDTree(posts).query(points, k=min(_POSTS, len(posts)))
        every = owner[nearest].reshape(len(points), -1)
        squared = np.full(len(points), np.inf)
        for column in every.T:
            start, side = line[column], sides[column]
            length = np.maximum(np.sum(side**2, axis=1), 1e-300)
            part = np.clip(np.sum((points - start) * side, axis=1) / length, 0.0, 1.0)
            rest = points - start - part[:, None] * side
            squared = np.minimum(squared, np.sum(rest**2, axis=1))
        return np.sqrt(squared)


def orbit_curve(orbit: ZenoOrbit, problem: Problem, *, n_per_arc: int = _SAMPLES) -> OrbitCurve:
    """Return an orbit as a line, made by simulating one period of it.

    Args:
        orbit: The orbit.
        problem: Its problem.
        n_per_arc: Points on every arc.
    """
    dynamics = problem.dynamics(orbit.values(problem))
    start = problem.state_vector(orbit.release_state)
    times, states = simulate(dynamics, start, until=orbit.period).sampled(n_per_arc)
    spans = np.ptp(states, axis=0)
    ranges = np.where(spans > 0.0, spans, 1.0)
    kept = _thinned(states / ranges)
    return OrbitCurve(times=times[kept], states=states[kept], ranges=ranges)


def _thinned(line: Vector) -> NDArray[np.intp]:
    """Return which corners of a line to keep: ends of long sides, and others at even lengths."""
    sides = np.sqrt(np.sum(np.diff(line, axis=0) ** 2, axis=1))
    lengths = np.concatenate([[0.0], np.cumsum(sides)])
    _, even = np.unique(np.floor(lengths / _SIDE), return_index=True)
    long = np.flatnonzero(sides > _SIDE)
    return np.unique(np.concatenate([even, long, long + 1, [len(line) - 1]]))


def orbit_distance(
    orbit: ZenoOrbit, problem: Problem, curve: OrbitCurve, settled: SettledRig
) -> OrbitDistance:
    """Return how far the last cycle of a settled machine is from its orbit.

    Args:
        orbit: The orbit.
        problem: Its problem.
        curve: The orbit as a line.
        settled: The machine.
    """
    cycle = settled.cycles[-1]
    known, wanted = asdict(numbers_of_cycle(cycle, problem)), numbers_of_orbit(orbit, problem)
    released = np.array(problem.state_vector(orbit.release_state))
    moved = cycle.end_state[: len(released)] - released
    states = settled.run.between(cycle.release, cycle.end).states[:, : len(problem.state_names)]
    return OrbitDistance(
        **{name: known[name] - value for name, value in asdict(wanted).items()},
        release=float(np.max(np.abs(moved) / curve.ranges)),
        portrait=float(np.max(curve.distances(states))),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class CycleNumbers:
    """Characteristic numbers of a cycle, of a machine or of the orbit of its model.

    Attributes:
        impact_time: First contact, or first impact, from release [s].
        impact_rate: Gap rate there.
        lock_time: End of the chatter, or Zeno time, from release [s].
        lock_angle: Coordinate that the problem measures amplitudes of, there.
        period: [s].
    """

    impact_time: float
    impact_rate: float
    lock_time: float
    lock_angle: float
    period: float


def numbers_of_orbit(orbit: ZenoOrbit, problem: Problem) -> CycleNumbers:
    """Return what an orbit of the model is known by."""
    dynamics = problem.dynamics(orbit.values(problem))
    first = orbit.impacts[0]
    return CycleNumbers(
        impact_time=first.time,
        impact_rate=dynamics.gap_rate(np.array(problem.state_vector(first.state_minus))),
        lock_time=orbit.zeno_time,
        lock_angle=orbit.zeno_state[problem.amplitude_of],
        period=orbit.period,
    )


def numbers_of_cycle(cycle: RigCycle, problem: Problem) -> CycleNumbers:
    """Return what a cycle of a machine is known by."""
    return CycleNumbers(
        impact_time=cycle.impact.start - cycle.release,
        impact_rate=cycle.impact.approach_rate,
        lock_time=cycle.lock - cycle.release,
        lock_angle=float(cycle.lock_state[problem.state_names.index(problem.amplitude_of)]),
        period=cycle.period,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """A distance over stiffnesses, fitted by a power.

    Attributes:
        order: :math:`p`.
        error: Standard error of it.
        coefficient: :math:`c`.
        scatter: Root mean square of what is left of ``log d``.
    """

    order: float
    error: float
    coefficient: float
    scatter: float


def fit_order(stiffnesses: Sequence[float], distances: Sequence[float]) -> Order:
    r"""Fit :math:`|d| = c\,k^{-p}` by least squares of the logarithms.

    Args:
        stiffnesses: Three at least.
        distances: Not zero.

    Raises:
        ValueError: If there are too few, or one is zero.
    """
    k, d = np.log(np.asarray(stiffnesses)), np.abs(np.asarray(distances))
    if len(k) < 3 or len(k) != len(d):
        raise ValueError(
            "Argument `distances` must hold one for each of three or more stiffnesses."
        )
    if not np.all(d > 0.0):
        raise ValueError("Argument `distances` must not hold zero: it has no logarithm.")
    away, y = k - k.mean(), np.log(d)
    slope = float(away @ y / (away @ away))
    left = y - y.mean() - slope * away
    spread = float(left @ left)
    return Order(
        order=-slope,
        error=float(np.sqrt(spread / (len(k) - 2) / (away @ away))),
        coefficient=float(np.exp(y.mean() - slope * k.mean())),
        scatter=float(np.sqrt(spread / len(k))),
    )
