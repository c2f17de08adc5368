"""The neighbourhoods of Zeno points: the flights that lead to them, and the flights of the tail."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model import GraphDynamics, HybridDynamics
from zeno_orbits.simulation import Arc, Ending, Execution, Impact, ZenoPoint

SAMPLES = 160
"""Points on a flight, at least."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CloseUp:
    """The last Zeno point of a stop and the motion that leads to it.

    Attributes:
        arcs: Arcs since the release before it, without the tail of the impact sequence.
        dynamics: The system that was simulated, with the gap of the stop.
        zeno: The Zeno point.
        impacts: The impacts that lead to it.
        flights: The arcs between them, empty if a single impact reaches the Zeno point.
    """

    arcs: tuple[Arc, ...]
    dynamics: HybridDynamics
    zeno: ZenoPoint
    impacts: tuple[Impact, ...]
    flights: tuple[Arc, ...]

    @property
    def pull(self) -> float:
        """Minus d2h/dt2 at the Zeno point, positive."""
        return -self.dynamics.gap_acceleration(self.zeno.state)

    def gaps(self, arc: Arc) -> tuple[Vector, Vector]:
        """Return times and gaps along an arc, the latter without negative rounding."""
        times, states = arc.sampled(SAMPLES)
        return times, np.array([max(self.dynamics.gap(state), 0.0) for state in states])

    def speeds(self) -> tuple[Vector, Vector]:
        """Return times left to the Zeno point and speeds of the impacts before it."""
        seen = [impact for impact in self.impacts if impact.time < self.zeno.time]
        left = np.array([self.zeno.time - impact.time for impact in seen])
        return left, np.array([-impact.approach_rate for impact in seen])

    def law(self, tail: Sequence[tuple[Vector, Vector]]) -> tuple[Vector, Vector]:
        r"""Return the first-order law :math:`|\dot h| = a (1 - e)/(2 e) (t_\infty - t)` as a line.

        Args:
            tail: The flights beyond the resolved flights for which the law is drawn.

        Returns:
            Times left to the Zeno point at both ends, and speeds. Both are empty without previous
            impacts.
        """
        left, e = self.speeds()[0], self.dynamics.restitution
        if not left.size:
            return left, left
        ends = np.array([left[0], min([left[-1], *(-float(times[0]) for times, _ in tail)])])
        return ends, self.pull * (1 - e) / (2 * e) * ends

    def tail(self, least: float = 0.02) -> list[tuple[Vector, Vector]]:
        r"""Return times before the Zeno point and gaps of flights left out, by the first-order law.

        A flight that starts at the speed :math:`w` under the acceleration :math:`-a` ends after
        :math:`2 w / a` at the same speed, and the rest of the sequence takes
        :math:`2 w / (a (1 - e))`.

        Args:
            least: Part of the first left-out flight's speed at which to stop.

        Returns:
            A pair a flight: times relative to the Zeno point, not positive [s], and gaps.
        """
        e = self.dynamics.restitution
        n = math.ceil(math.log(least, e)) if self.zeno.tail > 0.0 else 0
        fractions = np.linspace(0.0, 1.0, SAMPLES + 1)
        flights: list[tuple[Vector, Vector]] = []
        for speed in self.zeno.last_speed * e ** np.arange(n):
            offsets = (2 * speed / self.pull) * (fractions - 1 / (1 - e))
            flights.append((offsets, 2 * speed**2 / self.pull * fractions * (1 - fractions)))
        return flights


def close_ups(
    execution: Execution, dynamics: HybridDynamics | GraphDynamics
) -> tuple[CloseUp, ...]:
    """Return the neighbourhood of the last Zeno point of every stop, in the order of their times.

    Gap and impacts are those of the stop, and its neighbourhood begins where the stop opens.

    Args:
        execution: The execution.
        dynamics: The system that was simulated.

    Returns:
        The neighbourhoods, without those of stops whose impacts are all before the execution.
    """
    last: dict[str, CloseUp] = {}
    for zeno in reversed(execution.zeno_points):
        if zeno.stop not in last:
            one = _close_up(execution, dynamics, zeno)
            last |= {zeno.stop: one} if one.impacts else {}
    return tuple(reversed(last.values()))


def _close_up(
    execution: Execution, dynamics: HybridDynamics | GraphDynamics, zeno: ZenoPoint
) -> CloseUp:
    graph = dynamics.as_graph(zeno.stop)
    stop = graph.stop_names.index(zeno.stop)
    tail = next(arc for arc in execution.arcs if arc.end_time >= zeno.time)
    ends = [arc.end_time for arc in execution.arcs if stop in arc.mode_in(graph)[0]]
    begin = max((time for time in ends if time < zeno.time), default=0.0)
    impacts = tuple(
        event
        for event in execution.impacts
        if begin <= event.time <= zeno.time and event.stop == zeno.stop
    )
    first = impacts[0].time if impacts else zeno.time
    resolved = [arc for arc in execution.arcs if arc.ending is not Ending.ZENO]
    arcs = tuple(arc for arc in resolved if arc.start_time >= begin)
    return CloseUp(
        arcs=arcs,
        dynamics=graph.view(tail.mode_in(graph), stop),
        zeno=zeno,
        impacts=impacts,
        flights=tuple(arc for arc in arcs if first <= arc.start_time < zeno.time),
    )
