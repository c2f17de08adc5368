"""Executions in lockstep against closed forms, one-lane simulation, and each other."""

import math

import casadi as ca
import numpy as np
import pytest

from zeno_orbits.integrators.flow import Tolerance
from zeno_orbits.integrators.rosenbrock import rosenbrock_step
from zeno_orbits.model.library import load_problem
from zeno_orbits.simulation.batch.batch import Batch, BatchSettings
from zeno_orbits.simulation.batch.model import ABSOLUTE, Columns, _step_function, model_in_rows
from zeno_orbits.simulation.batch.outcomes import Ended, Reason, Released, Struck
from zeno_orbits.simulation.simulator import SimulationSettings, simulate

PENDULUM = load_problem("motor_pendulum")
BALL = load_problem("bouncing_ball")

PERIOD = 1.81371293903044
"""Of the reference orbit, from an independent Taylor integration."""
RELEASE = (0.1985068301199, 0.0, -5.2365375521764, 0.0, -1.8591703843225)


def run(batch):
    """Return every event until no lane runs."""
    events = []
    while batch.n_running:
        events.extend(batch.round())
    return events


def releases_of(events, lane):
    return [event for event in events if isinstance(event, Released) and event.lane == lane]


def values(**gains):
    return PENDULUM.values(gains=gains).vector


def random_gains(n, seed=4):
    rng = np.random.default_rng(seed)
    pairs = zip(rng.uniform(1, 5, n), rng.uniform(-1.5, -0.2, n), strict=True)
    return np.array([values(Kp=kp, Kd=kd) for kp, kd in pairs])


def one_step(rate, y0, size):
    y, h = ca.SX.sym("y", len(y0)), ca.SX.sym("h")
    step = ca.Function("step", [y, h], [*rosenbrock_step(rate, ca.jacobian(rate(y), y), y, h)])
    return [np.array(part).ravel() for part in step(y0, size)]


def test_a_rosenbrock_step_has_order_5_and_its_error_estimate_order_4():
    # y' = y (1 - y) from 0.2: y = 1 / (1 + 4 exp(-t)).
    def missed(size):
        after, estimate = one_step(lambda y: y * (1 - y), [0.2], size)
        return abs(after[0] - 1 / (1 + 4 * math.exp(-size))), abs(estimate[0])

    (coarse, told), (fine, told_fine) = missed(0.4), missed(0.2)
    assert math.log2(coarse / fine) == pytest.approx(6, abs=0.5)
    assert math.log2(told / told_fine) == pytest.approx(5, abs=0.5)


def test_the_local_error_of_a_step_is_the_mean_square_of_those_of_its_states():
    mode, p, size, relative = PENDULUM.compiled().free, PENDULUM.values().vector, 1e-4, 1e-6
    _, error, _ = _step_function(mode, ABSOLUTE)(RELEASE, p, [size, relative])
    after, miss = one_step(lambda y: mode.rate(y, p), RELEASE, size)
    scale = relative * (ABSOLUTE + np.maximum(np.abs(RELEASE), np.abs(after)))
    assert float(error) == pytest.approx(np.sqrt(np.mean((miss / scale) ** 2)), rel=1e-9)


def test_lanes_of_a_clock_rest_where_their_table_throws_nothing():
    table = load_problem("vibrating_table")
    least = 9.81 / table.values().number("omega") ** 2
    parts = (0.5, 1.02, 0.98, 1.5)
    shaken = [table.values(parameters={"A": part * least, "restitution": 0.3}) for part in parts]
    batch = Batch(model_in_rows(table), len(shaken))
    starts = np.tile([0.0, 0.0, 1.0, 0.0], (len(shaken), 1))
    batch.start(np.array([one.vector for one in shaken]), starts, 1e-8, np.full(len(shaken), 8.0))
    ended = {event.lane: event.reason for event in run(batch) if isinstance(event, Ended)}
    assert [ended[lane] is Reason.REST for lane in range(len(shaken))] == [True, False, True, False]


@pytest.mark.parametrize("size", [1.0, 3.0])
def test_the_rate_of_a_clock_is_its_own_wherever_it_stands(size):
    table = load_problem("vibrating_table")
    phases = np.array([0.0, 0.7, 2.0, 4.0])
    starts = np.stack([1.0 + 0 * phases, 0 * phases, np.cos(phases), np.sin(phases)], axis=1)
    starts[:, 2:] *= size
    batch = Batch(model_in_rows(table), len(phases))
    p = np.tile(table.values().vector, (len(phases), 1))
    rows = batch.start(p, starts, 1e-8, np.full(len(phases), 1.0))
    batch._lanes.y[rows, :4] = starts
    omega = table.values().number("omega")
    assert batch._clock_rate(0, rows) == pytest.approx(np.full(len(phases), omega), rel=1e-12)


def test_a_fast_decay_is_damped_in_one_step_however_stiff():
    after, _ = one_step(lambda y: -1e12 * (y - 3.0), [5.0], 1.0)
    assert after[0] == pytest.approx(3.0, abs=1e-9)


def test_many_balls_reach_their_zeno_times_in_closed_form():
    heights, restitutions = np.meshgrid([0.3, 1.0, 2.5], [0.0, 0.2, 0.5, 0.8, 0.9])
    heights, restitutions = heights.ravel(), restitutions.ravel()
    settings = [BALL.values(parameters={"restitution": e}) for e in restitutions]
    names = BALL.state_names
    states = [[height if name == names[0] else 0.0 for name in names] for height in heights]
    batch = Batch(model_in_rows(BALL), len(heights))
    until = np.full(len(heights), 60.0)
    lanes = batch.start(np.array([s.vector for s in settings]), np.array(states), 1e-9, until)
    ended = {event.lane: event for event in run(batch) if isinstance(event, Ended)}
    fall = np.sqrt(2 * heights / settings[0].parameters["g"])
    expected = fall * (1 + restitutions) / (1 - restitutions)
    # Gravity is a polynomial of degree 2 and exact; an error is the limit's, 1e-3 of 1e-9.
    assert batch._lanes.zeno_time[lanes] == pytest.approx(expected, rel=1e-11)
    assert {event.reason for event in ended.values()} == {Reason.REST}


def test_the_reference_orbit_has_its_period():
    batch = Batch(model_in_rows(PENDULUM), 1)
    p, x = np.array([values()]), np.array([RELEASE])
    (lane,) = batch.resume(p, x, 1e-10, np.array([4.0]), n_followers=0)
    first, second = releases_of(run(batch), lane)
    # Some 800 steps with a local error of 1e-10 each; the layers damp most of it.
    assert first.time == pytest.approx(PERIOD, abs=1e-9)
    assert second.time == pytest.approx(2 * PERIOD, abs=2e-9)
    assert first.state == pytest.approx(RELEASE, abs=1e-8)
    assert first.zeno_time == pytest.approx(1.3200260238375, abs=1e-8)
    assert first.struck == pytest.approx(-16.909711305434, abs=1e-7)


def test_lanes_do_what_single_simulations_do():
    p = random_gains(6)
    start = np.array(PENDULUM.state_vector(PENDULUM.starts[0]))
    batch = Batch(model_in_rows(PENDULUM), len(p))
    lanes = batch.start(p, np.tile(start, (len(p), 1)), 1e-9, np.full(len(p), 6.0))
    events = run(batch)
    for lane, numbers in zip(lanes, p, strict=True):
        alone = simulate(PENDULUM.dynamics(numbers), start, until=6.0).releases
        found = releases_of(events, lane)
        assert len(found) == len(alone) > 1
        for ours, theirs in zip(found, alone, strict=True):
            # Before they settle motions stretch errors; 300 times the local error was seen.
            assert ours.time == pytest.approx(theirs.time, abs=1e-6)
            assert ours.state == pytest.approx(theirs.state, abs=5e-6)


def test_a_lane_is_the_same_to_the_last_bit_in_any_company_and_order():
    p = random_gains(21)
    start = np.tile(PENDULUM.state_vector(PENDULUM.starts[0]), (len(p), 1))

    def returns(order):
        batch = Batch(model_in_rows(PENDULUM), len(order))
        lanes = batch.start(p[order], start[order], 1e-7, np.full(len(order), 4.0))
        events = run(batch)
        return {
            k: [(e.time, *e.state) for e in releases_of(events, lane)]
            for k, lane in zip(order, lanes, strict=True)
        }

    together = returns(list(range(21)))
    shuffled = returns(np.random.default_rng(1).permutation(21).tolist())
    some = returns([3, 17, 4])
    assert shuffled == together
    assert some == {k: together[k] for k in (3, 17, 4)}


def test_a_lane_that_fails_says_why_and_leaves_the_others_untouched():
    p = random_gains(4)
    start = np.tile(PENDULUM.state_vector(PENDULUM.starts[0]), (4, 1))
    spoiled = start.copy()
    spoiled[1, 1], spoiled[2, 0] = -0.1, np.nan

    def outcome(x):
        batch = Batch(model_in_rows(PENDULUM), 4)
        lanes = batch.start(p, x, 1e-7, np.full(4, 3.0))
        events = run(batch)
        ends = {event.lane: event for event in events if isinstance(event, Ended)}
        states = [[tuple(e.state) for e in releases_of(events, lane)] for lane in lanes]
        return states, [ends[lane] for lane in lanes]

    (good, _), (found, ends) = outcome(start), outcome(spoiled)
    assert found[0] == good[0]
    assert found[3] == good[3]
    assert [end.reason for end in ends[1:3]] == [Reason.FAILURE, Reason.FAILURE]
    assert "gap is negative" in ends[1].detail


def test_chatter_beyond_the_cap_and_steps_beyond_theirs_are_failures_with_a_name():
    p, x = np.array([values()]), np.array([RELEASE])
    caps = {
        "impacts": BatchSettings(most_impacts=3),
        "steps": BatchSettings(most_steps=50),
    }
    for word, settings in caps.items():
        batch = Batch(model_in_rows(PENDULUM), 1, settings=settings)
        batch.resume(p, x, 1e-7, np.array([9.0]), n_followers=0)
        (end,) = [event for event in run(batch) if isinstance(event, Ended)]
        assert end.reason is Reason.FAILURE
        assert word in end.detail


def test_a_coordinate_beyond_its_bound_has_escaped_by_name():
    bounds = np.array([0.5, math.inf, math.inf, math.inf, math.inf])
    batch = Batch(model_in_rows(PENDULUM), 1, bounds=bounds)
    batch.resume(np.array([values()]), np.array([RELEASE]), 1e-7, np.array([9.0]), n_followers=0)
    (end,) = [event for event in run(batch) if isinstance(event, Ended)]
    assert (end.reason, end.detail) == (Reason.ESCAPE, "theta1")


def test_a_stiff_lane_settles_at_the_same_period_for_any_inductance():
    # The orbit depends on L/R to first order: at 1e-6 of the declared layer it is the limit's.
    small = [PENDULUM.values(parameters={"L": value}).vector for value in (2e-8, 2e-9)]
    quasi = load_problem("motor_pendulum@quasi_static")
    limit = quasi.dynamics(quasi.values())
    start = PENDULUM.state_vector(PENDULUM.starts[0])
    batch = Batch(model_in_rows(PENDULUM), 2)
    lanes = batch.start(np.array(small), np.tile(start, (2, 1)), 1e-8, np.full(2, 4.0))
    events = run(batch)
    settings = SimulationSettings(tolerance=Tolerance(relative=1e-10, absolute=1e-11))
    expected = [r.time for r in simulate(limit, start[:4], until=4.0, settings=settings).releases]
    for lane, inductance in zip(lanes, (2e-8, 2e-9), strict=True):
        found = [event.time for event in releases_of(events, lane)]
        assert found == pytest.approx(expected, abs=1e-6 + inductance / 3.0 * 10)


def test_a_neighbour_that_follows_tells_the_derivative_of_the_return():
    # The tangent direction (theta1, dtheta1, i) of the release section is not needed: any state
    # beside the release serves, as long as leader and follower leave the stop alike.
    p = np.tile(values(), (3, 1))
    x = np.tile(RELEASE, (3, 1))
    x[1, 2] += 1e-6
    x[2, 2] -= 1e-6
    batch = Batch(model_in_rows(PENDULUM), 3)
    lanes = batch.resume(p, x, 1e-7, np.full(3, 3.0), n_followers=2)
    events = run(batch)
    first = [releases_of(events, lane)[0].state for lane in lanes]
    forward, backward = (first[1] - first[0]) / 1e-6, (first[0] - first[2]) / 1e-6
    # Both one-sided differences have errors of 1e-6 times the curvature, and no noise of steps.
    assert forward == pytest.approx(backward, abs=1e-4)
    assert np.max(np.abs(forward)) > 1e-3


def test_a_motion_resumed_after_an_impact_knows_that_it_is_in_a_sequence():
    # Two impacts a turn, the second a hundredth as fast: the first one alone begins a sequence.
    table = load_problem("vibrating_table")
    shaken = table.values(parameters={"A": 0.0312, "omega": 30.0, "restitution": 0.0365}).vector
    start, until = np.array([0.0, 0.0, 1.0, 0.0]), 2.0

    def struck(begun, x, from_time):
        batch = Batch(model_in_rows(table), 1)
        begun(batch)(np.array([shaken]), np.array([x]), 1e-10, np.array([until - from_time]))
        events = [event for event in run(batch) if isinstance(event, Struck)]
        return np.array([[event.time + from_time, event.rate] for event in events]), events

    whole, events = struck(lambda batch: batch.start, start, 0.0)
    assert len(whole) > 6
    at = events[2]
    rest, _ = struck(lambda b: lambda *a: b.resume(*a, n_followers=0), at.state, at.time)
    # A local error of 1e-10 on 60 flights.
    assert rest == pytest.approx(whole[3:], abs=1e-7)


@pytest.mark.parametrize("e", [0.0, 0.3])
def test_starts_on_the_stop_begin_as_single_simulations_do(e: float) -> None:
    numbers = BALL.values(parameters={"restitution": e})
    g, speed = numbers.parameters["g"], 2.0
    starts = np.array([[0.0, speed], [0.0, -speed], [0.0, 0.0], [1e-13, 0.0], [1e-3, 0.0]])
    batch = Batch(model_in_rows(BALL), len(starts))
    p = np.tile(numbers.vector, (len(starts), 1))
    lanes = batch.start(p, starts, 1e-9, np.full(len(starts), 9.0))
    events = run(batch)
    fall = math.sqrt(2e-3 / g)
    # Thrown up: a flight, then all that follow it. Struck at once: those alone. At rest: none.
    expected = [
        2 * speed / g / (1 - e),
        2 * e * speed / g / (1 - e),
        math.nan,
        math.nan,
        fall * (1 + e) / (1 - e),
    ]
    zeno = batch._lanes.zeno_time[lanes]
    assert zeno == pytest.approx(expected, rel=1e-11, abs=1e-15, nan_ok=True)
    struck = {one.lane: one for one in reversed(events) if isinstance(one, Struck)}
    first = [struck[lane].rate if lane in struck else math.nan for lane in lanes.tolist()]
    rates = [-speed, -speed, math.nan, math.nan, -g * fall]
    assert first == pytest.approx(rates, rel=1e-9, nan_ok=True)
    ended = {event.lane: event for event in events if isinstance(event, Ended)}
    assert [ended[lane].reason for lane in lanes.tolist()] == [Reason.REST] * len(starts)


def test_starts_that_are_none_are_refused_each_for_its_reason() -> None:
    good = list(BALL.values().vector)
    place = BALL.names.index("restitution")
    p = np.array([good] * 5)
    p[3, place], p[4, place] = 1.0, -0.1
    starts = np.array([[-1e-6, 0.0], [math.nan, 0.0], [1.0, math.inf], [1.0, 0.0], [1.0, 0.0]])
    batch = Batch(model_in_rows(BALL), len(starts))
    lanes = batch.start(p, starts, 1e-9, np.full(len(starts), 9.0))
    ended = {event.lane: event for event in batch.round() if isinstance(event, Ended)}
    details = [ended[lane].detail for lane in lanes.tolist()]
    assert details[:3] == ["The start is not admissible: the gap is negative"] * 3
    assert details[3:] == ["The restitution does not lie in [0, 1)"] * 2
    assert {event.reason for event in ended.values()} == {Reason.FAILURE}


@pytest.mark.parametrize("n", [0, 1, 5, 300, 700])
def test_rows_are_called_in_blocks_and_none_is_left_out(n: int) -> None:
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y")
    function = ca.Function("f", [x, y], [x * y, ca.sum1(x) + y])
    generator = np.random.default_rng(n)
    rows, factors = generator.normal(size=(n, 2)), generator.normal(size=(n, 1))
    product, total = Columns(function)(rows, factors)
    assert product == pytest.approx(rows * factors, rel=1e-15)
    assert total == pytest.approx(rows.sum(axis=1, keepdims=True) + factors, abs=1e-15)


def test_of_two_coordinates_the_one_that_has_left_is_named() -> None:
    batch = Batch(model_in_rows(PENDULUM), 2)
    p, x = np.tile(values(), (2, 1)), np.tile(RELEASE, (2, 1))
    rows = batch.start(p, x, 1e-7, np.full(2, 9.0))
    batch._lanes.reach[rows] = 1.0
    batch._lanes.y[rows, :2] = [[0.1, 1.1e3], [0.9e3, 0.1]]
    batch._end_of_time(rows)
    ends = {event.lane: event for event in batch.round() if isinstance(event, Ended)}
    assert [(ends[lane].reason, ends[lane].detail) for lane in rows.tolist()] == [
        (Reason.ESCAPE, "theta2"),
        (Reason.HORIZON, ""),
    ]
