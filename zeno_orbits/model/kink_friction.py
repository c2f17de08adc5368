r"""Dry friction that a user wrote as a kink, and the part that says the same.

A kink with the condition :math:`r` is dry friction if `r` is affine in the velocities and the force
alone jumps with it, along :math:`\partial r / \partial v` and against the rate:

.. math:: F(r > 0) - F(r < 0) = -2\,T\,(\partial r / \partial v)^\top
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from zeno_orbits.model.expressions.identities import at_random_points
from zeno_orbits.model.expressions.kinks import without_numbers
from zeno_orbits.model.expressions.operations import operation_name
from zeno_orbits.model.modes import ModeGraph

_LONGEST = 60
"""Length of a formula that a message quotes."""
_DEPTH = 32
"""Depth to which two terms are compared."""
_ROUNDING = 1e-12
"""Relative rounding of forces at random points."""
_FORMS = {
    ca.OP_ADD: ("{} + {}", 1, (1, 1)),
    ca.OP_SUB: ("{} - {}", 1, (1, 2)),
    ca.OP_NEG: ("-{}", 2, (3,)),
    ca.OP_MUL: ("{} * {}", 3, (3, 3)),
    ca.OP_DIV: ("{} / {}", 3, (3, 4)),
    ca.OP_TWICE: ("2 * {}", 3, (3,)),
    ca.OP_INV: ("1 / {}", 3, (4,)),
    ca.OP_SQ: ("{}**2", 4, (5,)),
    ca.OP_POW: ("{}**{}", 4, (5, 5)),
    ca.OP_CONSTPOW: ("{}**{}", 4, (5, 5)),
}
"""Operations as Python writes them, how much they bind, and how much their parts must bind."""
_NO_FRICTION = (
    "This is no dry friction along a rate: replace the jump by a steep smooth formula, as "
    "`ca.tanh(c / width)` is for `ca.sign(c)`."
)


def instead_of_kink(graph: ModeGraph, kink: int) -> str:
    """Return how a motion may go on along a kink: the part with dry friction, or another formula.

    Args:
        graph: The modes of a machine.
        kink: Index of the kink.
    """
    found = friction_of_kink(graph, kink)
    if found is None:
        return _NO_FRICTION
    rate, torque = _quoted(found[0], "rate"), _quoted(found[1], "T")
    size = torque if torque.replace(".", "").isalnum() else f"({torque})"
    return (
        f'For dry friction, declare the part `zo.DryFriction("NAME", rate={rate}, torque={torque})`'
        f" in place of the force `-{size} * ca.sign({rate})`."
    )


def friction_of_kink(graph: ModeGraph, kink: int) -> tuple[ca.SX, ca.SX] | None:
    """Return rate and torque of a kink that is dry friction, or ``None`` for another kink.

    Args:
        graph: The modes of a machine.
        kink: Index of the kink.
    """
    rate, factor = without_numbers(graph.conditions[kink])
    v = graph.mechanism.v
    row = ca.jacobian(rate, v)
    if not row.nnz() or ca.depends_on(row, v):
        return None
    (forward, others), (back, others_back) = (
        _effects(graph, kink, side) for side in (factor > 0.0, factor < 0.0)
    )
    place = next(k for k in range(row.numel()) if not row[k].is_zero())
    torque = _difference(back[place], forward[place], 2.0 * row[place])
    if torque.is_zero():
        return None
    left = ca.vertcat(back - forward - 2 * torque * row.T, others - others_back)
    size = ca.vertcat(torque, back, forward, others)
    values = at_random_points((ca.norm_1(left), ca.norm_1(size)))
    off, sizes = values[:, 0], values[:, 1]
    is_same = np.all(np.isfinite(values)) and np.all(off <= _ROUNDING * (1.0 + sizes))
    return (rate, torque) if is_same else None


def _effects(graph: ModeGraph, kink: int, side: bool) -> tuple[ca.SX, ca.SX]:
    """Return the forces on a side of a kink, and all else that may jump there."""
    sides = tuple(side or k != kink for k in range(len(graph.conditions)))
    mechanism, drive, _ = graph.on_branch(sides)
    return drive.force - mechanism.bias, ca.vertcat(ca.vec(mechanism.mass_matrix), drive.rates)


def _difference(one: ca.SX, other: ca.SX, divisor: ca.SX) -> ca.SX:
    """Return a quotient of a difference whose equal terms cancel, in as few terms as it has."""
    terms = list[tuple[float, ca.SX]]()
    for size, part in [*_terms(one, 1.0), *_terms(other, -1.0)]:
        at = next((k for k, (_, own) in enumerate(terms) if ca.is_equal(own, part, _DEPTH)), None)
        if at is None:
            terms.append((size, part))
        else:
            terms[at] = terms[at][0] + size, part
    left = [(size, part) for size, part in terms if size]
    largest = max((abs(size) for size, _ in left), default=0.0)
    total = ca.SX(0)
    for size, part in left:
        total = total + size / largest * part
    return (
        total * (largest / float(divisor)) if divisor.is_constant() else largest * total / divisor
    )


def _terms(formula: ca.SX, factor: float) -> list[tuple[float, ca.SX]]:
    """Return the terms of a sum with the numbers that multiply them."""
    part, size = without_numbers(formula)
    size *= factor
    if part.is_constant():
        return [(size * float(part), ca.SX(1))]
    if part.op() not in (ca.OP_ADD, ca.OP_SUB):
        return [(size, part)]
    sign = -1.0 if part.op() == ca.OP_SUB else 1.0
    return [*_terms(part.dep(0), size), *_terms(part.dep(1), sign * size)]


def _quoted(formula: ca.SX, name: str) -> str:
    """Return a formula as a user writes it, or a name for a long one."""
    text = _written(formula, 0)
    return text if len(text) <= _LONGEST else name


def _written(formula: Any, above: int) -> str:
    """Return a formula in Python, in brackets if it binds less than the operation above it."""
    operation = formula.op()
    if formula.is_constant():
        text = f"{float(formula):.12g}"
        return f"({text})" if text.startswith("-") and above else text
    if formula.is_leaf():
        return str(formula)
    parts = [formula.dep(k) for k in range(formula.n_dep())]
    if operation not in _FORMS:
        inside = ", ".join(_written(part, 0) for part in parts)
        return f"ca.{operation_name(operation)}({inside})"
    form, own, least = _FORMS[operation]
    texts = [_written(part, bound) for part, bound in zip(parts, least, strict=True)]
    text = form.format(*texts)
    return f"({text})" if own < above else text
