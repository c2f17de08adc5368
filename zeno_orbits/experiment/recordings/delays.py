"""Delays of the cycles of a record against what they have in common, and what they tell."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector

_TELLING = 4
"""Cycles from which on their scatter tells an error."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Delays:
    """How much later than the average the cycles of a record came, those that tell.

    Attributes:
        numbers: Of the cycles, ``(n,)``.
        values: Their delays, ``(n,)``.
        information: One over the variance of each, for residuals of variance one, ``(n,)``.
    """

    numbers: Vector
    values: Vector
    information: Vector

    @property
    def scatter(self) -> float:
        """Standard error of their mean, by their scatter; 0 for too few."""
        n = len(self.values)
        return float(np.std(self.values, ddof=1)) / math.sqrt(n) if n >= _TELLING else 0.0


def delays_of(cycles: NDArray[np.int64], late: Vector, rest: Vector) -> Delays:
    """Return the least-squares delay of each cycle.

    Args:
        cycles: Number of the cycle of each residual, not negative, ``(n,)``.
        late: Derivatives of what is predicted by a delay, ``(n,)``.
        rest: The residuals, ``(n,)``.
    """
    information: Vector = np.bincount(cycles, weights=late**2).astype(np.float64)
    told = information > 0.5 * np.median(information)
    moved = np.bincount(cycles, weights=late * rest)
    return Delays(
        numbers=np.flatnonzero(told).astype(np.float64),
        values=moved[told] / information[told],
        information=information[told],
    )


def period_error(delays: Delays, white: float) -> float:
    """Return the standard error of the slope of the cycles' delays over their numbers.

    With few cycles their scatter says little; the error of the noise alone counts if it is larger.

    Args:
        delays: The delays.
        white: Variance of the residuals.
    """
    n = len(delays.numbers)
    if n < 2:
        return math.inf
    centred = delays.numbers - delays.numbers.mean()
    spread = float(centred @ centred)
    weight = float(np.mean(delays.information))
    from_noise = math.sqrt(white / (weight * spread)) if weight > 0.0 else math.inf
    if n < _TELLING:
        return from_noise
    slope = float(centred @ delays.values) / spread
    rest = delays.values - delays.values.mean() - slope * centred
    return max(math.sqrt(float(rest @ rest) / (n - 2) / spread), from_noise)
