r"""Kinks of formulas as switches: ``fmin``, ``fmax``, ``fabs``, ``sign``, ``if_else``.

Each of these operations has a condition :math:`c`, a formula whose sign selects the branch. On one
side of :math:`c = 0` the formula is smooth. Its zero is an event without a reset.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca

_DEPTH = 32
"""Depth to which two conditions are compared."""

_REFUSED = {
    ca.OP_FLOOR: "floor",
    ca.OP_CEIL: "ceil",
    ca.OP_FMOD: "fmod",
    ca.OP_COPYSIGN: "copysign",
    ca.OP_EQ: "==",
    ca.OP_NE: "!=",
}
"""Operations that jump without a condition that could be an event."""

_COMPARISONS = (ca.OP_LT, ca.OP_LE)
_CHOICES = (ca.OP_FABS, ca.OP_SIGN, ca.OP_FMIN, ca.OP_FMAX)


@dataclass(slots=True)
class _Walk:
    """A walk through the operations of formulas, in two versions: as written and on a branch.

    Attributes:
        states: The states. Conditions of parameters alone are left in the formulas.
        sides: The side of every condition, True where it is positive. Further conditions take True.
        conditions: Conditions so far, as written.
        smooth: The same conditions on the branch.
    """

    states: ca.SX
    sides: Sequence[bool]
    conditions: list[ca.SX] = field(default_factory=list[ca.SX])
    smooth: list[ca.SX] = field(default_factory=list[ca.SX])

    def side(self, written: ca.SX, smooth: ca.SX) -> bool:
        """Return the side of a condition, and append a new condition."""
        for k, known in enumerate(self.conditions):
            if ca.is_equal(known, written, _DEPTH):
                return self._side_of(k)
            if ca.is_equal(known, -written, _DEPTH):
                return not self._side_of(k)
        self.conditions.append(written)
        self.smooth.append(smooth)
        return self._side_of(len(self.conditions) - 1)

    def _side_of(self, k: int) -> bool:
        return self.sides[k] if k < len(self.sides) else True

    def on_branch(self, operation: int, written: Sequence[ca.SX], smooth: Sequence[ca.SX]) -> ca.SX:
        """Return the result of an operation on the branch.

        Raises:
            ValueError: If the operation jumps without a condition.
        """
        if operation in _REFUSED and self._varies(*written):
            raise ValueError(
                f"Argument `switches`: a formula holds `{_REFUSED[operation]}` of the states, "
                "which jumps without a guard: declare a switch instead."
            )
        if operation in (*_COMPARISONS, *_CHOICES) and self._varies(*written):
            return self._chosen(operation, written, smooth)
        return _result(operation, smooth)

    def _chosen(self, operation: int, written: Sequence[ca.SX], smooth: Sequence[ca.SX]) -> ca.SX:
        first, last = smooth[0], smooth[-1]
        if operation in (ca.OP_FABS, ca.OP_SIGN):
            side = self.side(written[0], first)
            if operation == ca.OP_SIGN:
                return ca.SX(1.0 if side else -1.0)
            return first if side else -first
        difference = (written[0] - written[1], first - last)
        if operation in _COMPARISONS:
            return ca.SX(0.0 if self.side(*difference) else 1.0)
        is_larger = self.side(*difference)
        return first if is_larger == (operation == ca.OP_FMAX) else last

    def _varies(self, *formulas: ca.SX) -> bool:
        return any(ca.depends_on(formula, self.states) for formula in formulas)


def _result(operation: int, inputs: Sequence[ca.SX]) -> ca.SX:
    """Return the result of an operation, without a condition that is decided."""
    if operation == ca.OP_IF_ELSE_ZERO and inputs[0].is_constant():
        return inputs[1] if float(inputs[0]) != 0.0 else ca.SX(0.0)
    if operation in (ca.OP_NOT, ca.OP_AND, ca.OP_OR) and all(one.is_constant() for one in inputs):
        truths = [float(one) != 0.0 for one in inputs]
        combined: dict[int, Callable[[], bool]] = {
            ca.OP_NOT: lambda: not truths[0],
            ca.OP_AND: lambda: all(truths),
            ca.OP_OR: lambda: any(truths),
        }
        return ca.SX(float(combined[operation]()))
    return ca.SX.unary(operation, *inputs) if len(inputs) == 1 else ca.SX.binary(operation, *inputs)


@dataclass(frozen=True, slots=True, kw_only=True)
class Branched:
    """Formulas on one branch of all their kinks.

    Attributes:
        formulas: The formulas, smooth, in the shapes of the given formulas.
        conditions: The condition of every kink as written.
        smooth: The same conditions on the branch.
    """

    formulas: tuple[ca.SX, ...]
    conditions: tuple[ca.SX, ...]
    smooth: tuple[ca.SX, ...]


def branched(formulas: Sequence[ca.SX], states: ca.SX, sides: Sequence[bool] = ()) -> Branched:
    """Return formulas on a branch of their kinks.

    Args:
        formulas: The formulas.
        states: The states, ``(n_x,)``. A condition without states is not a kink.
        sides: For each condition, in the order of the operations, whether it is positive. Further
            conditions are taken as positive.

    Raises:
        ValueError: If a formula jumps without a condition.
    """
    flat: Any = ca.veccat(*(ca.densify(one) for one in formulas))
    symbols = _symbols_in(flat)
    walk = _Walk(states=states, sides=sides)
    function = ca.Function("formulas", symbols, [flat], {"cse": True})
    written: dict[int, ca.SX] = {}
    smooth: dict[int, ca.SX] = {}
    result = ca.SX.zeros(flat.numel())
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        places, outputs = function.instruction_input(k), function.instruction_output(k)
        if operation == ca.OP_OUTPUT:
            result[outputs[1]] = smooth[places[0]]
        elif operation == ca.OP_INPUT:
            written[outputs[0]] = smooth[outputs[0]] = symbols[places[0]]
        elif operation == ca.OP_CONST:
            number = ca.SX(function.instruction_constant(k))
            written[outputs[0]] = smooth[outputs[0]] = number
        else:
            before = [written[place] for place in places]
            after = [smooth[place] for place in places]
            smooth[outputs[0]] = walk.on_branch(operation, before, after)
            written[outputs[0]] = _result(operation, before)
    found: list[ca.SX] = []
    first = 0
    for one in formulas:
        entries = result[first : first + one.numel()]
        found.append(ca.sparsify(ca.reshape(entries, *one.shape)) if one.numel() else one)
        first += one.numel()
    return Branched(
        formulas=tuple(found), conditions=tuple(walk.conditions), smooth=tuple(walk.smooth)
    )


def _symbols_in(formula: ca.SX) -> list[ca.SX]:
    return ca.symvar(formula)
