r"""Damping of a compliant contact for a given restitution, exactly (theory (6.2)).

With :math:`g(z) = z - \ln(1 + z)` and the damping number :math:`u = \alpha v`, a contact that
begins at the speed `v` ends at :math:`e v` where

.. math:: g(u) = g(-e u),

for any stiffness, exponent and normal inertia. Source: [HuntCrossley1975]_ for the force. The
relation is theory (6.2).
"""

from __future__ import annotations

import math
from collections.abc import Callable

from zeno_orbits.errors import InputError


def damping_number(restitution: float) -> float:
    r"""Return :math:`u`, the damping factor times the approach speed, of a restitution.

    It falls from infinity at ``e = 0``, where it is about :math:`1/e`, to zero at ``e = 1``, where
    it is about :math:`\tfrac32 (1 - e)`. Its error is at the level of rounding over ``1 - e``.

    Args:
        restitution: :math:`e` in [0, 1].

    Raises:
        InputError: If the restitution is outside [0, 1].
    """
    e = restitution
    if not 0.0 <= e <= 1.0:
        raise InputError(f"Argument `restitution` must lie in [0, 1], but it is {e:g}.")
    if e == 0.0:
        return math.inf
    if e == 1.0:
        return 0.0

    def missing(depth: float) -> float:
        # With e u = 1 - exp(-depth) the logarithm of 1 - e u is exact, however small that is.
        return _excess(-math.expm1(-depth) / e) - _returned(depth)

    # The root at zero is excluded: it is the trivial solution without motion.
    lowest = -math.log1p(-0.5 * min(e * (1.0 - e), 0.5))
    depth = _root(missing, lowest, 4.0 / e + 4.0)
    return -math.expm1(-depth) / e


def effective_restitution(number: float) -> float:
    """Return the restitution of a damping number, the inverse of `damping_number`.

    Args:
        number: Damping number :math:`u`, at least 0. It may be infinite.

    Raises:
        InputError: If the damping number is negative or NaN.
    """
    if not number >= 0.0:
        raise InputError(f"Argument `number` must be at least 0, but it is {number:g}.")
    if number == 0.0:
        return 1.0
    if math.isinf(number):
        return 0.0
    wanted = _excess(number)
    depth = _root(lambda d: wanted - _returned(d), 0.0, wanted + 2.0)
    return -math.expm1(-depth) / number


def _excess(z: float) -> float:
    """Return ``z - log(1 + z)``, to relative rounding."""
    if abs(z) > 0.05:
        return z - math.log1p(z)
    return math.fsum((-z) ** k / k for k in range(2, 16))


def _returned(depth: float) -> float:
    """Return the same at ``z = exp(-depth) - 1``."""
    if depth > 0.05:
        return depth + math.expm1(-depth)
    return _excess(math.expm1(-depth))


def _root(function: Callable[[float], float], left: float, right: float) -> float:
    """Return the point at which a function changes from positive to negative, to rounding."""
    from scipy.optimize import brentq

    return float(brentq(function, left, right, xtol=1e-300, rtol=4 * 2.0**-52, maxiter=500))
