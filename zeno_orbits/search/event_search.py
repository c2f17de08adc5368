"""Search for the best orbit of any machine from one start, or for several orbits, ranked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model import GraphDynamics, ParameterValues, Problem, unknown
from zeno_orbits.orbits import (
    ENERGY,
    PERIOD,
    Bound,
    Orbit,
    course_signal_names,
    event_quantity_names,
    has_source,
    require_event_quantity,
)
from zeno_orbits.search.candidates import judged, ranked_candidates
from zeno_orbits.search.closing import require_no_other_start
from zeno_orbits.search.gains import GainSearch
from zeno_orbits.search.objectives import (
    MaxMargin,
    MaxPush,
    MinEnergy,
    MinPeak,
    MinSpectralRadius,
    NearestGains,
    Objective,
    OfImpacts,
    TargetAmplitude,
    TargetPeriod,
)
from zeno_orbits.search.outcome import Accept, EventSearchResult
from zeno_orbits.search.points import DIFFERENCED
from zeno_orbits.search.search_problem import clipped
from zeno_orbits.search.settings import SearchMethod
from zeno_orbits.search.validation import require_possible_bounds
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
    _require_valid(problem, values, free, wish, bounds)
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
        _require_source(graph, "objective", objective.wish)
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
        _require_source(graph, "bounds", "the energy")
    if "." in name:
        require_event_quantity(name, graph, "bounds")
    if ".impacts" in name:
        raise InputError(
            f"Argument `bounds` must not bound the number `{name}`: bound a speed or a time."
        )


def _require_source(graph: GraphDynamics, argument: str, what: str) -> None:
    if not has_source(graph.compiled):
        raise InputError(
            f"Argument `{argument}` asks for {what}, but the machine has no source of energy: "
            "give its drive an `input_power`, or ask for another quantity."
        )
