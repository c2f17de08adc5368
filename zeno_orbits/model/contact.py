r"""The stop: the five quantities that describe contact, and the impact law.

This is the only module that defines the state after an impact. The formulas accept values of any
kind: CasADi symbols, floats, columns of many motions, values with 30 digits. Hand-written reference
models and the residuals that check the law have separate formulas.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from zeno_orbits.errors import InputError

GAP, GAP_RATE, GAP_ACCELERATION, MULTIPLIER, MULTIPLIER_RATE = range(5)
"""Indices of the contact quantities in a vector, or rows in its derivative."""


class ContactQuantities(NamedTuple):
    r"""The five quantities by which a state flies, strikes, rests on its stop or leaves it.

    Attributes:
        gap: :math:`h`.
        gap_rate: :math:`\dot h`.
        gap_acceleration: :math:`\ddot h` of the free flow.
        multiplier: :math:`\lambda`, which keeps :math:`\ddot h = 0` on the stop.
        multiplier_rate: :math:`\dot\lambda` along the locked flow.
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

    Its fields are the parameters of the law. The first field is the restitution of the slowest
    impacts, which alone determines how impacts accumulate (theory (2.7)).

    Attributes:
        restitution: :math:`e`.
    """

    restitution: Any

    @classmethod
    def of(cls, numbers: Any) -> ImpactLaw:
        """Return the law with the entries of a vector as its parameters, one per field."""
        return cls(*(numbers[k] for k in range(len(cls._fields))))

    def speed_after(self, approach_rate: Any) -> Any:
        """Return the gap rate just after an impact, from the gap rate before it."""
        return -self.restitution * approach_rate

    def rate_drop(self, approach_rate: Any) -> Any:
        """Return the gap rate before an impact minus the gap rate after it."""
        return (1 + self.restitution) * approach_rate


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
