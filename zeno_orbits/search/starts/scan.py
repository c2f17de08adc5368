"""A scan of the search box: short simulations locate orbits and rank them.

A program finds the optimum near its start. The points of the scan are the starts of a search. Their
order follows from the attractors there. For an optimum, the search starts at the best point of each
valley of the objective, then at points far from these. Points without an orbit are last.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.integrators import Tolerance
from zeno_orbits.maps import ORBITS, Accuracy, Attractor, AttractorClass, attractors_at
from zeno_orbits.model import ParameterValues, Problem, own_time
from zeno_orbits.orbits import (
    EventSequence,
    SectionMode,
    event_return,
    objection_to,
)
from zeno_orbits.search.closing.closing import settled_return
from zeno_orbits.search.objectives import TargetPeriod
from zeno_orbits.search.optimum.points import OrbitAtValues
from zeno_orbits.search.search_problem import SearchProblem, clipped
from zeno_orbits.simulation import Extent, SimulationSettings, ZenoExtrapolation, simulate

_PLACES = 24
"""Points of a scan per free value."""
_MOST_DIMENSIONS = 3
ACCURACY = Accuracy(motion=1e-6, orbit=1e-8, near=0.05, exact=1e-3, repeats=1e-4)
"""Three digits are sufficient for the choice of starts."""
_ARRIVED = 1e-3
"""Part of the period after its end in which the last impact of an orbit may occur."""

_LOOSE = SimulationSettings(
    tolerance=Tolerance(relative=1e-8, absolute=1e-10),
    completion=ZenoExtrapolation(tolerance=1e-11),
)
"""Accuracy of a period that is only ranked."""


def start_place(search: SearchProblem, number: int) -> ParameterValues:
    """Return the values at a point of the scan.

    Point 0 has the given values, clipped to the box. The other points are a Halton sequence.

    Args:
        search: The search.
        number: Index of the point.
    """
    if number == 0:
        return clipped(search.values, search.free)
    lower, upper = np.array(list(search.free.values())).T
    place = _halton(len(search.free), _n_places(search), search.settings.seed)[number - 1]
    chosen = dict(zip(search.free, map(float, lower + place * (upper - lower)), strict=True))
    return search.values.replaced(chosen)


def start_order(search: SearchProblem) -> tuple[int, ...]:
    """Return the indices of all points, in the order in which a search starts there.

    If no point has an orbit, the first point occurs twice.

    Args:
        search: The search, with at least one free value.
    """
    places, attractors = _places(search), _attractors(search)
    ranks = [_rank(search, *pair) for pair in zip(places, attractors, strict=True)]
    if search.objective.is_sampled:
        ranks = _by_distance(search, places, attractors, ranks)
    by_rank = sorted(range(len(places)), key=lambda k: ranks[k])
    if not any(rank.group == 0 for rank in ranks):
        # A second start at the first point, by continuation from easier values.
        return (0, 0, *(k for k in by_rank if k != 0))
    if not search.seeks_optimum:
        return (0, *(k for k in by_rank if k != 0))
    low, high = np.array(list(search.free.values())).T
    free = np.array([[place.number(name) for name in search.free] for place in places])
    unit = free / (high - low)
    orbits = [k for k in by_rank if ranks[k].group == 0]
    order = [k for k in orbits if _is_valley(k, orbits, unit, ranks)]
    others = [k for k in orbits if k not in order][: len(orbits) // 2]
    while others:
        away = [min(float(np.linalg.norm(unit[k] - unit[j])) for j in order) for k in others]
        order.append(others.pop(int(np.argmax(away))))
    if search.objective.is_sampled and ranks[0].group == 0:
        # Distances between points say little about the optimum: the given values count first.
        order = [0, *(k for k in order if k != 0)]
    return (*order, *(k for k in by_rank if k not in order))


def scan_summary(search: SearchProblem) -> str:
    """Return the number of points of the box per attractor, as a sentence.

    Args:
        search: The search, with at least one free value.
    """
    counts = Counter(one.phrase for one in _attractors(search)).most_common()
    found = ", ".join(f"{phrase} ({count})" for phrase, count in counts)
    return f"{len(_places(search))} points of the box were simulated: {found}."


def stays_in_contact(search: SearchProblem) -> bool:
    """Return True if the motion of every point of the box ends in permanent contact.

    Args:
        search: The search, with at least one free value.
    """
    return all(one.fate is AttractorClass.HELD for one in _attractors(search))


def require_period_in_reach(search: SearchProblem, objective: TargetPeriod) -> None:
    """Refuse a period that is far from the period of every orbit of the scan.

    The scan takes seconds, so it is asked only if the period is also far from the time scale of the
    problem.

    Args:
        search: The search.
        objective: Its objective, with the period.

    Raises:
        InputError: If no period of an orbit is near it (`TargetPeriod.require_near`).
    """
    problem = search.problem
    start = np.array(problem.state_vector(problem.starts[0], search.values))
    if objective.is_far_from(own_time(search.first_system(search.values), start)):
        orbits = [one for one in _attractors(search) if one.fate in ORBITS]
        objective.require_near([one.period for one in orbits])


class _Rank(NamedTuple):
    """Sort key of an attractor in the order of starts: orbits within the bounds, the best first."""

    group: int
    violates: bool = False
    score: float = 0.0


def _n_places(search: SearchProblem) -> int:
    """Return the number of points after the first, at least the number of starts."""
    return max(search.settings.n_starts, _PLACES * min(len(search.free), _MOST_DIMENSIONS))


def _places(search: SearchProblem) -> list[ParameterValues]:
    return [start_place(search, k) for k in range(1 + _n_places(search))]


def _attractors(search: SearchProblem) -> tuple[Attractor, ...]:
    """Return the attractors at the points of a search."""
    starts = search.initial_states or search.problem.starts
    return _settled(
        search.problem,
        tuple(place.vector for place in _places(search)),
        tuple(tuple(start.items()) for start in starts),
        search.settings.settling.horizon,
    )


@lru_cache(maxsize=1)
def _settled(
    problem: Problem,
    places: tuple[tuple[float, ...], ...],
    starts: tuple[tuple[tuple[str, Any], ...], ...],
    until: float | None,
) -> tuple[Attractor, ...]:
    """Return the attractor at each point, from the first initial state that leads to an orbit."""
    n_gains = len(problem.gains)
    values = [
        ParameterValues(
            gains=dict(zip(problem.names[:n_gains], place, strict=False)),
            parameters=dict(zip(problem.names[n_gains:], place[n_gains:], strict=True)),
        )
        for place in places
    ]
    found: list[Attractor | None] = [None] * len(values)
    for start in starts:
        left = [k for k, one in enumerate(found) if one is None or one.fate not in ORBITS]
        some = [values[k] for k in left]
        try:
            seen = attractors_at(problem, some, start=dict(start), until=until, accuracy=ACCURACY)
        except ZenoOrbitsError as error:
            seen = tuple(Attractor(fate=AttractorClass.FAILED, detail=str(error)) for _ in left)
        for k, one in zip(left, seen, strict=True):
            if found[k] is None or one.fate in ORBITS:
                found[k] = one
    return tuple(one for one in found if one is not None)


def _rank(search: SearchProblem, values: ParameterValues, attractor: Attractor) -> _Rank:
    if attractor.fate not in ORBITS:
        decided = attractor.fate not in (AttractorClass.UNSETTLED, AttractorClass.FAILED)
        return _Rank(2 if decided else 1)
    if search.shape is not None and not _is_of_shape(attractor, search.shape):
        return _Rank(1)
    try:
        return _scored(search, values, attractor)
    except ZenoOrbitsError:
        return _Rank(1)


def _by_distance(
    search: SearchProblem,
    places: Sequence[ParameterValues],
    attractors: Sequence[Attractor],
    ranks: Sequence[_Rank],
) -> list[_Rank]:
    """Return ranks of orbits by their distance from the points with another attractor."""
    low, high = np.array(list(search.free.values())).T
    unit = np.array([[one.number(name) for name in search.free] for one in places]) / (high - low)
    found: list[_Rank] = []
    for k, (rank, one) in enumerate(zip(ranks, attractors, strict=True)):
        others = [
            float(np.max(np.abs(unit[k] - unit[j])))
            for j, other in enumerate(attractors)
            if (other.fate, other.returns, other.sequence) != (one.fate, one.returns, one.sequence)
        ]
        found.append(rank if rank.group else rank._replace(score=-min(others, default=1.0)))
    return found


def _is_of_shape(attractor: Attractor, shape: EventSequence) -> bool:
    """Return True if an orbit has the same number of releases as a shape."""
    return attractor.returns == shape.n_releases


def _scored(search: SearchProblem, values: ParameterValues, attractor: Attractor) -> _Rank:
    """Return the rank of an orbit, from the quantities of its map point and from a simulation."""
    objective = search.objective
    asked = () if objective.is_sampled else objective.quantities
    names = [*asked, *(bound.name for bound in search.bounds)]
    told = {"period": attractor.period, **attractor.margins}
    if attractor.multipliers:
        told["spectral_radius"] = attractor.spectral_radius
    extents = {name: Extent(lowest=x, highest=x) for name, x in told.items()}
    missing = [name for name in names if name not in told]
    score = 0.0
    if missing or objective.prescribes:
        point = _point_at(search, values, attractor)
        extents |= {name: point.extent(name) for name in missing}
        score = max((abs(miss.value) for miss in objective.misses(point)), default=0.0)
    if not (objective.prescribes or objective.is_sampled):
        score = search.score(values, extents)
    return _Rank(0, bool(objection_to(search.bounds, extents)), score)


def _point_at(
    search: SearchProblem, values: ParameterValues, attractor: Attractor
) -> OrbitAtValues:
    """Simulate a period of an attractor that is an orbit.

    Args:
        search: The search.
        values: Values of the attractor.
        attractor: The attractor.

    Raises:
        ZenoOrbitsError: If its motion cannot be simulated for a period.
    """
    graph, state = search.problem.graph_dynamics(values), attractor.state
    if attractor.sequence:
        found = settled_return(search.problem, values, starts=(state,), changing=tuple(search.free))
        return OrbitAtValues(values=values, graph=graph, found=found, chosen=())
    start, n_returns = np.array(search.problem.state_vector(state)), attractor.returns
    stop, is_released = graph.stop_names[0], n_returns > 0
    if not is_released:
        until = (1 + _ARRIVED) * attractor.period
        n_returns = len(simulate(graph, start, until=until, settings=_LOOSE).impacts)
    left, released = ("", stop) if is_released else (stop, "")
    found = event_return(
        graph,
        start,
        section=f"release {stop}" if is_released else f"impact {stop}",
        n_returns=n_returns,
        guess=attractor.period,
        settings=_LOOSE,
        mode=SectionMode(closed=(), sides=(), stop=left, released=released),
    )
    return OrbitAtValues(values=values, graph=graph, found=found, chosen=())


def _is_valley(k: int, orbits: Sequence[int], unit: Vector, ranks: Sequence[_Rank]) -> bool:
    """Return True if the nearest points, two per free value, do not have a better orbit."""
    away = {j: float(np.linalg.norm(unit[k] - unit[j])) for j in orbits if j != k}
    near = sorted(away, key=lambda j: away[j])[: 2 * unit.shape[1]]
    return all(ranks[k] <= ranks[j] for j in near)


@lru_cache(maxsize=1)
def _halton(dimension: int, count: int, seed: int) -> Vector:
    """Return quasi-random points in the unit box, ``(count, dimension)``."""
    # SciPy's statistics take half a second to import, and most searches end at their first start.
    from scipy.stats import qmc

    return qmc.Halton(dimension, seed=seed).random(count)
