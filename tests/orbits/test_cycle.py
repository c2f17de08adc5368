"""Periods cut out of an execution, and the fewest impacts that tell their Zeno point."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from tests.reference.closed_forms import FORCED
from tests.reference.reference_orbit import PERIOD, RELEASE
from tests.support.mechanisms import forced_oscillator, oscillator_state
from zeno_orbits.model.library import load_problem
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.model.problem import Problem
from zeno_orbits.orbits.cycle import Cycle, closure_of, cycles
from zeno_orbits.simulation.execution import Ending, Execution, Mode
from zeno_orbits.simulation.simulator import simulate
from zeno_orbits.simulation.zeno_limit import estimate_tail, extrapolate

ACCURACY = 1e-11
TURN = 2 * math.pi


@pytest.fixture(name="oscillator", scope="module")
def _oscillator() -> HybridDynamics:
    return forced_oscillator(FORCED, FORCED.restitution)


@pytest.fixture(name="turns", scope="module")
def _turns(oscillator: HybridDynamics) -> Execution:
    return simulate(oscillator, oscillator_state(0.0, FORCED.stop, 0.0), until=3.5 * TURN)


@pytest.fixture(name="turn", scope="module")
def _turn(turns: Execution) -> Cycle:
    return cycles(turns)[0]


def test_periods_run_from_release_to_release(turns: Execution) -> None:
    found = cycles(turns)
    assert len(turns.releases) == 4
    assert len(found) == 3
    for cycle in found:
        assert cycle.period == pytest.approx(TURN, abs=ACCURACY)
        assert cycle.drift(cycle.scale()) < ACCURACY
    for early, late in pairwise(found):
        assert early.end is late.start


def test_a_period_has_one_flight_its_hops_and_one_locked_arc(turn: Cycle) -> None:
    assert turn.flight.start_time == turn.start.time
    assert turn.flight.end_time == turn.impacts[0].time
    assert len(turn.impacts) == len(turn.hops) + 1
    for hop, impact in zip(turn.hops, turn.impacts[1:], strict=True):
        assert hop.end_time == impact.time
        assert hop.ending is Ending.IMPACT
    assert turn.locked.mode is Mode.LOCKED
    assert turn.locked.start_time == turn.zeno.time
    assert turn.locked.end_time == turn.end.time
    assert turn.zeno.time == pytest.approx(FORCED.zeno_time(), abs=ACCURACY)


def test_what_comes_before_the_first_release_is_no_period(oscillator: HybridDynamics) -> None:
    run = simulate(oscillator, oscillator_state(0.0, FORCED.stop, 0.0), until=TURN)
    assert len(run.releases) == 1
    assert cycles(run) == []


def test_a_start_at_a_release_begins_the_first_period(oscillator: HybridDynamics) -> None:
    start = np.array(oscillator_state(FORCED.release_time, FORCED.stop, 0.0))
    run = simulate(oscillator, start, until=1.1 * TURN)
    assert cycles(run) == []
    (cycle,) = cycles(run, start=start)
    assert cycle.start.time == 0.0
    assert cycle.period == pytest.approx(TURN, abs=ACCURACY)


def test_a_start_that_a_rounding_error_locks_is_one_release(oscillator: HybridDynamics) -> None:
    start = np.array(oscillator_state(FORCED.release_time - 1e-11, FORCED.stop, 0.0))
    run = simulate(oscillator, start, until=1.1 * TURN)
    assert run.releases[0].time < 1e-10
    (cycle,) = cycles(run, start=start)
    assert cycle.period == pytest.approx(TURN, abs=1e-10)


def test_a_ball_that_rests_for_good_has_no_period() -> None:
    problem = load_problem("bouncing_ball")
    ball = problem.dynamics(problem.values())
    assert cycles(simulate(ball, (1.0, 0.0), until=20.0)) == []


def test_the_scale_is_the_size_over_the_period_and_never_zero(turn: Cycle) -> None:
    # x swings from its stop at -0.8 down and back, y and dy are cos t and -sin t.
    scale = turn.scale()
    assert np.all(scale > 0)
    assert scale[1:2] == pytest.approx([1.0], abs=0.05)
    assert scale[3:] == pytest.approx([1.0], abs=0.05)
    assert scale[0] >= 0.8


def test_the_declared_release_starts_a_period_that_closes(machine: HybridDynamics) -> None:
    start = np.array(RELEASE)
    (cycle,) = cycles(simulate(machine, start, until=1.5 * PERIOD), start=start)
    assert cycle.period == pytest.approx(PERIOD, abs=1e-10)
    assert cycle.drift(cycle.scale()) < 1e-10


# Closure.


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
    assert cycle.hops == ()
    closure = closure_of(cycle.impacts, plastic, 1e-12)
    assert closure.n_impacts == 1
    assert closure.nodes == (0,)
    assert closure.error == 0.0
