"""Transitions of lanes at single events, on a table whose accelerations are plain numbers."""

import math

import numpy as np
import pytest

from zeno_orbits.model import USUAL, OwnScale
from zeno_orbits.model.library import load_problem
from zeno_orbits.simulation.batch.lanes import FLIGHT, FREE, LOCKED, empty_lanes
from zeno_orbits.simulation.batch.model import model_in_rows
from zeno_orbits.simulation.batch.outcomes import Ended, Reason, Released, Struck
from zeno_orbits.simulation.batch.rules import BatchSettings, Transitions

TABLE = load_problem("vibrating_table")
SLACK = math.sqrt(0.75)
"""Cosine of the clock where the table neither holds the ball nor throws it: its sine is a half."""
OWN = OwnScale(time=3.0, gap=2.0, gap_rate=4.0, gap_acceleration=8.0)


def table(n, *, restitution=0.5, own=USUAL, until=100.0, **settings):
    """Transitions of n lanes that run: the gap's acceleration is 4 sine - 2 [m/s^2]."""
    numbers = {"m": 2.0, "A": 1.0, "omega": 2.0, "g": 2.0, "restitution": restitution}
    model = model_in_rows(TABLE, own)
    lanes = empty_lanes(n, model.n_x, model.n_q, model.n_p)
    lanes.alive[:], lanes.mode[:], lanes.free_slots = True, 7, []
    lanes.p[:, :-1] = TABLE.values(parameters=numbers).vector
    lanes.tolerance[:], lanes.until[:], lanes.restitution[:] = 1e-9, until, restitution
    transitions = Transitions(model, lanes, BatchSettings(**settings))
    transitions.forget(np.arange(n))
    return transitions, lanes


def rows(*numbers):
    return np.array(numbers, dtype=np.intp)


def at(*states):
    return np.array(states, dtype=float)


UP, DOWN = (1.0, 0.0), (-1.0, 0.0)
"""Phases of the clock, cosine and sine: the table holds with 2 m/s^2 in both."""


def test_a_leg_begins_with_its_guard_its_rates_and_a_first_step():
    transitions, lanes = table(3, own=OWN)
    lanes.offset[:], lanes.largest[:], lanes.refused[:] = 7.0, 7.0, True
    lanes.largest_rate[2] = [1.0, 50.0, 0.0, 0.0]
    y = at((2.0, -3.0, *UP), (-2.0, 50.0, *DOWN))
    time, unit = at(1.5, 2.5), np.ones(2)
    transitions.begin(rows(2, 0), FREE, time, y, unit, on_guard=False)
    assert lanes.mode[[2, 0]].tolist() == [FREE, FREE]
    assert lanes.leg_time.tolist() == [2.5, 0.0, 1.5]
    assert lanes.y[[2, 0], :4].tolist() == y.tolist()
    assert lanes.offset.tolist() == lanes.largest.tolist() == [0.0, 7.0, 0.0]
    assert lanes.on_guard.tolist() == [False, False, False]
    assert lanes.refused.tolist() == [False, True, False]
    assert lanes.guard[[2, 0]] == pytest.approx(at((2.0, -3.0), (-2.0, 50.0)))
    # Rates (-3, -2, 0, 2), or (50, -2, 0, -2), beside 0.1 of the smallest size and the states.
    assert lanes.size[[2, 0]] == pytest.approx([0.01 * 0.1 / 2.0, 0.01 * 2.1 / 50.0])
    assert lanes.largest_rate[2] == pytest.approx([3.0, 50.0, 0.0, 2.0])
    assert lanes.largest_rate[0] == pytest.approx([50.0, 2.0, 0.0, 2.0])
    assert not transitions.events


def test_a_flight_is_counted_in_its_own_time():
    transitions, lanes = table(2)
    speed = at(0.5, 0.25)
    transitions._launch(rows(1, 0), at(3.0, 4.0), at((0, 0.5, *UP), (0, 0.25, *UP)), speed)
    assert lanes.mode.tolist() == [FLIGHT] * 2
    assert lanes.unit[[1, 0]].tolist() == lanes.p[[1, 0], -1].tolist() == speed.tolist()
    assert lanes.leg_time.tolist() == [4.0, 3.0]
    assert lanes.y[:, 4:].tolist() == [[0.0, 1.0]] * 2
    assert lanes.on_guard.all()
    # In its own time the height rises by the square of its speed, the sine by 2 for every speed.
    for k, w in enumerate((0.25, 0.5)):
        own = np.array([w * w, 2 * w, 0.0, 2 * w, 1.0, 2.0])
        assert lanes.largest_rate[k] == pytest.approx(own[:4] / w)
        size = 0.01 / np.max(own / (0.1 + np.array([0.0, w, 1.0, 0.0, 0.0, 1.0])))
        assert lanes.size[k] == pytest.approx(size)
    assert transitions.numbers(FLIGHT, rows(0)).tolist() == [[2.0, 1.0, 2.0, 2.0, 0.5, 0.25]]
    assert transitions.numbers(LOCKED, rows(0)).tolist() == [[2.0, 1.0, 2.0, 2.0, 0.5]]


def test_a_flow_that_hardly_moves_begins_with_a_thousandth_of_the_problems_time():
    transitions, lanes = table(3, own=OWN)
    lanes.p[:, 2] = 1e-7, 1e-4, 1e-6
    lanes.p[:, 3] = 0.0
    y, unit = at(*[(0.0, 0.0, *UP)] * 3), at(0.5, 1.0, 1.0)
    transitions.begin(np.arange(3), LOCKED, np.zeros(3), y, unit, on_guard=False)
    # The sine's rate over 0.1: it changes by 6e-6 in a time of 3 or 6, or by more than 1e-5.
    assert lanes.size == pytest.approx([6e-3, 0.01 * 0.1 / 1e-4, 0.01 * 0.1 / 1e-6])


def test_a_follower_takes_the_first_step_of_its_leader():
    transitions, lanes = table(3)
    lanes.leader[:] = [1, 1, 2]
    y = at((1.0, 50.0, *UP), (1.0, 100.0, *UP), (1.0, 0.0, *UP))
    transitions.begin(rows(2, 0, 1), FREE, np.zeros(3), y, np.ones(3), on_guard=False)
    # The sine's rate over 0.1, and a speed over 1.1.
    assert lanes.size == pytest.approx([0.01 / 20.0, 0.01 / 20.0, 0.01 / (50.0 / 1.1)])


def test_a_leg_whose_flow_is_not_finite_fails_alone():
    transitions, lanes = table(2)
    y = at((1.0, math.inf, *UP), (1.0, 0.0, *UP))
    transitions.begin(rows(0, 1), FREE, at(2.0, 3.0), y, np.ones(2), on_guard=False)
    (end,) = transitions.events
    assert isinstance(end, Ended)
    assert (end.lane, end.time, end.reason) == (0, 2.0, Reason.FAILURE)
    assert "not finite" in end.detail
    assert lanes.alive.tolist() == [False, True]
    assert lanes.free_slots == [0]


def test_starts_are_told_apart_by_the_problems_own_sizes():
    # A gap counts as zero below 2e-3 and a gap rate below 4e-3.
    transitions, lanes = table(8, own=OWN, contact=1e-3)
    starts = [
        (2.1e-3, 5.0),
        (2.0e-3, 4.1e-3),
        (2.0e-3, -4.1e-3),
        (2.0e-3, 4.0e-3),
        (-2.0e-3, -4.0e-3),
        (-2.1e-3, 0.0),
        (1.0, 0.0),
        (0.0, 0.0),
    ]
    transitions.admit(np.arange(8), at(*((*start, *UP) for start in starts)))
    modes = [FREE, FLIGHT, FLIGHT, LOCKED, LOCKED, None, FREE, LOCKED]
    known = [k for k, mode in enumerate(modes) if mode is not None]
    assert lanes.alive.tolist() == [mode is not None for mode in modes]
    assert lanes.mode[known].tolist() == [modes[k] for k in known]
    assert lanes.on_guard[known].tolist() == [False, True, True, False, False, False, False]
    struck = [event for event in transitions.events if isinstance(event, Struck)]
    assert [(event.lane, event.rate) for event in struck] == [(2, -4.1e-3)]
    assert lanes.p[[1, 2], -1] == pytest.approx([4.1e-3, 0.5 * 4.1e-3])
    assert lanes.leg_time.tolist() == [0.0] * 8
    assert lanes.unit[[0, 3, 6]].tolist() == [1.0] * 3
    (end,) = [event for event in transitions.events if isinstance(event, Ended)]
    assert (end.lane, end.reason) == (5, Reason.FAILURE)
    assert end.state[:2].tolist() == [-2.1e-3, 0.0]


def test_a_start_without_a_restitution_below_one_fails_wherever_it_is():
    transitions, lanes = table(4)
    lanes.restitution[:] = [1.0, -1e-9, 0.0, math.nan]
    transitions.admit(np.arange(4), at(*[(1.0, 0.0, *UP)] * 4))
    ends = [event for event in transitions.events if isinstance(event, Ended)]
    assert [end.lane for end in ends] == [0, 1, 3]
    assert all("restitution" in end.detail for end in ends)
    assert lanes.alive.tolist() == [False, False, True, False]


def test_a_motion_goes_on_from_a_release_or_in_its_sequence():
    transitions, lanes = table(3, own=OWN, contact=1e-3)
    x = at((0.0, 4.0e-3, *UP), (0.0, 4.1e-3, *UP), (0.0, 3.0, *DOWN))
    transitions.resume(np.arange(3), x)
    assert lanes.mode.tolist() == [FREE, FLIGHT, FLIGHT]
    assert lanes.on_guard.tolist() == [True] * 3
    assert lanes.leg_time.tolist() == [0.0] * 3
    assert lanes.unit.tolist() == [1.0, 4.1e-3, 3.0]
    # The impact that each comes from begins the sequence.
    tails = transitions._tails
    assert tails.last_speed(np.arange(3)).tolist() == [math.inf, 4.1e-3, 3.0]
    time, state, _ = tails.limits(rows(2), rows(2))
    # 2 w / (2 m/s^2 (1 - e)) after it the clock has turned on as if along its tangent.
    assert time == pytest.approx([6.0])
    assert state[0] == pytest.approx([0.0, 0.0, -1.0, -2.0 * 6.0])
    assert not transitions.events


def test_followers_go_on_as_their_leader_does():
    transitions, lanes = table(4)
    lanes.leader[:] = [0, 0, 2, 2]
    x = at((0.0, 0.0, *UP), (0.0, 1e-6, *UP), (0.0, 1e-6, *UP), (0.0, 1e-13, *UP))
    transitions.resume(np.arange(4), x)
    assert lanes.mode.tolist() == [FREE, FREE, FLIGHT, FLIGHT]


def test_a_release_is_told_with_all_that_went_before_it():
    transitions, lanes = table(3)
    lanes.impacts[:], lanes.struck[:] = [4, 5, 6], [-1.0, -2.0, -3.0]
    lanes.zeno_time[:], lanes.zeno_acceleration[:] = [0.1, 0.2, 0.3], [-7.0, -8.0, -9.0]
    y = at((1e-9, 1e-8, SLACK, 0.5), (0.0, 0.0, *UP))
    guard = np.zeros((2, 2))
    tails = transitions._tails
    tails.append(np.arange(3), np.ones(3), np.ones(3), np.zeros((3, 4)))
    transitions.arrive(LOCKED, rows(2, 1), at(1.5, 2.5), y, guard)
    last, first = transitions.events
    assert isinstance(last, Released)
    assert isinstance(first, Released)
    assert (last.lane, last.time, last.impacts, last.struck) == (2, 1.5, 6, -3.0)
    assert (last.zeno_time, last.zeno_acceleration) == (0.3, -9.0)
    assert (first.lane, first.time, first.impacts, first.struck) == (1, 2.5, 5, -2.0)
    # On the stop, exactly.
    assert last.state == pytest.approx([0.0, 0.0, SLACK, 0.5], abs=1e-30)
    assert lanes.mode[1:].tolist() == [FREE, FREE]
    assert lanes.on_guard[1:].tolist() == [True, True]
    assert lanes.leg_time[1:].tolist() == [2.5, 1.5]
    assert lanes.unit[1:].tolist() == [1.0, 1.0]
    # A new count begins for these, and for no other.
    assert lanes.impacts.tolist() == [4, 0, 0]
    assert np.isnan(lanes.struck[1:]).all()
    assert np.isnan(lanes.zeno_time[1:]).all()
    assert np.isnan(lanes.zeno_acceleration[1:]).all()
    assert lanes.zeno_time[0] == 0.1
    assert tails.count.tolist() == [1, 0, 0]


def test_a_free_fall_strikes_unless_it_only_touches():
    transitions, lanes = table(3, own=OWN, contact=1e-3)
    tails = transitions._tails
    tails.append(np.arange(3), np.ones(3), np.ones(3), np.zeros((3, 4)))
    guard = at((0.0, -4.0e-3), (0.0, -4.1e-3))
    y = at((0.0, -4.0e-3, *UP), (0.0, -4.1e-3, *UP))
    transitions.arrive(FREE, rows(0, 1), at(1.0, 2.0), y, guard)
    assert lanes.mode[:2].tolist() == [LOCKED, FLIGHT]
    assert lanes.leg_time[:2].tolist() == [1.0, 2.0]
    (event,) = transitions.events
    assert isinstance(event, Struck)
    assert (event.lane, event.time, event.rate) == (1, 2.0, -4.1e-3)
    assert event.state == pytest.approx([0.0, 0.5 * 4.1e-3, *UP], abs=1e-15)
    # The sequence before is over.
    assert tails.count.tolist() == [0, 1, 1]


def test_a_flight_ends_with_its_own_rate_in_units_of_its_speed():
    transitions, lanes = table(2)
    lanes.p[:, -1] = [0.1, 0.2]
    y = at((0.0, -0.09, *UP, 0.0, -0.9), (0.0, -0.16, *UP, 0.0, -0.8))
    transitions.arrive(FLIGHT, rows(0, 1), at(1.0, 2.0), y, np.zeros((2, 2)))
    rates = [event.rate for event in transitions.events if isinstance(event, Struck)]
    assert rates == pytest.approx([-0.09, -0.16])
    assert lanes.unit == pytest.approx([0.045, 0.08])
    transitions, lanes = table(2, most_impacts=0)
    lanes.p[:, -1] = [0.1, 0.2]
    transitions.arrive(FLIGHT, rows(0, 1), at(1.0, 2.0), y, np.zeros((2, 2)))
    assert [event.state.tolist() for event in transitions.events] == y[:, :4].tolist()


@pytest.mark.parametrize(
    ("cosine", "sine", "mode", "on_guard"),
    [
        (1.0, 0.0, LOCKED, False),
        (1.0, 0.6, FREE, True),
        # Neither held nor thrown: what the force does next decides.
        (SLACK, 0.5, FREE, True),
        (-SLACK, 0.5, LOCKED, True),
    ],
)
def test_a_ball_at_rest_on_the_table_stays_or_leaves(cosine, sine, mode, on_guard):
    # Beside one that is held, and led by it: a follower does what its leader does.
    transitions, lanes = table(3)
    lanes.leader[2] = 1
    x = at((0.0, 0.0, *UP), (0.0, 0.0, cosine, sine), (0.0, 0.0, cosine, sine + 1e-7))
    transitions._rest(np.arange(3), at(1.0, 2.0, 3.0), x)
    assert lanes.mode.tolist() == [LOCKED, mode, mode]
    assert lanes.on_guard.tolist() == [False, on_guard, on_guard]
    assert lanes.leg_time.tolist() == [1.0, 2.0, 3.0]
    assert lanes.unit.tolist() == [1.0] * 3


def test_what_an_acceleration_may_be_to_count_as_none_is_a_part_of_the_problems():
    # Below 8e-3 the multiplier's rate decides: the sine is 2e-3 / 4 beyond a half, or 4e-3 / 4.
    transitions, lanes = table(4, own=OWN, contact=1e-3)
    x = at(*[(0.0, 0.0, c, s) for c in (-SLACK, SLACK) for s in (0.5015, 0.503)])
    transitions._rest(np.arange(4), np.zeros(4), x)
    assert lanes.mode.tolist() == [LOCKED, FREE, FREE, FREE]


def strike(transitions, time, *rates, clock=UP):
    """Let the first lanes strike with these gap rates."""
    rate, n = np.array(rates), len(rates)
    x = np.column_stack([np.zeros(n), rate, np.tile(clock, (n, 1))])
    with np.errstate(all="ignore"):
        transitions._hit(np.arange(n), np.full(n, time), x, rate)


def test_the_first_impact_is_told_and_every_one_that_is_hardly_slower():
    transitions, lanes = table(2)
    # Three quarters of the speed before is between one half and all of it.
    for k, rates in enumerate([(-2.0, -4.0), (-1.49, -3.0), (-1.2, -1.0)]):
        strike(transitions, float(k), *rates)
    struck = [(one.lane, one.time, one.rate) for one in transitions.events]
    assert struck == [(0, 0.0, -2.0), (1, 0.0, -4.0), (1, 1.0, -3.0), (0, 2.0, -1.2)]
    assert transitions.events[1].state == pytest.approx([0.0, 2.0, *UP], abs=1e-15)
    assert lanes.impacts.tolist() == [3, 3]
    assert lanes.struck.tolist() == [-2.0, -4.0]
    assert lanes.unit == pytest.approx([0.6, 0.5])
    assert lanes.leg_time.tolist() == [2.0, 2.0]


def test_an_impact_that_opens_the_gap_fails_and_one_too_many():
    transitions, lanes = table(3, most_impacts=2)
    strike(transitions, 0.0, -1.0, 0.0, 1e-3)
    ends = [event for event in transitions.events if isinstance(event, Ended)]
    assert [end.lane for end in ends] == [1, 2]
    assert all("opens" in end.detail for end in ends)
    strike(transitions, 1.0, -0.5)
    assert lanes.alive.tolist() == [True, False, False]
    strike(transitions, 2.0, -0.25)
    assert lanes.alive.tolist() == [False] * 3
    assert "2 impacts" in transitions.events[-1].detail


def test_a_plastic_impact_locks_where_the_table_holds_and_is_the_zeno_point():
    # At the end of their time, too.
    transitions, lanes = table(2, restitution=0.0, until=1.5)
    strike(transitions, 1.5, -1.0, -1.0, clock=(0.0, -1.0))
    assert lanes.mode.tolist() == [LOCKED, LOCKED]
    assert lanes.zeno_time.tolist() == [1.5, 1.5]
    assert lanes.zeno_acceleration == pytest.approx([-6.0, -6.0])
    assert lanes.leg_time.tolist() == [1.5, 1.5]
    transitions, lanes = table(1, restitution=0.0)
    strike(transitions, 1.5, -1.0, clock=(0.0, 1.0))
    assert lanes.mode.tolist() == [FREE]
    assert lanes.on_guard.tolist() == [True]
    assert np.isnan(lanes.zeno_time).all()
    assert np.isnan(lanes.zeno_acceleration).all()


def test_a_slow_impact_flies_on_where_the_table_holds_and_is_let_go_where_it_does_not():
    # A rate counts as zero below 4e-3; one half of 8.4e-3 is above, of 8e-3 is not.
    for clock, modes in [(UP, [FLIGHT, FLIGHT]), ((0.0, 1.0), [FREE, FLIGHT])]:
        transitions, lanes = table(2, own=OWN, contact=1e-3)
        strike(transitions, 1.0, -8e-3, -8.4e-3, clock=clock)
        assert lanes.mode.tolist() == modes
        assert np.isnan(lanes.zeno_time).all()


def test_an_impact_whose_reset_enters_the_stop_fails():
    transitions, lanes = table(2)
    x, rate = at((0.0, -0.5, *UP), (0.0, -0.1, *UP)), at(-0.1, -0.1)
    transitions._hit(rows(0, 1), at(1.0, 1.0), x, rate)
    assert lanes.alive.tolist() == [False, True]
    (end, _) = transitions.events
    assert isinstance(end, Ended)
    assert (end.lane, end.reason) == (0, Reason.FAILURE)
    assert "into the stop" in end.detail


def test_a_zeno_point_is_passed_to_only_if_the_acceleration_hardly_changes_on_the_way():
    # A limit at which the table holds with 4 m/s^2, as two impacts tell alike.
    transitions, lanes = table(3)
    limit = np.tile((0.0, 0.0, SLACK, -0.5), (3, 1))
    for speed in (1.0, 1e-3):
        transitions._tails.append(np.arange(3), np.full(3, speed), np.full(3, 5.0), limit)
    passed = transitions._pass(np.arange(3), at(-2.0, -4.3, -5.0))
    assert passed.tolist() == [False, True, False]
    assert lanes.mode.tolist() == [7, LOCKED, 7]
    assert lanes.leg_time[1] == pytest.approx(5.0, rel=1e-15)


def test_a_sequence_is_left_for_its_zeno_point_when_it_is_resolved():
    # Without a turn of its clock this table is a floor.
    transitions, lanes = table(4, resolved=0.25, until=5.0)
    lanes.p[:, 2] = 0.0
    lanes.until[2] = 4.0
    for time, rate in [(0.0, -4.0), (2.0, -2.0)]:
        strike(transitions, time, rate, rate, rate, rate)
        assert lanes.mode.tolist() == [FLIGHT] * 4
        assert np.isnan(lanes.zeno_time).all()
    # To a quarter of the first speed, to hardly more, too late, and not as the last one told.
    strike(transitions, 3.0, -1.0, -1.01, -1.0, -0.99)
    assert lanes.mode.tolist() == [LOCKED, FLIGHT, FLIGHT, FLIGHT]
    # 2 w / (2 m/s^2 (1 - e)) with w = 0.5.
    assert lanes.zeno_time[0] == pytest.approx(4.0, rel=1e-14)
    assert lanes.leg_time[0] == lanes.zeno_time[0]
    assert lanes.zeno_acceleration[0] == pytest.approx(-2.0)
    assert lanes.y[0, :4] == pytest.approx([0.0, 0.0, *UP], abs=1e-15)
    assert lanes.leg_time[1:].tolist() == [3.0] * 3
    assert np.isnan(lanes.zeno_time[1:]).all()


def test_an_impact_at_which_the_table_throws_is_in_no_sequence():
    transitions, lanes = table(2)
    tails = transitions._tails
    strike(transitions, 0.0, -2.0, -2.0)
    assert tails.count.tolist() == [1, 1]
    strike(transitions, 1.0, -1.0, -1.0, clock=(0.8, 0.6))
    assert tails.count.tolist() == [0, 0]
    strike(transitions, 1.5, -1.0, -1.0, clock=(SLACK, 0.5))
    assert tails.count.tolist() == [0, 0]
    strike(transitions, 2.0, -0.5, -0.5)
    # As fast as before, or faster: another sequence; slower: the same one.
    strike(transitions, 3.0, -0.5, -0.4)
    assert tails.count.tolist() == [1, 2]
    assert lanes.mode.tolist() == [FLIGHT] * 2


def test_a_lane_that_ends_takes_its_followers_with_it_and_a_follower_none():
    transitions, lanes = table(5)
    lanes.leader[:] = [0, 0, 0, 3, 4]
    lanes.leg_time[:], lanes.unit[:], lanes.offset[:] = 2.0, 0.5, 3.0
    lanes.y[:, :4] = np.arange(4.0)
    transitions.end(1, Reason.ESCAPE, "height")
    assert lanes.alive.all()
    assert np.isfinite(lanes.y).all()
    transitions.fail(rows(2), "It cannot.")
    assert lanes.alive.all()
    assert np.isnan(lanes.y).all(axis=1).tolist() == [False, False, True, False, False]
    assert not transitions.events
    transitions.end(0, Reason.HELD, "why")
    transitions.end(0, Reason.HELD, "why")
    (end,) = transitions.events
    assert isinstance(end, Ended)
    assert (end.lane, end.time, end.reason, end.detail) == (0, 3.5, Reason.HELD, "why")
    assert end.state.tolist() == [0.0, 1.0, 2.0, 3.0]
    assert lanes.alive.tolist() == [False, False, False, True, True]
    assert lanes.free_slots == [0, 1, 2]
    transitions.leave(0)
    assert lanes.free_slots == [0, 1, 2]
