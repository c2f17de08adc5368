"""A scan of the box puts the starts of a search in order: the best valleys first."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.searches import question_of
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.maps import Attractor, AttractorClass
from zeno_orbits.model import Problem
from zeno_orbits.orbits import Bound, EventSequence
from zeno_orbits.search import (
    MinSpectralRadius,
    NearestGains,
    SearchSettings,
    SearchStatus,
    TargetPeriod,
    TransientSettings,
    scan,
    search_orbits,
)
from zeno_orbits.search.objectives import LEAST_RADIUS
from zeno_orbits.search.scan import scan_summary, start_order, start_place
from zeno_orbits.search.search_problem import SearchProblem, with_targets
from zeno_orbits.search.start import numbered_start, scanned
from zeno_orbits.simulation import Extent

BOX = (-1.9, -0.9)


def _search(problem: Problem, **changes: Any) -> SearchProblem:
    told: dict[str, Any] = {
        "values": problem.values(gains={"Kd": -1.0}),
        "free": {"Kd": BOX},
        "objective": MinSpectralRadius(),
    }
    return with_targets(question_of(problem, **told | changes))


def _orbit(radius: float, **changes: Any) -> Attractor:
    told: dict[str, Any] = {"fate": AttractorClass.ZENO, "returns": 1, "period": 2.0}
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
        return Attractor(fate=AttractorClass.ESCAPE, escaped="theta1")
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
        monkeypatch,
        problem,
        lambda kd: _orbit(0.1) if kd < -1.4 else Attractor(fate=AttractorClass.REST),
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
    search = _search(problem, shape=EventSequence.parsed("zeno*2"))
    assert _gains(search, start_order(search))[0] < -1.5


def test_without_an_orbit_anywhere_the_first_place_comes_twice(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    _landscape(monkeypatch, problem, lambda _: Attractor(fate=AttractorClass.REST))
    search = _search(problem)
    assert start_order(search)[:3] == (0, 0, 1)
    search = scanned(search, 0)
    first, again = numbered_start(search, 0), numbered_start(search, 1)
    assert first.values == again.values
    # The second time by a long way, without another simulation.
    assert (first.easy, first.known_empty) == ((), False)
    assert again.easy
    assert again.known_empty
    assert scan_summary(search).endswith("were simulated: rest (25).")


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
    result = search_orbits(
        problem,
        problem.values(),
        free={"Kd": (-1.9, -1.2)},
        objective=MinSpectralRadius(),
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
    result = search_orbits(problem, values, free={"Kd": (-1.9, -1.2)}, objective=objective)
    assert result.status is SearchStatus.FOUND
    assert [attempt.status for attempt in result.attempts] == [
        SearchStatus.NO_GUESS,
        SearchStatus.FOUND,
    ]


# By hand.


def test_places_are_in_the_box_each_number_on_its_own_and_the_first_is_what_is_given(
    problem: Problem,
) -> None:
    box = {"Kp": (2.0, 6.0), "Kd": (-1.9, -0.9)}
    search = _search(problem, values=problem.values(gains={"Kp": 9.0}), free=box)
    assert start_place(search, 0).gains == {"Kp": 6.0, "Kd": -1.0}
    assert scan._n_places(search) == 48
    places = [start_place(search, k) for k in range(1, 49)]
    for k, (low, high) in enumerate(box.values()):
        found = np.array([place.vector[problem.names.index([*box][k])] for place in places])
        assert np.all((low <= found) & (found <= high))
        # Spread evenly: every sixth of the range has its share of 8, but for 3.
        counts = np.histogram(found, bins=6, range=(low, high))[0]
        assert np.all(np.abs(counts - 8) <= 3)
    assert len({place.vector for place in places}) == 48
    other = replace(search, settings=SearchSettings(seed=1))
    assert start_place(other, 1) != start_place(search, 1)


def test_after_the_valleys_come_places_far_from_all_before_then_the_rest_by_rank(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    # In units of their ranges, 4 and 0.5; the fourth is the only valley.
    unit = [(0.1, 0.6), (1.0, 0.0), (0.0, 0.9), (0.6, 0.6), (0.9, 0.9), (0.0, 0.0), (0.45, 0.0)]
    scores = [3.0, 6.0, 5.0, 0.0, 2.0, 1.0, 4.0]
    ranks = [*(scan._Rank(0, False, score) for score in scores), scan._Rank(2), scan._Rank(1)]
    unit += [(0.5, 0.5), (0.5, 0.6)]
    places = [problem.values(gains={"Kp": 2 + 4 * u, "Kd": -1.5 + v / 2}) for u, v in unit]
    monkeypatch.setattr(scan, "_places", lambda _: places)
    monkeypatch.setattr(scan, "_attractors", lambda _: list(range(9)))
    monkeypatch.setattr(scan, "_rank", lambda _search, _values, k: ranks[k])
    asked: list[Any] = []

    def valley(k: int, orbits: Any, at: Any, by: Any) -> bool:
        asked.append((orbits, by))
        # Only how far places are apart counts.
        assert at - at[0] == pytest.approx(np.array(unit) - unit[0])
        return k == 3

    monkeypatch.setattr(scan, "_is_valley", valley)
    free = {"Kp": (2.0, 6.0), "Kd": (-1.5, -1.0)}
    # Of the seven orbits three more are looked at: the corner, 0.85 off the valley, and then the
    # first place, 0.5 off both, before the fifth, 0.42 off the valley.
    assert start_order(_search(problem, free=free)) == (3, 5, 0, 4, 6, 2, 1, 8, 7)
    assert asked == 7 * [([3, 5, 4, 0, 6, 2, 1], ranks)]
    nearest = _search(problem, free=free, objective=NearestGains(target={}))
    assert start_order(nearest) == (0, 3, 5, 4, 6, 2, 1, 8, 7)
    ranks[:] = [scan._Rank(1 + (k % 2 == 0)) for k in range(9)]
    assert start_order(nearest) == (0, 0, 1, 3, 5, 7, 2, 4, 6, 8)


@pytest.mark.parametrize(("n_free", "n_starts", "places"), [(1, 12, 24), (3, 12, 72), (4, 12, 72)])
def test_there_are_as_many_places_as_starts_at_least(
    n_free: int, n_starts: int, places: int
) -> None:
    def asked(starts: int) -> Any:
        free = dict.fromkeys(range(n_free))
        return SimpleNamespace(free=free, settings=SearchSettings(n_starts=starts))

    assert scan._n_places(asked(n_starts)) == places
    assert scan._n_places(asked(100)) == 100


def test_of_several_starts_the_first_that_leads_to_an_orbit_counts(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    scan._settled.cache_clear()
    asked: list[Any] = []
    rest, gone = (
        Attractor(fate=AttractorClass.REST),
        Attractor(fate=AttractorClass.ESCAPE, escaped="theta1"),
    )
    first, second = _orbit(0.25), _orbit(0.75)
    answers: list[Any] = [(first, rest, gone, rest), (second, gone, rest), ZenoOrbitsError("No.")]

    def told(of: Problem, values: Any, **named: Any) -> Any:
        asked.append((of, [one.gains["Kd"] for one in values], named))
        answer = answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    monkeypatch.setattr(scan, "attractors_at", told)
    places = tuple(problem.values(gains={"Kd": kd}).vector for kd in (-1.0, -1.1, -1.2, -1.3))
    starts = tuple(problem.state_vector({"theta1": x}) for x in (0.1, 0.2, 0.3))
    found = scan._settled(problem, places, starts, 7.0)
    # What else the first start leads to stays, if no other leads to an orbit.
    assert found == (first, second, gone, rest)
    assert [kd for _, kd, _ in asked] == [
        [-1.0, -1.1, -1.2, -1.3], [-1.1, -1.2, -1.3], [-1.2, -1.3]
    ]  # fmt: skip
    assert [named["start"]["theta1"] for *_, named in asked] == [0.1, 0.2, 0.3]
    assert {named["until"] for *_, named in asked} == {7.0}
    scan._settled.cache_clear()
    answers.append(ZenoOrbitsError("It fails."))
    (failed,) = scan._settled(problem, places[:1], starts[:1], None)
    assert (failed.fate, failed.detail) == (AttractorClass.FAILED, "It fails.")
    scan._settled.cache_clear()


def test_places_are_asked_about_with_the_starts_and_the_wait_of_the_search(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []
    monkeypatch.setattr(scan, "_settled", lambda *arguments: asked.append(arguments) or ())
    settings = SearchSettings(settling=TransientSettings(horizon=9.0))
    search = _search(problem, settings=settings, initial_states=({"theta1": 0.5},))
    scan._attractors(search)
    ((of, places, starts, until),) = asked
    assert (of, until, starts) == (problem, 9.0, (problem.state_vector({"theta1": 0.5}),))
    assert places == tuple(start_place(search, k).vector for k in range(25))


@pytest.mark.parametrize(
    ("fate", "group"),
    [
        (AttractorClass.ZENO, 0),
        (AttractorClass.SIMPLE, 0),
        (AttractorClass.NO_ZENO, 0),
        (AttractorClass.UNSETTLED, 1),
        (AttractorClass.FAILED, 1),
        (AttractorClass.REST, 2),
        (AttractorClass.ESCAPE, 2),
    ],
)
def test_places_with_an_orbit_come_first_and_those_that_are_decided_last(
    problem: Problem, monkeypatch: pytest.MonkeyPatch, fate: AttractorClass, group: int
) -> None:
    monkeypatch.setattr(scan, "_scored", lambda *_: scan._Rank(0, False, 1.5))
    search, values = _search(problem), problem.values()
    rank = scan._rank(search, values, Attractor(fate=fate, returns=1))
    assert rank == ((0, False, 1.5) if group == 0 else (group, False, 0.0))

    def fails(*_: Any) -> Any:
        raise ZenoOrbitsError("It cannot be measured.")

    monkeypatch.setattr(scan, "_scored", fails)
    unknown = scan._rank(search, values, Attractor(fate=fate, returns=1))
    assert unknown == (max(group, 1), False, 0.0)
    monkeypatch.setattr(scan, "_scored", lambda *_: scan._Rank(0))
    twice = _search(problem, shape=EventSequence.parsed("zeno*2"))
    assert scan._rank(twice, values, Attractor(fate=fate, returns=1)).group == max(group, 1)
    assert scan._rank(twice, values, Attractor(fate=fate, returns=2)).group == group


def test_an_orbit_is_scored_by_what_a_map_tells_and_measured_for_the_rest(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []

    def measure(orbit: Any, of: Problem, names: Any, *, simulation: Any) -> Any:
        asked.append((orbit, of, names, simulation))
        return {name: Extent(lowest=3.0, highest=4.0) for name in names}

    monkeypatch.setattr(scan, "measure", measure)
    monkeypatch.setattr(scan, "cycle_at", lambda *_: SimpleNamespace(period=2.5))
    monkeypatch.setattr(scan, "orbit_of", lambda cycle, *_: cycle)
    values, seen = problem.values(), _orbit(0.25, period=2.0, margins={"margin": 0.5})
    fastest = _search(problem)
    assert scan._scored(fastest, values, seen) == (0, False, 0.25)
    short = replace(fastest, bounds=(Bound(name="period", upper=1.5),))
    assert scan._scored(short, values, seen) == (0, True, 0.25)
    wide = replace(fastest, bounds=(Bound(name="margin", lower=0.4),))
    assert scan._scored(wide, values, seen) == (0, False, 0.25)
    assert asked == []
    # What the map does not tell: of its multipliers there may be none.
    assert scan._scored(fastest, values, replace(seen, multipliers=())) == (0, False, 4.0)
    ((orbit, of, names, simulation),) = asked
    assert (orbit.period, of, names) == (2.5, problem, ["spectral_radius"])
    assert simulation == TransientSettings().simulation
    swung = replace(fastest, bounds=(Bound(name="theta1", upper=3.5),))
    assert scan._scored(swung, values, seen) == (0, True, 0.25)
    assert asked[-1][2] == ["theta1"]
    # How far a target is missed is told by a simulation.
    target = _search(problem, objective=TargetPeriod(target=2.0))
    assert scan._scored(target, values, seen) == (0, False, 0.25)
    assert len(asked) == 2
    nearest = _search(problem, objective=NearestGains(target={}))
    assert scan._scored(nearest, nearest.values, seen) == (0, False, 0.0)


def test_a_period_of_an_attractor_has_its_returns_or_the_impacts_of_a_little_more(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []
    hits = SimpleNamespace(impacts=[None, None, None])
    monkeypatch.setattr(
        scan, "simulate", lambda *a, **named: asked.append((a[1].tolist(), named)) or hits
    )
    monkeypatch.setattr(scan, "place_on_section", lambda _machine, _shape, x: x)
    monkeypatch.setattr(scan, "cycle_of", lambda *a, **named: (a[1].tolist(), a[2], named))
    search, values, state = _search(problem), problem.values(), {"theta1": 0.5}
    start = list(problem.state_vector(state))
    settings = TransientSettings().simulation
    named = {"horizon": 4.0, "settings": settings}
    seen = _orbit(0.5, returns=2, state=state)
    found: Any = scan.cycle_at(search, values, seen)
    assert found == (start, EventSequence.parsed("zeno*2"), named)
    assert asked == []
    struck = _orbit(0.5, fate=AttractorClass.NO_ZENO, returns=0, state=state)
    found = scan.cycle_at(search, values, struck)
    assert found == (start, EventSequence.parsed("impact*3"), named)
    # The last impact is that at the end of the period, which rounding may put after it.
    assert asked == [(start, {"until": pytest.approx(2.002), "settings": settings})]
    simple = _orbit(0.5, fate=AttractorClass.SIMPLE, state=state)
    found = scan.cycle_at(search, values, simple)
    assert found[1] == EventSequence.parsed("plastic")


def test_a_valley_is_no_worse_than_the_two_nearest_orbits_for_each_number() -> None:
    ranks = [scan._Rank(0, False, score) for score in (3.0, 1.0, 2.0, 0.5, 1.0, 9.0)]
    line = np.array([[0.0], [0.1], [0.2], [0.35], [0.45], [0.5]])
    orbits = [0, 1, 2, 3, 4]
    found = [k for k in orbits if scan._is_valley(k, orbits, line, ranks)]
    # The fourth is lower than the second, but no neighbour of it.
    assert found == [1, 3]
    # In the plane there are four neighbours, and the fourth is one.
    plane = np.column_stack([line[:, 0], np.zeros(6)])
    assert [k for k in orbits if scan._is_valley(k, orbits, plane, ranks)] == [3]
    # As good as a neighbour is a valley, and so is an orbit that is alone.
    even = [scan._Rank(0, False, 1.0)] * 6
    assert all(scan._is_valley(k, orbits, line, even) for k in orbits)
    assert scan._is_valley(0, [0], line, ranks)
