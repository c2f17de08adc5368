r"""Orbits with free values by a program: transcribe, solve, simulate, and once more.

A program has the event sequence of its guess. The first rounds may run a flow backward for a moment
and take a target as a wish, so that they end near the optimum with events in another order. The
simulation from there has the new sequence, and is the guess of the next round. A result is a
simulated orbit, closed by Newton's method, that the program leaves unchanged.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Array, Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import (
    Bound,
    EventReturn,
    closed_return,
    event_return,
    largest_states,
    orbit_event_name,
)
from zeno_orbits.search.objectives import Objective
from zeno_orbits.search.program.elements import ElementBuilder, ElementProgram, ElementSolution
from zeno_orbits.search.program.ipopt import IpoptSettings, SolveStatus
from zeno_orbits.search.program.terms import (
    ReadingPlace,
    SearchTerms,
    dips_of,
    extremes_of,
    needs_work,
    signals_of,
)
from zeno_orbits.search.program.writer import (
    PeriodProgram,
    TranscriptionSettings,
    free_places,
    write_period,
)
from zeno_orbits.simulation import Event, Impact, SimulationSettings
from zeno_orbits.work import Progress, silent

_MOST_ROUNDS = 16
_WISHES = 2
"""Rounds in which a target is a wish."""
_BACKWARD = 0.3
"""Part of its guess by which a flow may run backward in the first rounds."""
_MESH, _FINE = 3e-8, 1e-10
"""Deviation of a polynomial from the guess, and that of a program with rows between stages."""
_FORWARD = 4
"""Round from which all flows run forward."""
_FIRST_BOX, _SMALLER, _LARGER = 0.25, 0.25, 2.0
"""Half width of the first box of a measured objective, in units of the ranges, and its factors
after a program that is not solved, and after one that its sides hold."""
_AT_SIDE = 1e-4
"""Distance from a side of a box, over its half width, at which it holds a value."""
_MOST_FAILURES = 2
"""Programs that are not solved, after which the search ends."""
_WORK = 400_000
"""Iterations times unknowns and inequalities of all rounds. A time limit would make the result
depend on the load of the machine."""
_EXHAUSTED = "the program needs too many iterations"
_MOST_CUTS = 6
"""Programs of a round, each with rows where the last solution penetrates a stop."""
_BARRIERS = 40
"""Number of inequality rows from which the first barrier is weaker."""
_KEPT = 1e-8
"""Largest scaled residual of a solved program."""
_SAME = 1e-7
"""Largest relative distance of a solution from the simulated orbit."""
_STILL, _NEAR = 1e-9, 1e-4
"""Change of the free values, over their ranges, below which a round repeats the last one, and that
of a least peak, whose error is of second order in it."""
_VANISHED = 1e-6
"""Part of its guess below which the duration of a leg is zero."""
_FIRST = IpoptSettings(optimality=1e-10, first_barrier=0.1, most_iterations=100, most_seconds=1e9)
_LATER = replace(_FIRST, first_barrier=1e-3)


@dataclass(frozen=True, slots=True, kw_only=True)
class ProgramTask:
    """What a program minimises, and what it keeps.

    Attributes:
        free: Name to range of the free values.
        objective: The objective, one that a program has.
        bounds: The bounds, which a program has.
        sizes: Name to unit of the distance of a bound.
        origin: Name to value near which a free value stays without another objective.
        units: Name to unit of this distance.
        corners: Corners of uncertain parameters, name to value.
    """

    free: Mapping[str, tuple[float, float]]
    objective: Objective
    bounds: tuple[Bound, ...] = ()
    sizes: Mapping[str, float]
    origin: Mapping[str, float]
    units: Mapping[str, float]
    corners: tuple[Mapping[str, float], ...] = ()

    @property
    def is_measured(self) -> bool:
        """True if the objective is a quantity of the orbit, and not a distance of values."""
        return self.objective.is_measured


@dataclass(frozen=True, slots=True, kw_only=True)
class ProgramOrbit:
    """The orbit of a program.

    Attributes:
        values: Values of its decision variables.
        found: The orbit, closed by simulation.
        corners: The orbits at the corners of uncertain parameters.
        miss: Largest relative distance of the program's starts and periods from these orbits.
        converged: Whether the program is solved there, and is left unchanged by one more round.
        rounds: Number of rounds.
        iterations: Number of iterations of Ipopt in all rounds.
        detail: Reason why it has not converged, as the end of a sentence.
    """

    values: ParameterValues
    found: EventReturn
    corners: tuple[EventReturn, ...]
    miss: float = math.inf
    converged: bool
    rounds: int
    iterations: int
    detail: str = ""


def orbit_by_program(
    problem: Problem,
    values: ParameterValues,
    near: EventReturn,
    task: ProgramTask,
    *,
    corners: Sequence[EventReturn] = (),
    simulation: SimulationSettings | None = None,
    on_progress: Progress = silent,
) -> ProgramOrbit:
    """Return the best orbit near a motion, by a nonlinear program.

    Args:
        problem: The problem.
        values: Values of its gains and parameters. Free values start there.
        near: A return to a section at these values. It need not be closed.
        task: Objective and bounds.
        corners: The returns at the corners of uncertain parameters.
        simulation: Accuracy.
        on_progress: Called with the stage.

    Raises:
        SimulationError: If no round leads to an orbit.
    """
    settings = simulation or SimulationSettings()
    state = _State(
        here=_Motions(values=values, found=near, corners=tuple(corners)),
        is_wish=task.objective.prescribes,
        half=_FIRST_BOX if task.is_measured else 1.0,
    )
    while not state.is_over and state.number < _MOST_ROUNDS:
        on_progress("solving the program", None)
        state = replace(_advanced(problem, task, state, settings), number=state.number + 1)
    if state.best is None:
        raise SimulationError(
            f"The program leads to no orbit: {state.reason.rstrip('.')}",
            time=near.period,
            state=tuple(near.start.tolist()),
        )
    return replace(state.best, rounds=state.number, iterations=state.iterations)


@dataclass(frozen=True, slots=True, kw_only=True)
class _State:
    """A search after some rounds.

    Attributes:
        here: The motions that are the next guess.
        number: Number of rounds so far.
        is_wish: Whether a target is a wish in the next round.
        has_contacts: Whether stops are then kept open or closed along the legs.
        half: Half width of the box of free values around the last ones, in units of the ranges.
        work: Work that is left.
        iterations: Iterations of Ipopt so far.
        n_failures: Number of programs that were not solved.
        places: Places between stages at which bounds on signals hold.
        best: The last orbit.
        reason: Reason why the search has not converged.
        is_over: Whether it has converged, or cannot go on.
    """

    here: _Motions
    number: int = 0
    is_wish: bool
    has_contacts: bool = False
    half: float
    work: int = _WORK
    iterations: int = 0
    n_failures: int = 0
    places: tuple[ReadingPlace, ...] = ()
    best: ProgramOrbit | None = None
    reason: str = ""
    is_over: bool = False


def _advanced(
    problem: Problem, task: ProgramTask, state: _State, settings: SimulationSettings
) -> _State:
    """Return a search after one more round: a program, and the motions from its solution."""
    try:
        solved = _solved(problem, task, state)
    except SimulationError as error:
        return replace(state, reason=error.reason, is_over=True)
    solution = solved.solution
    state = replace(
        state,
        iterations=state.iterations + solved.iterations,
        work=state.work - solved.work,
        reason=solution.status.value,
    )
    if not solution.violation <= _KEPT:
        state = replace(state, n_failures=state.n_failures + 1)
        if state.n_failures > _MOST_FAILURES or not np.all(np.isfinite(solution.unknowns)):
            return replace(state, is_over=True)
        if task.is_measured:
            return replace(state, half=state.half * _SMALLER)
    has_contacts = task.is_measured or state.number >= _WISHES
    try:
        here, is_closed = _simulated(problem, state.here, task, solved, settings)
    except SimulationError as error:
        state = replace(state, reason=error.reason, has_contacts=has_contacts)
        try:
            return replace(state, here=_halfway(problem, state.here, task, solved, settings))
        except SimulationError:
            return replace(state, is_over=True)
    is_same = _sequence(here) == _sequence(state.here)
    if task.is_measured and not is_same and not state.has_contacts:
        # The solution may penetrate a stop, which rows along its legs prevent.
        return replace(state, has_contacts=True)
    miss = _miss(here, solved)
    agrees = is_closed and is_same and _agrees(solved, miss)
    moved = replace(
        state,
        here=here,
        has_contacts=state.has_contacts or (not agrees and has_contacts),
        places=solved.places if is_same else (),
    )
    if not is_closed:
        return moved
    judged = _judged(task, state, moved, solved, agrees=agrees)
    return judged if judged.best is None else replace(judged, best=replace(judged.best, miss=miss))


def _judged(
    task: ProgramTask, before: _State, state: _State, solved: _Solved, *, agrees: bool
) -> _State:
    """Return a search with the orbit of a round, and with the rules of the next one.

    Args:
        task: Objective and bounds.
        before: The search before the round.
        state: The search at the orbit.
        solved: The program of the round.
        agrees: Whether the program has the orbit.
    """
    own = solved.periods[0]
    is_held = _is_held(before.here, task, before.half, solved.solution.unknowns[own.free])
    limit = _NEAR if task.objective.has_edges and task.objective.signals else _STILL
    is_still = _moved(task, before.here.values, state.here.values) <= limit
    is_still |= not signals_of(task.objective, task.bounds, own.graph)
    converged = agrees and is_still and not is_held and not before.is_wish
    best = ProgramOrbit(
        values=state.here.values,
        found=state.here.found,
        corners=state.here.corners,
        converged=converged,
        rounds=0,
        iterations=0,
        detail="" if converged else state.reason,
    )
    is_wish = before.is_wish and not agrees and state.number + 1 < _WISHES
    half = min(1.0, state.half * _LARGER) if is_held else state.half
    return replace(state, best=best, is_wish=is_wish, half=half, is_over=converged)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Solved:
    """The last program of a round, and the work of all programs of the round."""

    periods: tuple[PeriodProgram, ...]
    solution: ElementSolution
    places: tuple[ReadingPlace, ...]
    iterations: int
    work: int


@dataclass(frozen=True, slots=True, kw_only=True)
class _Motions:
    """Returns at values, and at the corners of uncertain parameters."""

    values: ParameterValues
    found: EventReturn
    corners: tuple[EventReturn, ...]


def _solved(problem: Problem, task: ProgramTask, state: _State) -> _Solved:
    """Write and solve the program of a round, with rows at places where it penetrates a stop.

    Raises:
        SimulationError: If the work is used up.
    """
    dips: list[ReadingPlace] = []
    last: _Solved | None = None
    settings = _FIRST if state.number == 0 else _LATER
    iterations = spent = 0
    for _ in range(_MOST_CUTS):
        periods, program, places = _written(problem, task, state, dips)
        if last is not None:
            # Unknowns of further places come last.
            guess = last.solution.unknowns
            kept = min(len(guess), len(program.guess))
            start = program.guess.copy()
            start[:kept] = guess[:kept] / program.sizes[:kept]
            program = replace(program, guess=start)
        # Many barriers would otherwise outweigh the objective.
        barrier = settings.first_barrier * min(1.0, _BARRIERS / max(program.n_inequalities, 1))
        size = len(program.guess) + program.n_inequalities
        most = min(settings.most_iterations, (state.work - spent) // size)
        if most < 1:
            break
        limited = replace(settings, first_barrier=barrier, most_iterations=most)
        solution = program.solve(limited)
        iterations += solution.iterations
        spent += solution.iterations * size
        last = _Solved(
            periods=periods,
            solution=solution,
            places=places,
            iterations=iterations,
            work=spent,
        )
        if not state.has_contacts or not np.all(np.isfinite(solution.unknowns)):
            break
        found = dips_of(periods, solution.unknowns)
        if not found:
            break
        dips, settings = dips + found, _LATER
    if last is None:
        here = state.here.found
        raise SimulationError(_EXHAUSTED, time=here.period, state=tuple(here.start.tolist()))
    return last


def _written(
    problem: Problem,
    task: ProgramTask,
    state: _State,
    dips: Sequence[ReadingPlace],
) -> tuple[tuple[PeriodProgram, ...], ElementProgram, tuple[ReadingPlace, ...]]:
    """Return the periods of a round, their program, and the places between its stages."""
    builder, here = ElementBuilder(), state.here
    graph = problem.graph_dynamics(here.values)
    box = _box(here, task, state.half)
    free = dict(zip(task.free, free_places(builder, graph, box).tolist(), strict=True))
    signals = signals_of(task.objective, task.bounds, graph)
    is_fine = bool(signals) or (state.has_contacts and task.is_measured)
    mesh = _FINE if is_fine else _MESH
    writing = TranscriptionSettings(
        mesh_tolerance=mesh, backward=_BACKWARD if state.number < _FORWARD else 0.0
    )
    pairs = [(here.values, here.found)]
    pairs += [
        (here.values.replaced(corner), found)
        for corner, found in zip(task.corners, here.corners, strict=True)
    ]
    periods = tuple(
        write_period(
            builder,
            problem.graph_dynamics(values),
            found,
            free,
            has_work=needs_work(task.objective, task.bounds, graph),
            settings=writing,
        )
        for values, found in pairs
    )
    # A bound holds everywhere, so the places of earlier rounds remain valid.
    places = (*state.places, *extremes_of(periods, signals))
    terms = SearchTerms(periods=periods, free=free, places=places)
    if not task.is_measured:
        terms.nearest(task.origin, task.units, task.objective.goal)
    task.objective.aim(terms, is_wish=state.is_wish)
    for bound in task.bounds:
        terms.keep(bound, task.sizes[bound.name])
    if state.has_contacts:
        terms.keep_contacts(dips)
    return periods, builder.built(), places


def _box(here: _Motions, task: ProgramTask, half: float) -> dict[str, tuple[float, float]]:
    """Return the ranges of free values within a box around the last ones."""
    box: dict[str, tuple[float, float]] = {}
    for name, (low, high) in task.free.items():
        value, room = here.values.number(name), half * (high - low)
        box[name] = (max(low, value - room), min(high, value + room))
    return box


def _is_held(here: _Motions, task: ProgramTask, half: float, numbers: Array) -> bool:
    """Return True if a side of a box holds a free value, and is not a side of its range."""
    for (name, (low, high)), number in zip(task.free.items(), numbers.tolist(), strict=True):
        room = half * (high - low)
        off = number - here.values.number(name)
        is_at_side = abs(off) >= (1.0 - _AT_SIDE) * room
        if is_at_side and low + _AT_SIDE * room < number < high - _AT_SIDE * room:
            return True
    return False


def _values_at(
    values: ParameterValues, task: ProgramTask, numbers: Sequence[float]
) -> ParameterValues:
    """Return values with other free values. Rounding does not take them out of their range."""
    ranges = task.free.items()
    free = {
        name: min(max(number, low), high)
        for (name, (low, high)), number in zip(ranges, numbers, strict=True)
    }
    return values.replaced(free)


def _simulated(
    problem: Problem,
    here: _Motions,
    task: ProgramTask,
    solved: _Solved,
    settings: SimulationSettings,
) -> tuple[_Motions, bool]:
    """Return the motions from the starts of a solution, and whether all are closed.

    Raises:
        SimulationError: If a motion does not return.
    """
    z, periods = solved.solution.unknowns, solved.periods
    values = _values_at(here.values, task, z[periods[0].free].tolist())
    motions: list[EventReturn] = []
    is_closed = True
    corners: tuple[Mapping[str, float], ...] = ({}, *task.corners)
    for period, corner, last in zip(periods, corners, (here.found, *here.corners), strict=True):
        start, time = z[period.legs[0].start], float(z[period.period])
        at = values.replaced(corner) if corner else values
        try:
            motions.append(_return(problem, at, start, last, time, settings, is_closed=True))
        except SimulationError:
            motions.append(_return(problem, at, start, last, time, settings, is_closed=False))
            is_closed = False
    return _Motions(values=values, found=motions[0], corners=tuple(motions[1:])), is_closed


def _return(
    problem: Problem,
    values: ParameterValues,
    start: Vector,
    last: EventReturn,
    period: float,
    settings: SimulationSettings,
    *,
    is_closed: bool,
) -> EventReturn:
    """Return the motion from a start to the section of the last one, closed or as it is."""
    section = orbit_event_name(last.events[-1])
    n_returns = sum(orbit_event_name(event) == section for event in last.events)
    close = closed_return if is_closed else event_return
    return close(
        problem.graph_dynamics(values),
        start,
        section=section,
        n_returns=n_returns,
        guess=period if period > 0.0 else last.period,
        settings=settings,
        mode=last.mode,
    )


def _halfway(
    problem: Problem,
    here: _Motions,
    task: ProgramTask,
    solved: _Solved,
    settings: SimulationSettings,
) -> _Motions:
    """Return the motions from the last starts, at values halfway to those of a solution.

    Raises:
        SimulationError: If a motion does not return.
    """
    wanted = solved.solution.unknowns[solved.periods[0].free].tolist()
    numbers = [
        (here.values.number(name) + number) / 2
        for name, number in zip(task.free, wanted, strict=True)
    ]
    values = _values_at(here.values, task, numbers)
    corners: tuple[Mapping[str, float], ...] = ({}, *task.corners)
    motions = [
        _return(
            problem,
            values.replaced(corner) if corner else values,
            last.start,
            last,
            last.period,
            settings,
            is_closed=False,
        )
        for corner, last in zip(corners, (here.found, *here.corners), strict=True)
    ]
    return _Motions(values=values, found=motions[0], corners=tuple(motions[1:]))


def _agrees(solved: _Solved, miss: float) -> bool:
    """Return True if a solved program has the simulated orbits, from which it is so far away."""
    solution = solved.solution
    return (
        solution.status in (SolveStatus.SOLVED, SolveStatus.ACCEPTABLE)
        and solution.violation <= _KEPT
        and miss <= _SAME
        and not any(
            solution.unknowns[one.duration] <= _VANISHED * one.leg.duration
            for period in solved.periods
            for one in period.legs
        )
    )


def _miss(here: _Motions, solved: _Solved) -> float:
    """Return the largest relative distance of starts and periods of a program from motions."""
    z, worst = solved.solution.unknowns, 0.0
    for period, found in zip(solved.periods, (here.found, *here.corners), strict=True):
        sizes = largest_states(found.execution.arcs, period.graph)
        off = np.abs(z[period.legs[0].start] - found.start) / sizes
        longer = abs(float(z[period.period]) / found.period - 1.0)
        worst = max(worst, float(np.max(off)), longer)
    return worst


def _sequence(here: _Motions) -> list[list[str]]:
    """Return the event sequences of motions. A faster impact begins another impact sequence."""
    return [
        [
            orbit_event_name(event)
            for before, event in zip((None, *found.events), found.events, strict=False)
            if not _is_slower(before, event)
        ]
        for found in (here.found, *here.corners)
    ]


def _is_slower(before: Event | None, event: Event) -> bool:
    """Return True for an impact that follows a faster one on the same stop."""
    if not (isinstance(before, Impact) and isinstance(event, Impact)):
        return False
    return before.stop == event.stop and event.approach_rate > before.approach_rate


def _moved(task: ProgramTask, before: ParameterValues, after: ParameterValues) -> float:
    """Return the largest change of a free value, in units of its range."""
    return max(
        (
            abs(after.number(name) - before.number(name)) / (high - low)
            for name, (low, high) in task.free.items()
            if high > low
        ),
        default=0.0,
    )
