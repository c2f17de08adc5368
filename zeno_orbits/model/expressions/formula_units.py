"""Unit of a formula, by the units of its symbols.

A literal number has any unit in a sum and none in a product. If the terms of a sum differ, the
first term decides: in ``x + 0.1 * x**2`` the model writes a coefficient as a number. The radian of
an angle disappears in any product with another unit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction

import casadi as ca

from zeno_orbits.model.expressions.units import powers_of, text_of

_Powers = Mapping[str, Fraction]

_NONE: _Powers = {}
_ANGLES = frozenset({ca.OP_ASIN, ca.OP_ACOS, ca.OP_ATAN, ca.OP_ATAN2})
_KEPT = frozenset({ca.OP_ASSIGN, ca.OP_NEG, ca.OP_FABS, ca.OP_FLOOR, ca.OP_CEIL, ca.OP_TWICE})
_SUMS = frozenset(
    {ca.OP_ADD, ca.OP_SUB, ca.OP_FMIN, ca.OP_FMAX, ca.OP_FMOD, ca.OP_REMAINDER, ca.OP_HYPOT}
)
_FIRST = frozenset({ca.OP_COPYSIGN})
_EXPONENTS = {ca.OP_SQ: Fraction(2), ca.OP_SQRT: Fraction(1, 2), ca.OP_INV: Fraction(-1)}
_POWERS = frozenset({ca.OP_POW, ca.OP_CONSTPOW})


def unit_of(formula: ca.SX, units: Sequence[tuple[ca.SX, str]]) -> str:
    """Return the unit of a scalar formula.

    Args:
        formula: The formula.
        units: Symbols and their units. Other symbols are without a unit.
    """
    symbols = ca.symvar(formula)
    known = {symbol.element_hash(): unit for symbol, unit in units}
    function = ca.Function("formula", symbols, [ca.densify(formula)])
    found: dict[int, _Powers | None] = {}
    numbers: dict[int, float] = {}
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        places, outputs = function.instruction_input(k), function.instruction_output(k)
        if operation == ca.OP_OUTPUT:
            powers = _without_spare_radians(found[places[0]] or _NONE)
            return text_of({base: int(n) for base, n in powers.items() if n.denominator == 1})
        if operation == ca.OP_INPUT:
            unit = known.get(symbols[places[0]].element_hash(), "1")
            found[outputs[0]] = {base: Fraction(n) for base, n in powers_of(unit).items()}
        elif operation == ca.OP_CONST:
            found[outputs[0]] = None
            numbers[outputs[0]] = function.instruction_constant(k)
        else:
            exponent = numbers.get(places[-1]) if operation in _POWERS else None
            found[outputs[0]] = _result(operation, [found[place] for place in places], exponent)
            numbers.pop(outputs[0], None)
    return "1"


def _result(
    operation: int, inputs: Sequence[_Powers | None], exponent: float | None
) -> _Powers | None:
    """Return the powers of a result, or ``None`` for a number, which has any unit."""
    first = inputs[0]
    if operation in _ANGLES:
        return {"rad": Fraction(1)}
    if operation in _KEPT or operation in _FIRST:
        return first
    if operation in _SUMS:
        return next((one for one in inputs if one is not None), None)
    if operation == ca.OP_IF_ELSE_ZERO:
        return inputs[1]
    if operation in (ca.OP_MUL, ca.OP_DIV):
        if inputs == [None, None]:
            return None
        sign = Fraction(1 if operation == ca.OP_MUL else -1)
        return _product(first or _NONE, inputs[1] or _NONE, sign)
    if operation in _EXPONENTS:
        return None if first is None else _product(_NONE, first, _EXPONENTS[operation])
    if operation in _POWERS and exponent is not None and first is not None:
        return _product(_NONE, first, Fraction(exponent).limit_denominator(12))
    return _NONE


def _product(first: _Powers, second: _Powers, exponent: Fraction) -> _Powers:
    bases = (*first, *(base for base in second if base not in first))
    zero = Fraction(0)
    return {base: first.get(base, zero) + exponent * second.get(base, zero) for base in bases}


def _without_spare_radians(powers: _Powers) -> _Powers:
    """Drop the radian beside other units: an arc ``r theta`` is a length."""
    left = {base: n for base, n in powers.items() if n}
    return left if set(left) == {"rad"} else {b: n for b, n in left.items() if b != "rad"}
