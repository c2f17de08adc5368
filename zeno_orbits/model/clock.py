r"""Forcing: time acts on a mechanism through a point on the unit circle (theory (1.9)), or itself.

A forced problem is autonomous: its clock is the state :math:`(\cos\omega t, \sin\omega t)`. So an
orbit closes when the clock does, after a whole number of periods of the clock, and time need not be
wrapped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

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


def _new_time() -> ca.SX:
    return ca.SX.sym("time")


@dataclass(frozen=True, slots=True, kw_only=True)
class Time(Checked):
    r"""Time as one state that does not turn: a clock of transients.

    .. math:: \dot t = 1

    Steps, pulses, ramps and records at given times are formulas of it. A motion under it never
    repeats, so a search for periodic orbits and a map refuse it.

    Attributes:
        state: The time since the start of the clock [s], a new symbol by default.
    """

    state: ca.SX = field(default_factory=_new_time)

    @property
    def rate(self) -> ca.SX:
        """The time derivative of the state, 1."""
        return ca.SX(1)

    @property
    def off_circle(self) -> ca.SX:
        """No condition: every time is admissible, ``(0,)``."""
        return ca.SX(0, 1)
