"""The compiled loop against the loop in Python, step by step.

A kernel does what the interpreter does, operation for operation. So explicit steps agree to the
last bit. Implicit steps differ in rounding where NumPy adds up in another order and where
eigenvalues are computed in another way.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from tests.support.compiling import fresh_system, needs_compiler, use_folder
from zeno_orbits.errors import RunawayError, SimulationError, StepSizeError
from zeno_orbits.integrators import (
    Automatic,
    Leg,
    Outcome,
    Passage,
    Radau,
    RadauStep,
    RecordedTrajectory,
    RungeKutta,
    SteppedTrajectory,
    Tolerance,
)
from zeno_orbits.integrators.stepping import SteppingEngine
from zeno_orbits.model import (
    CompiledSystem,
    HybridDynamics,
    bind,
    bundled_problems,
    load_problem,
    mode_functions,
)
from zeno_orbits.model.numeric.compiled_flow import CompiledFlow
from zeno_orbits.simulation import SimulationSettings, simulate

pytestmark = needs_compiler

TOLERANCE = Tolerance(relative=1e-8, absolute=1e-9)
SIZES = 1e-5
"""Relative difference of times of steps. An error estimate is wrong by rounding over tolerance,
2e-8, times the sizes of the weights in it, some hundreds; a step size by an eighth of that."""


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], CompiledSystem]:
    """Systems of problems with compiled kernels, which all processes of a session share."""
    folder = tmp_path_factory.getbasetemp().parent / "kernels"
    systems: dict[str, CompiledSystem] = {}

    def system(name: str) -> CompiledSystem:
        if name not in systems:
            systems[name] = fresh_system(name)
        with pytest.MonkeyPatch.context() as monkeypatch:
            use_folder(monkeypatch, folder)
            for mode in (systems[name].free, systems[name].locked, systems[name].flight):
                assert mode.kernels.build()
        return systems[name]

    return system


class Both:
    """Follows every leg in both loops and goes on from what the compiled one gives."""

    def __init__(self, engine: SteppingEngine) -> None:
        self.engine = engine
        self.pairs: list[tuple[Passage, Passage]] = []

    def follow(self, leg: Leg) -> Passage:
        compiled, plain = self.engine.follow(leg), self.engine.follow_interpreted(leg)
        self.pairs.append((compiled, plain))
        return compiled


def dynamics_of(system: CompiledSystem, name: str, **parameters: float) -> HybridDynamics:
    return bind(system, load_problem(name).values(parameters=parameters).vector)


def both(
    dynamics: HybridDynamics, name: str, engine: SteppingEngine, until: float = 3.0
) -> list[tuple[Passage, Passage]]:
    """Simulate a problem from its first start, every leg in both loops."""
    problem, engines = load_problem(name), Both(engine)
    start = problem.state_vector(problem.starts[0])
    settings = SimulationSettings(engine=engines, tolerance=TOLERANCE)
    simulate(dynamics, start, until=until, settings=settings)
    for compiled, plain in engines.pairs:
        assert isinstance(compiled.trajectory, RecordedTrajectory)
        assert isinstance(plain.trajectory, SteppedTrajectory)
    return engines.pairs


def require_same_steps(compiled: Passage, plain: Passage, tolerance: float = 1e-11) -> None:
    """Hold two passages together: outcome, number and kind of steps, times, states, dense output.

    Args:
        compiled: One passage.
        plain: The other.
        tolerance: Largest difference of states that both integrations may make by themselves.
    """
    assert compiled.outcome is plain.outcome
    mine, other = compiled.trajectory, plain.trajectory
    assert isinstance(mine, RecordedTrajectory)
    assert isinstance(other, SteppedTrajectory)
    assert [type(step) for step in mine.steps] == [type(step) for step in other.steps]
    assert np.allclose(mine.times, other.times, rtol=SIZES, atol=1e-300)
    scale = 1.0 + np.max(np.abs(other.states), axis=0)
    assert math.isclose(compiled.duration, plain.duration, rel_tol=tolerance)
    assert np.all(np.abs(compiled.state - plain.state) <= tolerance * scale)
    for part in (0.0, 0.3, 0.7, 0.99):
        at = part * compiled.duration
        assert np.all(np.abs(mine.state_at(at) - other.state_at(at)) <= tolerance * scale)


def test_explicit_steps_agree_to_the_last_bit(shared: Callable[[str], CompiledSystem]) -> None:
    dynamics = dynamics_of(shared("bouncing_ball"), "bouncing_ball")
    pairs = both(dynamics, "bouncing_ball", RungeKutta())
    assert len(pairs) > 3
    for compiled, plain in pairs:
        assert compiled.outcome is plain.outcome
        assert compiled.duration == plain.duration
        assert np.array_equal(compiled.trajectory.times, plain.trajectory.times)
        assert np.array_equal(compiled.trajectory.states, plain.trajectory.states)


@pytest.mark.parametrize("engine", [Automatic(), pytest.param(Radau(), marks=pytest.mark.slow)])
def test_a_valve_takes_the_same_steps_in_both_loops(
    engine: SteppingEngine, shared: Callable[[str], CompiledSystem]
) -> None:
    dynamics = dynamics_of(shared("motor_valve"), "motor_valve")
    for compiled, plain in both(dynamics, "motor_valve", engine):
        require_same_steps(compiled, plain)


@pytest.mark.slow
@pytest.mark.parametrize("name", bundled_problems())
@pytest.mark.parametrize("engine", [Automatic(), RungeKutta(), Radau()])
def test_every_problem_takes_the_same_steps_in_both_loops(
    name: str, engine: SteppingEngine, shared: Callable[[str], CompiledSystem]
) -> None:
    dynamics = dynamics_of(shared(name), name)
    for compiled, plain in both(dynamics, name, engine):
        require_same_steps(compiled, plain, 1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("inductance", [1e-2, 1e-4, 1e-6])
def test_both_loops_go_over_to_implicit_steps_at_the_same_time(
    inductance: float, shared: Callable[[str], CompiledSystem]
) -> None:
    name = "motor_pendulum"
    pairs = both(dynamics_of(shared(name), name, L=inductance), name, Automatic())
    kinds = {type(step) for compiled, _ in pairs for step in compiled.trajectory.steps}
    assert RadauStep in kinds
    for compiled, plain in pairs:
        require_same_steps(compiled, plain, 1e-9)


def leg_of(dynamics: HybridDynamics, y: tuple[float, ...], horizon: float = 1e3) -> Leg:
    return Leg(
        flow=dynamics.free,
        y=np.array(y),
        horizon=horizon,
        tolerance=Tolerance(),
        on_guard=False,
    )


def outcome_of(follow: Callable[[Leg], Passage], leg: Leg) -> tuple[object, ...]:
    """Return what became of a leg, an error too, in numbers that both loops must share."""
    try:
        passage = follow(leg)
    except SimulationError as error:
        return type(error), str(error)
    return passage.outcome, passage.duration, *passage.state.tolist()


@pytest.mark.parametrize(
    ("y", "horizon", "outcome"),
    [
        ((1.0, 0.0), 1e3, Outcome.FALL),
        ((1.0, 0.0), 0.25, Outcome.HORIZON),
        ((1.0, 1e5), 1e9, Outcome.FALL),
        ((1.0, 0.0), 1e-12, Outcome.HORIZON),
    ],
)
def test_a_fall_and_the_end_of_the_time_are_the_same_in_both_loops(
    y: tuple[float, float],
    horizon: float,
    outcome: Outcome,
    shared: Callable[[str], CompiledSystem],
) -> None:
    leg = leg_of(dynamics_of(shared("bouncing_ball"), "bouncing_ball"), y, horizon)
    for engine in (Automatic(), RungeKutta(largest_step=0.01 * min(horizon, 1e5))):
        expected = outcome_of(engine.follow_interpreted, leg)
        assert expected[0] is outcome
        assert outcome_of(engine.follow, leg) == expected


@pytest.mark.parametrize("on_guard", [False, True])
@pytest.mark.parametrize("y", [(0.0, -1.0), (0.0, 0.0), (0.0, 1e-3), (-1.0, 0.0), (1e-9, 1.0)])
def test_a_start_on_the_guard_is_treated_alike(
    y: tuple[float, float], on_guard: bool, shared: Callable[[str], CompiledSystem]
) -> None:
    leg = replace(
        leg_of(dynamics_of(shared("bouncing_ball"), "bouncing_ball"), y, 5.0), on_guard=on_guard
    )
    engine = Automatic()
    assert outcome_of(engine.follow, leg) == outcome_of(engine.follow_interpreted, leg)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("engine", [Automatic(), RungeKutta(), Radau()])
def test_what_is_not_finite_ends_alike_in_both_loops(
    bad: float, engine: SteppingEngine, shared: Callable[[str], CompiledSystem]
) -> None:
    leg = leg_of(dynamics_of(shared("motor_valve"), "motor_valve"), (1.0, bad, bad), 5.0)
    expected = outcome_of(engine.follow_interpreted, leg)
    found = outcome_of(engine.follow, leg)
    assert found[:2] == expected[:2]


def test_a_long_leg_is_told_to_the_watch_in_pieces_and_kept_whole(
    shared: Callable[[str], CompiledSystem],
) -> None:
    told: list[tuple[int, float]] = []
    leg = replace(
        leg_of(dynamics_of(shared("bouncing_ball"), "bouncing_ball"), (1.0, 0.0), 0.4),
        watch=lambda steps, time, _y: told.append((steps, time)),
    )
    engine = RungeKutta(largest_step=1e-3)
    passage, plain = engine.follow(leg), engine.follow_interpreted(replace(leg, watch=ignore))
    assert [steps for steps, _ in told] == [256, len(plain.trajectory.times) - 1 - 256]
    assert [time for _, time in told] == sorted(time for _, time in told)
    assert np.array_equal(passage.trajectory.times, plain.trajectory.times)
    assert np.array_equal(passage.state, plain.state)


def ignore(_steps: int, _time: float, _y: object) -> None:
    pass


def test_a_step_that_goes_too_far_is_told_at_once(
    shared: Callable[[str], CompiledSystem],
) -> None:
    dynamics = dynamics_of(shared("bouncing_ball"), "bouncing_ball")
    settings = SimulationSettings(far=20.0, engine=RungeKutta(largest_step=0.1))
    with pytest.raises(RunawayError) as caught:
        simulate(dynamics, (1.0, 30.0), until=10.0, settings=settings)
    # At 30 m/s the ball passes 20 m after 0.74 s: h = 1 + 30 t - g t^2 / 2.
    assert caught.value.state[0] > 20.0
    assert 0.6 < caught.value.time < 0.9


@pytest.mark.parametrize("engine", [Automatic(), RungeKutta(), Radau()])
def test_a_flow_that_blows_up_is_the_same_error_at_the_same_place(
    engine: SteppingEngine,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    # y' = y^2 from 1 is infinite at t = 1; rounding of the time ends the steps before.
    y, p = ca.SX.sym("y"), ca.SX.sym("p")
    mode = mode_functions("blow", y, p, y * y, ca.vertcat(y, y * y))
    use_folder(monkeypatch, tmp_path_factory.getbasetemp().parent / "kernels")
    leg = Leg(
        flow=CompiledFlow(mode, np.zeros(1)),
        y=np.ones(1),
        horizon=5.0,
        tolerance=Tolerance(),
        on_guard=False,
    )
    with pytest.raises(StepSizeError) as plain:
        engine.follow_interpreted(leg)
    with pytest.raises(StepSizeError) as compiled:
        engine.follow(leg)
    assert mode.kernels.library() is not None
    assert str(compiled.value).partition(" at ")[0] == str(plain.value).partition(" at ")[0]
    assert math.isclose(compiled.value.time, 1.0, abs_tol=1e-12)
    assert math.isclose(plain.value.time, 1.0, abs_tol=1e-12)


def test_where_a_jacobian_is_not_finite_both_loops_take_explicit_steps(
    monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    # The slope of a root at zero is infinite, and its flow stays there: x = exp(-t) beside it.
    y, p = ca.SX.sym("y", 2), ca.SX.sym("p")
    rate = ca.vertcat(-y[0], -ca.sqrt(y[1]))
    mode = mode_functions("root", y, p, rate, ca.vertcat(y[0], rate[0]))
    use_folder(monkeypatch, tmp_path_factory.getbasetemp().parent / "kernels")
    assert mode.kernels.build()
    flow = CompiledFlow(mode, np.zeros(1))
    leg = Leg(
        flow=flow,
        y=np.array([1.0, 0.0]),
        horizon=40.0,
        tolerance=TOLERANCE,
        on_guard=False,
    )
    assert not np.all(np.isfinite(flow.jacobian(leg.y)))
    compiled, plain = Automatic().follow(leg), Automatic().follow_interpreted(leg)
    require_same_steps(compiled, plain)
    assert len(compiled.trajectory.times) > 20
    assert abs(compiled.state[0] - math.exp(-40.0)) < 1e-8


@pytest.mark.parametrize("engine", [Automatic(), RungeKutta()])
def test_a_rise_of_rounding_off_the_guard_is_no_fall(
    engine: SteppingEngine,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    # The guard is t^3, with the rounding of cos^2 + sin^2 - 1 on it. A state that begins at zero
    # makes the first steps so short that they rise less than this rounding.
    y, p = ca.SX.sym("y", 5), ca.SX.sym("p")
    time, cube, cosine, sine, _ = ca.vertsplit(y)
    rate = ca.vertcat(1.0, 3 * time**2, -sine, cosine, 1.0)
    guard = ca.vertcat(cosine**2 + sine**2 - 1.0 + cube, 3 * time**2)
    mode = mode_functions("noisy", y, p, rate, guard)
    use_folder(monkeypatch, tmp_path_factory.getbasetemp().parent / "kernels")
    assert mode.kernels.build()
    start = np.array([0.0, 0.0, math.cos(0.7), math.sin(0.7), 0.0])
    tight = Tolerance(relative=1e-12, absolute=1e-24)
    for rounding, outcome in ((1e-14, Outcome.HORIZON), (0.0, Outcome.FALL)):
        leg = Leg(
            flow=CompiledFlow(mode, np.zeros(1)),
            y=start,
            horizon=1.0,
            tolerance=tight,
            on_guard=True,
            rounding=rounding,
        )
        assert engine.follow_interpreted(leg).outcome is outcome
        assert engine.follow(leg).outcome is outcome
