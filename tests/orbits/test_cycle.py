"""Periods cut out of an execution."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tests.reference.closed_forms import FORCED
from tests.reference.reference_orbit import PERIOD, RELEASE
from tests.support.executions import at, execution_of
from tests.support.mechanisms import forced_oscillator, oscillator_state
from zeno_orbits.model import HybridDynamics, load_problem
from zeno_orbits.orbits import (
    ONE_ZENO,
    Cycle,
    EventSequence,
    Moment,
    cycle_between,
    cycles,
    first_cycles,
    phases_of,
)
from zeno_orbits.simulation import Ending, Execution, Mode, simulate

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


@pytest.mark.parametrize("missing", ["zeno", "locked"])
def test_a_period_without_a_zeno_point_or_its_locked_arc_has_neither(
    turn: Cycle, missing: str
) -> None:
    (phase,) = turn.phases
    without = replace(turn, phases=(replace(phase, **{missing: None}),))
    for name in ("zeno", "locked"):
        with pytest.raises(ValueError, match="a Zeno point with a contact phase"):
            getattr(without, name)


def test_the_declared_release_starts_a_period_that_closes(machine: HybridDynamics) -> None:
    start = np.array(RELEASE)
    (cycle,) = cycles(simulate(machine, start, until=1.5 * PERIOD), start=start)
    assert cycle.period == pytest.approx(PERIOD, abs=1e-10)
    assert cycle.drift(cycle.scale()) < 1e-10


# Executions made by hand.

START = at(0.0, 1.0)
RETURNS = tuple(
    (letter, end + time)
    for time in (0.0, 3.0, 6.0, 9.0)
    for letter, end in (("i", 1.0), ("i", 1.5), ("z", 2.0), ("r", 3.0))
)
"""Four returns of 3 s each."""


def test_a_cycle_holds_the_arcs_after_its_start_and_the_events_up_to_its_end() -> None:
    run = execution_of(*RETURNS)
    phases = phases_of(run, START)
    cut = cycle_between(run, phases[1:3])
    assert (cut.start.time, cut.end.time, cut.period) == (3.0, 9.0, 6.0)
    # Tails are arcs of the execution and none of the phases.
    assert cut.execution.arcs == run.arcs[4:12]
    assert cut.arcs == (*run.arcs[4:6], *run.arcs[7:10], run.arcs[11])
    assert cut.execution.events == run.events[4:12]
    assert cut.impacts == run.impacts[2:6]
    assert cut.zeno_points == run.zeno_points[1:3]
    assert cut.flight is run.arcs[4]
    assert cut.rescaled_flights == (run.arcs[5], run.arcs[9])
    assert (cut.state_names, cut.execution.own) == (("time", "side"), run.own)
    assert cut.shape.text == "zeno*2"
    earlier = cycle_between(run, phases[1:2], since=1.5).execution
    assert earlier.arcs == run.arcs[2:8]
    assert earlier.events == run.events[2:8]


def test_returns_end_where_the_stop_lets_go_and_no_fall_before_is_one() -> None:
    run = execution_of(("i", 1.0), ("p", 2.0), ("r", 3.0), ("p", 4.0), ("r", 5.0), ("i", 6.0))
    found = cycles(run, start=START)
    assert [cycle.shape.text for cycle in found] == ["impact,plastic", "plastic"]
    assert [cycle.start.time for cycle in found] == [0.0, 3.0]


def test_periods_follow_each_other_from_the_start_on() -> None:
    run, twice = execution_of(*RETURNS), EventSequence.parsed("zeno*2")
    assert [c.start.time for c in first_cycles(run, START, ONE_ZENO)] == [0.0, 3.0, 6.0, 9.0]
    assert [c.start.time for c in first_cycles(run, START, twice)] == [0.0, 6.0]
    thrice = EventSequence.parsed("zeno*3")
    assert [(c.start.time, c.end.time) for c in first_cycles(run, START, thrice)] == [(0.0, 9.0)]
    assert first_cycles(run, START, EventSequence.parsed("plastic")) == ()
    assert first_cycles(run, START, EventSequence.parsed("zeno*5")) == ()


def test_periods_end_where_a_return_between_them_is_none() -> None:
    # The stop is touched in the second return: the first and the third do not follow each other.
    touched = [("t", 4.0) if leg == ("i", 4.0) else leg for leg in RETURNS]
    run = execution_of(*touched)
    assert len(phases_of(run, START)) == 3
    (only,) = first_cycles(run, START, ONE_ZENO)
    assert (only.start.time, only.end.time) == (0.0, 3.0)
    assert first_cycles(run, START, EventSequence.parsed("zeno*2")) == ()
    # Touched in the first one: there is nothing to begin with.
    run = execution_of(("t", 1.0), *RETURNS[1:])
    assert first_cycles(run, START, ONE_ZENO) == ()
    assert first_cycles(execution_of(("f", 1.0)), START, ONE_ZENO) == ()
    assert first_cycles(execution_of(("l", 1.0)), START, ONE_ZENO) == ()


def test_a_start_that_is_locked_belongs_to_the_first_period_alone() -> None:
    locked = (("r", 0.5), *((letter, end + 0.5) for letter, end in RETURNS))
    run = execution_of(*locked)
    first, second, *_ = first_cycles(run, START, ONE_ZENO)
    assert (first.start.time, first.execution.arcs) == (0.5, run.arcs[:5])
    assert first.execution.events == run.events[:5]
    assert second.execution.arcs == run.arcs[5:9]


def _with_states(cycle: Cycle, states: list[np.ndarray]) -> Cycle:
    """Return a cycle of one phase with other states at start, end, Zeno point and one impact."""
    (phase,) = cycle.phases
    start, end, zeno, minus, plus, flying, held = states
    assert phase.zeno is not None
    assert phase.locked is not None
    changed = replace(
        phase,
        start=Moment(time=0.0, state=start),
        end=Moment(time=3.0, state=end),
        zeno=replace(phase.zeno, state=zeno),
        impacts=(replace(phase.impacts[0], state_minus=minus, state_plus=plus),),
        flight=replace(phase.flight, start_state=start, end_state=flying),
        locked=replace(phase.locked, start_state=held, end_state=end),
    )
    names = tuple("abcdefgh")
    return replace(cycle, phases=(changed,), execution=replace(cycle.execution, state_names=names))


def test_the_size_of_a_state_is_the_largest_at_any_event_or_where_the_flow_is_followed() -> None:
    run = execution_of(("i", 1.0), ("z", 2.0), ("r", 3.0))
    (cycle,) = cycles(run, start=START)
    # Each of the seven places has the largest of one state; the last state vanishes.
    states = [np.full(8, 0.01 * (-1) ** k) for k in range(7)]
    for k, state in enumerate(states):
        state[k], state[7] = -(k + 2) / 4, 0.0
    spread = _with_states(cycle, states)
    assert spread.scale().tolist() == [0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 1.0]
    # At events nothing is known of the two inside, and what vanishes is given the largest size.
    assert spread.scale_at_events().tolist() == [0.5, 0.75, 1.0, 1.25, 1.5, 0.01, 0.01, 1.5]


def test_a_state_at_events_vanishes_below_a_billionth_of_the_largest() -> None:
    run = execution_of(("i", 1.0), ("z", 2.0), ("r", 3.0))
    (cycle,) = cycles(run, start=START)
    states = [np.array([2.0, 3e-9, 1.9e-9, *5 * [1.0]])] * 7
    assert _with_states(cycle, states).scale_at_events()[:3].tolist() == [2.0, 3e-9, 2.0]


def test_a_drift_is_the_largest_change_in_units_of_the_scale() -> None:
    run = execution_of(("i", 1.0), ("z", 2.0), ("r", 3.0))
    (cycle,) = cycles(run, start=START)
    (phase,) = cycle.phases
    moved = replace(phase, end=Moment(time=3.0, state=np.array([0.5, -2.0])))
    # The changes are 0.5 and -3.
    cycle = replace(cycle, phases=(moved,))
    assert cycle.drift(np.array([1.0, 4.0])) == 0.75
    assert cycle.drift(np.array([0.25, 4.0])) == 2.0
