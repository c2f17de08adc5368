"""Identities of formulas, decided by their values at random points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector

_POINTS = 4
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
