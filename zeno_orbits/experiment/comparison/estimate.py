"""A number of a recording and how sure it is."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A value and its standard error, both NaN if the recording does not determine the value."""

    value: float
    error: float

    @property
    def known(self) -> bool:
        """True if the recording determines the value."""
        return math.isfinite(self.value)

    def unsure(self, error: float) -> Estimate:
        """Return it with a further error."""
        return Estimate(value=self.value, error=math.hypot(self.error, error))


UNKNOWN = Estimate(value=math.nan, error=math.nan)
