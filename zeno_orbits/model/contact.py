r"""The stop: the five quantities that tell what happens at it, and the law of an impact.

This is the one place that knows how a state leaves the stop after it has struck it. The formulas
work on numbers of any kind: CasADi's symbols, floats, columns of many motions, numbers of 30
digits. Hand-written reference models and the residuals that check the law have their own.
"""

from __future__ import annotations

from typing import Any, NamedTuple

GAP, GAP_RATE, GAP_ACCELERATION, MULTIPLIER, MULTIPLIER_RATE = range(5)
"""Places of the contact quantities in a vector, or rows in its derivative."""


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
    r"""Newton's law of impact: the gap rate turns round, and keeps a part of its size.

    .. math:: \dot h^+ = -e\,\dot h^-,\qquad
        x^+ = x^- - (1 + e)\,\dot h^-\,d,\qquad d = \frac{W J^\top}{J W J^\top}

    Its fields are the numbers of the law. The first is the restitution of the slowest impacts,
    which alone decides how impacts accumulate (theory (15)).

    Attributes:
        restitution: :math:`e`.
    """

    restitution: Any

    @classmethod
    def of(cls, numbers: Any) -> ImpactLaw:
        """Return the law with the entries of a vector for its numbers, one a field."""
        return cls(*(numbers[k] for k in range(len(cls._fields))))

    def speed_after(self, approach_rate: Any) -> Any:
        """Return the gap rate just after an impact, from the one before it."""
        return -self.restitution * approach_rate

    def rate_drop(self, approach_rate: Any) -> Any:
        """Return the gap rate before an impact less the one after it."""
        return (1 + self.restitution) * approach_rate
