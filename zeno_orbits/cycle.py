"""One period of an execution, cut out at its releases: the raw material of a Zeno orbit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from zeno_orbits.dynamics import HybridDynamics, Vector
from zeno_orbits.execution import Arc, Ending, Execution, Impact, Mode, Release, ZenoPoint
from zeno_orbits.zeno import TailEstimate, estimate_tail, extrapolate, spread_nodes

_VANISHING = 1e-9
"""Part of the largest state below which one is rounding."""


@dataclass(frozen=True, kw_only=True)
class Cycle:
    """Release, flight, impacts, Zeno point, locked arc, next release.

    Attributes:
        state_names: Name of each state.
        start: The release it starts at.
        flight: The free arc from the release to the first impact.
        hops: The rescaled flights from impact to impact; empty for a plastic impact.
        impacts: The resolved impacts, one more than hops that ended in one.
        zeno: The Zeno point.
        locked: The locked arc.
        end: The release it ends at.
    """

    state_names: tuple[str, ...]
    start: Release
    flight: Arc
    hops: tuple[Arc, ...]
    impacts: tuple[Impact, ...]
    zeno: ZenoPoint
    locked: Arc
    end: Release

    @property
    def period(self) -> float:
        """Time from release to release [s]."""
        return self.end.time - self.start.time

    def drift(self, scale: Vector) -> float:
        """Return the change of the release state over the cycle, in units of ``scale``."""
        return float(np.max(np.abs(self.end.state - self.start.state) / scale))

    def scale(self) -> Vector:
        """Return the size of each state over the cycle, ``(n_x,)``, nowhere zero."""
        return self._sizes.copy()

    def scale_at_events(self) -> Vector:
        """Return the size of each state at the events of the cycle, ``(n_x,)``, nowhere near zero.

        Sizes in between cost an integration with some engines. A state that vanishes at every
        event, as the gap does, does not drift there; it is given the largest size.
        """
        sizes = np.max(np.abs(self._event_states()), axis=0)
        largest = float(np.max(sizes))
        return np.where(sizes > _VANISHING * largest, sizes, largest if largest > 0.0 else 1.0)

    def _event_states(self) -> Vector:
        ends = [self.start.state, self.zeno.state, self.end.state]
        return np.array([*ends, *(x for i in self.impacts for x in (i.state_minus, i.state_plus))])

    @cached_property
    def _sizes(self) -> Vector:
        # Between impacts only the gap has its largest value inside, and it is tiny there.
        inside = [self.flight.flow_states, self.locked.flow_states]
        sizes = np.max(np.abs(np.concatenate([self._event_states(), *inside])), axis=0)
        return np.where(sizes > 0.0, sizes, 1.0)


def cycles(execution: Execution, *, start: Vector | None = None) -> list[Cycle]:
    """Return the periods of an execution, each from a release through one Zeno point to the next.

    Args:
        execution: The execution.
        start: Its initial state, if it starts at a release.
    """
    found: list[Cycle] = []
    releases = execution.releases
    if start is not None:
        releases = (Release(time=0.0, state=start), *execution.returns(execution.end_time))
    for first, last in pairwise(releases):
        arcs = [a for a in execution.arcs if first.time <= a.start_time and a.end_time <= last.time]
        zenos = [z for z in execution.zeno_points if first.time < z.time < last.time]
        impacts = [i for i in execution.impacts if first.time < i.time < last.time]
        free = [arc for arc in arcs if arc.mode is Mode.FREE and arc.ending is Ending.IMPACT]
        locked = [arc for arc in arcs if arc.mode is Mode.LOCKED and arc.start_time > first.time]
        if len(zenos) == 1 and len(locked) == 1 and free and impacts:
            found.append(
                Cycle(
                    state_names=execution.state_names,
                    start=first,
                    flight=free[0],
                    hops=tuple(free[1:]),
                    impacts=tuple(impacts),
                    zeno=zenos[0],
                    locked=locked[0],
                    end=last,
                )
            )
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Closure:
    """How many impacts are resolved before the Zeno limit, and which of them tell it.

    Attributes:
        n_impacts: Impacts resolved one by one.
        nodes: Index of each impact that the extrapolation uses, the first impact being 0.
        error: Estimated error of the limit, relative to ``1 + |x|``.
    """

    n_impacts: int
    nodes: tuple[int, ...]
    error: float


def closure_of(cycle: Cycle, dynamics: HybridDynamics, tolerance: float) -> Closure:
    """Return the shortest closure whose estimated error is below a tolerance.

    Args:
        cycle: One period.
        dynamics: The system that made it.
        tolerance: Largest estimated error; all impacts are used if none reaches it.
    """
    estimates: list[TailEstimate] = []
    first, best = 0, Closure(n_impacts=1, nodes=(0,), error=np.inf)
    for index, impact in enumerate(cycle.impacts):
        speed = -dynamics.restitution * impact.approach_rate
        estimate = estimate_tail(dynamics, impact.time, impact.state_plus, speed)
        if estimate is None or (estimates and speed >= estimates[-1].speed):
            estimates, first = [], index + 1
        if estimate is None:
            continue
        first = index if not estimates else first
        estimates.append(estimate)
        limit = extrapolate(dynamics, estimates)
        nodes = spread_nodes([one.speed for one in estimates])
        used = tuple(first + node for node in nodes)
        best = Closure(n_impacts=index + 1, nodes=used, error=limit.error)
        if limit.error <= tolerance:
            break
    return best
