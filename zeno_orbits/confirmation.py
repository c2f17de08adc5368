"""A solution of a program held against a simulation of one period from its release.

Ipopt's word is not an orbit: only what a simulation follows is one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.bounds import KEPT, Bound, Extent, excess
from zeno_orbits.compiled import CompiledSystem, bind
from zeno_orbits.cycle import Cycle, cycles
from zeno_orbits.dynamics import HybridDynamics, Vector
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.finds import Find, SearchStatus
from zeno_orbits.nlp import Solution
from zeno_orbits.objectives import Objective, WantedAmplitude, WantedPeriod
from zeno_orbits.orbit import OrbitImpact, ZenoOrbit, versions
from zeno_orbits.poincare import to_next_release
from zeno_orbits.problem import Problem, Setting
from zeno_orbits.signals import extent_of, signal, signal_names
from zeno_orbits.simulate import SimulationSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class Confirmation:
    """How solutions are confirmed.

    Attributes:
        problem: The scene.
        compiled: Its functions.
        bounds: What must be kept at all times.
        agreement: Largest relative difference of program and simulation over one period.
    """

    problem: Problem
    compiled: CompiledSystem
    bounds: tuple[Bound, ...]
    agreement: float

    def of(self, find: Find, setting: Setting, objective: Objective | None) -> Find:
        """Simulate one period of a solution and compare.

        Args:
            find: What is known; its solution is the one.
            setting: Numbers of the solution.
            objective: What was asked, if anything was free.
        """
        solution = find.solution
        if solution is None:
            return find
        dynamics = bind(self.compiled, setting.values())
        release = dynamics.on_stop(solution.values["release state"][:, 0])
        period = float(solution.values["period"][0, 0])
        cycle = one_cycle(dynamics, release, 2 * period)
        if cycle is None:
            detail = "From the solution's release no Zeno point and release follow."
            return replace(find, status=SearchStatus.NOT_FOLLOWED, detail=detail)
        differs = max(_difference(cycle, solution), _miss(objective, cycle))
        excesses = self.excesses(setting, cycle)
        detail = ""
        if differs > self.agreement:
            detail = f"Solution and simulation differ by {differs:.1e}."
        elif excesses:
            worst = max(excesses.items(), key=lambda item: item[1])
            detail = f"Between its nodes `{worst[0]}` passes its bound by {worst[1]:.1e}."
        return replace(
            find,
            status=SearchStatus.NOT_FOLLOWED if detail else SearchStatus.FOUND,
            detail=detail,
            orbit=None if detail else self.orbit(solution, setting, release),
            setting=setting,
            cycle=cycle,
            agreement=differs,
            excesses=excesses,
        )

    def excesses(self, setting: Setting, cycle: Cycle) -> dict[str, float]:
        """Return by how much a simulated period passes the bounds of signals that it passes."""
        known = signal_names(self.compiled)
        arcs = (cycle.flight, *cycle.hops, cycle.locked)
        found: dict[str, float] = {}
        for bound in self.bounds:
            if bound.name in known:
                value = signal(self.compiled, bound.name).at(setting.values())
                extent: Extent = extent_of(value, arcs)
                size = excess(bound, extent)
                if size > KEPT * max(extent.largest, 1.0) / 2:
                    found[bound.name] = max(found.get(bound.name, 0.0), size)
        return found

    def orbit(self, solution: Solution, setting: Setting, release: Vector) -> ZenoOrbit:
        """Return the orbit of a solution."""
        values = solution.values
        times = np.cumsum(values["flight times"][:, 0])
        dynamics = bind(self.compiled, setting.values())
        return ZenoOrbit(
            problem=self.problem.name,
            parameters=dict(setting.parameters),
            gains=dict(setting.gains),
            period=float(values["period"][0, 0]),
            release_state=self.named(release),
            impacts=tuple(
                OrbitImpact(time=float(time), state_minus=self.named(state))
                for time, state in zip(times, values["impact states"].T, strict=True)
            ),
            zeno_time=float(values["Zeno time"][0, 0]),
            zeno_state=self.named(dynamics.on_stop(values["Zeno state"][:, 0])),
            certificate={},
            versions=versions(),
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


def one_cycle(dynamics: HybridDynamics, release: Vector, horizon: float) -> Cycle | None:
    """Return the period that starts at a release state, at full accuracy."""
    settings = SimulationSettings()
    try:
        run = to_next_release(dynamics, release, horizon=horizon, settings=settings)
    except ZenoOrbitsError:
        return None
    found = cycles(run, start=release)
    return found[0] if found else None


def _difference(cycle: Cycle, solution: Solution) -> float:
    """Return the largest difference of a solution from a simulated cycle, relative."""
    period = float(solution.values["period"][0, 0])
    zeno_time = float(solution.values["Zeno time"][0, 0])
    zeno = solution.values["Zeno state"][:, 0]
    return max(
        cycle.drift(cycle.scale()),
        abs(cycle.period - period) / period,
        abs(cycle.zeno.time - zeno_time) / period,
        float(np.max(np.abs(cycle.zeno.state - zeno) / cycle.scale())),
        _impact_difference(cycle, solution),
    )


def _impact_difference(cycle: Cycle, solution: Solution) -> float:
    """Return the largest difference of a solution's impacts from a cycle's, relative."""
    times = np.cumsum(solution.values["flight times"][:, 0])
    states = solution.values["impact states"].T
    return max(
        max(
            abs(impact.time - cycle.start.time - time) / cycle.period,
            float(np.max(np.abs(impact.state_minus - state) / cycle.scale())),
        )
        for impact, time, state in zip(cycle.impacts, times, states, strict=False)
    )


def _miss(objective: Objective | None, cycle: Cycle) -> float:
    """Return how far a simulated cycle is from a wanted value, relative; 0 if none is wanted."""
    if not isinstance(objective, WantedPeriod | WantedAmplitude):
        return 0.0
    return abs(objective.measured(cycle) - objective.target) / objective.target
