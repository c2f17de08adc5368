"""First guesses: motions that repeat, and the reasons why others do not."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.reference.closed_forms import FORCED
from tests.reference.reference_orbit import PERIOD
from tests.support.mechanisms import (
    falling_away,
    forced_oscillator,
    oscillator_state,
    pushed_away,
    spring_mass,
)
from zeno_orbits.errors import InputError
from zeno_orbits.model import HybridDynamics, Problem, load_problem, own_time
from zeno_orbits.search import TransientSettings, run_to_attractor
from zeno_orbits.simulation import (
    simulate,
)

SHORT = TransientSettings(horizon=30.0)
LOCKED = oscillator_state(0.0, FORCED.stop, 0.0)


def test_the_pendulum_settles_to_the_declared_period(
    machine: HybridDynamics, problem: Problem
) -> None:
    settling = run_to_attractor(machine, [problem.state_vector({"theta1": 0.6})])
    assert settling.reason == ""
    assert settling.cycle is not None
    # The motion repeats to 1e-6; what is left shrinks by 0.02 a period.
    assert settling.cycle.period == pytest.approx(PERIOD, abs=1e-6)
    assert settling.cycle.drift(settling.cycle.scale()) < TransientSettings().settled


def test_a_motion_that_repeats_from_the_start_is_known_at_once() -> None:
    settling = run_to_attractor(
        forced_oscillator(FORCED, 0.5), [LOCKED], replace(SHORT, chunk=20.0)
    )
    assert settling.cycle is not None
    assert settling.cycle.period == pytest.approx(2 * math.pi, abs=1e-8)


def test_a_coordinate_beyond_its_escape_is_told_in_the_words_of_the_problem() -> None:
    problem = load_problem("motor_pendulum")
    whirling = problem.state_vector({"theta1": 0.6, "dtheta1": 60.0})
    settling = run_to_attractor(
        problem.dynamics(problem.values()), [whirling], SHORT, problem=problem
    )
    assert settling.cycle is None
    assert settling.reason in {escape.phrase for escape in problem.escapes.values()}


def test_a_mass_that_leaves_for_good_runs_away_though_nobody_says_how_far_is_far() -> None:
    # It grows by e^t: by more than e^7 = 1096 in the second half of 15 s.
    settling = run_to_attractor(
        pushed_away(1.0), [(1.0, 1.0)], TransientSettings(horizon=15.0, chunk=1.0)
    )
    assert settling.cycle is None
    assert settling.reason == "x0 runs away"


def test_a_mass_that_flies_far_at_a_steady_speed_has_not_run_away() -> None:
    settling = run_to_attractor(falling_away(1.0), [(0.0, 1.0)], SHORT)
    assert settling.reason == "no release is followed by a Zeno point after 30 s"
    assert settling.undecided


@pytest.mark.parametrize(
    ("name", "numbers", "period"),
    [
        ("forced_oscillator", {"A": 2000.0}, 2 * math.pi),
        # A table that tosses as high as 1.376 g at any frequency has the orbit of any other.
        ("vibrating_table", {"omega": 0.1, "A": 1350.0}, 2 * math.pi / 0.1),
        ("vibrating_table", {"omega": 0.03, "A": 15_000.0}, 2 * math.pi / 0.03),
        ("torque_pendulum", {"omega": 2 * math.pi / 150.0}, 150.0),
    ],
)
def test_slow_and_large_motions_are_waited_for_in_their_own_scales(
    name: str, numbers: dict[str, float], period: float
) -> None:
    problem = load_problem(name)
    dynamics = problem.dynamics(problem.values(parameters=numbers))
    starts = [problem.state_vector(start) for start in problem.starts]
    settling = run_to_attractor(dynamics, starts, problem=problem)
    assert settling.reason == ""
    assert settling.cycle is not None
    assert settling.cycle.period == pytest.approx(period, rel=1e-6)


@pytest.mark.parametrize("omega", [0.1, 0.03])
def test_a_table_too_slow_to_toss_anything_is_told_to_come_to_rest(omega: float) -> None:
    problem = load_problem("vibrating_table")
    dynamics = problem.dynamics(problem.values(parameters={"omega": omega}))
    settling = run_to_attractor(
        dynamics, [problem.state_vector(problem.starts[0])], problem=problem
    )
    assert settling.reason == "the motion comes to rest"


def test_a_mass_that_is_held_while_its_clock_turns_does_not_rest() -> None:
    # It starts on its stop, which lets go after a good part of a turn: many looks later.
    problem = load_problem("forced_oscillator")
    dynamics = problem.dynamics(problem.values())
    start = problem.state_vector(problem.starts[0])
    settling = run_to_attractor(dynamics, [start], TransientSettings(chunk=0.1), problem=problem)
    assert settling.reason == ""


def test_the_own_time_of_a_problem_is_that_of_its_clock_or_its_slowest_oscillation() -> None:
    table = load_problem("vibrating_table")
    start = np.array(table.state_vector(table.starts[0]))
    assert own_time(table.dynamics(table.values()), start) == pytest.approx(2 * math.pi / 30.0)
    spring = spring_mass(1.0, 0.5)
    assert own_time(spring, np.array([0.5, 0.0])) == pytest.approx(2 * math.pi)
    ball = load_problem("bouncing_ball")
    falling = own_time(ball.dynamics(ball.values()), np.array([1.0, 0.0]))
    assert falling == pytest.approx(2 * math.pi / math.sqrt(9.81))


@pytest.mark.parametrize("rounding", [1e-17, -1e-17])
def test_a_start_on_the_ground_has_the_own_time_of_one_a_rounding_beside_it(
    rounding: float,
) -> None:
    ball = load_problem("bouncing_ball")
    dynamics = ball.dynamics(ball.values())
    exact, rounded = (own_time(dynamics, np.array([at, 1.0])) for at in (0.0, rounding))
    assert rounded == exact


def test_a_link_on_its_stop_does_not_rest_while_a_slow_current_grows() -> None:
    # The inductance is a hundred times the valve's own: the current takes seconds to lift the link.
    valve = load_problem("motor_valve")
    values = valve.values(parameters={"L": 10.0, "restitution": 0.05})
    dynamics, start = valve.dynamics(values), valve.state_vector(valve.starts[0])
    settling = run_to_attractor(dynamics, [start], problem=valve)
    *_, before, last = simulate(dynamics, start, until=120.0).impacts
    assert settling.cycle is not None, settling.reason
    # The state repeats to `settled`, 1e-6 of its size.
    assert settling.cycle.period == pytest.approx(last.time - before.time, rel=1e-5)


def test_a_mass_at_rest_off_its_stop_rests() -> None:
    settling = run_to_attractor(spring_mass(1.0, 0.5), [(0.0, 0.0)], SHORT)
    assert settling.reason == "the motion comes to rest"
    assert not settling.undecided


def test_a_mass_that_swings_without_impacts_has_no_zeno_point() -> None:
    settling = run_to_attractor(spring_mass(1.0, 0.5), [(0.5, 0.0)], SHORT)
    assert settling.reason == "no release is followed by a Zeno point after 30 s"


def test_a_mass_that_bounces_for_ever_has_no_zeno_point(problem: Problem) -> None:
    values = problem.values(parameters={"restitution": 0.5})
    bouncing = problem.dynamics(values)
    settling = run_to_attractor(bouncing, [problem.state_vector({"theta1": 0.6})], SHORT)
    assert settling.cycle is None
    assert settling.reason.endswith("after 30 s")


def test_a_start_that_cannot_be_simulated_says_so() -> None:
    right = forced_oscillator(FORCED, 0.5)
    wrong = replace(right, reset_map=lambda x, rate: right.reset_map(x, -rate))
    settling = run_to_attractor(wrong, [LOCKED], SHORT)
    words = "the simulation fails: the reset map sends the state into the stop"
    assert settling.reason.lower() == words


def test_the_first_start_that_settles_is_taken() -> None:
    settling = run_to_attractor(
        forced_oscillator(FORCED, 0.5), [(-2.0, 0.0, 0.0, 0.0), LOCKED], SHORT
    )
    assert settling.cycle is not None


def test_every_reason_is_told_once() -> None:
    resting, swinging = (0.0, 0.0), (0.5, 0.0)
    settling = run_to_attractor(spring_mass(1.0, 0.5), [resting, swinging, resting], SHORT)
    assert settling.reason == (
        "the motion comes to rest / no release is followed by a Zeno point after 30 s"
    )


def test_a_motion_that_still_drifts_is_a_guess_if_it_drifts_little(
    machine: HybridDynamics, problem: Problem
) -> None:
    # With a multiplier of 0.02 the third or fourth period repeats to 1e-3 but not to 1e-15.
    start = problem.state_vector({"theta1": 0.6})
    strict = TransientSettings(horizon=10.0, settled=0.0)
    assert run_to_attractor(machine, [start], strict).cycle is not None
    hopeless = run_to_attractor(machine, [start], replace(strict, usable=0.0))
    assert hopeless.cycle is None
    assert hopeless.reason == "its periods differ after 10 s"


@pytest.mark.parametrize(
    ("what", "numbers"),
    [
        ("clock", {"rho": 0.2, "lean": 0.15, "c": 0.02}),
        ("stop", {"rho": 0.05, "lean": 0.4, "c": 0.05}),
    ],
)
def test_a_long_loose_simulation_does_not_drift_off_what_a_start_has_to_keep(
    what: str, numbers: dict[str, float]
) -> None:
    # Without being put back, the state leaves clock or stop by 1e-8, and no simulation admits it.
    problem = load_problem("curved_surface")
    dynamics = problem.dynamics(problem.values(parameters=numbers))
    settling = run_to_attractor(dynamics, [problem.state_vector(start) for start in problem.starts])
    assert (settling.cycle is not None) == (what == "clock")


def test_a_motion_that_comes_back_after_more_than_a_chunk_is_found() -> None:
    # The period is 2 pi; every look but those from a release is shorter by far.
    settling = run_to_attractor(forced_oscillator(FORCED, 0.5), [LOCKED], replace(SHORT, chunk=1.0))
    assert settling.cycle is not None
    assert settling.cycle.period == pytest.approx(2 * math.pi, abs=1e-8)


# Limits of the wait.


@pytest.mark.parametrize("wrong", [0.0, -1.0, math.inf, math.nan])
def test_a_time_to_wait_that_is_not_positive_is_refused(wrong: float) -> None:
    with pytest.raises(InputError, match="`until` must be a finite, positive number"):
        TransientSettings(horizon=wrong)
    with pytest.raises(InputError, match="`chunk` must be a finite, positive number"):
        TransientSettings(chunk=wrong)


# A period made anew.
