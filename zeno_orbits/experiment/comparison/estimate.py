"""A number of a recording and how sure it is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

_OUTLIER = 6.0
"""Cycles this far from the middle one, in standard deviations, do not count."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A number and its standard error; NaN where the recording does not tell."""

    value: float
    error: float

    @property
    def known(self) -> bool:
        """True if the recording tells the number."""
        return math.isfinite(self.value)

    def since(self, other: Estimate, *errors: float) -> Estimate:
        """Return how much larger it is than another one.

        Args:
            other: The other.
            errors: Standard errors of what the difference is unsure by.
        """
        return Estimate(value=self.value - other.value, error=math.hypot(*errors))


UNKNOWN = Estimate(value=math.nan, error=math.nan)


def mean_over_cycles(numbers: Sequence[Estimate]) -> Estimate:
    """Return the mean of a number over cycles; its error is at least what the noise makes it."""
    known = [one for one in numbers if one.known]
    if not known:
        return UNKNOWN
    y, u = np.array([(one.value, one.error) for one in known]).T
    middle = float(np.median(y))
    width = 1.4826 * float(np.median(np.abs(y - middle)))
    kept = np.abs(y - middle) <= _OUTLIER * width if width > 0.0 else np.ones(len(y), dtype=bool)
    y, u = y[kept], np.where(np.isfinite(u), u, 0.0)[kept]
    noise = float(np.sqrt(np.mean(u**2) / len(y)))
    scatter = float(np.std(y, ddof=1)) / math.sqrt(len(y)) if len(y) >= 3 else 0.0
    return Estimate(value=float(y.mean()), error=max(noise, scatter) or math.nan)
