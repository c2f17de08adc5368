"""The best orbit in given ranges of gains and parameters, by two methods.

A program has the orbit and the free values as unknowns. Shooting closes the orbit anew at every
choice of the free values, with exact derivatives of objective and bounds along the orbits.
Uncertain parameters count with their worst corner.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import (
    Bound,
    EventReturn,
    EventSequence,
    StepError,
    asked_and_reached,
    excess,
    margins_of_return,
    objection_to,
    orbit_event_name,
)
from zeno_orbits.search.closing.closing import (
    event_orbit_of,
)
from zeno_orbits.search.measures import Slope
from zeno_orbits.search.nearness import nearness_of
from zeno_orbits.search.objectives import (
    PERSISTENCE,
    PUSH,
    MaxMargin,
    MaxPush,
    NearestGains,
    Objective,
    Target,
)
from zeno_orbits.search.optimum.least_worst import (
    PRECISION,
    Optimum,
    Sample,
    along_edges,
    least_worst,
)
from zeno_orbits.search.optimum.paths import TO_VALUES, OrbitPaths
from zeno_orbits.search.optimum.persistence import widest
from zeno_orbits.search.optimum.points import (
    DIFFERENCED,
    NoEventError,
    OrbitAtValues,
    OrbitsOverValues,
)
from zeno_orbits.search.optimum.strength import strongest
from zeno_orbits.search.outcome import SearchResult
from zeno_orbits.search.program.rounds import ProgramTask, orbit_by_program
from zeno_orbits.search.program.terms import lacking_terms, signals_of
from zeno_orbits.search.search_problem import Accept, listed
from zeno_orbits.search.settings import SearchMethod, SearchStatus
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
_AT_BOUND = 0.02
"""Distance below which a value is at its bound, in units of its range."""
_GONE = 0.02
"""Part of its value at the first trial below which a margin of an orbit vanishes."""
_SMALL_STEP = 1e-9
"""Part of the largest step of a free value below which a value does not change."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GainSearch:
    """A search for gains, without its starts.

    Attributes:
        problem: The problem.
        origin: Values near which free values stay without another objective.
        free: Name to range of the free values.
        objective: The objective.
        bounds: The bounds.
        method: How the optimum is found.
        accept: Check of the orbits, or ``None``.
        shape: Phases of the period of a machine with the stop `stop`. The default is any.
        starts: Initial states of motions that settle, name to value. The default is the problem's
            own.
        simulation: Accuracy.
        on_progress: Called with the stage.
    """

    problem: Problem
    origin: ParameterValues
    free: Mapping[str, tuple[float, float]]
    objective: Objective
    bounds: tuple[Bound, ...]
    method: SearchMethod = SearchMethod.AUTO
    accept: Accept | None = None
    shape: EventSequence | None = None
    starts: tuple[Mapping[str, float], ...] = ()
    simulation: SimulationSettings = field(default_factory=SimulationSettings)
    on_progress: Progress = silent

    def best(self, found: EventReturn, place: ParameterValues) -> BestOrbit:
        """Return the best orbit near an orbit.

        Where the check refuses the optimum of a program, shooting may end at another one.

        Args:
            found: The orbit.
            place: Values of its gains and parameters.

        Raises:
            InputError: If the event of the objective is missing there.
            SimulationError: If a corner lacks an orbit there.
        """
        best = self._by(self.method, found, place)
        if self.method is not SearchMethod.AUTO or best.result.method is not SearchMethod.PROGRAM:
            return best
        objection = self._objection(best)
        if not objection:
            return best
        other = self._by(SearchMethod.SHOOTING, found, place)
        if other.result.orbit is None or self._objection(other):
            return best
        value = best.result.value
        remark = f"The optimum of the program, {value:.10g}, was refused: {objection}"
        return other.told(iterations=best.result.iterations, remarks=(remark,))

    def _objection(self, best: BestOrbit) -> str:
        """Return the reason why the check refuses an orbit, empty if it does not.

        An orbit that is only unstable is replaced by a stable one in a further search.
        """
        if best.result.orbit is None or self.accept is None:
            return ""
        verdict = self.accept(best.result.orbit)
        return "" if verdict.repels else verdict.objection

    def _by(self, method: SearchMethod, found: EventReturn, place: ParameterValues) -> BestOrbit:
        """Return the best orbit by a method, from an orbit."""
        orbits = OrbitsOverValues(
            problem=self.problem,
            values=place,
            names=tuple(self.free),
            simulation=self.simulation,
            starts=self.starts,
            shape=self.shape,
        )
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
            corners=({}, *self.objective.trial_corners),
            on_progress=self.on_progress,
        )
        return _result(task, place)


@dataclass(frozen=True, slots=True, kw_only=True)
class BestOrbit:
    """The end of a search from one orbit.

    Attributes:
        result: The result.
        values: Values at the end.
        found: The orbit there.
        violation: Largest violation of a bound or a target, in units of its size.
        extents: Name to range of the quantities of the objective, and of the bounds over all
            corners.
        is_last: True if the orbit is the last before the end of a family.
    """

    result: SearchResult
    values: ParameterValues
    found: EventReturn
    violation: float
    extents: Mapping[str, Extent]
    is_last: bool

    def told(self, **changes: Any) -> BestOrbit:
        """Return the same end with other fields of the result.

        Args:
            changes: The fields.
        """
        return replace(self, result=replace(self.result, **changes))

    def measured(self, name: str, extent: Extent) -> BestOrbit:
        """Return the same end with a further quantity.

        Args:
            name: Its name.
            extent: Its range.
        """
        return replace(self, extents={**self.extents, name: extent})


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

    def trial(self, u: Vector, *, settles: bool = True) -> Sample:
        """Return objective and rows at free values in the unit box.

        Args:
            u: The free values in the unit box.
            settles: Whether a motion may settle to an orbit that is not near the last orbit.

        Raises:
            SimulationError: If no orbit is found near the last orbit.
            StepError: If an event of the objective or a bound does not occur.
        """
        self.on_progress("optimizing", None)
        numbers = self.numbers(u)
        points = tuple(self.orbits.at(numbers, corner, settles=settles) for corner in self.corners)
        costs = tuple(
            tuple(map(self._in_box, self.objective.costs(_Costed(self, point, numbers))))
            for point in points
        )
        rows: list[Slope] = []
        equal: list[Slope] = []
        for point, corner in zip(points, self.corners, strict=True):
            for bound in self.bounds:
                found = [self._in_box(one) for one in self._rows(point, bound, numbers, corner)]
                if bound.lower == bound.upper and not point.is_signal(bound.name):
                    equal.append(min(found[: len(found) // 2], key=lambda one: one.value))
                else:
                    rows += found
        equal += map(self._in_box, self.objective.misses(points[0]))
        return Sample(u=u, points=points, costs=costs, rows=tuple(rows), equal=tuple(equal))

    def bound_equations(self, trial: Sample) -> tuple[Slope, ...]:
        """Return the residuals of bounds with equal ends.

        Args:
            trial: The trial. A target is its last equation.
        """
        return trial.equal[:-1] if self.objective.prescribes else trial.equal

    def excess(self, trial: Sample) -> float:
        """Return the largest violation of a bound, zero if all bounds hold.

        Args:
            trial: The trial.
        """
        return replace(trial, equal=self.bound_equations(trial)).violation

    def sized(self, numbers: Vector) -> _Task:
        """Return the task with the sizes of the bounded quantities at free values.

        Raises:
            SimulationError: If no orbit is found.
            StepError: If an event of a bound does not occur.
        """
        if not self.bounds:
            return self
        point = self.orbits.at(numbers, {})
        sizes = {one.name: _size_of(one, point.extent(one.name)) for one in self.bounds}
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
        if not self.objective.has_edges:
            return found
        # Steps shrink until the orbit is near, so no motion has to settle anew.
        near = partial(self.trial, settles=False)
        return along_edges(near, found, abs(first.value) or 1.0)

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

    def by_program(self, first: Sample) -> tuple[Optimum, int]:
        """Return the optimum of the program near a first trial, and Ipopt's iterations.

        Args:
            first: The trial.

        Raises:
            SimulationError: If the program leads to no orbit.
            StepError: If an event of the objective or a bound does not occur there.
        """
        own, *others = first.points
        nearness = nearness_of(self.origin, self.free)
        solved = orbit_by_program(
            self.orbits.problem,
            own.values,
            own.found,
            ProgramTask(
                free=self.free,
                objective=self.objective,
                bounds=self.bounds,
                sizes=self.sizes,
                origin=nearness.first,
                units=nearness.sizes,
                corners=self.corners[1:],
            ),
            corners=[point.found for point in others],
            simulation=self.orbits.simulation,
            on_progress=self.on_progress,
        )
        found = (solved.found, *solved.corners)
        for corner, orbit in zip(self.corners, found, strict=True):
            self.orbits.begin(orbit, corner)
        trial = self.trial(self.in_box(solved.values))
        optimum = Optimum(trial=trial, converged=solved.converged, reason=solved.detail)
        return optimum, solved.iterations

    def paths(self) -> OrbitPaths:
        """Return the orbits over the free values as lines."""
        return OrbitPaths(
            orbits=self.orbits, free=self.free, bounds=self.bounds, on_progress=self.on_progress
        )

    def from_path(self, values: ParameterValues, found: EventReturn, section: str) -> Sample:
        """Return the trial at a followed orbit.

        Args:
            values: Its values.
            found: The orbit.
            section: Name of the event at which the orbits start.

        Raises:
            SimulationError: If the orbit lacks the event, or does not return.
        """
        self.orbits.begin(self.paths().back(found, values, section))
        return self.trial(self.in_box(values))

    def in_box(self, values: ParameterValues) -> Vector:
        """Return the free values in the unit box.

        Args:
            values: The values.
        """
        low, high = self.ranges.T
        numbers = np.array([values.number(name) for name in self.free])
        return (numbers - low) / np.where(high > low, high - low, 1.0)


@dataclass(frozen=True, slots=True)
class _Costed:
    """An orbit of a trial.

    Attributes:
        task: The search.
        point: The orbit.
        numbers: Free values, ``(k,)``.
    """

    task: _Task
    point: OrbitAtValues
    numbers: Vector

    def nearness(self, goal: Mapping[str, float]) -> Slope:
        """Return the distance of the free values from a goal, or from their start.

        Args:
            goal: Name to target value.
        """
        free = self.task.free
        nearness = nearness_of(self.task.origin, free)
        here = dict(zip(free, map(float, self.numbers), strict=True))
        wanted = {**nearness.first, **goal}
        by = [(here[name] - wanted[name]) / nearness.sizes[name] ** 2 for name in free]
        return Slope(value=nearness.distance(here, goal), by=np.array(by))

    def differenced(self, name: str) -> Slope:
        """Return a quantity whose derivatives are differences, at the search's own parameters.

        Args:
            name: Name of the quantity.
        """
        return self.task.orbits.differenced(name, self.point, self.numbers, self.task.ranges, {})


def _result(task: _Task, place: ParameterValues) -> BestOrbit:
    """Return the best orbit from free values at which there is an orbit.

    Raises:
        InputError: If the event of the objective is missing there.
        SimulationError: If a corner lacks an orbit there.
    """
    try:
        task = task.sized(np.array([place.number(name) for name in task.free]))
        first = task.trial(task.in_box(place))
    except NoEventError as error:
        wanted = "must be about events of the orbit"
        raise InputError(f"Argument `{error.argument}` {wanted}, but {error}.") from error
    if isinstance(task.objective, MaxPush):
        return _strongest(task, task.objective, first)
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
    if min(one.trial.violation for one in found) and task.bounds:
        kept = _least_violation(task, first)
        if kept is not None and task.excess(kept):
            return Optimum(trial=kept, converged=True)
        if kept is not None:
            found.append(task.near(kept))
    best = min(found, key=lambda one: one.trial.rank)
    return task.finished(best, first)


def _by_program(task: _Task, first: Sample) -> BestOrbit:
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
            told = told.told(orbit=None, status=SearchStatus.NOT_SOLVED, detail=detail)
        else:
            told = _told(task, first, solved)
        return told.told(method=SearchMethod.PROGRAM, iterations=iterations)
    if solved is not None and not reason and solved.trial.violation <= _NEARLY:
        checked = task.finished(task.near(solved.trial), first)
        if not checked.trial.violation:
            return _told(task, first, checked).told(
                method=SearchMethod.PROGRAM,
                iterations=iterations,
                remarks=_difference(solved.trial, checked.trial, first),
            )
    for corner, point in zip(task.corners, first.points, strict=True):
        task.orbits.begin(point.found, corner)
    told = _told(task, first, _by_shooting(task, first))
    said = reason.rstrip(".") or "its orbit does not keep the bounds"
    remark = f"The program found no optimum ({said})."
    return told.told(iterations=iterations, remarks=(remark,))


def _difference(solved: Sample, checked: Sample, first: Sample) -> tuple[str, ...]:
    """Return a remark if shooting improves the optimum of a program."""
    gained = solved.value - checked.value
    if solved.violation or gained <= _SAME_VALUE * max(abs(checked.value), abs(first.value)):
        return ()
    return (
        f"The program ends at {solved.value:.10g}, and shooting goes on from there to "
        f"{checked.value:.10g}.",
    )


def _strongest(task: _Task, objective: MaxPush, first: Sample) -> BestOrbit:
    """Return the orbit with the largest least push, within the bounds."""
    start = task.near(first).trial if first.violation else first
    if start.violation:
        return _told(task, first, Optimum(trial=start, converged=True))
    point, section = start.points[0], _section(start)
    best = strongest(task.paths(), objective, point.values, point.found)
    trial = task.from_path(best.values, best.found, section)
    told = _told(task, first, Optimum(trial=trial, converged=True))
    if not best.is_kept:
        return told.told(orbit=None, status=SearchStatus.NOT_SOLVED, detail=best.text)
    impulses = [one.impulse for one in best.pushes]
    return told.told(
        value=impulses[0],
        worst=best.impulse,
        worst_at=dict(best.least.corner),
        mean=float(np.mean(impulses[1:])) if len(impulses) > 1 else None,
        push=best.least.push,
    ).measured(PUSH, best.extent)


def _widest(task: _Task, first: Sample) -> BestOrbit:
    """Return the orbit with the widest margin, within the bounds."""
    start = task.near(first).trial if first.violation else first
    if start.violation:
        return _told(task, first, Optimum(trial=start, converged=True))
    point, section = start.points[0], _section(start)
    best = widest(task.paths(), point.values, point.found)
    trial = task.from_path(best.values, best.orbit, section)
    told = _told(task, first, Optimum(trial=trial, converged=True))
    margin = best.nearest.distance
    told = told.told(value=margin, worst=margin, detail=told.result.detail or best.text)
    return told.measured(PERSISTENCE, best.extent)


def _section(trial: Sample) -> str:
    """Return the name of the event at which the orbit of a trial starts."""
    return orbit_event_name(trial.points[0].found.events[-1])


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


def _least_violation(task: _Task, first: Sample) -> Sample | None:
    """Return the trial whose largest violation of a bound is least, ``None`` without an orbit."""

    def violations(u: Vector) -> Sample:
        trial = task.trial(u)
        broken = [row.scaled(-1.0) for row in trial.rows]
        broken += [row.scaled(sign) for row in task.bound_equations(trial) for sign in (1.0, -1.0)]
        return replace(trial, costs=(tuple(broken),), rows=(), equal=())

    try:
        least = least_worst(violations, violations(first.u), precision=_ROUGH)
        return task.trial(least.trial.u)
    except (SimulationError, StepError):
        return None


def _told(task: _Task, first: Sample, best: Optimum) -> BestOrbit:
    """Return the end of a search at an optimum, or at the end of its family."""
    ending = ""
    if task.free and not best.trial.violation and _nears_an_end(first, best):
        best, ending = _at_the_end(task, first, best)
    trial, objective = best.trial, task.objective
    point = trial.points[0]
    corner_costs = [max(one.value for one in costs) for costs in trial.costs]
    place = int(np.argmax(corner_costs))
    extents = {bound.name: _extent(trial.points, bound.name) for bound in task.bounds}
    vanishing = _vanishing(task, first, trial)
    orbit, detail = None, _lacking(task, trial, extents)
    if not detail and vanishing:
        detail = _end_of_family(task, trial, vanishing)
    elif not detail:
        orbit = event_orbit_of(task.orbits.problem, point.values, point.found)
        detail = ending
        if not best.converged and not ending:
            detail = f"The search ended before it converged: {best.reason.rstrip('.')}."
    result = SearchResult(
        status=SearchStatus.NOT_SOLVED if orbit is None else SearchStatus.FOUND,
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
    return BestOrbit(
        result=result,
        values=point.values,
        found=point.found,
        violation=trial.violation,
        extents={**{name: point.extent(name) for name in _measured(objective)}, **extents},
        is_last=bool(ending),
    )


def _nears_an_end(first: Sample, best: Optimum) -> bool:
    """Return True if a search is lost on its way, or ends where a margin of the orbit vanishes."""
    if not best.converged:
        return True
    before, after = first.points[0], best.trial.points[0]
    margins = margins_of_return(before.graph, before.found)
    last = margins_of_return(after.graph, after.found)
    return any(value < _GONE * margins[name] for name, value in last.items() if name in margins)


def _measured(objective: Objective) -> tuple[str, ...]:
    """Return the quantities of an objective that one orbit has."""
    return () if objective.is_sampled else objective.quantities


def _at_the_end(task: _Task, first: Sample, best: Optimum) -> tuple[Optimum, str]:
    """Return the last orbit of a family whose objective improves up to its end, and the end.

    The orbits are followed along the line from the first trial through the best one, or against the
    slope of the objective, to the side of the ranges.
    """
    trial, section = best.trial, _section(best.trial)
    step = trial.u - first.u
    if not np.any(step):
        step = -trial.heights[0].by
    step = np.where(np.abs(step) > _SMALL_STEP * np.max(np.abs(step)), step, 0.0)
    moved = step != 0.0
    if len(task.corners) > 1 or not np.any(moved):
        return best, ""
    reach = np.where(step > 0.0, 1.0 - trial.u, trial.u)[moved] / np.abs(step[moved])
    if not float(np.min(reach)) > 0.0:
        return best, ""
    wanted = task.numbers(np.clip(trial.u + float(np.min(reach)) * step, 0.0, 1.0))
    begin = first.points[0]
    values = begin.values.replaced(dict(zip(task.free, map(float, wanted), strict=True)))
    path = task.paths().follow(begin.found, begin.values, values, steps=TO_VALUES, is_stable=False)
    if path.orbit is None or path.arrived:
        return best, ""
    lost = f"The way to {task.objective.wish} ends: this is the last orbit before. {path.ending}"
    try:
        last = task.from_path(path.values, path.orbit, section)
    except (SimulationError, StepError):
        last = trial
        task.orbits.begin(trial.points[0].found)
    gained = trial.value - last.value
    if last.violation or gained < 0.0:
        return best, ""
    is_better = gained > _SAME_VALUE * max(abs(trial.value), abs(first.value))
    return (replace(best, trial=last) if is_better else best), lost


def _lacking(task: _Task, trial: Sample, extents: Mapping[str, Extent]) -> str:
    """Return why the orbit of a trial is refused, as sentences. Empty if it is accepted."""
    broken = objection_to(task.bounds, extents)
    if not broken and not trial.violation:
        return ""
    where = listed(dict(zip(task.free, map(float, task.numbers(trial.u)), strict=True)))
    held = [
        f"{name} at its bound {end:g}"
        for name, u, ends in zip(task.free, trial.u, task.free.values(), strict=True)
        for side, end in zip((u, 1.0 - u), ends, strict=True)
        if side <= _AT_BOUND
    ]
    at = f"at {where} ({', '.join(held)})" if held else f"at {where}"
    wish, seen = task.objective.wish, task.objective.reached(trial.points[0])
    if broken:
        reached = f"No orbit was found that keeps all bounds. The nearest one, {at}: {broken}"
        return f"{reached} There the orbit has {seen}." if seen else reached
    if not isinstance(task.objective, Target):
        return f"No orbit with {wish} was found in the ranges."
    miss = abs(task.objective.prescribed(trial.points[0]).value - task.objective.target)
    kept = ", ".join(
        f"`{bound.name}` is within {bound.text} by {-excess(bound, extents[bound.name]):.3g}"
        for bound in task.bounds
    )
    return (
        f"No orbit with {wish} was found in the ranges. The nearest that was reached has "
        f"{seen}, {at}; missed: `{wish}` by {miss:.3g}"
        f"{f'; {kept}' if kept else ''}."
    )


def _size_of(bound: Bound, extent: Extent) -> float:
    """Return the unit in which a bounded quantity is scaled."""
    ends = [abs(end) for end in (bound.lower, bound.upper) if math.isfinite(end)]
    return max(*ends, extent.largest) or 1.0


def _extent(points: Sequence[OrbitAtValues], name: str) -> Extent:
    """Return the range of a quantity over all corners."""
    found = [point.extent(name) for point in points]
    return Extent(
        lowest=min(one.lowest for one in found), highest=max(one.highest for one in found)
    )


def _vanishing(task: _Task, first: Sample, last: Sample) -> dict[str, float]:
    """Return the impacts that no bound keeps and whose speed falls to nothing at every corner."""
    objective = task.objective
    begun = objective.struck(first.points[0])
    ended = [objective.struck(point) for point in last.points]
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
    speeds = objective.struck(first.points[0])
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
