"""A CasADi expression as a formula that a person can read, through SymPy."""

from __future__ import annotations

import importlib
import operator
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import casadi as ca

from zeno_orbits.errors import InputError
from zeno_orbits.model.expressions.operations import operation_name
from zeno_orbits.model.hybrid import CompletedSystem
from zeno_orbits.model.problem import ParameterValues, Problem

sympy: Any = importlib.import_module("sympy")
"""SymPy lacks type hints, so it is imported as an untyped value."""


def _divide(a: Any, b: Any) -> Any:
    return a / b


def _power(a: Any, b: Any) -> Any:
    return a**b


def _less_one(a: Any) -> Any:
    return sympy.exp(a) - 1


def _log_of_more(a: Any) -> Any:
    return sympy.log(1 + a)


def _hypotenuse(a: Any, b: Any) -> Any:
    return sympy.sqrt(a**2 + b**2)


def _if_else_zero(holds: Any, a: Any) -> Any:
    return sympy.Piecewise((a, holds), (0, True))


_OPERATIONS: Mapping[int, Callable[..., Any]] = {
    ca.OP_ADD: operator.add,
    ca.OP_SUB: operator.sub,
    ca.OP_MUL: operator.mul,
    ca.OP_DIV: _divide,
    ca.OP_NEG: operator.neg,
    ca.OP_SQ: partial(_power, b=2),
    ca.OP_TWICE: partial(operator.mul, 2),
    ca.OP_INV: partial(_power, b=-1),
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
    ca.OP_SQRT: sympy.sqrt,
    ca.OP_SIN: sympy.sin,
    ca.OP_COS: sympy.cos,
    ca.OP_TAN: sympy.tan,
    ca.OP_ASIN: sympy.asin,
    ca.OP_ACOS: sympy.acos,
    ca.OP_ATAN: sympy.atan,
    ca.OP_ATAN2: sympy.atan2,
    ca.OP_SINH: sympy.sinh,
    ca.OP_COSH: sympy.cosh,
    ca.OP_TANH: sympy.tanh,
    ca.OP_EXP: sympy.exp,
    ca.OP_LOG: sympy.log,
    ca.OP_FABS: sympy.Abs,
    ca.OP_ASINH: sympy.asinh,
    ca.OP_ACOSH: sympy.acosh,
    ca.OP_ATANH: sympy.atanh,
    ca.OP_EXPM1: _less_one,
    ca.OP_LOG1P: _log_of_more,
    ca.OP_HYPOT: _hypotenuse,
    ca.OP_ERF: sympy.erf,
    ca.OP_FMIN: sympy.Min,
    ca.OP_FMAX: sympy.Max,
    ca.OP_SIGN: sympy.sign,
    ca.OP_FLOOR: sympy.floor,
    ca.OP_CEIL: sympy.ceiling,
    ca.OP_LT: sympy.Lt,
    ca.OP_LE: sympy.Le,
    ca.OP_NOT: sympy.Not,
    ca.OP_AND: sympy.And,
    ca.OP_OR: sympy.Or,
    ca.OP_IF_ELSE_ZERO: _if_else_zero,
}


def to_sympy(expression: ca.SX, names: Mapping[str, str]) -> Any:
    """Return a scalar expression as a SymPy expression.

    Args:
        expression: A scalar.
        names: New name of each CasADi symbol by its name. A symbol that is missing keeps its name.

    Raises:
        InputError: If the expression contains an operation that is not supported here.
    """
    known: dict[int, Any] = {}

    def convert(node: ca.SX) -> Any:
        key = node.element_hash()
        if key not in known:
            known[key] = build(node)
        return known[key]

    def build(node: ca.SX) -> Any:
        if node.is_symbolic():
            return sympy.Symbol(names.get(node.name(), node.name()), real=True)
        if node.is_constant():
            number = float(node)
            return sympy.Integer(int(number)) if number.is_integer() else sympy.Float(number, 17)
        if node.is_output():
            raise InputError(
                "Argument `problem`: its gap acceleration holds a table, which no formula names."
            )
        operation = _OPERATIONS.get(node.op())
        if operation is None:
            raise InputError(
                "Argument `problem`: its gap acceleration holds the operation "
                f"`{operation_name(node.op())}`, which formulas do not name."
            )
        return operation(*(convert(node.dep(k)) for k in range(node.n_dep())))

    return convert(expression)


def acceleration_formula(problem: Problem) -> Any:
    r"""Return :math:`\ddot h` at the Zeno equilibria as a formula in named states and parameters.

    If the gap is one of the coordinates, both the gap and the gap rate are set to zero. Otherwise
    the formula is valid on the whole stop (theory (2.1)).
    """
    symbols = problem.symbols()
    system = problem.model(symbols)
    stops = len(system.graph.stops)
    if stops == 0:
        raise InputError(
            f"Argument `problem`: `{problem.name}` lacks a stop, so no Zeno point exists. Declare "
            "a stop with `gap` or `stops`."
        )
    if stops > 1:
        raise InputError(
            f"Argument `problem`: `{problem.name}` has {stops} stops, and the Zeno condition is "
            "computed for one. Run `simulate` with `--events` to see the Zeno points of each stop."
        )
    at_rest = _resting(system)
    states = dict(
        zip((s.name() for s in ca.symvar(system.state)), problem.state_names, strict=True)
    )
    return _whole(sympy.simplify(to_sympy(at_rest, states)))


def with_numbers(formula: Any, values: ParameterValues) -> Any:
    """Return a formula with values in place of its symbols, expanded.

    Args:
        formula: Formula in SymPy, with named symbols.
        values: Values of gains and parameters. Other symbols remain.
    """
    entries = values.numbers
    numbers = {s: entries[s.name] for s in formula.free_symbols if s.name in entries}
    expanded = sympy.expand(sympy.expand_trig(formula.subs(numbers)))
    return sympy.collect(expanded, list(expanded.atoms(sympy.sin, sympy.cos)))


def six_digits(formula: Any) -> str:
    """Return a formula as text, with its coefficients to six digits."""
    return str(sympy.N(formula, 6))


def _whole(formula: Any) -> Any:
    """Return a formula whose whole floating-point numbers are integers."""
    return formula.xreplace(
        {
            number: sympy.Integer(int(number))
            for number in formula.atoms(sympy.Float)
            if float(number).is_integer()
        }
    )


def _resting(system: CompletedSystem) -> ca.SX:
    q = system.state[: system.n_q]
    v = system.state[system.n_q : 2 * system.n_q]
    for k in range(system.n_q):
        if ca.is_equal(ca.simplify(system.gap - q[k]), ca.SX(0), 1):
            pair, zeros = ca.vertcat(q[k], v[k]), ca.SX.zeros(2)
            return ca.substitute(system.gap_acceleration, pair, zeros)
    return system.gap_acceleration
