"""What the command says of a search that found nothing."""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from zeno_orbits import MinEnergy, MinSpectralRadius, NearestGains
from zeno_orbits.api import SearchNotes
from zeno_orbits.cli import build_parser
from zeno_orbits.cli.search_output import answer, map_command, on_the_optimum
from zeno_orbits.model import Problem, load_problem
from zeno_orbits.orbits import Bound, EventSequence, Orbit
from zeno_orbits.search import (
    Candidate,
    Objective,
    SearchResult,
    SearchStatus,
    StartAttempt,
    at_ends,
    far_from_own,
)
from zeno_orbits.simulation import Extent

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


def _notes(far: list[str]) -> SearchNotes:
    return SearchNotes(
        free={"Kp": (1.0, 5.0)},
        objective=NearestGains(target={}),
        bounds=(Bound(name="period", upper=2.0),),
        held=(),
        far=far,
    )


def _options(**given: Any) -> argparse.Namespace:
    usual: dict[str, Any] = {
        "json": False,
        "problem": "motor_pendulum",
        "output": None,
        "until": None,
        "shape": None,
        "allow_unstable": False,
        "set": {"Kd": -1.0, "R": 2.0},
    }
    return argparse.Namespace(**usual | given)


@pytest.mark.parametrize("as_json", [False, True])
def test_a_search_that_fails_names_the_numbers_that_may_be_in_another_unit(
    problem: Problem, capsys: pytest.CaptureFixture[str], *, as_json: bool
) -> None:
    far = far_from_own(problem, problem.values().replaced({"R": 3000.0}))
    options = _options(json=as_json)
    assert answer(options, problem, NOTHING, _notes(far)) == 1
    said = capsys.readouterr().out
    sentence = "`R` is 3000 ohm, 1000 times the problem's own 3 ohm: is its unit right?"
    if as_json:
        assert json.loads(said)["far"] == [sentence]
    else:
        assert sentence in said
        assert answer(options, problem, NOTHING, _notes([])) == 1
        assert "is that its unit" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("status", "levers", "others"),
    [
        (
            SearchStatus.NO_GUESS,
            (
                "--start",
                "--until",
                "--bounds than period=:2",
                "zeno-orbits map motor_pendulum --x Kp=1:5 --y Kd=-1.5:-0.4 --set R=2",
            ),
            ("--allow-unstable", "wider ranges"),
        ),
        (SearchStatus.NOT_SOLVED, ("--bounds", "wider ranges than Kp=1:5"), ("--start", "map")),
        (SearchStatus.NOT_ACCEPTED, ("--bounds",), ("--until", "map", "--allow-unstable")),
    ],
)
def test_every_no_says_which_options_to_try_and_which_are_of_no_use(
    problem: Problem,
    capsys: pytest.CaptureFixture[str],
    status: SearchStatus,
    levers: tuple[str, ...],
    others: tuple[str, ...],
) -> None:
    failed = replace(NOTHING, status=status, detail="Its periods differ.", undecided=True)
    answer(_options(json=True), problem, failed, _notes([]))
    said = " ".join(json.loads(capsys.readouterr().out)["try"])
    assert all(word in said for word in levers), said
    assert not any(word in said for word in others), said


def test_only_where_an_orbit_repels_is_the_option_named_that_takes_one(
    problem: Problem, capsys: pytest.CaptureFixture[str]
) -> None:
    failed = replace(NOTHING, status=SearchStatus.NOT_ACCEPTED, repels=True)
    answer(_options(json=True), problem, failed, _notes([]))
    said = " ".join(json.loads(capsys.readouterr().out)["try"])
    assert "--allow-unstable" in said


def test_a_motion_that_rests_need_not_be_waited_for(
    problem: Problem, capsys: pytest.CaptureFixture[str]
) -> None:
    rests = replace(NOTHING, detail="The motion comes to rest after 90 s.")
    answer(_options(), problem, rests, _notes([]))
    assert "--until" not in capsys.readouterr().out


def test_a_search_for_one_shape_is_told_to_do_without(
    problem: Problem, capsys: pytest.CaptureFixture[str]
) -> None:
    for shape, told in ((None, False), (EventSequence.parsed("zeno*3"), True)):
        answer(_options(shape=shape), problem, NOTHING, _notes([]))
        assert ("Try: omit --shape" in capsys.readouterr().out) == told


def test_the_map_that_a_failed_search_names_can_be_made() -> None:
    notes = replace(_notes([]), free={"restitution": (0.1, 0.2)})
    for name in ("motor_pendulum", "bouncing_ball", "forced_oscillator"):
        command = map_command(load_problem(name), _options(problem=name, set={}), notes)
        options = build_parser().parse_args(command.split()[1:])
        assert options.x.range.name == "restitution"
        assert options.y.range.name in load_problem(name).names


def test_a_failed_search_says_that_the_file_it_would_have_written_is_older(
    problem: Problem, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    older = tmp_path / "orbit.json"
    answer(_options(output=older), problem, NOTHING, _notes([]))
    assert "older" not in capsys.readouterr().out
    older.write_text("{}")
    answer(_options(output=older), problem, NOTHING, _notes([]))
    said = " ".join(capsys.readouterr().out.split())
    assert "was not written: it holds an older result." in said
    answer(_options(output=older, json=True), problem, NOTHING, _notes([]))
    assert json.loads(capsys.readouterr().out)["older_output"] is True


def test_a_number_at_an_end_of_its_range_is_told_and_whose_range_it_is(problem: Problem) -> None:
    own = {gain.name: (gain.lower, gain.upper) for gain in problem.gains}
    low, high = own["Kp"]
    inside = problem.values()
    assert at_ends(problem, inside, own, {}) == []
    (said,) = at_ends(problem, inside.replaced({"Kp": high}), own, {})
    assert said.startswith(f"`Kp` = {high:g} is the upper end of the problem's own range {low:g}:")
    (said,) = at_ends(problem, inside.replaced({"Kp": 2.4}), {"Kp": (2.4, 2.6)}, {})
    assert said.startswith("`Kp` = 2.4 is the lower end of its range 2.4:2.6")
    # Who asks for the end itself gets what is asked.
    assert at_ends(problem, inside.replaced({"Kp": high}), own, {"Kp": high}) == []


# What is said of an optimum.


def _found(orbit: Orbit, starts: int, score: float = 1.0) -> SearchResult:
    """Return a search of three starts, some of which led to an orbit."""
    candidate = Candidate(
        orbit=orbit,
        score=score,
        extents={"energy": Extent(lowest=1.0, highest=1.0)},
        certificate=None,
        starts=starts,
    )
    attempt = StartAttempt(gains=orbit.gains, status=SearchStatus.FOUND)
    return replace(NOTHING, orbit=orbit, candidates=(candidate,), attempts=3 * (attempt,))


def _said(problem: Problem, result: SearchResult, objective: Objective, candidates: int = 1) -> str:
    notes = replace(_notes([]), objective=objective, free={"Kp": (2.5, 5.0)})
    return " ".join(on_the_optimum(_options(candidates=candidates), problem, result, notes))


def test_an_optimum_that_one_start_found_may_be_local_and_one_of_several_is_not_called_so(
    problem: Problem, orbit: Orbit
) -> None:
    assert "the optimum may be local" in _said(problem, _found(orbit, 1), MinEnergy())
    said = _said(problem, _found(orbit, 2), MinEnergy())
    assert "2 of 3 starts led there" in said
    assert "local" not in said
    # Nothing is better than zero, however many starts there were; what is near has no rival.
    (one,) = _found(orbit, 1, 1e-4).candidates
    radius = {"spectral_radius": Extent(lowest=0.0, highest=0.0)}
    least = replace(_found(orbit, 1), candidates=(replace(one, extents=radius),))
    assert "local" not in _said(problem, least, MinSpectralRadius())
    assert "local" not in _said(problem, _found(orbit, 1), NearestGains(target={}))


def test_an_optimum_at_an_end_of_its_range_is_told(problem: Problem, orbit: Orbit) -> None:
    assert orbit.gains["Kp"] == 2.5
    assert "`Kp` = 2.5 is the lower end" in _said(problem, _found(orbit, 1), MinEnergy())
    beyond = NearestGains(target={"Kp": 1.0})
    assert "`Kp` = 2.5 is the lower end" in _said(problem, _found(orbit, 1), beyond)
    assert "end of" not in _said(problem, _found(orbit, 1), NearestGains(target={"Kp": 2.5}))


def test_fewer_candidates_than_asked_are_explained(problem: Problem, orbit: Orbit) -> None:
    said = _said(problem, _found(orbit, 2), MinEnergy(), candidates=3)
    assert "2 fewer than requested: 3 starts and 0 initial states" in "".join(said)
    assert "fewer" not in _said(problem, _found(orbit, 2), MinEnergy())
