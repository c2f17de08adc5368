"""The orbits of a search are ranked by their scores, and an optimum is believed if starts agree."""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest

from tests.support.searches import question_of
from zeno_orbits.errors import InputError
from zeno_orbits.model import Problem
from zeno_orbits.orbits import ONE_ZENO, Bound, EventSequence, ZenoOrbit
from zeno_orbits.search import (
    Candidate,
    MinEnergy,
    MinSpectralRadius,
    NearestGains,
    OrbitNotFoundError,
    SearchResult,
    SearchSettings,
    SearchStatus,
    StartAttempt,
    TargetPeriod,
    Verdict,
    orbit_at_gains,
    scan,
    search,
    search_orbits,
)
from zeno_orbits.search.objectives import LEAST_RADIUS
from zeno_orbits.search.outcome import StartOutcome
from zeno_orbits.search.search_problem import SearchProblem, listed, with_targets
from zeno_orbits.simulation import Extent

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
        asked: dict[str, Any] = {"objective": MinEnergy(), **changes}
        return search_orbits(problem, problem.values(), free={"Kp": (1.0, 5.0)}, **asked)

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
    result = searched(told, objective=MinSpectralRadius(), settings=SearchSettings())
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


# What is told of a search, and when it gives up.


def test_a_search_tells_what_its_best_start_did_and_that_of_every_start(
    searched: Any, orbit: ZenoOrbit
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


def test_the_free_parameters_of_a_start_are_told_beside_its_gains(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = replace(FAILED, start={"Kp": 1.5, "R": 2.5})
    monkeypatch.setattr(search, "outcomes_here", lambda *_: (one for one in [told]))
    free = {"Kp": (1.0, 5.0), "R": (2.0, 4.0)}
    (attempt,) = search_orbits(problem, problem.values(), free=free).attempts
    assert attempt.parameters == {"R": 2.5}
    assert attempt.gains == {"Kp": 1.5, "Kd": -1.0}


def test_of_two_equal_orbits_the_later_start_is_told_and_of_two_better_the_best(
    searched: Any, orbit: ZenoOrbit
) -> None:
    two = SearchSettings(candidates=2)
    equal = [_found(orbit, 1.0, 2.5), replace(_found(orbit, 1.0, 3.5), detail="later")]
    assert searched(equal, settings=two).detail == "later"
    assert searched([_found(orbit, 2.0, 2.5), _found(orbit, 1.0, 3.5)], settings=two).detail == (
        "1.0"
    )


def test_the_failure_that_came_farthest_is_told_and_of_two_such_the_nearer(
    searched: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scan, "scan_summary", lambda _: "A summary.")
    ends = [
        SearchStatus.NO_GUESS,
        SearchStatus.NOT_SOLVED,
        SearchStatus.NOT_FOLLOWED,
        SearchStatus.NOT_ACCEPTED,
        SearchStatus.FOUND,
    ]
    for before, after in pairwise(ends):
        pair = [StartOutcome(status=one, undecided=True, repels=True) for one in (before, after)]
        for told in (pair, pair[::-1]):
            result = searched(told)
            assert result.status is after
            assert (result.orbit, result.candidates, result.scan) == (None, (), "A summary.")
            assert (result.undecided, result.repels) == (True, True)
    near, far = replace(FAILED, shortfall=0.5, detail="near"), replace(FAILED, shortfall=2.0)
    for told in ([near, far], [far, near]):
        assert searched(told).detail == "near"
    # Nothing is said of the box where one start was all.
    assert searched([FAILED]).scan == ""


@pytest.mark.parametrize(
    ("changes", "most"),
    [
        ({}, 5),
        ({"objective": TargetPeriod(target=1.8)}, 2),
        ({"bounds": (Bound(name="period", upper=2.0),)}, 2),
    ],
)
def test_a_search_gives_up_after_a_few_good_guesses_that_fail(
    searched: Any,
    orbit: ZenoOrbit,
    monkeypatch: pytest.MonkeyPatch,
    changes: dict[str, Any],
    most: int,
) -> None:
    monkeypatch.setattr(search, "_summary", lambda _: "")
    empty = StartOutcome(status=SearchStatus.NO_GUESS)
    result = searched([empty, empty, *(9 * [FAILED])], **changes)
    assert len(result.attempts) == 2 + most
    # Once there is an orbit, more are looked for.
    told = [_found(orbit, 1.0, 2.5), *(9 * [FAILED])]
    result = searched(told, settings=SearchSettings(candidates=2), **changes)
    assert len(result.attempts) == 10


def test_starts_that_are_under_way_are_ended_when_there_are_enough(
    problem: Problem, orbit: ZenoOrbit, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended: list[bool] = []

    def told(*_: Any) -> Generator[StartOutcome]:
        try:
            yield _found(orbit, 1.0, 2.5)
            yield FAILED
        finally:
            ended.append(True)

    monkeypatch.setattr(search, "outcomes_here", told)
    result = search_orbits(problem, problem.values(), free={"Kp": (1.0, 5.0)})
    assert (len(result.attempts), ended) == (1, [True])


def test_settings_that_allow_no_start_are_refused(searched: Any) -> None:
    with pytest.raises(InputError, match="`settings` must allow a start"):
        searched([])


def test_as_many_orbits_are_looked_for_as_are_asked_for(searched: Any, orbit: ZenoOrbit) -> None:
    told = [_found(orbit, 1.0 + k, 1.5 + k) for k in range(4)]
    nearest: dict[str, Any] = {"objective": NearestGains(target={})}
    for n in (1, 2, 3):
        result = searched(told, settings=SearchSettings(candidates=n), **nearest)
        assert len(result.attempts) == n
    # More than there are starts.
    assert len(searched(told, settings=SearchSettings(candidates=9), **nearest).candidates) == 4


def test_the_best_optimum_has_to_be_found_twice_however_often_another_is(
    searched: Any, orbit: ZenoOrbit
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
    searched: Any, orbit: ZenoOrbit, gain: float, period: float, score: float, same: bool
) -> None:
    other = replace(orbit, period=orbit.period * (1 + period))
    told = [_found(orbit, 1.0, 2.5), _found(other, 1.0 + score, 2.5 * (1 + gain))]
    result = searched(told, settings=SearchSettings(candidates=2))
    assert len(result.candidates) == (1 if same else 2)


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        (1000.0, 1001.0005, True),
        (1000.0, 1001.0015, False),
        (-1000.0, -1001.0005, True),
        (0.0, 0.0, True),
        (0.0, 1e-30, False),
    ],
)
def test_what_agrees_to_a_thousandth_of_the_larger_one_agrees(
    searched: Any, orbit: ZenoOrbit, one: float, other: float, same: bool
) -> None:
    for scores in ((one, other), (other, one)):
        told = [_found(orbit, score, 2.5) for score in scores]
        result = searched(told, settings=SearchSettings(candidates=2))
        assert len(result.candidates) == (1 if same else 2)


def test_nothing_is_enough_before_there_are_as_many_as_asked(
    problem: Problem, orbit: ZenoOrbit
) -> None:
    settings = SearchSettings(candidates=2)
    asked = question_of(problem, free={}, objective=MinEnergy(), settings=settings)
    one, two = (_found(orbit, score, score).candidate for score in (1.0, 2.0))
    assert one is not None
    assert two is not None
    assert search._enough(asked, [], 9) is False
    assert search._enough(asked, [one], 9) is False
    assert search._enough(asked, [one, two], 9) is True
    twice = replace(one, orbit=replace(orbit, phases=2 * orbit.phases))
    assert search._same(asked, one, twice) is False
    assert search._same(asked, one, one) is True


@pytest.mark.parametrize(("apart", "same"), [(0.9e-5, True), (1.1e-5, False), (-1.1e-5, False)])
def test_nearest_orbits_are_the_same_if_numbers_and_period_agree_to_five_digits(
    searched: Any, orbit: ZenoOrbit, apart: float, same: bool
) -> None:
    asked: dict[str, Any] = {
        "objective": NearestGains(target={}),
        "settings": SearchSettings(candidates=2),
    }
    other = replace(orbit, period=orbit.period * (1 + apart))
    for told in (_found(orbit, 5.0, 2.5 * (1 + apart)), _found(other, 5.0, 2.5)):
        result = searched([_found(orbit, 1.0, 2.5), told], **asked)
        assert len(result.candidates) == (1 if same else 2)


def test_a_search_is_asked_what_its_arguments_say(
    problem: Problem, orbit: ZenoOrbit, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[Any] = []

    def told(asked: SearchProblem, accept: Any) -> Generator[StartOutcome]:
        seen.append((asked, accept))
        yield FAILED

    monkeypatch.setattr(search, "outcomes_here", told)
    orbit_at_gains(problem, problem.values(), settings=SearchSettings(seed=3), shape=ONE_ZENO)
    asked, accept = seen.pop()
    assert (asked.free, asked.bounds, asked.near, asked.shape) == ({}, (), None, ONE_ZENO)
    assert (asked.settings, accept) == (SearchSettings(seed=3, n_starts=0), None)
    assert asked.initial_states == problem.starts
    assert asked.objective.target == {"Kp": 2.5, "Kd": -1.0}
    orbit_at_gains(problem, problem.values())
    assert seen.pop()[0].settings == SearchSettings(n_starts=0)

    def judge(_: ZenoOrbit) -> Verdict:
        return Verdict()

    there, bound = {"theta1": 0.5}, Bound(name="period", upper=2.0)
    changes: dict[str, Any] = {"initial_states": [there], "bounds": [bound], "accept": judge}
    free = {"Kp": (1.0, 5.0)}
    search_orbits(
        problem, problem.values(), free=free, near=orbit, objective=MinEnergy(), **changes
    )
    asked, accept = seen.pop()
    assert (asked.free, asked.bounds, asked.near) == (free, (bound,), orbit)
    assert (asked.shape, asked.objective) == (orbit.shape, MinEnergy())
    assert (asked.initial_states, accept) == ((there,), judge)
    assert (asked.settings, asked.sizes) == (SearchSettings(), {"Kp": 2.5})
    twice = EventSequence.parsed("zeno*2")
    with pytest.raises(InputError, match="`shape`"):
        search_orbits(problem, problem.values(), free=free, near=orbit, shape=twice)
    with pytest.raises(InputError, match="`free`"):
        search_orbits(problem, problem.values(), free={"Ki": (1.0, 2.0)})


def test_a_result_is_shown_and_listed_with_its_orbits(searched: Any, orbit: ZenoOrbit) -> None:
    told = [FAILED, _found(orbit, 2.0, 1.5), _found(orbit, 1.0, 2.5)]
    result = searched(told, settings=SearchSettings(candidates=2))
    shown = repr(result)
    assert shown.startswith("<SearchResult FOUND: The search found an orbit. 1.0 starts=3, ")
    assert "candidates=2" in shown
    assert repr(result.orbit) in shown
    assert result._columns() == {
        "Kp": [2.5, 1.5],
        "Kd": [-1.0, -1.0],
        "period": [orbit.period, orbit.period],
        "impacts": [len(orbit.impacts), len(orbit.impacts)],
        "score": [1.0, 2.0],
    }
    none = searched([FAILED])
    assert repr(none).startswith(
        "<SearchResult NOT_SOLVED: The conditions of the orbit could not be met. It fails. starts=1"
    )
    assert repr(none).endswith(" s>")
    with pytest.raises(OrbitNotFoundError) as caught:
        none.unwrap()
    assert str(caught.value) == "The conditions of the orbit could not be met. It fails."
    assert caught.value.result is none
    silent = searched([StartOutcome(status=SearchStatus.NO_GUESS)])
    with pytest.raises(OrbitNotFoundError) as caught:
        silent.unwrap()
    assert str(caught.value) == SearchStatus.NO_GUESS.value


def test_an_outcome_of_which_nothing_is_told_has_no_numbers() -> None:
    outcome = StartOutcome(status=SearchStatus.NO_GUESS)
    assert (outcome.agreement, outcome.closure_error, outcome.shortfall) == 3 * (math.inf,)
    assert (outcome.n_unknowns, outcome.iterations, outcome.solve_time) == (0, 0, 0.0)
    assert (outcome.detail, outcome.undecided, outcome.repels) == ("", False, False)
    assert (outcome.start, outcome.residuals) == ({}, {})
    attempt = StartAttempt(gains={}, status=SearchStatus.NO_GUESS)
    assert (attempt.parameters, attempt.detail) == ({}, "")
    result = SearchResult(
        status=SearchStatus.NO_GUESS,
        orbit=None,
        residuals={},
        agreement=math.inf,
        closure_error=math.inf,
        n_unknowns=0,
        iterations=0,
        solve_time=0.0,
        wall_time=0.0,
        attempts=(),
    )
    assert (result.candidates, result.detail, result.scan) == ((), "", "")
    assert (result.undecided, result.repels) == (False, False)
    assert Verdict().objection == ""


# The question itself.


def test_free_numbers_are_measured_in_their_own_size_or_a_part_of_their_range(
    problem: Problem,
) -> None:
    told: dict[str, Any] = {
        "values": problem.values(gains={"Kd": 0.0}),
        "free": {"Kp": (1.0, 5.0), "Kd": (-3.0, 1.0)},
        "objective": MinEnergy(),
    }
    asked = with_targets(question_of(problem, **told))
    assert asked.sizes == {"Kp": 2.5, "Kd": pytest.approx(4e-3)}
    assert asked.objective == MinEnergy()
    below = with_targets(question_of(problem, **told | {"values": problem.values()}))
    assert below.sizes == {"Kp": 2.5, "Kd": 1.0}
    # Nearness is measured from the numbers it is asked from.
    nearness = asked.nearness(problem.values(gains={"Kp": 3.0}))
    assert nearness.first == {"Kp": 3.0, "Kd": -1.0}
    assert nearness.sizes == asked.sizes
    wanted = NearestGains(target={"Kd": -0.5})
    box = {"R": (3.2, 4.0)}
    near = with_targets(question_of(problem, **told | {"objective": wanted, "free": box}))
    # What has no target stays at its start, moved into the box.
    assert near.objective == NearestGains(target={"Kp": 2.5, "Kd": -0.5, "R": 3.2})
    assert near.values.number("Kd") == -0.5
    assert near.numbers(near.values) == {"Kp": 2.5, "Kd": -0.5, "R": 3.2}
    # Half the sum of squares, each in units of its size, of the distance from what is wanted.
    far = near.values.replaced({"R": 4.0})
    assert near.score(far, {}) == pytest.approx(
        near.nearness(near.values).distance({"R": 4.0}, near.objective.goal)
    )
    assert near.score(near.values, {}) == 0.0 < near.score(far, {})
    assert replace(near, free={}).score(far, {}) == 0.0


@pytest.mark.parametrize(
    ("changes", "compared"),
    [
        ({}, True),
        ({"free": {}}, False),
        ({"settings": SearchSettings(n_starts=1)}, True),
        ({"settings": SearchSettings(n_starts=0)}, False),
        ({"objective": NearestGains(target={})}, False),
        ({"near": True}, False),
    ],
)
def test_an_optimum_is_sought_all_over_the_box_unless_an_orbit_is_known(
    problem: Problem, orbit: ZenoOrbit, changes: dict[str, Any], compared: bool
) -> None:
    told: dict[str, Any] = {"objective": MinEnergy(), **changes}
    told["near"] = orbit if told.get("near") else None
    assert question_of(problem, **told).seeks_optimum is compared


def test_a_question_is_all_of_a_search_but_its_problem_and_who_is_told(problem: Problem) -> None:
    asked = SearchProblem(
        problem=problem,
        values=problem.values(),
        free={},
        objective=MinEnergy(),
        initial_states=problem.starts,
        settings=SearchSettings(),
        order=(1, 0),
    )
    question = asked.question()
    assert set(question) == {
        "values", "free", "objective", "bounds", "near", "shape", "initial_states",
        "sizes", "order", "settings",
    }  # fmt: skip
    assert SearchProblem(problem=problem, **question) == asked
    # The problem has the rest.
    assert asked.compiled is problem.compiled()
    e = {"restitution": 0.25}
    assert asked.dynamics(problem.values(parameters=e)).restitution == 0.25


def test_the_one_who_is_told_of_a_stage_is_not_told_how_far_it_is(problem: Problem) -> None:
    told: list[tuple[str, float | None]] = []
    asked = question_of(problem, on_progress=lambda stage, part: told.append((stage, part)))
    asked.tell("simulating")
    assert told == [("simulating", None)]


def test_numbers_are_listed_to_six_digits() -> None:
    assert listed({"Kp": 2.0 / 3.0, "Kd": -1.0}) == "Kp = 0.666667, Kd = -1"
    assert listed({}) == "the problem"


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
    assert (usual.first_step, usual.smallest_step, usual.agreement) == (0.03, 0.003, 3e-10)
    assert usual.ipopt.most_iterations == 60
    # Thirty years.
    assert usual.ipopt.most_seconds == 1e9
