"""What a search may ask of an orbit when numbers are free: one small value an objective.

Each adds its rows to a program and returns the cost to minimise. Where an orbit is asked to have
a property, the cost keeps the free numbers near where they started, so that the answer is unique.
What was reached is measured on a simulation.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import casadi as ca

from zeno_orbits.bounds import Extent
from zeno_orbits.optima import FastestContraction, LeastEnergy, LeastPeak, WidestMargin
from zeno_orbits.shooting import OrbitTerms
from zeno_orbits.wanted import Approach, NearestGains, WantedAmplitude, WantedPeriod

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
