"""Random formulas of every operation of CasADi: nested, with kinks, tables and function calls."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi
import numpy as np

ca: Any = casadi

UNARY: dict[str, Callable[[Any], Any]] = {
    "neg": lambda a: -a,
    "sq": lambda a: a**2,
    "twice": lambda a: 2 * a,
    "inv": lambda a: 1 / a,
    "sqrt": ca.sqrt,
    "exp": ca.exp,
    "expm1": ca.expm1,
    "log": ca.log,
    "log1p": ca.log1p,
    "sin": ca.sin,
    "cos": ca.cos,
    "tan": ca.tan,
    "asin": ca.asin,
    "acos": ca.acos,
    "atan": ca.atan,
    "sinh": ca.sinh,
    "cosh": ca.cosh,
    "tanh": ca.tanh,
    "asinh": ca.asinh,
    "acosh": ca.acosh,
    "atanh": ca.atanh,
    "erf": ca.erf,
    "erfinv": ca.erfinv,
    "fabs": ca.fabs,
    "sign": ca.sign,
    "floor": ca.floor,
    "ceil": ca.ceil,
    "not": ca.logic_not,
}
BINARY: dict[str, Callable[[Any, Any], Any]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "pow": lambda a, b: a**b,
    "constpow": lambda a, _: a**3,
    "hypot": ca.hypot,
    "atan2": ca.atan2,
    "fmin": ca.fmin,
    "fmax": ca.fmax,
    "copysign": ca.copysign,
    "fmod": ca.fmod,
    "remainder": ca.remainder,
    "lt": lambda a, b: a < b,
    "le": lambda a, b: a <= b,
    "eq": lambda a, b: a == b,
    "ne": lambda a, b: a != b,
    "and": ca.logic_and,
    "or": ca.logic_or,
}
JUMPS = {"floor", "ceil", "fmod", "remainder", "eq", "ne"}
"""Operations that jump without a condition."""


def choice(a: Any, b: Any, c: Any, d: Any) -> Any:
    """Return one of two values by a comparison."""
    return ca.if_else(a < b, c, d)


def compound(a: Any, b: Any, c: Any, d: Any) -> Any:
    """Return one of two values by several comparisons."""
    holds = ca.logic_or(ca.logic_and(a < b, c > -1), ca.logic_not(d < a))
    return ca.if_else(holds, b * c, d)


CHOICES: dict[str, Callable[[Any, Any, Any, Any], Any]] = {"choice": choice, "compound": compound}


def table(random: np.random.Generator) -> Any:
    """Return a linear table of random knots."""
    knots = np.cumsum(random.uniform(0.2, 1.0, 4)) - 1.2
    return ca.interpolant("table", "linear", [knots.tolist()], random.normal(size=4).tolist())


def nested_function(random: np.random.Generator) -> Any:
    """Return a function of scalar operations that is called, not inlined, and calls a table."""
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    inner = ca.Function("inner", [a], [ca.fabs(a) + table(random)(a)], {"never_inline": True})
    outputs = [ca.fmin(a, inner(b)), ca.sin(b) * a]
    return ca.Function("outer", [a, b], outputs, {"never_inline": True})


def random_formula(
    random: np.random.Generator, leaves: Sequence[Any], size: int, *, without: set[str]
) -> tuple[Any, set[str]]:
    """Return a random formula, and the names of its operations.

    Args:
        random: Random numbers.
        leaves: States and parameters.
        size: Number of operations.
        without: Names of operations to leave out.
    """
    nodes: list[Any] = [*leaves, ca.SX(float(random.normal())), ca.SX(1.0)]
    call = nested_function(random)

    def called(a: Any, b: Any) -> Any:
        first, second = call(a, b)
        return first + second

    every: list[tuple[str, Any, int]] = [
        *((name, one, 1) for name, one in UNARY.items()),
        *((name, one, 2) for name, one in BINARY.items()),
        *((name, one, 4) for name, one in CHOICES.items()),
        ("table", table(random), 1),
        ("function", called, 2),
    ]
    chosen = [one for one in every if one[0] not in without]
    used: set[str] = set()
    for _ in range(size):
        name, operation, n = chosen[int(random.integers(len(chosen)))]
        # Later nodes are preferred: formulas become deep.
        weights = np.arange(1.0, len(nodes) + 1.0)
        places = random.choice(len(nodes), n, p=weights / weights.sum())
        nodes.append(operation(*(nodes[k] for k in places)))
        used.add(name)
    return nodes[-1] + nodes[-2], used
