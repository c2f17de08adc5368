"""The orbits of a search are ranked by their scores, and an optimum is believed if starts agree."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import replace
from typing import Any

import pytest

from zeno_orbits import MinEnergy, MinSpectralRadius, NearestGains
from zeno_orbits.errors import InputError
from zeno_orbits.model import Problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.search import (
    Candidate,
    SearchResult,
    SearchSettings,
    SearchStatus,
    search,
    search_orbits,
)
from zeno_orbits.search.outcome import StartOutcome
from zeno_orbits.simulation import Extent

FAILED = StartOutcome(status=SearchStatus.NOT_SOLVED, detail="It fails.")


def _found(orbit: Orbit, score: float, gain: float) -> StartOutcome:
    """Return a start that found an orbit of a score at a gain."""
    there = replace(orbit, gains={**orbit.gains, "Kp": gain})
    candidate = Candidate(
        orbit=there,
        score=score,
        extents={"energy": Extent(lowest=score, highest=score)},
        certificate=None,
    )
    return StartOutcome(status=SearchStatus.FOUND, detail=f"{score}", candidate=candidate)


@pytest.fixture(name="searched")
def _searched(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a search whose starts end as they are told to."""

    def searched(outcomes: Sequence[StartOutcome], **changes: Any) -> SearchResult:
        def told(*_: Any) -> Generator[StartOutcome]:
            yield from outcomes

        monkeypatch.setattr(search, "outcomes", told)
        asked: dict[str, Any] = {"objective": MinEnergy(), **changes}
        return search_orbits(problem, problem.values(), free={"Kp": (1.0, 5.0)}, **asked)

    return searched


def test_candidates_come_best_first_whatever_the_order_of_their_starts(
    searched: Any, orbit: Orbit
) -> None:
    told = [_found(orbit, 3.0, 1.5), FAILED, _found(orbit, 1.0, 2.5), _found(orbit, 2.0, 3.5)]
    result = searched(told, settings=SearchSettings(candidates=3))
    assert [one.score for one in result.candidates] == [1.0, 2.0, 3.0]
    assert [one.orbit.gains["Kp"] for one in result.candidates] == [2.5, 3.5, 1.5]
    assert result.unwrap().gains["Kp"] == 2.5
    assert result.detail == "1.0"
    assert [one.status for one in result.attempts] == [one.status for one in told]


def test_a_second_start_at_the_same_optimum_ends_the_search_and_is_counted(
    searched: Any, orbit: Orbit
) -> None:
    told = [_found(orbit, 2.0, 1.5), _found(orbit, 1.0001, 2.5001), _found(orbit, 1.0, 2.5)]
    result = searched([*told, _found(orbit, 0.5, 4.0)], settings=SearchSettings())
    assert len(result.attempts) == 3
    assert [(one.score, one.starts) for one in result.candidates] == [(1.0, 2), (2.0, 1)]


def test_a_few_starts_are_compared_if_no_two_agree_on_the_best(searched: Any, orbit: Orbit) -> None:
    told = [_found(orbit, 4.0 - k, 1.5 + k) for k in range(4)]
    result = searched([FAILED, *told], settings=SearchSettings())
    assert len(result.attempts) == 4
    assert [one.starts for one in result.candidates] == [1, 1, 1]
    assert result.candidates[0].score == 2.0


def test_a_score_that_nothing_can_be_below_ends_the_search(searched: Any, orbit: Orbit) -> None:
    told = [_found(orbit, 1e-4, 1.5), _found(orbit, 1e-4, 2.5)]
    result = searched(told, objective=MinSpectralRadius(), settings=SearchSettings())
    assert len(result.attempts) == 1


def test_an_orbit_of_another_shape_or_gain_is_another_candidate(
    searched: Any, orbit: Orbit
) -> None:
    other = orbit.with_phases(2 * orbit.phases)
    told = [
        _found(orbit, 1.0, 2.5),
        _found(other, 1.0, 2.5),
        _found(orbit, 1.0, 2.6),
        _found(orbit, 1.0, 2.5),
    ]
    asked: dict[str, Any] = {
        "objective": NearestGains(target={}),
        "settings": SearchSettings(candidates=4),
    }
    result = searched(told, **asked)
    assert [one.starts for one in result.candidates] == [2, 1, 1]


def test_an_orbit_a_few_millionths_off_the_nearest_numbers_is_no_other_candidate(
    searched: Any, orbit: Orbit
) -> None:
    told = [_found(orbit, 0.0, 2.5), _found(orbit, 6e-13, 2.5 * (1 + 2e-6))]
    asked: dict[str, Any] = {
        "objective": NearestGains(target={}),
        "settings": SearchSettings(candidates=2),
    }
    (one,) = searched(told, **asked).candidates
    assert (one.starts, one.score) == (2, 0.0)


# What is told of a search, and when it gives up.


def test_a_search_tells_what_its_best_start_did_and_that_of_every_start(
    searched: Any, orbit: Orbit
) -> None:
    best = replace(
        _found(orbit, 1.0, 2.5),
        start={"Kp": 3.5},
        residuals={"gap": 1e-10},
        agreement=1e-11,
        closure_error=1e-12,
        n_unknowns=7,
        iterations=3,
        solve_time=0.25,
    )
    told = [replace(FAILED, start={"Kp": 1.5}), best, _found(orbit, 2.0, 3.5)]
    result = searched(told, settings=SearchSettings(candidates=2))
    assert (result.status, result.detail) == (SearchStatus.FOUND, "1.0")
    assert result.residuals == {"gap": 1e-10}
    assert (result.agreement, result.closure_error) == (1e-11, 1e-12)
    assert (result.n_unknowns, result.iterations, result.solve_time) == (7, 3, 0.25)
    assert 0.0 <= result.wall_time < 60.0
    assert (result.undecided, result.repels, result.scan) == (False, False, "")
    assert [one.gains["Kp"] for one in result.attempts] == [1.5, 3.5, 2.5]
    assert [one.parameters for one in result.attempts] == [{}, {}, {}]
    assert [one.detail for one in result.attempts] == ["It fails.", "1.0", "2.0"]


def test_settings_that_allow_no_start_are_refused(searched: Any) -> None:
    with pytest.raises(InputError, match="`settings` must allow a start"):
        searched([])


@pytest.mark.slow
def test_as_many_orbits_are_looked_for_as_are_asked_for(searched: Any, orbit: Orbit) -> None:
    told = [_found(orbit, 1.0 + k, 1.5 + k) for k in range(4)]
    nearest: dict[str, Any] = {"objective": NearestGains(target={})}
    for n in (1, 2, 3):
        result = searched(told, settings=SearchSettings(candidates=n), **nearest)
        assert len(result.attempts) == n
    # More than there are starts.
    assert len(searched(told, settings=SearchSettings(candidates=9), **nearest).candidates) == 4


@pytest.mark.slow
def test_the_best_optimum_has_to_be_found_twice_however_often_another_is(
    searched: Any, orbit: Orbit
) -> None:
    worse, better = _found(orbit, 2.0, 1.5), _found(orbit, 1.0, 2.5)
    result = searched([worse, better, worse, better])
    assert [(one.score, one.starts) for one in result.candidates] == [(1.0, 2), (2.0, 2)]
    assert len(result.attempts) == 4
    result = searched([worse, worse, better])
    assert len(result.attempts) == 2


@pytest.mark.parametrize(
    ("gain", "period", "score", "same"),
    [
        (0.9e-3, 0.0, 0.0, True),
        (1.1e-3, 0.0, 0.0, False),
        (0.0, 0.9e-3, 0.0, True),
        (0.0, 1.1e-3, 0.0, False),
        (0.0, 0.0, 0.9e-3, True),
        (0.0, 0.0, 1.1e-3, False),
        (-0.9e-3, -0.9e-3, -0.9e-3, True),
        (-1.1e-3, 0.0, 0.0, False),
    ],
)
def test_optima_are_the_same_if_numbers_period_and_score_agree_to_a_thousandth(
    searched: Any, orbit: Orbit, gain: float, period: float, score: float, same: bool
) -> None:
    other = replace(orbit, period=orbit.period * (1 + period))
    told = [_found(orbit, 1.0, 2.5), _found(other, 1.0 + score, 2.5 * (1 + gain))]
    result = searched(told, settings=SearchSettings(candidates=2))
    assert len(result.candidates) == (1 if same else 2)


@pytest.mark.parametrize(("apart", "same"), [(0.9e-5, True), (1.1e-5, False), (-1.1e-5, False)])
def test_nearest_orbits_are_the_same_if_numbers_and_period_agree_to_five_digits(
    searched: Any, orbit: Orbit, apart: float, same: bool
) -> None:
    asked: dict[str, Any] = {
        "objective": NearestGains(target={}),
        "settings": SearchSettings(candidates=2),
    }
    other = replace(orbit, period=orbit.period * (1 + apart))
    for told in (_found(orbit, 5.0, 2.5 * (1 + apart)), _found(other, 5.0, 2.5)):
        result = searched([_found(orbit, 1.0, 2.5), told], **asked)
        assert len(result.candidates) == (1 if same else 2)


# The question itself.


def test_an_accuracy_asks_for_a_mesh_a_closure_and_an_agreement_of_its_own_size() -> None:
    fine = SearchSettings().for_accuracy(1e-6)
    assert fine.agreement == pytest.approx(3e-7)
    assert fine.transcription.mesh_tolerance == pytest.approx(1e-4)
    assert fine.transcription.closure_tolerance == pytest.approx(3e-8)
    coarse = SearchSettings().for_accuracy(1e-2)
    assert coarse.transcription.mesh_tolerance == 1e-2
    finest = SearchSettings().for_accuracy(1e-12)
    assert finest.transcription.closure_tolerance == 1e-12
    assert finest.transcription.mesh_tolerance == pytest.approx(1e-10)


def test_a_search_is_limited_by_numbers_and_not_by_time_where_nothing_is_said() -> None:
    usual = SearchSettings()
    assert (usual.n_starts, usual.candidates, usual.seed, usual.rounds) == (12, 1, 0, 4)
    assert usual.agreement == 3e-10
