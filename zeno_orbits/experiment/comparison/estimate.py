"""A number of a recording, its standard error, and the rounding of samples."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector

_EVEN = 1e-3
"""Part of a step by which multiples of it may differ in a file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A value and its standard error, both NaN if the recording does not determine the value.

    Attributes:
        value: The value.
        error: Standard error, including the rounding.
        rounding: Largest error by the rounding of samples.
    """

    value: float
    error: float
    rounding: float = 0.0

    @property
    def known(self) -> bool:
        """True if the recording determines the value."""
        return math.isfinite(self.value)

    def unsure(self, error: float) -> Estimate:
        """Return it with a further error."""
        return replace(self, error=math.hypot(self.error, error))

    def rounded(self, most: float) -> Estimate:
        """Return it with the largest error by the rounding of samples."""
        return replace(self.unsure(most), rounding=most)


UNKNOWN = Estimate(value=math.nan, error=math.nan)


def instruments_json(errors: Mapping[str, Estimate]) -> dict[str, dict[str, float | None]]:
    """Return errors of instruments as plain data, with null for unknown errors."""
    return {
        name: {
            "value": one.value,
            "standard_error": one.error if math.isfinite(one.error) else None,
        }
        for name, one in errors.items()
    }


def step_of(row: Vector) -> float:
    """Return the step of a rounded signal, or 0 if its values are not multiples of a step."""
    values = np.unique(row[np.isfinite(row)])
    if len(values) < 2:
        return 0.0
    apart = np.diff(values)
    step = float(np.min(apart))
    numbers = apart / step
    return step if np.max(np.abs(numbers - np.rint(numbers))) < _EVEN else 0.0
