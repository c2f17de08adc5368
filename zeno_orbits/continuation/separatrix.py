r"""Impacts that accumulate exactly at the release: the self-similar sequence.

Let the acceleration towards the stop fall to zero at :math:`t = 0`, :math:`\ddot h = b t`. In units
in which an impact is at :math:`t = -1` and :math:`b = 1`, a flight that starts at the speed
:math:`r` lasts :math:`s` with :math:`r = s/2 - s^2/6`, and the next impact has

.. math:: r' = \frac{e\,(s/2 - s^2/3)}{(1 - s)^2}, \qquad r = \frac{w\,b}{a^2}.

The fixed point :math:`r_*` separates sequences that accumulate before :math:`t = 0` from sequences
that do not. It is unstable: per impact, a distance from it grows by a factor :math:`\kappa`, while
the remaining time shrinks by :math:`\sigma = 1 - s`. Theory (5.7).
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Separatrix:
    r"""The self-similar sequence at a coefficient of restitution.

    Attributes:
        ratio: :math:`r_*`, the speed after an impact times the rate at which the acceleration
            decreases, divided by the square of the acceleration.
        shrinking: :math:`\sigma`, the factor of the remaining time per impact.
        repulsion: :math:`\kappa`, the factor of a distance from the ratio per impact.
    """

    ratio: float
    shrinking: float
    repulsion: float

    @property
    def exponent(self) -> float:
        r"""Power of the distance to the end with which a contact phase vanishes.

        .. math:: \alpha = \frac{\ln 1/\sigma}{\ln \kappa}

        It is 1 for :math:`e \to 0` and 3/5 for :math:`e \to 1`.
        """
        return -math.log(self.shrinking) / math.log(self.repulsion)


def separatrix(restitution: float) -> Separatrix:
    r"""Return the self-similar sequence: :math:`e (1/2 - s/3) = (1/2 - s/6)(1 - s)^2`.

    Args:
        restitution: Coefficient of restitution, :math:`0 < e < 1`.
    """
    e = restitution
    # k = 1 - s avoids cancellation near s = 1: e (1 + 2k) = (2 + k) k^2.
    low, high = 0.0, 1.0
    for _ in range(200):
        k = (low + high) / 2
        low, high = (low, k) if (2 + k) * k**2 > e * (1 + 2 * k) else (k, high)
    k = (low + high) / 2
    s = 1 - k
    slope_next = e * ((1 / 2 - 2 * s / 3) / k**2 + 2 * (s / 2 - s**2 / 3) / k**3)
    return Separatrix(ratio=s / 2 - s**2 / 6, shrinking=k, repulsion=slope_next / (1 / 2 - s / 3))
