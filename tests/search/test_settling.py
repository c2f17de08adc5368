"""Motions that settle: to the orbit that attracts them, early, or with the reason why not."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import zeno_orbits as zo
from benchmarks.random_graphs import drawn
from benchmarks.random_graphs import problem as random_machine
from tests.reference.reference_orbit import PERIOD
from tests.support.mechanisms import spring_mass
from tests.support.random_machines import RandomMachine
from zeno_orbits.errors import InputError
from zeno_orbits.model import Problem, load_problem, own_time
from zeno_orbits.search import TransientSettings, orbit_by_shooting
from zeno_orbits.simulation import simulate


def test_the_pendulum_settles_to_the_declared_period(problem: Problem) -> None:
    found = zo.find_orbit_by_shooting(problem, start={"theta1": 0.6})
    assert found.unwrap().period == pytest.approx(PERIOD, rel=2e-12)
    assert found.miss < 1e-12


def test_a_motion_that_nearly_repeats_is_closed_before_its_time_is_over(problem: Problem) -> None:
    # Newton's method needs a motion within 0.01 of the orbit, here after two periods.
    short = zo.find_orbit_by_shooting(problem, until=2.5 * PERIOD).unwrap()
    assert short.period == pytest.approx(PERIOD, rel=2e-12)
    early = zo.find_orbit_by_shooting(problem, until=PERIOD)
    assert early.detail.startswith("The motion does not nearly repeat")


def test_a_coordinate_beyond_its_escape_is_told_in_the_words_of_the_problem() -> None:
    problem = load_problem("motor_pendulum")
    found = zo.find_orbit_by_shooting(problem, start={"theta1": 0.6, "dtheta1": 60.0})
    phrases = {escape.phrase for escape in problem.escapes.values()}
    assert found.detail in {f"{phrase[0].upper()}{phrase[1:]}." for phrase in phrases}


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
    orbit = zo.find_orbit_by_shooting(name, parameters=numbers).unwrap()
    assert orbit.period == pytest.approx(period, rel=1e-6)


@pytest.mark.parametrize("omega", [0.1, 0.03])
def test_a_table_too_slow_to_toss_anything_is_told_to_come_to_rest(omega: float) -> None:
    found = zo.find_orbit_by_shooting("vibrating_table", parameters={"omega": omega})
    assert found.detail.startswith("The motion comes to rest")


@pytest.mark.parametrize("gains", [{"Kp": 4.3, "Kd": -1.55}])
def test_a_motion_beside_an_orbit_that_repels_it_settles_to_the_doubled_one(
    gains: dict[str, float],
) -> None:
    orbit = zo.find_orbit_by_shooting("motor_pendulum", gains=gains).unwrap()
    assert orbit.shape.text == "zeno*2"
    once = zo.find_orbit_by_shooting(
        "motor_pendulum", gains=gains, shape=zo.EventSequence.parsed("zeno")
    ).unwrap()
    assert once.shape.text == "zeno"
    assert zo.verify(orbit).stable
    assert not zo.verify(once).stable


@pytest.mark.slow
def test_the_orbit_of_a_random_machine_is_the_one_that_attracts() -> None:
    # Its motion comes within 0.01 of an orbit of half the period, whose multiplier is -1.24.
    problem = random_machine(drawn(7, 0))
    orbit = zo.find_orbit_by_shooting(problem).unwrap()
    assert zo.verify(orbit, problem=problem).stable


def test_both_doors_take_every_machine_and_find_the_same_orbit() -> None:
    for name in ("motor_valve", "hopper"):
        one, other = zo.find_orbit_by_shooting(name).unwrap(), zo.find_orbit(name).unwrap()
        assert one.sequence == other.sequence
        assert one.period == other.period
        assert one.certificate == {}
        assert other.certificate["passed"]


def test_a_shape_that_the_motion_does_not_have_is_told_with_the_one_it_has() -> None:
    shape = zo.EventSequence.parsed("zeno")
    found = zo.find_orbit_by_shooting("impact_oscillator", shape=shape)
    assert found.detail == "The motion settles to an orbit of shape `impact`."


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
    orbit = orbit_by_shooting(valve, values).unwrap()
    start = valve.state_vector(valve.starts[0])
    *_, before, last = simulate(valve.dynamics(values), start, until=120.0).impacts
    assert orbit.period == pytest.approx(last.time - before.time, rel=1e-5)


def test_the_first_start_that_settles_is_taken() -> None:
    problem = load_problem("forced_oscillator")
    resting = {"distance": -2.0}
    both = replace(problem, starts=(resting, *problem.starts))
    assert orbit_by_shooting(both, both.values()).orbit is not None


@pytest.mark.parametrize("wrong", [0.0, -1.0, math.inf, math.nan])
def test_a_time_to_wait_that_is_not_positive_is_refused(wrong: float) -> None:
    with pytest.raises(InputError, match="`until` must be a finite, positive number"):
        TransientSettings(horizon=wrong)


@pytest.mark.slow
def test_an_orbit_without_a_derivative_is_found_without_multipliers() -> None:
    # A root of its force meets zero at an event.
    problem = RandomMachine(seed=20).problem()
    orbit = zo.find_orbit_by_shooting(problem).unwrap()
    assert orbit.floquet_multipliers == ()
    assert not zo.verify(orbit, problem=problem).stable
