r"""The stop: the five quantities that describe contact, and the impact law.

This is the only module that defines the state after an impact. The formulas accept values of any
kind: CasADi symbols, floats, columns of many motions, values with 30 digits. Hand-written reference
models and the residuals that check the law have separate formulas.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import casadi as ca

from zeno_orbits.errors import InputError

impact_speed = ca.SX.sym("impact_speed")
r"""Speed at which an impact closes its gap, :math:`-\dot h^- \ge 0`, in formulas of a restitution.

Its unit is that of the gap per second.
"""

SLOWEST = 2.0**-332
"""Speed at which the limit of a restitution at speed zero is taken.

At zero itself a power has no derivative, and a power of two does not round.
"""

_SPEEDS = (1e-6, 1e-3, 0.75, 1.5, 3.0)
"""Speeds at which two laws of impact are compared, of small and of large machines."""

GAP, GAP_RATE, GAP_ACCELERATION, MULTIPLIER, MULTIPLIER_RATE = range(5)
"""Indices of the contact quantities in a vector, or rows in its derivative."""


class ContactQuantities(NamedTuple):
    r"""The five quantities by which a state flies, strikes, rests on its stop or leaves it.

    Attributes:
        gap: :math:`h`.
        gap_rate: :math:`\dot h`.
        gap_acceleration: :math:`\ddot h` of the free flow.
        multiplier: :math:`\lambda`, which keeps :math:`\ddot h = 0` on the stop.
        multiplier_rate: :math:`\dot\lambda` along the constrained flow.
    """

    gap: Any
    gap_rate: Any
    gap_acceleration: Any
    multiplier: Any
    multiplier_rate: Any

    @classmethod
    def of(cls, entries: Any) -> ContactQuantities:
        """Return the entries of a vector, ``(5,)``, by their names."""
        return cls(*(entries[k] for k in range(5)))


class ImpactLaw(NamedTuple):
    r"""Newton's impact law: an impact multiplies the gap rate by minus the restitution.

    .. math:: \dot h^+ = -e\,\dot h^-,\qquad
        x^+ = x^- - (1 + e)\,\dot h^-\,d,\qquad d = \frac{W J^\top}{J W J^\top}

    The restitution may depend on the speed, :math:`e(-\dot h^-)`. The restitution of the slowest
    impacts alone determines how impacts accumulate (theory (2.7)).

    Attributes:
        restitution: :math:`e`, at speed zero if it depends on the speed.
        of_speed: Function from the speed of an impact to :math:`e`, if it depends on the speed.
    """

    restitution: Any
    of_speed: Callable[[Any], Any] | None = None

    @classmethod
    def of_formula(cls, formula: Any) -> ImpactLaw:
        """Return the law of a formula of parameters and `impact_speed`."""
        whole = ca.SX(formula)
        if not ca.depends_on(whole, impact_speed):
            return cls(whole)
        return cls(at_impact_speed(whole, SLOWEST), partial(at_impact_speed, whole))

    @property
    def numbers(self) -> ca.SX:
        """The restitution of the slowest impacts, and at fixed speeds if it depends on the speed.

        The latter tell laws apart. They are finite, also where a law does not apply.
        """
        slowest = ca.SX(self.restitution)
        if self.of_speed is None:
            return slowest
        others = [ca.SX(self.at(speed)) for speed in _SPEEDS]
        return ca.vertcat(slowest, *(ca.fmax(one / (1 + ca.fabs(one)), -1) for one in others))

    def at(self, speed: Any) -> Any:
        """Return the restitution of impacts at a speed."""
        return self.restitution if self.of_speed is None else self.of_speed(speed)

    def speed_after(self, approach_rate: Any) -> Any:
        """Return the gap rate just after an impact, from the gap rate before it."""
        return -self.at(-approach_rate) * approach_rate

    def rate_drop(self, approach_rate: Any) -> Any:
        """Return the gap rate before an impact minus the gap rate after it."""
        return (1 + self.at(-approach_rate)) * approach_rate


def at_impact_speed(formula: Any, speed: Any) -> ca.SX:
    """Return a formula at a speed of the impact.

    Args:
        formula: A formula of parameters and `impact_speed`.
        speed: The speed, a number or a formula.
    """
    return ca.substitute(ca.SX(formula), impact_speed, ca.SX(speed))


def require_zeno_points(restitution: float, stop: str = "") -> None:
    """Refuse elastic impacts, for what needs a Zeno point.

    At ``e = 1`` every impact keeps its speed, so impacts do not accumulate (theory (2.7)).

    Args:
        restitution: :math:`e` at fixed parameter values.
        stop: Name of the stop, for machines with several stops.

    Raises:
        InputError: If the restitution is 1.
    """
    if restitution == 1.0:
        at = f" at the stop `{stop}`" if stop else ""
        raise InputError(
            f"Argument `restitution` must be less than 1 for a Zeno point, but it is 1{at}: "
            "elastic impacts do not accumulate."
        )
