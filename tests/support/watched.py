"""Formulas of guards that vary otherwise than the state: every operation that has bounds."""

from __future__ import annotations

import math
from collections.abc import Callable

import casadi as ca
import numpy as np

import zeno_orbits as zo

KNOTS = np.array([-5.0, -3.0, -2.5, -1.0, 0.0, 0.2, 1.0, 2.0, 4.0, 5.5])
VALUES = np.array([1.0, -2.0, 0.5, 3.0, 2.0, -1.0, 0.0, 4.0, -3.0, 1.0])
Formula = Callable[[ca.SX, ca.SX, ca.SX], ca.SX]

FORMULAS: dict[str, Formula] = {
    "sum and product": lambda x, y, p: p * x * y - 3 * x + y - 2,
    "quotient": lambda x, y, p: (x - p) / (4 + y),
    "inverse": lambda x, y, p: 1 / (5 + x * y / 4) - p,
    "square": lambda x, y, p: (x + p) ** 2 - y**4,
    "odd power": lambda x, y, p: (x - y) ** 3 + p,
    "negative power": lambda x, y, p: (4 + x) ** -3 * y * p,
    "broken power": lambda x, y, p: (4 + x) ** 1.5 * y + p,
    "power with a parameter": lambda x, y, p: (4 + x) ** p * y,
    "power with a state": lambda x, y, p: (4 + x) ** (y - p),
    "sine and cosine": lambda x, y, p: ca.sin(9 * x) * ca.cos(7 * y + p),
    "tangent": lambda x, y, p: ca.tan(x / 2) + p * y,
    "exponential": lambda x, y, p: ca.exp(-(((x - p) / 0.3) ** 2)) + ca.expm1(y),
    "logarithm": lambda x, y, p: ca.log(4 + x) * y + p,
    "root": lambda x, y, p: ca.sqrt(x**2 + y**2 + 0.1) - p,
    "length": lambda x, y, p: ca.hypot(x - p, y),
    "angle": lambda x, y, p: ca.atan2(y, 4 + x) + p,
    "arcs": lambda x, y, p: ca.asin(x / 4) + ca.acos(y / 4) + ca.atan(p * x),
    "hyperbolic": lambda x, y, p: ca.sinh(x) - ca.cosh(y) + ca.tanh(p * x) + ca.asinh(y),
    "size and sign": lambda x, y, p: ca.fabs(x) - p * ca.sign(y),
    "steps": lambda x, y, p: ca.floor(3 * x) + ca.ceil(y * p),
    "smaller and larger": lambda x, y, p: ca.fmin(x, p) * ca.fmax(y, x),
    "choice": lambda x, y, p: ca.if_else(x < p, y, 2 - x * y),
    "nested choice": lambda x, y, p: ca.if_else(
        ca.logic_and(x >= p, ca.logic_not(y > 0)), x - y, ca.erf(x)
    ),
    "inverse hyperbolic": lambda x, y, p: ca.atanh(x / 4) - ca.acosh(2 + y * x / 4) * p,
    "logarithm of more": lambda x, y, p: ca.log1p(x / 4) * y - p,
    "power of a number": lambda x, y, p: 2**x - y * p,
    "joined choice": lambda x, y, p: ca.if_else(ca.logic_or(x <= p, y != x), x, y * p),
    "equal": lambda x, y, p: ca.if_else(ca.floor(x) == ca.ceil(y), x * p, y),
    "table": lambda x, y, p: zo.table(x + p, KNOTS, VALUES, outside="extend") * y,
    "smooth table": lambda x, y, p: zo.table(x * p, KNOTS, VALUES, "cubic", outside="extend") + y,
    "table of two": lambda x, y, p: zo.table(
        (x, p * y), (KNOTS, KNOTS), np.outer(VALUES, VALUES), outside="hold"
    ),
    "record": lambda x, y, p: (
        p
        * zo.record(KNOTS, VALUES, period=12.0).at(
            zo.Clock(cosine=x, sine=y, frequency=ca.SX(2 * math.pi / 12.0))
        )
    ),
}


def watched(name: str) -> ca.Function:
    """Return ``(y, p) -> (a formula, its derivative along (1, 2))``."""
    y, p = ca.SX.sym("y", 2), ca.SX.sym("p")
    value = FORMULAS[name](y[0], y[1], p)
    outputs = ca.vertcat(value, ca.jtimes(value, y, ca.SX([1, 2])))
    return ca.Function("watched", [y, p], [outputs])
