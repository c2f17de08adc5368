"""Predictions of an orbit for samples, and their exact derivatives by the unknowns of a fit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.identification.folding import Fold, Folded
from zeno_orbits.experiment.identification.orbit_sensitivity import OrbitSlope, orbit_slope
from zeno_orbits.experiment.identification.unknowns import Unknowns
from zeno_orbits.experiment.orbit_table import Measurement, OrbitTable, tabulated
from zeno_orbits.model import Problem
from zeno_orbits.orbits import Cycle
from zeno_orbits.search import close_near
from zeno_orbits.simulation import SimulationSettings

_KEPT = 8
"""Orbits that are remembered."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Slopes:
    """Derivatives by the unknowns.

    Attributes:
        signals: Of the signals at the samples, ``(n, n_s, k + 1)``.
        period: Of the period, ``(k + 1,)`` [s].
    """

    signals: Vector
    period: Vector


class Predictions:
    """Orbits at unknowns; the last one that was accepted tells where the next is looked for."""

    def __init__(
        self, problem: Problem, unknowns: Unknowns, measured: Measurement, near: Cycle
    ) -> None:
        self._problem, self._measured, self._near = problem, measured, near
        self._settings = SimulationSettings()
        self._tables = lru_cache(_KEPT)(self._tabulated)
        self._slopes = lru_cache(_KEPT)(self._differentiated)
        self.unknowns = unknowns

    def table(self, x: Vector) -> OrbitTable:
        """Return the orbit at unknowns.

        Raises:
            SimulationError: If none is found near the last one.
        """
        return self._tables(x[:-1].tobytes())

    def accept(self, x: Vector) -> None:
        """Look for the next orbits near the one at these unknowns."""
        self._near = self.table(x).cycle

    def fold(self, x: Vector, data: Folded) -> Fold:
        """Return the orbit at the phases of samples."""
        return data.predicted(self.table(x), float(x[-1]))

    def slopes(self, x: Vector, data: Folded) -> Slopes:
        """Return the exact derivatives of what the orbit says of samples (theory (58))."""
        unknowns, table, fold = self.unknowns, self.table(x), self.fold(x, data)
        slope = self._slopes(x[:-1].tobytes())
        states = slope.at(fold.times)
        n_x = states.shape[1]
        by = self._measured.derivatives(table.states.at(fold.times), table.p)
        moved = by[:, :, :n_x] @ states + by[:, :, n_x:][:, :, list(unknowns.places)]
        # At a fixed phase a longer period means a later time.
        share = fold.times / table.period
        moved += fold.slopes[:, :, None] * share[:, None, None] * slope.period
        late = -fold.slopes[:, :, None] * table.period
        own = unknowns.ties * unknowns.scale
        return Slopes(
            signals=np.concatenate([moved @ own, late], axis=2),
            period=np.append(slope.period @ own, 0.0),
        )

    def _tabulated(self, key: bytes) -> OrbitTable:
        near, p = self._near, self.unknowns.p_at(np.append(np.frombuffer(key), 0.0))
        dynamics = self._problem.dynamics(p)
        closed = close_near(dynamics, near, self._settings)
        return tabulated(dynamics, closed.cycle, self._measured, p)

    def _differentiated(self, key: bytes) -> OrbitSlope:
        table = self._tables(key)
        return orbit_slope(
            self._problem.dynamics(table.p),
            table.cycle.start.state,
            scale=table.cycle.scale_at_events(),
            period=table.period,
            chosen=self.unknowns.places,
            settings=self._settings,
        )
