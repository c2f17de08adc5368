"""Delays of the cycles of a record relative to their mean cycle, and the resulting period error."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector

_TELLING = 4
"""Smallest number of cycles from which their scatter gives an error estimate."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Delays:
    """Delays of the cycles of a record relative to the mean cycle, where samples determine them.

    Attributes:
        numbers: Indices of the cycles, ``(n,)``.
        values: Delays of the cycles, ``(n,)``.
        information: Inverse variance of each delay, for residuals of variance one, ``(n,)``.
    """

    numbers: Vector
    values: Vector
    information: Vector

    @property
    def scatter(self) -> float:
        """Standard error of the mean delay, from the scatter. It is 0 for too few cycles."""
        n = len(self.values)
        return float(np.std(self.values, ddof=1)) / math.sqrt(n) if n >= _TELLING else 0.0


def delays_of(cycles: NDArray[np.int64], late: Vector, rest: Vector) -> Delays:
    """Return the least-squares delay of each cycle.

    Args:
        cycles: Cycle index of each residual, nonnegative, ``(n,)``.
        late: Derivatives of the prediction with respect to a delay, ``(n,)``.
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
    """Return the standard error of the slope of the delays as a function of the cycle index.

    The scatter of few cycles is a poor estimate. The error from the noise alone counts if it is
    larger.

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
