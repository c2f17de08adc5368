"""The measure of the distance between values and their targets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from zeno_orbits.model import ParameterValues

_SMALLEST_SIZE = 1e-3
"""Smallest size of a free value, in units of its range."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Nearness:
    r"""The measure of nearness of free values: :math:`\sum ((p_i - t_i) / s_i)^2 / 2`.

    Attributes:
        first: Name to value at the start of the search.
        sizes: Name to size :math:`s_i`, the unit of a difference.
    """

    first: Mapping[str, float]
    sizes: Mapping[str, float]

    def distance(self, numbers: Mapping[str, float], target: Mapping[str, float]) -> float:
        """Return the distance of values from their targets, or from the start.

        Args:
            numbers: Name to value.
            target: Name to target value. Without a target, the start is used.
        """
        wanted = {**self.first, **target}
        return sum(
            (
                ((value - wanted[name]) / self.sizes[name]) ** 2 / 2
                for name, value in numbers.items()
            ),
            0.0,
        )


def nearness_of(origin: ParameterValues, free: Mapping[str, tuple[float, float]]) -> Nearness:
    """Return the measure of nearness to values, each in units of its own size.

    Args:
        origin: The values.
        free: Name to range of the free values.
    """
    return Nearness(
        first={name: origin.number(name) for name in free},
        sizes={
            name: max(abs(origin.number(name)), _SMALLEST_SIZE * (high - low))
            for name, (low, high) in free.items()
        },
    )
