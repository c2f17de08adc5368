"""Solutions held against simulations that are made up, entry by entry."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.searches import question_of
from zeno_orbits.errors import SimulationError
from zeno_orbits.model import Problem
from zeno_orbits.orbits import ONE_ZENO, Bound, EventSequence, Moment, PhaseKind, place_on_section
from zeno_orbits.search import MinEnergy, SearchSettings, SearchStatus, TargetPeriod, confirmation
from zeno_orbits.search.confirmation import confirm, one_cycle, tightened
from zeno_orbits.search.outcome import StartOutcome
from zeno_orbits.search.search_problem import SearchProblem
from zeno_orbits.simulation import Impact, SimulationSettings, ZenoPoint

TWICE = EventSequence.parsed("zeno*2")
STRUCK = EventSequence.parsed("impact*2")
SCALE = np.array([1.0, 2.0, 4.0, 8.0, 16.0])
SINCE = 100.0
"""When the simulated period starts [s]."""


def _state(number: int) -> Any:
    """Return a state, each entry of it different from those of others."""
    return number + np.array([0.1, 0.2, 0.3, 0.4, 0.5])


def _unknowns(shape: EventSequence = TWICE) -> dict[str, Any]:
    """Return a solution of two phases of two impacts each; the period is 8 s."""
    told: dict[str, Any] = {"period": np.array([[8.0]])}
    for k, kind in enumerate(shape.phases):
        label, before = f"phase {k + 1}: ", "release" if kind.holds else "start"
        told |= {
            f"{label}start time": np.array([[4.0 * k]]),
            f"{label}{before} state": _state(10 * k)[:, None],
            f"{label}flight times": np.array([[1.0], [0.5]])[: 2 if kind.holds else 1],
            f"{label}impact states": np.transpose([_state(10 * k + 1), _state(10 * k + 2)])[
                :, : 2 if kind.holds else 1
            ],
        }
        if kind.holds:
            told |= {
                f"{label}Zeno time": np.array([[4.0 * k + 2.0]]),
                f"{label}Zeno state": _state(10 * k + 3)[:, None],
            }
    return told


def _impact(time: float, state: Any) -> Impact:
    return Impact(time=time, state_minus=state, state_plus=-state, approach_rate=-1.0)


def _cycle(shape: EventSequence = TWICE, drift: float = 0.0) -> Any:
    """Return the simulated period of that solution."""
    phases: list[Any] = []
    for k, kind in enumerate(shape.phases):
        since, zeno = SINCE + 4.0 * k, None
        if kind.holds:
            zeno = ZenoPoint(
                time=since + 2.0,
                state=_state(10 * k + 3),
                limit_error=0.0,
                tail=0.0,
                last_speed=1.0,
            )
        impacts = [_impact(since + 1.0 + 0.5 * j, _state(10 * k + 1 + j)) for j in range(2)]
        start = Moment(time=since, state=_state(10 * k))
        phases.append(
            SimpleNamespace(start=start, zeno=zeno, impacts=impacts[: 2 if kind.holds else 1])
        )
    return SimpleNamespace(
        period=8.0,
        shape=shape,
        start=phases[0].start,
        phases=tuple(phases),
        scale=lambda: SCALE.copy(),
        drift=lambda scale: drift if np.all(scale == SCALE) else math.nan,
        arcs=("an arc",),
    )


def _search(problem: Problem, **changes: Any) -> SearchProblem:
    return question_of(problem, **{"objective": MinEnergy(), **changes})


# How far they differ.


@pytest.mark.parametrize("shape", [TWICE, STRUCK])
def test_a_solution_that_is_the_simulated_period_does_not_differ_from_it(
    shape: EventSequence,
) -> None:
    assert confirmation._difference(_cycle(shape), _unknowns(shape)) == 0.0
    # What does not close differs by that.
    assert confirmation._difference(_cycle(shape, drift=0.25), _unknowns(shape)) == 0.25


@pytest.mark.parametrize(
    ("block", "entry", "apart"),
    [
        ("period", (0, 0), 1 / 8),
        ("phase 2: start time", (0, 0), 1 / 8),
        ("phase 1: Zeno time", (0, 0), 1 / 8),
        ("phase 2: Zeno time", (0, 0), 1 / 8),
        ("phase 2: release state", (2, 0), 1 / 4),
        ("phase 1: Zeno state", (0, 0), 1.0),
        ("phase 2: Zeno state", (4, 0), 1 / 16),
        ("phase 1: flight times", (0, 0), 1 / 8),
        ("phase 2: flight times", (1, 0), 1 / 8),
        ("phase 1: impact states", (1, 0), 1 / 2),
        ("phase 2: impact states", (3, 1), 1 / 8),
    ],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_every_entry_of_a_solution_is_compared_in_its_own_size(
    block: str, entry: tuple[int, int], apart: float, sign: float
) -> None:
    unknowns = _unknowns()
    unknowns[block][entry] += sign
    assert confirmation._difference(_cycle(), unknowns) == pytest.approx(apart)


@pytest.mark.parametrize(
    ("block", "entry", "apart"),
    [
        ("phase 2: start state", (2, 0), 1 / 4),
        ("phase 1: impact states", (1, 0), 1 / 2),
        ("phase 2: flight times", (0, 0), 1 / 8),
    ],
)
def test_phases_that_end_at_an_impact_are_compared_too(
    block: str, entry: tuple[int, int], apart: float
) -> None:
    unknowns = _unknowns(STRUCK)
    unknowns[block][entry] += 1.0
    assert confirmation._difference(_cycle(STRUCK), unknowns) == pytest.approx(apart)


def test_the_start_of_a_solution_is_where_its_simulation_starts_by_making() -> None:
    unknowns = _unknowns()
    unknowns["phase 1: release state"][0, 0] += 1.0
    assert confirmation._difference(_cycle(), unknowns) == 0.0
    # Impacts that only one of them resolved cannot be compared.
    unknowns = _unknowns()
    unknowns["phase 2: flight times"] = np.array([[1.0], [0.5], [9.0]])
    states = np.column_stack([unknowns["phase 2: impact states"], _state(99)])
    unknowns["phase 2: impact states"] = states
    assert confirmation._difference(_cycle(), unknowns) == 0.0


# What is made of it.


class _Confirmed:
    """A confirmation whose simulation and checks find what they are told to."""

    def __init__(self, problem: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
        self.problem, self.patch = problem, monkeypatch
        self.asked: list[Any] = []
        self.told: dict[str, Any] = {
            "one_cycle": _cycle(),
            "_difference": 0.0,
            "_excesses": {},
            "round_again": "",
            "escape_of": "",
            "_orbit": "the orbit",
            "place_on_section": "the start",
        }
        for name in self.told:
            monkeypatch.setattr(confirmation, name, self._telling(name))

    def _telling(self, name: str) -> Any:
        def telling(*arguments: Any) -> Any:
            self.asked.append((name, arguments))
            return self.told[name]

        return telling

    def __call__(self, objective: Any = None, shape: EventSequence = TWICE, **changes: Any) -> Any:
        before = StartOutcome(status=SearchStatus.NOT_SOLVED, detail="before", iterations=7)
        search = _search(self.problem, **changes)
        values = self.problem.values(gains={"Kp": 3.0})
        return confirm(search, before, _unknowns(shape), values, objective, shape)


@pytest.fixture(name="confirmed")
def _confirmed(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> _Confirmed:
    return _Confirmed(problem, monkeypatch)


def test_a_solution_that_simulation_follows_is_an_orbit(
    confirmed: _Confirmed, problem: Problem
) -> None:
    confirmed.told["_difference"] = SearchSettings().agreement
    confirmed.told["_excesses"] = {}
    outcome = confirmed()
    assert (outcome.status, outcome.detail) == (SearchStatus.FOUND, "")
    assert (outcome.agreement, outcome.iterations) == (SearchSettings().agreement, 7)
    solution = outcome.solution
    values = problem.values(gains={"Kp": 3.0})
    assert (solution.values, solution.orbit, solution.excesses) == (values, "the orbit", {})
    assert solution.cycle is confirmed.told["one_cycle"]
    assert set(solution.unknowns) == set(_unknowns())
    asked = dict(confirmed.asked)
    machine, shape, start = asked["place_on_section"]
    assert (shape, start.tolist()) == (TWICE, _state(0).tolist())
    # Twice the period is long enough for one.
    assert asked["one_cycle"] == (machine, "the start", 16.0, TWICE)


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        (ONE_ZENO, "From its release the simulation reaches no Zeno point with a later release."),
        (TWICE, "The simulation from its start does not follow the shape `zeno*2`."),
    ],
)
def test_a_solution_without_a_period_is_not_followed(
    confirmed: _Confirmed, shape: EventSequence, words: str
) -> None:
    confirmed.told["one_cycle"] = None
    unknowns = {"period": np.array([[8.0]]), "release state": _state(0)[:, None]}
    before = StartOutcome(status=SearchStatus.NOT_SOLVED, detail="before", iterations=7)
    search = _search(confirmed.problem)
    told = unknowns if shape is ONE_ZENO else _unknowns()
    outcome = confirm(search, before, told, confirmed.problem.values(), None, shape)
    assert outcome == replace(before, status=SearchStatus.NOT_FOLLOWED, detail=words)


def test_a_solution_that_differs_or_passes_its_bounds_is_not_followed_and_kept(
    confirmed: _Confirmed,
) -> None:
    confirmed.told["_difference"] = 1.1 * SearchSettings().agreement
    outcome = confirmed()
    assert outcome.status is SearchStatus.NOT_FOLLOWED
    assert outcome.detail == "Solution and simulation differ by 3.3e-10."
    assert outcome.solution.orbit is None
    assert outcome.agreement == 1.1 * SearchSettings().agreement
    confirmed.told["_difference"] = 0.0
    confirmed.told["_excesses"] = {"theta1": 0.25, "dtheta1": 0.5, "current": 0.125}
    outcome = confirmed()
    assert outcome.status is SearchStatus.NOT_FOLLOWED
    assert outcome.detail == "Between its nodes `dtheta1` exceeds its bound by 5.0e-01."
    assert outcome.solution.excesses == confirmed.told["_excesses"]
    assert outcome.solution.orbit is None
    # What is no orbit at all is told first.
    for name in ("escape_of", "round_again"):
        confirmed.told[name] = f"{name}."
        assert confirmed().detail == f"{name}."
        confirmed.told["_difference"] = 1.0
        assert confirmed().detail == f"{name}."
    assert confirmed().agreement == 1.0


def test_a_target_has_to_be_met_by_the_simulation(confirmed: _Confirmed) -> None:
    outcome = confirmed(TargetPeriod(target=10.0))
    assert outcome.agreement == pytest.approx(0.2)
    assert outcome.status is SearchStatus.NOT_FOLLOWED
    confirmed.told["_difference"] = 0.5
    assert confirmed(TargetPeriod(target=10.0)).agreement == 0.5
    confirmed.told["_difference"] = 0.0
    assert confirmed(TargetPeriod(target=8.0)).status is SearchStatus.FOUND
    assert confirmed(MinEnergy()).agreement == 0.0


# Bounds between the nodes.


def test_bounds_of_signals_that_a_period_passes_are_told_with_the_largest_excess(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    ranges = {"theta1": (-1.0, 2.0), "current": (-3.0, 3.0)}

    class Told:
        def __init__(self, name: str) -> None:
            self.name = name

        def at(self, vector: Any) -> Any:
            assert vector == problem.values(gains={"Kp": 3.0}).vector
            return self.name

    def extent(name: str, arcs: Any) -> Any:
        assert arcs == ("an arc",)
        low, high = ranges[name]
        return confirmation.Extent(lowest=low, highest=high)

    monkeypatch.setattr(confirmation, "signal", lambda _, name: Told(name))
    monkeypatch.setattr(confirmation, "extent_of", extent)
    bounds = (
        Bound(name="period", upper=1.0),
        Bound(name="theta1", upper=1.5),
        Bound(name="theta1", lower=-0.25),
        Bound(name="theta1", upper=1.75),
        Bound(name="current", lower=-4.0, upper=3.0),
    )
    values = problem.values(gains={"Kp": 3.0})
    asked = _search(problem, bounds=bounds)
    assert confirmation._excesses(asked, values, _cycle()) == {"theta1": 0.75}
    # At fixed numbers nothing gives way.
    assert confirmation._excesses(replace(asked, free={}), values, _cycle()) == {}
    # Half of what a check allows, a billionth of the size, is passed without a word.
    for by, told in ((0.4e-9, {}), (0.6e-9, {"theta1": pytest.approx(1.2e-9, rel=1e-6)})):
        ranges["theta1"] = (-1.0, 2.0 * (1.0 + by))
        near = _search(problem, bounds=(Bound(name="theta1", upper=2.0),))
        assert confirmation._excesses(near, values, _cycle()) == told


def test_bounds_are_drawn_in_by_what_they_were_passed_by_while_something_is_left() -> None:
    bounds = (
        Bound(name="a", lower=-1.0, upper=2.0),
        Bound(name="b", upper=2.0),
        Bound(name="c", lower=0.0, upper=1.0),
        Bound(name="d", lower=0.0, upper=1.0),
        Bound(name="e", lower=0.0, upper=1.0),
    )
    excesses = {"a": 0.25, "b": 0.5, "c": 0.5, "d": 0.375}
    assert tightened(bounds, excesses) == (
        Bound(name="a", lower=-0.75, upper=1.75),
        Bound(name="b", upper=1.5),
        bounds[2],
        Bound(name="d", lower=0.375, upper=0.625),
        bounds[4],
    )


# The orbit, and its simulation.


@pytest.mark.parametrize("shape", [TWICE, STRUCK])
def test_the_orbit_of_a_solution_has_its_phases_with_times_since_its_start(
    problem: Problem, shape: EventSequence
) -> None:
    values = problem.values(gains={"Kp": 3.0})
    orbit = confirmation._orbit(_search(problem), _unknowns(shape), values, shape)
    names, machine = problem.state_names, problem.dynamics(values)

    def named(state: Any) -> dict[str, float]:
        return dict(zip(names, map(float, state), strict=True))

    assert (orbit.problem, orbit.gains["Kp"], orbit.period) == (problem.name, 3.0, 8.0)
    assert orbit.shape == shape
    for k, phase in enumerate(orbit.phases):
        assert phase.start_time == 4.0 * k
        before = EventSequence(phases=shape.phases[:1])
        assert phase.start_state == named(place_on_section(machine, before, _state(10 * k)))
        count = 2 if shape is TWICE else 1
        assert [one.time for one in phase.impacts] == [4.0 * k + 1.0, 4.0 * k + 1.5][:count]
        assert [one.state_minus for one in phase.impacts] == [
            named(_state(10 * k + 1)),
            named(_state(10 * k + 2)),
        ][:count]
        if shape is STRUCK:
            assert (phase.zeno_time, phase.zeno_state) == (None, None)
            continue
        assert phase.zeno_time == 4.0 * k + 2.0
        assert phase.zeno_state == named(machine.on_stop(_state(10 * k + 3)))


def test_a_phase_starts_where_the_one_before_it_ends(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Any] = []

    def kept(_: Any, before: EventSequence, state: Any) -> Any:
        asked.append((before.phases, state.tolist()))
        return state

    shape = EventSequence.parsed("impact,plastic")
    monkeypatch.setattr(confirmation, "place_on_section", kept)
    unknowns = _unknowns(shape)
    unknowns["phase 1: release state"] = unknowns.pop("phase 1: start state")
    unknowns["phase 2: start state"] = unknowns.pop("phase 2: release state")
    confirmation._orbit(_search(problem), unknowns, problem.values(), shape)
    assert asked == [
        ((PhaseKind.PLASTIC,), _state(0).tolist()),
        ((PhaseKind.IMPACT,), _state(10).tolist()),
    ]


def test_a_period_is_simulated_at_full_accuracy_or_is_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[Any] = []
    machine: Any = SimpleNamespace()

    def simulated(*arguments: Any, **named: Any) -> Any:
        asked.append((*arguments, named))
        return "a period"

    monkeypatch.setattr(confirmation, "cycle_of", simulated)
    start = _state(0)
    assert one_cycle(machine, start, 3.0) == "a period"
    named = {"horizon": 3.0, "settings": SimulationSettings()}
    assert asked == [(machine, start, ONE_ZENO, named)]
    assert one_cycle(machine, start, 3.0, TWICE) == "a period"
    assert asked[1] == (machine, start, TWICE, named)

    def fails(*_: Any, **__: Any) -> Any:
        raise SimulationError("It fails", time=1.0, state=(1.0,))

    monkeypatch.setattr(confirmation, "cycle_of", fails)
    assert one_cycle(machine, start, 3.0) is None
