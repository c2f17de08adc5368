"""Objectives that want a value: of the free numbers themselves, of the period, of an amplitude.

The free numbers stay near where they started, each in units of its own size, so that the answer is
unique.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

from zeno_orbits.bounds import Extent
from zeno_orbits.cycle import Cycle
from zeno_orbits.shooting import OrbitTerms
from zeno_orbits.signals import extent_of
from zeno_orbits.summits import summit


@dataclass(frozen=True, slots=True, kw_only=True)
class NearestGains:
    """Gains as near as may be to given ones, each in units of its own size.

    Attributes:
        target: Name to wanted value; a free gain without one stays near its start.
    """

    target: Mapping[str, float]

    @property
    def wish(self) -> str:
        """What is asked."""
        wanted = ", ".join(f"{name} = {value:g}" for name, value in self.target.items())
        return f"gains near {wanted}" if wanted else "gains near the start"

    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Return half the squared distance of the gains."""
        return _distance(terms, {**terms.first, **self.target})

    @property
    def quantities(self) -> tuple[str, ...]:
        """Nothing but the free numbers tells how good it is."""
        return ()

    def score(
        self,
        numbers: Mapping[str, float],
        first: Mapping[str, float],
        extents: Mapping[str, Extent],
    ) -> float:
        """Return half the squared distance of the free numbers."""
        del extents
        return _how_far(numbers, {**first, **self.target})


class _Wanted(ABC):
    """A wanted value of a quantity; the free numbers stay near where they started."""

    __slots__ = ()
    target: float

    @property
    @abstractmethod
    def wish(self) -> str:
        """What is asked."""

    @abstractmethod
    def value(self, terms: OrbitTerms) -> ca.MX:
        """Return the quantity in the unknowns of the program."""

    @abstractmethod
    def measured(self, cycle: Cycle) -> float:
        """Return the quantity of a simulated cycle."""

    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Require the value; return the squared distance of the gains from their start."""
        terms.program.equal(self.wish, self.value(terms) - self.target)
        return _distance(terms, terms.first)

    @property
    def quantities(self) -> tuple[str, ...]:
        """Nothing but the free numbers tells how good it is."""
        return ()

    def score(
        self,
        numbers: Mapping[str, float],
        first: Mapping[str, float],
        extents: Mapping[str, Extent],
    ) -> float:
        """Return half the squared distance of the free numbers."""
        del extents
        return _how_far(numbers, first)


@dataclass(frozen=True, slots=True, kw_only=True)
class WantedPeriod(_Wanted):
    """A period.

    Attributes:
        target: [s].
    """

    target: float

    @property
    def wish(self) -> str:
        """What is asked."""
        return f"a period of {self.target:.10g} s"

    def value(self, terms: OrbitTerms) -> ca.MX:
        """Return the period [s]."""
        return terms.period

    def measured(self, cycle: Cycle) -> float:
        """Return the period of a simulated cycle [s]."""
        return cycle.period


@dataclass(frozen=True, slots=True, kw_only=True)
class WantedAmplitude(_Wanted):
    """An amplitude of a state: half its travel from peak to peak.

    Attributes:
        state: Its name.
        target: In the unit of the state.
    """

    state: str
    target: float

    @property
    def wish(self) -> str:
        """What is asked."""
        return f"an amplitude of {self.target:.10g} of {self.state}"

    def value(self, terms: OrbitTerms) -> ca.MX:
        """Return the amplitude, in the unit of the state."""
        index = terms.state_names.index(self.state)
        return (summit(terms, index, 1.0) - summit(terms, index, -1.0)) / 2

    def measured(self, cycle: Cycle) -> float:
        """Return the amplitude of a simulated cycle."""
        index = cycle.state_names.index(self.state)
        extent = extent_of(lambda x: float(x[index]), cycle.arcs)
        return (extent.highest - extent.lowest) / 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Approach:
    """As near to a wanted value as may be: what leads to it, or as far as it goes.

    Attributes:
        wanted: The value.
    """

    wanted: WantedPeriod | WantedAmplitude

    @property
    def wish(self) -> str:
        """What is asked."""
        return f"{self.wanted.wish}, or near it"

    @property
    def quantities(self) -> tuple[str, ...]:
        """What the wanted value needs."""
        return self.wanted.quantities

    def score(
        self,
        numbers: Mapping[str, float],
        first: Mapping[str, float],
        extents: Mapping[str, Extent],
    ) -> float:
        """Return what the wanted value says."""
        return self.wanted.score(numbers, first, extents)

    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Return half the squared relative distance from the value."""
        return ((self.wanted.value(terms) - self.wanted.target) / self.wanted.target) ** 2 / 2


def _distance(terms: OrbitTerms, target: Mapping[str, float]) -> ca.MX:
    """Return half the squared distance of what is free from a target, each in units of its size."""
    cost = ca.MX(0)
    for name, unknown in terms.free.items():
        cost += ((unknown - target[name]) / _size_of(target[name])) ** 2 / 2
    return cost


def _how_far(numbers: Mapping[str, float], target: Mapping[str, float]) -> float:
    """Return the same of numbers."""
    return sum(
        ((value - target[name]) / _size_of(target[name])) ** 2 / 2
        for name, value in numbers.items()
    )


def _size_of(value: float) -> float:
    return max(abs(value), 1e-3)
