r"""The first root of a polynomial on an interval, isolated without samples.

In Bernstein's basis on ``[0, 1]`` a polynomial has no more roots in the interval than its
coefficients have changes of sign (Descartes), so an interval without a change needs no further
look, and one with a single change holds exactly one root. The rest is bisected, and so is what is
too close to zero for its sign to be certain.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BPoly
from scipy.optimize import brentq

from zeno_orbits.errors import InputError

Coefficients = NDArray[np.float64]

_ROUNDING = 2.0**-52
_DEPTH = 46
"""Bisections before two roots count as one: their distance is then near rounding."""


def first_root(coefficients: Coefficients) -> float | None:
    r"""Return where a polynomial first ceases to be positive in ``[0, 1]``, if it does.

    Args:
        coefficients: Those in Bernstein's basis,
            :math:`\sum_k b_k \binom{n}{k} u^k (1 - u)^{n - k}`, ``(n + 1,)``.

    Returns:
        The root, to rounding; 0 if the polynomial is not positive there.

    Raises:
        InputError: If the coefficients are not finite, or two roots cannot be told apart.
    """
    if not np.all(np.isfinite(coefficients)):
        raise InputError("Argument `coefficients` must be finite, but some are not.")
    noise = 4 * len(coefficients) * _ROUNDING * float(np.max(np.abs(coefficients)))
    pieces = [(0.0, 1.0, coefficients)]
    while pieces:
        left, right, values = pieces.pop()
        if values[0] <= 0.0:
            return left
        changes = np.count_nonzero(np.diff(np.sign(values[values != 0.0])))
        if changes == 0 and (np.min(values) > noise or _leads_away(values, left)):
            continue
        if changes == 1 and values[-1] < 0.0:
            piece, tight = BPoly(values[:, None], [left, right]), 4 * _ROUNDING
            return float(brentq(_value, left, right, args=(piece,), xtol=1e-300, rtol=tight))
        middle = (left + right) / 2
        if right - left < 2.0**-_DEPTH:
            message = f"must have simple roots, but two meet near {middle:.6g}"
            raise InputError(f"Argument `coefficients` {message}.")
        first, second = _halves(values)
        pieces += [(middle, right, second), (left, middle, first)]
    return None


def _leads_away(values: Coefficients, left: float) -> bool:
    """Return True if a piece is near zero only where that is no root of its own.

    At the start of the whole interval it has just come from zero; where it falls to zero, the
    next piece, which starts with the same value, or the next interval sees it fall through.
    """
    steps = np.diff(values)
    return (left == 0.0 and bool(np.all(steps > 0.0))) or bool(np.all(steps < 0.0))


def _halves(values: Coefficients) -> tuple[Coefficients, Coefficients]:
    """Return the coefficients on both halves, by de Casteljau's rule."""
    row = values
    first, second = [row[0]], [row[-1]]
    while len(row) > 1:
        row = (row[1:] + row[:-1]) / 2
        first.append(row[0])
        second.append(row[-1])
    return np.array(first), np.array(second[::-1])


def _value(u: float, polynomial: Any) -> float:
    return float(polynomial(u))
