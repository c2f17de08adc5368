"""The stiff engine: its order, its indifference to fast decays, and what it must refuse."""

from __future__ import annotations

import math

import numpy as np
import pytest

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import StepSizeError
from zeno_orbits.integrators import (
    Automatic,
    ExplicitStep,
    FlowWithEvent,
    PlainFlow,
    Radau,
    RungeKutta,
    Segment,
    SegmentResult,
    SteppedTrajectory,
    Termination,
    Tolerance,
    flow_eigenvalues,
    radau_scheme,
    rates_of,
    staying_rate,
)
from zeno_orbits.model import bind, load_problem
from zeno_orbits.simulation import simulate

TIGHT = Tolerance(relative=1e-11, absolute=1e-12)


def _prothero_robinson(rate: float) -> PlainFlow:
    """Return y' = -rate (y - cos t) - sin t, t' = 1: the solution from y(0) = 1 is cos t."""
    return PlainFlow(
        field=lambda y: np.array([-rate * (y[0] - math.cos(y[1])) - math.sin(y[1]), 1.0]),
        guard_and_rate=lambda y: (float(y[0]), -math.sin(float(y[1]))),
    )


def _leg(flow: FlowWithEvent, y: Vector, horizon: float, tolerance: Tolerance = TIGHT) -> Segment:
    return Segment(flow=flow, y=y, horizon=horizon, tolerance=tolerance, on_guard=False)


def _n_steps(passage: SegmentResult) -> int:
    return len(passage.trajectory.times) - 1


@pytest.mark.parametrize("rate", [1.0, 1e3, 1e6, 1e9])
def test_a_decay_changes_neither_the_guard_time_nor_the_number_of_steps(rate: float) -> None:
    passage = Radau().follow(_leg(_prothero_robinson(rate), np.array([1.0, 0.0]), 10.0))
    assert passage.outcome is Termination.FALL
    # cos t falls through zero at pi / 2 with slope -1: the error of the time is that of the state.
    assert passage.duration == pytest.approx(math.pi / 2, abs=10 * TIGHT.relative)
    # The first guess of a step starts from the size of the slope alone; then steps grow sixfold.
    assert _n_steps(passage) < 25


@pytest.mark.parametrize("n_stages", [1, 3, 5, 7])
def test_the_eigenvectors_rebuild_the_inverse_of_the_matrix(n_stages: int) -> None:
    scheme = radau_scheme(n_stages)
    spectrum = scheme.spectrum
    rebuilt = np.zeros((n_stages, n_stages))
    for value, column, row in zip(spectrum.values, spectrum.columns, spectrum.rows, strict=True):
        part = np.outer(column, value * row)
        rebuilt += part.real if value.imag == 0.0 else 2 * part.real
    assert rebuilt == pytest.approx(scheme.inverse, abs=1e-10 * float(np.abs(rebuilt).max()))


def test_the_jacobian_of_a_compiled_flow_is_its_derivative() -> None:
    problem = load_problem("motor_pendulum")
    flow = problem.dynamics(problem.values()).free
    y = np.array([0.2, 0.1, -5.0, 1.0, -1.8])
    plain = PlainFlow(field=flow.rate, guard_and_rate=flow.guard)
    assert flow.jacobian(y) == pytest.approx(plain.jacobian(y), rel=1e-6, abs=1e-5)
    fastest, slower = rates_of(flow_eigenvalues(flow, y))
    # The current decays at R / L = 1500 1/s, coupled to the rest by the torque constant.
    assert fastest == pytest.approx(1500.0, rel=0.01)
    assert slower < 30.0


def test_dense_output_is_as_accurate_as_the_tolerance() -> None:
    tolerance = Tolerance(relative=1e-8, absolute=1e-9)
    leg = _leg(_prothero_robinson(1e4), np.array([1.0, 0.0]), 1.5, tolerance)
    trajectory = Radau().follow(leg).trajectory
    for time in np.linspace(0.0, 1.5, 41):
        y = trajectory.state_at(float(time))
        assert y[0] == pytest.approx(math.cos(float(time)), abs=10 * tolerance.relative)


@pytest.mark.slow
def test_the_default_engine_goes_over_to_implicit_steps_where_they_pay() -> None:
    stiff = _leg(_prothero_robinson(1e5), np.array([1.0, 0.0]), 1.5)
    smooth = _leg(_prothero_robinson(1.0), np.array([1.0, 0.0]), 1.5)
    explicit = _n_steps(RungeKutta().follow(stiff))
    assert _n_steps(Automatic().follow(stiff)) < explicit / 50
    ours, theirs = Automatic().follow(smooth), RungeKutta().follow(smooth)
    assert ours.state.tolist() == theirs.state.tolist()


def _two_layers(first: float, second: float) -> PlainFlow:
    """Return `y' = -rate (y - cos t) - sin t` twice, at two rates, with a clock: both `cos t`."""

    def rate(y: Vector) -> Vector:
        off, slope = y[:2] - math.cos(y[2]), math.sin(y[2])
        return np.array([-first * off[0] - slope, -second * off[1] - slope, 1.0])

    return PlainFlow(field=rate, guard_and_rate=lambda _: (1.0, 0.0))


@pytest.mark.parametrize(
    "apart",
    [pytest.param(apart, marks=pytest.mark.slow) for apart in (1.0, 3.0, 24.0, 100.0)] + [10.0],
)
@pytest.mark.slow
def test_two_layers_however_far_apart_are_both_left_behind(apart: float) -> None:
    leg = _leg(_two_layers(1e5, 1e5 / apart), np.array([2.0, 2.0, 0.0]), 1.5)
    ours, explicit = Automatic().follow(leg), RungeKutta().follow(leg)
    # A layer costs some fifty steps; 1.5 s at the edge of stability, 6 / 1e5 s, 25 000.
    assert _n_steps(ours) < 300
    assert _n_steps(explicit) > 10_000
    assert ours.state[:2] == pytest.approx([math.cos(1.5)] * 2, abs=1e-9)


def test_a_second_decay_that_lasts_as_long_as_the_leg_is_no_layer() -> None:
    """At a tenth of the fastest rate it leaves nothing to gain before the end of a short leg."""
    leg = _leg(_two_layers(1e4, 1e3), np.array([2.0, 2.0, 0.0]), 0.02)
    ours, explicit = Automatic().follow(leg), RungeKutta().follow(leg)
    assert ours.state.tolist() == explicit.state.tolist()


def test_what_lasts_is_neither_what_decays_long_before_nor_less_than_what_swings() -> None:
    values = np.array([-1e5, -1e4, -50.0 + 400.0j, -50.0 - 400.0j, -7.0, 2.0])
    assert staying_rate(values, 1.0) == pytest.approx(abs(values[2]))
    assert staying_rate(values[[0, 1, 4, 5]], 1.0) == 7.0
    assert staying_rate(values[[0, 1, 4, 5]], 100.0) == 2.0
    assert staying_rate(values[[0, 1, 4, 5]], 1e-3) == 1e4
    assert staying_rate(values[:2], math.inf) == 0.0


def test_two_motors_ten_times_apart_are_followed_implicitly() -> None:
    problem = load_problem("two_motors")
    resistance, start = 3.0, problem.state_vector({"theta1": 0.6})
    steps = []
    for apart in (10.0, 1000.0):
        coils = {"L": resistance / 1e5, "L_coil2": resistance / 1e5 * apart}
        dynamics = problem.dynamics(problem.values(parameters=coils))
        run = simulate(dynamics, start, until=1.0)
        steps.append(sum(len(arc.flow_times) - 1 for arc in run.arcs))
    # The explicit engine takes 15 700 for either.
    assert steps[0] < 2 * steps[1] < 500


def _n_explicit(passage: SegmentResult) -> int:
    trajectory = passage.trajectory
    assert isinstance(trajectory, SteppedTrajectory)
    return sum(isinstance(step, ExplicitStep) for step in trajectory.steps)


@pytest.mark.parametrize("rate", [1e4, 1e6, 1e8])
def test_a_layer_is_all_that_the_default_engine_steps_through_explicitly(rate: float) -> None:
    tolerance = Tolerance(relative=1e-8, absolute=1e-9)
    # From y(0) = 2 a layer exp(-rate t) is added to cos t. Order 8 crosses it, ln(1 / 1e-9) = 21
    # times 1 / rate, in steps that grow from 0.3 to 3 of that.
    leg = _leg(_prothero_robinson(rate), np.array([2.0, 0.0]), 10.0, tolerance)
    passage = Automatic().follow(leg)
    assert 10 < _n_explicit(passage) < 40
    assert passage.duration == pytest.approx(math.pi / 2, abs=10 * tolerance.relative)
    # Without the layer the first look at the rates is after five steps.
    smooth = _leg(_prothero_robinson(rate), np.array([1.0, 0.0]), 10.0, tolerance)
    assert _n_explicit(Automatic().follow(smooth)) <= 6


def test_a_leg_that_is_nearly_over_is_finished_explicitly() -> None:
    # Stiff, but the guard falls after 20 / rate.
    rate = 1e6
    leg = _leg(_prothero_robinson(rate), np.array([math.cos(1.0), 1.0]), 20.0 / rate)
    passage = Automatic().follow(leg)
    assert _n_explicit(passage) == _n_steps(passage)


@pytest.mark.parametrize(("bound", "stays"), [(2e-4, True), (2e-3, False)])
def test_steps_of_a_bounded_length_stay_explicit_unless_stability_shortens_them(
    bound: float, stays: bool
) -> None:
    # A stable explicit step is at most about 6 / rate.
    leg = _leg(_prothero_robinson(1e4), np.array([1.0, 0.0]), 0.05)
    explicit = RungeKutta(largest_step=bound)
    passage = Automatic(explicit=explicit, implicit=Radau(largest_step=bound)).follow(leg)
    assert (_n_explicit(passage) == _n_steps(passage)) is stays
    assert (passage.state.tolist() == explicit.follow(leg).state.tolist()) is stays
    assert passage.state[0] == pytest.approx(math.cos(0.05), abs=1e-11)


def test_flights_that_share_their_memory_do_not_disturb_each_other() -> None:
    problem = load_problem("motor_pendulum")
    values = problem.values().vector
    compiled = problem.compiled()
    shared = bind(compiled, values)
    y = np.array([0.2, 0.0, -5.0, 1.0, -1.8, 0.0, 1.0])
    speeds = (0.3, 2.0)
    for take in (_explicit_end, _implicit_end):
        alone = [take(bind(compiled, values).flight(speed), y) for speed in speeds]
        flows = [shared.flight(speed) for speed in speeds]
        # In turns: first both rates, then both steps, then the first guard again.
        assert flows[0].rate(y)[:2] * 2.0 == pytest.approx(flows[1].rate(y)[:2] * 0.3)
        together = [take(flow, y) for flow in flows]
        for (after, guard), (after_alone, guard_alone) in zip(together, alone, strict=True):
            assert after.tolist() == after_alone.tolist()
            assert guard == guard_alone
        assert flows[0].guard(together[0][0]) == alone[0][1]
        assert flows[0].guard(together[1][0]) == alone[1][1]


def _explicit_end(flow: FlowWithEvent, y: Vector) -> tuple[Vector, tuple[float, float]]:
    after, _ = flow.attempt(y, 1e-3, TIGHT)
    return after, flow.guard(after)


def _implicit_end(flow: FlowWithEvent, y: Vector) -> tuple[Vector, tuple[float, float]]:
    after = flow.newton(radau_scheme(7)).begin(y, 1e-3, TIGHT, None).after
    return after, flow.guard(after)


@pytest.mark.parametrize("engine", [Radau(), Automatic()])
def test_a_flow_that_blows_up_ends_in_a_named_error(engine: Radau | Automatic) -> None:
    # y' = y^2 from 1 is infinite at t = 1.
    flow = PlainFlow(field=lambda y: y**2, guard_and_rate=lambda _: (1.0, 0.0))
    with np.errstate(all="ignore"), pytest.raises(StepSizeError, match="rounding level"):
        engine.follow(_leg(flow, np.array([1.0]), 2.0))
