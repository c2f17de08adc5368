"""Parts of objectives: numbers at an orbit with their derivatives, and terms of a program.

The protocols state what an objective may ask. The search provides it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from zeno_orbits.arrays import Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class Slope:
    """A number at an orbit, and its derivative along the orbits.

    Attributes:
        value: The number.
        by: Its derivative with respect to the free values, ``(k,)``.
    """

    value: float
    by: Vector

    def __add__(self, other: Slope) -> Slope:
        """Return the sum."""
        return Slope(value=self.value + other.value, by=self.by + other.by)

    def scaled(self, factor: float, less: float = 0.0) -> Slope:
        """Return a multiple of the number minus another."""
        return Slope(value=factor * (self.value - less), by=factor * self.by)


class MeasuredOrbit(Protocol):
    """An orbit at given values."""

    def slopes(self, name: str) -> list[Slope]:
        """Return the values of the period, the energy or a quantity of an event, in order."""
        ...

    def amplitude(self, state: str) -> Slope:
        """Return half the range of a state."""
        ...

    def peak_costs(self, signal: str) -> tuple[Slope, ...]:
        """Return the largest absolute extremes of a signal."""
        ...

    def impact_speed(self, stop: str) -> dict[str, float]:
        """Return the fastest first impact of a stop, or of each stop for an empty text."""
        ...

    def impact_cost(self, stop: str, quantity: str) -> Slope:
        """Return a quantity of impacts, summed over stops and sequences."""
        ...


class Trial(Protocol):
    """An orbit at trial values of a search."""

    @property
    def point(self) -> MeasuredOrbit:
        """The orbit."""
        ...

    def nearness(self, goal: Mapping[str, float]) -> Slope:
        """Return the distance of the free values from a goal."""
        ...

    def differenced(self, name: str) -> Slope:
        """Return a quantity whose derivatives are differences."""
        ...


class ProgramTerms(Protocol):
    """The terms of a program."""

    def reach(self, name: str, target: float, *, is_wish: bool) -> None:
        """Prescribe the period, the energy or a quantity of an event."""
        ...

    def reach_amplitude(self, state: str, target: float, *, is_wish: bool) -> None:
        """Prescribe half the range of a state."""
        ...

    def least_work(self) -> None:
        """Minimize the work of a period."""
        ...

    def least_peak(self, name: str) -> None:
        """Minimize the largest absolute value of a signal."""
        ...

    def least_of_impacts(self, stop: str, quantity: str) -> None:
        """Minimize a quantity of impacts, summed over stops and sequences."""
        ...
