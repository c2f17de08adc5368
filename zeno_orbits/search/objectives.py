"""What a search may ask of an orbit when numbers are free: one small value an objective.

Each adds its rows to a program and returns the cost to minimise. Where an orbit is asked to have
a property, the cost keeps the free numbers near where they started, so that the answer is unique.
What was reached is measured on a simulation.

Objectives that want the least or most of something: energy, a peak, contraction, a margin.

Objectives that want a value: of the free numbers themselves, of the period, of an amplitude.

The free numbers stay near where they started, each in units of its own size, so that the answer is
unique.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import casadi as ca

from zeno_orbits.orbits.cycle import Cycle
from zeno_orbits.search.constraints import largest, smallest_share
from zeno_orbits.search.extremes import summit
from zeno_orbits.search.spectral_radius import LEAST_RADIUS, keep_radius_below, radius_of
from zeno_orbits.search.transcription.transcribe import OrbitTerms
from zeno_orbits.simulation.signals import Extent, extent_of, signal

__all__ = [
    "Approach",
    "FastestContraction",
    "LeastEnergy",
    "LeastPeak",
    "NearestGains",
    "Objective",
    "WantedAmplitude",
    "WantedPeriod",
    "WidestMargin",
]


class Objective(Protocol):
    """What a search asks for."""

    @property
    def wish(self) -> str:
        """What is asked, as a clause for the user."""
        ...

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names of what has to be measured of an orbit to tell how good it is."""
        ...

    def score(
        self,
        numbers: Mapping[str, float],
        first: Mapping[str, float],
        extents: Mapping[str, Extent],
    ) -> float:
        """Return how good an orbit is; less is better.

        Args:
            numbers: Name to value of what is free, at the orbit.
            first: The same where the search started.
            extents: The measured quantities.
        """
        ...

    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Add rows to the program and return what to minimise.

        Args:
            terms: The orbit in the unknowns of the program.
        """
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class LeastEnergy:
    """The least electrical work in a period."""

    @property
    def wish(self) -> str:
        """What is asked."""
        return "the least electrical energy a period"

    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Return the electrical work of one period, in units of the guess's."""
        size = abs(float(terms.guessed(terms.electrical_work)[0, 0]))
        return terms.electrical_work / max(size, 1e-9)

    @property
    def quantities(self) -> tuple[str, ...]:
        """What tells how good it is."""
        return ("energy",)

    def score(
        self,
        numbers: Mapping[str, float],
        first: Mapping[str, float],
        extents: Mapping[str, Extent],
    ) -> float:
        """Return the electrical work [J]."""
        del numbers, first
        return extents["energy"].highest


@dataclass(frozen=True, slots=True, kw_only=True)
class LeastPeak:
    """The least peak of a signal: its largest absolute value in a period.

    Attributes:
        signal: Its name.
    """

    signal: str

    @property
    def wish(self) -> str:
        """What is asked."""
        return f"the least peak of {self.signal}"

    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Return an unknown that the signal does not exceed anywhere, in units of its size."""
        size = self._size(terms)
        quantity = signal(terms.compiled, self.signal)
        return largest(terms, quantity, terms.stretches, f"peak of {self.signal}") / size

    def _size(self, terms: OrbitTerms) -> float:
        value = signal(terms.compiled, self.signal).at(terms.numbers)
        ends = [abs(value(stretch.arc.start_state)) for stretch in terms.stretches]
        return max(*ends, 1e-6)

    @property
    def quantities(self) -> tuple[str, ...]:
        """What tells how good it is."""
        return (self.signal,)

    def score(
        self,
        numbers: Mapping[str, float],
        first: Mapping[str, float],
        extents: Mapping[str, Extent],
    ) -> float:
        """Return the peak, in the unit of the signal."""
        del numbers, first
        return extents[self.signal].largest


@dataclass(frozen=True, slots=True, kw_only=True)
class FastestContraction:
    """The fastest return after a disturbance: the least spectral radius of the return map."""

    @property
    def wish(self) -> str:
        """What is asked."""
        return "the fastest contraction"

    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Return an unknown that no multiplier exceeds in size (theory (31))."""
        if terms.return_slope is None:
            raise ValueError("Argument `terms` must carry the return map, but it has none.")
        first = radius_of(terms.guessed(terms.return_slope))
        radius = terms.program.variable(
            "spectral radius", 1.01 * max(first, LEAST_RADIUS), lower=LEAST_RADIUS
        )[0, 0]
        keep_radius_below(terms.program, terms.return_slope, radius)
        return radius

    @property
    def quantities(self) -> tuple[str, ...]:
        """What tells how good it is."""
        return ("spectral_radius",)

    def score(
        self,
        numbers: Mapping[str, float],
        first: Mapping[str, float],
        extents: Mapping[str, Extent],
    ) -> float:
        """Return the spectral radius; below the least that is asked for, that."""
        del numbers, first
        return max(extents["spectral_radius"].highest, LEAST_RADIUS)


@dataclass(frozen=True, slots=True, kw_only=True)
class WidestMargin:
    """The widest margin to losing the orbit: the largest smallest share (theory (32))."""

    @property
    def wish(self) -> str:
        """What is asked."""
        return "the widest margin to losing the orbit"

    def cost(self, terms: OrbitTerms) -> ca.MX:
        """Return minus the smallest share."""
        return -smallest_share(terms)

    @property
    def quantities(self) -> tuple[str, ...]:
        """What tells how good it is."""
        return ("margin",)

    def score(
        self,
        numbers: Mapping[str, float],
        first: Mapping[str, float],
        extents: Mapping[str, Extent],
    ) -> float:
        """Return minus the smallest share."""
        del numbers, first
        return -extents["margin"].lowest


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
