"""A compass walker whose two legs are unlike, by its bodies and SciPy, as a recorded robot is.

The legs are rigid bodies with their own centre and inertia. The equations of motion and the plastic
heel strike follow from the Jacobians of the bodies and from constraints at the feet, without a
potential of the stance leg, a hand-made momentum balance or any code of the package.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Vector = NDArray[np.float64]
LENGTH, GRAVITY = 0.2778, 9.81


@dataclass(frozen=True, kw_only=True)
class Leg:
    """A leg: its mass [kg], distance from the hip to its centre [m], inertia about the hip."""

    mass: float = 0.7
    centre: float = 0.0475
    inertia: float = 0.0043466


@dataclass(frozen=True, kw_only=True)
class Walker:
    """A walker: both legs, inert and weighing mass of the hip, friction, and a controller."""

    legs: tuple[Leg, Leg] = (Leg(), Leg())
    hip: float = 2.0
    weight: float = -0.409
    viscous: float = 0.00156
    dry: float = 0.00611
    drop: float = 0.0
    gains: tuple[float, float, float] = (0.0327, -0.155, 0.512)

    def torque(self, hip: float, stance: float) -> float:
        """Return the torque of the controller [N m]."""
        push, by_hip, by_stance = self.gains
        return push + by_hip * hip + by_stance * stance


def _bodies(one: Walker, first: int, angles: Vector) -> list[tuple[Vector, float, float]]:
    """Return the Jacobian, mass and weighing mass of the hip and the centres of both legs.

    Args:
        one: The walker.
        first: Index of the stance leg.
        angles: Stance and swing leg from the vertical [rad].
    """
    turns = [np.array([np.cos(one), -np.sin(one)]) for one in angles]
    hip = np.zeros((2, 4))
    hip[:, :2] = np.eye(2)
    hip[:, 2] = LENGTH * turns[0]
    found = [(hip, one.hip, one.weight)]
    for k in range(2):
        leg, rows = one.legs[(first + k) % 2], hip.copy()
        rows[:, 2 + k] -= leg.centre * turns[k]
        found.append((rows, leg.mass, leg.mass))
    return found


def _mass(one: Walker, first: int, angles: Vector) -> Vector:
    """Return the mass matrix in the place of the stance foot and the angles of both legs."""
    found: Vector = np.zeros((4, 4))
    for rows, inert, _ in _bodies(one, first, angles):
        found += inert * rows.T @ rows
    for k in range(2):
        leg = one.legs[(first + k) % 2]
        found[2 + k, 2 + k] += leg.inertia - leg.mass * leg.centre**2
    return found


def accelerations(one: Walker, first: int, angles: Vector, rates: Vector) -> Vector:
    """Return the angular accelerations of stance and swing leg [rad/s^2]."""
    force, spin = np.zeros(2), rates**2
    downs = [np.array([-np.sin(a), -np.cos(a)]) for a in angles]
    for k, (rows, inert, weighs) in enumerate(_bodies(one, first, angles)):
        bend = LENGTH * downs[0] * spin[0]
        if k:
            bend = bend - one.legs[(first + k - 1) % 2].centre * downs[k - 1] * spin[k - 1]
        force += rows[:, 2:].T @ (np.array([0.0, -weighs * GRAVITY]) - inert * bend)
    hip_rate = rates[0] - rates[1]
    drive = one.torque(angles[0] - angles[1], angles[0]) - one.viscous * hip_rate
    drive -= (one.dry - one.drop * abs(hip_rate)) * np.tanh(hip_rate / 0.05)
    inverse = np.asarray(np.linalg.inv(_mass(one, first, angles)[2:, 2:]), dtype=np.float64)
    return inverse @ (force + float(drive) * np.array([1.0, -1.0]))


def after_strike(one: Walker, first: int, angles: Vector, rates: Vector) -> Vector:
    """Return the rates of the new stance leg and the new swing leg.

    The impulse at the swing foot stops that foot: ``M (v+ - v-) = J' f`` and ``J v+ = 0``.
    """
    turns = [np.array([np.cos(a), -np.sin(a)]) for a in angles]
    rows = np.zeros((2, 4))
    rows[:, :2] = np.eye(2)
    rows[:, 2], rows[:, 3] = LENGTH * turns[0], -LENGTH * turns[1]
    mass, before = _mass(one, first, angles), np.array([0.0, 0.0, *rates])
    whole = np.block([[mass, -rows.T], [rows, np.zeros((2, 2))]])
    after = np.linalg.solve(whole, np.concatenate([mass @ before, np.zeros(2)]))
    return np.array([after[3], after[2]], dtype=np.float64)


def walked(
    one: Walker, start: Vector, steps: int, rate: float, *, skipped: int = 0
) -> list[tuple[Vector, Vector]]:
    """Return the samples of each step: times since the first, and hip, stance and torque.

    Args:
        one: The walker.
        start: Angles of stance and swing leg, then their rates.
        steps: Number of steps.
        rate: Samples per second [Hz].
        skipped: Number of steps before the first one.
    """

    def flow(first: int, _: float, x: Vector) -> Vector:
        return np.concatenate([x[2:], accelerations(one, first, x[:2], x[2:])])

    def gap(_: float, x: Vector) -> float:
        return float(-x[0] - x[1]) if x[0] - x[1] > 0.05 else 1.0

    gap.terminal, gap.direction = True, -1.0  # pyright: ignore[reportFunctionMemberAccess]
    state, begin, found = np.array(start), 0.0, list[tuple[Vector, Vector]]()
    for step in range(skipped + steps):
        first = step % 2
        run: Any = solve_ivp(
            partial(flow, first),
            (begin, begin + 2.0),
            state,
            events=gap,
            dense_output=True,
            rtol=1e-9,
            atol=1e-11,
        )
        end = float(run.t_events[0][0])
        numbers: Vector = np.arange(
            math.ceil(begin * rate), math.ceil(end * rate), dtype=np.float64
        )
        times: Vector = numbers / rate
        rows: Vector = run.sol(times)
        hip = rows[0] - rows[1]
        torque = np.array([one.torque(a, b) for a, b in zip(hip, rows[0], strict=True)])
        found.append((times, np.stack([hip, rows[0], torque], axis=1)))
        last: Vector = run.y_events[0][0]
        state = np.concatenate([last[[1, 0]], after_strike(one, first, last[:2], last[2:])])
        begin = end
    return found[skipped:]
