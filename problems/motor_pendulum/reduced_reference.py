r"""The motor pendulum without current states, derived by hand and written with nothing but floats.

One file for both reduced models: the corrected one has an inductance `L`, the quasi-static one has
none, which is ``L = 0``. In the letters of ``reference.py``, with the motor's voltage put in,

.. math::
    \bar\imath = -\frac{K_p \theta_1 + (K_d + K_\omega)\,\dot\theta_1}{R}, \qquad
    \imath = \bar\imath - \frac{L}{R}\,\frac{d\bar\imath}{dt}
    = \bar\imath + \frac{L}{R^2}\bigl(K_p \dot\theta_1 + (K_d + K_\omega)\,\ddot\theta_1\bigr)

and the last term on the left side of the equation of motion is an inertia of the rotor:

.. math::
    A \to A - K_\varphi (K_d + K_\omega)\,\frac{L}{R^2}, \qquad
    K_d \to K_d - K_p\,\frac{L}{R}, \qquad
    1 + e \to (1 + e)\,\frac{1/\tilde m_n}{1/m_n}

The state is ``x = (theta1, theta2, dtheta1, dtheta2)`` in [rad] and [rad/s].
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators.flow import PlainFlow
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics, plain_flight

if TYPE_CHECKING:
    from zeno_orbits.model.problem import ParameterValues


@dataclass(frozen=True, slots=True, kw_only=True)
class Pendulum:
    """The reduced pendulum at fixed numbers.

    Attributes:
        A: Inertia about the shoulder with the one that the inductance adds [kg m^2].
        B: Inertia of link 2 about the knee [kg m^2].
        C: Coupling ``m2 L1 lc2`` [kg m^2].
        D: First moment of link 1 and of link 2's mass at the knee, about the shoulder [kg m].
        E: First moment of link 2 about the knee [kg m].
        g: Gravity [m/s^2].
        stiffness: Motor torque for one radian of link 1, turned round [N m/rad].
        damping: Motor torque for one radian a second, turned round [N m s/rad].
        restitution: Of the stop and the current layer together.
    """

    A: float
    B: float
    C: float
    D: float
    E: float
    g: float
    stiffness: float
    damping: float
    restitution: float

    def inertias(self, x: Vector) -> tuple[float, float, float]:
        """Return ``M11``, ``M12`` and the determinant of the mass matrix."""
        swing = self.C * math.cos(x[1])
        m11, m12 = self.A + self.B + 2 * swing, self.B + swing
        return m11, m12, m11 * self.B - m12**2

    def forces(self, x: Vector) -> tuple[float, float]:
        """Return the right-hand sides of both rows [N m]."""
        theta1, theta2, rate1, rate2 = x.tolist()
        torque = -self.stiffness * theta1 - self.damping * rate1
        swirl = self.C * math.sin(theta2)
        pull2 = self.g * self.E * math.sin(theta1 + theta2)
        r1 = torque + swirl * (2 * rate1 + rate2) * rate2
        return r1 - self.g * self.D * math.sin(theta1) - pull2, -swirl * rate1**2 - pull2

    def free_flow(self, x: Vector) -> Vector:
        """Return the state's rate off the stop, ``(4,)``."""
        m11, m12, determinant = self.inertias(x)
        r1, r2 = self.forces(x)
        first = (self.B * r1 - m12 * r2) / determinant
        return np.array([x[2], x[3], first, (m11 * r2 - m12 * r1) / determinant])

    def locked_flow(self, x: Vector) -> Vector:
        """Return the state's rate on the stop, ``(4,)``: the links turn as one."""
        return np.array([x[2], x[3], self.forces(x)[0] / self.inertias(x)[0], 0.0])

    def gap_acceleration(self, x: Vector) -> float:
        """Return the second derivative of ``theta2`` off the stop [rad/s^2]."""
        return float(self.free_flow(x)[3])

    def multiplier(self, x: Vector) -> float:
        """Return the torque of the stop that keeps link 2 on it [N m]."""
        m11, m12, _ = self.inertias(x)
        r1, r2 = self.forces(x)
        return m12 / m11 * r1 - r2

    def multiplier_rate(self, x: Vector) -> float:
        """Return the multiplier's rate along the constrained flow [N m/s], for contact states."""
        m11, m12, _ = self.inertias(x)
        theta1, rate1 = float(x[0]), float(x[2])
        fall = self.g * math.cos(theta1) * rate1
        torque_rate = -self.stiffness * rate1 - self.damping * float(self.locked_flow(x)[2])
        return m12 / m11 * (torque_rate - (self.D + self.E) * fall) + self.E * fall

    def impulse_direction(self, x: Vector) -> Vector:
        """Return the change of state for a unit change of the gap rate, ``(4,)``."""
        m11, m12, _ = self.inertias(x)
        return np.array([0.0, 0.0, -m12 / m11, 1.0])

    def normal_inertia(self, x: Vector) -> float:
        """Return the inertia that an impact feels, layer included [kg m^2]."""
        m11, _, determinant = self.inertias(x)
        return determinant / m11

    def energy(self, x: Vector) -> float:
        """Return kinetic and potential energy [J]; zero height is at the shoulder."""
        theta1, theta2, rate1, rate2 = x.tolist()
        m11, m12, _ = self.inertias(x)
        kinetic = (m11 * rate1**2 + 2 * m12 * rate1 * rate2 + self.B * rate2**2) / 2
        return kinetic - self.g * (self.D * math.cos(theta1) + self.E * math.cos(theta1 + theta2))


def pendulum(values: ParameterValues) -> Pendulum:
    """Return the reduced pendulum at given numbers, its inductance folded in."""
    p, kp, kd = values.parameters, values.gains["Kp"], values.gains["Kd"]
    inductance = p.get("L", 0.0)
    bare = p["I1"] + p["m1"] * p["lc1"] ** 2 + p["m2"] * p["L1"] ** 2 + p["J_rotor"]
    heavy = bare - p["K_torque"] * (kd + p["K_emf"]) * inductance / p["R"] ** 2
    b, c = p["I2"] + p["m2"] * p["lc2"] ** 2, p["m2"] * p["L1"] * p["lc2"]

    def response(a: float) -> float:
        return (a + b + 2 * c) / (a * b - c**2)

    together = (1 + p["restitution"]) * response(heavy) / response(bare) - 1
    return Pendulum(
        A=heavy,
        B=b,
        C=c,
        D=p["m1"] * p["lc1"] + p["m2"] * p["L1"],
        E=p["m2"] * p["lc2"],
        g=p["g"],
        stiffness=p["K_torque"] * kp / p["R"],
        damping=p["K_torque"] * (kd - kp * inductance / p["R"] + p["K_emf"]) / p["R"],
        restitution=max(together, 0.0),
    )


def dynamics(values: ParameterValues) -> HybridDynamics:
    """Return the hand-written reduced pendulum as numeric functions of the state.

    Args:
        values: Numbers for every gain and parameter of the reduced problem.
    """
    machine = pendulum(values)
    return HybridDynamics(
        state_names=("theta1", "theta2", "dtheta1", "dtheta2"),
        n_q=2,
        restitution=machine.restitution,
        speed_after=lambda rate: -machine.restitution * rate,
        free=PlainFlow(
            field=machine.free_flow, guard_and_rate=lambda x: (float(x[1]), float(x[3]))
        ),
        locked=PlainFlow(
            field=machine.locked_flow,
            guard_and_rate=lambda x: (machine.multiplier(x), machine.multiplier_rate(x)),
        ),
        flight=plain_flight(machine.free_flow, machine.gap_acceleration),
        gap=lambda x: float(x[1]),
        gap_rate=lambda x: float(x[3]),
        gap_acceleration=machine.gap_acceleration,
        multiplier=machine.multiplier,
        multiplier_rate=machine.multiplier_rate,
        reset_map=lambda x, rate: (
            x - (1 + machine.restitution) * rate * machine.impulse_direction(x)
        ),
        impulse_direction=machine.impulse_direction,
        normal_inertia=machine.normal_inertia,
        energy=machine.energy,
        holonomic=lambda _: np.zeros(0),
    )
