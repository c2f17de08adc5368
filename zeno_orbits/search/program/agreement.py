"""The agreement of a simulated orbit with a program at fixed values.

The program has as many equations as unknowns, and shares neither integrator nor events with the
simulation from which it starts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from zeno_orbits.model import GraphDynamics
from zeno_orbits.orbits import EventReturn, largest_states
from zeno_orbits.search.program.elements import ElementBuilder, ElementSolution
from zeno_orbits.search.program.ipopt import IpoptSettings, SolveStatus
from zeno_orbits.search.program.writer import PeriodProgram, TranscriptionSettings, write_period

_SETTINGS = IpoptSettings(optimality=1e-8, most_iterations=60, most_seconds=1e9, first_barrier=1e-5)


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """A solved program beside the orbit at which it starts.

    Attributes:
        difference: Largest relative difference of states and times of events. Infinite if the
            program is not solved.
        closure_error: Estimated relative error of the Zeno points. Zero without one.
        status: Status of the program.
        residuals: Row name to scaled violation.
        n_unknowns: Number of unknowns.
        iterations: Number of Ipopt iterations.
        solve_time: Wall time in Ipopt [s].
    """

    difference: float
    closure_error: float
    status: SolveStatus
    residuals: Mapping[str, float]
    n_unknowns: int
    iterations: int
    solve_time: float


def agreement_of(
    graph: GraphDynamics, found: EventReturn, settings: TranscriptionSettings
) -> Agreement:
    """Solve the program of an orbit at its own values, and compare.

    Args:
        graph: The graph of modes at these values.
        found: The orbit.
        settings: Scheme and tolerances of the program.
    """
    builder = ElementBuilder()
    period = write_period(builder, graph, found, {}, settings=settings)
    program = builder.built(is_square=True)
    solution = program.solve(_SETTINGS)
    is_solved = solution.status in (SolveStatus.SOLVED, SolveStatus.ACCEPTABLE)
    tails = [places.leg.tail for places in period.legs]
    return Agreement(
        difference=_difference(period, found, solution) if is_solved else np.inf,
        closure_error=max((tail.error for tail in tails if tail is not None), default=0.0),
        status=solution.status,
        residuals=solution.residuals,
        n_unknowns=len(program.guess),
        iterations=solution.iterations,
        solve_time=solution.wall_time,
    )


def _difference(period: PeriodProgram, found: EventReturn, solution: ElementSolution) -> float:
    """Return the largest relative difference of a solution from the orbit, and of its closing."""
    z, builder = solution.unknowns, period.builder
    sizes = largest_states(found.execution.arcs, period.graph)
    worst = float(np.max(np.abs(found.end - found.start) / sizes))
    late = 0.0
    for k, places in enumerate(period.legs):
        off = np.abs(z[places.start] - builder.value(places.start)) / sizes
        spans = [np.append(places.unit, places.duration)]
        if k in period.tails:
            spans.append(np.array([period.tails[k]]))
        late += sum(float(np.prod(z[one]) - np.prod(builder.value(one))) for one in spans)
        worst = max(worst, float(np.max(off)), abs(late) / found.period)
    return max(worst, abs(float(z[period.period]) / found.period - 1.0))
