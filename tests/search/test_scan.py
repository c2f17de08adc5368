"""A scan of the box puts the starts of a search in order: the best valleys first."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from zeno_orbits.maps import Attractor, Fate
from zeno_orbits.model.problem import Problem
from zeno_orbits.orbits import Bound, OrbitShape
from zeno_orbits.search import (
    FastestContraction,
    NearestGains,
    SearchSettings,
    SearchStatus,
    TargetPeriod,
    scan,
    search_gains,
)
from zeno_orbits.search.objectives import LEAST_RADIUS
from zeno_orbits.search.scan import scan_summary, start_order, start_place
from zeno_orbits.search.search_problem import SearchProblem, with_targets
from zeno_orbits.search.start import numbered_start, scanned

BOX = (-1.9, -0.9)


def _search(problem: Problem, **changes: Any) -> SearchProblem:
    told: dict[str, Any] = {
        "problem": problem,
        "values": problem.values(gains={"Kd": -1.0}),
        "free": {"Kd": BOX},
        "objective": FastestContraction(),
        "initial_states": problem.starts,
        "settings": SearchSettings(),
    }
    return with_targets(SearchProblem(**told | changes))


def _orbit(radius: float, **changes: Any) -> Attractor:
    told: dict[str, Any] = {"fate": Fate.ZENO, "returns": 1, "period": 2.0}
    return Attractor(multipliers=(complex(radius),), **told | changes)


def _landscape(
    monkeypatch: pytest.MonkeyPatch, problem: Problem, attractor: Callable[[float], Attractor]
) -> None:
    """Let motions settle to what a function of Kd says."""
    place = problem.names.index("Kd")

    def told(_problem: Problem, places: Sequence[tuple[float, ...]], *_: Any) -> tuple[Any, ...]:
        return tuple(attractor(one[place]) for one in places)

    monkeypatch.setattr(scan, "_settled", told)


def _gains(search: SearchProblem, order: Sequence[int]) -> list[float]:
    return [start_place(search, k).gains["Kd"] for k in order]


def _two_valleys(kd: float) -> Attractor:
    """Valleys at -1.7, the deeper one, and at -1.2; no orbit below -1.8."""
    if kd < -1.8:
        return Attractor(fate=Fate.ESCAPE, escaped="theta1")
    return _orbit(min(0.1 + 5 * abs(kd + 1.7), 0.3 + abs(kd + 1.2)))


def test_the_best_place_of_each_valley_comes_first_and_places_without_an_orbit_last(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    _landscape(monkeypatch, problem, _two_valleys)
    search = _search(problem)
    order = start_order(search)
    kd = _gains(search, order)
    assert sorted(order) == list(range(len(order)))
    # Places are 1/24 apart in the mean, of a box that is one wide.
    assert kd[0] == pytest.approx(-1.7, abs=0.06)
    assert kd[1] == pytest.approx(-1.2, abs=0.06)
    radius = [_two_valleys(one).spectral_radius for one in kd]
    n_orbits = int(np.sum(np.isfinite(radius)))
    assert np.all(np.isfinite(radius[:n_orbits]))
    assert radius[0] == min(radius[:n_orbits])
    # The third is no neighbour of the first two.
    assert min(abs(kd[2] - kd[0]), abs(kd[2] - kd[1])) > 0.1


def test_bounds_that_an_orbit_breaks_put_it_behind_those_that_keep_them(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    _landscape(monkeypatch, problem, lambda kd: _orbit(2 + kd, period=1.5 if kd > -1.3 else 2.5))
    best = start_place(_search(problem), start_order(_search(problem))[0])
    assert best.gains["Kd"] < -1.8
    short = _search(problem, bounds=(Bound(name="period", upper=2.0),))
    kept = start_place(short, start_order(short)[0])
    assert -1.3 < kept.gains["Kd"] < -1.2


def test_what_is_near_starts_at_the_given_numbers_and_goes_on_by_nearness(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    _landscape(
        monkeypatch, problem, lambda kd: _orbit(0.1) if kd < -1.4 else Attractor(fate=Fate.REST)
    )
    search = _search(problem, objective=NearestGains(target={}))
    kd = _gains(search, start_order(search))
    orbits = [one for one in kd if one < -1.4]
    assert kd[0] == -1.0
    assert kd[1 : 1 + len(orbits)] == sorted(orbits, reverse=True)


def test_orbits_of_another_number_of_releases_are_no_starts_for_a_shape(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    _landscape(monkeypatch, problem, lambda kd: _orbit(0.1, returns=2 if kd < -1.5 else 1))
    search = _search(problem, shape=OrbitShape.parsed("zeno*2"))
    assert _gains(search, start_order(search))[0] < -1.5


def test_without_an_orbit_anywhere_the_first_place_comes_twice(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    _landscape(monkeypatch, problem, lambda _: Attractor(fate=Fate.REST))
    search = _search(problem)
    assert start_order(search)[:3] == (0, 0, 1)
    search = scanned(search, 0)
    first, again = numbered_start(search, 0), numbered_start(search, 1)
    assert first.values == again.values
    # The second time by a long way, without another simulation.
    assert (first.easy, first.known_empty) == ((), False)
    assert again.easy
    assert again.known_empty
    assert scan_summary(search).endswith("looked at by simulation: rest (25).")


def test_the_places_of_a_scan_do_not_depend_on_how_many_starts_there_may_be(
    problem: Problem,
) -> None:
    few = _search(problem, settings=SearchSettings(n_starts=1))
    many = _search(problem, settings=SearchSettings(n_starts=60))
    for k in range(1, 20):
        assert start_place(few, k) == start_place(many, k)


# The motor pendulum.


@pytest.mark.slow
def test_the_fastest_contraction_of_the_whole_box_is_found_beyond_a_hill(problem: Problem) -> None:
    # From the end of the box at -1.2 all ways lead up to 0.42 before they lead down to 0.
    result = search_gains(
        problem,
        problem.values(),
        free={"Kd": (-1.9, -1.2)},
        objective=FastestContraction(),
    )
    assert result.candidates[0].score == LEAST_RADIUS
    # A scan in steps of 1e-4 by simulation: the multiplier passes zero between -1.5658 and -1.5657.
    assert result.unwrap().gains["Kd"] == pytest.approx(-1.5658, abs=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("objective", [NearestGains(target={}), TargetPeriod(target=1.9)])
def test_a_box_is_answered_whose_start_lies_outside_where_no_orbit_is(
    problem: Problem, objective: Any
) -> None:
    values = problem.values(gains={"Kd": -2.5})
    result = search_gains(problem, values, free={"Kd": (-1.9, -1.2)}, objective=objective)
    assert result.status is SearchStatus.FOUND
    assert [attempt.status for attempt in result.attempts] == [
        SearchStatus.NO_GUESS,
        SearchStatus.FOUND,
    ]
