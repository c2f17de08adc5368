"""One start of a search: guess, transcribe, solve, and simulate what came out.

Ipopt's word is not an orbit: every solution is simulated for one period and the mesh is drawn
anew on that period, until program and simulation agree.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from zeno_orbits.compiled import CompiledSystem, bind
from zeno_orbits.cycle import Cycle, closure_of, cycles
from zeno_orbits.dynamics import HybridDynamics, Vector
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.guess import SettlingSettings, settle
from zeno_orbits.nlp import Hessian, IpoptSettings, Solution, SolveStatus, solve
from zeno_orbits.objectives import NearestGains, Objective, WantedAmplitude, WantedPeriod
from zeno_orbits.orbit import OrbitImpact, ZenoOrbit, versions
from zeno_orbits.poincare import to_next_release
from zeno_orbits.problem import Problem, Setting
from zeno_orbits.shooting import TranscriptionSettings, transcribe
from zeno_orbits.simulate import SimulationSettings


class SearchStatus(Enum):
    """How a search ended. The value is the sentence shown to the user."""

    FOUND = "The search found an orbit."
    NO_GUESS = "No simulation settled to a motion with one Zeno point a period."
    NOT_SOLVED = "The conditions of the orbit could not be met."
    NOT_FOLLOWED = "A simulation does not follow the solution."
    NOT_ACCEPTED = "The orbits that were found were not accepted."


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchSettings:
    """How hard to look.

    Attributes:
        settling: How long a simulation may take to repeat itself.
        transcription: Scheme, mesh and closure.
        ipopt: Solver settings; the square case approximates the Hessian whatever they say.
        agreement: Largest relative difference of program and simulation over one period.
        rounds: Times the mesh is drawn anew.
        n_starts: Quasi-random starting gains after the given ones.
        first_step: Change of a wanted value that is tried at once, in units of the value.
        smallest_step: Smallest change before the search gives up, likewise.
        seed: Of the quasi-random gains.
    """

    settling: SettlingSettings = field(default_factory=SettlingSettings)
    transcription: TranscriptionSettings = field(default_factory=TranscriptionSettings)
    ipopt: IpoptSettings = field(default_factory=lambda: IpoptSettings(most_iterations=60))
    agreement: float = 3e-10
    rounds: int = 4
    n_starts: int = 12
    first_step: float = 0.03
    smallest_step: float = 0.003
    seed: int = 0

    def for_accuracy(self, accuracy: float) -> SearchSettings:
        """Return the cheapest settings that reach a relative accuracy of the orbit.

        A mesh is drawn anew, ten times finer, until program and simulation agree so far; the first
        one is what `zeno-orbits trade` measured to be near.
        """
        transcription = replace(
            self.transcription,
            mesh_tolerance=min(_MESH_FOR * accuracy, _COARSEST_MESH),
            closure_tolerance=max(0.03 * accuracy, 1e-12),
        )
        return replace(self, transcription=transcription, agreement=0.3 * accuracy)


_COARSEST_MESH = 1e-2
_MESH_FOR = 100.0
"""Mesh tolerance in units of the accuracy: ends of intervals are that much better than insides."""

_COARSE = 100.0
"""First mesh of a search for gains, in units of the mesh tolerance; the gains still move."""

_ON_THE_WAY = 1e-4
"""Agreement of program and simulation that suffices for a value on the way to a wanted one."""

_AT_BOUND = 0.02
"""A gain this near its bound, in units of its range, is said to be at it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Find:
    """What came of one start or one solve.

    Attributes:
        status: How it ended.
        detail: The reason in words, where there is no orbit.
        orbit: The orbit, if there is one.
        gains: Gains of the solution.
        cycle: One period simulated from the solution.
        solution: What the solver returned.
        agreement: Relative difference of solution and simulation.
        closure_error: Estimated error of the Zeno closure, relative.
        n_unknowns: Unknowns of the program.
        shortfall: How far from a wanted value the start ended.
    """

    status: SearchStatus
    detail: str = ""
    orbit: ZenoOrbit | None = None
    gains: Mapping[str, float] = field(default_factory=dict[str, float])
    cycle: Cycle | None = None
    solution: Solution | None = None
    agreement: float = np.inf
    closure_error: float = np.inf
    n_unknowns: int = 0
    shortfall: float = np.inf


@dataclass(frozen=True, slots=True, kw_only=True)
class Hunt:
    """A search: its scene, its question and how hard to look.

    Attributes:
        problem: The scene.
        compiled: Its functions.
        setting: Its numbers; the gains are those of the first start.
        free_gains: Name to bounds of the gains to be found.
        objective: What is asked.
        settings: How hard to look.
        tell: Called with what is being done.
    """

    problem: Problem
    compiled: CompiledSystem
    setting: Setting
    free_gains: Mapping[str, tuple[float, float]]
    objective: Objective
    settings: SearchSettings
    tell: Callable[[str], None]

    def from_gains(self, gains: Mapping[str, float]) -> Find:
        """Search from one set of gains."""
        dynamics = self.dynamics(gains)
        starts = [self.problem.state_vector(start) for start in self.problem.starts]
        settling = settle(dynamics, starts, self.settings.settling)
        if settling.cycle is None:
            where = f"At {listed(gains)}, " if gains else ""
            detail = f"{where}{settling.reason}."
            return Find(status=SearchStatus.NO_GUESS, detail=detail[0].upper() + detail[1:])
        # The noise of the loose settling would be meshed; one period costs little.
        start = settling.cycle.start.state
        cycle = _one_cycle(dynamics, start, 2 * settling.cycle.period) or settling.cycle
        if isinstance(self.objective, WantedPeriod | WantedAmplitude):
            return self.toward(gains, cycle, self.objective)
        if (
            isinstance(self.objective, NearestGains)
            and self.objective.target.items() <= gains.items()
        ):
            # Nothing is nearer than the target itself: its gains need no freedom.
            return replace(self, free_gains={}).refine(gains, cycle, self.objective)
        find = self.refine(gains, cycle, self.objective)
        if find.status is not SearchStatus.FOUND and isinstance(self.objective, NearestGains):
            # Nearness is a wish, the orbit the point: keep the one at the gains of the start.
            here = replace(self, free_gains={}).refine(gains, cycle, self.objective)
            if here.status is SearchStatus.FOUND:
                return replace(
                    here, detail="Its gains are not the nearest: the way there was lost."
                )
        return find

    def toward(
        self, gains: Mapping[str, float], cycle: Cycle, wanted: WantedPeriod | WantedAmplitude
    ) -> Find:
        """Reach a wanted value, directly if possible, else through values on the way."""
        here, last = wanted.measured(cycle), None
        start, growth = gains, 2.0
        step, smallest = self.settings.first_step, self.settings.smallest_step
        while step >= smallest:
            far = step * abs(wanted.target)
            ahead = wanted.target - here
            last_step = abs(ahead) <= far
            value = wanted.target if last_step else here + math.copysign(far, ahead)
            self.tell(f"asking for {wanted.at(value).wish}")
            if last_step:
                find = self.refine(gains, cycle, wanted, start)
            else:
                find = self.solve_once(start, gains, cycle, wanted.at(value), _COARSE)
            if find.status is SearchStatus.FOUND and last_step:
                return find
            if last_step or find.cycle is None or not find.agreement < _ON_THE_WAY:
                last, step, growth = find, step / 2, 1.0
                continue
            here, gains, cycle = value, find.gains, find.cycle
            step *= growth
        return self._short_of(wanted, here, gains, last)

    def _short_of(
        self,
        wanted: WantedPeriod | WantedAmplitude,
        here: float,
        gains: Mapping[str, float],
        last: Find | None,
    ) -> Find:
        """Return a failure that says how near a wanted value came, and what held it."""
        held = [
            f"{name} at its bound {bound:g}"
            for name, bounds in self.free_gains.items()
            for bound in bounds
            if abs(gains[name] - bound) <= _AT_BOUND * (bounds[1] - bounds[0])
        ]
        reached = f"The nearest that was reached is {wanted.at(here).wish}, at {listed(gains)}"
        detail = f"{reached} ({', '.join(held)})." if held else f"{reached}."
        return replace(
            last or Find(status=SearchStatus.NOT_SOLVED),
            status=SearchStatus.NOT_SOLVED,
            detail=f"{detail} {'' if last is None else last.detail}".strip(),
            shortfall=abs(wanted.target - here),
        )

    def refine(
        self,
        gains: Mapping[str, float],
        cycle: Cycle,
        objective: Objective,
        start: Mapping[str, float] | None = None,
    ) -> Find:
        """Solve on the mesh of a cycle, simulate the solution, and again on the mesh of that."""
        find = Find(status=SearchStatus.NOT_SOLVED)
        start = start or gains
        coarse = _COARSE if self.free_gains else 1.0
        for refinement in range(self.settings.rounds):
            find = self.solve_once(start, gains, cycle, objective, coarse * 0.1**refinement)
            if find.status is SearchStatus.FOUND or find.cycle is None:
                return find
            gains, cycle = find.gains, find.cycle
        return find

    def solve_once(
        self,
        start: Mapping[str, float],
        gains: Mapping[str, float],
        cycle: Cycle,
        objective: Objective,
        coarseness: float = 1.0,
    ) -> Find:
        """Solve one program and hold its solution against a simulation."""
        dynamics = self.dynamics(gains)
        tolerance = self.settings.transcription.closure_tolerance
        closure = closure_of(cycle, dynamics, tolerance)
        settings = self.settings.transcription
        terms = transcribe(
            self.compiled,
            replace(self.setting, gains=gains),
            dynamics=dynamics,
            cycle=cycle,
            closure=closure,
            free_gains=self.free_gains,
            first_gains=start,
            settings=replace(settings, mesh_tolerance=coarseness * settings.mesh_tolerance),
        )
        square = not self.free_gains
        cost = None if square else objective.cost(terms)
        ipopt = self.settings.ipopt
        program = terms.program.build(cost)
        solution = solve(
            program, replace(ipopt, hessian=Hessian.LIMITED_MEMORY) if square else ipopt
        )
        find = Find(
            status=SearchStatus.NOT_SOLVED,
            detail=_complaint(solution, objective if self.free_gains else None),
            solution=solution,
            closure_error=closure.error,
            n_unknowns=program.unknowns.numel(),
        )
        if solution.status not in (SolveStatus.SOLVED, SolveStatus.ACCEPTABLE):
            return find
        found = {
            name: float(solution.values[f"gain {name}"][0, 0]) if name in self.free_gains else value
            for name, value in gains.items()
        }
        return self.confirm(find, solution, found, objective)

    def confirm(
        self, find: Find, solution: Solution, gains: Mapping[str, float], objective: Objective
    ) -> Find:
        """Simulate one period of a solution and compare."""
        dynamics = self.dynamics(gains)
        release = dynamics.on_stop(solution.values["release state"][:, 0])
        period = float(solution.values["period"][0, 0])
        zeno_time = float(solution.values["Zeno time"][0, 0])
        zeno = solution.values["Zeno state"][:, 0]
        cycle = _one_cycle(dynamics, release, 2 * period)
        if cycle is None:
            detail = "From the solution's release no Zeno point and release follow."
            return replace(find, status=SearchStatus.NOT_FOLLOWED, detail=detail)
        agreement = max(
            cycle.drift(cycle.scale()),
            abs(cycle.period - period) / period,
            abs(cycle.zeno.time - zeno_time) / period,
            float(np.max(np.abs(cycle.zeno.state - zeno) / cycle.scale())),
            _impact_difference(cycle, solution),
            _miss(objective, cycle) if self.free_gains else 0.0,
        )
        agrees = agreement <= self.settings.agreement
        return replace(
            find,
            status=SearchStatus.FOUND if agrees else SearchStatus.NOT_FOLLOWED,
            detail="" if agrees else f"Solution and simulation differ by {agreement:.1e}.",
            orbit=self.orbit(solution, gains, release) if agrees else None,
            gains=gains,
            cycle=cycle,
            agreement=agreement,
        )

    def orbit(self, solution: Solution, gains: Mapping[str, float], release: Vector) -> ZenoOrbit:
        """Return the orbit of a solution."""
        values = solution.values
        times = np.cumsum(values["flight times"][:, 0])
        return ZenoOrbit(
            problem=self.problem.name,
            parameters=dict(self.setting.parameters),
            gains=dict(gains),
            period=float(values["period"][0, 0]),
            release_state=self.named(release),
            impacts=tuple(
                OrbitImpact(time=float(time), state_minus=self.named(state))
                for time, state in zip(times, values["impact states"].T, strict=True)
            ),
            zeno_time=float(values["Zeno time"][0, 0]),
            zeno_state=self.named(self.dynamics(gains).on_stop(values["Zeno state"][:, 0])),
            certificate={},
            versions=versions(),
        )

    def named(self, state: Vector) -> dict[str, float]:
        """Return state name to value."""
        return dict(zip(self.problem.state_names, map(float, state), strict=True))

    def dynamics(self, gains: Mapping[str, float]) -> HybridDynamics:
        """Return the system at given gains."""
        return bind(self.compiled, replace(self.setting, gains=gains).values())


def _one_cycle(dynamics: HybridDynamics, release: Vector, horizon: float) -> Cycle | None:
    """Return the period that starts at a release state, at full accuracy."""
    settings = SimulationSettings()
    try:
        run = to_next_release(dynamics, release, horizon=horizon, settings=settings)
    except ZenoOrbitsError:
        return None
    found = cycles(run, start=release)
    return found[0] if found else None


def _complaint(solution: Solution, objective: Objective | None) -> str:
    """Return what was asked, how the solver ended and which conditions it missed most."""
    asked = "At these gains" if objective is None else f"Asked for {objective.wish}"
    worst = [f"`{name}` by {size:.1e}" for name, size in solution.worst() if size > 1e-9]
    missed = f"; missed: {', '.join(worst)}" if worst else ""
    return f"{asked}, {solution.status.value}{missed}."


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


def _miss(objective: Objective, cycle: Cycle) -> float:
    """Return how far a simulated cycle is from a wanted value, relative; 0 if none is wanted."""
    if not isinstance(objective, WantedPeriod | WantedAmplitude):
        return 0.0
    return abs(objective.measured(cycle) - objective.target) / objective.target


def listed(gains: Mapping[str, float]) -> str:
    """Return gains in words."""
    return ", ".join(f"{name} = {value:.6g}" for name, value in gains.items()) or "the scene"
