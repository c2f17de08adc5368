"""A tape gives the numbers of CasADi's interpreter, bit for bit, or names what it cannot do."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

import zeno_orbits as zo
from tests.loop.agreement import needs_compiler
from tests.support.mechanisms import numeric
from tests.support.one_stop import one_stop_problems
from zeno_orbits import HybridLagrangian
from zeno_orbits.arrays import Vector
from zeno_orbits.loop import (
    LoopRun,
    UnknownOperationError,
    binding,
    filled,
    loop_library,
    program_of,
    refusals,
    tape_of,
)
from zeno_orbits.simulation import Execution, SimulationTask, run_settings, simulate

pytestmark = needs_compiler

BINARY: dict[str, Callable[[Any, Any], Any]] = {
    "add": lambda x, y: x + y,
    "subtract": lambda x, y: x - y,
    "multiply": lambda x, y: x * y,
    "divide": lambda x, y: x / y,
    "power": lambda x, y: ca.fabs(x) ** y,
    "constant power": lambda x, y: ca.fabs(x) ** 2.7 + y,
    "atan2": ca.atan2,
    "fmin": ca.fmin,
    "fmax": ca.fmax,
    "fmod": ca.fmod,
    "remainder": ca.remainder,
    "copysign": ca.copysign,
    "hypot": ca.hypot,
    "less": lambda x, y: x < y,
    "at most": lambda x, y: x <= y,
    "equal": lambda x, y: ca.if_else(x == y, 2.0, y),
    "not equal": lambda x, y: ca.if_else(x != y, x, y),
    "and": lambda x, y: ca.logic_and(x > 0, y > 0),
    "or": lambda x, y: ca.logic_or(x > 0, y > 0),
    "not": lambda x, y: ca.logic_not(x > y),
    "if else": lambda x, y: ca.if_else(x > y, ca.sin(x), ca.cos(y)),
}
UNARY: dict[str, Callable[[Any], Any]] = {
    **{
        name: getattr(ca, name)
        for name in (
            *("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh"),
            *("acosh", "atanh", "exp", "expm1", "log", "log1p", "sqrt", "fabs", "floor", "ceil"),
            *("sign", "erf"),
        )
    },
    "square": lambda x: x * x,
    "twice": lambda x: x + x,
    "inverse": lambda x: 1 / x,
    "negative": lambda x: -x,
}
PLACES = [0.0, -0.0, 0.3, -0.3, 1.0, -1.0, 2.5, -7.25, 1e-300, 1e300, math.inf, -math.inf, math.nan]


class _Tried:
    """One formula in the place of a mode's rate, evaluated by the library."""

    def __init__(self, function: ca.Function) -> None:
        problem = zo.load_problem("bouncing_ball")
        dynamics = problem.dynamics(problem.values())
        assert dynamics.formulas is not None
        program = program_of(dynamics.formulas.system)
        assert program is not None
        self._tape = tape_of(function)
        self._program, self._zero = program, ctypes.c_longlong(0)
        self._problem = binding.ProblemType.from_buffer_copy(program.problem)
        self._problem.code = None  # the formulas of the ball may be compiled
        place = self._problem.tapes[binding.LIFT]
        tape = self._tape
        place.n_varying, place.n_parameters = tape.n_varying, tape.n_parameters
        place.n_constants, place.n_registers = tape.constants.size, tape.n_registers
        place.n_once, place.n_instructions = tape.n_once, len(tape.code)
        place.n_outputs = tape.outputs.size
        place.code, place.constants = tape.code.ctypes.data, tape.constants.ctypes.data
        place.outputs = tape.outputs.ctypes.data
        self._function = function
        whole, zero = ctypes.addressof(self._problem), ctypes.addressof(self._zero)
        self._graph = binding.GraphType(n_stops=1, n_views=1, views=whole)
        self._graph.n_numbers = loop_library().zl_room(whole)
        self._graph.view_keys = self._graph.view_places = zero
        self._problem.graph = ctypes.addressof(self._graph)

    def __call__(self, x: Vector, p: Vector) -> Vector:
        library, address = loop_library(), ctypes.addressof(self._problem)
        memory = ctypes.create_string_buffer(library.zl_size(address))
        settings = binding.SettingsType()
        padded = np.zeros(max(self._problem.n_p, p.size))
        padded[: p.size] = p
        state = np.zeros(2)
        library.zl_begin(
            address,
            ctypes.addressof(memory),
            ctypes.addressof(settings),
            padded.ctypes.data,
            state.ctypes.data,
        )
        outputs = np.empty(self._tape.outputs.size)
        library.zl_evaluate(
            address, ctypes.addressof(memory), binding.LIFT, x.ctypes.data, outputs.ctypes.data
        )
        return outputs

    def expected(self, x: Vector, p: Vector) -> Vector:
        return np.array(self._function(x, p)).ravel()


def _same(found: Vector, expected: Vector) -> bool:
    return [one.hex() for one in found.tolist()] == [one.hex() for one in expected.tolist()]


@pytest.mark.parametrize("name", BINARY)
def test_a_binary_operation_is_that_of_the_interpreter(name: str) -> None:
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p", 1)
    tried = _Tried(ca.Function("f", [x, p], [BINARY[name](x[0], x[1]) + 0 * p]))
    for a in PLACES:
        for b in PLACES:
            given, numbers = np.array([a, b]), np.array([1.0])
            with np.errstate(all="ignore"):
                found, expected = tried(given, numbers), tried.expected(given, numbers)
            assert np.isnan(found[0]) == np.isnan(expected[0])
            assert np.isnan(found[0]) or _same(found, expected), (a, b)


@pytest.mark.parametrize("name", UNARY)
def test_a_function_of_one_number_is_that_of_the_interpreter(name: str) -> None:
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p", 1)
    # By the state, and by a parameter: what depends on that alone is carried out once.
    formula = ca.vertcat(UNARY[name](x[0]), UNARY[name](p[0]) * x[1])
    tried = _Tried(ca.Function("f", [x, p], [formula]))
    for a in PLACES:
        given, numbers = np.array([a, 1.0]), np.array([a])
        with np.errstate(all="ignore"):
            found, expected = tried(given, numbers), tried.expected(given, numbers)
        for mine, other in zip(found, expected, strict=True):
            assert (np.isnan(mine) and np.isnan(other)) or float(mine).hex() == float(other).hex()


@pytest.mark.parametrize("name", one_stop_problems())
def test_formulas_of_problems_are_those_of_the_interpreter(name: str) -> None:
    problem = zo.load_problem(name)
    system, values = problem.compiled(), np.array(problem.values().vector)
    task = SimulationTask(
        dynamics=problem.dynamics(problem.values()),
        state=np.array(problem.state_vector(problem.starts[0])),
        until=1.0,
    )
    program = program_of(system)
    assert program is not None
    run = LoopRun(program, filled(run_settings(task)), values, task.state)
    rng = np.random.default_rng(2)
    for _ in range(10):
        x = task.state + rng.uniform(-0.3, 0.3, task.state.size)
        for tape, function in (
            (binding.RATE + binding.FREE, system.free.rate),
            (binding.RATE + binding.LOCKED, system.locked.rate),
            (binding.GUARD + binding.LOCKED, system.locked.guard),
        ):
            expected = np.array(function(x, values)).ravel()
            assert run.evaluate(tape, x, expected.size).tolist() == expected.tolist()
        landed = [np.array(part).ravel() for part in system.landing(x, values, -0.7)]
        found = run.evaluate(binding.LANDING, np.append(x, -0.7), sum(map(len, landed)))
        assert found.tolist() == np.concatenate(landed).tolist()


def test_what_depends_on_parameters_alone_comes_first() -> None:
    x, p = ca.SX.sym("x", 1), ca.SX.sym("p", 2)
    tape = tape_of(ca.Function("f", [x, p], [ca.sin(p[0]) * p[1] + x * ca.exp(p[1])]))
    # A sine, an exponential and a product; then a product with a sum.
    assert tape.n_once == 3
    assert len(tape.code) == 4


def test_an_unknown_operation_is_named() -> None:
    x, p = ca.SX.sym("x", 1), ca.SX.sym("p", 1)
    with pytest.raises(UnknownOperationError, match="erfinv"):
        tape_of(ca.Function("f", [x, p], [ca.erfinv(x) + p]))


def test_formulas_that_tapes_cannot_do_run_in_python_and_are_reported() -> None:
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    ball = numeric(
        HybridLagrangian.from_energies(
            q=q,
            v=v,
            kinetic=v**2 / 2,
            potential=9.81 * q,
            gap=q,
            # Far below rounding, so the fall is that of the closed form.
            passive_force=1e-30 * ca.erfinv(q),
        ),
        restitution=0.5,
    )
    run = simulate(ball, (0.5, 0.0), until=1.0)
    assert type(run) is Execution
    assert run.impacts[0].time == pytest.approx(math.sqrt(1.0 / 9.81), rel=1e-12)
    reason = "a formula holds the operation `erfinv`"
    assert f"some executions run in Python: {reason}" in refusals()
