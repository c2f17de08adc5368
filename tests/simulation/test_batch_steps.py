"""Steps of lanes, one at a time: sizes, ends and rests, on a table with plain numbers."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from zeno_orbits.model import USUAL, OwnScale
from zeno_orbits.model.library import load_problem
from zeno_orbits.simulation.batch.batch import Batch, BatchSettings, _followed, _Start, _turned
from zeno_orbits.simulation.batch.lanes import FLIGHT, FREE, LOCKED
from zeno_orbits.simulation.batch.model import model_in_rows
from zeno_orbits.simulation.batch.outcomes import Ended, Reason, Struck

TABLE = load_problem("vibrating_table")
OWN = OwnScale(
    time=3.0,
    gap=2.0,
    gap_rate=4.0,
    gap_acceleration=8.0,
    multiplier=5.0,
    sizes=(1.0, 5.0, 1.0, 1.0),
)


def numbers(**changed):
    """Parameters: the gap's acceleration is 4 sine - 2 [m/s^2], the multiplier minus twice that."""
    usual = {"m": 2.0, "A": 1.0, "omega": 2.0, "g": 2.0, "restitution": 0.5}
    return TABLE.values(parameters=usual | changed).vector


def running(n, *, own=USUAL, bounds=None, until=10.0, **settings):
    """A batch of n lanes that run, free, from nowhere in particular, and its lanes."""
    model = model_in_rows(TABLE, own)
    batch = Batch(model, n, bounds=bounds, settings=BatchSettings(**settings))
    lanes = batch._lanes
    lanes.alive[:], lanes.free_slots = True, []
    lanes.p[:, :-1], lanes.tolerance[:], lanes.until[:] = numbers(), 1e-6, until
    lanes.y[:, :4] = 1.0, 0.0, 1.0, 0.0
    return batch, lanes


def ends_of(batch):
    """The ends that were told since the last call, by lane."""
    events, batch._transitions.events = batch._transitions.events, []
    assert all(isinstance(event, Ended) for event in events)
    return {event.lane: event for event in events}


def test_lanes_are_taken_as_if_nobody_had_used_them():
    batch = Batch(model_in_rows(TABLE), 3)
    lanes = batch._lanes
    assert (batch.n_free, batch.n_running) == (3, 0)
    for array in (lanes.steps, lanes.largest_rate, lanes.reach, lanes.p, lanes.impacts, lanes.size):
        array[:] = 9
    p = np.array([numbers(restitution=0.25), numbers(restitution=0.75)])
    x = np.array([[1.0, -3.0, 1.0, 0.0], [2.0, 0.0, 0.0, 1.0]])
    rows = batch.start(p, x, 1e-5, np.array([7.0, 8.0]))
    assert rows.tolist() == [0, 1]
    assert (batch.n_free, batch.n_running) == (1, 2)
    assert lanes.leader[rows].tolist() == [0, 1]
    assert lanes.p[rows, :-1].tolist() == p.tolist()
    assert lanes.p[rows, -1].tolist() == [0.0, 0.0]
    assert lanes.restitution[rows].tolist() == [0.25, 0.75]
    assert lanes.tolerance[rows].tolist() == [1e-5, 1e-5]
    assert lanes.until[rows].tolist() == [7.0, 8.0]
    assert lanes.steps[rows].tolist() == lanes.impacts[rows].tolist() == [0, 0]
    assert lanes.reach[rows].tolist() == [[0.0], [0.0]]
    assert lanes.largest_rate[rows] == pytest.approx(np.array([[3, 2, 0, 2], [0, 2, 2, 0]]))
    # The third is as it was.
    assert lanes.steps[2] == 9
    batch.stop([0])
    assert (batch.n_free, batch.n_running) == (2, 1)
    assert batch.start(p[:1], x[:1], 1e-5, np.array([7.0])).tolist() == [0]


def test_followers_are_taken_behind_their_leaders_and_stop_with_them():
    batch = Batch(model_in_rows(TABLE), 6)
    x = np.tile([0.0, 0.0, 1.0, 0.0], (6, 1))
    rows = batch.resume(np.tile(numbers(), (6, 1)), x, 1e-5, np.full(6, 7.0), n_followers=2)
    assert batch._lanes.leader[rows].tolist() == [rows[0]] * 3 + [rows[3]] * 3
    batch.stop([int(rows[0])])
    assert batch._lanes.alive[rows].tolist() == [False] * 3 + [True] * 3


def test_a_step_is_followed_by_one_that_its_error_asks_for():
    batch, lanes = running(10)
    lanes.offset[:] = 1.0
    lanes.refused[5:7] = True
    # An error of the tolerance leaves nine tenths; one of 2 ** -5 of it twice as much.
    errors = [1.0, 1 / 32, 1e-10, 32.0, 1e10, 1 / 32, 1e-10, math.nan, math.inf, 1.9]
    factors = [0.9, 1.8, 8.0, 0.45, 0.2, 1.0, 1.0, 0.2, 0.2, 0.9 * 1.9**-0.2]
    size = np.linspace(0.1, 1.0, 10)
    good = batch._control(np.arange(10), size, np.array(errors))
    assert good.tolist() == [True, True, True, False, False, True, True, False, False, False]
    assert lanes.size == pytest.approx(size * factors)
    assert lanes.refused.tolist() == (~good).tolist()
    assert lanes.steps.tolist() == good.astype(int).tolist()
    assert not ends_of(batch)


def test_a_lane_fails_when_its_steps_fall_to_rounding_or_are_too_many():
    batch, lanes = running(6, most_steps=5)
    lanes.offset[:], lanes.steps[:] = 1.0, [0, 0, 0, 4, 5, 5]
    # Times near 1 are 2.2e-16 apart: a step must be more than four of these.
    size = np.array([1.5e-15, 2.5e-15, 1.5e-15, 0.1, 0.1, 0.1])
    batch._control(np.arange(6), size, np.array([32.0, 32.0, 0.5, 0.5, 0.5, 32.0]))
    ends = ends_of(batch)
    assert sorted(ends) == [0, 4]
    assert "rounding" in ends[0].detail
    assert "5 steps" in ends[4].detail
    assert {end.reason for end in ends.values()} == {Reason.FAILURE}


@pytest.mark.parametrize(("mode", "least"), [(FREE, 2e-3), (FLIGHT, 1 / 8e3), (LOCKED, 5e-3)])
def test_a_guard_that_was_never_above_is_left_below_a_part_of_its_size(mode, least):
    batch, lanes = running(6, own=OWN, contact=1e-3)
    lanes.mode[:], lanes.on_guard[:] = mode, [True, True, True, True, True, False]
    n_y = batch._transitions.flows[mode].n_y
    after = np.tile([1.0, 0.0, 1.0, 0.0, 0.0, 1.0], (6, 1))[:, :n_y]
    # Beyond 1e-6 of what it may change by, if that is more: here by 1e5 in a step of 0.1.
    lanes.guard[3, 1] = -1e5
    guard = np.zeros((6, 2))
    guard[:, 0] = -1.01 * least, -least, 0.1, -0.99e-2, -1.01e-2, -1.01 * least
    guard[4, 1] = -1e5
    batch._go_on(mode, np.arange(6), after, guard, np.full(6, 0.1))
    assert sorted(ends_of(batch)) == [0, 4]
    assert lanes.on_guard[[1, 2, 3, 5]].tolist() == [True, False, True, False]
    assert lanes.largest[[1, 3, 4]] == pytest.approx([0.0, 1e4, 1e4])
    assert lanes.guard[1:4].tolist() == guard[1:4].tolist()
    assert lanes.y[1, :n_y].tolist() == after[1].tolist()
    assert lanes.offset[1:4].tolist() == [0.1] * 3
    # The largest change of the leg counts, not the last one.
    batch._go_on(mode, np.array([3]), after[:1], np.array([[-0.99e-2, 0.0]]), np.array([0.1]))
    assert not ends_of(batch)
    assert lanes.offset[3] == 0.2


def test_a_follower_has_left_the_guard_when_its_leader_has():
    batch, lanes = running(2)
    lanes.leader[:], lanes.on_guard[:] = 0, True
    after = np.tile([1.0, 0.0, 1.0, 0.0], (2, 1))
    batch._go_on(FREE, np.arange(2), after, np.array([[0.0, 0.0], [0.1, 0.0]]), np.full(2, 0.1))
    assert lanes.on_guard.tolist() == [True, True]
    batch._go_on(FREE, np.arange(2), after, np.array([[0.1, 0.0], [0.0, 0.0]]), np.full(2, 0.1))
    assert lanes.on_guard.tolist() == [False, False]


def test_the_first_state_beyond_its_bound_names_the_escape():
    batch, lanes = running(4, bounds=np.array([2.0, 3.0, math.inf, math.inf]))
    after = np.array([[2.0, -3.0], [2.1, 9.0], [-2.1, 0.0], [0.0, -3.1]])
    after = np.column_stack([after, np.tile([1.0, 0.0], (4, 1))])
    batch._go_on(FREE, np.arange(4), after, np.ones((4, 2)), np.full(4, 0.1))
    ends = ends_of(batch)
    assert {lane: end.detail for lane, end in ends.items()} == {
        1: "height",
        2: "height",
        3: "speed",
    }
    assert {end.reason for end in ends.values()} == {Reason.ESCAPE}
    assert ends[1].state.tolist() == after[1].tolist()
    assert ends[1].time == pytest.approx(0.1)
    assert lanes.alive.tolist() == [True, False, False, False]


def test_the_reach_of_a_motion_is_that_of_the_first_half_of_its_time():
    batch, lanes = running(4)
    lanes.leg_time[:], lanes.unit[:] = [4.0, 4.0, 4.0, 4.8], [1.0, 0.5, 0.5, 0.1]
    lanes.reach[:, 0] = [1.0, 1.0, 9.0, 1.0]
    after = np.tile([-3.0, 5.0, 1.0, 0.0], (4, 1))
    batch._go_on(FREE, np.arange(4), after, np.ones((4, 2)), np.array([2.0, 2.0, 1.9, 2.1]))
    # At 6 s, 5 s, 4.95 s and 5.01 s of 10 s.
    assert lanes.reach[:, 0].tolist() == [1.0, 3.0, 9.0, 1.0]


def test_a_lane_ends_at_its_time_and_not_before():
    batch, lanes = running(3)
    lanes.leg_time[:], lanes.unit[:], lanes.offset[:] = 4.0, 0.5, 11.0
    lanes.reach[:] = 1.0
    after = np.tile([1.0, 5.0, 1.0, 0.0], (3, 1))
    batch._go_on(FREE, np.arange(3), after, np.ones((3, 2)), np.array([1.0, 0.999, 1.0 - 1e-14]))
    ends = ends_of(batch)
    assert sorted(ends) == [0, 2]
    assert (ends[0].time, ends[0].reason, ends[0].detail) == (10.0, Reason.HORIZON, "")


def test_at_the_end_of_its_time_a_motion_is_gone_held_at_rest_or_none_of_these():
    batch, lanes = running(6)
    lanes.mode[:] = [FREE, FREE, LOCKED, LOCKED, LOCKED, FREE]
    lanes.reach[:, 0] = [1e-3, 1e-3, 1.0, 1.0, 1.0, 0.0]
    lanes.y[:, 0] = [-1.1, 0.9, 0.0, 0.0, 0.0, 5.0]
    lanes.leg_time[:] = [0.0, 0.0, 4.9, 5.0, 0.0, 0.0]
    # The fifth lies on a table that does not shake enough to throw it.
    lanes.p[4, :-1] = numbers(A=0.25)
    batch._end_of_time(np.arange(6))
    ends = ends_of(batch)
    reasons = [Reason.ESCAPE, Reason.HORIZON, Reason.HELD, Reason.HORIZON, Reason.REST]
    assert [ends[k].reason for k in range(6)] == [*reasons, Reason.HORIZON]
    assert ends[0].detail == "height"
    assert {ends[k].detail for k in range(1, 6)} == {""}


def test_every_64_steps_a_lane_is_looked_at_whether_it_rests():
    batch, lanes = running(5)
    lanes.mode[:], lanes.p[:, :-1] = LOCKED, numbers(A=0.25)
    lanes.steps[:] = [62, 63, 64, 127, 0]
    batch._look_for_rest()
    ends = ends_of(batch)
    assert sorted(ends) == [1, 3]
    assert {end.reason for end in ends.values()} == {Reason.REST}


def test_a_motion_rests_if_nothing_but_the_clock_moves_in_any_of_its_phases():
    batch, lanes = running(8, own=OWN, contact=1e-3)
    # A free ball without weight drifts; a table that throws at a quarter of a turn does not hold.
    lanes.p[:, :-1] = numbers(g=1e-300, A=1e-300)
    lanes.p[4:, :-1] = numbers(A=0.49), numbers(A=0.51), numbers(A=0.49), numbers(A=0.49)
    lanes.mode[:] = [FREE, FREE, FREE, FREE, LOCKED, LOCKED, FREE, LOCKED]
    lanes.largest_rate[:4] = [[1e4, 0, 9, 9], [1e4, 0, 9, 9], [0, 0, 9, 9], [0, 0, 9, 9]]
    # Below a millionth of the largest rate, or 1e-3 of the problem's own: 5 for speeds.
    lanes.y[:4, 1] = [0.99e-2, -1.01e-2, 4.9e-3, 5.1e-3]
    # Of the free ones the stop is no matter.
    lanes.y[2, 0] = 0.0
    still = batch._still(np.array([7, 6, 5, 4, 3, 2, 1, 0]))
    assert still.tolist() == [2, 0, 7, 4]


@pytest.mark.parametrize("omega", [0.01, 2.0, 300.0])
def test_a_clock_of_any_speed_is_seen_to_throw_between_its_phases(omega):
    batch, lanes = running(4)
    lanes.mode[:] = LOCKED
    for k, least in enumerate((0.9, 0.9995, 1.0005, 1.1)):
        lanes.p[k, :-1] = numbers(A=2.0 * least / omega**2, omega=omega)
    # A phase at which the highest point of the table is halfway between two of 64.
    start = math.pi / 64
    lanes.y[:, 2:4] = math.cos(start), math.sin(start)
    assert batch._still(np.arange(4)).tolist() == [0, 1]


def test_a_clock_is_turned_by_its_angles():
    found = _turned(np.array([[1.0, 0.0], [0.6, 0.8]]), np.array([0.0, math.pi / 2, math.pi]))
    expected = [[[1, 0], [0, 1], [-1, 0]], [[0.6, 0.8], [-0.8, 0.6], [-0.6, -0.8]]]
    assert found == pytest.approx(np.array(expected), abs=1e-15)


def test_a_follower_falls_where_its_own_guard_does():
    roots, calls = np.array([9.0, 1.0, 2.0, 1e-3]), []

    def attempt(y, p, size, tolerance):
        # Falls of different followers, the first of them told exactly.
        calls.append(len(size))
        assert p[:, 0].tolist() == tolerance.tolist() == y[:, 0].tolist()
        guard = np.column_stack([y[:, 0] ** 2 - size**2, -2 * size])
        return y, size, guard

    start = _Start(
        flow=SimpleNamespace(attempt=attempt), y=roots[:, None], p=roots[:, None], tolerance=roots
    )
    lanes, offset = np.array([3, 1, 2]), np.array([1.02e-3, 1.0, 1.995])
    found = _followed(start, lanes, offset)
    assert found == pytest.approx(roots[lanes], rel=1e-14)
    assert offset.tolist() == [1.02e-3, 1.0, 1.995]
    # Corrections of 2e-2, 2e-4, 2e-8 and 2e-16 of the first, of 2e-3, 3e-6 and 5e-12 of the last,
    # and of nothing: those that are done are left alone.
    assert calls == [3, 2, 2, 1]


def test_a_follower_that_does_not_come_near_is_left_after_eight_corrections():
    calls = []

    def attempt(y, _p, size, _tolerance):
        calls.append(len(size))
        return y, size, np.column_stack([np.full(len(size), 1.0), np.full(len(size), -1.0)])

    one = np.ones((1, 1))
    start = _Start(flow=SimpleNamespace(attempt=attempt), y=one, p=one, tolerance=one[:, 0])
    assert _followed(start, np.array([0]), np.array([1.0])).tolist() == [9.0]
    assert len(calls) == 8


def test_a_ball_is_followed_from_its_fall_to_its_rest_or_the_end_of_its_time():
    # A floor: from 1 m it falls for 1 s, and bounces for 2 s more.
    batch = Batch(model_in_rows(TABLE), 2)
    p, x = np.tile(numbers(omega=1e-9), (2, 1)), np.tile([1.0, 0.0, 1.0, 0.0], (2, 1))
    cut, whole = batch.start(p, x, 1e-6, np.array([0.5, 10.0])).tolist()
    events, rounds = [], 0
    while batch.n_running:
        events.extend(batch.round())
        rounds += 1
    struck = [event for event in events if isinstance(event, Struck)]
    ends = {event.lane: event for event in events if isinstance(event, Ended)}
    assert (ends[cut].time, ends[cut].reason) == (0.5, Reason.HORIZON)
    assert ends[cut].state[:2] == pytest.approx([0.75, -1.0])
    (impact,) = struck
    assert impact.lane == whole
    assert (impact.time, impact.rate) == pytest.approx((1.0, -2.0), rel=1e-12)
    assert impact.state[:2] == pytest.approx([0.0, 1.0], abs=1e-12)
    assert batch._lanes.zeno_time[whole] == pytest.approx(3.0, rel=1e-9)
    assert batch._lanes.leg_time[whole] == batch._lanes.zeno_time[whole]
    assert ends[whole].reason is Reason.REST
    assert rounds < 300


def test_a_follower_lands_at_its_own_time_in_the_step_of_its_leader():
    batch = Batch(model_in_rows(TABLE), 2)
    p = np.tile(numbers(omega=1e-9), (2, 1))
    x = np.array([[0.0, 1.0, 1.0, 0.0], [0.0, 1.01, 1.0, 0.0]])
    rows = batch.resume(p, x, 1e-6, np.full(2, 9.0), n_followers=1)
    lanes = batch._lanes
    for _ in range(50):
        assert lanes.mode[rows].tolist() == [FLIGHT, FLIGHT]
        assert lanes.size[rows[0]] == lanes.size[rows[1]]
        batch.round()
        if lanes.impacts[rows].any():
            break
    # Thrown up at 1 m/s and 1.01 m/s against 2 m/s^2; they leave at half that.
    assert lanes.impacts[rows].tolist() == [1, 1]
    assert lanes.leg_time[rows] == pytest.approx([1.0, 1.01], rel=1e-12)
    assert lanes.unit[rows] == pytest.approx([0.5, 0.505], rel=1e-12)


def test_a_step_that_is_refused_changes_nothing_but_the_next_one():
    batch = Batch(model_in_rows(TABLE), 2)
    # Its guard falls in the step, but that is not told by a step so long.
    x = np.array([[0.1, -1.0, 1.0, 0.0], [9.0, 0.0, 1.0, 0.0]])
    rows = batch.start(np.tile(numbers(), (2, 1)), x, 1e-9, np.full(2, 9.0))
    lanes = batch._lanes
    lanes.size[rows] = 3.0
    assert batch.round() == []
    assert lanes.refused[rows].all()
    assert (lanes.offset[rows] == 0.0).all()
    assert (lanes.size[rows] < 3.0).all()
    assert lanes.y[rows, :4].tolist() == x.tolist()
    assert lanes.impacts[rows].tolist() == [0, 0]
