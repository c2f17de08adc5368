"""Named programs: what is solved, what is refused, and what a failure says."""

from __future__ import annotations

import math
import time

import casadi as ca
import numpy as np
import pytest

from zeno_orbits.search.transcription.ipopt import (
    Hessian,
    IpoptSettings,
    Solution,
    SolveStatus,
    row_rounding,
    solve,
)
from zeno_orbits.search.transcription.program import Derived, NonlinearProgram, ProgramBuilder

G = 9.81
TIGHT = 1e-9


def _throw(flight_time: float, *, most_speed: float = math.inf) -> NonlinearProgram:
    """Return the program of a ball that lands after a given time."""
    builder = ProgramBuilder()
    speed = builder.variable("speed", 1.0, scale=10.0, upper=most_speed)
    landing = speed * flight_time - G * flight_time**2 / 2
    builder.equal("the ball lands", landing, scale=G)
    builder.report("peak", speed**2 / (2 * G))
    return builder.build()


@pytest.mark.parametrize("hessian", list(Hessian))
def test_a_ball_that_lands_after_one_second_has_half_of_g(hessian: Hessian) -> None:
    started = time.perf_counter()
    solution = solve(_throw(1.0), IpoptSettings(hessian=hessian))
    assert solution.wall_time < time.perf_counter() - started
    assert solution.status is SolveStatus.SOLVED
    assert solution.values["speed"][0, 0] == pytest.approx(G / 2, rel=TIGHT)
    assert solution.values["peak"][0, 0] == pytest.approx(G / 8, rel=TIGHT)
    assert set(solution.residuals) == {"the ball lands"}
    assert solution.residuals["the ball lands"] < TIGHT
    assert solution.wall_time > 0.0


def test_a_speed_that_is_not_allowed_leaves_the_ball_in_the_wrong_place() -> None:
    solution = solve(_throw(1.0, most_speed=3.0))
    assert solution.status is not SolveStatus.SOLVED
    (name, size), *_ = solution.worst()
    assert name == "the ball lands"
    # In units of g the landing misses by 3 / g - 1 / 2, if the speed is at its bound.
    assert size >= 0.5 - 3 / G - 1e-6
    assert solution.values["speed"][0, 0] <= 3.0 * (1 + 1e-6)


def test_conditions_that_contradict_each_other_are_named() -> None:
    builder = ProgramBuilder()
    x = builder.variable("x", [0.5, 0.5])
    builder.equal("on the circle", ca.sumsqr(x) - 1)
    builder.equal("far to the right", x[0] - 3)
    solution = solve(builder.build())
    assert solution.status in (SolveStatus.INFEASIBLE, SolveStatus.RESTORATION_FAILED)
    assert {name for name, size in solution.worst() if size > 1e-3} <= {
        "on the circle",
        "far to the right",
    }
    assert solution.worst(1)[0][1] > 0.1


def test_more_conditions_than_unknowns_are_told() -> None:
    builder = ProgramBuilder()
    x = builder.variable("x", 0.5)
    builder.equal("one", x - 1)
    builder.equal("two", x - 2)
    solution = solve(builder.build())
    assert solution.status is SolveStatus.TOO_FEW_FREEDOMS


def test_a_limit_of_iterations_is_told() -> None:
    builder = ProgramBuilder()
    x = builder.variable("x", [-1.2, 1.0])
    program = builder.variable("unused", 0.0)
    builder.equal("still", program)
    banana = (1 - x[0]) ** 2 + 100 * (x[1] - x[0] ** 2) ** 2
    solution = solve(builder.build(banana), IpoptSettings(most_iterations=3))
    assert solution.status is SolveStatus.ITERATION_LIMIT
    assert solution.iterations == 3


def test_the_objective_is_minimised_over_what_the_rows_leave_free() -> None:
    builder = ProgramBuilder()
    x = builder.variable("x", [1.0, 0.3], scale=[2.0, 0.5])
    builder.equal("on the line", x[0] + x[1] - 2)
    solution = solve(builder.build(ca.sumsqr(x)))
    assert solution.values["x"][:, 0] == pytest.approx([1.0, 1.0], abs=1e-7)
    assert solution.objective == pytest.approx(2.0, abs=1e-7)


# Residuals.


def _unsolved(program: NonlinearProgram) -> Solution:
    """Return the program's guess as a solution: no iteration is allowed."""
    return solve(program, IpoptSettings(most_iterations=0))


def test_residuals_are_recomputed_from_the_rows() -> None:
    builder = ProgramBuilder()
    x = builder.variable("x", [1.0, 2.0, 5.0], scale=4.0)
    builder.equal("first", x[0] - 3, scale=4.0)
    builder.at_least_zero("second", x[1] - 7)
    builder.at_least_zero("third", x[2] - 4)
    solution = _unsolved(builder.build())
    assert solution.residuals == pytest.approx({"first": 0.5, "second": 5.0, "third": 0.0})
    assert [name for name, _ in solution.worst(2)] == ["second", "first"]


def test_rows_of_one_name_give_their_largest() -> None:
    builder = ProgramBuilder()
    x = builder.variable("x", [[1.0, 2.0], [-3.0, 4.0]])
    builder.equal(["left", "right"], x)
    program = builder.build()
    assert program.row_names == ("left", "left", "right", "right")
    assert _unsolved(program).residuals == pytest.approx({"left": 3.0, "right": 4.0})


# Blocks.


def test_blocks_come_back_in_their_own_shape_and_units() -> None:
    guess = np.arange(6.0).reshape(2, 3)
    builder = ProgramBuilder()
    builder.variable("before", -1.0, scale=7.0)
    matrix = builder.variable("matrix", guess, scale=[2.0, 1e-3])
    builder.report("second row", matrix[1, :])
    builder.equal("kept", matrix - ca.DM(guess))
    program = builder.build()
    assert program.names == {"before": (0, (1, 1)), "matrix": (1, (2, 3))}
    solution = _unsolved(program)
    assert solution.values["matrix"] == pytest.approx(guess)
    assert solution.values["second row"] == pytest.approx(guess[1:])
    assert solution.values["before"].tolist() == [[-1.0]]


@pytest.mark.parametrize(("bounds", "best"), [((1.0, 9.0), 1.0), ((-9.0, -2.0), -2.0)])
def test_bounds_hold_at_the_solution(bounds: tuple[float, float], best: float) -> None:
    builder = ProgramBuilder()
    x = builder.variable("x", best, scale=5.0, lower=bounds[0], upper=bounds[1])
    y = builder.variable("y", 0.0)
    builder.equal("y is one", y - 1)
    solution = solve(builder.build(x**2))
    # A bound may be passed by Ipopt's relaxation, 1e-8 relative.
    assert solution.values["x"][0, 0] == pytest.approx(best, abs=1e-6)


# Ipopt's words.


@pytest.mark.parametrize("word", ["", "Internal_Error", "solve_succeeded", "A new word"])
def test_a_status_that_nobody_knows_is_a_stop_and_no_success(word: str) -> None:
    assert SolveStatus.from_ipopt(word) is SolveStatus.STOPPED


def _drowned(target: float) -> NonlinearProgram:
    """Return a program whose first row is the difference of two terms of size 1e9."""
    builder = ProgramBuilder()
    x = builder.variable("x", [0.9, 1.1])
    builder.equal("difference", 1e9 * (ca.sin(x[0]) - ca.sin(x[1]) * ca.sin(target) / ca.sin(2)))
    builder.equal("sum", x[0] + ca.sin(x[1]) - 1.7)
    return builder.build()


@pytest.mark.parametrize("target", [1.0, 1.1, 1.3])
def test_a_row_is_met_as_well_as_the_rounding_of_its_terms_lets_it(target: float) -> None:
    # Sines are right to half a rounding: the row to about 1e9 * 1e-16, far above the tolerance.
    solution = solve(_drowned(target), IpoptSettings(hessian=Hessian.LIMITED_MEMORY))
    assert solution.status is SolveStatus.SOLVED
    assert solution.iterations < 12
    # Residuals are told as they are, not as they were weighted.
    assert solution.residuals["difference"] < 4 * 1e9 * np.finfo(np.float64).eps
    x = solution.values["x"][:, 0]
    assert math.sin(x[0]) == pytest.approx(math.sin(x[1]) * math.sin(target) / math.sin(2))


def test_the_rounding_of_a_row_is_that_of_its_terms() -> None:
    builder = ProgramBuilder()
    x = builder.variable("x", [2.0, -3.0])
    builder.equal("steep", 1e6 * x[0] + 4 * x[1])
    builder.equal("endless", 1 / (x[0] - 2))
    eps = float(np.finfo(np.float64).eps)
    # A pole at the guess has no rounding; the row keeps its weight and is missed.
    steep, endless = row_rounding(builder.build())
    assert steep == pytest.approx(4 * eps * (2e6 + 12.0))
    assert endless == 0.0


def test_a_steep_row_that_cannot_be_met_is_still_missed() -> None:
    builder = ProgramBuilder()
    x = builder.variable("x", [0.5, 0.5])
    builder.equal("on the circle", 1e9 * (ca.sumsqr(x) - 1))
    builder.equal("far to the right", x[0] - 3)
    solution = solve(builder.build())
    assert solution.status not in (SolveStatus.SOLVED, SolveStatus.ACCEPTABLE)
    assert solution.worst(1)[0][1] > 0.1


def _inverse_of_a_sum(slope_factor: float) -> tuple[ProgramBuilder, ca.MX]:
    """Return a program of two numbers, and the inverse of their sum by a linear equation."""
    builder = ProgramBuilder()
    first, second = (builder.variable(name, 1.0, scale=2.0)[0, 0] for name in ("a", "b"))
    inverse = ca.solve(first + second, ca.MX(1), "qr")
    # The unknowns are scaled: a change of one of them by 1 changes its number by 2.
    slope = -slope_factor * 2.0 * inverse**2 * ca.MX.ones(1, 2)
    return builder, builder.derived("inverse", Derived(value=inverse, slope=slope))


def test_a_quantity_that_linear_equations_give_is_one_of_rows_cost_and_reports() -> None:
    builder, inverse = _inverse_of_a_sum(1.0)
    third = builder.variable("c", 3.0)[0, 0]
    builder.equal("c is the inverse", third - inverse)
    builder.at_least_zero("a", builder.at_guess(inverse) - inverse)
    builder.report("twice", 2 * inverse)
    program = builder.build((inverse - 0.25) ** 2)
    at = ca.Function("at", [program.unknowns], [program.rows, program.jacobian])
    rows, jacobian = at([1.0, 1.5, 0.5])
    assert rows.full().ravel() == pytest.approx([0.5 - 1 / 5, 0.5 - 1 / 5])
    expected = [[2 / 25, 2 / 25, 1.0], [2 / 25, 2 / 25, 0.0]]
    assert jacobian.full() == pytest.approx(np.array(expected))
    solution = solve(program, IpoptSettings(hessian=Hessian.LIMITED_MEMORY))
    assert solution.status is SolveStatus.SOLVED
    assert solution.values["a"][0, 0] + solution.values["b"][0, 0] == pytest.approx(4.0, rel=1e-4)
    assert solution.values["twice"][0, 0] == pytest.approx(2 * solution.values["c"][0, 0])


def test_a_wrong_derivative_of_such_a_quantity_is_seen_in_the_rows() -> None:
    builder, inverse = _inverse_of_a_sum(1.1)
    builder.equal("inverse", inverse)
    program = builder.build()
    slope = ca.Function("slope", [program.unknowns], [program.jacobian])([1.0, 1.5])
    assert slope.full() == pytest.approx(np.full((1, 2), -1.1 * 2 / 25))


# What Ipopt is asked, and what is made of its answer.


def test_a_guess_is_hardly_pushed_off_its_bounds_as_it_comes_from_a_simulation() -> None:
    builder = ProgramBuilder()
    builder.variable("wide", 0.0, lower=0.0)
    builder.variable("narrow", 2.0, lower=1.0, upper=2.0)
    builder.variable("narrower", 0.5, lower=0.5, upper=0.75)
    builder.at_least_zero("row", builder.variable("x", 1.0))
    values = _unsolved(builder.build()).values
    assert values["wide"][0, 0] == pytest.approx(1e-6, rel=1e-2)
    # Of two bounds it counts how far they are apart, if that is less.
    assert 2.0 - values["narrow"][0, 0] == pytest.approx(1e-6, rel=1e-2)
    assert values["narrower"][0, 0] - 0.5 == pytest.approx(0.25e-6, rel=1e-1)
    options = IpoptSettings().as_casadi()["ipopt"]
    assert options["slack_bound_push"] == options["slack_bound_frac"] == 1e-8


def test_ipopt_says_nothing_and_scales_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    options = IpoptSettings().as_casadi()
    assert options["ipopt"]["nlp_scaling_method"] == "none"
    # What is not asked for is not computed, and a failure is told by its status.
    assert not options["calc_lam_p"]
    assert options["no_nlp_grad"]
    solve(_throw(1.0, most_speed=3.0))
    assert capfd.readouterr() == ("", "")


# Rows along columns.


def _line() -> ca.Function:
    x, t = ca.SX.sym("x", 2), ca.SX.sym("t")
    return ca.Function("line", [x, t], [ca.horzcat(x * t, x), ca.sum1(x)])


def test_rows_along_columns_have_a_scale_each_and_a_name_a_column() -> None:
    builder = ProgramBuilder()
    x = builder.variable("x", [[1.0, 3.0], [2.0, 4.0]])
    scale = np.array([[1.0, 10.0], [2.0, 20.0]])
    names = ["left", "right"]
    (sums,) = builder.equal_along(names, _line(), (x, ca.MX(ca.DM([[5.0, 7.0]]))), scale=scale)
    builder.at_least_zero_along("positive", _line(), (x[:, 0], ca.MX(5.0)))
    assert builder.at_guess(sums).full().tolist() == [[3.0, 7.0]]
    program = builder.build()
    rows = ca.Function("rows", [program.unknowns], [program.rows])(program.guess).full().ravel()
    left, right = [5.0, 5.0, 0.1, 0.1], [21.0, 14.0, 0.3, 0.2]
    assert rows == pytest.approx([*left, *right, 5.0, 10.0, 1.0, 2.0])
    assert program.row_names == (*["left"] * 4, *["right"] * 4, *["positive"] * 4)
    assert program.row_lower.tolist() == [0.0] * 12
    assert program.row_upper.tolist() == [0.0] * 8 + [math.inf] * 4
    (equation,) = builder.equations
    assert equation.names == names
