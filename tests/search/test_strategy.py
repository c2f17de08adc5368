"""Steps of a search that a whole search shows at its end only."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.reference.reference_orbit import PERIOD, RELEASE
from tests.support.searches import question_of
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.model import HybridDynamics, Problem, load_problem
from zeno_orbits.model.problem import ParameterValues
from zeno_orbits.orbits import ONE_ZENO, Bound, EventSequence, ZenoOrbit, cycles
from zeno_orbits.search import (
    MinEnergy,
    NearestGains,
    SearchSettings,
    TargetAmplitude,
    TargetPeriod,
    at_ends,
    strategy,
)
from zeno_orbits.search.homotopy import homotopy
from zeno_orbits.search.homotopy.line import Followed
from zeno_orbits.search.objectives import TowardTarget
from zeno_orbits.search.outcome import SearchStatus, SimulatedSolution, StartOutcome
from zeno_orbits.search.refinement import COARSE, ON_THE_WAY
from zeno_orbits.search.search_problem import SearchProblem
from zeno_orbits.search.shooting import fixed_point
from zeno_orbits.search.shooting.guess import FollowedMotion
from zeno_orbits.search.strategy import SearchStart
from zeno_orbits.search.transcription import constraints
from zeno_orbits.search.transcription.ipopt import Solution, SolveStatus
from zeno_orbits.search.trust_region import _BOXES, LastStep, _is_held, trust_region_steps
from zeno_orbits.simulation import SimulationSettings, simulate


def gains(**values: float) -> ParameterValues:
    return ParameterValues(gains=values, parameters={})


@pytest.mark.parametrize(
    ("kp", "held"),
    [
        (2.5, False),
        (2.0, True),
        (3.0, True),
        (2.2, False),
    ],
)
def test_a_step_is_held_by_a_side_of_its_small_box(kp: float, held: bool) -> None:
    search: Any = SimpleNamespace(free={"Kp": (0.0, 10.0), "Kd": (-1.0, 1.0)})
    box = {"Kp": (2.0, 3.0), "Kd": (-0.5, 0.5)}
    assert _is_held(search, gains(Kp=kp, Kd=0.0), box) is held
    # The second number is looked at as well as the first.
    turned = {"Kd": (-0.5, 0.5), "Kp": (2.0, 3.0)}
    assert _is_held(search, gains(Kp=kp, Kd=0.0), turned) is held


@pytest.mark.parametrize("side", [0.0, 10.0])
def test_a_step_is_not_held_by_a_side_of_the_whole_box(side: float) -> None:
    search: Any = SimpleNamespace(free={"Kp": (0.0, 10.0)})
    box = {"Kp": (max(side - 1.0, 0.0), min(side + 1.0, 10.0))}
    assert not _is_held(search, gains(Kp=side), box)


def test_a_known_orbit_that_cannot_be_followed_is_no_guess() -> None:
    nowhere = Followed(orbit=None, values=gains(Kp=1.0), arrived=False)
    start, search = SearchStart(values=gains(Kp=2.0)), SimpleNamespace()
    outcome = strategy._along(search, start, nowhere, "the known orbit")  # type: ignore[arg-type]
    assert outcome.status is SearchStatus.NO_GUESS
    assert outcome.detail == "From the known orbit no orbit could be followed."


def test_the_rows_of_a_bound_say_which_end_they_hold() -> None:
    bound = Bound(name="current", lower=-2.0, upper=0.5)
    assert constraints._label(bound, 1.0) == "current >= -2"
    assert constraints._label(bound, -1.0) == "current <= 0.5"


def test_the_worst_rows_of_a_solution_are_its_three_largest_violations() -> None:
    sizes = {"a": 1e-9, "b": 3.0, "c": 0.5, "d": 2.0, "e": 1.0}
    found = Solution(
        status=SolveStatus.from_ipopt("Solve_Succeeded"),
        values={"x": np.zeros((1, 1))},
        residuals=sizes,
        objective=0.0,
        iterations=1,
        wall_time=0.0,
    )
    assert found.worst() == [("b", 3.0), ("d", 2.0), ("e", 1.0)]
    assert found.worst(1) == [("b", 3.0)]


@dataclass(frozen=True)
class _Box:
    """A search as far as steps in boxes are concerned."""

    free: dict[str, tuple[float, float]]


def test_boxes_grow_from_step_to_step_while_their_sides_hold_the_optimum() -> None:
    search: Any = _Box(free={"Kp": (0.0, 10.0)})
    widths: list[float] = []

    def to_the_upper_side(there: Any, _values: ParameterValues, cycle: Any) -> Any:
        low, high = there.free["Kp"]
        widths.append((high - low) / 10.0)
        reached = SimpleNamespace(values=gains(Kp=min(high, 9.0)), cycle=cycle)
        return SimpleNamespace(solution=reached, agreement=0.0, detail="")

    cycle: Any = None
    last = trust_region_steps(search, gains(Kp=5.0), cycle, to_the_upper_side)
    assert last.converged
    assert last.values.number("Kp") == 9.0
    # Twice half a box, and the growth of the second one.
    assert widths[0] == pytest.approx(2 * _BOXES.first)
    assert widths[1] == pytest.approx(2 * min(_BOXES.growth * _BOXES.first, _BOXES.longest))
    assert widths[1] > widths[0]


@pytest.mark.parametrize(("kp", "end"), [(3.0, "upper"), (2.0, "lower"), (2.5, "")])
def test_a_number_at_an_end_of_its_range_is_told_with_the_end(kp: float, end: str) -> None:
    pendulum = load_problem("motor_pendulum")
    values = pendulum.values(gains={"Kp": kp, "Kd": -1.0})
    told = (
        f"`Kp` = {kp:g} is the {end} end of its range 2:3: beyond it there may be a better orbit."
    )
    found = at_ends(pendulum, values, {"Kp": (2.0, 3.0), "Kd": (-1.5, -0.5)}, {})
    assert found == ([told] if end else [])
    # What was asked for is no compromise.
    assert at_ends(pendulum, values, {"Kp": (2.0, 3.0)}, {"Kp": kp}) == []


def test_objectives_say_what_they_wish() -> None:
    assert TargetPeriod(target=1.8).wish == "a period of 1.8 s"
    assert TargetAmplitude(target=0.25, state="theta1").wish == "an amplitude of 0.25 of theta1"


def test_the_margins_of_a_path_are_those_of_its_orbit(machine: HybridDynamics) -> None:
    start = np.array(RELEASE)
    (cycle,) = cycles(simulate(machine, start, until=1.5 * PERIOD), start=start)
    margins = homotopy._margins(machine, cycle)
    # To the digits that the declared orbit is given with.
    assert margins["first_impact_speed"] == pytest.approx(-cycle.impacts[0].approach_rate)
    assert margins["locked_time"] == pytest.approx(cycle.end.time - cycle.zeno.time)
    pressed = machine.multiplier(cycle.zeno.state) / machine.normal_inertia(cycle.zeno.state)
    assert margins["gap_acceleration"] == pytest.approx(pressed, rel=1e-6)
    assert min(margins.values()) > 0.0


@pytest.mark.parametrize(
    ("slope", "returns", "slopes"),
    # The start, a return that leads away, and the fixed point by the exact slope at the start; a
    # slope that is known leads there at once.
    [(None, 3, 1), (np.diag([3.0, -2.0]), 2, 0)],
)
def test_the_slope_is_taken_where_returns_alone_lead_away(
    slope: Any, returns: int, slopes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    matrix, taken = np.diag([3.0, -2.0]), []

    def tried(_dynamics: Any, _section: Any, at: Any, *_: Any, **__: Any) -> Any:
        cycle: Any = SimpleNamespace(
            start=SimpleNamespace(state=at), drift=lambda _: 0.0, scale_at_events=lambda: 1.0
        )
        return fixed_point._Trial(at=at, cycle=cycle, miss=matrix @ (at - 0.01) - (at - 0.01))

    def exact(*_: Any, **__: Any) -> Any:
        taken.append(matrix)
        return matrix

    section = SimpleNamespace(dimension=2)
    monkeypatch.setattr(fixed_point, "section_around", lambda *_: section)
    monkeypatch.setattr(fixed_point, "place_on_section", lambda _dynamics, _shape, state: state)
    monkeypatch.setattr(fixed_point, "_tried", tried)
    monkeypatch.setattr(fixed_point, "poincare_jacobian", exact)
    machine: Any = SimpleNamespace(restitution=0.2)
    settings: Any = None
    found = fixed_point.newton_on_return_map(
        machine, np.zeros(2), scale=np.ones(2), period=1.0, settings=settings, slope=slope
    )
    assert found.cycle.start.state == pytest.approx([0.01, 0.01], abs=1e-14)
    assert (found.returns, len(taken)) == (returns, slopes)


# ---------------------------------------------------------------------------- ways to orbits

FOUND, UNSOLVED = SearchStatus.FOUND, SearchStatus.NOT_SOLVED


def _period(name: str = "period", *, shape: EventSequence = ONE_ZENO, length: float = 2.0) -> Any:
    """Return a period as far as ways look at it; each is told from the others by its name."""
    return SimpleNamespace(
        name=name, shape=shape, period=length, start=SimpleNamespace(state=np.array([1.0, 2.0]))
    )


def _asked(problem: Problem, **changes: Any) -> SearchProblem:
    return question_of(problem, **{"initial_states": ({"theta1": 0.6},), **changes})


def _solution(values: ParameterValues, **unknowns: float) -> SimulatedSolution:
    return SimulatedSolution(
        values=values,
        cycle=_period("solution"),
        unknowns={name: np.array([[size]]) for name, size in unknowns.items()},
        orbit=None,
        excesses={},
    )


@dataclass
class Ways:
    """The ways of `strategy`, each of which ends as it is told; what was asked of them is kept."""

    monkeypatch: pytest.MonkeyPatch
    calls: list[tuple[Any, ...]]

    def tell(self, name: str, *answers: Any) -> None:
        """Let a function of the module return one answer after the other, the last for ever."""
        left = list(answers)

        def told(*arguments: Any, **_named: Any) -> Any:
            self.calls.append((name, *arguments))
            answer = left.pop(0) if len(left) > 1 else left[0]
            if isinstance(answer, Exception):
                raise answer
            return answer(*arguments) if callable(answer) else answer

        self.monkeypatch.setattr(strategy, name, told)

    def asked(self, name: str) -> list[tuple[Any, ...]]:
        """Return the arguments that a function was called with."""
        return [arguments for called, *arguments in self.calls if called == name]  # type: ignore[misc]


@pytest.fixture(name="ways")
def _ways(monkeypatch: pytest.MonkeyPatch) -> Ways:
    ways = Ways(monkeypatch=monkeypatch, calls=[])
    # Hand-made periods have no arcs on which bounds could be measured.
    monkeypatch.setattr(strategy, "all_kept", lambda *_: False)
    return ways


def test_a_search_beside_a_solution_starts_from_it_and_measures_nearness_from_the_start(
    problem: Problem, ways: Ways
) -> None:
    ways.tell("refine", StartOutcome(status=FOUND))
    search, start = _asked(problem), SearchStart(values=problem.values(gains={"Kp": 3.0}))
    solution = _solution(problem.values(gains={"Kp": 3.5}))
    assert strategy.beside(search, start, solution).status is FOUND
    assert ways.asked("refine") == [
        [search, solution.values, solution.cycle, search.objective, start.values]
    ]


def test_a_known_orbit_is_followed_to_the_numbers_of_the_start(
    problem: Problem, ways: Ways, orbit: ZenoOrbit
) -> None:
    path = Followed(orbit=None, values=problem.values(), arrived=False)
    ways.tell("follow", path)
    search, values = _asked(problem), problem.values(gains={"Kp": 3.0})
    outcome = strategy.from_start(search, SearchStart(values=values, near=orbit))
    assert outcome.detail == "From the known orbit no orbit could be followed."
    assert ways.asked("follow") == [[search, orbit, orbit.values(problem), values]]


def test_a_simulated_period_is_where_a_search_begins(problem: Problem, ways: Ways) -> None:
    cycle = _period()
    ways.tell("simulated", FollowedMotion(cycle=cycle))
    for free, status in (({"Kp": (2.0, 4.0)}, UNSOLVED), ({}, FOUND), ({"Kp": (2.0, 4.0)}, FOUND)):
        ways.tell("from_cycle", StartOutcome(status=status, detail="So."))
        search, start = _asked(problem, free=free), SearchStart(values=problem.values())
        assert strategy.from_start(search, start) == StartOutcome(status=status, detail="So.")
        assert ways.asked("from_cycle")[-1] == [search, start.values, cycle]


@pytest.mark.parametrize(
    ("closed", "status", "detail"),
    [
        (StartOutcome(status=FOUND, detail="By itself."), FOUND, "By itself."),
        (None, UNSOLVED, "So."),
        (StartOutcome(status=UNSOLVED, detail="Not."), UNSOLVED, "Not."),
    ],
)
def test_at_fixed_numbers_simulation_closes_what_the_program_cannot(
    problem: Problem, ways: Ways, closed: Any, status: SearchStatus, detail: str
) -> None:
    cycle, start = _period(), SearchStart(values=problem.values())
    ways.tell("simulated", FollowedMotion(cycle=cycle))
    ways.tell("from_cycle", StartOutcome(status=UNSOLVED, detail="So."))
    ways.tell("_closed", closed)
    ways.tell("_by_an_easier_way", lambda *arguments: arguments[-1])
    search = _asked(problem, free={})
    outcome = strategy.from_start(search, start)
    assert (outcome.status, outcome.detail) == (status, detail)
    assert ways.asked("_closed") == [[search, start.values, cycle]]
    assert bool(ways.asked("_by_an_easier_way")) == (status is not FOUND)


def test_a_start_without_a_motion_says_where_and_why(problem: Problem, ways: Ways) -> None:
    nothing = FollowedMotion(cycle=None, reason="it rests", undecided=True)
    ways.tell("simulated", nothing)
    start = SearchStart(values=problem.values(gains={"Kp": 3.0}))
    outcome = strategy.from_start(_asked(problem), start)
    assert outcome == StartOutcome(
        status=SearchStatus.NO_GUESS, detail="At Kp = 3, Kd = -1, it rests.", undecided=True
    )
    ball = load_problem("bouncing_ball")
    alone = _asked(ball, values=ball.values(), free={}, initial_states=())
    outcome = strategy.from_start(alone, SearchStart(values=ball.values()))
    assert outcome.detail == "It rests."
    known = strategy.from_start(alone, SearchStart(values=ball.values(), known_empty=True))
    assert (known.detail, known.undecided) == ("No orbit is near.", False)
    assert len(ways.asked("simulated")) == 2


# A simulation.


def test_a_motion_is_simulated_once_more_over_one_period_or_told_why_not(
    problem: Problem, ways: Ways
) -> None:
    cycle, again = _period("loose", length=3.0), _period("exact")
    ways.tell("run_to_attractor", FollowedMotion(cycle=cycle))
    ways.tell("one_cycle", again)
    search, values = _asked(problem), problem.values()
    assert strategy.simulated(search, values).cycle is again
    ((_, starts, settling, shape, of),) = ways.asked("run_to_attractor")
    assert starts == [problem.state_vector({"theta1": 0.6})]
    assert (settling, shape, of) == (search.settings.settling, None, problem)
    ((_, state, horizon, kind),) = ways.asked("one_cycle")
    assert (state.tolist(), horizon, kind) == ([1.0, 2.0], 6.0, ONE_ZENO)
    # The loose one is better than none.
    ways.tell("one_cycle", None)
    assert strategy.simulated(search, values).cycle is cycle
    nothing = FollowedMotion(cycle=None, reason="it rests")
    ways.tell("run_to_attractor", nothing)
    assert strategy.simulated(search, values) is nothing


@pytest.mark.parametrize(
    ("wanted", "settled"), [(ONE_ZENO, "zeno"), (None, "zeno*2"), (None, "impact")]
)
def test_a_period_of_a_wanted_shape_or_of_several_phases_is_closed_first(
    problem: Problem, ways: Ways, wanted: Any, settled: str
) -> None:
    cycle = _period(shape=EventSequence.parsed(settled))
    nearer = FollowedMotion(cycle=_period("nearer"))
    ways.tell("run_to_attractor", FollowedMotion(cycle=cycle))
    ways.tell("_brought_nearer", nearer)
    search = _asked(problem, shape=wanted)
    assert strategy.simulated(search, problem.values()) is nearer
    ((of, _, period),) = ways.asked("_brought_nearer")
    assert (of, period) == (search, cycle)


def test_a_period_that_closes_is_taken_and_one_that_does_not_is_left_as_it_is(
    problem: Problem, ways: Ways
) -> None:
    search, cycle, near = _asked(problem), _period(), _period("near", length=4.0)
    machine: Any = SimpleNamespace()
    ways.tell("newton_from_cycle", ZenoOrbitsError("It does not close."))
    assert strategy._brought_nearer(search, machine, cycle) == FollowedMotion(cycle=cycle)
    ways.tell("newton_from_cycle", SimpleNamespace(cycle=near))
    ways.tell("minimal_period", None)
    assert strategy._brought_nearer(search, machine, cycle) == FollowedMotion(cycle=near)
    assert ways.asked("minimal_period") == [[near]]


def test_a_period_that_is_gone_round_twice_is_halved_unless_that_shape_is_wanted(
    problem: Problem, ways: Ways
) -> None:
    cycle, near, once = _period(), _period("near", length=4.0), _period("once")
    machine: Any = SimpleNamespace()
    ways.tell("newton_from_cycle", SimpleNamespace(cycle=near))
    ways.tell("minimal_period", ONE_ZENO)
    ways.tell("round_again", "The orbit is gone round twice.")
    ways.tell("one_cycle", once)
    assert strategy._brought_nearer(_asked(problem), machine, cycle).cycle is once
    ((_, state, horizon, shape),) = ways.asked("one_cycle")
    # Twice the shorter period is the whole one.
    assert (state.tolist(), horizon, shape) == ([1.0, 2.0], 4.0, ONE_ZENO)
    ways.tell("one_cycle", None)
    assert strategy._brought_nearer(_asked(problem), machine, cycle).cycle is near
    wanted = _asked(problem, shape=EventSequence.parsed("zeno*2"))
    found = strategy._brought_nearer(wanted, machine, cycle)
    assert found == FollowedMotion(cycle=None, reason="the orbit is gone round twice")


def test_an_orbit_that_simulation_closes_is_found_with_what_is_left_of_its_miss(
    problem: Problem, ways: Ways, monkeypatch: pytest.MonkeyPatch
) -> None:
    search, values, found = _asked(problem, free={}), problem.values(), _period("closed")
    orbit: Any = SimpleNamespace()
    ways.tell("newton_from_cycle", SimpleNamespace(cycle=found, miss=3e-13))
    ways.tell("round_again", "")
    ways.tell("escape_of", "")
    ways.tell("orbit_of", orbit)
    outcome = strategy._closed(search, values, _period())
    assert outcome is not None
    assert (outcome.status, outcome.agreement) == (FOUND, 3e-13)
    assert "simulation alone closes the orbit" in outcome.detail
    assert outcome.solution == SimulatedSolution(
        values=values, cycle=found, unknowns={}, orbit=orbit, excesses={}
    )
    assert ways.asked("orbit_of") == [[found, problem, values]]
    ((_, _, settings),) = ways.asked("newton_from_cycle")
    usual = SimulationSettings().tolerance
    assert settings.tolerance.relative == pytest.approx(usual.relative / 100, rel=1e-9, abs=0.0)
    for name in ("round_again", "escape_of"):
        with monkeypatch.context():
            ways.tell(name, "It is none.")
            assert strategy._closed(search, values, _period()) is None
            ways.tell(name, "")
    target = replace(search, objective=TargetPeriod(target=1.0))
    assert strategy._closed(target, values, _period()) is None
    assert strategy._closed(search, values, _period()) is not None
    ways.tell("newton_from_cycle", ZenoOrbitsError("It does not close."))
    assert strategy._closed(search, values, _period()) is None


# An easier place.


def test_orbits_are_followed_from_the_first_easier_place_that_has_one(
    problem: Problem, ways: Ways
) -> None:
    told: list[str] = []
    search = _asked(problem, on_progress=lambda stage, _: told.append(stage))
    values = [problem.values(gains={"Kp": kp}) for kp in (3.0, 2.1, 2.2, 2.3, 2.4)]
    start = SearchStart(values=values[0], easy=tuple(values))
    cycle = _period()
    ways.tell("simulated", FollowedMotion(cycle=None), FollowedMotion(cycle=cycle))
    lost = Followed(orbit=None, values=values[2], arrived=False)
    path = Followed(orbit=_period("end"), values=values[0], arrived=True)
    ways.tell("follow", lost, path)
    ways.tell("_along", StartOutcome(status=FOUND))
    failed = StartOutcome(status=SearchStatus.NO_GUESS, detail="It rests.", shortfall=0.5)
    assert strategy._by_an_easier_way(search, start, failed).status is FOUND
    # That of the start itself is no easier one.
    assert ways.asked("simulated") == [[search, values[k]] for k in (1, 2, 3)]
    assert ways.asked("follow") == [[search, cycle, values[k], values[0]] for k in (2, 3)]
    assert ways.asked("_along") == [[search, start, path, "Kp = 2.3"]]
    assert told == [f"following orbits from Kp = {kp}" for kp in (2.1, 2.2, 2.3)]


@pytest.mark.parametrize(("left", "shortfall"), [(0.25, 0.25), (0.75, 0.5)])
def test_a_path_that_ends_before_the_start_says_where(
    problem: Problem, ways: Ways, left: float, shortfall: float
) -> None:
    easy = problem.values(gains={"Kp": 2.1})
    start = SearchStart(values=problem.values(), easy=(easy, easy))
    ways.tell("simulated", FollowedMotion(cycle=_period()))
    path = Followed(orbit=_period(), values=easy, arrived=False, ending="It ends here.", left=left)
    ways.tell("follow", path)
    ways.tell("_along", StartOutcome(status=SearchStatus.NO_GUESS))
    failed = StartOutcome(status=SearchStatus.NO_GUESS, detail="It rests.", shortfall=0.5)
    outcome = strategy._by_an_easier_way(_asked(problem), start, failed)
    assert outcome == replace(failed, detail="It rests. It ends here.", shortfall=shortfall)
    assert len(ways.asked("follow")) == 1
    nowhere = SearchStart(values=problem.values())
    assert strategy._by_an_easier_way(_asked(problem), nowhere, failed) is failed


def test_a_path_that_arrives_leads_to_a_search_at_the_numbers_of_the_start(
    problem: Problem, ways: Ways
) -> None:
    ways.tell("from_cycle", StartOutcome(status=FOUND))
    cycle, values = _period(), problem.values(gains={"Kp": 3.0})
    path = Followed(orbit=cycle, values=problem.values(), arrived=True)
    search = _asked(problem)
    assert strategy._along(search, SearchStart(values=values), path, "it").status is FOUND
    assert ways.asked("from_cycle") == [[search, values, cycle]]


@pytest.mark.parametrize(
    ("reached", "free", "inside"),
    [
        ({"Kp": 2.0}, {"Kp": (2.0, 4.0)}, True),
        ({"Kp": 4.0}, {"Kp": (2.0, 4.0)}, True),
        ({"Kp": 1.9}, {"Kp": (2.0, 4.0)}, False),
        ({"Kp": 4.1}, {"Kp": (2.0, 4.0)}, False),
        ({"Kp": 3.0, "Kd": -0.9}, {"Kp": (2.0, 4.0)}, False),
        ({"Kp": 3.0, "Kd": -0.9}, {"Kp": (2.0, 4.0), "Kd": (-1.0, 0.0)}, True),
        ({}, {}, False),
    ],
)
def test_the_end_of_a_path_is_searched_if_it_lies_in_the_box_of_what_is_free(
    problem: Problem, ways: Ways, reached: Any, free: Any, inside: bool
) -> None:
    ways.tell("from_cycle", StartOutcome(status=FOUND, detail="And on."))
    cycle, values = _period(), problem.values(gains=reached)
    path = Followed(orbit=cycle, values=values, arrived=False, ending="It ends here.")
    search = _asked(problem, free=free)
    outcome = strategy._along(search, SearchStart(values=problem.values()), path, "it")
    if inside:
        assert outcome == StartOutcome(status=FOUND, detail="It ends here. And on.")
        assert ways.asked("from_cycle") == [[search, values, cycle]]
    else:
        assert outcome == StartOutcome(status=SearchStatus.NO_GUESS, detail="It ends here.")
        assert ways.asked("from_cycle") == []


def test_a_failure_at_the_end_of_a_path_is_told_alone(problem: Problem, ways: Ways) -> None:
    failed = StartOutcome(status=UNSOLVED, detail="It fails.")
    ways.tell("from_cycle", failed)
    path = Followed(orbit=_period(), values=problem.values(), arrived=False, ending="It ends.")
    search = _asked(problem)
    assert strategy._along(search, SearchStart(values=problem.values()), path, "it") is failed


# From a period to the objective.


def _refined(*statuses: SearchStatus) -> list[StartOutcome]:
    return [StartOutcome(status=status, detail=f"{k}") for k, status in enumerate(statuses)]


def test_numbers_that_are_wanted_are_held_where_nothing_else_is_asked(
    problem: Problem, ways: Ways
) -> None:
    here, cycle = problem.values(gains={"Kp": 3.0}), _period()
    wanted = NearestGains(target={"Kp": 3.0, "Kd": -1.0})
    search, held = _asked(problem, objective=wanted), _asked(problem, objective=wanted, free={})
    for one in (search, held):
        ways.tell("refine", *_refined(UNSOLVED))
        assert strategy.from_cycle(one, here, cycle).status is UNSOLVED
    assert ways.asked("refine") == 2 * [[held, here, cycle, wanted]]
    # With bounds, the orbit at the wanted numbers may have to give way.
    bounded = replace(search, bounds=(Bound(name="period", upper=2.0),))
    ways.tell("refine", *_refined(FOUND, FOUND))
    assert strategy.from_cycle(bounded, here, cycle).detail == "1"
    assert ways.asked("refine")[-1] == [bounded, here, cycle, wanted]


@pytest.mark.parametrize("target", [{"Kp": 3.1}, {"Kp": 3.0, "Kd": -0.9}])
def test_numbers_that_are_not_the_wanted_ones_are_free(
    problem: Problem, ways: Ways, target: dict[str, float]
) -> None:
    here, cycle = problem.values(gains={"Kp": 3.0}), _period()
    search = _asked(problem, objective=NearestGains(target=target))
    ways.tell("refine", *_refined(FOUND, UNSOLVED))
    assert strategy.from_cycle(search, here, cycle).detail == "0"
    assert ways.asked("refine") == [[search, here, cycle, search.objective]]


def test_an_objective_is_reached_in_small_steps_where_one_program_fails(
    problem: Problem, ways: Ways
) -> None:
    told: list[str] = []
    search = _asked(problem, objective=MinEnergy(), on_progress=lambda stage, _: told.append(stage))
    here, there = problem.values(), problem.values(gains={"Kp": 3.0})
    cycle, last = _period(), _period("last")
    ways.tell("refine", *_refined(UNSOLVED, FOUND))
    ways.tell("trust_region_steps", LastStep(values=there, cycle=last))
    ways.tell("solve_once", StartOutcome(status=FOUND))
    assert strategy.from_cycle(search, here, cycle).detail == "1"
    objective = search.objective
    assert ways.asked("refine") == [
        [search, here, cycle, objective],
        [search, there, last, objective, here],
    ]
    ((_, values, around, solve),) = ways.asked("trust_region_steps")
    assert (values, around) == (here, cycle)
    assert told == [f"small steps toward {objective.wish}"]
    near = replace(search, free={"Kp": (2.4, 2.6)})
    solve(near, there, last)
    assert ways.asked("solve_once") == [[near, here, there, last, objective, COARSE]]
    # At fixed numbers there are no steps.
    ways.tell("refine", *_refined(UNSOLVED))
    held = replace(search, free={})
    assert strategy.from_cycle(held, here, cycle).status is UNSOLVED
    assert len(ways.asked("trust_region_steps")) == 1


def test_where_no_orbit_keeps_the_bounds_the_one_that_does_nearly_is_told(
    problem: Problem, ways: Ways
) -> None:
    bounds = (Bound(name="period", upper=2.0),)
    search = _asked(problem, objective=MinEnergy(), bounds=bounds)
    here, there = problem.values(), problem.values(gains={"Kp": 3.0})
    cycle, last = _period(), _period("last")
    ways.tell("refine", replace(_refined(UNSOLVED)[0], iterations=7))
    lacking = StartOutcome(status=SearchStatus.NO_GUESS, detail="It leaves them.", shortfall=0.5)
    ways.tell("_where_bounds_are_kept", (there, last, lacking))
    outcome = strategy.from_cycle(search, here, cycle)
    assert outcome == replace(lacking, iterations=7)
    assert ways.asked("_where_bounds_are_kept") == [[search, here, cycle]]
    # From where they are kept, steps go on.
    ways.tell("_where_bounds_are_kept", (there, last, None))
    ways.tell("trust_region_steps", LastStep(values=there, cycle=last))
    ways.tell("refine", *_refined(UNSOLVED, UNSOLVED))
    ways.tell("best_on_the_way", None)
    assert strategy.from_cycle(search, here, cycle).detail == "0"
    ((_, values, around, _),) = ways.asked("trust_region_steps")
    assert (values, around) == (there, last)


# Where bounds are kept.


def _violated(values: ParameterValues, *slacks: float) -> StartOutcome:
    unknowns = {f"slack {k}": size for k, size in enumerate(slacks)}
    unknowns |= {f"excess {k}": 10 * size for k, size in enumerate(slacks)}
    return StartOutcome(status=UNSOLVED, solution=_solution(values, **unknowns))


def test_bounds_that_cannot_be_kept_are_told_with_where_and_by_how_much(
    problem: Problem, ways: Ways
) -> None:
    bounds = tuple(Bound(name=name, upper=1.0) for name in ("period", "theta1", "dtheta1"))
    told: list[str] = []
    search = _asked(problem, bounds=bounds, on_progress=lambda stage, _: told.append(stage))
    here, there = problem.values(), problem.values(gains={"Kp": 3.0})
    cycle, end = _period(), _period("end")
    outcome = _violated(there, 0.25, 0.9e-5, 1.1e-5)
    step = LastStep(values=there, cycle=end, outcome=outcome, converged=True)
    ways.tell("trust_region_steps", step)
    ways.tell("least_violation", outcome)
    values, around, lacking = strategy._where_bounds_are_kept(search, here, cycle)
    assert (values, around) == (there, end)
    assert lacking is not None
    assert lacking.status is UNSOLVED
    assert lacking.shortfall == pytest.approx(0.25 + 2e-5)
    assert lacking.detail.endswith(
        "at Kp = 3, `period` leaves its bounds :1 by 2.5, "
        "`dtheta1` leaves its bounds :1 by 0.00011."
    )
    assert told == ["looking for where the bounds are kept"]
    ((_, first, of, solve),) = ways.asked("trust_region_steps")
    assert (first, of) == (here, cycle)
    solve(search, there, end)
    assert ways.asked("least_violation") == [[search, here, there, end]]


@pytest.mark.parametrize(
    ("slack", "converged"), [(0.0, True), (1e-5, True), (1.0, False), (0.0, False)]
)
def test_steps_end_where_the_bounds_are_kept_or_no_further_is_known(
    problem: Problem, ways: Ways, slack: float, converged: bool
) -> None:
    search = _asked(problem, bounds=(Bound(name="period", upper=1.0),))
    there, end = problem.values(gains={"Kp": 3.0}), _period("end")
    step = LastStep(values=there, cycle=end, outcome=_violated(there, slack), converged=converged)
    ways.tell("trust_region_steps", step)
    found = strategy._where_bounds_are_kept(search, problem.values(), _period())
    assert found == (there, end, None)


@pytest.mark.parametrize("outcome", [None, StartOutcome(status=UNSOLVED)])
def test_without_a_step_the_search_stays_where_it_is(
    problem: Problem, ways: Ways, outcome: Any
) -> None:
    here, cycle = problem.values(), _period()
    step = LastStep(values=problem.values(gains={"Kp": 3.0}), cycle=_period(), outcome=outcome)
    ways.tell("trust_region_steps", step)
    search = _asked(problem, bounds=(Bound(name="period", upper=1.0),))
    assert strategy._where_bounds_are_kept(search, here, cycle) == (here, cycle, None)


# A target.

FIRST_STEP, SMALLEST_STEP = 0.125, 0.0625


def _toward(problem: Problem, told: list[str]) -> tuple[SearchProblem, TargetPeriod]:
    target = TargetPeriod(target=2.0)
    settings = SearchSettings(first_step=FIRST_STEP, smallest_step=SMALLEST_STEP)
    search = _asked(
        problem,
        objective=target,
        settings=settings,
        on_progress=lambda stage, _: told.append(stage),
    )
    return search, target


def test_a_target_that_is_near_is_asked_for_at_once(problem: Problem, ways: Ways) -> None:
    told: list[str] = []
    search, target = _toward(problem, told)
    ways.tell("refine", *_refined(FOUND))
    cycle = _period(length=2.0 * (1 + FIRST_STEP))
    assert strategy.from_cycle(search, problem.values(), cycle).status is FOUND
    assert ways.asked("refine") == [[search, problem.values(), cycle, target]]
    assert told == ["asking for a period of 2 s"]


def test_a_target_that_is_far_is_approached_in_steps(problem: Problem, ways: Ways) -> None:
    told: list[str] = []
    search, target = _toward(problem, told)
    here, there = problem.values(), problem.values(gains={"Kp": 3.0})
    cycle, last = _period(length=2.5), _period("last", length=2.0 * (1 + SMALLEST_STEP))
    ways.tell("trust_region_steps", LastStep(values=there, cycle=last))
    ways.tell("solve_once", StartOutcome(status=FOUND))
    ways.tell("refine", *_refined(FOUND))
    assert strategy.from_cycle(search, here, cycle).status is FOUND
    assert told == ["small steps toward a period of 2 s", "asking for a period of 2 s"]
    assert ways.asked("refine") == [[search, there, last, target, here]]
    ((_, values, around, solve),) = ways.asked("trust_region_steps")
    assert (values, around) == (here, cycle)
    solve(search, there, last)
    assert ways.asked("solve_once") == [
        [search, here, there, last, TowardTarget(target=target), COARSE]
    ]
    # The nearest numbers may be far along the level line.
    ways.tell("refine", *_refined(UNSOLVED, FOUND))
    assert strategy.from_cycle(search, here, cycle).detail == "1"
    assert ways.asked("refine")[-1] == [search, there, last, target, there]


def test_a_near_target_that_is_missed_at_once_is_approached_too(
    problem: Problem, ways: Ways
) -> None:
    told: list[str] = []
    search, _ = _toward(problem, told)
    cycle = _period(length=2.125)
    ways.tell("refine", *_refined(UNSOLVED, FOUND))
    ways.tell("trust_region_steps", LastStep(values=problem.values(), cycle=cycle))
    assert strategy.from_cycle(search, problem.values(), cycle).detail == "1"
    assert told[1] == "small steps toward a period of 2 s"


def test_a_target_that_cannot_be_asked_for_is_missed_with_the_reason(
    problem: Problem, ways: Ways
) -> None:
    search, _ = _toward(problem, [])
    cycle = _period(length=2.5)
    near = LastStep(values=problem.values(), cycle=_period(length=1.9375))
    ways.tell("trust_region_steps", near)
    ways.tell("refine", *_refined(UNSOLVED, SearchStatus.NOT_FOLLOWED))
    outcome = strategy.from_cycle(search, problem.values(), cycle)
    assert (outcome.status, outcome.detail, outcome.shortfall) == (UNSOLVED, "1", 0.0625)


@pytest.mark.parametrize("length", [2.2, 1.8])
def test_a_target_that_the_steps_do_not_come_near_is_missed(
    problem: Problem, ways: Ways, length: float
) -> None:
    search, _ = _toward(problem, [])
    there = problem.values(gains={"Kp": 3.999})
    ways.tell(
        "trust_region_steps", LastStep(values=there, cycle=_period(length=length), outcome=None)
    )
    outcome = strategy.from_cycle(search, problem.values(), _period(length=2.5))
    assert outcome.status is UNSOLVED
    assert outcome.shortfall == pytest.approx(0.2)
    assert outcome.detail == (
        f"The nearest that was reached is a period of {length:g} s, at Kp = 3.999, Kd = -1 "
        "(Kp at its bound 4); missed: `a period of 2 s` by 0.2."
    )


@pytest.mark.parametrize(
    ("agreement", "words"), [(ON_THE_WAY / 2, ""), (ON_THE_WAY, " It fails."), (1.0, " It fails.")]
)
def test_the_last_failure_is_told_unless_it_was_good_enough_on_the_way(
    problem: Problem, agreement: float, words: str
) -> None:
    search, target = _toward(problem, [])
    last = StartOutcome(status=FOUND, detail="It fails.", agreement=agreement, iterations=7)
    outcome = strategy._short_of(
        search, target, 2.5, LastStep(values=problem.values(), cycle=_period()), last
    )
    assert outcome.detail.endswith(f"by 0.5.{words}")
    assert (outcome.status, outcome.iterations, outcome.shortfall) == (UNSOLVED, 7, 0.5)


def test_numbers_within_a_fiftieth_of_their_range_are_at_its_bound(problem: Problem) -> None:
    search = _asked(problem, free={"Kp": (2.0, 4.0), "Kd": (-2.0, 2.0)})

    def held(kp: float, kd: float) -> str:
        return strategy._held(search, problem.values(gains={"Kp": kp, "Kd": kd}))

    assert held(2.041, -1.919) == ""
    assert held(2.039, 1.921) == " (Kp at its bound 2, Kd at its bound 2)"
    assert held(3.961, 0.0) == " (Kp at its bound 4)"
    # Exactly a fiftieth of a range of 50 counts.
    wide = replace(search, free={"Kp": (0.0, 50.0)})
    assert strategy._held(wide, problem.values(gains={"Kp": 1.0})) == " (Kp at its bound 0)"
