"""A solution of a program held against a simulation of one period from its release.

Ipopt's word is not an orbit: only what a simulation follows is one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.model.numeric.compiled import CompiledSystem
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.model.problem import ParameterValues, Problem
from zeno_orbits.orbits.bounds import KEPT, Bound, excess
from zeno_orbits.orbits.cycle import Cycle, round_again
from zeno_orbits.orbits.orbit import OrbitImpact, OrbitPhase, ZenoOrbit, new_orbit
from zeno_orbits.orbits.period import cycle_of, placed
from zeno_orbits.orbits.phases import Moment
from zeno_orbits.orbits.shape import ONE_ZENO, OrbitShape
from zeno_orbits.search.objectives import Objective, WantedAmplitude, WantedPeriod
from zeno_orbits.search.settings import Find, SearchStatus
from zeno_orbits.search.transcription.ipopt import Solution
from zeno_orbits.search.transcription.transcribe import labels_of, start_block
from zeno_orbits.simulation.execution import Impact, ZenoPoint
from zeno_orbits.simulation.signals import Extent, extent_of, signal, signal_names
from zeno_orbits.simulation.simulator import SimulationSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class Confirmation:
    """How solutions are confirmed.

    Attributes:
        problem: The problem.
        compiled: Its functions.
        bounds: What must be kept at all times.
        agreement: Largest relative difference of program and simulation over one period.
    """

    problem: Problem
    compiled: CompiledSystem
    bounds: tuple[Bound, ...]
    agreement: float

    def of(
        self, find: Find, values: ParameterValues, objective: Objective | None, shape: OrbitShape
    ) -> Find:
        """Simulate one period of a solution and compare.

        Args:
            find: What is known; its solution is the one.
            values: Numbers of the solution.
            objective: What was asked, if anything was free.
            shape: The shape of the solution.
        """
        solution = find.solution
        if solution is None:
            return find
        dynamics = self.problem.dynamics(values)
        start = solution.values[start_block(shape, 0)][:, 0]
        start = placed(dynamics, shape, start)
        period = float(solution.values["period"][0, 0])
        cycle = one_cycle(dynamics, start, 2 * period, shape)
        if cycle is None:
            detail = "From the solution's release no Zeno point and release follow."
            if not shape.has_one_release:
                detail = f"From the solution's start no period of shape `{shape.text}` follows."
            return replace(find, status=SearchStatus.NOT_FOLLOWED, detail=detail)
        differs = max(_difference(cycle, solution), _miss(objective, cycle))
        excesses = self.excesses(values, cycle)
        detail = round_again(cycle)
        if not detail and differs > self.agreement:
            detail = f"Solution and simulation differ by {differs:.1e}."
        elif not detail and excesses:
            worst = max(excesses.items(), key=lambda item: item[1])
            detail = f"Between its nodes `{worst[0]}` passes its bound by {worst[1]:.1e}."
        return replace(
            find,
            status=SearchStatus.NOT_FOLLOWED if detail else SearchStatus.FOUND,
            detail=detail,
            orbit=None if detail else self.orbit(solution, values, shape),
            values=values,
            cycle=cycle,
            agreement=differs,
            excesses=excesses,
        )

    def excesses(self, values: ParameterValues, cycle: Cycle) -> dict[str, float]:
        """Return by how much a simulated period passes the bounds of signals that it passes."""
        known = signal_names(self.compiled)
        arcs = cycle.arcs
        found: dict[str, float] = {}
        for bound in self.bounds:
            if bound.name in known:
                value = signal(self.compiled, bound.name).at(values.vector)
                extent: Extent = extent_of(value, arcs)
                size = excess(bound, extent)
                if size > KEPT * max(extent.largest, 1.0) / 2:
                    found[bound.name] = max(found.get(bound.name, 0.0), size)
        return found

    def orbit(self, solution: Solution, values: ParameterValues, shape: OrbitShape) -> ZenoOrbit:
        """Return the orbit of a solution."""
        dynamics = self.problem.dynamics(values)
        period = float(solution.values["period"][0, 0])
        starts = [*_start_times(solution, shape), period]
        return new_orbit(
            self.problem,
            values,
            period=period,
            phases=tuple(
                self._phase(solution, dynamics, shape, k, starts[k]) for k in range(shape.n_phases)
            ),
        )

    def _phase(
        self, solution: Solution, dynamics: HybridDynamics, shape: OrbitShape, k: int, start: float
    ) -> OrbitPhase:
        values, label, kind = solution.values, labels_of(shape)[k], shape.phases[k]
        before = OrbitShape(phases=(shape.phases[k - 1],))
        times = start + np.cumsum(values[f"{label}flight times"][:, 0])
        states = values[f"{label}impact states"].T
        zeno_time, zeno_state = None, None
        if kind.holds:
            zeno_time = float(values[f"{label}Zeno time"][0, 0])
            zeno_state = self.named(dynamics.on_stop(values[f"{label}Zeno state"][:, 0]))
        return OrbitPhase(
            kind=kind,
            start_time=start,
            start_state=self.named(placed(dynamics, before, values[start_block(shape, k)][:, 0])),
            impacts=tuple(
                OrbitImpact(time=float(time), state_minus=self.named(state))
                for time, state in zip(times, states, strict=True)
            ),
            zeno_time=zeno_time,
            zeno_state=zeno_state,
        )

    def named(self, state: Vector) -> dict[str, float]:
        """Return state name to value."""
        return dict(zip(self.problem.state_names, map(float, state), strict=True))


def tightened(bounds: Sequence[Bound], excesses: Mapping[str, float]) -> tuple[Bound, ...]:
    """Return bounds drawn in by what a simulation passed them by."""

    def drawn_in(bound: Bound) -> Bound:
        by = excesses.get(bound.name, 0.0)
        if 2 * by >= bound.upper - bound.lower:
            return bound
        return replace(bound, lower=bound.lower + by, upper=bound.upper - by)

    return tuple(drawn_in(bound) for bound in bounds)


def one_cycle(
    dynamics: HybridDynamics, start: Vector, horizon: float, shape: OrbitShape = ONE_ZENO
) -> Cycle | None:
    """Return the period of a shape that starts at a state, at full accuracy."""
    settings = SimulationSettings()
    try:
        return cycle_of(dynamics, start, shape, horizon=horizon, settings=settings)
    except ZenoOrbitsError:
        return None


def _start_times(solution: Solution, shape: OrbitShape) -> list[float]:
    """Return when the phases of a solution start [s]."""
    return [float(solution.values[f"{label}start time"][0, 0]) for label in labels_of(shape)]


def _difference(cycle: Cycle, solution: Solution) -> float:
    """Return the largest difference of a solution from a simulated cycle, relative."""
    values, period, scale = solution.values, cycle.period, cycle.scale()

    def apart(time: float, state: Vector, at: Moment | Impact | ZenoPoint) -> float:
        seen = at.state_minus if isinstance(at, Impact) else at.state
        late = abs(at.time - cycle.start.time - time) / period
        return max(late, float(np.max(np.abs(seen - state) / scale)))

    found = [cycle.drift(scale), abs(period - float(values["period"][0, 0])) / period]
    shape = cycle.shape
    starts = _start_times(solution, shape)
    for k, (label, phase) in enumerate(zip(labels_of(shape), cycle.phases, strict=True)):
        if k > 0:
            found.append(apart(starts[k], values[start_block(shape, k)][:, 0], phase.start))
        if phase.zeno is not None:
            zeno = values[f"{label}Zeno state"][:, 0]
            found.append(apart(float(values[f"{label}Zeno time"][0, 0]), zeno, phase.zeno))
        times = starts[k] + np.cumsum(values[f"{label}flight times"][:, 0])
        states = values[f"{label}impact states"].T
        for impact, time, state in zip(phase.impacts, times, states, strict=False):
            found.append(apart(float(time), state, impact))
    return max(found)


def _miss(objective: Objective | None, cycle: Cycle) -> float:
    """Return how far a simulated cycle is from a wanted value, relative; 0 if none is wanted."""
    if not isinstance(objective, WantedPeriod | WantedAmplitude):
        return 0.0
    return abs(objective.measured(cycle) - objective.target) / objective.target
