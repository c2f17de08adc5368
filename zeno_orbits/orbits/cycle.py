"""One period of an execution, cut out where its section is passed: the raw material of an orbit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.orbits.period import round_trip
from zeno_orbits.orbits.phases import Moment, Phase, kinds_of, phases_of
from zeno_orbits.orbits.shape import OrbitShape
from zeno_orbits.simulation.execution import Arc, Execution, Impact, ZenoPoint
from zeno_orbits.simulation.simulator import SimulationSettings
from zeno_orbits.simulation.zeno_limit import TailEstimate, estimate_tail, extrapolate, spread_nodes

_VANISHING = 1e-9
"""Part of the largest state below which one is rounding."""


@dataclass(frozen=True, kw_only=True)
class Cycle:
    """The phases of a period: mostly release, flight, impacts, Zeno point, locked arc, release.

    Attributes:
        state_names: Name of each state.
        phases: The phases, one after the other, at least one.
    """

    state_names: tuple[str, ...]
    phases: tuple[Phase, ...]

    @property
    def shape(self) -> OrbitShape:
        """Their kinds."""
        return OrbitShape(phases=kinds_of(self.phases))

    @property
    def start(self) -> Moment:
        """Where it starts: a release, or just after an impact."""
        return self.phases[0].start

    @property
    def end(self) -> Moment:
        """Where it ends, likewise."""
        return self.phases[-1].end

    @property
    def period(self) -> float:
        """Time from start to end [s]."""
        return self.end.time - self.start.time

    @property
    def arcs(self) -> tuple[Arc, ...]:
        """All arcs that have a flow."""
        return tuple(arc for phase in self.phases for arc in phase.arcs)

    @property
    def impacts(self) -> tuple[Impact, ...]:
        """All resolved impacts."""
        return tuple(impact for phase in self.phases for impact in phase.impacts)

    @property
    def flight(self) -> Arc:
        """The first flight."""
        return self.phases[0].flight

    @property
    def hops(self) -> tuple[Arc, ...]:
        """The flights between impacts that accumulate."""
        return tuple(hop for phase in self.phases for hop in phase.hops)

    @property
    def zeno(self) -> ZenoPoint:
        """The Zeno point of a period that has one.

        Raises:
            InputError: If it has another number of them.
        """
        return self._held()[0]

    @property
    def locked(self) -> Arc:
        """The locked arc of a period that has one.

        Raises:
            InputError: If it has another number of them.
        """
        return self._held()[1]

    def _held(self) -> tuple[ZenoPoint, Arc]:
        self.shape.require_one_release()
        phase = self.phases[-1]
        if phase.zeno is None or phase.locked is None:
            raise ValueError("Argument `phases` must have a Zeno point where the stop holds.")
        return phase.zeno, phase.locked

    def drift(self, scale: Vector) -> float:
        """Return the change of the start over the cycle, in units of ``scale``."""
        return float(np.max(np.abs(self.end.state - self.start.state) / scale))

    def scale(self) -> Vector:
        """Return the size of each state over the cycle, ``(n_x,)``, nowhere zero."""
        return self._sizes.copy()

    def scale_at_events(self) -> Vector:
        """Return the size of each state at the events of the cycle, ``(n_x,)``, nowhere near zero.

        Sizes in between cost an integration with some engines. A state that vanishes at every
        event, as the gap does, does not drift there; it is given the largest size.
        """
        return self._sizes_at_events.copy()

    @cached_property
    def _sizes_at_events(self) -> Vector:
        sizes = np.max(np.abs(self._event_states()), axis=0)
        largest = float(np.max(sizes))
        return np.where(sizes > _VANISHING * largest, sizes, largest if largest > 0.0 else 1.0)

    def _event_states(self) -> Vector:
        ends = [self.start.state, *(phase.end.state for phase in self.phases)]
        ends += [phase.zeno.state for phase in self.phases if phase.zeno is not None]
        return np.array([*ends, *(x for i in self.impacts for x in (i.state_minus, i.state_plus))])

    @cached_property
    def _sizes(self) -> Vector:
        # Between impacts that accumulate only the gap has its largest value inside, and a tiny one.
        n_x = len(self.state_names)
        inside = [
            arc.flow_states[:, :n_x]
            for phase in self.phases
            for arc in (phase.flight, *(() if phase.locked is None else (phase.locked,)))
        ]
        sizes = np.max(np.abs(np.concatenate([self._event_states(), *inside])), axis=0)
        return np.where(sizes > 0.0, sizes, 1.0)


def cycles(execution: Execution, *, start: Vector | None = None) -> list[Cycle]:
    """Return the returns of an execution, each from a release to the next.

    Args:
        execution: The execution.
        start: Its initial state, if it starts at a release.
    """
    found: list[Cycle] = []
    passed: list[Phase] = []
    for phase in phases_of(execution, start):
        passed.append(phase)
        if phase.kind.holds:
            found.append(Cycle(state_names=execution.state_names, phases=tuple(passed)))
            passed = []
    return found


def cycle_of(
    dynamics: HybridDynamics,
    x: Vector,
    shape: OrbitShape,
    *,
    horizon: float,
    settings: SimulationSettings,
) -> Cycle:
    """Return the period of a shape that starts at a state of its section.

    Args:
        dynamics: The system.
        x: The state, ``(n_x,)``.
        shape: The shape.
        horizon: Longest time to wait for its end [s].
        settings: Accuracy.

    Raises:
        SimulationError: If the motion has another shape.
    """
    trip = round_trip(dynamics, x, shape, horizon=horizon, settings=settings)
    return Cycle(state_names=dynamics.state_names, phases=trip.phases)


_SAME = 1e-6
"""Starts of phases nearer than this, relative, make a period several of a shorter one."""


def gone_round_twice(cycle: Cycle) -> OrbitShape | None:
    """Return the shape of which a cycle that repeats is several periods, if it is."""
    for shape in cycle.shape.shorter:
        again = cycle.phases[shape.n_phases].start.state
        if float(np.max(np.abs(again - cycle.start.state) / cycle.scale())) <= _SAME:
            return shape
    return None


def round_again(cycle: Cycle) -> str:
    """Return that a cycle is several periods of a shorter shape, if it is, as a sentence."""
    shorter = gone_round_twice(cycle)
    if shorter is None:
        return ""
    n = cycle.shape.n_phases // shorter.n_phases
    what = f"The orbit of shape `{cycle.shape.text}` is one of shape `{shorter.text}`"
    return f"{what}, gone round {n} times."


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


def closures_of(cycle: Cycle, dynamics: HybridDynamics, tolerance: float) -> tuple[Closure, ...]:
    """Return the closure of each phase; one impact that does not hold closes without an error."""
    return tuple(
        Closure(n_impacts=1, nodes=(), error=0.0)
        if phase.zeno is None
        else closure_of(phase.impacts, dynamics, tolerance)
        for phase in cycle.phases
    )


def closure_of(impacts: Sequence[Impact], dynamics: HybridDynamics, tolerance: float) -> Closure:
    """Return the shortest closure whose estimated error is below a tolerance.

    Args:
        impacts: The impacts of a phase.
        dynamics: The system that made them.
        tolerance: Largest estimated error; all impacts are used if none reaches it.
    """
    estimates: list[TailEstimate] = []
    first, best = 0, Closure(n_impacts=1, nodes=(0,), error=np.inf)
    for index, impact in enumerate(impacts):
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
