"""Periods cut out of an execution."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tests.reference.closed_forms import FORCED
from tests.reference.reference_orbit import PERIOD, RELEASE
from tests.support.mechanisms import forced_oscillator, oscillator_state
from zeno_orbits.model.library import load_problem
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.orbits.cycle import Cycle, cycle_between, cycles, gone_round_twice, round_again
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


def test_the_scale_counts_what_is_largest_on_the_locked_arc() -> None:
    table = load_problem("vibrating_table")
    (turn, *_) = cycles(simulate(table.dynamics(table.values()), (0.0, 0.0, 0.0, 1.0), until=1.0))
    (phase,) = turn.phases
    # The cosine of the clock passes through -1 in the flight, too: a short hop stands for it here.
    short = replace(turn, phases=(replace(phase, flight=turn.rescaled_flights[-1]),))
    times = np.linspace(turn.locked.start_time, turn.locked.end_time, 101)
    inside = max(abs(turn.locked.state_at(t)[2]) for t in times)
    assert inside > 1.4 * turn.scale_at_events()[2]
    assert short.scale()[2] == pytest.approx(inside, rel=0.01)


def test_a_period_gone_round_twice_is_told_by_the_state_half_way(turns: Execution) -> None:
    first, second, _ = cycles(turns)
    assert gone_round_twice(first) is None
    twice = cycle_between(turns, (*first.phases, *second.phases))
    assert twice.shorter_periods(twice.scale()) == {first.shape: 0.0}
    assert gone_round_twice(twice) == first.shape
    text, once = twice.shape.text, first.shape.text
    assert (
        round_again(twice)
        == f"The orbit of shape `{text}` is one of shape `{once}`, traversed 2 times."
    )


def test_two_unlike_returns_are_no_period_gone_round_twice(machine: HybridDynamics) -> None:
    start = machine.on_stop(np.array(RELEASE) * 1.05)
    run = simulate(machine, start, until=4 * PERIOD)
    first, second = cycles(run)[:2]
    twice = cycle_between(run, (*first.phases, *second.phases))
    scale = twice.scale()
    off = np.abs(second.start.state - first.start.state) / scale
    assert np.min(off) < np.max(off)
    assert twice.shorter_periods(scale) == {first.shape: np.max(off)}
    assert gone_round_twice(twice) is None
    assert round_again(twice) == ""


@pytest.mark.parametrize("missing", ["zeno", "locked"])
def test_a_period_without_a_zeno_point_or_its_locked_arc_has_neither(
    turn: Cycle, missing: str
) -> None:
    (phase,) = turn.phases
    without = replace(turn, phases=(replace(phase, **{missing: None}),))
    for name in ("zeno", "locked"):
        with pytest.raises(ValueError, match="a Zeno point where the stop holds"):
            getattr(without, name)


def test_the_declared_release_starts_a_period_that_closes(machine: HybridDynamics) -> None:
    start = np.array(RELEASE)
    (cycle,) = cycles(simulate(machine, start, until=1.5 * PERIOD), start=start)
    assert cycle.period == pytest.approx(PERIOD, abs=1e-10)
    assert cycle.drift(cycle.scale()) < 1e-10
