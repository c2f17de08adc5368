"""Compare a solution of a program with a simulation of one period from its release.

A solution of Ipopt counts as an orbit only if a simulation reproduces it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from zeno_orbits.arrays import Array, Vector
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.model import HybridDynamics, ParameterValues
from zeno_orbits.orbits import (
    ONE_ZENO,
    Bound,
    Cycle,
    EventSequence,
    Moment,
    Orbit,
    OrbitImpact,
    OrbitPhase,
    allowance,
    cycle_of,
    excess,
    new_orbit,
    place_on_section,
    round_again,
)
from zeno_orbits.search.cycles import beyond_limits, named
from zeno_orbits.search.objectives import Objective, Target
from zeno_orbits.search.outcome import SimulatedSolution, StartOutcome
from zeno_orbits.search.search_problem import SearchProblem
from zeno_orbits.search.settings import SearchStatus
from zeno_orbits.search.transcription.transcribe import labels_of, start_block
from zeno_orbits.simulation import (
    Extent,
    Impact,
    SimulationSettings,
    ZenoPoint,
    extent_of,
    signal,
    signal_names,
)


def confirm(
    search: SearchProblem,
    outcome: StartOutcome,
    unknowns: Mapping[str, Array],
    values: ParameterValues,
    objective: Objective | None,
    shape: EventSequence,
) -> StartOutcome:
    """Simulate one period of a solution and compare.

    Args:
        search: The search.
        outcome: Outcome of the program so far.
        unknowns: Name of each block of unknowns and each report to its values in the solution.
        values: Gains and parameters of the solution.
        objective: The objective, or ``None`` without free values.
        shape: The shape of the solution.
    """
    dynamics = search.dynamics(values)
    start = place_on_section(dynamics, shape, unknowns[start_block(shape, 0)][:, 0])
    cycle = one_cycle(dynamics, start, 2 * float(unknowns["period"][0, 0]), shape)
    if cycle is None:
        detail = "From its release the simulation reaches no Zeno point with a later release."
        if not shape.has_one_release:
            detail = f"The simulation from its start does not follow the shape `{shape.text}`."
        return replace(outcome, status=SearchStatus.NOT_FOLLOWED, detail=detail)
    differs = _difference(cycle, unknowns)
    if isinstance(objective, Target):
        differs = max(differs, objective.miss(cycle))
    excesses = _excesses(search, values, cycle)
    beyond = beyond_limits(search.problem, cycle.arcs)
    detail = round_again(cycle) or (f"{beyond}." if beyond else "")
    if not detail and differs > search.settings.agreement:
        detail = f"Solution and simulation differ by {differs:.1e}."
    elif not detail and excesses:
        worst = max(excesses.items(), key=lambda item: item[1])
        detail = f"Between its nodes `{worst[0]}` exceeds its bound by {worst[1]:.1e}."
    return replace(
        outcome,
        status=SearchStatus.NOT_FOLLOWED if detail else SearchStatus.FOUND,
        detail=detail,
        agreement=differs,
        solution=SimulatedSolution(
            values=values,
            cycle=cycle,
            unknowns=unknowns,
            orbit=None if detail else _orbit(search, unknowns, values, shape),
            excesses=excesses,
        ),
    )


def _excesses(search: SearchProblem, values: ParameterValues, cycle: Cycle) -> dict[str, float]:
    """Return the excess over each bound that a signal violates in a simulated period."""
    known = signal_names(search.compiled)
    found: dict[str, float] = {}
    for bound in search.bounds if search.free else ():
        if bound.name in known:
            value = signal(search.compiled, bound.name).at(values.vector)
            extent: Extent = extent_of(value, cycle.arcs)
            size = excess(bound, extent)
            if size > allowance(bound, extent) / 2:
                found[bound.name] = max(found.get(bound.name, 0.0), size)
    return found


def _orbit(
    search: SearchProblem,
    unknowns: Mapping[str, Array],
    values: ParameterValues,
    shape: EventSequence,
) -> Orbit:
    """Return the orbit of a solution."""
    dynamics, problem = search.dynamics(values), search.problem
    period = float(unknowns["period"][0, 0])
    starts = _start_times(unknowns, shape)

    def phase(k: int) -> OrbitPhase:
        label, kind = labels_of(shape)[k], shape.phases[k]
        before = EventSequence(phases=(shape.phases[k - 1],))
        start = place_on_section(dynamics, before, unknowns[start_block(shape, k)][:, 0])
        times = starts[k] + np.cumsum(unknowns[f"{label}flight times"][:, 0])
        states = unknowns[f"{label}impact states"].T
        zeno_time, zeno_state = None, None
        if kind.holds:
            zeno_time = float(unknowns[f"{label}Zeno time"][0, 0])
            zeno_state = named(problem, dynamics.on_stop(unknowns[f"{label}Zeno state"][:, 0]))
        return OrbitPhase(
            kind=kind,
            start_time=starts[k],
            start_state=named(problem, start),
            impacts=tuple(
                OrbitImpact(time=float(time), state_minus=named(problem, state))
                for time, state in zip(times, states, strict=True)
            ),
            zeno_time=zeno_time,
            zeno_state=zeno_state,
        )

    return new_orbit(
        problem, values, period=period, phases=tuple(phase(k) for k in range(shape.n_phases))
    )


def tightened(bounds: Sequence[Bound], excesses: Mapping[str, float]) -> tuple[Bound, ...]:
    """Return bounds tightened by the excesses of a simulation."""

    def drawn_in(bound: Bound) -> Bound:
        by = excesses.get(bound.name, 0.0)
        if 2 * by >= bound.upper - bound.lower:
            return bound
        return replace(bound, lower=bound.lower + by, upper=bound.upper - by)

    return tuple(drawn_in(bound) for bound in bounds)


def one_cycle(
    dynamics: HybridDynamics, start: Vector, horizon: float, shape: EventSequence = ONE_ZENO
) -> Cycle | None:
    """Simulate the period of a shape that starts at a state, at full accuracy.

    Args:
        dynamics: The system.
        start: Initial state on the section of the shape, ``(n_x,)``.
        horizon: Longest simulated time [s].
        shape: The shape of the orbit.

    Returns:
        The period, or ``None`` if the motion does not return with that shape.
    """
    settings = SimulationSettings()
    try:
        return cycle_of(dynamics, start, shape, horizon=horizon, settings=settings)
    except ZenoOrbitsError:
        return None


def _start_times(unknowns: Mapping[str, Array], shape: EventSequence) -> list[float]:
    """Return the start time of each phase of a solution [s]."""
    return [float(unknowns[f"{label}start time"][0, 0]) for label in labels_of(shape)]


def _difference(cycle: Cycle, values: Mapping[str, Array]) -> float:
    """Return the largest relative difference between a solution and a simulated cycle."""
    period, scale = cycle.period, cycle.scale()

    def apart(time: float, state: Vector, at: Moment | Impact | ZenoPoint) -> float:
        seen = at.state_minus if isinstance(at, Impact) else at.state
        late = abs(at.time - cycle.start.time - time) / period
        return max(late, float(np.max(np.abs(seen - state) / scale)))

    found = [cycle.drift(scale), abs(period - float(values["period"][0, 0])) / period]
    shape = cycle.shape
    starts = _start_times(values, shape)
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
