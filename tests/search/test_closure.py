"""The fewest impacts that tell a Zeno point."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.reference.closed_forms import FORCED
from tests.reference.reference_orbit import RELEASE
from tests.support.mechanisms import forced_oscillator, oscillator_state
from zeno_orbits.model import HybridDynamics, Problem
from zeno_orbits.orbits import Cycle, cycles
from zeno_orbits.search.transcription import closure as closure_module
from zeno_orbits.search.transcription.closure import Closure, closure_of, closures_of
from zeno_orbits.simulation import estimate_tail, extrapolate, simulate

ACCURACY = 1e-11


@pytest.fixture(name="oscillator", scope="module")
def _oscillator() -> HybridDynamics:
    return forced_oscillator(FORCED, FORCED.restitution)


@pytest.fixture(name="turn", scope="module")
def _turn(oscillator: HybridDynamics) -> Cycle:
    start = oscillator_state(0.0, FORCED.stop, 0.0)
    return cycles(simulate(oscillator, start, until=2.5 * math.tau))[0]


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5, 1e-7, 1e-9, 1e-11])
def test_a_closure_has_the_fewest_impacts_for_its_tolerance(
    oscillator: HybridDynamics, turn: Cycle, tolerance: float
) -> None:
    closure = closure_of(turn.impacts, oscillator, tolerance)
    assert closure.error <= tolerance
    for n in range(1, closure.n_impacts):
        fewer = closure_of(turn.impacts[:n], oscillator, tolerance)
        assert fewer.error > tolerance
    assert closure.nodes[-1] == closure.n_impacts - 1
    assert list(closure.nodes) == sorted(set(closure.nodes))


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-6, 1e-8, 1e-10])
def test_the_error_of_a_closure_bounds_the_true_one(
    oscillator: HybridDynamics, turn: Cycle, tolerance: float
) -> None:
    closure = closure_of(turn.impacts, oscillator, tolerance)
    estimates = []
    for k in closure.nodes:
        impact = turn.impacts[k]
        speed = -oscillator.restitution * impact.approach_rate
        estimate = estimate_tail(oscillator, impact.time, impact.state_plus, speed)
        assert estimate is not None
        estimates.append(estimate)
    limit = extrapolate(oscillator, estimates)
    exact = FORCED.zeno_time()
    assert abs(limit.time - exact) <= closure.error * (1 + exact) + ACCURACY
    point = np.array(oscillator_state(exact, FORCED.stop, 0.0))
    assert np.all(np.abs(limit.state - point) <= closure.error * (1 + np.abs(point)) + ACCURACY)


def test_a_tolerance_that_nothing_reaches_takes_all_impacts(
    oscillator: HybridDynamics, turn: Cycle
) -> None:
    closure = closure_of(turn.impacts, oscillator, 0.0)
    assert closure.n_impacts == len(turn.impacts)


def test_a_plastic_impact_closes_alone(problem: Problem) -> None:
    values = problem.values(parameters={"restitution": 0.0})
    plastic = problem.dynamics(values)
    run = simulate(plastic, RELEASE, until=6.0)
    cycle = cycles(run)[-1]
    assert cycle.rescaled_flights == ()
    closure = closure_of(cycle.impacts, plastic, 1e-12)
    assert closure.n_impacts == 1
    assert closure.nodes == (0,)
    assert closure.error == 0.0


# Which impacts are taken, told by estimates that are given.

E = 0.5


def _closure(
    monkeypatch: pytest.MonkeyPatch,
    speeds: list[float],
    errors: dict[int, float],
    tolerance: float = 1e-3,
    unusable: tuple[int, ...] = (),
) -> Closure:
    """Return the closure of impacts with given speeds after them, and errors by their number."""
    impacts: Any = [
        SimpleNamespace(time=float(k), state_plus=k, approach_rate=-speed / E)
        for k, speed in enumerate(speeds)
    ]

    def estimate(_dynamics: Any, time: float, state: int, speed: float) -> Any:
        assert time == state
        assert speed == pytest.approx(speeds[state])
        return None if state in unusable else SimpleNamespace(speed=speed, place=state)

    def limit(_dynamics: Any, estimates: list[Any]) -> Any:
        # Estimates are those of impacts that follow each other.
        places = [one.place for one in estimates]
        assert places == list(range(places[0], places[0] + len(places)))
        return SimpleNamespace(error=errors.get(len(places), 1.0))

    monkeypatch.setattr(closure_module, "estimate_tail", estimate)
    monkeypatch.setattr(closure_module, "extrapolate", limit)
    monkeypatch.setattr(closure_module, "spread_nodes", lambda found: tuple(range(len(found))))
    dynamics: Any = SimpleNamespace(speed_after=lambda rate: -E * rate)
    return closure_of(impacts, dynamics, tolerance)


def test_impacts_are_taken_until_the_error_is_the_tolerance(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    speeds = [8.0, 4.0, 2.0, 1.0, 0.5]
    found = _closure(monkeypatch, speeds, {1: 1.0, 2: 0.1, 3: 1e-3, 4: 1e-9})
    assert found == Closure(n_impacts=3, nodes=(0, 1, 2), error=1e-3)


@pytest.mark.parametrize("third", [3.0, 4.0, 5.0])
def test_impacts_count_anew_where_speeds_do_not_fall(
    monkeypatch: pytest.MonkeyPatch, third: float
) -> None:
    found = _closure(monkeypatch, [8.0, 4.0, third, 2.0, 1.0], {3: 1e-4})
    if third < 4.0:
        assert found == Closure(n_impacts=3, nodes=(0, 1, 2), error=1e-4)
    else:
        assert found == Closure(n_impacts=5, nodes=(2, 3, 4), error=1e-4)


def test_impacts_count_anew_after_one_from_which_no_tail_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    speeds = [8.0, 4.0, 2.0, 1.0, 0.5, 0.25]
    found = _closure(monkeypatch, speeds, {3: 1e-4}, unusable=(0, 2))
    assert found == Closure(n_impacts=6, nodes=(3, 4, 5), error=1e-4)


def test_without_any_tail_the_first_impact_closes_and_nothing_is_known_of_its_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = _closure(monkeypatch, [2.0, 1.0], {}, unusable=(0, 1))
    assert found == Closure(n_impacts=1, nodes=(0,), error=math.inf)


def test_each_phase_has_its_closure_and_an_impact_that_does_not_hold_closes_exactly(
    oscillator: HybridDynamics, turn: Cycle
) -> None:
    (held,) = turn.phases
    let_go = replace(held, zeno=None, locked=None)
    cycle: Any = SimpleNamespace(phases=(held, let_go, held))
    expected = closure_of(turn.impacts, oscillator, 1e-7)
    alone = Closure(n_impacts=1, nodes=(), error=0.0)
    assert closures_of(cycle, oscillator, 1e-7) == (expected, alone, expected)
