"""Periods cut out of an execution."""

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
from zeno_orbits.orbits.cycle import Cycle, cycles
from zeno_orbits.simulation.execution import Ending, Execution, Mode
from zeno_orbits.simulation.simulator import simulate

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
    assert len(turn.impacts) == len(turn.rescaled_flights) + 1
    for hop, impact in zip(turn.rescaled_flights, turn.impacts[1:], strict=True):
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
