"""One start of a search, with ways to orbits and checks of them that are told what to find."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from tests.support.searches import question_of
from zeno_orbits.errors import InputError, ZenoOrbitsError
from zeno_orbits.model import Problem
from zeno_orbits.model.problem import ParameterValues
from zeno_orbits.orbits import Bound
from zeno_orbits.search import (
    MinEnergy,
    MinSpectralRadius,
    SearchSettings,
    SearchStatus,
    TargetPeriod,
    Verdict,
    scan,
)
from zeno_orbits.search import start as starts
from zeno_orbits.search.outcome import SimulatedSolution, StartOutcome
from zeno_orbits.search.search_problem import SearchProblem, with_targets
from zeno_orbits.search.start import numbered_start, scanned, start_count, try_start
from zeno_orbits.search.strategy import SearchStart
from zeno_orbits.simulation import Extent

FOUND, REFUSED = SearchStatus.FOUND, SearchStatus.NOT_ACCEPTED


def _search(problem: Problem, **changes: Any) -> SearchProblem:
    return with_targets(question_of(problem, **changes))


class _Orbit:
    """An orbit as far as a search looks at it before it is accepted."""

    def __init__(self, values: ParameterValues) -> None:
        self._values = values

    def values(self, _problem: Problem) -> ParameterValues:
        return self._values


def _found(values: ParameterValues, **changes: Any) -> StartOutcome:
    cycle: Any = None
    orbit: Any = _Orbit(values)
    solution = SimulatedSolution(values=values, cycle=cycle, unknowns={}, orbit=orbit, excesses={})
    return StartOutcome(**{"status": FOUND, "solution": solution, **changes})


def _certificate(*multipliers: complex, passed: bool = True, stable: bool = False) -> Any:
    return SimpleNamespace(passed=passed, stable=stable, multipliers=multipliers)


def _repelled(*multipliers: complex) -> Verdict:
    return Verdict(objection="It repels.", certificate=_certificate(*multipliers))


@pytest.fixture(name="ways")
def _ways(monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[tuple[str, Any, Any]]]:
    """Let ways from a start end where functions say; return what was asked of them."""

    def ways(
        direct: Callable[[SearchProblem, SearchStart], StartOutcome],
        near: Callable[[SearchProblem, SimulatedSolution], StartOutcome] | None = None,
        measured: Mapping[str, float] | None = None,
    ) -> list[tuple[str, Any, Any]]:
        asked: list[tuple[str, Any, Any]] = []

        def from_start(search: SearchProblem, start: SearchStart) -> StartOutcome:
            asked.append(("from", search, start))
            return direct(search, start)

        def beside(search: SearchProblem, start: SearchStart, solution: Any) -> StartOutcome:
            asked.append(("beside", search, (start, solution)))
            assert near is not None
            return near(search, solution)

        def measure(_orbit: Any, _problem: Problem, names: Sequence[str]) -> dict[str, Extent]:
            asked.append(("measure", None, list(names)))
            told = measured or {}
            return {n: Extent(lowest=told.get(n, 0.0), highest=told.get(n, 0.0)) for n in names}

        monkeypatch.setattr(starts, "from_start", from_start)
        monkeypatch.setattr(starts, "beside", beside)
        monkeypatch.setattr(starts, "measure", measure)
        return asked

    return ways


# Which starts there are.


def test_fixed_numbers_have_one_start_and_free_ones_as_many_more_as_the_settings_say(
    problem: Problem,
) -> None:
    settings = SearchSettings(n_starts=7)
    assert start_count(_search(problem, settings=settings)) == 8
    assert start_count(_search(problem, settings=settings, free={})) == 1


def test_the_box_is_looked_at_when_a_start_needs_it_and_once(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked: list[SearchProblem] = []

    def order(search: SearchProblem) -> tuple[int, ...]:
        looked.append(search)
        return (2, 0, 1)

    monkeypatch.setattr(scan, "start_order", order)
    told: list[str] = []
    search = _search(problem, on_progress=lambda stage, _: told.append(stage))
    assert scanned(search, 0) is search
    assert (looked, told) == ([], [])
    ordered = scanned(search, 1)
    assert ordered == replace(search, order=(2, 0, 1))
    assert told == ["simulating points of the whole box"]
    assert scanned(ordered, 2) is ordered
    optimum = _search(problem, objective=MinEnergy())
    assert scanned(optimum, 0).order == (2, 0, 1)
    assert len(looked) == 2


def test_starts_are_at_the_places_of_their_order_and_the_given_numbers_in_the_box(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    def place(_search: SearchProblem, number: int) -> ParameterValues:
        return problem.values(gains={"Kp": float(number)})

    monkeypatch.setattr(scan, "start_place", place)
    near: Any = SimpleNamespace()
    search = _search(problem, values=problem.values(gains={"Kp": 9.0}), near=near)
    first = numbered_start(search, 0)
    assert first == SearchStart(values=problem.values(gains={"Kp": 4.0}), near=near)
    assert numbered_start(search, 3).values.gains["Kp"] == 3.0
    ordered = replace(search, order=(2, 0, 1, 0))
    assert numbered_start(ordered, 0) == SearchStart(values=place(search, 2))
    assert numbered_start(ordered, 1) == first
    assert numbered_start(ordered, 2) == SearchStart(values=place(search, 1))
    again = numbered_start(ordered, 3)
    assert (again.values, again.near, again.known_empty) == (first.values, None, True)
    assert again.easy
    # The given numbers need not come first to be new.
    assert numbered_start(replace(search, order=(1, 0)), 1) == first


def test_a_search_with_one_start_has_its_easier_numbers_at_once(problem: Problem) -> None:
    search = _search(problem, free={}, values=problem.values(gains={"Kp": 3.0}))
    start = numbered_start(search, 0)
    assert not start.known_empty
    assert start.easy[0].gains["Kp"] == 2.5


def test_easier_numbers_are_the_usual_gains_half_the_restitution_and_both(
    problem: Problem,
) -> None:
    usual, e = problem.values(), problem.values().parameters["restitution"]
    values = problem.values(gains={"Kp": 3.0}, parameters={"R": 3.5})
    own_gains = values.replaced({"Kp": 2.5})
    assert starts._easy_values(problem, values) == (
        own_gains,
        values.replaced({"restitution": e / 2}),
        own_gains.replaced({"restitution": e / 2}),
        usual,
    )
    # What is there already is told once.
    assert starts._easy_values(problem, usual) == (usual.replaced({"restitution": e / 2}),)
    plastic = values.replaced({"restitution": 0.0})
    assert starts._easy_values(problem, plastic) == (
        own_gains.replaced({"restitution": 0.0}),
        usual,
    )


def test_no_path_leads_from_the_problems_own_numbers_to_some_in_another_unit(
    problem: Problem,
) -> None:
    far = problem.values(gains={"Kp": 3.0}, parameters={"R": 3.5e6})
    easy = starts._easy_values(problem, far)
    assert len(easy) == 3
    assert {one.parameters["R"] for one in easy} == {3.5e6}


# What comes of one.


def test_a_start_tells_its_numbers_and_keeps_its_candidate_alone(
    problem: Problem, ways: Any
) -> None:
    told: list[str] = []
    search = _search(
        problem, objective=MinEnergy(), on_progress=lambda stage, _: told.append(stage)
    )
    search = replace(search, order=(0, 1), bounds=(Bound(name="period", upper=2.0),))
    there = problem.values(gains={"Kp": 3.5})
    asked = ways(lambda *_: _found(there), measured={"energy": 4.0, "period": 1.5})
    certificate = _certificate(0.5, stable=True)
    outcome = try_start(search, 0, lambda _: Verdict(certificate=certificate))
    assert outcome.start == {"Kp": 2.5}
    assert outcome.solution is None
    assert outcome.candidate is not None
    assert outcome.candidate.orbit.values(problem) == there
    assert outcome.candidate.score == 4.0
    assert outcome.candidate.certificate is certificate
    assert outcome.candidate.extents["period"].highest == 1.5
    assert [kind for kind, *_ in asked] == ["from", "measure"]
    assert asked[1][2] == ["energy", "period"]
    assert told == [
        "start 1: simulating Kp = 2.5, Kd = -1",
        "start 1: measuring energy, period",
        "start 1: verifying",
    ]


def test_nothing_is_measured_of_an_orbit_of_which_nothing_is_asked(
    problem: Problem, ways: Any
) -> None:
    asked = ways(lambda *_: _found(problem.values()))
    outcome = try_start(_search(problem), 0, None)
    assert [kind for kind, *_ in asked] == ["from"]
    assert outcome.candidate is not None
    assert (outcome.candidate.score, outcome.candidate.certificate) == (0.0, None)
    assert outcome.candidate.extents == {}
    # At fixed numbers an objective has nothing to choose, but bounds are kept.
    fixed = _search(problem, free={}, objective=MinEnergy())
    bounded = replace(fixed, bounds=(Bound(name="period", upper=2.0),))
    assert try_start(fixed, 0, None).candidate is not None
    assert len(asked) == 2
    assert try_start(bounded, 0, None).candidate is not None
    assert asked[-1] == ("measure", None, ["period"])


def test_an_orbit_beyond_a_bound_is_refused_before_it_is_checked(
    problem: Problem, ways: Any
) -> None:
    ways(lambda *_: _found(problem.values()), measured={"period": 2.5})
    search = _search(problem, bounds=(Bound(name="period", upper=2.0),))

    def never(_orbit: Any) -> Verdict:
        raise AssertionError

    outcome = try_start(search, 0, never)
    assert (outcome.status, outcome.candidate, outcome.repels) == (REFUSED, None, False)
    assert outcome.detail == "`period` leaves its bounds :2 by 0.5."


def test_an_orbit_that_cannot_be_measured_is_refused_with_the_reason(
    problem: Problem, ways: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    ways(lambda *_: _found(problem.values()))

    def fails(*_: Any) -> Any:
        raise ZenoOrbitsError("It falls over.")

    monkeypatch.setattr(starts, "measure", fails)
    outcome = try_start(_search(problem, objective=MinEnergy()), 0, None)
    assert (outcome.status, outcome.detail) == (REFUSED, "It falls over.")


@pytest.mark.parametrize("status", [SearchStatus.NO_GUESS, SearchStatus.NOT_FOLLOWED])
def test_a_start_without_an_orbit_is_not_judged(
    problem: Problem, ways: Any, status: SearchStatus
) -> None:
    ways(lambda *_: _found(problem.values(), status=status, detail="So."))
    outcome = try_start(_search(problem), 2, lambda _: Verdict(objection="never"))
    assert (outcome.status, outcome.detail) == (status, "So.")
    ways(lambda *_: StartOutcome(status=FOUND))
    assert try_start(_search(problem), 0, None) == StartOutcome(status=FOUND, start={"Kp": 2.5})


@pytest.mark.parametrize(
    ("certificate", "repels"),
    [
        (None, False),
        (_certificate(passed=True, stable=False), True),
        (_certificate(passed=True, stable=True), False),
        (_certificate(passed=False, stable=False), False),
    ],
)
def test_an_orbit_repels_that_passes_but_is_refused_for_its_stability(
    certificate: Any, repels: bool
) -> None:
    assert Verdict(objection="No.", certificate=certificate).repels is repels
    assert Verdict(certificate=certificate).repels is False


# Where the best orbit of all does not attract.


def _place(outcome: StartOutcome) -> float:
    assert outcome.candidate is not None
    return outcome.candidate.orbit.values(None).gains["Kp"]  # type: ignore[arg-type]


def _stable_below(limit: float, *multipliers: complex) -> Callable[[Any], Verdict]:
    def accept(orbit: Any) -> Verdict:
        stable = orbit.values(None).gains["Kp"] < limit
        return Verdict() if stable else _repelled(*multipliers)

    return accept


def test_the_best_orbit_that_attracts_is_looked_for_beside_the_one_that_does_not(
    problem: Problem, ways: Any
) -> None:
    best, near = problem.values(gains={"Kp": 3.5}), problem.values(gains={"Kp": 3.0})
    told: list[str] = []
    search = _search(problem, on_progress=lambda stage, _: told.append(stage))
    first = _found(best)
    asked = ways(lambda *_: first, lambda *_: _found(near), measured={"spectral_radius": 0.9})
    outcome = try_start(search, 1, _stable_below(3.2, 0.5, -1.5))
    assert _place(outcome) == 3.0
    assert outcome.detail == (
        "The best orbit, at Kp = 3.5, Kd = -1, is unstable. "
        "This is the best orbit with a spectral radius up to 0.99."
    )
    kind, bounded, (start, solution) = asked[1]
    assert kind == "beside"
    assert bounded == replace(search, bounds=(Bound(name="spectral_radius", upper=0.99),))
    assert start.values == scan.start_place(search, 1)
    assert solution is first.solution
    assert [one for one, *_ in asked] == ["from", "beside", "measure"]
    assert "start 2: looking for a stable orbit" in told
    assert told[-1] == "start 2: verifying"


def test_other_bounds_hold_while_an_orbit_that_attracts_is_looked_for(
    problem: Problem, ways: Any
) -> None:
    kept = Bound(name="period", upper=2.0)
    asked = ways(
        lambda search, _: _found(problem.values(gains={"Kp": 3.0 + (len(search.bounds) < 2)})),
        lambda *_: StartOutcome(status=SearchStatus.NOT_SOLVED),
        measured={"period": 1.5, "spectral_radius": 0.9},
    )
    outcome = try_start(_search(problem, bounds=(kept,)), 0, _stable_below(3.5))
    # From the start again, as there is none beside.
    assert _place(outcome) == 3.0
    assert [one for one, *_ in asked] == ["from", "measure", "beside", "from", "measure"]
    assert [bound.name for bound in asked[3][1].bounds] == ["period", "spectral_radius"]
    assert asked[3][2] == asked[0][2]


@pytest.mark.parametrize(
    ("multiplier", "words"),
    [
        (1.009, "lies on a fold of the family, where orbits lose stability"),
        (1.011, "is unstable"),
        (0.991, "lies on a fold of the family, where orbits lose stability"),
        (-1.009, "lies on a period doubling, where orbits lose stability"),
        (complex(0.0, 1.0), "is unstable"),
        (complex(1.0, 0.01), "is unstable"),
    ],
)
def test_where_orbits_cease_to_attract_is_told(
    problem: Problem, ways: Any, multiplier: complex, words: str
) -> None:
    ways(
        lambda *_: _found(problem.values(gains={"Kp": 3.5})),
        lambda *_: _found(problem.values(gains={"Kp": 3.0})),
    )
    outcome = try_start(_search(problem), 0, _stable_below(3.2, 0.3, multiplier))
    assert outcome.detail.startswith(f"The best orbit, at Kp = 3.5, Kd = -1, {words}. This is")


def test_a_refusal_stands_where_nothing_attracts_or_stability_is_asked_for_already(
    problem: Problem, ways: Any
) -> None:
    here = problem.values(gains={"Kp": 3.5})
    asked = ways(lambda *_: _found(here), lambda *_: _found(here))
    repelled = _stable_below(0.0)
    bounded = _search(problem, bounds=(Bound(name="spectral_radius", upper=0.5),))
    fixed = _search(problem, free={})
    for search, words in ((bounded, 2), (fixed, 1)):
        del asked[:]
        outcome = try_start(search, 0, repelled)
        assert (outcome.status, outcome.detail, outcome.repels) == (REFUSED, "It repels.", True)
        assert len(asked) == words
    optimum = _search(problem, objective=MinSpectralRadius())
    outcome = try_start(replace(optimum, order=(0, 1)), 0, repelled)
    assert (outcome.status, outcome.detail, outcome.repels) == (REFUSED, "It repels.", True)


def test_a_refusal_stands_where_stability_cannot_be_asked_for(problem: Problem, ways: Any) -> None:
    def too_many(*_: Any) -> StartOutcome:
        raise InputError("Too many multipliers.")

    ways(lambda *_: _found(problem.values()), too_many)
    outcome = try_start(_search(problem), 0, lambda _: _repelled())
    assert (outcome.status, outcome.detail) == (REFUSED, "It repels.")


def test_an_orbit_that_is_refused_for_another_reason_is_not_replaced(
    problem: Problem, ways: Any
) -> None:
    asked = ways(lambda *_: _found(problem.values()))
    outcome = try_start(_search(problem), 0, lambda _: Verdict(objection="Ugly."))
    assert (outcome.status, outcome.detail, len(asked)) == (REFUSED, "Ugly.", 1)


def test_nearest_numbers_that_attract_are_looked_for_on_the_way_back(
    problem: Problem, ways: Any
) -> None:
    best = problem.values(gains={"Kp": 3.5})

    def from_start(search: SearchProblem, start: SearchStart) -> StartOutcome:
        return _found(best if search.free else start.values)

    asked = ways(from_start, lambda *_: _found(best))
    search = _search(problem)
    # From 2.5 to 3.5; the way is gone back until the orbit attracts, at half of it.
    outcome = try_start(search, 0, _stable_below(3.2))
    assert _place(outcome) == 3.0
    assert outcome.detail == (
        "The best orbit, at Kp = 3.5, Kd = -1, is unstable. "
        "This orbit, on the way to it, is stable."
    )
    held = [(bounded, start) for kind, bounded, start in asked if kind == "from"][2:]
    tried = [start.values.gains["Kp"] for _, start in held]
    assert tried == pytest.approx([3.45, 3.3, 3.0])
    assert all(one == replace(search, free={}) for one, _ in held)
    # Back at the start itself there may be none either.
    nowhere = try_start(search, 0, _stable_below(2.4))
    assert (nowhere.status, nowhere.detail, nowhere.candidate) == (REFUSED, "It repels.", None)
    last = [start.values.gains["Kp"] for kind, _, start in asked if kind == "from"]
    assert last[-5:] == pytest.approx([3.45, 3.3, 3.0, 2.7, 2.5])
    barely = try_start(search, 0, _stable_below(2.6))
    assert _place(barely) == 2.5


def test_an_orbit_of_another_objective_is_not_looked_for_on_the_way(
    problem: Problem, ways: Any
) -> None:
    asked = ways(
        lambda *_: _found(problem.values()), lambda *_: StartOutcome(status=SearchStatus.NO_GUESS)
    )
    search = _search(problem, objective=TargetPeriod(target=1.8))
    outcome = try_start(search, 0, lambda _: _repelled())
    assert outcome.status is REFUSED
    assert [one for one, *_ in asked if one != "measure"] == ["from", "beside", "from"]
