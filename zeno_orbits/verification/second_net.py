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

_LEAST = 24
"""Least number of steps of an arc: contacts and flights may be much shorter than a period."""
_SIZE = 1e12
"""Size of a guard in units of its rounding level."""


class GuardRanges:
    """Extreme values of all guards along arcs, in the characteristic scales of their stops."""

    def __init__(self, graph: GraphDynamics) -> None:
        """Begin without a state.

        Args:
            graph: The graph of modes.
        """
        self._graph, self.is_broken = graph, False
        n = len(graph.stop_names)
        self._highest, self._push = np.zeros(n), np.zeros(n)
        self._deepest = self._pull = self._crossed = 0.0

    def meet(self, arc: Arc, states: Vector) -> None:
        """Take the states of an arc into account.

        Args:
            arc: The arc.
            states: States inside it, in order of time, ``(n, n_x)``.
        """
        if not len(states):
            return
        graph = self._graph
        mode = arc.mode_in(graph)
        for k in range(len(graph.stop_names)):
            if k in mode[0]:
                view = graph.holding(mode, k)
                forces = view.locked.guards(states) / view.own.multiplier
                self._pull = max(self._pull, -float(np.min(forces)))
                self._push[k] = max(self._push[k], float(np.max(forces)))
            else:
                view = graph.view(mode, k)
                gaps = view.free.guards(states) / view.own.gap
                self._deepest = max(self._deepest, -float(np.min(gaps)))
                self._highest[k] = max(self._highest[k], float(np.max(gaps)))
        if graph.switch_names:
            self._crossed = max(self._crossed, self._on_other_side(arc, states))

    def residuals(self) -> dict[str, float]:
        """Return `penetration` and `adhesion` of stops, and `switches` of switches and kinks.

        They are the deepest gap below zero in units of the largest gap, the largest pull on a stop
        in units of the largest multiplier, and the largest guard of a switch on its other side in
        units of its own size.
        """
        found: dict[str, float] = {}
        if self._graph.stop_names:
            found["penetration"] = _share(self._deepest, float(np.max(self._highest)))
            found["adhesion"] = _share(self._pull, float(np.max(self._push)))
        found |= {"switches": self._crossed} if self._graph.switch_names else {}
        return dict.fromkeys(found, math.inf) if self.is_broken else found

    def largest_gap(self, stop: int) -> float:
        """Return the largest gap of a stop, its characteristic scale if it was never open."""
        return float(self._highest[stop] or 1.0) * self._graph.open_views[stop].own.gap

    def largest_force(self, stop: int) -> float:
        """Return the largest multiplier of a stop, its characteristic scale if never closed."""
        return float(self._push[stop] or 1.0) * self._graph.open_views[stop].own.multiplier

    def _on_other_side(self, arc: Arc, states: Vector) -> float:
        """Return the largest guard of a kink on its other side, or of a switch that was passed."""
        n = self._graph.n_declared
        guards, rounding, armed = self._graph.guards_along(arc.mode_in(self._graph), states)
        sizes = np.abs(guards) / np.maximum(rounding * _SIZE, 1e-300)
        wrong = (guards[:, n:] > 0.0) != np.array(arc.sides, dtype=bool)
        above = (guards[:-1, :n] > 0.0) & (armed[:-1] > 0.0)
        passed = above & (guards[1:, :n] < 0.0) & (armed[1:] > 0.0)
        found = [sizes[:, n:][wrong], sizes[1:, :n][passed]]
        return float(np.max(np.concatenate(found), initial=0.0))


def _share(below: float, above: float) -> float:
    return below / above if above > 0.0 else float(below > 0.0)


def sampled_guards(graph: GraphDynamics, arcs: Sequence[Arc], period: float) -> GuardRanges:
    """Return the extreme values of all guards over a period, from different, bounded steps.

    Args:
        graph: The graph of modes.
        arcs: The arcs of the period.
        period: The period [s].

    Returns:
        The extreme values. Their residuals are infinite if an arc cannot be integrated.
    """
    ranges, tolerance = GuardRanges(graph), _TOLERANCE.times(graph.own.least)
    usual = _bounded(period / SAMPLES)
    try:
        for arc in arcs:
            duration = arc.end_time - arc.start_time
            if arc.trajectory is None or not duration > 0.0:
                continue
            # Impacts that accumulate have many short flights.
            is_short = arc.time_unit == 1.0 and duration < _LEAST * period / SAMPLES
            engine = _bounded(duration / _LEAST) if is_short else usual
            flow = graph.flow(arc.mode_in(graph))
            ranges.meet(arc, states_after_steps(flow, engine, arc.start_state, tolerance, duration))
    except ZenoOrbitsError:
        ranges.is_broken = True
    return ranges


def _bounded(longest: float) -> Automatic:
    """Return the automatic integrator with a longest step [s]."""
    explicit, implicit = RungeKutta(largest_step=longest), Radau(largest_step=longest)
    return Automatic(explicit=explicit, implicit=implicit)
