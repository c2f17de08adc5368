"""The measure of how near numbers are to those that are wanted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Nearness:
    r"""The measure of nearness of free numbers: :math:`\sum ((p_i - t_i) / s_i)^2 / 2`.

    Attributes:
        first: Name to value where the search started.
        sizes: Name to size :math:`s_i` in which a difference is measured.
    """

    first: Mapping[str, float]
    sizes: Mapping[str, float]

    def distance(self, numbers: Mapping[str, Any], target: Mapping[str, float]) -> Any:
        """Return the distance of numbers, or of unknowns, from those wanted; others from the first.

        Args:
            numbers: Name to value or unknown.
            target: Name to value that is wanted.
        """
        wanted = {**self.first, **target}
        parts = [
            ((value - wanted[name]) / self.sizes[name]) ** 2 / 2 for name, value in numbers.items()
        ]
        return sum(parts[1:], parts[0]) if parts else 0.0
