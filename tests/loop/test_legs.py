"""Legs of single flows in compiled code against the engines in Python, step by step.

The loop does what the interpreter does, operation for operation. So explicit steps agree to the
last bit. Implicit steps differ in rounding where NumPy adds up in another order and where
eigenvalues are computed in another way.
"""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import DOP853

from tests.loop.agreement import needs_compiler
from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError, StepSizeError
from zeno_orbits.integrators import (
    Automatic,
    PlainFlow,
    Radau,
    RadauStep,
    RungeKutta,
    SciPy,
    Segment,
    SegmentResult,
    SteppedTrajectory,
    SteppingEngine,
    Termination,
    Tolerance,
)
from zeno_orbits.model import CompiledFlow, HybridDynamics, load_problem, mode_functions
from zeno_orbits.simulation import LegFollower, states_after_steps

pytestmark = needs_compiler

TOLERANCE = Tolerance(relative=1e-8, absolute=1e-9)
ENGINES = [Automatic(), RungeKutta(), Radau()]


def dynamics_of(name: str, **parameters: float) -> HybridDynamics:
    problem = load_problem(name)
    return problem.dynamics(problem.values(parameters=parameters))


def leg_of(
    dynamics: HybridDynamics, y: tuple[float, ...], horizon: float = 1e3, *, on_guard: bool = False
) -> Segment:
    return Segment(
        flow=dynamics.free,
        y=np.array(y),
        horizon=horizon,
        tolerance=TOLERANCE,
        on_guard=on_guard,
    )


def in_c(leg: Segment, engine: SteppingEngine) -> SegmentResult:
    """Follow a leg in compiled code, which is another trajectory than the engine's own."""
    passage = LegFollower(engine).follow(leg)
    assert not isinstance(passage.trajectory, SteppedTrajectory)
    return passage


def outcome_of(follow: Callable[[], SegmentResult]) -> tuple[object, ...]:
    """Return the end of a leg, an error too, in values that both must share."""
    try:
        passage = follow()
    except SimulationError as error:
        return type(error), str(error)
    return passage.outcome, passage.duration, *passage.state.tolist()


def require_same_steps(mine: SegmentResult, other: SegmentResult, tolerance: float) -> None:
    """Hold two passages together: outcome, number of steps, times, states, dense output."""
    assert mine.outcome is other.outcome
    assert len(mine.trajectory.times) == len(other.trajectory.times)
    scale = 1.0 + np.max(np.abs(other.trajectory.states), axis=0)
    assert mine.duration == pytest.approx(other.duration, rel=tolerance)
    assert np.all(np.abs(mine.state - other.state) <= tolerance * scale)
    for part in (0.0, 0.3, 0.7, 0.99, 1.0):
        at = part * mine.duration
        difference = mine.trajectory.state_at(at) - other.trajectory.state_at(at)
        assert np.all(np.abs(difference) <= tolerance * scale)


@pytest.mark.parametrize(
    ("y", "horizon", "outcome"),
    [
        ((1.0, 0.0), 1e3, Termination.FALL),
        ((1.0, 0.0), 0.25, Termination.HORIZON),
        ((1.0, 1e5), 1e9, Termination.FALL),
        ((1.0, 0.0), 1e-12, Termination.HORIZON),
    ],
)
def test_a_fall_and_the_end_of_the_time_are_equal_to_the_last_bit(
    y: tuple[float, float], horizon: float, outcome: Termination
) -> None:
    leg = leg_of(dynamics_of("bouncing_ball"), y, horizon)
    for engine in (Automatic(), RungeKutta(largest_step=0.01 * min(horizon, 1e5))):
        mine, other = in_c(leg, engine), engine.follow(leg)
        assert other.outcome is outcome
        assert (mine.outcome, mine.duration) == (other.outcome, other.duration)
        assert mine.state.tolist() == other.state.tolist()
        assert mine.trajectory.times.tolist() == other.trajectory.times.tolist()
        assert mine.trajectory.states.tolist() == other.trajectory.states.tolist()
        inside = 0.37 * mine.duration
        wanted = other.trajectory.state_at(inside)
        assert mine.trajectory.state_at(inside).tolist() == wanted.tolist()


@pytest.mark.parametrize("engine", ENGINES, ids=lambda one: type(one).__name__)
@pytest.mark.parametrize("inductance", [2e-3, 1e-5])
def test_a_flight_of_the_pendulum_takes_the_same_steps(
    engine: SteppingEngine, inductance: float
) -> None:
    if isinstance(engine, RungeKutta) and inductance < 1e-3:
        pytest.skip("explicit steps are too short where the current decays so fast")
    leg = leg_of(dynamics_of("motor_pendulum", L=inductance), (0.4, 0.5, -1.0, 0.5, 0.2))
    # Step sizes follow from error estimates, which rounding over tolerance changes by 1e-7. Inside
    # implicit steps that moves the polynomial by less than the tolerance of 1e-8.
    require_same_steps(in_c(leg, engine), engine.follow(leg), 1e-8)


def test_both_go_over_to_implicit_steps_at_the_same_time() -> None:
    leg = leg_of(dynamics_of("motor_pendulum", L=1e-5), (0.4, 0.5, -1.0, 0.5, 0.2))
    mine, other = in_c(leg, Automatic()), Automatic().follow(leg)
    kinds = [[type(step) for step in getattr(way.trajectory, "steps", ())] for way in (mine, other)]
    assert kinds[0] == kinds[1]
    assert RadauStep in kinds[0]


@pytest.mark.parametrize("on_guard", [False, True])
@pytest.mark.parametrize("y", [(0.0, -1.0), (0.0, 0.0), (0.0, 1e-3), (-1.0, 0.0), (1e-9, 1.0)])
def test_a_start_on_the_guard_is_treated_alike(y: tuple[float, float], on_guard: bool) -> None:
    leg = leg_of(dynamics_of("bouncing_ball"), y, 5.0, on_guard=on_guard)
    expected = outcome_of(lambda: Automatic().follow(leg))
    assert outcome_of(lambda: LegFollower(Automatic()).follow(leg)) == expected


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("engine", ENGINES, ids=lambda one: type(one).__name__)
def test_a_start_that_is_not_finite_ends_in_the_same_error(
    bad: float, engine: SteppingEngine
) -> None:
    leg = leg_of(dynamics_of("motor_valve"), (1.0, bad, bad), 5.0)
    expected = outcome_of(lambda: engine.follow(leg))
    assert expected[0] is StepSizeError
    assert outcome_of(lambda: LegFollower(engine).follow(leg)) == expected


def test_a_long_leg_is_told_to_the_watch_in_pieces_and_kept_whole() -> None:
    told: list[tuple[int, float]] = []
    leg = leg_of(dynamics_of("bouncing_ball"), (1.0, 0.0), 0.4)
    watched = replace(leg, watch=lambda steps, time, _y: told.append((steps, time)))
    engine = RungeKutta(largest_step=1e-4)
    mine, other = in_c(watched, engine), engine.follow(leg)
    assert len(told) > 1
    assert sum(steps for steps, _ in told) == len(other.trajectory.times) - 1
    assert [time for _, time in told] == sorted(time for _, time in told)
    assert mine.trajectory.times.tolist() == other.trajectory.times.tolist()
    assert mine.state.tolist() == other.state.tolist()


def test_a_watch_may_end_a_leg() -> None:
    def refuse(_steps: int, time: float, _y: Vector) -> None:
        raise StepSizeError("That is enough", time=time, state=())

    leg = replace(leg_of(dynamics_of("bouncing_ball"), (1.0, 0.0)), watch=refuse)
    follower = LegFollower(RungeKutta())
    with pytest.raises(StepSizeError, match="That is enough"):
        follower.follow(leg)
    # The next leg is not disturbed: h = 1 - g t^2 / 2 falls at sqrt(2 / g).
    after = follower.follow(leg_of(dynamics_of("bouncing_ball"), (1.0, 0.0)))
    assert after.duration == pytest.approx(math.sqrt(2 / 9.81), rel=1e-9)


@pytest.mark.parametrize("engine", ENGINES, ids=lambda one: type(one).__name__)
def test_a_flow_that_blows_up_is_the_same_error_at_the_same_place(engine: SteppingEngine) -> None:
    # y' = y^2 from 1 is infinite at t = 1; rounding of the time ends the steps before.
    y, p = ca.SX.sym("y"), ca.SX.sym("p")
    mode = mode_functions("blow", y, p, y * y, ca.vertcat(y, y * y))
    leg = Segment(
        flow=CompiledFlow(mode, np.zeros(1)),
        y=np.ones(1),
        horizon=5.0,
        tolerance=Tolerance(),
        on_guard=False,
    )
    with pytest.raises(StepSizeError) as plain:
        engine.follow(leg)
    with pytest.raises(StepSizeError) as compiled:
        LegFollower(engine).follow(leg)
    assert str(compiled.value).partition(" at ")[0] == str(plain.value).partition(" at ")[0]
    assert compiled.value.time == pytest.approx(1.0, abs=1e-12)
    assert plain.value.time == pytest.approx(1.0, abs=1e-12)


def test_where_a_jacobian_is_not_finite_both_take_explicit_steps() -> None:
    # The slope of a root at zero is infinite, and its flow stays there: x = exp(-t) beside it.
    y, p = ca.SX.sym("y", 2), ca.SX.sym("p")
    rate = ca.vertcat(-y[0], -ca.sqrt(y[1]))
    mode = mode_functions("root", y, p, rate, ca.vertcat(y[0], rate[0]))
    flow = CompiledFlow(mode, np.zeros(1))
    leg = Segment(
        flow=flow, y=np.array([1.0, 0.0]), horizon=40.0, tolerance=TOLERANCE, on_guard=False
    )
    assert not np.all(np.isfinite(flow.jacobian(leg.y)))
    mine = in_c(leg, Automatic())
    require_same_steps(mine, Automatic().follow(leg), 1e-11)
    assert len(mine.trajectory.times) > 20
    # The local error of 1e-9 a step, over some hundred steps that damp it.
    assert abs(mine.state[0] - math.exp(-40.0)) < 1e-8


@pytest.mark.parametrize("engine", [Automatic(), RungeKutta()])
def test_a_rise_of_rounding_off_the_guard_is_no_fall(engine: SteppingEngine) -> None:
    # The guard is t^3, with the rounding of cos^2 + sin^2 - 1 on it. A state that begins at zero
    # makes the first steps so short that they rise less than this rounding.
    y, p = ca.SX.sym("y", 5), ca.SX.sym("p")
    time, cube, cosine, sine, _ = ca.vertsplit(y)
    rate = ca.vertcat(1.0, 3 * time**2, -sine, cosine, 1.0)
    guard = ca.vertcat(cosine**2 + sine**2 - 1.0 + cube, 3 * time**2)
    mode = mode_functions("noisy", y, p, rate, guard)
    start = np.array([0.0, 0.0, math.cos(0.7), math.sin(0.7), 0.0])
    tight = Tolerance(relative=1e-12, absolute=1e-24)
    for rounding, outcome in ((1e-14, Termination.HORIZON), (0.0, Termination.FALL)):
        leg = Segment(
            flow=CompiledFlow(mode, np.zeros(1)),
            y=start,
            horizon=1.0,
            tolerance=tight,
            on_guard=True,
            rounding=rounding,
        )
        assert engine.follow(leg).outcome is outcome
        assert in_c(leg, engine).outcome is outcome


def test_a_leg_can_be_pickled_and_still_has_its_states() -> None:
    passage = in_c(leg_of(dynamics_of("bouncing_ball"), (1.0, 0.0)), RungeKutta())
    again = pickle.loads(pickle.dumps(passage))
    at = 0.4 * passage.duration
    assert again.trajectory.state_at(at).tolist() == passage.trajectory.state_at(at).tolist()
    # h = 1 - g t^2 / 2, a polynomial that the method has exactly.
    assert again.trajectory.state_at(at)[0] == pytest.approx(1 - 9.81 * at**2 / 2, rel=1e-13)


def test_other_flows_and_engines_are_followed_in_python() -> None:
    ball = leg_of(dynamics_of("bouncing_ball"), (1.0, 0.0))
    plain = PlainFlow(field=ball.flow.rate, guard_and_rate=ball.flow.guard)
    for leg, engine in ((replace(ball, flow=plain), RungeKutta()), (ball, SciPy(method=DOP853))):
        passage = LegFollower(engine).follow(leg)
        assert isinstance(passage.trajectory, SteppedTrajectory)
        assert passage.duration == pytest.approx(math.sqrt(2 / 9.81), rel=1e-6)


def test_states_after_bounded_steps_go_on_through_the_guard() -> None:
    dynamics, longest = dynamics_of("bouncing_ball"), 1e-3
    engine = Automatic(
        explicit=RungeKutta(largest_step=longest), implicit=Radau(largest_step=longest)
    )
    plain = PlainFlow(field=dynamics.free.rate, guard_and_rate=dynamics.free.guard)
    for flow in (dynamics.free, plain):
        states = states_after_steps(flow, engine, np.array([1.0, 0.0]), TOLERANCE, 1.0)
        assert len(states) >= 999
        # The velocity is -g t: it tells the time of every state, and the gap goes below zero.
        times = -states[:, 1] / 9.81
        assert np.all(np.diff(times) <= longest * (1 + 1e-9))
        assert times[-1] < 1.0
        assert states[:, 0] == pytest.approx(1 - 9.81 * times**2 / 2, abs=1e-12)
        assert states[-1, 0] < 0.0
