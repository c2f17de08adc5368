"""From a period to an orbit: which programs are made, and what becomes of their solutions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from tests.support.searches import question_of
from zeno_orbits.model import Problem
from zeno_orbits.model.problem import ParameterValues
from zeno_orbits.orbits import Bound
from zeno_orbits.search import (
    MinEnergy,
    MinSpectralRadius,
    NearestGains,
    Objective,
    SearchSettings,
    SearchStatus,
    refinement,
)
from zeno_orbits.search.outcome import StartOutcome
from zeno_orbits.search.refinement import least_violation, refine, solve_once
from zeno_orbits.search.search_problem import SearchProblem
from zeno_orbits.search.transcription.ipopt import Hessian, Solution, SolveStatus
from zeno_orbits.search.transcription.program import NonlinearProgram, ProgramBuilder

FOUND, UNSOLVED = SearchStatus.FOUND, SearchStatus.NOT_SOLVED
UNLIKE = SearchStatus.NOT_FOLLOWED
NEAREST = NearestGains(target={})
CYCLE: Any = SimpleNamespace(name="the first cycle")


def _search(problem: Problem, **more: Any) -> SearchProblem:
    told: dict[str, Any] = {
        "free": {"Kp": (1.0, 5.0)},
        "sizes": {"Kp": 2.0},
        "settings": SearchSettings(rounds=3),
    }
    return question_of(problem, **told | more)


def _gains(**values: float) -> ParameterValues:
    return ParameterValues(gains=values, parameters={})


# Rounds.


def _outcome(
    status: SearchStatus,
    agreement: float = 0.0,
    excesses: Mapping[str, float] | None = None,
    **at: float,
) -> StartOutcome:
    """Return the outcome of a round, with a solution if there are numbers of it."""
    solution: Any = SimpleNamespace(
        values=_gains(**at), cycle=f"the cycle at {at}", excesses=excesses or {}
    )
    return StartOutcome(status=status, agreement=agreement, solution=solution if at else None)


@pytest.fixture(name="rounds")
def _rounds(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """What each round was asked; the outcomes to give are its attribute ``outcomes``."""
    asked = _Rounds()
    monkeypatch.setattr(refinement, "solve_once", asked.solve)
    return asked


class _Rounds(list[dict[str, Any]]):
    outcomes: Callable[[int], StartOutcome] = staticmethod(lambda _: _outcome(UNSOLVED))

    def solve(self, search: Any, origin: Any, values: Any, cycle: Any, *rest: Any) -> StartOutcome:
        objective, coarseness = rest
        self.append(
            {
                "origin": origin,
                "values": values,
                "cycle": cycle,
                "bounds": search.bounds,
                "objective": objective,
                "coarseness": coarseness,
            }
        )
        return self.outcomes(len(self) - 1)


def test_each_round_starts_from_the_simulation_of_the_last_on_a_mesh_ten_times_finer(
    problem: Problem, rounds: Any
) -> None:
    rounds.outcomes = lambda k: _outcome(FOUND if k == 2 else UNLIKE, 1.0, Kp=2.0 + k)
    found = refine(_search(problem), _gains(Kp=1.0), CYCLE, NEAREST)
    assert found.status is FOUND
    assert found.solution is not None
    assert found.solution.values == _gains(Kp=4.0)
    assert [one["coarseness"] for one in rounds] == pytest.approx([100.0, 10.0, 1.0])
    assert [one["values"].number("Kp") for one in rounds] == [1.0, 2.0, 3.0]
    assert [one["origin"].number("Kp") for one in rounds] == [1.0, 1.0, 1.0]
    assert rounds[0]["cycle"] is CYCLE
    assert [one["cycle"] for one in rounds[1:]] == [
        f"the cycle at { {'Kp': v} }" for v in (2.0, 3.0)
    ]
    assert all(one["objective"] is NEAREST for one in rounds)


def test_at_fixed_numbers_the_first_mesh_is_that_of_the_settings(
    problem: Problem, rounds: Any
) -> None:
    rounds.outcomes = lambda _: _outcome(UNLIKE, Kp=1.0)
    origin = _gains(Kp=9.0)
    found = refine(_search(problem, free={}), _gains(Kp=1.0), CYCLE, NEAREST, origin)
    assert found.status is UNLIKE
    assert [one["coarseness"] for one in rounds] == pytest.approx([1.0, 0.1, 0.01])
    assert all(one["origin"] is origin for one in rounds)


def test_bounds_have_two_rounds_more_and_are_drawn_in_from_the_third_on(
    problem: Problem, rounds: Any
) -> None:
    rounds.outcomes = lambda _: _outcome(UNLIKE, 1.0, {"current": 0.25}, Kp=1.0)
    bounds = (Bound(name="current", lower=-4.0, upper=3.0),)
    refine(_search(problem, bounds=bounds), _gains(Kp=1.0), CYCLE, NEAREST)
    assert [one["coarseness"] for one in rounds] == pytest.approx([100.0, 10.0, 1.0, 0.1, 0.1])
    assert [one["bounds"][0].upper for one in rounds] == [3.0, 3.0, 3.0, 2.75, 2.5]
    assert [one["bounds"][0].lower for one in rounds] == [-4.0, -4.0, -4.0, -3.75, -3.5]


@pytest.mark.parametrize(
    ("outcome", "n_rounds"),
    [
        # Found, or nothing to start a round from.
        (_outcome(FOUND, Kp=1.0), 1),
        (_outcome(UNLIKE), 1),
        # Not solved: only an iterate that is nearly an orbit is worth another round.
        (_outcome(UNSOLVED, 1e-4, Kp=1.0), 1),
        (_outcome(UNSOLVED, float("nan"), Kp=1.0), 1),
        (_outcome(UNSOLVED, 0.9e-4, Kp=1.0), 3),
        (_outcome(UNLIKE, 1.0, Kp=1.0), 3),
    ],
)
def test_rounds_end_where_another_one_would_not_help(
    problem: Problem, rounds: Any, outcome: StartOutcome, n_rounds: int
) -> None:
    rounds.outcomes = lambda _: outcome
    assert refine(_search(problem), _gains(Kp=1.0), CYCLE, NEAREST) is outcome
    assert len(rounds) == n_rounds


def test_without_a_round_nothing_is_solved(problem: Problem, rounds: Any) -> None:
    none = _search(problem, settings=SearchSettings(rounds=0))
    found = refine(none, _gains(Kp=1.0), CYCLE, NEAREST)
    assert found == StartOutcome(status=UNSOLVED)
    assert rounds == []


# Programs.


class _Made:
    """What a program was made of, asked for and solved to."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.transcribed: dict[str, Any] = {}
        self.kept: list[Any] = []
        self.program: NonlinearProgram | None = None
        self.settings: Any = None
        self.confirmed: list[Any] = []
        self.solved = SolveStatus.SOLVED
        self.residuals = {"row": 0.0}
        self.kp = 3.0
        monkeypatch.setattr(
            refinement,
            "closures_of",
            lambda *asked: [
                SimpleNamespace(error=error, asked=asked) for error in (1e-13, 3e-12, 1e-12)
            ],
        )
        monkeypatch.setattr(refinement, "transcribe", self.transcribe)
        monkeypatch.setattr(refinement, "section_map", lambda _terms: ca.MX(0.5))
        monkeypatch.setattr(refinement, "keep", self.keep)
        monkeypatch.setattr(refinement, "solve", self.solve)
        monkeypatch.setattr(refinement, "confirm", self.confirm)
        monkeypatch.setattr(refinement, "replace", _replaced)

    def transcribe(self, compiled: Any, values: ParameterValues, **asked: Any) -> Any:
        del compiled
        self.transcribed = asked
        builder = ProgramBuilder()
        unknown = {
            name: builder.variable(f"free {name}", values.number(name))[0, 0]
            for name in asked["free"]
        }
        builder.equal("row", builder.variable("state", 0.5))
        return SimpleNamespace(
            program=builder,
            free=unknown,
            nearness=asked["nearness"],
            return_slope=None,
            shape="the shape",
            electrical_work=ca.MX(4.0),
            guessed=lambda expression: builder.at_guess(expression).full(),
        )

    def keep(self, terms: Any, bound: Bound, slack: Any = 0.0) -> float:
        del terms
        self.kept.append((bound.name, slack))
        return {"current": 2.0, "theta2": 5.0}.get(bound.name, 1.0)

    def solve(self, program: NonlinearProgram, settings: Any) -> Solution:
        self.program, self.settings = program, settings
        return Solution(
            status=self.solved,
            values={"free Kp": np.array([[self.kp]]), "free Kd": np.array([[-0.5]])},
            residuals=self.residuals,
            objective=0.0,
            iterations=17,
            wall_time=0.25,
        )

    def confirm(self, *asked: Any) -> StartOutcome:
        self.confirmed.append(asked)
        return replace(asked[1], status=FOUND, detail="confirmed", agreement=1e-11)

    def cost(self, **scaled: float) -> float:
        """Return the cost of the program at values of its unknowns."""
        assert self.program is not None
        at = np.array(self.program.guess)
        for name, value in scaled.items():
            place = self.program.names[name.replace("_", " ")][0]
            at[place] = value
        function = ca.Function("cost", [self.program.unknowns], [self.program.objective])
        return float(function(at))

    @property
    def reports(self) -> Mapping[str, ca.MX]:
        assert self.program is not None
        return self.program.reports


def _replaced(value: Any, **changes: Any) -> Any:
    """Return a value with other attributes, frozen or not."""
    if isinstance(value, SimpleNamespace):
        return SimpleNamespace(**{**vars(value), **changes})
    return replace(value, **changes)


@pytest.fixture(name="made")
def _made(monkeypatch: pytest.MonkeyPatch) -> _Made:
    return _Made(monkeypatch)


def _once(
    search: SearchProblem, objective: Objective = NEAREST, coarseness: float = 1.0
) -> StartOutcome:
    origin = search.problem.values(gains={"Kp": 1.5})
    return solve_once(search, origin, search.values, CYCLE, objective, coarseness)


def test_a_program_is_transcribed_on_the_mesh_that_is_asked_for(
    problem: Problem, made: _Made
) -> None:
    outcome = _once(_search(problem), coarseness=100.0)
    settings = SearchSettings().transcription
    assert made.transcribed["settings"].mesh_tolerance == pytest.approx(100 * 3e-8)
    assert made.transcribed["settings"].closure_tolerance == settings.closure_tolerance
    assert made.transcribed["closures"][0].asked[2] == settings.closure_tolerance
    assert made.transcribed["cycle"] is CYCLE
    assert made.transcribed["nearness"].first == {"Kp": 1.5}
    assert outcome.closure_error == 3e-12
    assert (outcome.n_unknowns, outcome.iterations, outcome.solve_time) == (2, 17, 0.25)
    assert outcome.residuals == {"row": 0.0}
    # ((2.5 - 1.5) / 2)^2 / 2 at the problem's own gain, and what it is at another.
    assert made.cost() == pytest.approx(0.125)
    assert made.cost(free_Kp=3.5) == pytest.approx(0.5)


def test_at_fixed_numbers_nothing_is_kept_or_minimised(problem: Problem, made: _Made) -> None:
    bounds = (Bound(name="spectral_radius", upper=0.5), Bound(name="current", upper=1.0))
    outcome = _once(_search(problem, free={}, bounds=bounds), MinSpectralRadius())
    assert outcome.status is FOUND
    assert made.kept == []
    assert made.cost() == 0.0
    assert made.settings.hessian is Hessian.LIMITED_MEMORY
    (asked,) = made.confirmed
    # No objective was asked for, so none is missed.
    assert asked[4] is None
    assert asked[1].detail == "At these gains, the solver converged."


@pytest.mark.parametrize(
    ("objective", "bounds", "slope"),
    [
        (NEAREST, (), False),
        (MinEnergy(), (Bound(name="current", upper=1.0),), False),
        (NEAREST, (Bound(name="spectral_radius", upper=0.5),), True),
        (MinSpectralRadius(), (), True),
    ],
)
def test_the_return_map_is_carried_where_it_is_asked_for_and_has_no_second_derivatives(
    problem: Problem,
    made: _Made,
    monkeypatch: pytest.MonkeyPatch,
    objective: Objective,
    bounds: tuple[Bound, ...],
    slope: bool,
) -> None:
    monkeypatch.setattr(MinSpectralRadius, "cost", lambda _, terms: terms.return_slope)
    _once(_search(problem, bounds=bounds), objective)
    assert [name for name, _ in made.kept] == [bound.name for bound in bounds]
    assert made.settings.hessian is (Hessian.LIMITED_MEMORY if slope else Hessian.EXACT)
    assert made.settings.most_iterations == 60


@pytest.mark.parametrize(("kp", "taken"), [(3.0, 3.0), (0.999, 1.0), (5.001, 5.0)])
def test_numbers_that_the_solver_relaxed_are_taken_back_into_their_ranges(
    problem: Problem, made: _Made, kp: float, taken: float
) -> None:
    made.kp = kp
    search = _search(
        problem, free={"Kp": (1.0, 5.0), "Kd": (-2.0, 0.0)}, sizes={"Kp": 1.0, "Kd": 1.0}
    )
    _once(search)
    ((_, _, unknowns, values, objective, shape),) = made.confirmed
    assert values.gains == {"Kp": taken, "Kd": -0.5}
    assert values.parameters == problem.values().parameters
    assert unknowns["free Kp"] == kp
    assert objective is NEAREST
    assert shape == "the shape"


@pytest.mark.parametrize(
    ("status", "violation", "confirmed", "found"),
    [
        (SolveStatus.SOLVED, 1.0, True, True),
        (SolveStatus.ACCEPTABLE, 1.0, True, True),
        (SolveStatus.ITERATION_LIMIT, 0.9e-6, True, False),
        (SolveStatus.ITERATION_LIMIT, 1e-6, False, False),
        (SolveStatus.INFEASIBLE, float("inf"), False, False),
    ],
)
def test_only_what_nearly_meets_its_rows_is_simulated_and_only_a_solution_is_found(
    problem: Problem,
    made: _Made,
    status: SolveStatus,
    violation: float,
    confirmed: bool,
    found: bool,
) -> None:
    made.solved, made.residuals = status, {"a": 1e-12, "worst row": violation}
    outcome = _once(_search(problem))
    assert (len(made.confirmed) == 1) is confirmed
    assert outcome.status is (FOUND if found else UNSOLVED)
    # An iterate on the way keeps the solver's complaint, and how well its simulation agrees.
    assert (outcome.detail == "confirmed") is found
    assert (outcome.agreement == 1e-11) is confirmed


def test_a_complaint_names_what_was_asked_and_what_was_missed(
    problem: Problem, made: _Made
) -> None:
    made.solved = SolveStatus.INFEASIBLE
    made.residuals = {"a": 1e-9, "b": 2e-9, "c": 0.5}
    outcome = _once(_search(problem))
    sentence = SolveStatus.INFEASIBLE.value
    asked = "Asked for gains near the start"
    assert outcome.detail == f"{asked}, {sentence}; missed: `c` by 5.0e-01, `b` by 2.0e-09."


# The least violation of bounds.


def test_bounds_that_nothing_keeps_are_passed_by_as_little_as_possible(
    problem: Problem, made: _Made
) -> None:
    bounds = (Bound(name="current", upper=1.0), Bound(name="theta2", upper=1.0))
    search = _search(problem, bounds=bounds, free={"Kp": (1.0, 5.0), "Kd": (-2.0, 0.0)}, sizes={})
    origin = problem.values(gains={"Kp": 1.5, "Kd": -1.0})
    outcome = least_violation(search, origin, search.values, CYCLE)
    assert made.transcribed["settings"].mesh_tolerance == pytest.approx(100 * 3e-8)
    assert [name for name, _ in made.kept] == ["current", "theta2"]
    program = made.program
    assert program is not None
    for k in range(2):
        place, _ = program.names[f"slack {k}"]
        assert (program.lower[place], program.guess[place]) == (0.0, 0.1)
    # The sum of both, and a thousandth of how far the gains are, squared, in units of their ranges.
    assert made.cost() == pytest.approx(0.2 + 1e-3 * (1.0 / 4.0) ** 2)
    moved = made.cost(slack_0=0.25, slack_1=0.5, free_Kp=3.5, free_Kd=-0.5)
    assert moved == pytest.approx(0.75 + 1e-3 * (0.5**2 + 0.25**2))
    # Slacks are parts of a size; what is told is the excess itself.
    function = ca.Function("told", [program.unknowns], list(made.reports.values()))
    told = dict(zip(made.reports, function.call([ca.DM(program.guess)]), strict=True))
    assert {name: float(value) for name, value in told.items()} == pytest.approx(
        {"excess 0": 0.2, "excess 1": 0.5}
    )
    ((*_, objective, _shape),) = made.confirmed
    assert objective is None
    assert outcome.detail == "confirmed"
