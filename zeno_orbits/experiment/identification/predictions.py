"""Predictions of an orbit for samples, and their exact derivatives by the unknowns of a fit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.experiment.identification.folding import Fold, Folded
from zeno_orbits.experiment.identification.orbit_sensitivity import OrbitSlope, orbit_slope
from zeno_orbits.experiment.identification.unknowns import Unknowns
from zeno_orbits.experiment.orbit_table import Measurement, OrbitTable, tabulated
from zeno_orbits.model import HybridDynamics, Problem
from zeno_orbits.orbits import Cycle
from zeno_orbits.search import close_cycle
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
        self._known: dict[bytes, OrbitTable] = {}
        self._moving: dict[bytes, OrbitSlope] = {}
        self._settings = SimulationSettings()
        self.unknowns = unknowns

    def table(self, x: Vector) -> OrbitTable:
        """Return the orbit at unknowns.

        Raises:
            SimulationError: If none is found near the last one.
        """
        key = x[:-1].tobytes()
        if key not in self._known:
            near, p = self._near, self.unknowns.p_at(x)
            dynamics = self._dynamics(p)
            closed = close_cycle(
                dynamics,
                near.start.state,
                scale=near.scale_at_events(),
                period=near.period,
                settings=self._settings,
            )
            self._known[key] = tabulated(dynamics, closed.cycle, self._measured, p)
            _forget(self._known)
        return self._known[key]

    def accept(self, x: Vector) -> None:
        """Look for the next orbits near the one at these unknowns."""
        self._near = self.table(x).cycle

    def fold(self, x: Vector, data: Folded) -> Fold:
        """Return the orbit at the phases of samples."""
        return data.predicted(self.table(x), float(x[-1]))

    def slopes(self, x: Vector, data: Folded) -> Slopes:
        """Return the exact derivatives of what the orbit says of samples (theory (58))."""
        unknowns, table, fold = self.unknowns, self.table(x), self.fold(x, data)
        slope = self._slope(x)
        states = slope.at(fold.times)
        n_x = states.shape[1]
        by = self._measured.derivatives(table.states.at(fold.times), table.p)
        moved = np.einsum("nsx,nxk->nsk", by[:, :, :n_x], states)
        moved += by[:, :, n_x:][:, :, list(unknowns.places)]
        # At a fixed phase a longer period means a later time.
        share = fold.times / table.period
        moved += fold.slopes[:, :, None] * share[:, None, None] * slope.period
        late = -fold.slopes[:, :, None] * table.period
        own = unknowns.ties * unknowns.scale
        return Slopes(
            signals=np.concatenate([moved @ own, late], axis=2),
            period=np.append(slope.period @ own, 0.0),
        )

    def _slope(self, x: Vector) -> OrbitSlope:
        key, table = x[:-1].tobytes(), self.table(x)
        if key not in self._moving:
            self._moving[key] = orbit_slope(
                self._dynamics(table.p),
                table.cycle.start.state,
                scale=table.cycle.scale_at_events(),
                period=table.period,
                chosen=self.unknowns.places,
                settings=self._settings,
            )
            _forget(self._moving)
        return self._moving[key]

    def _dynamics(self, p: Vector) -> HybridDynamics:
        return self._problem.dynamics(p)


def _forget(known: dict[bytes, Any]) -> None:
    """Keep the last ones only."""
    while len(known) > _KEPT:
        del known[next(iter(known))]
