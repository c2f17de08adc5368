"""The loop and the plain simulator carry out the same execution, event by event."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.loop.agreement import (
    difference,
    followed,
    looped,
    n_implicit,
    needs_compiler,
    numbers_of,
    require_close,
    require_equal,
    task_of,
)
from tests.support.cases import fast
from tests.support.families import BALL, CART
from tests.support.mechanisms import numeric, slider
from tests.support.one_stop import one_stop_problems
from tests.support.units import Units, in_units
from zeno_orbits import HybridLagrangian
from zeno_orbits.errors import PenetrationError, RunawayError, SimulationError
from zeno_orbits.integrators import Automatic, Radau, RungeKutta, Tolerance
from zeno_orbits.simulation import (
    FixedImpacts,
    Mode,
    PlasticAfter,
    SimulationSettings,
    SimulationTask,
    Truncation,
    ZenoExtrapolation,
    ZenoPassage,
    by_reference,
    simulate,
)

pytestmark = needs_compiler

STARTS = [
    (name, start)
    for name in one_stop_problems()
    for start in range(len(zo.load_problem(name).starts))
]
EXPLICIT = SimulationSettings(engine=RungeKutta())
STIFF = {"motor_cart", "motor_pendulum", "two_motors"}

ROUNDING = 1e-11
"""Implicit steps are chosen by an error estimate whose last digits differ: their ends differ by
rounding, and a few seconds of motion magnify that. Up to 1.6e-12 was seen."""


@pytest.mark.parametrize(("name", "start"), fast(3, [one for one in STARTS if one[0] in STIFF]))
def test_explicit_steps_give_the_same_bits(name: str, start: int) -> None:
    run = require_equal(task_of(zo.load_problem(name), until=2.0, start=start, settings=EXPLICIT))
    assert run is not None
    assert n_implicit(run) == 0


@pytest.mark.parametrize(("name", "start"), fast(8, STARTS))
def test_the_default_engine_gives_the_same_to_rounding(name: str, start: int) -> None:
    task = task_of(zo.load_problem(name), until=2.0, start=start)
    if name in STIFF:
        # The test above compares their explicit steps.
        run = require_close(task, ROUNDING)
        assert run is not None
        assert n_implicit(run) > 0
    else:
        run = require_equal(task)
        assert run is not None
        assert n_implicit(run) == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", list(one_stop_problems())[::3])
def test_implicit_steps_alone_give_the_same_to_rounding(name: str) -> None:
    settings = SimulationSettings(engine=Radau())
    run = require_close(task_of(zo.load_problem(name), until=2.0, settings=settings), ROUNDING)
    assert run is not None
    assert n_implicit(run) > 0


@pytest.mark.parametrize("restitution", [0.0, 0.05, 0.5, 0.9])
@pytest.mark.parametrize("name", ["curved_surface", "falling_pendulum", "vibrating_table"])
def test_it_is_the_same_at_any_restitution(name: str, restitution: float) -> None:
    problem = zo.load_problem(name)
    task = task_of(problem, until=3.0, values={"restitution": restitution})
    run = require_equal(task)
    assert run is not None
    assert run.impacts
    if restitution == 0.0:
        # A plastic impact is its own Zeno point: it has no tail.
        assert all(point.tail == 0.0 for point in run.zeno_points)
        assert run.zeno_points


@pytest.mark.parametrize("restitution", [0.99, 0.999])
@pytest.mark.parametrize("name", ["bouncing_ball", "vibrating_table", "torque_pendulum"])
def test_near_one_the_curve_of_the_impacts_is_followed_alike(name: str, restitution: float) -> None:
    problem = zo.load_problem(name)
    run = require_equal(task_of(problem, until=6.0, values={"restitution": restitution}))
    assert run is not None


def test_a_curve_that_is_found_is_recorded_with_its_states() -> None:
    height, e, g = 1.0, 0.99, 9.81
    ball = zo.load_problem("bouncing_ball")
    fall = math.sqrt(2 * height / g)
    # Twice the geometric series of the flights, less the first half flight.
    zeno = fall * (1 + e) / (1 - e)
    task = task_of(ball, until=zeno + 1.0, values={"restitution": e})
    task = replace(task, state=np.array([height, 0.0]))
    run = require_equal(task)
    assert run is not None
    (point,) = run.zeno_points
    assert point.time == pytest.approx(zeno, rel=1e-11)
    tail = next(arc for arc in run.arcs if arc.end_time == point.time)
    assert tail.trajectory is not None


@pytest.mark.parametrize(
    "completion",
    [
        ZenoExtrapolation(),
        ZenoExtrapolation(tolerance=1e-9, resolved=0.1),
        ZenoPassage(tolerance=1e-9),
        Truncation(delta=0.01),
        FixedImpacts(n_impacts=3),
        PlasticAfter(n_impacts=3),
    ],
    ids=lambda rule: type(rule).__name__,
)
@pytest.mark.parametrize("name", ["curved_surface", "motor_valve"])
def test_every_rule_of_completion_is_the_same(name: str, completion: object) -> None:
    settings = SimulationSettings(completion=completion)  # type: ignore[arg-type]
    run = require_equal(task_of(zo.load_problem(name), until=2.0, settings=settings))
    assert run is not None
    assert run.zeno_points


@pytest.mark.parametrize("relative", [1e-4, 1e-6, 1e-9, 1e-13])
def test_every_tolerance_gives_the_same(relative: float) -> None:
    settings = SimulationSettings(tolerance=Tolerance(relative=relative, absolute=relative / 10))
    run = require_equal(task_of(zo.load_problem("motor_valve"), until=2.0, settings=settings))
    assert run is not None


@pytest.mark.parametrize("largest", [0.3, 0.01])
def test_a_largest_step_is_kept(largest: float) -> None:
    engine = Automatic(explicit=RungeKutta(largest_step=largest))
    settings = SimulationSettings(engine=engine)
    run = require_equal(task_of(zo.load_problem("vibrating_table"), until=2.0, settings=settings))
    assert run is not None
    assert max(np.max(np.diff(arc.flow_times)) for arc in run.arcs) <= largest * (1 + 1e-12)


@pytest.mark.parametrize(
    "limits",
    [{"most_releases": 1}, {"most_releases": 3}, {"most_impacts": 1}, {"most_impacts": 7}],
    ids=str,
)
def test_a_count_of_releases_or_impacts_ends_both(limits: dict[str, float]) -> None:
    run = require_equal(task_of(zo.load_problem("curved_surface"), until=9.0, **limits))
    assert run is not None
    counted = run.releases if "most_releases" in limits else run.impacts
    assert len(counted) == next(iter(limits.values()))


# Limits and errors: the same kind, words, time and state.


@pytest.mark.parametrize("most_steps", [1, 2, 17, 60])
def test_too_many_steps_end_both_at_the_same_place(most_steps: int) -> None:
    settings = SimulationSettings(most_steps=most_steps)
    task = task_of(zo.load_problem("curved_surface"), until=9.0, settings=settings)
    require_equal(task)
    assert isinstance(looped(task).error, SimulationError)


@pytest.mark.parametrize("far", [1e-9, 0.2, (0.3, 0.1), [0.3, 0.1]])
def test_a_coordinate_beyond_its_bound_ends_both(far: Any) -> None:
    settings = SimulationSettings(far=far)
    task = task_of(zo.load_problem("torque_pendulum"), until=9.0, settings=settings)
    require_equal(task)
    assert isinstance(looped(task).error, RunawayError)


@pytest.mark.slow
def test_a_velocity_that_grows_without_end_ends_both() -> None:
    # `x'' = 100 x'`: the speed grows by e^100 a second, and its steps do not get longer. The
    # fourth look comes after 200 000 of them.
    cart = BALL.at(m=1.0, g=-9.81, c=-100.0, e=0.5)
    settings = SimulationSettings(engine=RungeKutta(largest_step=1e-5), most_steps=1_000_000)
    task = SimulationTask(dynamics=cart, state=np.array([1.0, 1.0]), until=1e4, settings=settings)
    require_equal(task)
    error = looped(task).error
    assert isinstance(error, RunawayError)
    assert "grows without bound" in error.reason


def test_impacts_without_a_zeno_point_end_both() -> None:
    settings = SimulationSettings(most_impacts=4)
    task = task_of(
        zo.load_problem("bouncing_ball"), until=9.0, settings=settings, values={"restitution": 0.9}
    )
    require_equal(task)
    assert "4 impacts" in str(looped(task).error)


@pytest.mark.parametrize(
    ("name", "until", "numbers"),
    [
        ("bouncing_ball", 40.0, {}),
        ("vibrating_table", 10.0, {}),
        ("impact_oscillator", 60.0, {"c": 0.0, "stop": 0.2}),
    ],
)
def test_elastic_impacts_are_the_same(name: str, until: float, numbers: dict[str, float]) -> None:
    for restitution in (1.0, 1.0 - 1e-12):
        values = {**numbers, "restitution": restitution}
        run = require_equal(task_of(zo.load_problem(name), until=until, values=values))
        assert run is not None
        assert len(run.impacts) > 8
        assert not run.zeno_points


def test_elastic_impacts_end_both_at_their_limit() -> None:
    settings = SimulationSettings(most_impacts=6)
    ball, values = zo.load_problem("bouncing_ball"), {"restitution": 1.0}
    task = task_of(ball, until=90.0, settings=settings, values=values)
    require_equal(task)
    assert "6 impacts" in str(looped(task).error)


def test_a_flow_that_leaves_the_doubles_ends_both() -> None:
    rising = BALL.at(m=1.0, g=-9.81, c=0.0, e=0.5)
    task = SimulationTask(dynamics=rising, state=np.array([1.0, 0.0]), until=1e200)
    require_equal(task)
    assert looped(task).error is not None


def test_a_reset_map_that_is_replaced_is_the_one_that_is_used() -> None:
    # The formulas no longer stand for the system, so the plain simulator has to run.
    ball = BALL.at(m=1.0, g=9.81, c=0.0, e=0.5)
    wrong = replace(ball, reset_map=lambda x, _: np.array([x[0], -1.0]))
    with pytest.raises(PenetrationError):
        simulate(wrong, (1.0, 0.0), until=3.0)


# Grazes, and stops that let go within rounding.


@pytest.mark.parametrize("seed", range(12))
def test_a_graze_is_the_same(seed: int) -> None:
    # `x'' = -x` swings just as far as its stop: whether it touches is a matter of the last digit.
    drawn = np.random.default_rng(seed)
    problem = zo.load_problem("impact_oscillator")
    task = task_of(problem, until=20.0)
    state = task.state.copy()
    state[:2] += 10.0 ** drawn.uniform(-9, -1, 2)
    require_equal(replace(task, state=state))


@pytest.mark.parametrize("turn", [-1e-3, -1e-5, -1e-6, -1e-9, -1e-12])
def test_a_stop_that_lets_go_within_rounding_is_the_same(turn: float) -> None:
    dynamics = CART.at(M=1.0, m=0.5, l=0.7, g=9.81, wall=-0.2, e=0.0)
    state = np.array([0.3, 0.0, -2.0, turn])
    require_equal(SimulationTask(dynamics=dynamics, state=state, until=1.0))


@pytest.mark.parametrize("size", [1.0, 1e-3])
def test_a_bump_that_the_scaled_gap_does_not_feel_is_the_same(size: float) -> None:
    # After its first impact the ball flies into a bump that is thinner than a step.
    fall, restitution, along = math.sqrt(2 * size / 9.81), 0.6, 2.0 * math.sqrt(size)
    centre = along * fall * (1 + 0.7 * restitution)
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    bump = 0.4 * size * ca.exp(-(((q[0] - centre) / (3e-3 * size)) ** 2))
    machine = HybridLagrangian.from_energies(
        q=q, v=v, kinetic=ca.sumsqr(v) / 2, potential=9.81 * q[1], gap=q[1] - bump
    )
    task = SimulationTask(
        dynamics=numeric(machine, restitution=restitution),
        state=np.array([0.0, size, along, 0.0]),
        until=fall * (1 + restitution),
        settings=EXPLICIT,
    )
    run = require_equal(task)
    assert run is not None
    assert len(run.impacts) > 1


@pytest.mark.parametrize("width", [1.0, 0.1, 1e-3])
def test_a_narrow_magnet_under_the_stop_is_the_same(width: float) -> None:
    dynamics = slider(lambda x: 1.5 * ca.exp(-(((x - 3) / width) ** 2)) - 1)
    state = np.array([0.0, 0.0, 1.0, 0.0])
    task = SimulationTask(dynamics=dynamics, state=state, until=5.0)
    run = require_equal(task)
    assert run is not None
    # The multiplier is 1 - pull: it is zero where the pull has risen to 1.
    let_go = 3 - width * math.sqrt(math.log(1.5))
    assert run.releases[0].time == pytest.approx(let_go, rel=1e-9)


@pytest.mark.parametrize("excess", [4e-13, 1e-11, 1e-9, 2e-7, 1e-5])
def test_a_flight_below_the_rounding_of_the_gap_is_the_same(excess: float) -> None:
    dynamics = slider(lambda x: excess - (x - 1) ** 2)
    state = np.array([0.0, 0.0, 1.0, 0.0])
    run = require_equal(SimulationTask(dynamics=dynamics, state=state, until=2.0))
    assert run is not None
    assert run.impacts
    # From the release at 1 - s the gap closes 4 s later.
    half = math.sqrt(excess)
    assert run.impacts[0].time == pytest.approx(1 + 3 * half, abs=1e-14 + 2e-15 / half)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_a_start_at_zero_multiplier_is_the_same(order: int, sign: float) -> None:
    dynamics = slider(lambda x: sign * x**order)
    state = np.array([0.0, 0.0, 1.0, 0.0])
    run = require_equal(SimulationTask(dynamics=dynamics, state=state, until=1.0))
    assert run is not None
    assert [arc.mode for arc in run.arcs] == [Mode.FREE if sign > 0.0 else Mode.LOCKED]


@pytest.mark.slow
def test_starts_on_the_stop_are_the_same() -> None:
    problem = zo.load_problem("vibrating_table")
    task = task_of(problem, until=2.0)
    drawn = np.random.default_rng(1)
    for rate in (0.0, 1e-13, -1e-13, 1e-3, -1e-3, -2.0, 2.0, 1e-300):
        state = task.state.copy()
        turn = drawn.uniform(0, 2 * math.pi)
        state[2:4] = math.cos(turn), math.sin(turn)
        on_stop = task.dynamics.on_stop(state)
        direction = task.dynamics.impulse_direction(on_stop)
        require_equal(replace(task, state=on_stop + rate * direction))


# Units far from those of everyday.


@pytest.mark.parametrize(
    "units",
    fast(2, [Units(length=1e3), Units(length=1e-6, mass=1e6), Units(time=1e6), Units(time=1e-6)]),
    ids=str,
)
@pytest.mark.parametrize("name", ["vibrating_table", "curved_surface"])
def test_in_far_units_it_is_the_same(name: str, units: Units) -> None:
    problem = in_units(zo.load_problem(name), units)
    run = require_equal(task_of(problem, until=2.0 * units.time))
    assert run is not None
    assert run.impacts


# Dense output.


@pytest.mark.parametrize("name", ["motor_pendulum", "curved_surface"])
def test_states_between_events_are_the_same(name: str) -> None:
    task = task_of(zo.load_problem(name), until=2.0)
    found, expected = looped(task).execution, followed(task).execution
    assert found is not None
    assert expected is not None
    for time in np.linspace(0.0, 2.0, 137):
        mine, other = found.state_at(float(time)), expected.state_at(float(time))
        # Inside an implicit step both read a polynomial that is good to the tolerance.
        assert mine == pytest.approx(other, rel=1e-10, abs=1e-10)


def test_an_execution_can_be_changed_like_any_other() -> None:
    run = looped(task_of(zo.load_problem("bouncing_ball"), until=2.0)).execution
    assert run is not None
    end = run.end_time, run.end_state.tolist()
    assert end == (run.arcs[-1].end_time, run.arcs[-1].end_state.tolist())
    shorter = replace(run, arcs=run.arcs[:1])
    assert shorter.end_time == run.arcs[0].end_time
    fewer = replace(run, events=run.events[:1])
    assert len(fewer.events) == 1
    assert len(numbers_of(fewer)) < len(numbers_of(run))
    assert difference(replace(run, events=run.events), run) == 0.0


@pytest.mark.parametrize("rounding", range(-8, 9))
def test_an_impact_within_rounding_of_the_end_is_no_start_of_an_arc(rounding: int) -> None:
    # A ball from 1 m: the impact is at sqrt(2 / g), to a few spacings of the numbers there.
    task = task_of(zo.load_problem("bouncing_ball"), until=1.0)
    until = math.sqrt(2.0 / 9.81) + rounding * math.ulp(0.45)
    found = looped(replace(task, until=until)).execution
    expected = by_reference(replace(task, until=until))
    assert found is not None
    assert len(found.events) == len(expected.events)
    assert found.end_time == expected.end_time == until
    assert all(arc.end_time > arc.start_time for arc in found.arcs)
