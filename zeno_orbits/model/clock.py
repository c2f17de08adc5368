r"""Periodic forcing: time acts on a mechanism through a point on the unit circle (theory (1.9)).

A forced problem is autonomous: its clock is the state :math:`(\cos\omega t, \sin\omega t)`. So an
orbit closes when the clock does, after a whole number of periods of the clock, and time need not be
wrapped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca

from zeno_orbits.errors import InputError
from zeno_orbits.work import Checked, checked


@dataclass(frozen=True, slots=True, kw_only=True)
class Clock(Checked):
    r"""The phase of a periodic forcing, as two states that turn at a constant rate.

    .. math:: \dot c = -\omega s,\qquad \dot s = \omega c,\qquad c^2 + s^2 = 1

    Attributes:
        cosine: :math:`c`, 1 at the start of a turn.
        sine: :math:`s`.
        frequency: :math:`\omega` [rad/s].
    """

    cosine: ca.SX
    sine: ca.SX
    frequency: ca.SX

    @classmethod
    @checked
    def at(cls, frequency: ca.SX) -> Clock:
        r"""Return a clock that turns at a constant rate, its states new symbols.

        Args:
            frequency: :math:`\omega` [rad/s], a parameter of the problem.

        Raises:
            InputError: If the frequency is a number that is not positive.
        """
        rate = ca.SX(frequency)
        if rate.is_constant() and rate.is_scalar() and float(rate) <= 0.0:
            raise InputError(f"Argument `frequency` must be positive, but it is {float(rate):g}.")
        return cls(cosine=ca.SX.sym("cosine"), sine=ca.SX.sym("sine"), frequency=ca.SX(frequency))

    @property
    def state(self) -> ca.SX:
        """The two states, ``(2,)``."""
        return ca.vertcat(self.cosine, self.sine)

    @property
    def rate(self) -> ca.SX:
        """Their time derivatives, ``(2,)`` [1/s]."""
        return self.frequency * ca.vertcat(-self.sine, self.cosine)

    @property
    def period(self) -> ca.SX:
        r"""Time of a turn, :math:`2\pi/\omega` [s]."""
        return 2 * math.pi / self.frequency

    @property
    def off_circle(self) -> ca.SX:
        """Zero on admissible states. The flow preserves it."""
        return (self.cosine**2 + self.sine**2 - 1) / 2
