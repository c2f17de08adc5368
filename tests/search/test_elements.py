"""Programs of elements against CasADi's own derivatives, and their sums against quadratures."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from zeno_orbits.orbits import EventCourse, EventQuantities, EventReturn
from zeno_orbits.search import settled_return
from zeno_orbits.search.program.elements import ElementBuilder, LegElement
from zeno_orbits.search.program.ipopt import IpoptSettings, SolveStatus
from zeno_orbits.search.program.terms import SearchTerms
from zeno_orbits.search.program.writer import PeriodProgram, free_places, write_period


def written(name: str, **ranges: tuple[float, float]) -> tuple[EventReturn, PeriodProgram]:
    """Return an orbit and its program, whose guess is the orbit."""
    problem = zo.load_problem(name)
    values = problem.values()
    graph, found = problem.graph_dynamics(values), settled_return(problem, values)
    builder = ElementBuilder()
    free = dict(zip(ranges, free_places(builder, graph, ranges).tolist(), strict=True))
    return found, write_period(builder, graph, found, free, has_work=True)


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
