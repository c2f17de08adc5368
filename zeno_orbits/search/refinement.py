"""From a simulated period to an orbit: transcribe, solve, and simulate the solution.

Every solution is simulated for one period. The mesh is then refined on this period, until program
and simulation agree.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from zeno_orbits.model import ParameterValues
from zeno_orbits.orbits import Cycle
from zeno_orbits.search.confirmation import confirm, tightened
from zeno_orbits.search.objectives import Objective
from zeno_orbits.search.outcome import StartOutcome
from zeno_orbits.search.search_problem import SearchProblem
from zeno_orbits.search.settings import SearchStatus
from zeno_orbits.search.transcription.closure import closures_of
from zeno_orbits.search.transcription.constraints import keep
from zeno_orbits.search.transcription.ipopt import (
    Hessian,
    IpoptSettings,
    Solution,
    SolveStatus,
    solve,
)
from zeno_orbits.search.transcription.spectral_radius import section_map
from zeno_orbits.search.transcription.transcribe import OrbitTerms, transcribe

COARSE = 100.0
"""First mesh of a search for gains, in units of the mesh tolerance, as the gains still change."""

ON_THE_WAY = 1e-4
"""Agreement of program and simulation that is sufficient for a step toward a target."""

_FEASIBLE = 1e-6
"""Largest violation of rows with which an iterate may be an orbit, though not the optimum."""

_EXCHANGES = 2
"""Rounds in which only the points of a bound are updated, before the bound itself is tightened."""

_NEAR = 1e-3
"""Weight of the distance from the start while the violation of bounds is minimised."""


def refine(
    search: SearchProblem,
    values: ParameterValues,
    cycle: Cycle,
    objective: Objective,
    origin: ParameterValues | None = None,
) -> StartOutcome:
    """Solve on the mesh of a cycle, simulate the solution, and repeat on the mesh of the solution.

    Args:
        search: The search.
        values: Gains and parameters of the cycle.
        cycle: One simulated period.
        objective: The objective.
        origin: Gains and parameters at the start of the search. The default is ``values``.
    """
    outcome = StartOutcome(status=SearchStatus.NOT_SOLVED)
    origin = origin or values
    coarse = COARSE if search.free else 1.0
    most = search.settings.rounds
    for refinement in range(most + (_EXCHANGES if search.bounds else 0)):
        # An update of the points of a bound does not need a finer mesh than the settings' mesh.
        fineness = coarse * 0.1 ** min(refinement, most)
        outcome = solve_once(search, origin, values, cycle, objective, fineness)
        solution = outcome.solution
        if outcome.status is SearchStatus.FOUND or solution is None:
            return outcome
        if outcome.status is SearchStatus.NOT_SOLVED and not outcome.agreement < ON_THE_WAY:
            return outcome
        values, cycle = solution.values, solution.cycle
        if refinement >= _EXCHANGES:
            search = replace(search, bounds=tightened(search.bounds, solution.excesses))
    return outcome


def solve_once(
    search: SearchProblem,
    origin: ParameterValues,
    values: ParameterValues,
    cycle: Cycle,
    objective: Objective,
    coarseness: float = 1.0,
) -> StartOutcome:
    """Solve one program and compare its solution with a simulation.

    Args:
        search: The search.
        origin: Gains and parameters at the start of the search.
        values: Gains and parameters of the cycle.
        cycle: One simulated period, the guess.
        objective: The objective.
        coarseness: Mesh tolerance in units of the settings' mesh tolerance.
    """
    terms, closure_error = _transcribed(search, origin, values, cycle, objective, coarseness)
    if not search.free:
        return _solved(search, terms, closure_error, None, values, objective)
    for bound in search.bounds:
        keep(terms, bound)
    return _solved(search, terms, closure_error, objective.cost(terms), values, objective)


def least_violation(
    search: SearchProblem, origin: ParameterValues, values: ParameterValues, cycle: Cycle
) -> StartOutcome:
    """Solve for the smallest total violation of the bounds.

    Args:
        search: The search.
        origin: Gains and parameters at the start of the search.
        values: Gains and parameters of the cycle.
        cycle: One simulated period, the guess.
    """
    terms, closure_error = _transcribed(search, origin, values, cycle, None, COARSE)
    total = ca.MX(0)
    for k, bound in enumerate(search.bounds):
        name = f"slack {k}"
        slack = terms.program.variable(name, 0.1, lower=0.0)[0, 0]
        terms.program.report(f"excess {k}", slack * keep(terms, bound, slack))
        total += slack
    for name, unknown in terms.free.items():
        low, high = search.free[name]
        total += _NEAR * ((unknown - origin.number(name)) / (high - low)) ** 2
    return _solved(search, terms, closure_error, total, values, None)


def _transcribed(
    search: SearchProblem,
    origin: ParameterValues,
    values: ParameterValues,
    cycle: Cycle,
    objective: Objective | None,
    coarseness: float,
) -> tuple[OrbitTerms, float]:
    """Return the terms of a program around a cycle, and the error of the Zeno closure."""
    settings = search.settings.transcription
    dynamics = search.dynamics(values)
    closures = closures_of(cycle, dynamics, settings.closure_tolerance)
    terms = transcribe(
        search.compiled,
        values,
        dynamics=dynamics,
        cycle=cycle,
        closures=closures,
        free=search.free,
        nearness=search.nearness(origin),
        settings=replace(settings, mesh_tolerance=coarseness * settings.mesh_tolerance),
    )
    asked = {bound.name for bound in search.bounds}
    asked.update(objective.quantities if objective else ())
    if search.free and "spectral_radius" in asked:
        terms = replace(terms, return_slope=section_map(terms))
    return terms, max(closure.error for closure in closures)


def _solved(
    search: SearchProblem,
    terms: OrbitTerms,
    closure_error: float,
    cost: ca.MX | None,
    values: ParameterValues,
    objective: Objective | None,
) -> StartOutcome:
    """Solve a program and compare its solution with a simulation."""
    asked = objective if search.free else None
    program = terms.program.build(cost)
    solution = solve(program, _ipopt_settings(search, terms))
    outcome = StartOutcome(
        status=SearchStatus.NOT_SOLVED,
        detail=_complaint(solution, asked),
        residuals=solution.residuals,
        closure_error=closure_error,
        n_unknowns=program.unknowns.numel(),
        iterations=solution.iterations,
        solve_time=solution.wall_time,
    )
    solved = solution.status in (SolveStatus.SOLVED, SolveStatus.ACCEPTABLE)
    if not solved and not solution.worst(1)[0][1] < _FEASIBLE:
        return outcome
    found = {
        name: float(np.clip(solution.values[f"free {name}"][0, 0], *search.free[name]))
        for name in search.free
    }
    confirmed = confirm(
        search, outcome, solution.values, values.replaced(found), asked, terms.shape
    )
    if solved:
        return confirmed
    # This may be an orbit, but not the optimum. It is usable as an intermediate step.
    return replace(confirmed, status=outcome.status, detail=outcome.detail)


def _ipopt_settings(search: SearchProblem, terms: OrbitTerms) -> IpoptSettings:
    """Return the solver settings of a program, with exact second derivatives if they save time."""
    settings = search.settings.ipopt
    if not search.free or terms.return_slope is not None:
        return replace(settings, hessian=Hessian.LIMITED_MEMORY)
    return settings


def _complaint(solution: Solution, objective: Objective | None) -> str:
    """Return the objective, the status of the solver and the largest violations, as a sentence."""
    asked = "At these gains" if objective is None else f"Asked for {objective.wish}"
    worst = [f"`{name}` by {size:.1e}" for name, size in solution.worst() if size > 1e-9]
    missed = f"; missed: {', '.join(worst)}" if worst else ""
    return f"{asked}, {solution.status.value}{missed}."
