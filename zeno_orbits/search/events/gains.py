"""Gains of orbits of events: the best orbit in given ranges.

The orbit is closed anew at every choice of the free values, and the derivatives of objective and
bounds along the orbits are exact. Uncertain parameters count with their worst corner.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.maps import Push
from zeno_orbits.model import GraphDynamics, ParameterValues, Problem, unknown
from zeno_orbits.orbits import (
    ENERGY,
    PERIOD,
    Bound,
    EventReturn,
    Orbit,
    StepError,
    asked_and_reached,
    at_section,
    course_signal_names,
    event_quantity_names,
    is_electrical,
    objection_to,
    orbit_event_name,
    require_event_quantity,
)
from zeno_orbits.search.closing import (
    event_orbit_of,
    require_no_other_start,
    return_near,
    settled_return,
)
from zeno_orbits.search.events.candidates import judged, ranked_candidates
from zeno_orbits.search.events.margins import EventWays
from zeno_orbits.search.events.optimum import PRECISION, Optimum, Sample, along_edges, least_worst
from zeno_orbits.search.events.outcome import AcceptEvents, EventSearchResult
from zeno_orbits.search.events.points import (
    DIFFERENCED,
    RADIUS,
    NoEventError,
    OrbitAtValues,
    OrbitsOverValues,
    Slope,
)
from zeno_orbits.search.homotopy.persistence import widest
from zeno_orbits.search.objectives import (
    MaxMargin,
    MaxPush,
    MinEnergy,
    MinPeak,
    MinSpectralRadius,
    NearestGains,
    Objective,
    OfImpacts,
    Target,
    TargetAmplitude,
    TargetPeriod,
    WorstCase,
    corners_of,
)
from zeno_orbits.search.program.rounds import ProgramTask, orbit_by_program
from zeno_orbits.search.program.terms import lacking_terms, signals_of
from zeno_orbits.search.search_problem import clipped
from zeno_orbits.search.settings import SearchMethod
from zeno_orbits.search.strength import EnoughError, highest, push_of
from zeno_orbits.search.transcription.constraints import size_of
from zeno_orbits.search.transcription.nearness import Nearness
from zeno_orbits.search.validation import require_possible_bounds
from zeno_orbits.simulation import Extent, SimulationSettings
from zeno_orbits.work import Progress, silent

_VANISHED = 1e-2
"""Part of its first speed below which an impact vanishes: 1e-4 of its energy is left."""
_SUGGESTED = 0.1
"""Least speed that is suggested, over the first speed. At a slower impact a return amplifies
errors of the integration too much for a verification."""
_ROUGH = 1e-3
"""Precision of an optimum that is only a start."""
_NEARLY = 1e-5
"""Violation of a program's orbit, in units of its bounds, that shooting removes."""
_SAME_VALUE = 1e-6
"""Relative difference of the optima of two methods that is reported."""
_SMALLEST_SIZE = 1e-2
"""Smallest size of a free value, in units of its range."""


def search_event_orbits(
    problem: Problem,
    values: ParameterValues,
    *,
    free: Mapping[str, tuple[float, float]],
    objective: Objective | None = None,
    bounds: Sequence[Bound] = (),
    near: Orbit | None = None,
    start: Mapping[str, float] | None = None,
    section: str | None = None,
    until: float | None = None,
    n_starts: int = 12,
    seed: int = 0,
    candidates: int = 1,
    method: SearchMethod = SearchMethod.AUTO,
    accept: AcceptEvents | None = None,
    simulation: SimulationSettings | None = None,
    on_progress: Progress = silent,
) -> EventSearchResult:
    """Return the best orbit of events of a machine, or several of them, ranked.

    Args:
        problem: The problem.
        values: Values of its gains and parameters. Free values start there.
        free: Name to range of the free gains and parameters.
        objective: The objective, by default values near their start.
        bounds: Bounds on signals, on the period, the energy, the spectral radius and margins, and
            on quantities of events, at every corner.
        near: A known orbit at which the search starts, in place of a motion that settles.
        start: State name to initial value, by default each start of the problem in turn.
        section: Name of the event at which the period starts and ends. By default it is chosen.
        until: Longest time to settle [s].
        n_starts: Number of further free values, from all over the ranges, that are tried in turn
            until a motion settles to an orbit.
        seed: Seed of these values, and of the initial states of several orbits.
        candidates: Number of different orbits that are searched, and ranked.
        method: How the optimum is found.
        accept: Check of the orbits. Only accepted orbits are ranked. By default there is no check.
        simulation: Accuracy.
        on_progress: Called with the stage.

    Raises:
        InputError: If a name or range is invalid, or the objective needs another machine.
        SimulationError: If no motion settles to an orbit at any of the free values.
    """
    wish = objective or NearestGains(target={})
    _require_valid(problem, values, free, wish, bounds)
    if isinstance(wish, NearestGains):
        values = values.replaced(wish.target)
    if near is not None:
        require_no_other_start(start, section)
        n_starts = 0
    search = _Search(
        problem=problem,
        origin=clipped(values, free),
        free=free,
        objective=wish,
        bounds=tuple(bounds),
        method=method,
        accept=accept,
        near=near,
        section=section,
        until=until,
        simulation=simulation or SimulationSettings(),
        on_progress=on_progress,
    )
    places = _places(search.origin, free, n_starts, seed)
    if candidates > 1:
        return ranked_candidates(
            problem,
            search,
            places,
            start=start,
            free=tuple(free),
            n_wanted=candidates,
            accept=accept,
            until=until,
            seed=seed,
            simulation=search.simulation,
            on_progress=on_progress,
        )
    trouble: SimulationError | None = None
    for place in places:
        try:
            found = search.returned(place, start)
        except SimulationError as error:
            trouble = error
            continue
        return judged(search.result(found, place), accept)
    if trouble is None:
        raise AssertionError("A search has a first place.")
    raise trouble


@dataclass(frozen=True, slots=True, kw_only=True)
class _Search:
    """A search for gains, without its starts.

    Attributes:
        problem: The problem.
        origin: Values near which free values stay without another objective.
        free: Name to range of the free values.
        objective: The objective.
        bounds: The bounds.
        method: How the optimum is found.
        accept: Check of the orbits, or ``None``.
        near: A known orbit at which the search starts, in place of a motion that settles.
        section: Name of the event at which the period starts and ends. By default it is chosen.
        until: Longest time to settle [s].
        simulation: Accuracy.
        on_progress: Called with the stage.
    """

    problem: Problem
    origin: ParameterValues
    free: Mapping[str, tuple[float, float]]
    objective: Objective
    bounds: tuple[Bound, ...]
    method: SearchMethod
    accept: AcceptEvents | None
    near: Orbit | None
    section: str | None
    until: float | None
    simulation: SimulationSettings
    on_progress: Progress

    @property
    def _uncertain(self) -> Mapping[str, tuple[float, float]]:
        return self.objective.uncertain if isinstance(self.objective, WorstCase) else {}

    def returned(self, place: ParameterValues, start: Mapping[str, float] | None) -> EventReturn:
        """Return the orbit to which a motion settles, or that the known orbit becomes.

        Args:
            place: Values of the gains and parameters.
            start: State name to initial value. By default each start of the problem in turn, or the
                known orbit.

        Raises:
            SimulationError: If no motion settles, or the known orbit is lost.
        """
        if self.near is not None and start is None:
            return return_near(
                self.problem,
                place,
                self.near,
                simulation=self.simulation,
                on_progress=self.on_progress,
            )
        return settled_return(
            self.problem,
            place,
            starts=() if start is None else (start,),
            section=self.section,
            until=self.until,
            simulation=self.simulation,
            changing=(*self.free, *self._uncertain),
            on_progress=self.on_progress,
        )

    def result(self, found: EventReturn, place: ParameterValues) -> EventSearchResult:
        """Return the result of the search from an orbit.

        Where the check refuses the optimum of a program, shooting may end at another one.

        Args:
            found: The orbit.
            place: Values of its gains and parameters.

        Raises:
            InputError: If the objective has no event there.
            SimulationError: If a corner has no orbit there.
        """
        best = self._by(self.method, found, place)
        if self.method is not SearchMethod.AUTO or best.method is not SearchMethod.PROGRAM:
            return best
        objection = self._objection(best)
        if not objection:
            return best
        other = self._by(SearchMethod.SHOOTING, found, place)
        if other.orbit is None or self._objection(other):
            return best
        remark = f"The optimum of the program, {best.value:.10g}, was refused: {objection}"
        return replace(other, iterations=best.iterations, remarks=(remark,))

    def _objection(self, result: EventSearchResult) -> str:
        """Return the reason why the check refuses an orbit, empty if it does not."""
        if result.orbit is None or self.accept is None:
            return ""
        return self.accept(result.orbit).objection

    def _by(
        self, method: SearchMethod, found: EventReturn, place: ParameterValues
    ) -> EventSearchResult:
        """Return the result of the search by a method from an orbit."""
        orbits = OrbitsOverValues(
            problem=self.problem,
            values=place,
            names=tuple(self.free),
            simulation=self.simulation,
        )
        if isinstance(self.objective, TargetPeriod):
            self.objective.require_near([found.period])
        orbits.begin(found)
        task = _Task(
            orbits=orbits,
            origin=self.origin,
            free=self.free,
            ranges=np.array(list(self.free.values()), dtype=np.float64).reshape(-1, 2),
            objective=self.objective,
            bounds=self.bounds,
            method=method,
            corners=({}, *corners_of(self._uncertain)),
            on_progress=self.on_progress,
        )
        return _result(task, np.array([place.number(name) for name in self.free]))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Task:
    """Everything that a trial needs.

    Attributes:
        orbits: The orbits over the free values.
        origin: Values near which free values stay without another objective.
        free: Name to range of the free values.
        ranges: The same, ``(k, 2)``.
        objective: The objective.
        bounds: The bounds.
        method: How the optimum is found.
        corners: The corners of uncertain parameters, the search's own parameters first.
        sizes: Name to size of the bounded quantities.
        on_progress: Called with the stage.
    """

    orbits: OrbitsOverValues
    origin: ParameterValues
    free: Mapping[str, tuple[float, float]]
    ranges: Vector
    objective: Objective
    bounds: tuple[Bound, ...]
    method: SearchMethod
    corners: tuple[dict[str, float], ...]
    sizes: Mapping[str, float] = field(default_factory=dict[str, float])
    on_progress: Progress

    def numbers(self, u: Vector) -> Vector:
        """Return free values from the unit box."""
        return self.ranges[:, 0] + u * (self.ranges[:, 1] - self.ranges[:, 0])

    def trial(self, u: Vector) -> Sample:
        """Return objective and rows at free values in the unit box.

        Raises:
            SimulationError: If there is no orbit near the last one.
            StepError: If an event of the objective or a bound does not occur.
        """
        self.on_progress("optimizing", None)
        numbers = self.numbers(u)
        points = tuple(self.orbits.at(numbers, corner) for corner in self.corners)
        costs = tuple(tuple(map(self._in_box, self._costs(point, numbers))) for point in points)
        rows: list[Slope] = []
        equal: list[Slope] = []
        for point, corner in zip(points, self.corners, strict=True):
            for bound in self.bounds:
                found = [self._in_box(one) for one in self._rows(point, bound, numbers, corner)]
                if bound.lower == bound.upper and not point.is_signal(bound.name):
                    equal.append(min(found[: len(found) // 2], key=lambda one: one.value))
                else:
                    rows += found
        if isinstance(self.objective, Target):
            target = self.objective.target
            equal.append(self._in_box(self.prescribed(points[0]).scaled(1 / target, target)))
        return Sample(u=u, points=points, costs=costs, rows=tuple(rows), equal=tuple(equal))

    def sized(self, numbers: Vector) -> _Task:
        """Return the task with the sizes of the bounded quantities at free values.

        Raises:
            SimulationError: If there is no orbit.
            StepError: If an event of a bound does not occur.
        """
        if not self.bounds:
            return self
        point = self.orbits.at(numbers, {})
        sizes = {one.name: size_of(one, point.extent(one.name).largest) for one in self.bounds}
        return replace(self, sizes=sizes)

    def near(self, first: Sample, *, precision: float = PRECISION) -> Optimum:
        """Return the optimum near a first trial, up to an edge of the objective.

        Args:
            first: The first trial.
            precision: Change of the objective over its first value, below which it has converged.
        """
        return least_worst(self.trial, first, precision=precision)

    def finished(self, found: Optimum, first: Sample) -> Optimum:
        """Return an optimum after a search along edges of the objective.

        Args:
            found: The optimum up to an edge.
            first: The first trial of the search.
        """
        if not isinstance(self.objective, WorstCase):
            return found
        return along_edges(self.trial, found, abs(first.value) or 1.0)

    def _in_box(self, slope: Slope) -> Slope:
        """Return a number with its derivative with respect to the free values in the unit box."""
        return Slope(value=slope.value, by=slope.by * (self.ranges[:, 1] - self.ranges[:, 0]))

    def _rows(
        self, point: OrbitAtValues, bound: Bound, numbers: Vector, corner: dict[str, float]
    ) -> list[Slope]:
        """Return the distances of a quantity from its bounds, positive inside, in its size."""
        size = self.sizes[bound.name]
        if bound.name not in DIFFERENCED:
            return point.rows(bound, size)
        number = self.orbits.differenced(bound.name, point, numbers, self.ranges, corner)
        ends = ((-1.0, -bound.lower), (1.0, bound.upper))
        return [
            number.scaled(sign).scaled(-1 / size, end) for sign, end in ends if math.isfinite(end)
        ]

    def prescribed(self, point: OrbitAtValues) -> Slope:
        """Return the quantity whose value the objective prescribes."""
        if isinstance(self.objective, TargetAmplitude):
            return point.amplitude(self.objective.state)
        return point.slopes(PERIOD)[0]

    def _costs(self, point: OrbitAtValues, numbers: Vector) -> tuple[Slope, ...]:
        """Return the numbers whose largest is the objective."""
        if isinstance(self.objective, OfImpacts):
            return (point.impact_cost(self.objective),)
        if isinstance(self.objective, MinEnergy):
            return tuple(point.slopes(ENERGY))
        if isinstance(self.objective, MinPeak):
            return point.peak_costs(self.objective.signal)
        if isinstance(self.objective, MinSpectralRadius):
            return (self.orbits.differenced(RADIUS, point, numbers, self.ranges, {}),)
        first, sizes = self._first, self._units
        here = dict(zip(self.free, map(float, numbers), strict=True))
        wanted = {**first, **self.objective.goal}
        value = float(Nearness(first=first, sizes=sizes).distance(here, self.objective.goal))
        by = [(here[name] - wanted[name]) / sizes[name] ** 2 for name in self.free]
        return (Slope(value=value, by=np.array(by)),)

    @property
    def _first(self) -> dict[str, float]:
        """Name to value near which a free value stays without another objective."""
        return {name: self.origin.number(name) for name in self.free}

    @property
    def _units(self) -> dict[str, float]:
        """Name to unit of the distance of a free value."""
        return {
            name: max(abs(self.origin.number(name)), _SMALLEST_SIZE * (high - low))
            for name, (low, high) in self.free.items()
        }

    def by_program(self, first: Sample) -> tuple[Optimum, int]:
        """Return the optimum of the program near a first trial, and Ipopt's iterations.

        Args:
            first: The trial.

        Raises:
            SimulationError: If the program leads to no orbit.
            StepError: If an event of the objective or a bound does not occur there.
        """
        own, *others = first.points
        solved = orbit_by_program(
            self.orbits.problem,
            own.values,
            own.found,
            ProgramTask(
                free=self.free,
                objective=self.objective,
                bounds=self.bounds,
                sizes=self.sizes,
                origin=self._first,
                units=self._units,
                corners=self.corners[1:],
            ),
            corners=[point.found for point in others],
            simulation=self.orbits.simulation,
            on_progress=self.on_progress,
        )
        found = (solved.found, *solved.corners)
        for corner, orbit in zip(self.corners, found, strict=True):
            self.orbits.begin(orbit, corner)
        low, high = self.ranges.T
        numbers = np.array([solved.values.number(name) for name in self.free])
        trial = self.trial((numbers - low) / np.where(high > low, high - low, 1.0))
        optimum = Optimum(trial=trial, converged=solved.converged, reason=solved.detail)
        return optimum, solved.iterations

    def pushes(self, trial: Sample) -> list[tuple[float, Push | None]]:
        """Return the least impulse at every corner of a trial, zero where the orbit is unstable."""
        problem, objective = self.orbits.problem, self.objective
        if not isinstance(objective, MaxPush):
            raise TypeError("Argument `self` must have the objective `MaxPush`.")
        found: list[tuple[float, Push | None]] = []
        for point in trial.points:
            orbit = event_orbit_of(problem, point.values, point.found)
            push, _ = push_of(problem, orbit, objective)
            impulse = math.inf if push is not None else 0.0
            if push is not None and math.isfinite(push.largest):
                impulse = push.largest
            found.append((impulse, push))
        return found


def _result(task: _Task, numbers: Vector) -> EventSearchResult:
    """Return the result of a search from free values at which there is an orbit.

    Raises:
        InputError: If the objective has no event there.
        SimulationError: If a corner has no orbit there.
    """
    low, high = task.ranges.T
    u = (numbers - low) / np.where(high > low, high - low, 1.0)
    try:
        task = task.sized(numbers)
        first = task.trial(u)
    except NoEventError as error:
        wanted = "must be about events of the orbit"
        raise InputError(f"Argument `{error.argument}` {wanted}, but {error}.") from error
    if isinstance(task.objective, MaxPush):
        return _strongest(task, first)
    if isinstance(task.objective, MaxMargin):
        return _widest(task, first)
    is_best = isinstance(task.objective, NearestGains) and first.rank == (0.0, 0.0)
    if task.method is not SearchMethod.PROGRAM and (is_best or not task.free):
        return _told(task, first, Optimum(trial=first, converged=True))
    graph = first.points[0].graph
    lacking = lacking_terms(graph, task.objective, task.bounds)
    # Extremes of signals take a program ten times as long.
    slow = lacking or signals_of(task.objective, task.bounds, graph)
    if task.method is SearchMethod.SHOOTING or (slow and task.method is SearchMethod.AUTO):
        return _told(task, first, _by_shooting(task, first))
    if lacking:
        raise InputError(
            f"Argument `method` must be shooting or auto: a program does not have {lacking}."
        )
    return _by_program(task, first)


def _by_shooting(task: _Task, first: Sample) -> Optimum:
    """Return the best optimum of searches over closed orbits."""
    found = [task.near(first)]
    if len(task.corners) > 1:
        found += _by_nominal(task, first)
    if min(one.trial.violation for one in found):
        found += _by_feasible(task, first)
    best = min(found, key=lambda one: one.trial.rank)
    return task.finished(best, first)


def _by_program(task: _Task, first: Sample) -> EventSearchResult:
    """Return the optimum of the program, which shooting checks, or replaces where it fails."""
    iterations = 0
    try:
        solved, iterations = task.by_program(first)
        reason = "" if solved.converged else solved.reason
    except (SimulationError, StepError) as error:
        solved, reason = None, error.reason if isinstance(error, SimulationError) else str(error)
    if task.method is SearchMethod.PROGRAM:
        if solved is None or reason:
            told = _told(task, first, solved or Optimum(trial=first, converged=False))
            detail = f"The program found no optimum: {reason.rstrip('.')}."
            told = replace(told, orbit=None, detail=detail)
        else:
            told = _told(task, first, solved)
        return replace(told, method=SearchMethod.PROGRAM, iterations=iterations)
    if solved is not None and not reason and solved.trial.violation <= _NEARLY:
        checked = task.finished(task.near(solved.trial), first)
        if not checked.trial.violation:
            told = _told(task, first, checked)
            return replace(
                told,
                method=SearchMethod.PROGRAM,
                iterations=iterations,
                remarks=_difference(solved.trial, checked.trial, first),
            )
    for corner, point in zip(task.corners, first.points, strict=True):
        task.orbits.begin(point.found, corner)
    told = _told(task, first, _by_shooting(task, first))
    said = reason.rstrip(".") or "its orbit does not keep the bounds"
    remark = f"The program found no optimum ({said})."
    return replace(told, iterations=iterations, remarks=(remark,))


def _difference(solved: Sample, checked: Sample, first: Sample) -> tuple[str, ...]:
    """Return a remark if shooting improves the optimum of a program."""
    gained = solved.value - checked.value
    if solved.violation or gained <= _SAME_VALUE * max(abs(checked.value), abs(first.value)):
        return ()
    return (
        f"The program ends at {solved.value:.10g}, and shooting goes on from there to "
        f"{checked.value:.10g}.",
    )


def _strongest(task: _Task, first: Sample) -> EventSearchResult:
    """Return the orbit with the largest least push, by a search without derivatives."""
    start = first
    if first.violation:
        start = task.near(first).trial
    pushed = task.pushes(start)
    best, best_pushes = start, pushed
    known = {start.u.tobytes(): (_least_impulse(pushed), start)}
    size = _least_impulse(pushed) or 1.0

    def evaluated(u: Vector) -> tuple[float, Sample | None]:
        nonlocal best, best_pushes
        u = np.clip(np.array(u), 0.0, 1.0)
        key = u.tobytes()
        if key in known:
            return known[key]
        try:
            there = task.trial(u)
        except (SimulationError, StepError):
            # Without an orbit there is no push.
            return 0.0, None
        found = task.pushes(there)
        impulse = _least_impulse(found)
        if there.violation <= best.violation and impulse > _least_impulse(best_pushes):
            best, best_pushes = there, found
        if math.isinf(impulse):
            raise EnoughError
        known[key] = impulse, there
        return known[key]

    def inside(u: Vector) -> Vector:
        there = evaluated(u)[1]
        if there is None:
            return np.full(n_rows, -1.0)
        equal = [sign * row.value for row in there.equal for sign in (1.0, -1.0)]
        return np.array([*(row.value for row in there.rows), *equal])

    n_rows = len(first.rows) + 2 * len(first.equal)
    if task.free and math.isfinite(_least_impulse(pushed)):
        with suppress(EnoughError):
            highest(lambda u: evaluated(u)[0] / size, start.u, inside if n_rows else None)
    impulses = [impulse for impulse, _ in best_pushes]
    place = int(np.argmin(impulses))
    told = _told(task, first, Optimum(trial=best, converged=True))
    return replace(
        told,
        value=impulses[0],
        worst=impulses[place],
        worst_at=task.corners[place],
        mean=float(np.mean(impulses[1:])) if len(impulses) > 1 else None,
        push=best_pushes[place][1],
    )


def _widest(task: _Task, first: Sample) -> EventSearchResult:
    """Return the orbit with the widest margin, within the bounds."""
    start = first
    if first.violation:
        start = task.near(first).trial
    if start.violation:
        return _told(task, first, Optimum(trial=start, converged=True))
    point, orbits = start.points[0], task.orbits
    section = orbit_event_name(point.found.events[-1])
    ways = EventWays(
        orbits=orbits, free=task.free, bounds=task.bounds, on_progress=task.on_progress
    )
    best = widest(ways, point.values, point.found)
    numbers = np.array([best.values.number(name) for name in task.free])
    low, high = task.ranges.T
    graph = orbits.problem.graph_dynamics(best.values)
    orbits.begin(at_section(graph, best.orbit, section, orbits.simulation))
    trial = task.trial((numbers - low) / (high - low))
    told = _told(task, first, Optimum(trial=trial, converged=True))
    margin = best.nearest.distance
    return replace(
        told,
        value=margin,
        worst=margin,
        detail=told.detail or best.text,
    )


def _least_impulse(pushes: Sequence[tuple[float, Push | None]]) -> float:
    """Return the least impulse of all corners."""
    return min(impulse for impulse, _ in pushes)


def _by_nominal(task: _Task, first: Sample) -> list[Optimum]:
    """Return the worst-case optimum near the optimum at the search's own parameters."""
    alone = replace(task, corners=({},))
    nominal = alone.near(
        Sample(
            u=first.u,
            points=first.points[:1],
            costs=first.costs[:1],
            rows=first.rows[: len(first.rows) // len(task.corners)],
            equal=first.equal[: len(first.equal) // len(task.corners)],
        ),
        precision=_ROUGH,
    )
    try:
        begin = task.trial(nominal.trial.u)
    except (SimulationError, StepError):
        return []
    return [task.near(begin)]


def _by_feasible(task: _Task, first: Sample) -> list[Optimum]:
    """Return the optimum near the values that keep the bounds and are nearest to the start."""
    if isinstance(task.objective, NearestGains | Target):
        return []
    try:
        nearest = replace(task, objective=NearestGains(target={}))
        kept = nearest.near(nearest.trial(first.u))
        return [] if kept.trial.violation else [task.near(task.trial(kept.trial.u))]
    except (SimulationError, StepError):
        return []


def _told(task: _Task, first: Sample, best: Optimum) -> EventSearchResult:
    """Return the result of an optimum."""
    trial, objective = best.trial, task.objective
    point = trial.points[0]
    corner_costs = [max(one.value for one in costs) for costs in trial.costs]
    place = int(np.argmax(corner_costs))
    extents = {bound.name: _extent(trial.points, bound.name) for bound in task.bounds}
    vanishing = _vanishing(task, first, trial)
    detail = objection_to(task.bounds, extents)
    orbit = None
    if detail:
        detail = f"No orbit that keeps the bounds was found: {detail}"
    elif trial.violation:
        detail = f"No orbit with {objective.wish} was found in the ranges."
        if isinstance(objective, Target):
            detail += f" The nearest has {task.prescribed(point).value:.8g}."
    elif vanishing:
        detail = _end_of_family(task, trial, vanishing)
    else:
        orbit = event_orbit_of(task.orbits.problem, point.values, point.found)
        if not best.converged:
            detail = f"The search ended before it converged: {best.reason}."
    return EventSearchResult(
        orbit=orbit,
        free=dict(zip(task.free, map(float, task.numbers(trial.u)), strict=True)),
        objective=objective,
        value=corner_costs[0],
        worst=corner_costs[place],
        worst_at=task.corners[place],
        mean=float(np.mean(corner_costs[1:])) if len(corner_costs) > 1 else None,
        asked=tuple(asked_and_reached(task.bounds, extents)),
        vanishing=vanishing,
        least_speeds=_least_speeds(objective, first, vanishing),
        n_orbits=task.orbits.n_orbits,
        detail=detail,
    )


def _extent(points: Sequence[OrbitAtValues], name: str) -> Extent:
    """Return the range of a quantity over all corners."""
    found = [point.extent(name) for point in points]
    return Extent(
        lowest=min(one.lowest for one in found), highest=max(one.highest for one in found)
    )


def _vanishing(task: _Task, first: Sample, last: Sample) -> dict[str, float]:
    """Return the impacts that no bound keeps and whose speed falls to nothing at every corner."""
    objective = task.objective
    if not isinstance(objective, OfImpacts):
        return {}
    begun = first.points[0].impact_speed(objective)
    ended = [point.impact_speed(objective) for point in last.points]
    kept = {bound.name for bound in task.bounds if bound.lower > 0.0}
    speeds = {stop: max(one.get(stop, 0.0) for one in ended) for stop in begun}
    return {
        stop: speed
        for stop, speed in speeds.items()
        if speed < _VANISHED * begun[stop] and f"{stop}.impact_speed" not in kept
    }


def _least_speeds(
    objective: Objective, first: Sample, vanishing: Mapping[str, float]
) -> tuple[Bound, ...]:
    """Return bounds that keep impacts which would vanish."""
    if not isinstance(objective, OfImpacts):
        return ()
    speeds = first.points[0].impact_speed(objective)
    return tuple(
        Bound(name=f"{stop}.impact_speed", lower=float(f"{_SUGGESTED * speeds[stop]:.1g}"))
        for stop in vanishing
    )


def _end_of_family(task: _Task, last: Sample, vanishing: Mapping[str, float]) -> str:
    numbers = zip(task.free, task.numbers(last.u), strict=True)
    where = ", ".join(f"{name} = {value:.6g}" for name, value in numbers)
    said = [
        f"The impact on `{stop}` vanishes at {where}: its speed falls to {speed:.1e}."
        for stop, speed in vanishing.items()
    ]
    return " ".join([*said, "This is the end of a family and not an orbit."])


def _places(
    values: ParameterValues, free: Mapping[str, tuple[float, float]], n_starts: int, seed: int
) -> list[ParameterValues]:
    """Return the values at which a search may start: its own, then a Halton sequence."""
    if not free or n_starts < 1:
        return [values]
    # SciPy's statistics take half a second to import.
    from scipy.stats import qmc

    low, high = np.array(list(free.values())).T
    places = low + qmc.Halton(len(free), seed=seed).random(n_starts) * (high - low)
    chosen = [dict(zip(free, map(float, place), strict=True)) for place in places]
    return [values, *(values.replaced(one) for one in chosen)]


def _require_valid(
    problem: Problem,
    values: ParameterValues,
    free: Mapping[str, tuple[float, float]],
    objective: Objective,
    bounds: Sequence[Bound],
) -> None:
    """Reject a search with unknown names, or one that needs a machine with one stop.

    Raises:
        InputError: If the search is not valid. The message names the invalid part.
    """
    # A push needs the graph of a machine with several stops or switches.
    if not isinstance(objective, _POSSIBLE) and not (
        isinstance(objective, MaxPush) and problem.has_graph
    ):
        words = (
            "nearest, period, amplitude, energy, peak, contraction, margin, push, impacts or bounce"
        )
        wanted = f"must be one of {words}"
        raise InputError(
            f"Argument `objective` {wanted} in a search by events, but it "
            f"asks for {objective.wish}."
        )
    for name, box in free.items():
        problem.require_range(name, box, argument="vary")
    if isinstance(objective, MaxMargin) and not free:
        raise InputError(
            "Argument `objective` asks for the widest margin, which needs a free value: name its "
            "range in `vary`."
        )
    objective.check(problem, free)
    graph = problem.graph_dynamics(values)
    if isinstance(objective, MinEnergy):
        _require_electrical(graph, "objective", objective.wish)
    for bound in bounds:
        _require_quantity(bound.name, graph)
    require_possible_bounds(bounds)


_POSSIBLE = (
    NearestGains,
    TargetPeriod,
    TargetAmplitude,
    MinEnergy,
    MinPeak,
    MinSpectralRadius,
    MaxMargin,
    OfImpacts,
)
"""Objectives of a search by events."""


def _require_quantity(name: str, graph: GraphDynamics) -> None:
    """Refuse a bound on a quantity that an orbit of events does not have, or on a number."""
    signals = course_signal_names(graph.compiled)
    numbers = (PERIOD, ENERGY, *DIFFERENCED)
    if "." not in name and name not in (*signals, *numbers):
        known = (*signals, *numbers, *event_quantity_names(graph))
        raise InputError(unknown("bounds", name, known))
    if name == ENERGY and name not in signals:
        _require_electrical(graph, "bounds", "the energy")
    if "." in name:
        require_event_quantity(name, graph, "bounds")
    if ".impacts" in name:
        raise InputError(
            f"Argument `bounds` must not bound the number `{name}`: bound a speed or a time."
        )


def _require_electrical(graph: GraphDynamics, argument: str, what: str) -> None:
    if not is_electrical(graph.compiled):
        raise InputError(
            f"Argument `{argument}` asks for {what}, but the machine has no source of electrical "
            "energy: give its drive an `input_power`, or ask for another quantity."
        )
