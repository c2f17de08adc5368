"""Objectives that want the least or most of something: energy, a peak, contraction, a margin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

from zeno_orbits.bounds import Extent
from zeno_orbits.restraints import largest, smallest_share
from zeno_orbits.return_map import LEAST_RADIUS, keep_radius_below, radius_of
from zeno_orbits.shooting import OrbitTerms
from zeno_orbits.signals import signal


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
