"""Taylor's method: no fall missed, none invented, and the same executions as the other engines."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from tests.reference.reference_orbit import (
    FIRST_IMPACT,
    FIRST_RATE,
    PERIOD,
    RELEASE,
    ZENO_STATE,
    ZENO_TIME,
)
from tests.support.mechanisms import GRAVITY, falling_away
from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, PenetrationError, SimulationError, StepSizeError
from zeno_orbits.integrators import Leg, Outcome, Passage, RungeKutta, Taylor
from zeno_orbits.integrators.flow import GuardedFlow, PlainFlow, Tolerance
from zeno_orbits.integrators.taylor import engine
from zeno_orbits.integrators.taylor import modes as series
from zeno_orbits.model.library import load_problem
from zeno_orbits.model.numeric.compiled import bind
from zeno_orbits.model.numeric.compiled_flow import CompiledFlow, mode_functions
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.simulation.simulator import SimulationSettings, simulate

heyoka: Any = pytest.importorskip("heyoka")

TIGHT = Tolerance(relative=1e-12, absolute=1e-13)
SETTINGS = SimulationSettings(engine=Taylor(), tolerance=TIGHT)
LOCATED = 1e-14
"""heyoka's roots are right to a few roundings of the step; steps here have size 1 to 3."""


@pytest.fixture(name="pendulum", scope="module")
def _pendulum() -> HybridDynamics:
    problem = load_problem("motor_pendulum")
    return problem.dynamics(problem.values())


@pytest.fixture(name="ball", scope="module")
def _ball() -> HybridDynamics:
    problem = load_problem("bouncing_ball")
    return problem.dynamics(problem.values(parameters={"restitution": 0.5}))


@pytest.fixture(name="walked")
def _walked(monkeypatch: pytest.MonkeyPatch) -> list[Leg]:
    """Collect the legs that are followed step by step after all."""
    legs: list[Leg] = []
    follow_steps = engine.follow_steps

    def spied(steps: Any, leg: Leg) -> Passage:
        legs.append(leg)
        return follow_steps(steps, leg)

    monkeypatch.setattr(engine, "follow_steps", spied)
    return legs


@pytest.fixture(name="no_nudge")
def _no_nudge(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let heyoka meet a guard of exactly zero."""
    series._carrier.cache_clear()
    monkeypatch.setattr(series, "NUDGE", 0.0)
    yield
    series._carrier.cache_clear()


def _clock(guard: Callable[[Any], Any]) -> GuardedFlow:
    """Return a clock ``y' = 1`` with a guard that is a function of its time."""
    y, p = ca.SX.sym("y"), ca.SX(0, 1)
    pair = ca.vertcat(guard(y), ca.jacobian(guard(y), y))
    return CompiledFlow(mode_functions("clock", y, p, ca.SX(1), pair), np.zeros(0))


def _leg(flow: GuardedFlow, y: Any, *, on_guard: bool = False, **others: Any) -> Leg:
    given = {"horizon": 10.0, "tolerance": TIGHT, **others}
    return Leg(flow=flow, y=np.array(y, dtype=np.float64), on_guard=on_guard, **given)


def _follow(flow: GuardedFlow, y: Any, *, on_guard: bool = False, **others: Any) -> Passage:
    return Taylor().follow(_leg(flow, y, on_guard=on_guard, **others))


# The reference orbit.


def test_the_reference_orbit_has_its_period_impact_and_zeno_point(
    pendulum: HybridDynamics, walked: list[Leg]
) -> None:
    execution = simulate(pendulum, RELEASE, until=5.0, releases=1, settings=SETTINGS)
    assert execution.releases[0].time == pytest.approx(PERIOD, abs=1e-13)
    assert execution.impacts[0].time == pytest.approx(FIRST_IMPACT, abs=1e-12)
    assert execution.impacts[0].approach_rate == pytest.approx(FIRST_RATE, abs=1e-12)
    assert execution.zeno_points[0].time == pytest.approx(ZENO_TIME, abs=1e-12)
    assert execution.zeno_points[0].state == pytest.approx(np.array(ZENO_STATE), abs=2e-12)
    assert not walked


@pytest.mark.parametrize("seed", range(6))
def test_whole_executions_are_those_of_the_runge_kutta_engine(
    pendulum: HybridDynamics, seed: int
) -> None:
    random = np.random.default_rng(seed)
    start = (random.uniform(-1, 1), random.uniform(0.0, 1.5), *random.uniform(-3, 3, 2), 0.0)
    own = simulate(pendulum, start, until=4.0, settings=SETTINGS)
    other = SimulationSettings(engine=RungeKutta(), tolerance=TIGHT)
    theirs = simulate(pendulum, start, until=4.0, settings=other)
    assert [type(event) for event in own.events] == [type(event) for event in theirs.events]
    times = [event.time for event in theirs.events]
    assert [event.time for event in own.events] == pytest.approx(times, abs=1e-9)
    assert own.end_state == pytest.approx(theirs.end_state, abs=1e-8)


# No fall is missed.


@pytest.mark.parametrize("relative", [1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize("name", ["torque_pendulum", "two_motors", "motor_valve"])
def test_a_coarse_run_misses_no_impact(name: str, relative: float) -> None:
    """After a false root heyoka looks away for a while, the longer the coarser it is."""
    problem = load_problem(name)
    dynamics = problem.dynamics(problem.values())
    start = problem.state_vector(problem.starts[0])
    rough = Tolerance(relative=relative, absolute=relative / 10)
    runs = [
        simulate(dynamics, start, until=4.0, settings=settings)
        for settings in (
            SimulationSettings(engine=Taylor(), tolerance=rough),
            SimulationSettings(engine=RungeKutta()),
        )
    ]
    assert runs[1].zeno_points
    first, second = ([point.time for point in run.zeno_points] for run in runs)
    # Looser by what a run at 1e-2 is off, and far below the time between two of them.
    assert first == pytest.approx(second, abs=1e-2)


@pytest.mark.parametrize("speed", [10.0, 1.0, 1e-3, 1e-6, 1e-9, 1e-12, 1e-30, 1e-100, 1e-290])
def test_a_rescaled_flight_of_the_ball_lasts_as_long_as_in_the_closed_form(
    ball: HybridDynamics, speed: float, walked: list[Leg]
) -> None:
    start = (0.0, speed, 0.0, 1.0)
    passage = _follow(ball.flight(speed), start, on_guard=True, horizon=min(20 / speed, 1e280))
    assert passage.outcome is Outcome.FALL
    assert passage.duration == pytest.approx(2 / GRAVITY, rel=1e-14)
    assert passage.state[-2:] == pytest.approx(np.array([0.0, -1.0]), abs=1e-14)
    assert not walked


def test_heyoka_alone_misses_the_fall_after_a_start_of_exactly_zero(ball: HybridDynamics) -> None:
    # eta' = nu, nu' = -g from (0, 1): one step from the start reaches past the fall at 2 / g.
    eta, nu = heyoka.make_vars("eta", "nu")
    event = heyoka.t_event(eta, direction=heyoka.event_direction.negative)
    gravity = heyoka.expression(-GRAVITY)
    alone = heyoka.taylor_adaptive([(eta, nu), (nu, gravity)], [0.0, 1.0], t_events=[event])
    outcome = alone.propagate_until(1.0)[0]
    assert outcome == heyoka.taylor_outcome.time_limit
    assert alone.state[0] < 0.0
    assert _follow(ball.flight(1.0), (0, 1, 0, 1), on_guard=True).outcome is Outcome.FALL


@pytest.mark.usefixtures("no_nudge")
@pytest.mark.parametrize("speed", [1.0, 1e-6])
def test_the_net_catches_a_fall_that_heyoka_missed(
    ball: HybridDynamics, speed: float, walked: list[Leg]
) -> None:
    passage = _follow(ball.flight(speed), (0.0, speed, 0.0, 1.0), on_guard=True)
    assert len(walked) == 1
    assert passage.outcome is Outcome.FALL
    assert passage.duration == pytest.approx(2 / GRAVITY, rel=1e-14)


@pytest.mark.usefixtures("no_nudge")
def test_without_the_net_the_end_of_the_leg_betrays_the_missed_fall(
    ball: HybridDynamics, walked: list[Leg], monkeypatch: pytest.MonkeyPatch
) -> None:
    set_net = series.Carrier.set_net
    monkeypatch.setattr(series.Carrier, "set_net", lambda kept, _: set_net(kept, 1e6))
    passage = _follow(ball.flight(1.0), (0, 1, 0, 1), on_guard=True)
    assert len(walked) == 1
    assert passage.duration == pytest.approx(2 / GRAVITY, rel=1e-14)


@pytest.mark.usefixtures("no_nudge")
def test_an_execution_in_which_heyoka_misses_every_impact_is_the_same(
    pendulum: HybridDynamics, walked: list[Leg]
) -> None:
    execution = simulate(pendulum, RELEASE, until=5.0, releases=1, settings=SETTINGS)
    assert execution.releases[0].time == pytest.approx(PERIOD, abs=1e-12)
    assert len(walked) >= 5


@pytest.mark.parametrize("width", [0.3, 1e-2, 1e-5])
def test_a_dip_inside_one_step_is_found_at_its_first_root(width: float) -> None:
    passage = _follow(_clock(lambda t: (t - 0.53) ** 2 - width**2), [0.0])
    # Near a shallow dip the rounding of the guard counts, divided by its slope there.
    assert passage.duration == pytest.approx(0.53 - width, abs=LOCATED + 2.0**-52 / width)


def test_of_two_falls_in_one_step_the_first_counts() -> None:
    passage = _follow(_clock(lambda t: ca.cos(2 * math.pi * t) + 0.5), [0.0])
    assert passage.duration == pytest.approx(1 / 3, abs=LOCATED)


def test_a_rise_counts_for_nothing() -> None:
    passage = _follow(_clock(lambda t: t * (t - 1) * (t - 2) + t * 1e-3), [0.0], on_guard=True)
    # It rises from zero, falls near 1, and would rise again near 2.
    assert passage.outcome is Outcome.FALL
    assert passage.duration == pytest.approx(1.5 - math.sqrt(0.25 - 1e-3), abs=LOCATED)


# And none is invented.


@pytest.mark.parametrize("rate", [0.0, 1e-17, -1e-17, 1e-14])
@pytest.mark.parametrize("bend", [0.0, 1e-15, -1e-15, -1e-13])
def test_a_start_with_third_order_contact_does_not_fall_by_rounding(
    rate: float, bend: float
) -> None:
    flow = _clock(lambda t: rate * t + bend * t**2 + t**3 * (1 - t))
    passage = _follow(flow, [0.0], on_guard=True, rounding=1e-12)
    assert passage.outcome is Outcome.FALL
    # Near 1 the guard falls at the rate -1.
    assert passage.duration == pytest.approx(1.0 + rate + bend, abs=2 * LOCATED)


def test_a_flow_that_leaves_the_guard_on_the_wrong_side_is_told(walked: list[Leg]) -> None:
    passage = _follow(falling_away(-1.0).free, (0.0, 0.0), on_guard=True, rounding=1e-12)
    assert passage.outcome is Outcome.LEFT
    assert passage.duration < 1e-3
    assert walked
    slow = _follow(_clock(lambda t: -(t**3)), [0.0], on_guard=True, rounding=1e-12)
    assert slow.outcome is Outcome.LEFT


def test_a_false_model_is_refused_as_with_other_engines() -> None:
    with pytest.raises(PenetrationError):
        simulate(_sunken(), (0.0, 0.0), until=1.0, settings=SETTINGS)


def _sunken() -> HybridDynamics:
    """Return a mass that is drawn into its stop while the functions say that it is not."""
    inwards = falling_away(-1.0)
    return replace(inwards, gap_acceleration=lambda _: 0.0, multiplier_rate=lambda _: -1.0)


def test_a_leg_that_stays_off_its_guard_ends_with_its_time() -> None:
    passage = _follow(_clock(lambda t: 1.0 + t), [0.0], horizon=2.5)
    assert passage.outcome is Outcome.HORIZON
    assert passage.duration == 2.5
    assert passage.state == pytest.approx(np.array([2.5]), rel=LOCATED)


def test_a_fall_after_the_time_is_over_is_none() -> None:
    assert _follow(_clock(lambda t: 1 - t), [0.0], horizon=0.999).outcome is Outcome.HORIZON


def test_many_batches_of_steps_make_one_leg() -> None:
    y = ca.SX.sym("y", 3)
    rate, guard = ca.vertcat(y[1], -y[0], 1), ca.vertcat(900 - y[2], -1)
    flow = CompiledFlow(mode_functions("long", y, ca.SX(0, 1), rate, guard), np.zeros(0))
    counts: list[int] = []
    passage = _follow(flow, [0, 1, 0], horizon=1e4, watch=lambda steps, *_: counts.append(steps))
    assert len(counts) > 1
    assert sum(counts) > series_steps(900.0)
    assert passage.duration == pytest.approx(900.0, rel=LOCATED)
    assert passage.state[0] == pytest.approx(math.sin(900.0), abs=1e-10)


def series_steps(duration: float) -> float:
    """Return fewer steps than a harmonic oscillator takes at the order for this tolerance."""
    # A series of order 16 of a sine is right to 1e-13 up to a time of about 2.
    return duration / 8


# Errors and watching.


def test_a_flow_that_blows_up_is_an_error_with_its_time_and_state() -> None:
    y = ca.SX.sym("y")
    mode = mode_functions("blow_up", y, ca.SX(0, 1), y**2, ca.vertcat(y, y**2))
    with pytest.raises(StepSizeError) as stop:
        _follow(CompiledFlow(mode, np.zeros(0)), [1.0])
    assert stop.value.time == pytest.approx(1.0, abs=1e-6)
    assert math.isfinite(stop.value.state[0])


def test_a_start_that_is_not_finite_is_an_error(ball: HybridDynamics) -> None:
    with pytest.raises(StepSizeError):
        _follow(ball.free, (math.nan, 0.0))


def test_a_watch_may_end_the_leg(pendulum: HybridDynamics) -> None:
    def enough(steps: int, time: float, state: Vector) -> None:
        raise SimulationError(f"{steps} steps", time=time, state=tuple(state.tolist()))

    with pytest.raises(SimulationError, match="steps"):
        _follow(pendulum.free, RELEASE, on_guard=True, watch=enough)
    settings = SimulationSettings(engine=Taylor(), most_steps=50)
    with pytest.raises(SimulationError, match="more than 50 steps"):
        simulate(pendulum, RELEASE, until=20.0, settings=settings)


def test_a_model_written_by_hand_is_refused() -> None:
    by_hand = PlainFlow(field=lambda y: y, guard_and_rate=lambda _: (1.0, 0.0))
    with pytest.raises(
        InputError, match=r"must come from formulas .* it is a PlainFlow"
    ) as refusal:
        _follow(by_hand, [1.0])
    assert "\n" not in str(refusal.value)


def test_without_heyoka_the_extra_is_named(
    ball: HybridDynamics, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(name: str) -> None:
        raise ModuleNotFoundError(f"No module named {name!r}")

    monkeypatch.setattr(importlib, "import_module", missing)
    series._carrier.cache_clear()
    with pytest.raises(InputError, match=r"zeno_orbits\[taylor\]"):
        _follow(ball.free, (1.0, 0.0))


def test_heyoka_prints_nothing(ball: HybridDynamics, capfd: pytest.CaptureFixture[str]) -> None:
    # A step of this length overflows heyoka's root finder, which tells so on the standard output.
    start = np.array([0.0, 1e-200, 0.0, 1.0])
    kept = series.carrier(series.symbols_of(ball.flight(1e-200))[0], 1e-13, start)
    flow = ball.flight(1e-200)
    kept.begin(np.array([0.0, 1e-200, 0.0, 1.0]), series.symbols_of(flow)[1])
    kept.advance(1e250, 1e250, 10)
    assert capfd.readouterr() == ("", "")


# What is kept, and what is looked at later.


def test_new_gains_compile_nothing() -> None:
    problem = load_problem("motor_pendulum")
    functions = problem.compiled()
    counts: list[int] = []
    for stiffness in (2.5, 2.6, 3.0):
        values = problem.values(gains={"Kp": stiffness})
        simulate(bind(functions, values.vector), RELEASE, until=3.0, settings=SETTINGS)
        counts.append(series._carrier.cache_info().misses)
    assert len(set(counts)) == 1


def test_a_large_model_is_compiled_as_calls_and_moves_the_same(
    pendulum: HybridDynamics, monkeypatch: pytest.MonkeyPatch
) -> None:
    inlined = _follow(pendulum.free, RELEASE, on_guard=True, rounding=1e-12)
    monkeypatch.setattr(series, "_LARGE", 0)
    series._carrier.cache_clear()
    called = _follow(pendulum.free, RELEASE, on_guard=True, rounding=1e-12)
    series._carrier.cache_clear()
    assert called.duration == pytest.approx(inlined.duration, abs=1e-13)
    assert called.state == pytest.approx(inlined.state, abs=1e-12)


def test_the_way_is_integrated_again_when_it_is_asked_for(pendulum: HybridDynamics) -> None:
    own = _follow(pendulum.free, RELEASE, on_guard=True, rounding=1e-12)
    leg = _leg(pendulum.free, RELEASE, on_guard=True, rounding=1e-12)
    theirs = RungeKutta().follow(leg)
    times, states = own.trajectory.times, own.trajectory.states
    assert times[0] == 0.0
    assert times[-1] == own.duration
    assert np.all(np.diff(times) > 0.0)
    assert states[0] == pytest.approx(np.array(RELEASE), abs=0.0)
    assert states[-1] == pytest.approx(own.state, abs=0.0)
    for time in np.linspace(0.0, own.duration, 40).tolist():
        expected = theirs.trajectory.state_at(time)
        assert own.trajectory.state_at(time) == pytest.approx(expected, abs=1e-10)
    for time, state in zip(times.tolist(), states, strict=True):
        assert own.trajectory.state_at(time) == pytest.approx(state, abs=1e-14)


def test_the_tolerance_is_that_of_the_leg(pendulum: HybridDynamics) -> None:
    exact = _follow(pendulum.free, RELEASE, on_guard=True, rounding=1e-12)
    errors: list[float] = []
    for digits in (3, 5, 7):
        tolerance = Tolerance(relative=10.0**-digits, absolute=10.0**-digits)
        rough = _follow(pendulum.free, RELEASE, on_guard=True, tolerance=tolerance)
        errors.append(abs(rough.duration - exact.duration))
    assert errors[0] > errors[1] > errors[2]
    assert all(error < 10.0**-digits for error, digits in zip(errors, (3, 5, 7), strict=True))


def test_threads_do_not_share_an_integrator() -> None:
    problem = load_problem("motor_pendulum")
    functions = problem.compiled()

    def run(_: int) -> float:
        own = bind(functions, problem.values().vector)
        execution = simulate(own, RELEASE, until=5.0, releases=1, settings=SETTINGS)
        return execution.releases[0].time

    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(run, range(6))) == pytest.approx([PERIOD] * 6, abs=1e-13)


def test_the_lean_formulas_of_a_mode_are_its_own() -> None:
    problem = load_problem("motor_pendulum")
    dynamics = problem.dynamics(problem.values())
    generator = np.random.default_rng(3)
    for flow in (dynamics.free, dynamics.locked, dynamics.flight(0.7)):
        mode, p = series.symbols_of(flow)
        lean = series.lean_mode(mode)
        y = generator.uniform(-1.0, 1.0, lean.n_y)
        got = np.array(lean.formulas(y, p, lean.factors(p))).ravel()
        # The same operations in another order.
        assert got == pytest.approx([*flow.rate(y), flow.guard(y)[0]], rel=1e-12, abs=1e-12)


def test_only_what_rests_is_left_out() -> None:
    problem = load_problem("motor_pendulum")
    dynamics = problem.dynamics(problem.values())
    (free, _), (locked, p) = (series.symbols_of(f) for f in (dynamics.free, dynamics.locked))
    # The gap and its rate rest on the stop; off it gravity sets the link in motion.
    assert series._resting(locked, (1, 3)) == (1, 3)
    assert series._resting(locked, (1, 3, 4)) == (1, 3)
    # Hanging straight down nothing moves at all; that much is not left out.
    assert series._resting(locked, (0, 1, 2, 3, 4)) == ()
    # A gap of zero alone does not rest, if its rate need not be zero.
    assert series._resting(locked, (1,)) == ()
    assert series._resting(free, (1, 3)) == ()
    lean = series.lean_mode(locked, (1, 3))
    assert lean.moving == (0, 2, 4)
    y = np.array([1.2, 0.0, 1.7, 0.0, -0.4])
    got = np.array(lean.formulas(y[[0, 2, 4]], p, lean.factors(p))).ravel()
    wanted = [*dynamics.locked.rate(y)[[0, 2, 4]], dynamics.locked.guard(y)[0]]
    assert got == pytest.approx(wanted, rel=1e-12)


def test_a_gap_that_is_not_quite_zero_stays_in_the_series_of_a_locked_arc() -> None:
    problem = load_problem("motor_pendulum")
    dynamics = problem.dynamics(problem.values())
    ends: list[Passage] = []
    for gap in (0.0, 1e-14):
        start = np.array([1.236, gap, 1.749, 0.0, -0.46])
        leg = Leg(flow=dynamics.locked, y=start, horizon=2.0, tolerance=Tolerance(), on_guard=False)
        ends.append(Taylor().follow(leg))
    assert ends[0].state[1] == 0.0
    assert ends[1].state[1] == pytest.approx(1e-14, rel=1e-6)
    assert ends[1].duration == pytest.approx(ends[0].duration, abs=1e-11)
    assert ends[1].state == pytest.approx(ends[0].state, abs=1e-11)
    # Dense output is of all states.
    assert ends[0].trajectory.state_at(0.1).shape == (5,)
