"""Identities of formulas, decided by their values at random points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector

_POINTS, _MANY = 4, 64
"""Numbers of points for formulas that are flat nowhere, and for others."""
_TOLD = frozenset(
    {
        *(ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV, ca.OP_NEG, ca.OP_INV, ca.OP_SQ, ca.OP_TWICE),
        *(ca.OP_CONSTPOW, ca.OP_SQRT, ca.OP_SIN, ca.OP_COS, ca.OP_TAN),
    }
)
_HIGHEST = 8
"""Operations, and the highest power, of formulas that are flat nowhere."""


def at_random_points(formulas: Sequence[ca.SX], lowest: float = 0.5) -> Vector:
    """Return the values of scalar formulas at random points, the same in every run, ``(n, m)``.

    Args:
        formulas: The formulas, ``(m,)``.
        lowest: Least value of a symbol. The largest one is 2.
    """
    every = ca.vertcat(*formulas)
    symbols = ca.symvar(every)
    values: Any = ca.Function("values", symbols, [ca.densify(every)])
    points = np.random.default_rng(0).uniform(lowest, 2.0, (_POINTS, len(symbols)))
    return np.array([np.ravel(values.call(point)[0].full()) for point in points.tolist()])


def values_near_one(formula: ca.SX, symbols: Sequence[ca.SX] = ()) -> Vector:
    """Return the values of a formula at random points, the same in every run, ``(n, m)``.

    Points at which it is not finite are left out. What vanishes at the points vanishes everywhere
    if `is_told_by_points`. Other formulas are evaluated at more points, of both signs: they may be
    flat at all of them.

    Args:
        formula: The formula, ``(m,)``.
        symbols: Symbols that take both signs in turn, by default none.

    Raises:
        ValueError: If the formula is finite at no point.
    """
    every = ca.vec(ca.densify(formula))
    turned = ca.vertcat(ca.SX(0, 1), *symbols)
    others = ca.veccat(*(one for one in ca.symvar(every) if not ca.depends_on(turned, one)))
    values: Any = ca.Function("values", [turned, others], [every])
    random = np.random.default_rng(0)
    n, rows = turned.numel(), list[Vector]()
    is_told = is_told_by_points(*ca.vertsplit(every))
    for k in range(_POINTS if is_told else _MANY):
        lowest = 0.5 if k < _POINTS else -1.5
        first = random.uniform(0.5, 1.5, n) * (1.0 if k % 2 else -1.0)
        found: Any = values(first, random.uniform(lowest, 1.5, others.numel()))
        rows.append(np.array(found.full()).ravel())
    finite = np.array([row for row in rows if np.all(np.isfinite(row))])
    if not len(finite):
        raise ValueError(
            f"Argument `model`: a formula is finite at none of {len(rows)} states with values of "
            "about 1, so it cannot be checked: write it so that it is finite there."
        )
    return finite


def is_told_by_points(*formulas: Any) -> bool:
    """Return True if what vanishes of formulas at random points vanishes everywhere.

    Other operations, such as ``exp(-u**2)``, may be flat in all digits except in a narrow range.

    Args:
        formulas: The formulas.
    """
    seen: set[int] = set()
    waiting = [*formulas]
    while waiting:
        node = waiting.pop()
        if node.is_leaf() or node.is_constant() or node.element_hash() in seen:
            continue
        seen.add(node.element_hash())
        power = node.dep(1) if node.op() == ca.OP_CONSTPOW else None
        if node.op() not in _TOLD or (power is not None and abs(float(power)) > _HIGHEST):
            return False
        waiting += [node.dep(k) for k in range(node.n_dep())]
    return True
