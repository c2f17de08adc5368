"""One start of a search: guess, transcribe, solve, and simulate what came out.

Every solution is simulated for one period and the mesh is drawn anew on that period, until
program and simulation agree.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from zeno_orbits.model.numeric.compiled import CompiledSystem
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.model.problem import ParameterValues, Problem
from zeno_orbits.orbits.bounds import Bound
from zeno_orbits.orbits.cycle import Cycle
from zeno_orbits.orbits.shape import OrbitShape
from zeno_orbits.search.confirmation import Confirmation, tightened
from zeno_orbits.search.constraints import keep
from zeno_orbits.search.objectives import Objective
from zeno_orbits.search.settings import Find, SearchSettings, SearchStatus
from zeno_orbits.search.spectral_radius import section_map
from zeno_orbits.search.transcription.closure import closures_of
from zeno_orbits.search.transcription.ipopt import (
    Hessian,
    IpoptSettings,
    Solution,
    SolveStatus,
    solve,
)
from zeno_orbits.search.transcription.transcribe import OrbitTerms, transcribe

COARSE = 100.0
"""First mesh of a search for gains, in units of the mesh tolerance; the gains still move."""

ON_THE_WAY = 1e-4
"""Agreement of program and simulation that suffices for a value on the way to a wanted one."""

_FEASIBLE = 1e-6
"""Violation of rows with which an iterate may still be an orbit, though not the best one."""

_EXCHANGES = 2
"""Rounds in which a bound's places are drawn anew before it is asked for less instead."""

_NEAR = 1e-3
"""Weight of nearness while the violation of bounds is made as small as may be."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Hunt:
    """A search: its problem, its question and how hard to look.

    Attributes:
        problem: The problem.
        compiled: Its functions.
        values: Its numbers; what is free is near them if nothing else is asked.
        free: Name to bounds of the gains and parameters to be found.
        objective: What is asked.
        bounds: What the orbit must keep.
        settings: How hard to look.
        shape: The shape of the orbits that are wanted; any by default.
        tell: Called with what is being done.
    """

    problem: Problem
    compiled: CompiledSystem
    values: ParameterValues
    free: Mapping[str, tuple[float, float]]
    objective: Objective
    bounds: tuple[Bound, ...]
    settings: SearchSettings
    shape: OrbitShape | None
    tell: Callable[[str], None]

    def refine(
        self,
        values: ParameterValues,
        cycle: Cycle,
        objective: Objective,
        origin: ParameterValues | None = None,
    ) -> Find:
        """Solve on the mesh of a cycle, simulate the solution, and again on the mesh of that.

        Args:
            values: Numbers of the cycle.
            cycle: One simulated period.
            objective: What is asked.
            origin: Where the search started, by default here.
        """
        find = Find(status=SearchStatus.NOT_SOLVED)
        origin = origin or values
        hunt, coarse = self, COARSE if self.free else 1.0
        rounds = self.settings.rounds + (_EXCHANGES if self.bounds else 0)
        for refinement in range(rounds):
            # A finer mesh than the settings' own is of no use to an exchange of places.
            fineness = coarse * 0.1 ** min(refinement, self.settings.rounds)
            find = hunt.solve_once(origin, values, cycle, objective, fineness)
            if find.status is SearchStatus.FOUND or find.cycle is None or find.values is None:
                return find
            if find.status is SearchStatus.NOT_SOLVED and not find.agreement < ON_THE_WAY:
                return find
            values, cycle = find.values, find.cycle
            if refinement >= _EXCHANGES:
                hunt = replace(hunt, bounds=tightened(hunt.bounds, find.excesses))
        return find

    def solve_once(
        self,
        origin: ParameterValues,
        values: ParameterValues,
        cycle: Cycle,
        objective: Objective,
        coarseness: float = 1.0,
    ) -> Find:
        """Solve one program and hold its solution against a simulation."""
        terms, closure_error = self.transcribed(origin, values, cycle, coarseness, objective)
        square = not self.free
        if not square:
            for bound in self.bounds:
                keep(terms, bound)
        return self.solved(
            terms, closure_error, None if square else objective.cost(terms), values, objective
        )

    def least_violation(
        self, origin: ParameterValues, values: ParameterValues, cycle: Cycle
    ) -> Find:
        """Solve with the bounds as wishes: the sum of what they are passed by is least."""
        terms, closure_error = self.transcribed(origin, values, cycle, COARSE, None)
        total = ca.MX(0)
        for k, bound in enumerate(self.bounds):
            name = f"slack {k}"
            slack = terms.program.variable(name, 0.1, lower=0.0)[0, 0]
            terms.program.report(f"excess {k}", slack * keep(terms, bound, slack))
            total += slack
        for name, unknown in terms.free.items():
            low, high = self.free[name]
            total += _NEAR * ((unknown - origin.number(name)) / (high - low)) ** 2
        return self.solved(terms, closure_error, total, values, None)

    def transcribed(
        self,
        origin: ParameterValues,
        values: ParameterValues,
        cycle: Cycle,
        coarseness: float,
        objective: Objective | None,
    ) -> tuple[OrbitTerms, float]:
        """Return the terms of a program around a cycle, and the error of its Zeno closure."""
        settings = self.settings.transcription
        dynamics = self.dynamics(values)
        closures = closures_of(cycle, dynamics, settings.closure_tolerance)
        terms = transcribe(
            self.compiled,
            values,
            dynamics=dynamics,
            cycle=cycle,
            closures=closures,
            free=self.free,
            first={name: origin.number(name) for name in self.free},
            settings=replace(settings, mesh_tolerance=coarseness * settings.mesh_tolerance),
        )
        asked = {bound.name for bound in self.bounds}
        if self.free and "spectral_radius" in asked.union(
            objective.quantities if objective else ()
        ):
            terms = replace(terms, return_slope=section_map(terms))
        return terms, max(closure.error for closure in closures)

    def solved(
        self,
        terms: OrbitTerms,
        closure_error: float,
        cost: ca.MX | None,
        values: ParameterValues,
        objective: Objective | None,
    ) -> Find:
        """Solve a program and hold its solution against a simulation."""
        program = terms.program.build(cost)
        solution = solve(program, self.ipopt(terms))
        find = Find(
            status=SearchStatus.NOT_SOLVED,
            detail=_complaint(solution, objective if self.free else None),
            solution=solution,
            closure_error=closure_error,
            n_unknowns=program.unknowns.numel(),
        )
        solved = solution.status in (SolveStatus.SOLVED, SolveStatus.ACCEPTABLE)
        if not solved and not solution.worst(1)[0][1] < _FEASIBLE:
            return find
        found = {
            name: float(np.clip(solution.values[f"free {name}"][0, 0], *self.free[name]))
            for name in self.free
        }
        confirmation = Confirmation(
            problem=self.problem,
            compiled=self.compiled,
            bounds=self.bounds if self.free else (),
            agreement=self.settings.agreement,
        )
        asked = objective if self.free else None
        confirmed = confirmation.of(find, values.replaced(found), asked, terms.shape)
        if solved:
            return confirmed
        # An orbit it may be, but not the best one: good for a step on the way.
        return replace(confirmed, status=SearchStatus.NOT_SOLVED, detail=find.detail, orbit=None)

    def ipopt(self, terms: OrbitTerms) -> IpoptSettings:
        """Return how to solve a program: second derivatives where they cost less than they save."""
        settings = self.settings.ipopt
        if not self.free or terms.return_slope is not None:
            return replace(settings, hessian=Hessian.LIMITED_MEMORY)
        return settings

    def dynamics(self, values: ParameterValues) -> HybridDynamics:
        """Return the system at given numbers."""
        return self.problem.dynamics(values)

    def numbers(self, values: ParameterValues) -> dict[str, float]:
        """Return the numbers to name a start by: all gains, and the parameters that are free."""
        free = {name: values.number(name) for name in self.free}
        return {**values.gains, **free}


def _complaint(solution: Solution, objective: Objective | None) -> str:
    """Return what was asked, how the solver ended and which conditions it missed most."""
    asked = "At these gains" if objective is None else f"Asked for {objective.wish}"
    worst = [f"`{name}` by {size:.1e}" for name, size in solution.worst() if size > 1e-9]
    missed = f"; missed: {', '.join(worst)}" if worst else ""
    return f"{asked}, {solution.status.value}{missed}."
