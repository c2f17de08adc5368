"""The orbits of machines with one stop over free values, for their margins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import Cycle, Orbit, excess
from zeno_orbits.search.homotopy.best_on_line import bounded_extents
from zeno_orbits.search.homotopy.homotopy import follow
from zeno_orbits.search.homotopy.line import Followed
from zeno_orbits.search.homotopy.persistence import WAY
from zeno_orbits.search.search_problem import SearchProblem
from zeno_orbits.simulation import Extent


@dataclass(frozen=True, slots=True, kw_only=True)
class CycleWays:
    """The orbits of a search over its free values.

    Attributes:
        search: The search.
    """

    search: SearchProblem

    @property
    def problem(self) -> Problem:
        """The problem."""
        return self.search.problem

    @property
    def free(self) -> Mapping[str, tuple[float, float]]:
        """Name to range of the free values."""
        return self.search.free

    @property
    def is_bounded(self) -> bool:
        """True if the orbits must keep bounds."""
        return bool(self.search.bounds)

    def follow(
        self, near: Cycle | Orbit, here: ParameterValues, wanted: ParameterValues
    ) -> Followed[Cycle | Orbit]:
        """Follow a stable orbit along a line of values, until it is lost.

        Args:
            near: The orbit.
            here: Its values.
            wanted: Values at the end of the line.
        """
        return follow(self.search, near, here, wanted, steps=WAY, attracting=True)

    def slack(self, values: ParameterValues, near: Cycle | Orbit) -> Vector:
        """Return the distance of each bounded quantity from its bounds, positive inside.

        Args:
            values: Values of the orbit.
            near: One simulated period of the orbit.
        """
        bounds = self.search.bounds
        extents: Mapping[str, Extent] = {}
        if bounds and isinstance(near, Cycle):
            extents = bounded_extents(self.search, values, near)
        return np.array([-excess(bound, extents[bound.name]) for bound in bounds])

    def tell(self, stage: str) -> None:
        """Report progress.

        Args:
            stage: The stage.
        """
        self.search.tell(stage)
