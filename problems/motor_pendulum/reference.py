r"""The motor pendulum once more, derived by hand and written with nothing but floats.

No symbolic algebra touches this file, so that it can check the model that is derived by machine.
With ``theta1`` from the downward vertical and ``theta2 >= 0`` the angle of link 2 relative to
link 1, the laws are

.. math::
    M &= \begin{pmatrix} A + B + 2 C \cos\theta_2 & B + C \cos\theta_2 \\ \cdot & B \end{pmatrix},
    \qquad \det M = A B - C^2 \cos^2\theta_2 \\
    r_1 &= K_\varphi\,\imath + C \sin\theta_2\,(2 \dot\theta_1 + \dot\theta_2)\,\dot\theta_2
        - g\,(D \sin\theta_1 + E \sin(\theta_1 + \theta_2)) \\
    r_2 &= -C \sin\theta_2\,\dot\theta_1^2 - g E \sin(\theta_1 + \theta_2) \\
    M\,(\ddot\theta_1, \ddot\theta_2) &= (r_1, r_2), \qquad
    L\,\dot\imath = -K_p \theta_1 - K_d \dot\theta_1 - R\,\imath - K_\omega \dot\theta_1

The state is ``x = (theta1, theta2, dtheta1, dtheta2, current)`` in [rad], [rad], [rad/s],
[rad/s], [A]. The gap is :math:`\theta_2`, so its Jacobian is ``(0, 1)``.
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
    """The pendulum at fixed numbers, in the letters of the module's laws.

    Attributes:
        A: Inertia of link 1, the rotor and link 2's mass at the knee, about the shoulder [kg m^2].
        B: Inertia of link 2 about the knee [kg m^2].
        C: Coupling ``m2 L1 lc2`` [kg m^2].
        D: First moment of link 1 and of link 2's mass at the knee, about the shoulder [kg m].
        E: First moment of link 2 about the knee [kg m].
        g: Gravity [m/s^2].
        torque_constant: Torque for one ampere [N m/A].
        emf_constant: Voltage for one radian a second [V s/rad].
        resistance: Of the motor circuit [ohm].
        inductance: Of the motor circuit [H].
        proportional: Gain ``Kp`` [V/rad].
        derivative: Gain ``Kd`` [V s/rad].
        restitution: Coefficient of restitution ``e`` of the stop.
    """

    A: float
    B: float
    C: float
    D: float
    E: float
    g: float
    torque_constant: float
    emf_constant: float
    resistance: float
    inductance: float
    proportional: float
    derivative: float
    restitution: float

    @property
    def delta(self) -> float:
        """Determinant of the mass matrix on the stop, ``A B - C^2`` [kg^2 m^4]."""
        return self.A * self.B - self.C**2

    def forces(self, x: Vector) -> tuple[float, float, float, float]:
        """Return ``M11``, ``M12`` [kg m^2] and the right-hand sides ``r1``, ``r2`` [N m]."""
        theta1, theta2, rate1, rate2, current = x.tolist()
        cosine, sine = math.cos(theta2), math.sin(theta2)
        pull1 = self.g * self.D * math.sin(theta1)
        pull2 = self.g * self.E * math.sin(theta1 + theta2)
        swirl = self.C * sine
        r1 = self.torque_constant * current + swirl * (2 * rate1 + rate2) * rate2 - pull1 - pull2
        r2 = -swirl * rate1**2 - pull2
        return self.A + self.B + 2 * self.C * cosine, self.B + self.C * cosine, r1, r2

    def determinant(self, x: Vector) -> float:
        r"""Return :math:`\det M = A B - C^2 \cos^2\theta_2` [kg^2 m^4]."""
        return self.A * self.B - (self.C * math.cos(x[1])) ** 2

    def current_rate(self, x: Vector) -> float:
        r"""Return :math:`\dot\imath` [A/s] under the PD voltage."""
        theta1, _, rate1, _, current = x.tolist()
        voltage = -self.proportional * theta1 - self.derivative * rate1
        return (voltage - self.resistance * current - self.emf_constant * rate1) / self.inductance

    def free_flow(self, x: Vector) -> Vector:
        r"""Return :math:`\dot x` off the stop, ``(5,)``, by the inverse of the 2 x 2 matrix.

        .. math:: \ddot\theta_1 = \frac{B r_1 - M_{12} r_2}{\det M}, \qquad
            \ddot\theta_2 = \frac{M_{11} r_2 - M_{12} r_1}{\det M}
        """
        m11, m12, r1, r2 = self.forces(x)
        determinant = m11 * self.B - m12**2
        return np.array(
            [
                x[2],
                x[3],
                (self.B * r1 - m12 * r2) / determinant,
                (m11 * r2 - m12 * r1) / determinant,
                self.current_rate(x),
            ]
        )

    def locked_flow(self, x: Vector) -> Vector:
        r"""Return :math:`\dot x` on the stop, ``(5,)``: the links turn as one.

        .. math:: \ddot\theta_1 = r_1 / M_{11}, \qquad \ddot\theta_2 = 0
        """
        m11, _, r1, _ = self.forces(x)
        return np.array([x[2], x[3], r1 / m11, 0.0, self.current_rate(x)])

    def gap_acceleration(self, x: Vector) -> float:
        r"""Return :math:`\ddot h = \ddot\theta_2` of the free flow [rad/s^2]."""
        m11, m12, r1, r2 = self.forces(x)
        return (m11 * r2 - m12 * r1) / (m11 * self.B - m12**2)

    def multiplier(self, x: Vector) -> float:
        r"""Return the torque of the stop that keeps :math:`\ddot\theta_2 = 0` [N m].

        With :math:`\ddot\theta_1 = r_1 / M_{11}` the second row reads

        .. math:: \lambda = \frac{M_{12}}{M_{11}}\,r_1 - r_2
        """
        m11, m12, r1, r2 = self.forces(x)
        return m12 / m11 * r1 - r2

    def multiplier_rate(self, x: Vector) -> float:
        r"""Return :math:`\dot\lambda` along the constrained flow [N m/s], for states on the stop.

        There :math:`\theta_2 = \dot\theta_2 = 0` and both stay so; the multiplier is

        .. math:: \lambda = \frac{B + C}{A + B + 2 C}
            \bigl(K_\varphi\,\imath - g (D + E) \sin\theta_1\bigr) + g E \sin\theta_1

        and its derivative only needs those of the current and of :math:`\theta_1`. Off the stop,
        or with :math:`\dot\theta_2 \ne 0`, the value means nothing.
        """
        share = (self.B + self.C) / (self.A + self.B + 2 * self.C)
        sine_rate = math.cos(x[0]) * float(x[2])
        turning = self.torque_constant * self.current_rate(x)
        turning -= self.g * (self.D + self.E) * sine_rate
        return share * turning + self.g * self.E * sine_rate

    def locked_guard(self, x: Vector) -> tuple[float, float]:
        """Return the multiplier and its rate on the stop."""
        return self.multiplier(x), self.multiplier_rate(x)

    def impulse_direction(self, x: Vector) -> Vector:
        r"""Return the change of state for a unit change of the gap rate, ``(5,)``.

        An impulse at the knee stop leaves :math:`M_{11} \dot\theta_1 + M_{12} \dot\theta_2` alone,
        so :math:`\dot\theta_1` changes by :math:`-M_{12} / M_{11}`.
        """
        cosine = math.cos(x[1])
        m11 = self.A + self.B + 2 * self.C * cosine
        m12 = self.B + self.C * cosine
        return np.array([0.0, 0.0, -m12 / m11, 1.0, 0.0])

    def normal_inertia(self, x: Vector) -> float:
        r"""Return the inertia that an impact feels, :math:`\det M / M_{11}` [kg m^2]."""
        return self.determinant(x) / (self.A + self.B + 2 * self.C * math.cos(x[1]))

    def reset_map(self, x: Vector, approach_rate: float) -> Vector:
        r"""Return the state after an impact, ``(5,)``.

        .. math:: \dot\theta_2^+ = -e\,\dot\theta_2^-, \qquad
            \dot\theta_1^+ = \dot\theta_1^- + (1 + e)\,\frac{M_{12}}{M_{11}}\,\dot\theta_2^-
        """
        return x - (1 + self.restitution) * approach_rate * self.impulse_direction(x)

    def energy(self, x: Vector) -> float:
        """Return kinetic, potential and magnetic energy [J]; zero height is at the shoulder."""
        theta1, theta2, rate1, rate2, current = x.tolist()
        cosine = math.cos(theta2)
        m11 = self.A + self.B + 2 * self.C * cosine
        m12 = self.B + self.C * cosine
        kinetic = (m11 * rate1**2 + 2 * m12 * rate1 * rate2 + self.B * rate2**2) / 2
        height = self.D * math.cos(theta1) + self.E * math.cos(theta1 + theta2)
        return kinetic - self.g * height + self.inductance * current**2 / 2


def pendulum(values: ParameterValues) -> Pendulum:
    """Return the pendulum at given numbers: lengths and masses gathered into the letters."""
    p, gains = values.parameters, values.gains
    return Pendulum(
        A=p["I1"] + p["m1"] * p["lc1"] ** 2 + p["m2"] * p["L1"] ** 2 + p["J_rotor"],
        B=p["I2"] + p["m2"] * p["lc2"] ** 2,
        C=p["m2"] * p["L1"] * p["lc2"],
        D=p["m1"] * p["lc1"] + p["m2"] * p["L1"],
        E=p["m2"] * p["lc2"],
        g=p["g"],
        torque_constant=p["K_torque"],
        emf_constant=p["K_emf"],
        resistance=p["R"],
        inductance=p["L"],
        proportional=gains["Kp"],
        derivative=gains["Kd"],
        restitution=p["restitution"],
    )


def dynamics(values: ParameterValues) -> HybridDynamics:
    """Return the hand-written pendulum as numeric functions of the state.

    ``multiplier_rate`` holds on the stop only, which is where a simulator asks for it.

    Args:
        values: Numbers for every gain and parameter of the problem.
    """
    machine = pendulum(values)
    return HybridDynamics(
        state_names=("theta1", "theta2", "dtheta1", "dtheta2", "current"),
        n_q=2,
        restitution=machine.restitution,
        speed_after=lambda rate: -machine.restitution * rate,
        free=PlainFlow(
            field=machine.free_flow, guard_and_rate=lambda x: (float(x[1]), float(x[3]))
        ),
        locked=PlainFlow(field=machine.locked_flow, guard_and_rate=machine.locked_guard),
        flight=plain_flight(machine.free_flow, machine.gap_acceleration),
        gap=lambda x: float(x[1]),
        gap_rate=lambda x: float(x[3]),
        gap_acceleration=machine.gap_acceleration,
        multiplier=machine.multiplier,
        multiplier_rate=machine.multiplier_rate,
        reset_map=machine.reset_map,
        impulse_direction=machine.impulse_direction,
        normal_inertia=machine.normal_inertia,
        energy=machine.energy,
        holonomic=lambda _: np.zeros(0),
    )
