r"""Bounds of a guard over a box of states: its formula in interval arithmetic.

The result is a formula in the lower and upper ends of the box. The result for a box :math:`[a, b]`
contains every value that the formula takes in the box. Rounding errors, of relative size 1e-16, are
neglected. The compiled loop performs the same operations on floating-point values
(`loop/intervals.c`). Source: [Moore1966]_.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, cast

import casadi as ca
import numpy as np

from zeno_orbits.integrators.lookups import CellTable, Lookup, called, may_be_merged

_ca: Any = ca
"""CasADi, whose stubs do not know the types of some functions."""
WIDE = 1e300
"""Stands for a bound where none is known, as of a quotient by an interval around zero."""


class Interval(NamedTuple):
    """All values between two expressions, or one expression that is independent of the box."""

    low: ca.SX
    high: ca.SX

    @property
    def is_point(self) -> bool:
        """True if both ends are one expression."""
        return self.low is self.high


Unary = Callable[[Interval, "_Doubt"], Interval]


@dataclass(slots=True)
class _Doubt:
    """Additions to bounds: zero, or `WIDE` if an operation in them is not bounded.

    Attributes:
        total: Addition to the bounds of the guard and of its derivatives.
        jumps: Addition to the bounds of the derivatives alone, which do not exist for a guard with
            a jump in the box.
    """

    total: ca.SX = field(default_factory=lambda: ca.SX(0.0))
    jumps: ca.SX = field(default_factory=lambda: ca.SX(0.0))

    def where(self, condition: ca.SX) -> None:
        """Leave everything unbounded where a condition holds."""
        self.total = self.total + ca.if_else(condition, WIDE, 0.0)

    def unless_constant(self, result: Interval) -> None:
        """Leave derivatives unbounded if a result that moves in jumps is not one value."""
        if not result.is_point:
            jumps: ca.SX = ca.if_else(result.low != result.high, WIDE, 0.0)
            self.jumps = ca.fmax(self.jumps, jumps)


def has_bounds(formula: ca.Function) -> bool:
    """Return True if each operation of a formula has bounds here."""
    codes = {formula.instruction_id(k) for k in range(formula.n_instructions())}
    return codes - {ca.OP_CALL} <= _KNOWN


def guard_bounds(watched: ca.Function) -> ca.Function:
    """Return bounds of a guard and of its derivatives along a flow over a box of states.

    Args:
        watched: ``(y, p) -> (guard, its time derivative)``, and the second derivative, if it is
            cheap. With the second derivative fewer pieces of a step are needed. Its operations are
            limited to the operations of `has_bounds`.

    Returns:
        ``((lower ends, upper ends), p) -> (least and largest guard, rate and second derivative)``.
    """
    n_y, n_p = watched.size1_in(0), watched.size1_in(1)
    box, p = ca.SX.sym("box", 2 * n_y), ca.SX.sym("p", n_p)
    states = [Interval(box[k], box[n_y + k]) for k in range(n_y)]
    found = _enclosed(watched, states, ca.vertsplit(p) if n_p else [])
    ends = [end for interval in found for end in interval]
    if len(found) == _WITHOUT_BEND:
        ends += [ca.SX(-WIDE), ca.SX(WIDE)]
    return ca.Function(
        f"{watched.name()}_bounds", [box, p], [ca.vertcat(*ends)], {"cse": may_be_merged(ends)}
    )


_WITHOUT_BEND = 2


def _enclosed(formula: ca.Function, states: list[Interval], numbers: list[ca.SX]) -> list[Interval]:
    """Return the outputs of a formula in intervals."""
    work: dict[int, Interval] = {}
    constants: dict[int, float] = {}
    doubt, guard_doubt = _Doubt(), ca.SX(0.0)
    outputs = [_point(0.0)] * formula.numel_out(0)
    rows = formula.sparsity_out(0).row()
    nodes: Any = formula.instructions_sx()
    for k in range(formula.n_instructions()):
        code = formula.instruction_id(k)
        takes, gives = formula.instruction_input(k), formula.instruction_output(k)
        if code == ca.OP_INPUT:
            place = takes[1]
            work[gives[0]] = states[place] if takes[0] == 0 else _point(numbers[place])
        elif code == ca.OP_OUTPUT:
            outputs[rows[gives[1]]] = work[takes[0]]
            if rows[gives[1]] == 0:
                guard_doubt = doubt.total
            continue
        elif code == ca.OP_CONST:
            constants[gives[0]] = formula.instruction_constant(k)
            work[gives[0]] = _point(constants[gives[0]])
            continue
        elif code == ca.OP_CALL:
            results = _looked_up(nodes[k], [work[place] for place in takes])
            for place, result in zip(gives, results, strict=True):
                doubt.unless_constant(result)
                work[place] = result
                constants.pop(place, None)
            continue
        else:
            given = [work[place] for place in takes]
            known = constants.get(takes[-1]) if code in _POWERS else None
            result = _operation(code, given, known, doubt)
            if code in JUMPS:
                doubt.unless_constant(result)
            work[gives[0]] = result
        constants.pop(gives[0], None)
    # CasADi evaluates the dependencies of the first output first, so its own additions are complete
    # there.
    doubts = [guard_doubt] + [doubt.total + doubt.jumps] * (len(outputs) - 1)
    return [
        Interval(one.low - more, one.high + more) for one, more in zip(outputs, doubts, strict=True)
    ]


def _looked_up(node: Any, given: list[Interval]) -> list[Interval]:
    """Return the cell of a table, or the numbers of a cell."""
    function, found = called(node)
    lookup = cast("Lookup", found)
    if lookup.side is None:
        return _numbers_of_cells(function, lookup.table, given[0])
    if len(given) == 1:
        return [Interval(function(given[0].low), function(given[0].high))]
    return [_cells_of_turn(lookup.table.on_phase(lookup.side), lookup.table, *given)]


def _cells_of_turn(cell: Any, table: CellTable, c: Interval, s: Interval) -> Interval:
    """Return the cells of phases: all cells where the interval holds the end of a turn."""
    doubt, turn = _Doubt(), float(table.knots[-1])
    angle: Any = _ca.atan2(s.low + s.high, c.low + c.high)
    middle = _ca.if_else(angle < 0, angle + turn, angle)
    cosine, sine = _point(_ca.cos(angle)), _point(_ca.sin(angle))
    ahead = _sum(_product(c, cosine, doubt), _product(s, sine, doubt), doubt)
    aside = _difference(_product(s, cosine, doubt), _product(c, sine, doubt), doubt)
    low = middle + _ca.atan(aside.low / _ca.if_else(aside.low < 0, ahead.low, ahead.high))
    high = middle + _ca.atan(aside.high / _ca.if_else(aside.high > 0, ahead.low, ahead.high))
    first, last = cell(low), cell(high)
    every = _ca.logic_or(_ca.logic_not(ahead.low > 0), _ca.logic_or(low < 0, high >= turn))
    every = _ca.logic_or(every, last < first)
    return Interval(_ca.if_else(every, 0, first), _ca.if_else(every, table.n - 1, last))


def _numbers_of_cells(pick: Any, table: CellTable, cell: Interval) -> list[Interval]:
    """Return the numbers of cells: those of all where the cells are not close to each other."""
    middle = _ca.floor((cell.low + cell.high) / 2)
    found = [_ca.vertsplit(_ca.densify(pick(one))) for one in (cell.low, middle, cell.high)]
    is_near = cell.high - cell.low <= 2
    results: list[Interval] = []
    for column, near in zip(table.columns, zip(*found, strict=True), strict=True):
        hull = _hull(list(near))
        least, largest = float(np.min(column)), float(np.max(column))
        low, high = _ca.if_else(is_near, hull.low, least), _ca.if_else(is_near, hull.high, largest)
        results.append(Interval(low, high))
    return results


def _operation(code: int, given: list[Interval], exponent: float | None, doubt: _Doubt) -> Interval:
    if code in _POWERS and exponent is not None:
        return _power(given[0], exponent, doubt)
    if all(one.is_point for one in given) and code in _POINTS:
        return _point(_POINTS[code](*(one.low for one in given)))
    if code in _RISING:
        return Interval(_RISING[code](given[0].low), _RISING[code](given[0].high))
    if code in _UNARY:
        return _UNARY[code](given[0], doubt)
    return _BINARY[code](given[0], given[1], doubt)


def _point(value: ca.SX | float) -> Interval:
    entry = ca.SX(value)
    return Interval(entry, entry)


def _sum(a: Interval, b: Interval, _doubt: _Doubt) -> Interval:
    return Interval(a.low + b.low, a.high + b.high)


def _difference(a: Interval, b: Interval, _doubt: _Doubt) -> Interval:
    return Interval(a.low - b.high, a.high - b.low)


def _negative(a: Interval, _doubt: _Doubt) -> Interval:
    return Interval(-a.high, -a.low)


def _product(a: Interval, b: Interval, _doubt: _Doubt) -> Interval:
    if a.is_point:
        a, b = b, a
    if b.is_point:
        if b.low.is_constant():
            low, high = a.low * b.low, a.high * b.low
            return Interval(low, high) if float(b.low) >= 0.0 else Interval(high, low)
        return _hull([a.low * b.low, a.high * b.low])
    return _hull([a.low * b.low, a.low * b.high, a.high * b.low, a.high * b.high])


def _hull(entries: list[ca.SX]) -> Interval:
    low = high = entries[0]
    for entry in entries[1:]:
        low, high = ca.fmin(low, entry), ca.fmax(high, entry)
    return Interval(low, high)


def _inverse(a: Interval, doubt: _Doubt) -> Interval:
    if a.is_point:
        return _point(1 / a.low)
    around = a.low * a.high <= 0
    doubt.where(around)
    return Interval(ca.if_else(around, 0, 1 / a.high), ca.if_else(around, 0, 1 / a.low))


def _quotient(a: Interval, b: Interval, doubt: _Doubt) -> Interval:
    return _product(a, _inverse(b, doubt), doubt)


def _size(a: Interval, _doubt: _Doubt) -> Interval:
    return Interval(ca.fmax(ca.fmax(a.low, -a.high), 0), ca.fmax(-a.low, a.high))


def _square(a: Interval, doubt: _Doubt) -> Interval:
    size = _size(a, doubt)
    return Interval(size.low**2, size.high**2)


def _root(a: Interval, doubt: _Doubt) -> Interval:
    doubt.where(a.low < 0)
    return Interval(ca.sqrt(ca.fmax(a.low, 0)), ca.sqrt(ca.fmax(a.high, 0)))


def _logarithm_of_more(a: Interval, doubt: _Doubt) -> Interval:
    return _logarithm(Interval(a.low + 1, a.high + 1), doubt)


def _inverse_tangent(a: Interval, doubt: _Doubt) -> Interval:
    beyond = ca.logic_or(a.low <= -1, a.high >= 1)
    doubt.where(beyond)
    return Interval(*(ca.atanh(ca.if_else(beyond, 0.0, end)) for end in a))


def _inverse_cosine(a: Interval, doubt: _Doubt) -> Interval:
    doubt.where(a.low < 1)
    return Interval(*(ca.acosh(ca.fmax(end, 1.0)) for end in a))


def _logarithm(a: Interval, doubt: _Doubt) -> Interval:
    beyond = a.low <= 0
    doubt.where(beyond)
    return Interval(ca.log(ca.if_else(beyond, 1.0, a.low)), ca.log(ca.if_else(beyond, 1.0, a.high)))


def _power(a: Interval, exponent: float, doubt: _Doubt) -> Interval:
    if a.is_point:
        return _point(a.low**exponent)
    if exponent < 0.0:
        return _inverse(_power(a, -exponent, doubt), doubt)
    if exponent % 2.0 == 0.0:
        size = _size(a, doubt)
        return Interval(size.low**exponent, size.high**exponent)
    if exponent % 2.0 == 1.0:
        return Interval(a.low**exponent, a.high**exponent)
    doubt.where(a.low < 0)
    return Interval(ca.fmax(a.low, 0) ** exponent, ca.fmax(a.high, 0) ** exponent)


def _any_power(a: Interval, b: Interval, doubt: _Doubt) -> Interval:
    """Return bounds of a power of a positive base, which is monotone in base and exponent."""
    doubt.where(a.low <= 0)
    ends = [ca.if_else(a.low <= 0, 1, end) for end in a]
    return _hull([end**exponent for end in ends for exponent in b])


def _wave(function: Callable[[ca.SX], ca.SX], top: float) -> Unary:
    """Return bounds of a sine that has its maxima at `top` and every turn from there."""

    def bounds(a: Interval, _doubt: _Doubt) -> Interval:
        turn = 2 * math.pi
        # The last maximum and the last minimum that are not above the interval.
        highest = top + turn * ca.floor((a.high - top) / turn)
        lowest = top - math.pi + turn * ca.floor((a.high - top + math.pi) / turn)
        start, end = function(a.low), function(a.high)
        return Interval(
            ca.fmin(ca.fmin(start, end), 1 - 2 * (lowest >= a.low)),
            ca.fmax(ca.fmax(start, end), 2 * (highest >= a.low) - 1),
        )

    return bounds


def _tangent(a: Interval, doubt: _Doubt) -> Interval:
    turns = [ca.floor((end + math.pi / 2) / math.pi) for end in a]
    doubt.where(turns[0] != turns[1])
    return Interval(ca.tan(a.low), ca.tan(a.high))


def _arc(function: Callable[[ca.SX], ca.SX], *, falls: bool) -> Unary:
    def bounds(a: Interval, doubt: _Doubt) -> Interval:
        doubt.where(ca.logic_or(a.low < -1, a.high > 1))
        ends = [function(ca.fmin(ca.fmax(end, -1), 1)) for end in a]
        return Interval(ends[1], ends[0]) if falls else Interval(ends[0], ends[1])

    return bounds


def _catenary(a: Interval, doubt: _Doubt) -> Interval:
    size = _size(a, doubt)
    return Interval(ca.cosh(size.low), ca.cosh(size.high))


def _angle(y: Interval, x: Interval, doubt: _Doubt) -> Interval:
    doubt.where(x.low <= 0)
    slope = _quotient(y, x, doubt)
    return Interval(ca.atan(slope.low), ca.atan(slope.high))


def _length(a: Interval, b: Interval, doubt: _Doubt) -> Interval:
    total = _sum(_square(a, doubt), _square(b, doubt), doubt)
    return Interval(ca.sqrt(total.low), ca.sqrt(total.high))


def _lesser(a: Interval, b: Interval, _doubt: _Doubt) -> Interval:
    return Interval(ca.fmin(a.low, b.low), ca.fmin(a.high, b.high))


def _greater(a: Interval, b: Interval, _doubt: _Doubt) -> Interval:
    return Interval(ca.fmax(a.low, b.low), ca.fmax(a.high, b.high))


def _below(a: Interval, b: Interval, _doubt: _Doubt) -> Interval:
    return Interval(a.high < b.low, a.low < b.high)


def _not_above(a: Interval, b: Interval, _doubt: _Doubt) -> Interval:
    return Interval(a.high <= b.low, a.low <= b.high)


def _equal(a: Interval, b: Interval, _doubt: _Doubt) -> Interval:
    overlap = ca.logic_and(a.low <= b.high, b.low <= a.high)
    points = ca.logic_and(a.low == a.high, b.low == b.high)
    return Interval(ca.logic_and(overlap, points), overlap)


def _truth(a: Interval) -> Interval:
    """Return the two truth values of a nonzero test: certainly and possibly nonzero."""
    return Interval(
        ca.logic_or(a.low > 0, a.high < 0), ca.logic_not(ca.logic_and(a.low == 0, a.high == 0))
    )


def _not(a: Interval, _doubt: _Doubt) -> Interval:
    sure, possible = _truth(a)
    return Interval(1 - possible, 1 - sure)


def _both(a: Interval, b: Interval, doubt: _Doubt) -> Interval:
    return _lesser(_truth(a), _truth(b), doubt)


def _either(a: Interval, b: Interval, doubt: _Doubt) -> Interval:
    return _greater(_truth(a), _truth(b), doubt)


def _unequal(a: Interval, b: Interval, doubt: _Doubt) -> Interval:
    return _not(_equal(a, b, doubt), doubt)


def _if_true(condition: Interval, a: Interval, _doubt: _Doubt) -> Interval:
    """Return a value where a condition holds and zero elsewhere, both where it is not decided."""
    sure, possible = _truth(condition)
    low = ca.if_else(sure, a.low, ca.fmin(a.low, 0))
    high = ca.if_else(sure, a.high, ca.fmax(a.high, 0))
    return Interval(ca.if_else(possible, low, 0), ca.if_else(possible, high, 0))


def _divided(a: ca.SX, b: ca.SX) -> ca.SX:
    return a / b


def _raised(a: ca.SX, b: ca.SX) -> ca.SX:
    return a**b


def _reciprocal(a: ca.SX) -> ca.SX:
    return 1 / a


def _squared(a: ca.SX) -> ca.SX:
    return a**2


def _where_true(condition: ca.SX, a: ca.SX) -> ca.SX:
    return ca.if_else(condition, a, 0)


_POWERS = (ca.OP_POW, ca.OP_CONSTPOW)
JUMPS = (
    *(ca.OP_SIGN, ca.OP_FLOOR, ca.OP_CEIL, ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE),
    *(ca.OP_NOT, ca.OP_AND, ca.OP_OR),
)
"""Operations whose values jump, and whose derivatives are zero all the same."""
_RISING: Mapping[int, Callable[[ca.SX], ca.SX]] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_TWICE: lambda a: 2 * a,
    ca.OP_EXP: ca.exp,
    ca.OP_EXPM1: ca.expm1,
    ca.OP_ATAN: ca.atan,
    ca.OP_TANH: ca.tanh,
    ca.OP_SINH: ca.sinh,
    ca.OP_ASINH: ca.asinh,
    ca.OP_ERF: ca.erf,
    ca.OP_SIGN: ca.sign,
    ca.OP_FLOOR: ca.floor,
    ca.OP_CEIL: ca.ceil,
}
_UNARY: Mapping[int, Unary] = {
    ca.OP_NEG: _negative,
    ca.OP_INV: _inverse,
    ca.OP_SQ: _square,
    ca.OP_SQRT: _root,
    ca.OP_FABS: _size,
    ca.OP_LOG: _logarithm,
    ca.OP_LOG1P: _logarithm_of_more,
    ca.OP_ATANH: _inverse_tangent,
    ca.OP_ACOSH: _inverse_cosine,
    ca.OP_SIN: _wave(ca.sin, math.pi / 2),
    ca.OP_COS: _wave(ca.cos, 0.0),
    ca.OP_TAN: _tangent,
    ca.OP_ASIN: _arc(ca.asin, falls=False),
    ca.OP_ACOS: _arc(ca.acos, falls=True),
    ca.OP_COSH: _catenary,
    ca.OP_NOT: _not,
}
_BINARY: Mapping[int, Callable[[Interval, Interval, _Doubt], Interval]] = {
    ca.OP_ADD: _sum,
    ca.OP_SUB: _difference,
    ca.OP_MUL: _product,
    ca.OP_DIV: _quotient,
    ca.OP_POW: _any_power,
    ca.OP_ATAN2: _angle,
    ca.OP_HYPOT: _length,
    ca.OP_FMIN: _lesser,
    ca.OP_FMAX: _greater,
    ca.OP_LT: _below,
    ca.OP_LE: _not_above,
    ca.OP_EQ: _equal,
    ca.OP_NE: _unequal,
    ca.OP_AND: _both,
    ca.OP_OR: _either,
    ca.OP_IF_ELSE_ZERO: _if_true,
}
_POINTS: Mapping[int, Callable[..., Any]] = {
    **_RISING,
    ca.OP_NEG: operator.neg,
    ca.OP_INV: _reciprocal,
    ca.OP_SQ: _squared,
    ca.OP_SQRT: ca.sqrt,
    ca.OP_FABS: ca.fabs,
    ca.OP_LOG: ca.log,
    ca.OP_LOG1P: ca.log1p,
    ca.OP_ATANH: ca.atanh,
    ca.OP_ACOSH: ca.acosh,
    ca.OP_SIN: ca.sin,
    ca.OP_COS: ca.cos,
    ca.OP_TAN: ca.tan,
    ca.OP_ASIN: ca.asin,
    ca.OP_ACOS: ca.acos,
    ca.OP_COSH: ca.cosh,
    ca.OP_NOT: ca.logic_not,
    ca.OP_ADD: operator.add,
    ca.OP_SUB: operator.sub,
    ca.OP_MUL: operator.mul,
    ca.OP_DIV: _divided,
    ca.OP_POW: _raised,
    ca.OP_ATAN2: ca.atan2,
    ca.OP_HYPOT: ca.hypot,
    ca.OP_FMIN: ca.fmin,
    ca.OP_FMAX: ca.fmax,
    ca.OP_LT: operator.lt,
    ca.OP_LE: operator.le,
    ca.OP_EQ: operator.eq,
    ca.OP_NE: operator.ne,
    ca.OP_AND: ca.logic_and,
    ca.OP_OR: ca.logic_or,
    ca.OP_IF_ELSE_ZERO: _where_true,
}
_KNOWN = {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, *_POWERS, *_RISING, *_UNARY, *_BINARY}
