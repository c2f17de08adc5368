"""Search for the best orbit of any machine from one start, or for several orbits, ranked."""

from __future__ import annotations

import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from zeno_orbits.errors import SimulationError, ZenoOrbitsError
from zeno_orbits.model import ParameterValues, Problem, ProblemFile
from zeno_orbits.orbits import Bound, EventSequence, Orbit
from zeno_orbits.search.closing.closing import require_no_other_start
from zeno_orbits.search.objectives import NearestGains, Objective
from zeno_orbits.search.optimum.gains import GainSearch
from zeno_orbits.search.outcome import Accept, SearchResult, StartAttempt
from zeno_orbits.search.search_problem import clipped
from zeno_orbits.search.settings import SearchMethod
from zeno_orbits.search.starts.candidates import StartEnd, end_of_start, ranked_candidates
from zeno_orbits.search.starts.multistart import StartWorkers, identity_of, results_in_order
from zeno_orbits.search.validation import check_bounds, check_objective
from zeno_orbits.simulation import SimulationSettings
from zeno_orbits.work import FailedPoint, Progress, silent, to_plain

_LOCAL = (
    "One start led there, so the optimum may be local: 3 candidates (`candidates`, --candidates) "
    "take more starts."
)


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
    shape: EventSequence | None = None,
    until: float | None = None,
    n_starts: int = 12,
    seed: int = 0,
    candidates: int = 1,
    method: SearchMethod = SearchMethod.AUTO,
    accept: Accept | None = None,
    simulation: SimulationSettings | None = None,
    on_progress: Progress = silent,
    spread: StartWorkers | None = None,
) -> SearchResult:
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
        shape: Phases of the period of a machine with the stop `stop`. The default is any.
        until: Longest time to settle [s].
        n_starts: Number of further free values, from all over the ranges, that are tried in turn
            until a motion settles to an orbit.
        seed: Seed of these values, and of the initial states of several orbits.
        candidates: Number of different orbits that are searched, and ranked.
        method: How the optimum is found.
        accept: Check of the orbits. Only accepted orbits are ranked. The default accepts all.
        simulation: Accuracy.
        on_progress: Called with the stage.
        spread: Workers for the starts after the first. By default all starts run in this process.
            The result does not depend on the workers.

    Raises:
        InputError: If a name or range is invalid, the objective needs another machine, or the
            executor or the checkpoint of ``spread`` is not usable.
        SimulationError: If no motion settles to an orbit at any of the free values.
        WorkError: If the workers of ``spread`` cannot finish.
    """
    started = time.perf_counter()
    wish = objective or NearestGains(target={})
    for name, box in free.items():
        problem.require_range(name, box, argument="vary")
    check_objective(problem, wish, free)
    check_bounds(problem.graph_dynamics(values), bounds)
    values = values.replaced(wish.goal)
    if near is not None:
        require_no_other_start(start, section)
        if shape is not None:
            near.shape.agreed(shape)
        n_starts = 0
    search = GainSearch(
        problem=problem,
        origin=clipped(values, free),
        free=free,
        objective=wish,
        bounds=tuple(bounds),
        method=method,
        accept=accept,
        near=near,
        section=section,
        shape=shape,
        until=until,
        simulation=simulation or SimulationSettings(),
        on_progress=on_progress,
    )
    places = _places(search.origin, free, n_starts, seed)
    if spread is None:
        ends = (end_of_start(search, place, start) for place in places)
    else:
        ends = _ends_spread(search, places, start, spread)
    with closing(ends):
        if candidates > 1:
            result = ranked_candidates(search, places, ends, n_wanted=candidates, seed=seed)
        else:
            result = _first_end(search, places, ends)
    return replace(result, wall_time=time.perf_counter() - started)


def _first_end(
    search: GainSearch, places: Sequence[ParameterValues], ends: Generator[StartEnd]
) -> SearchResult:
    """Return the result of the first start from which a motion settles.

    Raises:
        ZenoOrbitsError: If there is none, the reason of the last start.
    """
    attempts: list[StartAttempt] = []
    trouble: ZenoOrbitsError | None = None
    for place, end in zip(places, ends, strict=False):
        attempts.append(end.attempt(place, search.free))
        if end.result is not None:
            found = end.candidate()
            candidates = () if found is None else (found,)
            result = replace(end.result, attempts=tuple(attempts), candidates=candidates)
            return _told(result, several=len(places) > 1)
        trouble = end.error
        if not isinstance(trouble, SimulationError):
            break
    if trouble is None:
        raise AssertionError("A search has a first place.")
    raise trouble


def _told(result: SearchResult, *, several: bool) -> SearchResult:
    """Return the result of one start, with a remark if further starts may lead to a better one."""
    objective = result.objective
    is_best = not result.is_measured or result.score <= objective.least
    if result.orbit is None or is_best or not several:
        return result
    return replace(result, remarks=(*result.remarks, _LOCAL))


def _ends_spread(
    search: GainSearch,
    places: Sequence[ParameterValues],
    start: Mapping[str, float] | None,
    spread: StartWorkers,
) -> Generator[StartEnd]:
    """Yield the ends of starts in order, as `results_in_order`."""
    # The problem is loaded by every worker, and progress is told by this process.
    question = {
        field.name: getattr(search, field.name)
        for field in fields(search)
        if field.name not in ("problem", "on_progress")
    }
    task = _Task(
        problem_file=spread.problem_file, question=question, places=tuple(places), start=start
    )
    results = results_in_order(
        task,
        len(places),
        spread,
        problem=search.problem,
        here=lambda numbers: task.ends(search, numbers),
        identity=task.identity,
    )
    try:
        for result in results:
            if isinstance(result, FailedPoint):
                yield StartEnd(error=SimulationError(result.reason, time=0.0, state=()))
            else:
                yield StartEnd.from_plain(result, search.objective)
    finally:
        results.close()


@dataclass(frozen=True, slots=True, kw_only=True)
class _Task:
    """A task that runs starts by their indices. It contains all data that a worker needs.

    Attributes:
        problem_file: File from which the worker loads the problem.
        question: The search without its problem.
        places: Values of the starts.
        start: Initial state of the motions, by default each start of the problem in turn.
    """

    problem_file: ProblemFile
    question: Mapping[str, Any]
    places: tuple[ParameterValues, ...]
    start: Mapping[str, float] | None

    def __call__(self, numbers: Sequence[int]) -> list[dict[str, Any]]:
        """Return the ends of starts, as plain data."""
        return self.ends(GainSearch(problem=self.problem_file.load(), **self.question), numbers)

    def ends(self, search: GainSearch, numbers: Sequence[int]) -> list[dict[str, Any]]:
        """Return the ends of starts of a given search, as plain data."""
        return [end_of_start(search, self.places[k], self.start).as_plain() for k in numbers]

    def identity(self) -> dict[str, Any]:
        """Return all inputs on which the end of a start depends."""
        question = dict(self.question)
        origin = question.pop("origin")
        others = {
            "start": to_plain(self.start),
            # They follow from the ranges, the number of starts and the seed.
            "places": [to_plain(place.numbers) for place in self.places],
        }
        return identity_of("search of events", self.problem_file, origin, question, others)


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
