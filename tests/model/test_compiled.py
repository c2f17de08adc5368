"""The compiled functions give every entry its place, sparse as the symbols may be."""

import gc
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from problems.motor_pendulum import reference
from zeno_orbits import HybridLagrangian, hybrid_system, no_drive
from zeno_orbits.errors import StepSizeError
from zeno_orbits.integrators import PlainFlow, RungeKutta, Tolerance
from zeno_orbits.model import HybridDynamics, bind, compile_system, load_problem

ROUNDING = 1e-15


def _uncoupled_ball() -> HybridDynamics:
    """Return a ball of unit mass in the plane over a floor: its mass matrix couples nothing."""
    q, v, e = ca.SX.sym("q", 2), ca.SX.sym("v", 2), ca.SX.sym("restitution")
    lagrangian = HybridLagrangian.from_energies(
        q=q, v=v, kinetic=ca.sumsqr(v) / 2, potential=9.81 * q[1], gap=q[1]
    )
    system = hybrid_system(lagrangian, no_drive(lagrangian), e)
    compiled = compile_system(system, {"restitution": e}, ("x", "y", "vx", "vy"))
    return bind(compiled, [0.3])


def test_structural_zeros_keep_their_places() -> None:
    ball = _uncoupled_ball()
    state = np.array([0.0, 0.0, 1.0, -1.0])
    assert ball.impulse_direction(state).tolist() == [0.0, 0.0, 0.0, 1.0]
    assert ball.free.rate(state).tolist() == [1.0, -1.0, 0.0, -9.81]
    assert ball.reset_map(state, -1.0) == pytest.approx(np.array([0.0, 0.0, 1.0, 0.3]))
    assert ball.on_stop(state).tolist() == [0.0, 0.0, 1.0, 0.0]


@pytest.mark.slow
def test_the_numbers_of_a_flow_outlive_their_maker() -> None:
    ball = _uncoupled_ball()
    flights = [ball.flight(10.0**-k) for k in range(50)]
    gc.collect()
    _ = [np.full(4, np.nan) for _ in range(1000)]
    y = np.array([0.0, 0.0, 1.0, 0.5, 0.0, 1.0])
    for k, flight in enumerate(flights):
        speed = 10.0**-k
        expected = np.array([speed, 0.5 * speed, 0.0, -9.81 * speed, 1.0, -9.81])
        assert flight.rate(y) == pytest.approx(expected, rel=ROUNDING)


def test_the_fused_rest_is_that_of_the_pendulum_written_by_hand() -> None:
    problem = load_problem("motor_pendulum")
    values = problem.values()
    compiled = problem.dynamics(values)
    by_hand = reference.dynamics(values)
    assert compiled.fused_stop is not None
    assert by_hand.fused_stop is None
    random = np.random.default_rng(0)
    for gap in (0.0, 1e-9, 0.1):
        x = random.uniform(-2.0, 2.0, 5)
        x[1] = gap
        fused, plain = compiled.resting(x), by_hand.resting(x)
        # Forces of size 100 over inertias of 0.01 cancel in the accelerations.
        assert fused.state == pytest.approx(plain.state, rel=1e-13, abs=1e-14)
        assert fused.gap_acceleration == pytest.approx(plain.gap_acceleration, rel=1e-11, abs=1e-11)
        assert fused.rate == pytest.approx(plain.rate, rel=1e-11, abs=1e-11)
        assert compiled.on_stop(x).tolist() == fused.state.tolist()


def test_the_fused_rest_gives_way_to_a_part_that_was_replaced() -> None:
    ball = _uncoupled_ball()
    x = np.array([0.0, 0.1, 1.0, -1.0])
    assert ball.resting(x).gap_acceleration == pytest.approx(-9.81)
    heavy = replace(ball, gap_acceleration=lambda _: -20.0)
    assert heavy.resting(x).gap_acceleration == -20.0
    sideways = replace(ball, impulse_direction=lambda _: np.array([0.0, 0.0, 0.5, 1.0]))
    assert sideways.on_stop(x) == pytest.approx(np.array([-0.05, 0.0, 1.5, 0.0]))
    # What it does not stand for leaves it alone.
    assert replace(ball, energy=lambda _: 0.0).fused_stop is ball.fused_stop


def test_a_compiled_step_is_the_plain_step() -> None:
    problem = load_problem("motor_pendulum")
    dynamics = problem.dynamics(problem.values())
    state = np.array([0.4, 0.2, -1.0, 2.0, 0.5])
    plain = PlainFlow(field=dynamics.free.rate, guard_and_rate=dynamics.free.guard)
    tolerance = Tolerance(relative=1e-9, absolute=1e-9)
    for size in (1e-5, 1e-3, 5e-3):
        by_plain, plain_error = plain.attempt(state, size, tolerance)
        by_compiled, compiled_error = dynamics.free.attempt(state, size, tolerance)
        assert by_compiled == pytest.approx(by_plain, rel=1e-13)
        # Below the tolerance the error estimate is rounding, magnified.
        assert compiled_error == pytest.approx(plain_error, rel=1e-3, abs=1e-6)


def test_a_flow_that_is_not_finite_is_named() -> None:
    flow = PlainFlow(field=lambda y: y / 0.0 * np.inf, guard_and_rate=lambda _: (1.0, 0.0))
    with np.errstate(all="ignore"), pytest.raises(StepSizeError, match="not finite"):
        next(RungeKutta().steps(flow, np.array([1.0]), Tolerance()))


@pytest.mark.slow
def test_a_flow_that_blows_up_ends_in_a_named_error() -> None:
    flow = PlainFlow(field=lambda y: y**2, guard_and_rate=lambda _: (1.0, 0.0))
    starts: list[float] = []

    def follow() -> None:
        starts.extend(s.start for s in RungeKutta().steps(flow, np.array([1.0]), Tolerance()))

    with np.errstate(all="ignore"), pytest.raises(StepSizeError, match="rounding level"):
        follow()
    # y' = y^2 from 1 is infinite at t = 1.
    assert starts[-1] == pytest.approx(1.0, rel=1e-11)


def test_powers_are_those_of_voltage_current_and_resistance() -> None:
    problem = load_problem("motor_pendulum")
    graph = problem.graph_dynamics(problem.values())
    state = np.array([[0.4, 0.2, -1.0, 2.0, 0.5]])
    # Voltage -Kp theta1 - Kd dtheta1 at R = 3 ohm.
    ((work, copper, other),) = graph.powers(graph.open_mode, state)
    assert work == pytest.approx((-2.5 * 0.4 + 1.0 * -1.0) * 0.5)
    assert copper == pytest.approx(3.0 * 0.5**2)
    assert other == pytest.approx(0.0, abs=ROUNDING)


def test_names_that_do_not_fit_the_states_are_refused() -> None:
    problem = load_problem("bouncing_ball")
    symbols = problem.symbols()
    system = problem.model(symbols)
    with pytest.raises(ValueError, match="must name 2 states"):
        compile_system(system, symbols, ("height",))


def test_a_loose_symbol_is_named() -> None:
    problem = load_problem("bouncing_ball")
    symbols = problem.symbols()
    system = problem.model(symbols)
    del symbols["g"]
    with pytest.raises(ValueError, match="depends on g"):
        compile_system(system, symbols, problem.state_names)


def test_a_step_that_overflows_is_never_accepted() -> None:
    problem = load_problem("motor_pendulum")
    dynamics = problem.dynamics(problem.values(gains={"Kd": 0.5}))
    plain = PlainFlow(field=dynamics.free.rate, guard_and_rate=dynamics.free.guard)
    state = np.array([-2.8e-7, 0.0, -1.4e-5, 0.0, 2.6e-6])
    tolerance = Tolerance(relative=1e-8, absolute=1e-10)
    # R/L = 1500 1/s: a step of 12 s raises 2e4 to the power 8 in every stage, and ends in NaN.
    assert not dynamics.free.attempt(state, 12.0, tolerance)[1] <= 1.0
    with np.errstate(all="ignore"):
        assert not plain.attempt(state, 12.0, tolerance)[1] <= 1.0


def test_a_damped_component_keeps_its_tolerance() -> None:
    # y' = -a (y - sin w t), t' = 1, settled: y = (a^2 sin w t - a w cos w t) / (a^2 + w^2). The
    # usual mixed estimate lets through five times the tolerance here, the bounded one far less.
    a, w = 10.0, 20.0

    def exact(t: float) -> float:
        return (a**2 * np.sin(w * t) - a * w * np.cos(w * t)) / (a**2 + w**2)

    flow = PlainFlow(
        field=lambda y: np.array([-a * (y[0] - np.sin(w * y[1])), 1.0]),
        guard_and_rate=lambda _: (1.0, 0.0),
    )
    tolerance = Tolerance(relative=1e-12, absolute=1e-13)
    worst = 0.0
    for step in RungeKutta().steps(flow, np.array([exact(0.0), 0.0]), tolerance):
        worst = max(worst, abs(float(step.after[0]) - exact(float(step.after[1]))))
        if step.start > 1.0:
            break
    assert worst < tolerance.relative


def test_a_changed_problem_is_not_mistaken_for_the_one_it_was_made_from() -> None:
    problem = load_problem("motor_pendulum")
    other = load_problem("bouncing_ball")
    changed = replace(other, name=problem.name, title=problem.title, source=problem.source)
    assert changed.compiled().n_x == 2
    assert problem.compiled().n_x == 5
    # Without its file, a problem is equal to itself only.
    assert replace(problem, origin=None).compiled() is not problem.compiled()
    assert replace(problem).compiled() is problem.compiled()


def test_two_systems_bound_to_one_model_keep_their_own_numbers() -> None:
    problem = load_problem("motor_pendulum")
    weak = problem.values(gains={"Kp": 2.0})
    strong = problem.values(gains={"Kp": 4.0})
    shared = [problem.dynamics(values) for values in (weak, strong)]
    alone = [replace(problem, origin=None).dynamics(values) for values in (weak, strong)]
    x = np.array([0.3, 0.2, 1.0, -0.5, 0.1])
    for _ in range(2):
        for ours, theirs in zip(shared, alone, strict=True):
            assert np.array_equal(ours.free.rate(x), theirs.free.rate(x))
            assert np.array_equal(ours.locked.rate(x), theirs.locked.rate(x))
    assert not np.array_equal(shared[0].free.rate(x), shared[1].free.rate(x))


def test_what_an_impact_leads_to_is_reset_and_rest_one_after_the_other() -> None:
    problem = load_problem("motor_pendulum")
    dynamics = problem.dynamics(problem.values())
    x = np.array([0.3, 0.0, 1.0, -2.0, 0.5])
    rate = dynamics.gap_rate(x)
    landed = dynamics.landed(x, rate)
    after = dynamics.reset_map(x, rate)
    assert landed.state_plus.tolist() == after.tolist()
    assert landed.gap_rate == dynamics.gap_rate(after) == pytest.approx(0.4, rel=1e-12)
    resting = dynamics.resting(after)
    assert landed.state.tolist() == resting.state.tolist()
    assert landed.rate.tolist() == resting.rate.tolist()
    assert landed.gap_acceleration == resting.gap_acceleration
    # A reset that was replaced is the one that is taken.
    stuck = replace(dynamics, reset_map=lambda x, _: x)
    assert stuck.landed(x, rate).state_plus is x
