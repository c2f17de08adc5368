"""Zeno limits in rows: against polynomials, and against the limits of single sequences."""

import math

import numpy as np
import pytest

from zeno_orbits.simulation.batch.zeno_limit import Tails
from zeno_orbits.simulation.zeno_limit import TailEstimate, combine, spread_nodes


def add(tails, lane, speed, time, state):
    tails.append(np.array([lane]), np.array([speed]), np.array([time]), np.array([state]))


def test_limits_in_rows_are_those_of_single_sequences():
    rng = np.random.default_rng(2)
    tails = Tails(3, np.ones(5))
    estimates = {lane: [] for lane in range(3)}
    for lane, (ratio, n) in enumerate([(0.2, 6), (0.7, 40), (0.45, 1)]):
        for k in range(n):
            speed = ratio**k
            state = rng.normal(size=4) * 1e-3 * speed**2 + lane
            time = 2.0 + 0.1 * speed**2
            rows = np.array([lane])
            tails.append(rows, np.array([speed]), np.array([time]), state[None])
            estimates[lane].append(
                TailEstimate(
                    impact_time=0.0,
                    resting=state,
                    speed=speed,
                    time=time,
                    state=state,
                    gap_acceleration=-1.0,
                )
            )
    rows = np.arange(3)
    times, states, errors = tails.limits(rows, rows)
    for lane in range(3):
        limit = combine(estimates[lane])
        assert times[lane] == pytest.approx(limit.time, rel=1e-13)
        assert states[lane] == pytest.approx(limit.state, rel=1e-12)
        assert errors[lane] == pytest.approx(limit.error, rel=1e-6, abs=1e-14)


def test_the_last_speed_is_that_of_each_lanes_own_sequence():
    tails = Tails(4, np.ones(2))
    for lane, speeds in {0: [3.0], 1: [2.0, 0.5, 0.1], 3: [7.0, 6.0]}.items():
        for speed in speeds:
            add(tails, lane, speed, 1.0, [0.0])
    assert tails.last_speed(np.array([3, 2, 1, 0])).tolist() == [6.0, math.inf, 0.1, 3.0]
    tails.clear(np.array([3, 0]))
    assert tails.last_speed(np.arange(4)).tolist() == [math.inf, 0.1, math.inf, math.inf]
    assert tails.count.tolist() == [0, 3, 0, 0]
    # A new sequence begins where the old one did.
    add(tails, 3, 9.0, 1.0, [0.0])
    assert tails.last_speed(np.array([3])).tolist() == [9.0]
    assert tails.speed[3, 0] == 9.0


def test_room_is_made_for_long_sequences_and_none_of_their_impacts_is_lost():
    tails, speeds = Tails(2, np.ones(2)), 0.99 ** np.arange(150)
    for speed in speeds:
        # The other begins anew each time.
        tails.clear(np.array([0]))
        states = np.array([[4.0], [1.0 - speed**2]])
        times = np.array([3.0, 2.0 + speed**2])
        tails.append(np.arange(2), np.array([0.5, speed]), times, states)
    tails.append(np.empty(0, dtype=np.intp), np.empty(0), np.empty(0), np.empty((0, 1)))
    assert tails.count.tolist() == [1, 150]
    assert tails.speed[1, :150].tolist() == speeds.tolist()
    times, states, errors = tails.limits(np.array([1, 0]), np.array([1, 0]))
    # A quadratic law is told by two nodes or more; a lone impact tells its own point.
    assert times == pytest.approx([2.0, 3.0], rel=1e-13)
    assert states.ravel() == pytest.approx([1.0, 4.0], rel=1e-13)
    assert errors[0] < 1e-12
    assert errors[1] == math.inf


@pytest.mark.parametrize("largest", [0, 1, 2])
def test_the_error_is_the_largest_change_from_a_node_earlier_in_the_problems_sizes(largest):
    unit, limit = np.array([2.0, 0.5, 3.0]), np.array([7.0, -1.0, 4.0])
    square = np.where(np.arange(3) == largest, 0.2, -0.01)
    tails = Tails(3, unit)
    for lane, first in ((2, 1.0), (0, 2.0)):
        for speed in (first, first / 10):
            point = limit + square * speed**2
            add(tails, lane, speed, point[0], point[1:])
    lanes = np.array([0, 2])
    times, states, errors = tails.limits(lanes, lanes)
    assert times == pytest.approx([7.0, 7.0], rel=1e-14)
    assert states == pytest.approx(np.tile(limit[1:], (2, 1)), rel=1e-14)
    # From the first impact alone, square * first ** 2 is missing.
    change = 0.2 / (unit[largest] + abs(limit[largest]))
    assert errors == pytest.approx([4 * change, change], rel=1e-12)


def test_a_plastic_impact_is_its_own_limit_without_error():
    tails = Tails(2, np.ones(2))
    for lane in (0, 1):
        add(tails, lane, 1.0, 3.0, [2.0])
        add(tails, lane, 0.0 if lane == 0 else 0.9, 5.0, [6.0])
    times, states, errors = tails.limits(np.arange(2), np.arange(2))
    # The other's two impacts are too near each other for two nodes.
    assert times.tolist() == [5.0, 5.0]
    assert states.tolist() == [[6.0], [6.0]]
    assert errors.tolist() == [0.0, math.inf]


def test_a_follower_is_extrapolated_from_the_impacts_of_its_leader():
    # The leader's speeds are half of each other; the follower's are nearer than a node asks.
    tails = Tails(2, np.ones(2))
    speeds = {0: [1.0, 0.5, 0.25], 1: [1.0, 0.51, 0.26]}
    for lane, falling in speeds.items():
        for speed in falling:
            # A term that three nodes take out and two do not.
            add(tails, lane, speed, 1.0 + 0.3 * speed**2 - 0.2 * speed**3, [0.0])
    times, _, _ = tails.limits(np.array([0, 1]), np.array([0, 0]))
    assert times == pytest.approx([1.0, 1.0], rel=1e-13)
    alone, _, _ = tails.limits(np.array([1]), np.array([1]))
    assert abs(alone[0] - 1.0) > 1e-3


@pytest.mark.parametrize("ratio", [0.5, 0.499, 0.501, 0.71, 0.3, 0.95])
def test_nodes_in_rows_are_those_of_a_single_sequence(ratio):
    speeds = [0.5 * ratio**k for k in range(30)]
    tails = Tails(2, np.ones(2))
    for speed in speeds:
        add(tails, 1, speed, 0.0, [0.0])
    for last in (0, 1, 7, 29):
        (nodes,) = tails._nodes(np.array([1]), np.array([last])).tolist()
        expected = spread_nodes(speeds[: last + 1])[::-1]
        assert nodes == expected + [-1] * (5 - len(expected))
