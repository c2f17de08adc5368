"""Search for the best orbit of any machine from one start, or for several orbits, ranked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from zeno_orbits.errors import SimulationError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import Bound, Orbit
from zeno_orbits.search.candidates import judged, ranked_candidates
from zeno_orbits.search.closing import require_no_other_start
from zeno_orbits.search.gains import GainSearch
from zeno_orbits.search.objectives import NearestGains, Objective
from zeno_orbits.search.outcome import Accept, EventSearchResult
from zeno_orbits.search.search_problem import clipped
from zeno_orbits.search.settings import SearchMethod
from zeno_orbits.search.validation import check_bounds, check_objective
from zeno_orbits.simulation import SimulationSettings
from zeno_orbits.work import Progress, silent


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
    accept: Accept | None = None,
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
    for name, box in free.items():
        problem.require_range(name, box, argument="vary")
    check_objective(problem, wish, free)
    check_bounds(problem.graph_dynamics(values), bounds)
    if isinstance(wish, NearestGains):
        values = values.replaced(wish.target)
    if near is not None:
        require_no_other_start(start, section)
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
        return judged(search.best(found, place).result, accept)
    if trouble is None:
        raise AssertionError("A search has a first place.")
    raise trouble


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
