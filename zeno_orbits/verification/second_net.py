"""Guards along a period, and a second check for missed events: bounded steps, sampled guards.

The integration of a certificate searches for zero crossings of gaps, multipliers and switches. This
check does not search for events. It integrates every arc again, with the automatic integrator and
steps of at most 1/2000 of the period. All guards are evaluated at each step. After a missed event a
gap or a multiplier is negative, or a switch is on its other side.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.integrators import Automatic, Radau, RungeKutta, Tolerance
from zeno_orbits.model import GraphDynamics
from zeno_orbits.simulation import Arc, states_after_steps

SAMPLES = 2000
"""Least number of steps per period."""

_TOLERANCE = Tolerance(relative=1e-11, absolute=1e-12)
"""Local error of a step. It is ten times the usual error, so that accuracy-limited steps differ."""

_SIZE = 1e12
"""Size of a guard in units of its rounding level."""


class GuardRanges:
    """Extreme values of all guards along arcs, in the characteristic scales of their stops."""

    def __init__(self, graph: GraphDynamics) -> None:
        """Begin without a state.

        Args:
            graph: The graph of modes.
        """
        self._graph = graph
        self._deepest = self._highest = self._pull = self._push = self._crossed = 0.0

    def meet(self, arc: Arc, states: Vector) -> None:
        """Take the states of an arc into account.

        Args:
            arc: The arc.
            states: States inside it, in order of time, ``(n, n_x)``.
        """
        if not len(states):
            return
        graph, n_stops = self._graph, len(self._graph.stop_names)
        mode = arc.mode_in(graph)
        for k in range(n_stops):
            if k in mode[0]:
                view = graph.holding(mode, k)
                forces = view.locked.guards(states) / view.own.multiplier
                self._pull = max(self._pull, -float(np.min(forces)))
                self._push = max(self._push, float(np.max(forces)))
            else:
                view = graph.view(mode, k)
                gaps = view.free.guards(states) / view.own.gap
                self._deepest = max(self._deepest, -float(np.min(gaps)))
                self._highest = max(self._highest, float(np.max(gaps)))
        if graph.switch_names:
            self._crossed = max(self._crossed, self._on_other_side(arc, states))

    def residuals(self) -> dict[str, float]:
        """Return `penetration`, `adhesion` and, with switches, `switches`.

        They are the deepest gap below zero in units of the largest gap, the largest pull on a stop
        in units of the largest multiplier, and the largest guard of a switch on its other side in
        units of its own size.
        """
        found = {
            "penetration": _share(self._deepest, self._highest),
            "adhesion": _share(self._pull, self._push),
        }
        return found | ({"switches": self._crossed} if self._graph.switch_names else {})

    def _on_other_side(self, arc: Arc, states: Vector) -> float:
        """Return the largest guard of a kink on its other side, or of a switch that was passed."""
        graph, n = self._graph, self._graph.n_declared
        found, above = 0.0, np.zeros(n, dtype=bool)
        for x in states:
            guards, rounding, armed = graph.guards(x, arc.sides)
            sizes = np.abs(guards) / np.maximum(rounding * _SIZE, 1e-300)
            wrong = (guards[n:] > 0.0) != np.array(arc.sides, dtype=bool)
            passed = above & (guards[:n] < 0.0) & (armed[:n] > 0.0)
            found = max(found, *sizes[n:][wrong], *sizes[:n][passed], 0.0)
            above = (guards[:n] > 0.0) & (armed[:n] > 0.0)
        return found


def _share(below: float, above: float) -> float:
    return below / above if above > 0.0 else float(below > 0.0)


def sampled_guards(graph: GraphDynamics, arcs: Sequence[Arc], period: float) -> dict[str, float]:
    """Return the residuals of `GuardRanges` of a period, from different, bounded steps.

    Args:
        graph: The graph of modes.
        arcs: The arcs of the period.
        period: The period [s].

    Returns:
        The residuals. Infinite if an arc cannot be integrated.
    """
    ranges, longest = GuardRanges(graph), period / SAMPLES
    engine = Automatic(
        explicit=RungeKutta(largest_step=longest), implicit=Radau(largest_step=longest)
    )
    try:
        for arc in arcs:
            if arc.trajectory is None:
                continue
            flow = graph.flow(arc.mode_in(graph))
            tolerance = _TOLERANCE.times(graph.own.least)
            duration = arc.end_time - arc.start_time
            ranges.meet(arc, states_after_steps(flow, engine, arc.start_state, tolerance, duration))
    except ZenoOrbitsError:
        return dict.fromkeys(ranges.residuals(), math.inf)
    return ranges.residuals()
