"""A wanted accuracy: what it chooses, whether its estimate bounds the error, when it says no."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import DOP853

import zeno_orbits as zo
from tests.reference.many_digits.execution import extended_execution
from tests.reference.reference_orbit import FIRST_IMPACT, PERIOD, RELEASE, ZENO_STATE, ZENO_TIME
from tests.support.cases import fast
from tests.support.units import Units, in_units
from zeno_orbits import execution_distance
from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError
from zeno_orbits.integrators import Automatic, Radau, RungeKutta, SciPy, Tolerance
from zeno_orbits.model import HybridDynamics, Problem, load_problem
from zeno_orbits.precision import (
    FINEST,
    ExecutionWithError,
    accuracy,
    execution_to_accuracy,
    execution_with_error,
    settings_for,
    why_engine,
)
from zeno_orbits.simulation import (
    Release,
    SimulationSettings,
    ZenoPassage,
    ZenoPoint,
    simulate,
)

GRAVITY, BOUNCE = 9.81, 0.8
FALL = math.sqrt(2 / GRAVITY)
ZENO = FALL * (1 + BOUNCE) / (1 - BOUNCE)
"""Of a ball that falls from 1 m."""


@pytest.fixture(name="ball", scope="module")
def _ball() -> HybridDynamics:
    problem = load_problem("bouncing_ball")
    values = problem.values(parameters={"restitution": BOUNCE})
    return problem.dynamics(values)


FOLLOWED = 1.5 * PERIOD


@pytest.fixture(name="truth", scope="module")
def _truth(problem: Problem) -> dict[str, list[tuple[float, Vector]]]:
    """One and a half periods in extended precision: two Zeno points, one release, the end."""
    until = FOLLOWED
    state = (0.6, 0.0, 0.0, 0.0, 0.0)
    exact = extended_execution(problem, problem.values(), state, until=until, times=[until])
    return {
        name: [(float(p.time), np.array([float(v) for v in p.state])) for p in points]
        for name, points in (
            ("releases", exact.releases),
            ("zeno_points", exact.zeno_points),
            ("end", exact.samples),
        )
    }


def error_of(assured: ExecutionWithError, truth: dict[str, list[tuple[float, Vector]]]) -> float:
    """Return the true error of an execution, in the units of its estimate."""
    run = assured.execution
    found = {
        "releases": [(p.time, p.state) for p in run.releases],
        "zeno_points": [(p.time, p.state) for p in run.zeno_points],
        "end": [(run.end_time, run.end_state)],
    }
    ends = [x for arc in run.arcs for x in (arc.start_state, arc.end_state)]
    unit, scale = run.events[-1].time, np.max(np.abs(ends), axis=0)
    return max(
        max(abs(time - true_time) / unit, float(np.max(np.abs(x - true_x) / scale)))
        for name in truth
        for (time, x), (true_time, true_x) in zip(found[name], truth[name], strict=True)
    )


# ------------------------------------------------------------------------------- settings


@pytest.mark.parametrize("wanted", [math.nan, math.inf, -1.0, 0.0, 1e-20, 0.9e-12, 0.011, 1.0])
def test_what_is_no_accuracy_in_reach_is_refused(wanted: float) -> None:
    with pytest.raises(InputError, match=r"`accuracy` must lie in \[1e-12, 0\.01\], but it is"):
        settings_for(wanted)


@pytest.mark.parametrize("wanted", [FINEST, 1e-6, 0.01])
def test_the_tolerance_is_below_the_accuracy_and_all_else_is_kept(wanted: float) -> None:
    given = SimulationSettings(engine=Radau(), most_impacts=17)
    chosen = settings_for(wanted, given)
    assert chosen.tolerance.absolute < chosen.tolerance.relative < wanted
    assert isinstance(chosen.completion, ZenoPassage)
    assert chosen.completion.tolerance <= wanted
    same = replace(chosen, tolerance=given.tolerance, completion=given.completion)
    assert same == given


# ------------------------------------------------------------------------ the error estimate


@pytest.mark.parametrize("wanted", [1e-3, 1e-6, 1e-9])
@pytest.mark.slow
def test_the_estimate_bounds_the_true_error_and_keeps_the_accuracy(
    wanted: float, machine: HybridDynamics, truth: dict[str, list[tuple[float, Vector]]]
) -> None:
    start = (0.6, 0.0, 0.0, 0.0, 0.0)
    assured = execution_to_accuracy(machine, start, until=FOLLOWED, accuracy=wanted)
    assert error_of(assured, truth) <= assured.error <= wanted


@pytest.mark.parametrize("wanted", fast(1, [1e-6, 1e-9]))
def test_an_execution_that_is_off_is_seen_to_be(
    wanted: float, machine: HybridDynamics, truth: dict[str, list[tuple[float, Vector]]]
) -> None:
    """The same comparison on a start that is off by more than the accuracy."""
    start = (0.6 * (1 + 10 * wanted), 0.0, 0.0, 0.0, 0.0)
    assured = execution_to_accuracy(machine, start, until=FOLLOWED, accuracy=wanted)
    assert error_of(assured, truth) > assured.error


@pytest.mark.parametrize("wanted", [1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("until", [0.1, 0.6, 5.0, 1e6])
def test_a_ball_is_as_exact_as_said(ball: HybridDynamics, until: float, wanted: float) -> None:
    assured = execution_to_accuracy(ball, (1.0, 0.0), until=until, accuracy=wanted)
    assert 0.0 < assured.error <= wanted
    run = assured.execution
    if run.impacts:
        assert abs(run.impacts[0].time - FALL) <= assured.error * run.events[-1].time
    if run.zeno_points:
        assert abs(run.zeno_points[0].time - ZENO) <= assured.error * ZENO
    height = max(0.0, 1 - GRAVITY * until**2 / 2)
    if until != 0.6:
        assert abs(run.end_state[0] - height) <= assured.error


def test_times_are_judged_by_the_last_event_and_not_by_a_far_horizon(
    ball: HybridDynamics,
) -> None:
    """A ball that lies still for eleven days excuses no error of its bounces."""
    early, late = (simulate(ball, (height, 0.0), until=1e6) for height in (1.0, 1.0 + 2e-3))
    # The times grow by the root of the height, the speeds too.
    assert execution_distance(early, late) == pytest.approx(1e-3, rel=0.01, abs=1.1e-3)
    assert execution_distance(early, late) > 0.9e-3


# ------------------------------------------------------------ the error of Zeno points, total

ENGINES = {
    "automatic": Automatic(),
    "explicit": RungeKutta(),
    "implicit": Radau(),
    "scipy": SciPy(method=DOP853),
}
Points = list[tuple[float, Vector]]


@dataclass(frozen=True, kw_only=True)
class Motion:
    """A system with a start, and its Zeno points in extended precision."""

    dynamics: HybridDynamics
    start: Sequence[float]
    until: float
    points: Points


@cache
def motion(name: str) -> Motion:
    problem, until = load_problem(name), UNTIL[name]
    start = problem.state_vector(problem.starts[0]) if name != "bouncing_ball" else (1.0, 0.0)
    exact = extended_execution(problem, problem.values(), start, until=until)
    points = [(float(p.time), np.array([float(v) for v in p.state])) for p in exact.zeno_points]
    assert points
    dynamics = problem.dynamics(problem.values())
    return Motion(dynamics=dynamics, start=start, until=until, points=points)


UNTIL = {
    "bouncing_ball": 5.0,
    "forced_oscillator": 14.0,
    "motor_pendulum": 4.5,
    "motor_valve": 1.0,
    "torque_pendulum": 4.0,
    "two_motors": 4.0,
}
"""Seconds in which the impacts accumulate once at least."""


def off(found: ZenoPoint, truth: tuple[float, Vector]) -> float:
    """Return how far a Zeno point is off, relative to one plus its numbers."""
    time, state = truth
    states = np.abs(found.state - state) / (1 + np.abs(state))
    return max(abs(found.time - time) / (1 + time), float(np.max(states)))


@pytest.mark.slow
@pytest.mark.parametrize("relative", [1e-4, 1e-8, 1e-12])
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("name", UNTIL)
def test_the_error_of_a_zeno_point_bounds_the_true_one(
    name: str, engine: str, relative: float
) -> None:
    case = motion(name)
    settings = SimulationSettings(
        engine=ENGINES[engine], tolerance=Tolerance(relative=relative, absolute=relative / 10)
    )
    seen = execution_with_error(case.dynamics, case.start, until=case.until, settings=settings)
    found = seen.execution.zeno_points
    assert len(found) == len(seen.zeno_errors) == len(case.points)
    for point, error, truth in zip(found, seen.zeno_errors, case.points, strict=True):
        assert off(point, truth) <= error
    # Honest, and not merely large: at a tolerance that is worth it, within some periods.
    assert relative > 1e-8 or max(seen.zeno_errors) < 1e5 * relative


@pytest.mark.slow
def test_the_estimate_of_the_limit_alone_bounds_nothing_of_that() -> None:
    """What a Zeno point used to call its error is a billion times too small for a coarse run."""
    case = motion("forced_oscillator")
    coarse = SimulationSettings(tolerance=Tolerance(relative=1e-4, absolute=1e-5))
    run = simulate(case.dynamics, case.start, until=case.until, settings=coarse)
    assert off(run.zeno_points[0], case.points[0]) > 1e6 * run.zeno_points[0].limit_error


def test_two_runs_that_take_the_same_steps_are_not_taken_for_exact() -> None:
    """Collocation of order 13 goes through a flight in one step at either tolerance."""
    case = motion("forced_oscillator")
    rough = Tolerance(relative=1e-4, absolute=1e-5)
    looser = Tolerance(relative=1e-2, absolute=1e-3)
    first, second = (
        simulate(
            case.dynamics,
            case.start,
            until=case.until,
            settings=SimulationSettings(engine=Radau(), tolerance=tolerance),
        ).zeno_points[0]
        for tolerance in (rough, looser)
    )
    true = off(first, case.points[0])
    assert true > 10 * abs(first.time - second.time)
    assert true <= rough.relative


def test_zeno_points_that_only_one_run_has_are_of_unknown_error(ball: HybridDynamics) -> None:
    run = simulate(ball, (1.0, 0.0), until=5.0)
    assert list(accuracy.errors_of_zeno_points(None, run)) == [math.inf]
    assert list(accuracy.errors_of_zeno_points(replace(run, events=run.impacts), run)) == [math.inf]
    released = (Release(time=0.1, state=np.zeros(2)), *run.events)
    assert list(accuracy.errors_of_zeno_points(replace(run, events=released), run)) == [math.inf]
    assert list(accuracy.errors_of_zeno_points(run, run)) == [run.zeno_points[0].limit_error]


# ---------------------------------------------------------------- events close to the horizon


@pytest.mark.parametrize("shift", [-1e-9, -1e-13, 0.0, 1e-13, 1e-9])
def test_a_zeno_point_at_the_horizon_is_no_reason_to_say_no(
    ball: HybridDynamics, shift: float
) -> None:
    assured = execution_to_accuracy(ball, (1.0, 0.0), until=ZENO * (1 + shift), accuracy=1e-6)
    assert assured.error <= 1e-6
    assert abs(assured.execution.end_state[0]) <= 1e-6


@pytest.mark.parametrize("where", [FIRST_IMPACT, ZENO_TIME, PERIOD])
def test_an_event_of_the_orbit_at_the_horizon_is_no_reason_to_say_no(
    machine: HybridDynamics, where: float
) -> None:
    assured = execution_to_accuracy(machine, RELEASE, until=where, accuracy=1e-6)
    assert assured.error <= 1e-6
    if where == ZENO_TIME:
        # Off by the error, in units of each state's size; the largest is below 20.
        assert np.max(np.abs(assured.execution.end_state - ZENO_STATE)) < 20 * assured.error


def test_an_event_that_one_run_has_and_the_other_has_not_counts_by_how_late_it_is(
    ball: HybridDynamics,
) -> None:
    """One ball is 1e-6 s before its Zeno point where another one has just reached it."""
    first = simulate(ball, (1.0, 0.0), until=ZENO + 1e-6)
    second = simulate(ball, ((1 + 2e-6 / ZENO) ** 2, 0.0), until=ZENO + 1e-6)
    assert len(first.zeno_points) == 1
    assert not second.zeno_points
    shorter, longer = execution_distance(first, second), execution_distance(second, first)
    assert min(shorter, longer) > 1e-7
    assert max(shorter, longer) < 1e-4


def test_one_impact_more_before_the_horizon_is_held_against_the_end(ball: HybridDynamics) -> None:
    before, after = (simulate(ball, (h, 0.0), until=FALL) for h in (1 + 1e-6, 1 - 1e-6))
    assert (len(before.impacts), len(after.impacts)) == (0, 1)
    # The speed at the end of the one is the speed before the impact of the other.
    assert execution_distance(before, after) < 1e-5
    far = simulate(ball, (2.0, 0.0), until=FALL)
    assert execution_distance(far, after) > 0.1


def test_executions_that_go_different_ways_are_infinitely_apart(machine: HybridDynamics) -> None:
    run = simulate(machine, RELEASE, until=2.9 * PERIOD)
    first = run.returns(PERIOD)[0]
    without = tuple(event for event in run.events if event is not first)
    assert len(without) == len(run.events) - 1
    assert math.isinf(execution_distance(run, replace(run, events=without)))
    assert execution_distance(run, run) == 0.0


# ------------------------------------------------------------------------------- landmarks


def test_a_ball_at_rest_has_no_error_but_its_tolerance(ball: HybridDynamics) -> None:
    """All states are zero all the time."""
    assured = execution_to_accuracy(ball, (0.0, 0.0), until=1.0, accuracy=1e-9)
    # No run claims to be better than its tolerance, even one that is.
    assert 0.0 < assured.error == assured.settings.tolerance.relative <= 1e-9
    assert not assured.execution.end_state.any()


# ------------------------------------------------------------------------------ the reason


def test_the_reason_for_an_engine_names_the_rates(machine: HybridDynamics) -> None:
    assert "implicit" in why_engine(machine, RELEASE, 1.0)
    assert "1.5e+03 1/s" in why_engine(machine, RELEASE, 1.0)
    ball = load_problem("bouncing_ball").dynamics(load_problem("bouncing_ball").values())
    assert why_engine(ball, (1.0, 0.0), 1.0) == "explicit steps (DOP853): nothing decays."


@pytest.mark.parametrize("engine", [Automatic(), RungeKutta(), Radau()])
def test_every_engine_keeps_the_accuracy(
    engine: Automatic | RungeKutta | Radau, machine: HybridDynamics
) -> None:
    settings = SimulationSettings(engine=engine)
    assured = execution_to_accuracy(
        machine, RELEASE, until=1.1 * PERIOD, accuracy=1e-6, settings=settings
    )
    assert abs(assured.execution.returns(PERIOD)[0].time - PERIOD) <= assured.error * PERIOD
    assert assured.settings.engine == engine


def test_an_error_estimate_is_the_same_number_in_any_units() -> None:
    # So small a table in so long a second that 1 and 1e-12 of an SI unit would be vast beside it.
    # Own sizes are powers of a thousand, so steps differ by what less than that is.
    table = load_problem("vibrating_table")
    found: list[ExecutionWithError] = []
    for problem, unit in ((table, 1.0), (in_units(table, Units(length=1e-12, time=1e-6)), 1e-6)):
        dynamics = problem.dynamics(problem.values())
        start = problem.state_vector(problem.starts[0])
        found.append(execution_with_error(dynamics, start, until=2.0 * unit))
    here, there = found
    assert len(here.zeno_errors) == len(there.zeno_errors) > 3
    assert 0.1 < there.error / here.error < 10.0
    for one, other in zip(here.zeno_errors, there.zeno_errors, strict=True):
        assert 0.1 < other / one < 10.0


def test_the_accuracy_of_a_simulation_takes_a_problem_or_its_dynamics() -> None:
    ball = zo.load_problem("bouncing_ball")
    dynamics, state = ball.dynamics(ball.values()), ball.state_vector({"height": 1.0})
    one = zo.simulate_to_accuracy(dynamics, state, until=0.6, accuracy=1e-8)
    other = zo.simulate_to_accuracy(ball, start={"height": 1.0}, until=0.6, accuracy=1e-8)
    # A fall from 1 m: sqrt(2 / g).
    g = ball.values().parameters["g"]
    for found in (one, other):
        assert abs(found.execution.impacts[0].time - (2.0 / g) ** 0.5) < 1e-8
    with pytest.raises(zo.InputError, match="needs `state`"):
        zo.simulate_to_accuracy(dynamics, accuracy=1e-8)
    with pytest.raises(zo.InputError, match="exclude each other"):
        zo.simulate_with_error(ball, state, start={"height": 1.0})
