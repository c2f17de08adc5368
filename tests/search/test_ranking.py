"""The orbits of a search are ranked by their scores, and an optimum is believed if starts agree."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import replace
from typing import Any

import pytest

from zeno_orbits.model.problem import Problem
from zeno_orbits.orbits.orbit import ZenoOrbit
from zeno_orbits.search import (
    Candidate,
    FastestContraction,
    LeastEnergy,
    NearestGains,
    SearchResult,
    SearchSettings,
    SearchStatus,
    search,
    search_gains,
)
from zeno_orbits.search.objectives import LEAST_RADIUS
from zeno_orbits.search.outcome import StartOutcome
from zeno_orbits.simulation.signals import Extent

FAILED = StartOutcome(status=SearchStatus.NOT_SOLVED, detail="It fails.")


def _found(orbit: ZenoOrbit, score: float, gain: float) -> StartOutcome:
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

        monkeypatch.setattr(search, "outcomes_here", told)
        asked: dict[str, Any] = {"objective": LeastEnergy(), **changes}
        return search_gains(problem, problem.values(), free={"Kp": (1.0, 5.0)}, **asked)

    return searched


def test_candidates_come_best_first_whatever_the_order_of_their_starts(
    searched: Any, orbit: ZenoOrbit
) -> None:
    told = [_found(orbit, 3.0, 1.5), FAILED, _found(orbit, 1.0, 2.5), _found(orbit, 2.0, 3.5)]
    result = searched(told, settings=SearchSettings(candidates=3))
    assert [one.score for one in result.candidates] == [1.0, 2.0, 3.0]
    assert [one.orbit.gains["Kp"] for one in result.candidates] == [2.5, 3.5, 1.5]
    assert result.unwrap().gains["Kp"] == 2.5
    assert result.detail == "1.0"
    assert [one.status for one in result.attempts] == [one.status for one in told]


def test_a_second_start_at_the_same_optimum_ends_the_search_and_is_counted(
    searched: Any, orbit: ZenoOrbit
) -> None:
    told = [_found(orbit, 2.0, 1.5), _found(orbit, 1.0001, 2.5001), _found(orbit, 1.0, 2.5)]
    result = searched([*told, _found(orbit, 0.5, 4.0)], settings=SearchSettings())
    assert len(result.attempts) == 3
    assert [(one.score, one.starts) for one in result.candidates] == [(1.0, 2), (2.0, 1)]


def test_a_few_starts_are_compared_if_no_two_agree_on_the_best(
    searched: Any, orbit: ZenoOrbit
) -> None:
    told = [_found(orbit, 4.0 - k, 1.5 + k) for k in range(4)]
    result = searched([FAILED, *told], settings=SearchSettings())
    assert len(result.attempts) == 4
    assert [one.starts for one in result.candidates] == [1, 1, 1]
    assert result.candidates[0].score == 2.0


def test_a_score_that_nothing_can_be_below_ends_the_search(searched: Any, orbit: ZenoOrbit) -> None:
    told = [_found(orbit, LEAST_RADIUS, 1.5), _found(orbit, LEAST_RADIUS, 2.5)]
    result = searched(told, objective=FastestContraction(), settings=SearchSettings())
    assert len(result.attempts) == 1


@pytest.mark.parametrize(
    "changes",
    [
        {"settings": SearchSettings(n_starts=0)},
        {"objective": NearestGains(target={})},
    ],
)
def test_what_is_nearest_or_asked_of_one_start_is_not_compared(
    searched: Any, orbit: ZenoOrbit, changes: dict[str, Any]
) -> None:
    result = searched([_found(orbit, 2.0, 1.5), _found(orbit, 1.0, 2.5)], **changes)
    assert [one.score for one in result.candidates] == [2.0]


def test_an_orbit_of_another_shape_or_gain_is_another_candidate(
    searched: Any, orbit: ZenoOrbit
) -> None:
    other = replace(orbit, phases=2 * orbit.phases)
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
    searched: Any, orbit: ZenoOrbit
) -> None:
    told = [_found(orbit, 0.0, 2.5), _found(orbit, 6e-13, 2.5 * (1 + 2e-6))]
    asked: dict[str, Any] = {
        "objective": NearestGains(target={}),
        "settings": SearchSettings(candidates=2),
    }
    (one,) = searched(told, **asked).candidates
    assert (one.starts, one.score) == (2, 0.0)
