"""The measure of the distance between values and their targets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Nearness:
    r"""The measure of nearness of free values: :math:`\sum ((p_i - t_i) / s_i)^2 / 2`.

    Attributes:
        first: Name to value at the start of the search.
        sizes: Name to size :math:`s_i`, the unit of a difference.
    """

    first: Mapping[str, float]
    sizes: Mapping[str, float]

    def distance(self, numbers: Mapping[str, Any], target: Mapping[str, float]) -> Any:
        """Return the distance of values, or of unknowns, from their targets or from the start.

        Args:
            numbers: Name to value or unknown.
            target: Name to target value. Without a target, the start is used.
        """
        wanted = {**self.first, **target}
        parts = [
            ((value - wanted[name]) / self.sizes[name]) ** 2 / 2 for name, value in numbers.items()
        ]
        return sum(parts[1:], parts[0]) if parts else 0.0
