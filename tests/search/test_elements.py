"""Programs of elements against CasADi's own derivatives, and their sums against quadratures."""

from __future__ import annotations

import math
from typing import Any

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.reference.closed_forms import FORCED
from tests.reference.reference_orbit import RELEASE
from tests.support.mechanisms import forced_oscillator, oscillator_state
from zeno_orbits.model import HybridDynamics, Problem
from zeno_orbits.orbits import EventCourse, EventQuantities, EventReturn
from zeno_orbits.search import settled_return
from zeno_orbits.search.program.closure import closure_of
from zeno_orbits.search.program.elements import ElementBuilder, LegElement
from zeno_orbits.search.program.ipopt import IpoptSettings, SolveStatus
from zeno_orbits.search.program.terms import SearchTerms
from zeno_orbits.search.program.writer import PeriodProgram, free_places, write_period
from zeno_orbits.simulation import Impact, estimate_tail, extrapolate, simulate


def written(name: str, **ranges: tuple[float, float]) -> tuple[EventReturn, PeriodProgram]:
    """Return an orbit and its program, whose guess is the orbit."""
    problem = zo.load_problem(name)
    values = problem.values()
    graph, found = problem.graph_dynamics(values), settled_return(problem, values)
    builder = ElementBuilder()
    free = dict(zip(ranges, free_places(builder, graph, ranges).tolist(), strict=True))
    return found, write_period(builder, graph, found, free, has_work=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "ranges"),
    [
        ("relief_valve", {"q": (0.1, 0.5), "restitution": (0.1, 0.6)}),
        pytest.param("clapper", {"A": (3.0, 8.0)}, marks=pytest.mark.slow),
        pytest.param("relay_soft", {"t1": (5e-4, 1.6e-3)}, marks=pytest.mark.slow),
        pytest.param("powered_walker", {"Kp": (3.0, 9.0)}, marks=pytest.mark.slow),
    ],
)
def test_derivatives_are_those_of_the_whole_expression(name: str, ranges: Any) -> None:
    _, period = written(name, **ranges)
    builder = period.builder
    builder.cost_of({int(period.legs[0].event[1]): 0.7})
    builder.cost_of_distance(int(period.free[0]), 2.0, 1.0)
    program = builder.built()
    z, f, g = (program.functions[key] for key in "xfg")
    random = np.random.default_rng(3)
    at = program.guess * (1 + 1e-3 * random.uniform(-1, 1, program.guess.size))
    weights, factor = random.uniform(-1, 1, g.numel()), 0.3
    own = program.derivatives["jac_g"](at, [])[1]
    wanted = ca.Function("J", [z], [ca.jacobian(g, z)])(at)
    size = float(np.max(np.abs(wanted.full())))
    assert np.max(np.abs((own - wanted).full())) < 1e-13 * size
    slope = program.derivatives["grad_f"](at, [])[1].full()
    assert np.allclose(slope, ca.Function("s", [z], [ca.gradient(f, z)])(at).full(), atol=1e-13)
    lagrangian = factor * f + ca.dot(ca.DM(weights), g)
    # Reverse over reverse is another way than the elements' own Hessians.
    second = ca.Function("H", [z], [ca.jacobian(ca.gradient(lagrangian, z), z)])(at).full()
    upper = program.derivatives["hess_lag"](at, [], factor, weights).full()
    assert np.max(np.abs(upper - np.triu(second))) < 1e-11 * np.max(np.abs(second))


def test_a_program_of_elements_has_the_closed_form_of_rosenbrock_on_a_circle() -> None:
    # On x^2 + y^2 = 2 the least of (1 - x)^2 + 100 (y - x^2)^2 is 0 at (1, 1).
    x = ca.SX.sym("x", 2)
    element = LegElement.of(
        x,
        ca.SX(0, 1),
        ca.vertcat((1 - x[0]) ** 2 + 100 * (x[1] - x[0] ** 2) ** 2, ca.dot(x, x)),
    )
    builder = ElementBuilder()
    places = builder.unknowns([0.5, 0.7], [3.0, 0.2])
    out = builder.outputs(element, places[:, None], np.zeros(0))
    builder.rows("circle", outputs=[(out[1], 1.0)], constant=-2.0)
    builder.cost_of({int(out[0, 0]): 1.0})
    solution = builder.built().solve(IpoptSettings(optimality=1e-10, first_barrier=0.1))
    assert solution.status is SolveStatus.SOLVED
    assert np.allclose(solution.unknowns, 1.0, atol=1e-9)
    assert solution.violation < 1e-11


def test_a_program_whose_rows_cannot_be_met_is_not_solved() -> None:
    builder = ElementBuilder()
    x = ca.SX.sym("x")
    place = builder.unknowns([1.0], 1.0)
    out = builder.outputs(LegElement.of(x, ca.SX(0, 1), x**2), place[:, None], np.zeros(0))
    builder.rows("square", outputs=[(out[0], 1.0)], constant=1.0)
    solution = builder.built().solve(IpoptSettings())
    assert solution.status is not SolveStatus.SOLVED
    assert solution.residuals["square"] > 0.9


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "clapper",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("relay_soft", "powered_walker", "motor_pendulum")
        ),
    ],
)
def test_sums_of_a_program_are_those_of_the_simulated_orbit(name: str) -> None:
    # Quadrature of the stages and the tail against a rule of Newton and Cotes along the steps.
    found, period = written(name)
    course = EventCourse(graph=period.graph, found=found, parameters=())
    terms = SearchTerms(periods=(period,), free={})
    work = terms.measured(period, "energy")[0]
    assert work == pytest.approx(course.work.value, rel=1e-9)
    quantities = EventQuantities.of(period.graph, found)
    for stop in period.graph.stop_names:
        for word in ("impact_speed", "bounce_time", "energy_lost"):
            own = [one.value for one in quantities.readings(f"{stop}.{word}")]
            assert sorted(terms.measured(period, f"{stop}.{word}")) == pytest.approx(
                sorted(own), rel=1e-9, abs=1e-300
            )


# The closure of a program by the limit of its impacts.

ACCURACY = 1e-11


@pytest.fixture(name="oscillator", scope="module")
def _oscillator() -> HybridDynamics:
    return forced_oscillator(FORCED, FORCED.restitution)


@pytest.fixture(name="impacts", scope="module")
def _impacts(oscillator: HybridDynamics) -> tuple[Impact, ...]:
    """The impacts of one period."""
    start = oscillator_state(0.0, FORCED.stop, 0.0)
    run = simulate(oscillator, start, until=2.5 * math.tau)
    return tuple(one for one in run.impacts if one.time < run.zeno_points[0].time)


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5, 1e-7, 1e-9, 1e-11])
def test_a_closure_has_the_fewest_impacts_for_its_tolerance(
    oscillator: HybridDynamics, impacts: tuple[Impact, ...], tolerance: float
) -> None:
    closure = closure_of(impacts, oscillator, tolerance)
    assert closure.error <= tolerance
    for n in range(1, closure.n_impacts):
        fewer = closure_of(impacts[:n], oscillator, tolerance)
        assert fewer.error > tolerance
    assert closure.nodes[-1] == closure.n_impacts - 1
    assert list(closure.nodes) == sorted(set(closure.nodes))


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-6, 1e-8, 1e-10])
def test_the_error_of_a_closure_bounds_the_true_one(
    oscillator: HybridDynamics, impacts: tuple[Impact, ...], tolerance: float
) -> None:
    closure = closure_of(impacts, oscillator, tolerance)
    estimates = []
    for k in closure.nodes:
        impact = impacts[k]
        speed = -oscillator.restitution * impact.approach_rate
        estimate = estimate_tail(oscillator, impact.time, impact.state_plus, speed)
        assert estimate is not None
        estimates.append(estimate)
    limit = extrapolate(oscillator, estimates)
    exact = FORCED.zeno_time()
    assert abs(limit.time - exact) <= closure.error * (1 + exact) + ACCURACY
    point = np.array(oscillator_state(exact, FORCED.stop, 0.0))
    assert np.all(np.abs(limit.state - point) <= closure.error * (1 + np.abs(point)) + ACCURACY)


def test_a_tolerance_that_nothing_reaches_takes_all_impacts(
    oscillator: HybridDynamics, impacts: tuple[Impact, ...]
) -> None:
    closure = closure_of(impacts, oscillator, 0.0)
    assert closure.n_impacts == len(impacts)


def test_a_plastic_impact_closes_alone(problem: Problem) -> None:
    values = problem.values(parameters={"restitution": 0.0})
    plastic = problem.dynamics(values)
    run = simulate(plastic, RELEASE, until=6.0)
    closure = closure_of(run.impacts[-1:], plastic, 1e-12)
    assert closure.n_impacts == 1
    assert closure.nodes == (0,)
    assert closure.error == 0.0
