"""A CasADi expression as a formula that a person can read, through SymPy."""

from __future__ import annotations

import importlib
import operator
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import casadi as ca

from zeno_orbits.model.hybrid import CompletedSystem
from zeno_orbits.model.problem import ParameterValues, Problem

sympy: Any = importlib.import_module("sympy")
"""SymPy has no types; it is imported as a value that has none."""


def _divide(a: Any, b: Any) -> Any:
    return a / b


def _power(a: Any, b: Any) -> Any:
    return a**b


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
}


def to_sympy(expression: ca.SX, names: Mapping[str, str]) -> Any:
    """Return a scalar expression as a SymPy one.

    Args:
        expression: A scalar.
        names: CasADi symbol name to the name wanted; a name that is missing stays.

    Raises:
        ValueError: If the expression holds an operation that has no counterpart here.
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
        operation = _OPERATIONS.get(node.op())
        if operation is None:
            message = f"Argument `expression` must use known operations, but it holds {node}."
            raise ValueError(message)
        return operation(*(convert(node.dep(k)) for k in range(node.n_dep())))

    return convert(expression)


def acceleration_formula(problem: Problem) -> Any:
    r"""Return :math:`\ddot h` at the Zeno equilibria as a formula in named states and parameters.

    Where the gap is one of the coordinates, it and its rate are set to zero; else the formula is
    that of the whole stop (theory (9)).
    """
    symbols = problem.symbols()
    system = problem.model(symbols)
    at_rest = _resting(system)
    states = dict(
        zip((s.name() for s in ca.symvar(system.state)), problem.state_names, strict=True)
    )
    return _whole(sympy.simplify(to_sympy(at_rest, states)))


def with_numbers(formula: Any, values: ParameterValues) -> Any:
    """Return a formula with numbers for its symbols, expanded.

    Args:
        formula: In SymPy, of named symbols.
        values: Numbers for gains and parameters; what it does not name stays a symbol.
    """
    entries = values.numbers
    numbers = {s: entries[s.name] for s in formula.free_symbols if s.name in entries}
    expanded = sympy.expand(sympy.expand_trig(formula.subs(numbers)))
    return sympy.collect(expanded, list(expanded.atoms(sympy.sin, sympy.cos)))


def six_digits(formula: Any) -> str:
    """Return a formula as text, its numbers to six digits."""
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
