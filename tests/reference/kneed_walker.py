r"""The kneed walker of McGeer and Hsu Chen, in NumPy: point feet, a straight stance leg, one knee.

Angles from the vertical: stance leg, swing thigh, swing shank. The position of a mass is a sum of
``c_j (-sin q_j, cos q_j)``, so ``M_jk = sum m c_j c_k cos(q_j - q_k)``. The knee stop is
``q_2 >= q_3``. At heel strike the foot of the straight swing leg stops, both knees are rigid, and
the legs exchange names.

The published state just after heel strike and the period are those of the gait at restitution 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from tests.reference.event_loop import Contact, Machine, Reset

GRAVITY, SLOPE = 9.8, math.asin(7.25 / 144)
LENGTH, SHANK, THIGH = 1.0, 0.375, 0.675
"""Length of a leg, and distances of the masses from the foot."""
SHANK_MASS, THIGH_MASS, HIP_MASS = 0.05, 0.5, 0.5
KNEE = 0.5
AHEAD = 0.02

START = (0.18816565351, -0.28890268731, -1.10894729114, -0.05771782658)
"""Published angles of stance leg and straight swing leg just after heel strike, and rates."""
PERIOD, KNEE_TIME, KNEE_RATE = 0.56457806957, 0.34881592073, -7.711117507

_MASSES = (SHANK_MASS, THIGH_MASS, HIP_MASS, THIGH_MASS, SHANK_MASS)
_ARMS = np.array(
    [
        (SHANK, 0.0, 0.0),
        (THIGH, 0.0, 0.0),
        (LENGTH, 0.0, 0.0),
        (LENGTH, -(LENGTH - THIGH), 0.0),
        (LENGTH, -KNEE, -(KNEE - SHANK)),
    ]
)
"""Coefficients ``c`` of the masses."""
_WEIGHTS = np.einsum("m,mj,mk->jk", _MASSES, _ARMS, _ARMS)
_PULL = GRAVITY * np.array(_MASSES) @ _ARMS


def _direction(angle: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the unit vector of an angle and its derivative."""
    sine, cosine = math.sin(angle), math.cos(angle)
    return np.array([-sine, cosine]), np.array([-cosine, -sine])


def _mass(q: np.ndarray) -> np.ndarray:
    return _WEIGHTS * np.cos(q[:, None] - q[None, :])


def _force(_t: float, q: np.ndarray, v: np.ndarray, *_: object) -> np.ndarray:
    turning = (_WEIGHTS * np.sin(q[:, None] - q[None, :])) @ v**2
    return -turning + _PULL * np.sin(q)


def heel_strike(stance: float, swing: float, rates: tuple[float, float]) -> tuple[float, float]:
    """Return the rates of both straight legs after the foot of the swing leg stops.

    Body of the hip's position and both angles, ``(x, y, stance, swing)``: the foot that strikes is
    at ``hip - L (-sin, cos)`` of the swing leg, and the other one is free.
    """
    M = np.zeros((4, 4))
    down = [(SHANK_MASS, LENGTH - SHANK), (THIGH_MASS, LENGTH - THIGH)]
    for leg, angle in ((2, stance), (3, swing)):
        for mass, arm in down:
            J = np.zeros((2, 4))
            J[:, :2] = np.eye(2)
            J[:, leg] = -arm * _direction(angle)[1]
            M += mass * J.T @ J
    M[:2, :2] += HIP_MASS * np.eye(2)
    hip_rate = LENGTH * _direction(stance)[1] * rates[0]
    before = np.array([*hip_rate, *rates])
    J = np.zeros((2, 4))
    J[:, :2] = np.eye(2)
    J[:, 3] = -LENGTH * _direction(swing)[1]
    response = np.linalg.solve(M, J.T)
    after = before - response @ np.linalg.solve(J @ response, J @ before)
    return float(after[2]), float(after[3])


def _exchanged(
    _t: float, q: np.ndarray, v: np.ndarray, z: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    old, new = heel_strike(q[0], q[1], (v[0], v[1]))
    return np.array([q[1], q[0], q[0]]), np.array([new, old, old]), z


Drive = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, float]]
"""Torques of motors on the three angles, and their electrical power, of angles and rates."""


def _undriven(_q: np.ndarray, _v: np.ndarray) -> tuple[np.ndarray, float]:
    return np.zeros(3), 0.0


def motors(q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, float]:
    """Return torques and electrical power of the motors of `powered_walker`, at its own gains."""
    torque_constant, resistance = 1.0, 2.0
    hip, hip_rate = q[1] - q[0], v[1] - v[0]
    knee, knee_rate = q[1] - q[2], v[1] - v[2]
    hip_voltage = 5.0 * (0.42 - hip) + 0.2 * hip_rate
    knee_voltage = -1.5 * (knee + 1.6 * hip) + 0.8 * knee_rate
    hip_current = (hip_voltage - torque_constant * hip_rate) / resistance
    knee_current = (knee_voltage - torque_constant * knee_rate) / resistance
    on_hip, on_knee = torque_constant * hip_current, torque_constant * knee_current
    torques = np.array([-on_hip, on_hip + on_knee, -on_knee])
    return torques, hip_voltage * hip_current + knee_voltage * knee_current


def walker(restitution: float, *, slope: float = SLOPE, drive: Drive = _undriven) -> Machine:
    """Return the walker with a restitution of the knee stop. Its further state is the energy in."""
    return Machine(
        n=3,
        mass=_mass,
        force=lambda t, q, v, _z, _: _force(t, q, v) + drive(q, v)[0],
        rate=lambda _t, q, v, z, _: np.full(len(z), drive(q, v)[1]),
        contacts=(
            Contact(
                name="knee",
                gap=lambda q: q[1] - q[2],
                normal=lambda _q: np.array([0.0, 1.0, -1.0]),
                restitution=restitution,
            ),
        ),
        resets=(
            Reset(
                name="heel strike",
                guard=lambda _t, q, _v, _z: q[0] + q[1] + 2 * slope,
                armed=lambda _t, q, _v, _z: q[1] + slope - AHEAD,
                after=_exchanged,
            ),
        ),
        scale=0.05,
    )


def start() -> tuple[float, ...]:
    """Return the published state just after heel strike."""
    stance, swing, stance_rate, swing_rate = START
    return stance, swing, swing, stance_rate, swing_rate, swing_rate
