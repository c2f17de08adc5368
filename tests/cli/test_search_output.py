"""What the command says of a search that found nothing."""

from __future__ import annotations

import argparse
import json

import pytest

from zeno_orbits.cli.search_output import answer
from zeno_orbits.model.problem import Problem
from zeno_orbits.search import SearchResult, SearchStatus
from zeno_orbits.search.number_notes import far_from_own

NOTHING = SearchResult(
    status=SearchStatus.NO_GUESS,
    orbit=None,
    residuals={},
    agreement=1.0,
    closure_error=1.0,
    n_unknowns=0,
    iterations=0,
    solve_time=0.0,
    wall_time=0.0,
    attempts=(),
)


def test_a_number_a_hundred_times_off_the_problems_own_is_far_and_one_just_nearer_is_not(
    problem: Problem,
) -> None:
    own = problem.values()
    assert far_from_own(problem, own) == []
    for factor, far in ((1000.0, True), (100.0, True), (99.0, False), (0.011, False), (1e-3, True)):
        for name in ("R", "Kd"):
            given = own.number(name) * factor
            told = far_from_own(problem, own.replaced({name: given}))
            assert len(told) == far
            if far:
                assert told[0].startswith(f"`{name}` is {given:g} ")
                assert f"{factor:g} times the problem's own {own.number(name):g}" in told[0]


def test_zero_is_not_taken_for_a_mistaken_unit(problem: Problem) -> None:
    assert far_from_own(problem, problem.values().replaced({"restitution": 0.0, "Kp": 0.0})) == []


@pytest.mark.parametrize("as_json", [False, True])
def test_a_search_that_fails_names_the_numbers_that_may_be_in_another_unit(
    problem: Problem, capsys: pytest.CaptureFixture[str], *, as_json: bool
) -> None:
    far = far_from_own(problem, problem.values().replaced({"R": 3000.0}))
    options = argparse.Namespace(json=as_json)
    assert answer(options, problem, NOTHING, None, (), (), far) == 1
    said = capsys.readouterr().out
    sentence = "`R` is 3000 ohm, 1000 times the problem's own 3 ohm: is its unit right?"
    if as_json:
        assert json.loads(said)["far"] == [sentence]
    else:
        assert sentence in said
        assert answer(options, problem, NOTHING, None, (), ()) == 1
        assert "unit" not in capsys.readouterr().out
