r"""Kinks of formulas as switches: ``fmin``, ``fmax``, ``fabs``, ``sign``, ``if_else``, ``atan2``.

Each of these operations has a condition :math:`c`, a formula whose sign selects the branch. On one
side of :math:`c = 0` the formula is smooth. Its zero is an event without a reset. Operations that
jump without a condition are refused, and so are operations that are unknown here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial, reduce
from itertools import chain, combinations
from typing import Any

import casadi as ca
import numpy as np

from zeno_orbits.integrators import Lookup, Side, called, may_be_merged
from zeno_orbits.model.expressions.identities import at_random_points, is_told_by_points
from zeno_orbits.model.expressions.operations import operation_name, symbols_in

_DEPTH = 32
"""Depth to which two conditions are compared."""
_SAME = 1e-13
"""Relative rounding at which two formulas are the same at random points."""

_SMOOTH = frozenset(
    {
        *(ca.OP_ASSIGN, ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV, ca.OP_NEG, ca.OP_INV),
        *(ca.OP_SQ, ca.OP_TWICE, ca.OP_SQRT, ca.OP_POW, ca.OP_CONSTPOW, ca.OP_EXP, ca.OP_EXPM1),
        *(ca.OP_LOG, ca.OP_LOG1P, ca.OP_SIN, ca.OP_COS, ca.OP_TAN, ca.OP_ASIN, ca.OP_ACOS),
        *(ca.OP_ATAN, ca.OP_SINH, ca.OP_COSH, ca.OP_TANH, ca.OP_ASINH, ca.OP_ACOSH, ca.OP_ATANH),
        *(ca.OP_ERF, ca.OP_ERFINV, ca.OP_HYPOT, ca.OP_LIFT, ca.OP_PRINTME),
    }
)
"""Operations that are smooth where they are finite."""
_ROOTS = frozenset({ca.OP_SQRT, ca.OP_POW, ca.OP_CONSTPOW})
"""Smooth operations that have a kink where their argument is zero as a square is."""
_BOUNDED = frozenset({ca.OP_ATAN, ca.OP_TANH, ca.OP_ERF})
"""Smooth operations that jump where their argument has a pole."""
_PARTIAL = frozenset(
    {
        *(ca.OP_SQRT, ca.OP_LOG, ca.OP_LOG1P, ca.OP_POW, ca.OP_CONSTPOW, ca.OP_DIV, ca.OP_INV),
        *(ca.OP_ASIN, ca.OP_ACOS, ca.OP_ACOSH, ca.OP_ATANH, ca.OP_ERFINV),
    }
)
"""Operations that are undefined for some arguments."""
_LOGIC = frozenset({ca.OP_NOT, ca.OP_AND, ca.OP_OR, ca.OP_IF_ELSE_ZERO})
_JUMPS = frozenset(
    {ca.OP_FLOOR, ca.OP_CEIL, ca.OP_FMOD, ca.OP_REMAINDER, ca.OP_EQ, ca.OP_NE, *_LOGIC}
)
"""Operations that jump without a condition that could be an event."""
_COMPARISONS = frozenset({ca.OP_LT, ca.OP_LE})
_LARGEST = frozenset({ca.OP_FMIN, ca.OP_FMAX})
_SIGNED = frozenset({ca.OP_FABS, ca.OP_SIGN, ca.OP_COPYSIGN})
_KINKS = frozenset({*_COMPARISONS, *_LARGEST, *_SIGNED, ca.OP_ATAN2})
"""Operations with a condition."""
_PARITIES = (Side.EVEN, Side.ODD)
"""Cells of a table on the two sides of its kink."""


@dataclass(frozen=True, slots=True)
class _Value:
    """The result of an operation in two versions, as written and on a branch.

    Attributes:
        written: As written.
        smooth: On the branch.
        slopes: Derivatives of the version on the branch with respect to the states, ``(1, n_x)``,
            empty if they are not asked for.
        varies: Whether the value depends on the states on some branch. A value that depends on
            nothing but the sides of kinks does not vary.
        quotient: Numerator and denominator of a quotient, else empty.
        is_partial: Whether the value may be undefined for some states.
        factors: Factors of a product, else empty.
        square: A base and a factor, if the value is the square of the base times the factor.
        steps: Whether the value is constant between the knots of tables.
        reads: For the kinks whose condition may be undefined, 1 if the value depends on the side of
            the kink on this branch. A missing kink does not change the side.
    """

    written: ca.SX
    smooth: ca.SX
    slopes: ca.SX
    varies: bool = False
    quotient: tuple[_Value, ...] = ()
    is_partial: bool = False
    factors: tuple[_Value, ...] = ()
    square: tuple[_Value, ...] = ()
    steps: bool = False
    reads: Mapping[int, ca.SX] = field(default_factory=dict[int, ca.SX])


@dataclass(slots=True, kw_only=True)
class _Walk:
    """A walk through the operations of formulas.

    Attributes:
        states: The states. Conditions of parameters alone are left in the formulas.
        sides: The side of every condition, 1 where it is positive, as a number or a symbol. Further
            conditions take 1.
        has_slopes: Whether derivatives with respect to the states are carried along.
        gaps: Formulas that are not negative on admissible states.
        conditions: The conditions so far.
        at_zero: For each of them, the side where it is zero on a whole branch.
        decided: Conditions that are known before the walk.
        roots: Bases that an event keeps from falling below zero, and the exponents of their powers.
        cells: Look-ups so far with their arguments and cells.
    """

    states: ca.SX
    sides: Sequence[ca.SX]
    has_slopes: bool
    gaps: Sequence[ca.SX]
    conditions: list[_Value] = field(default_factory=list[_Value])
    at_zero: list[bool] = field(default_factory=list[bool])
    decided: Sequence[ca.SX] = ()
    roots: list[tuple[ca.SX, ca.SX]] = field(default_factory=list["tuple[ca.SX, ca.SX]"])
    cells: list[tuple[Lookup, Sequence[_Value], _Value]] = field(
        default_factory=list["tuple[Lookup, Sequence[_Value], _Value]"]
    )

    def number(self, value: float) -> _Value:
        """Return a number."""
        return _Value(ca.SX(value), ca.SX(value), self._no_slopes())

    def symbol(self, symbol: ca.SX) -> _Value:
        """Return a state or a parameter."""
        if not ca.depends_on(symbol, self.states):
            return _Value(symbol, symbol, self._no_slopes())
        slopes = ca.jacobian(symbol, self.states) if self.has_slopes else self._no_slopes()
        return _Value(symbol, symbol, slopes, varies=True)

    def _no_slopes(self) -> ca.SX:
        return ca.SX(1, self.states.numel() if self.has_slopes else 0)

    def made(self, operation: int, parts: Sequence[_Value]) -> _Value:
        """Return the result of a smooth operation."""
        slopes = self._no_slopes()
        if self.has_slopes and any(one.slopes.nnz() for one in parts):
            partials = _partials(operation, len(parts)).call([one.smooth for one in parts])
            for factor, one in zip(partials, parts, strict=True):
                if one.slopes.nnz():
                    slopes = slopes + factor * one.slopes
        quotient = tuple(parts) if operation == ca.OP_DIV else ()
        varies = any(one.varies for one in parts)
        reads = [one.reads for one in parts]
        if operation == ca.OP_IF_ELSE_ZERO:
            reads[1] = _chosen_reads(parts[0].smooth, reads[1], {})
        factors: tuple[_Value, ...] = ()
        if operation == ca.OP_MUL:
            factors = tuple(chain(*(one.factors or (one,) for one in parts)))
        return _Value(
            _result(operation, [one.written for one in parts]),
            _result(operation, [one.smooth for one in parts]),
            slopes,
            varies=varies,
            steps=varies and all(one.steps for one in parts if one.varies),
            quotient=(self.number(1.0), *parts) if operation == ca.OP_INV else quotient,
            is_partial=any(one.is_partial for one in parts)
            or (operation in _PARTIAL and parts[operation == ca.OP_DIV].varies),
            reads=_union(reads),
            factors=factors,
            square=self._squared(operation, parts, factors) if varies else (),
        )

    def _squared(
        self, operation: int, parts: Sequence[_Value], factors: Sequence[_Value]
    ) -> tuple[_Value, ...]:
        """Return the base of a square and its factor, or nothing: products of squares are squares.

        Of several squares with one base, the factors of a sum add up.
        """
        first, last = parts[0], parts[-1]
        if operation == ca.OP_SQ:
            return first, self.number(1.0)
        for one, other in combinations(range(len(factors)), 2):
            if factors[one].varies and _are_equal(factors[one], factors[other]):
                rest = [part for k, part in enumerate(factors) if k not in (one, other)]
                return factors[one], reduce(self._product, rest, self.number(1.0))
        if operation in (ca.OP_POW, ca.OP_CONSTPOW) and last.written.is_constant():
            half = float(last.written) / 2.0
            if half.is_integer() and half > 0.0:
                return self.made(operation, [first, self.number(half)]), self.number(1.0)
        if operation in (ca.OP_NEG, ca.OP_TWICE) and first.square:
            base, factor = first.square
            return base, self.made(operation, [factor])
        if operation in (ca.OP_ADD, ca.OP_SUB) and first.square and last.square:
            (base, factor), (other, further) = first.square, last.square
            if _are_equal(base, other):
                return base, self.made(operation, [factor, further])
        if operation == ca.OP_MUL and first.square and last.square:
            return tuple(
                self.made(ca.OP_MUL, pair) for pair in zip(first.square, last.square, strict=True)
            )
        if operation == ca.OP_MUL and last.square:
            first, last = last, first
        if operation in (ca.OP_MUL, ca.OP_DIV) and first.square:
            base, factor = first.square
            return base, self.made(operation, [factor, last])
        return ()

    def _product(self, one: _Value, other: _Value) -> _Value:
        return self.made(ca.OP_MUL, [one, other])

    def side(
        self, condition: _Value, at_zero: bool = True, *, jumps: bool = False
    ) -> tuple[ca.SX, int | None]:
        """Return the side of a condition, 1 where it is positive, and keep a new condition.

        Args:
            condition: The condition.
            at_zero: The side where it is zero on a whole branch.
            jumps: Whether the value jumps where the condition is zero. Contact keeps it zero, so it
                must then have the side of an open stop there.

        Returns:
            The side, and the index of the condition, ``None`` for a condition that is decided.

        Raises:
            ValueError: If the condition may change its sign at a pole, or the value jumps where a
                stop closes.
        """
        if condition.written.is_constant():
            value = float(condition.written)
            return ca.SX(int(value > 0.0 or (value == 0.0 and at_zero))), None
        for k, known in enumerate(self.conditions):
            if ca.is_equal(known.written, condition.written, _DEPTH):
                return self.side_of(k), k
            if ca.is_equal(known.written, -condition.written, _DEPTH):
                return 1 - self.side_of(k), k
        for gap in self.gaps:
            factor = _factor(condition.written, gap)
            if factor != 0.0 and jumps and (factor > 0.0) != at_zero:
                raise ValueError(
                    "Argument `model`: a formula jumps where the gap of a stop is zero, where "
                    "contact keeps it: write a formula that is continuous there, as `fmax` is, or "
                    "move the jump off the stop."
                )
            if factor != 0.0:
                return ca.SX(int(factor > 0.0)), None
        if _has_pole(condition.written, self.states, self.gaps):
            raise ValueError(
                "Argument `model`: a formula holds a comparison, `fmin` or `fmax` of a quotient, "
                "which jumps where a denominator of the states is zero: compare the numerator with "
                "a multiple of the denominator, or write a denominator that is positive in its "
                "form, as `1 + q**2`."
            )
        self.conditions.append(condition)
        self.at_zero.append(at_zero)
        k = len(self.conditions) - 1
        return self.side_of(k), k

    def side_of(self, k: int) -> ca.SX:
        """Return the side of a condition, 1 where it is positive."""
        return self.sides[k] if k < len(self.sides) else ca.SX(1)

    def chosen(
        self,
        condition: _Value,
        written: ca.SX,
        first: _Value,
        last: _Value,
        *,
        at_zero: bool = True,
        jumps: bool = False,
    ) -> _Value:
        """Return the first value where a condition is positive, and else the last value."""
        side, k = self.side(condition, at_zero, jumps=jumps)
        reads = [_chosen_reads(side, first.reads, last.reads), condition.reads]
        if k is not None and self.conditions[k].is_partial:
            reads.append({k: ca.SX(1)})
        return _Value(
            written,
            _picked(side, first.smooth, last.smooth),
            _picked(side, first.slopes, last.slopes) if self.has_slopes else self._no_slopes(),
            varies=first.varies or last.varies,
            is_partial=first.is_partial or last.is_partial,
            reads=_union(reads),
        )

    def is_read(self, k: int, entries: Sequence[_Value]) -> ca.SX:
        """Return 1 if a formula depends on the side of a kink, or if its condition is defined."""
        if not self.conditions[k].is_partial:
            return ca.SX(1)
        return _union([one.reads for one in entries]).get(k, ca.SX(0))

    def on_branch(self, operation: int, parts: Sequence[_Value]) -> _Value:
        """Return the result of an operation on the branch.

        Raises:
            ValueError: If the operation jumps without a condition, or is unknown.
        """
        varies = any(one.varies and not one.steps for one in parts)
        if operation not in _SMOOTH | _JUMPS | _KINKS:
            raise ValueError(
                f"Argument `model`: a formula holds the operation `{operation_name(operation)}`, "
                "which is unknown here: write it in other `casadi.SX` operations."
            )
        if operation in _JUMPS and varies:
            self._require_decided(operation, parts)
        if operation in _BOUNDED and varies:
            return self._bounded(operation, parts[0])
        if operation == ca.OP_HYPOT and varies:
            return self._length(*parts)
        if operation in _KINKS and varies:
            return self._kinked(operation, parts)
        if operation in _ROOTS and parts[0].varies and not parts[0].steps:
            return self._root(operation, parts)
        return self.made(operation, parts)

    def looked_up(self, node: Any, parts: Sequence[_Value]) -> list[_Value]:
        """Return the outputs of a look-up.

        Raises:
            ValueError: If a formula calls another function.
        """
        function, lookup = called(node)
        if lookup is None:
            raise ValueError(
                f"Argument `model`: a formula calls the function `{function.name()}`, which has no "
                "formula here: write it in `casadi.SX` operations."
            )
        if lookup.side is not None:
            return [self._cell(lookup, parts)]
        written, smooth = (function(one) for one in (parts[0].written, parts[0].smooth))
        return [
            replace(parts[0], written=written[k], smooth=smooth[k])
            for k in range(function.nnz_out(0))
        ]

    def _cell(self, lookup: Lookup, parts: Sequence[_Value]) -> _Value:
        """Return the cell of a value, the cells of even and odd indices on two sides of a kink."""
        for known, values, cell in self.cells:
            is_one = known.table is lookup.table and known.side is lookup.side
            if is_one and all(map(_are_one, values, parts)):
                return cell
        varies, table = any(one.varies for one in parts), lookup.table
        written, smooth = [one.written for one in parts], [one.smooth for one in parts]
        cell = table.on_side(lookup.side or Side.ALL)(*written)
        is_partial = any(one.is_partial for one in parts)
        reads = [one.reads for one in parts]
        if not (varies and table.is_kinked and lookup.side is Side.ALL):
            on_branch = table.on_side(lookup.side or Side.ALL)(*smooth)
        else:
            k = len(self.conditions)
            side, (even, odd) = self.side_of(k), (table.on_side(one) for one in _PARITIES)
            here = _picked(side, even(*smooth), odd(*smooth))
            by_place = table.guard(here, smooth)
            sign = _picked(side, ca.SX(1), ca.SX(-1))
            slopes = self._no_slopes()
            if self.has_slopes:
                places = [ca.SX.sym("place") for _ in smooth]
                by = ca.jacobian(table.guard(here, places), ca.vertcat(*places))
                at: Any = ca.substitute(by, ca.vertcat(*places), ca.vertcat(*smooth))
                slopes = sign * ca.mtimes(at, ca.vertcat(*(one.slopes for one in parts)))
            self.conditions.append(
                _Value(
                    table.alternating(cell, written),
                    sign * by_place,
                    slopes,
                    varies=True,
                    is_partial=is_partial,
                    reads=_union(reads),
                )
            )
            self.at_zero.append(True)
            on_branch = here
            reads += [{k: ca.SX(1)}] if is_partial else []
        found = _Value(
            cell,
            on_branch,
            self._no_slopes(),
            varies=varies,
            steps=varies,
            is_partial=is_partial,
            reads=_union(reads),
        )
        self.cells.append((lookup, parts, found))
        return found

    def _root(self, operation: int, parts: Sequence[_Value]) -> _Value:
        """Return a power, with the size of its base if that is a square times a factor: a kink."""
        exponent = self.number(0.5) if operation == ca.OP_SQRT else parts[1]
        is_number = exponent.written.is_constant()
        if exponent.varies or (is_number and float(exponent.written).is_integer()):
            return self.made(operation, parts)
        if not (parts[0].square and is_number):
            return self._power(operation, parts, exponent)
        base, factor = parts[0].square
        size = base if _is_positive(base.written, zero=True) else self.on_branch(ca.OP_FABS, [base])
        if float(exponent.written) != 0.5:
            twice = self.number(2.0 * float(exponent.written))
            size = self.on_branch(ca.OP_POW, [size, twice])
        root = self.made(ca.OP_MUL, [size, self.on_branch(operation, [factor, *parts[1:]])])
        return replace(root, written=_result(operation, [one.written for one in parts]))

    def _power(self, operation: int, parts: Sequence[_Value], exponent: _Value) -> _Value:
        """Return a power, as an odd function beyond zero if something keeps its base from there.

        A step of the flow may reach beyond the event at which the base is zero.
        """
        power, base = self.made(operation, parts), parts[0]
        is_number = exponent.written.is_constant()
        if is_number and float(exponent.written) < 0.0:
            return power
        is_chosen = not ca.is_equal(base.written, base.smooth, _DEPTH)
        is_kept = any(_factor(base.written, gap) > 0.0 for gap in self.gaps)
        is_kept = is_kept or (is_chosen and _is_positive(base.written, zero=True))
        if not is_kept and all(_factor(base.written, one, -2.0) == 0.0 for one in self.decided):
            return power
        turn, size = (self.made(sign, [base]) for sign in (ca.OP_SIGN, ca.OP_FABS))
        odd = self.made(ca.OP_MUL, [turn, self.made(operation, [size, *parts[1:]])])
        smooth, slopes = odd.smooth, odd.slopes
        if not is_number:
            # A power that turns out to have a pole stays as it is.
            smooth, slopes = (
                _picked(exponent.smooth > 0, one, other)
                for one, other in ((smooth, power.smooth), (slopes, power.slopes))
            )
        self.roots.append((base.written, exponent.written))
        odd = replace(power, smooth=smooth, slopes=slopes)
        return odd if is_kept else self.chosen(base, power.written, odd, power)

    def _require_decided(self, operation: int, parts: Sequence[_Value]) -> None:
        """Refuse an operation that jumps with the states, other than by a comparison.

        Raises:
            ValueError: If it does.
        """
        decided = parts[:1] if operation == ca.OP_IF_ELSE_ZERO else parts
        if operation in _LOGIC:
            if any(one.varies for one in decided):
                raise ValueError(
                    "Argument `model`: a formula uses a number of the states as a condition, which "
                    "jumps without an event: write a comparison with `<` or `>`."
                )
        else:
            raise ValueError(
                f"Argument `model`: a formula holds `{operation_name(operation)}` of the states, "
                "which jumps without an event: declare a switch instead, or `atan2` for an angle."
            )

    def _kinked(self, operation: int, parts: Sequence[_Value]) -> _Value:
        first, last = parts[0], parts[-1]
        written = _result(operation, [one.written for one in parts])
        one, minus_one, zero = map(self.number, (1.0, -1.0, 0.0))
        if operation == ca.OP_ATAN2:
            return self._angle(first, last, written)
        if operation == ca.OP_SIGN:
            return self.chosen(first, written, one, minus_one)
        if operation == ca.OP_COPYSIGN:
            size = self.on_branch(ca.OP_FABS, [first])
            if not last.varies:
                return self.made(ca.OP_MUL, [size, self.made(ca.OP_COPYSIGN, [one, last])])
            return self.chosen(last, written, size, self.made(ca.OP_NEG, [size]))
        if operation == ca.OP_FABS:
            return self.chosen(first, written, first, self.made(ca.OP_NEG, [first]))
        difference = self.made(ca.OP_SUB, parts)
        if operation in _COMPARISONS:
            is_strict = operation == ca.OP_LT
            return self.chosen(difference, written, zero, one, at_zero=is_strict, jumps=True)
        if operation == ca.OP_FMAX:
            return self.chosen(difference, written, first, last)
        return self.chosen(difference, written, last, first)

    def _angle(self, y: _Value, x: _Value, written: ca.SX) -> _Value:
        r"""Return ``atan2(y, x)`` on one side of its branch cut.

        The condition :math:`x + y + \sqrt{x^2 + y^2}` is below zero in the third quadrant alone.
        One of the borders is the branch cut. At the other border the angle is -pi/2 on both sides.
        On each side, the angle is smooth beyond both borders.
        """
        if _is_positive(x.written):
            return self.made(ca.OP_ATAN, [self.made(ca.OP_DIV, [y, x])])
        total = self.made(ca.OP_ADD, [x, y])
        length = self.made(ca.OP_HYPOT, [x, y])
        inside = self._turned(self.made(ca.OP_SUB, [y, x]), total, math.pi / 4)
        outside = self._turned(
            self.made(ca.OP_SUB, [x, y]), self.made(ca.OP_NEG, [total]), -3 * math.pi / 4
        )
        return self.chosen(self.made(ca.OP_ADD, [total, length]), written, inside, outside)

    def _length(self, one: _Value, other: _Value) -> _Value:
        """Return a length, which has a kink where one side is zero on a whole branch."""
        if one.varies and other.varies:
            return self.made(ca.OP_HYPOT, [one, other])
        leg, held = (one, other) if one.varies else (other, one)
        if held.written.is_zero():
            return self.on_branch(ca.OP_FABS, [leg])
        length = self.made(ca.OP_HYPOT, [one, other])
        if not ca.depends_on(held.written, self.states):
            return length
        is_zero = held.smooth == 0
        first, last = (
            replace(
                length,
                smooth=_picked(is_zero, part.smooth, length.smooth),
                slopes=_picked(is_zero, part.slopes, length.slopes)
                if self.has_slopes
                else part.slopes,
            )
            for part in (leg, self.made(ca.OP_NEG, [leg]))
        )
        return self.chosen(leg, length.written, first, last)

    def _turned(self, y: _Value, x: _Value, angle: float) -> _Value:
        """Return ``atan2(y, x)`` plus an angle, without its branch cut."""
        return self.made(ca.OP_ADD, [self.made(ca.OP_ATAN2, [y, x]), self.number(angle)])

    def _bounded(self, operation: int, part: _Value) -> _Value:
        """Return a bounded operation of a formula that may have a pole.

        The arc tangent of a quotient is an angle, with the denominator as its condition.

        Raises:
            ValueError: If the operation would jump where a denominator is zero.
        """
        if not _has_pole(part.written, self.states):
            return self.made(operation, [part])
        if operation == ca.OP_ATAN and part.quotient:
            y, x = part.quotient
            if not any(_has_pole(one.written, self.states) for one in (y, x)):
                written = _result(operation, [part.written])
                first = self.made(ca.OP_ATAN2, [y, x])
                negative = [self.made(ca.OP_NEG, [one]) for one in (y, x)]
                return self.chosen(x, written, first, self.made(ca.OP_ATAN2, negative))
        raise ValueError(
            f"Argument `model`: a formula holds `{operation_name(operation)}` of a quotient, which "
            "jumps where a denominator of the states is zero: write the angle as `atan2`, or a "
            "denominator that is positive in its form, as `1 + q**2`."
        )


def _are_equal(one: _Value, other: _Value) -> bool:
    return bool(ca.is_equal(one.written, other.written, _DEPTH))


def _are_one(one: _Value, other: _Value) -> bool:
    """Return True if two arguments of a table are one formula, which may be written twice."""
    return _are_equal(one, other) or _factor(one.written, other.written) == 1.0


def _picked(side: ca.SX, first: ca.SX, last: ca.SX) -> ca.SX:
    """Return the first value on side 1 and the last one on side 0, whatever the other one is."""
    if side.is_constant():
        return first if float(side) else last
    picked: ca.SX = ca.if_else(side, first, last)
    return picked


def _union(reads: Sequence[Mapping[int, ca.SX]]) -> Mapping[int, ca.SX]:
    """Return the kinks on which one of several values depends."""
    found: dict[int, ca.SX] = {}
    for k, is_read in chain(*(one.items() for one in reads)):
        known = found.get(k, ca.SX(0))
        if known.is_zero() or is_read.is_one():
            found[k] = is_read
        elif not known.is_one():
            found[k] = ca.fmax(known, is_read)
    return found


def _chosen_reads(
    side: ca.SX, first: Mapping[int, ca.SX], last: Mapping[int, ca.SX]
) -> Mapping[int, ca.SX]:
    """Return the kinks on which the first value on side 1, or the last one on side 0, depends."""
    if side.is_constant():
        return first if float(side) else last
    none = ca.SX(0)
    return {k: _picked(side, first.get(k, none), last.get(k, none)) for k in {*first, *last}}


def _factor(formula: ca.SX, gap: ca.SX, lowest: float = 0.5) -> float:
    """Return the number of which a formula is the product with a gap, or zero.

    Args:
        formula: The formula.
        gap: The gap, or another formula.
        lowest: Least value of the symbols at which they are compared.
    """
    by_form = _factor_by_form(formula, gap)
    if by_form or not is_told_by_points(formula, gap):
        return by_form
    values = at_random_points((formula, gap), lowest)
    if not np.all(np.isfinite(values)) or values[0, 1] == 0.0:
        return 0.0
    factor = float(values[0, 0] / values[0, 1])
    off = np.abs(values[:, 0] - factor * values[:, 1])
    return factor if np.all(off <= _SAME * np.max(np.abs(values))) else 0.0


def _factor_by_form(formula: ca.SX, gap: ca.SX) -> float:
    """Return the number of which a formula is the product with a gap by its form, or zero."""
    (one, size), (other, unit) = without_numbers(formula), without_numbers(gap)
    if ca.is_equal(one, other, _DEPTH):
        return size / unit
    return -size / unit if ca.is_equal(one, -other, _DEPTH) else 0.0


def without_numbers(formula: Any) -> tuple[Any, float]:
    """Return a formula without the numbers that multiply it, and their product."""
    factor = 1.0
    while True:
        operation = formula.op()
        parts = [formula.dep(k) for k in range(formula.n_dep())]
        if operation == ca.OP_NEG:
            formula, factor = parts[0], -factor
        elif operation == ca.OP_TWICE:
            formula, factor = parts[0], 2.0 * factor
        elif operation == ca.OP_MUL and any(_is_number(one) for one in parts):
            number, formula = sorted(parts, key=_is_number, reverse=True)
            factor *= float(number)
        elif operation == ca.OP_DIV and _is_number(parts[1]):
            formula, factor = parts[0], factor / float(parts[1])
        else:
            return formula, factor


def _is_number(formula: Any) -> bool:
    return formula.is_constant() and math.isfinite(float(formula)) and float(formula) != 0.0


def _result(operation: int, inputs: Sequence[ca.SX]) -> ca.SX:
    """Return the result of an operation, without a condition that is decided."""
    if operation == ca.OP_IF_ELSE_ZERO and inputs[0].is_constant():
        return inputs[1] if float(inputs[0]) != 0.0 else ca.SX(0.0)
    return ca.SX.unary(operation, *inputs) if len(inputs) == 1 else ca.SX.binary(operation, *inputs)


@cache
def _partials(operation: int, n: int) -> Any:
    """Return the partial derivatives of an operation as a function."""
    parts = [ca.SX.sym("part") for _ in range(n)]
    result = _result(operation, parts)
    return ca.Function("partials", parts, [ca.jacobian(result, one) for one in parts])


def _has_pole(formula: ca.SX, states: ca.SX, gaps: Sequence[ca.SX] | None = None) -> bool:
    """Return True if a denominator in a formula depends on the states and may be zero.

    Args:
        formula: The formula.
        states: The states.
        gaps: Formulas that are not negative. If they are given, only a pole counts at which the
            formula may change its sign.
    """
    changes_sign = gaps is not None
    seen: set[int] = set()
    waiting: list[Any] = [formula]
    while waiting:
        node = waiting.pop()
        if node.is_leaf() or node.element_hash() in seen:
            continue
        seen.add(node.element_hash())
        parts: list[Any] = [node.dep(k) for k in range(node.n_dep())]
        waiting += parts
        operation = node.op()
        is_power = operation in (ca.OP_POW, ca.OP_CONSTPOW)
        below: list[Any]
        if operation == ca.OP_TAN:
            below = [ca.cos(parts[0])]
        elif operation in (ca.OP_DIV, ca.OP_INV):
            below = parts[-1:]
        else:
            below = parts[:1] if is_power and not _is_positive(parts[1], zero=True) else []
        for one in chain(*map(_factors, below)):
            if ca.depends_on(one, states) and not (
                _is_positive(one, zero=changes_sign)
                or any(_is_above(one, gap, states) for gap in gaps or ())
            ):
                return True
    return False


def _factors(formula: Any) -> list[Any]:
    """Return the factors of a product, and the base of a power with an odd exponent."""
    operation = formula.op()
    if operation == ca.OP_MUL:
        return [*_factors(formula.dep(0)), *_factors(formula.dep(1))]
    if operation in (ca.OP_POW, ca.OP_CONSTPOW) and formula.dep(1).is_constant():
        is_even = (float(formula.dep(1)) / 2.0).is_integer()
        return [formula.dep(0) ** 2] if is_even else _factors(formula.dep(0))
    return [formula]


def _is_above(formula: ca.SX, gap: ca.SX, states: ca.SX) -> bool:
    """Return True if a formula is by its form a positive multiple of a gap plus a positive rest.

    Both must be formulas of parameters, which count as positive, and the gap linear in a state.
    """
    for k in range(states.numel()):
        state: Any = states[k]
        slope: Any = ca.jacobian(gap, state)
        if slope.is_zero() or ca.depends_on(slope, states):
            continue
        factor: Any = ca.jacobian(formula, state) / slope
        on_stop = -ca.substitute(gap, state, ca.SX(0.0)) / slope
        rest: Any = ca.simplify(ca.substitute(formula, state, on_stop))
        return all(
            not ca.depends_on(one, states) and _is_positive(one, parameters=True)
            for one in (factor, rest)
        )
    return False


def _is_positive(formula: Any, *, zero: bool = False, parameters: bool = False) -> bool:
    """Return True if a formula is positive by its form.

    Args:
        formula: The formula.
        zero: Whether zero is sufficient.
        parameters: Whether the formula holds no states, and its symbols count as positive.
    """
    if formula.is_constant():
        return float(formula) > 0.0 or (zero and float(formula) == 0.0)
    if formula.is_leaf():
        return parameters
    positive = partial(_is_positive, parameters=parameters)
    parts = [formula.dep(k) for k in range(formula.n_dep())]
    operation = formula.op()
    if operation in (ca.OP_EXP, ca.OP_COSH):
        return True
    if operation in (ca.OP_SQ, ca.OP_FABS):
        return zero or (parameters and positive(parts[0]))
    if operation == ca.OP_FMAX:
        return any(positive(one, zero=zero) for one in parts)
    if operation in (ca.OP_ADD, ca.OP_HYPOT):
        least = operation == ca.OP_HYPOT or all(positive(one, zero=True) for one in parts)
        return least and (zero or any(map(positive, parts)))
    if operation in (ca.OP_MUL, ca.OP_DIV, ca.OP_FMIN, ca.OP_SQRT, ca.OP_TWICE, ca.OP_INV):
        return all(positive(one, zero=zero) for one in parts)
    return False


@dataclass(frozen=True, slots=True, kw_only=True)
class Branched:
    """Formulas on one branch of all their kinks.

    Attributes:
        formulas: The formulas, smooth, in the shapes of the given formulas.
        conditions: The condition of every kink as written.
        smooth: The same conditions on the branch. A condition that may be undefined there, and on
            whose side nothing depends, gets the sign of its side: 1 or -1.
        roots: Bases of powers, as written, that events keep from falling below zero, with the
            exponents. On the branch such a power is an odd function of its base.
    """

    formulas: tuple[ca.SX, ...]
    conditions: tuple[ca.SX, ...]
    smooth: tuple[ca.SX, ...]
    roots: tuple[tuple[ca.SX, ca.SX], ...]


def is_smooth(formulas: Sequence[ca.SX]) -> bool:
    """Return True if no operation of formulas needs to be looked at: a quick answer.

    Args:
        formulas: The formulas.
    """
    flat: Any = ca.veccat(*formulas)
    function = ca.Function("formulas", symbols_in(flat), [flat])
    operations = {function.instruction_id(k) for k in range(function.n_instructions())}
    return operations <= _SMOOTH - _BOUNDED - _ROOTS - {ca.OP_HYPOT} | {
        *(ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST)
    }


def branched(
    formulas: Sequence[ca.SX],
    states: ca.SX,
    sides: Sequence[bool] = (),
    gaps: Sequence[ca.SX] = (),
) -> Branched:
    """Return formulas on a branch of their kinks.

    Args:
        formulas: The formulas.
        states: The states, ``(n_x,)``. A condition without states is not a kink.
        sides: For each condition, in the order of the operations, whether it is positive. Further
            conditions are taken as positive. A condition depends only on earlier conditions.
        gaps: The gaps of the stops. A condition that is a multiple of a gap is not a kink: a
            gap is not negative.

    Raises:
        ValueError: If a formula jumps without a condition, or holds an unknown operation.
    """
    walk = _Walk(
        states=states, sides=[ca.SX(int(one)) for one in sides], has_slopes=False, gaps=gaps
    )
    flat: Any = ca.veccat(*(ca.densify(one) for one in formulas))
    walked = _walked(walk, flat)
    entries = ca.vertcat(*(one.smooth for one in walked))
    found: list[ca.SX] = []
    first = 0
    for one in formulas:
        part = entries[first : first + one.numel()]
        found.append(ca.sparsify(ca.reshape(part, *one.shape)) if one.numel() else one)
        first += one.numel()
    return Branched(
        formulas=tuple(found),
        conditions=tuple(one.written for one in walk.conditions),
        smooth=tuple(
            ca.SX(2 * walk.side_of(k) - 1) if walk.is_read(k, walked).is_zero() else one.smooth
            for k, one in enumerate(walk.conditions)
        ),
        roots=tuple(walk.roots),
    )


def sided(
    formulas: Sequence[ca.SX], states: ca.SX, sides: ca.SX, gaps: Sequence[ca.SX]
) -> tuple[tuple[ca.SX, ...], tuple[ca.SX, ...]]:
    """Return the conditions of the kinks of formulas on given sides, and their derivatives.

    The value on the other side of an inner kink does not matter, even if it is not finite.

    Args:
        formulas: The formulas, as `branched` takes them.
        states: The states, ``(n_x,)``.
        sides: Symbols of the sides, 1 where a condition is positive and else 0.
        gaps: The gaps of the stops, as `branched` takes them.

    Returns:
        The conditions, and their derivatives with respect to the states, each ``(1, n_x)``. A
        condition that is zero on a whole branch, as that of ``fmin(x, 1) >= 1``, gets the sign of
        its side: 1 or -1. So does one that may be undefined where nothing depends on its side.
    """
    walk = _Walk(states=states, sides=ca.vertsplit(sides), has_slopes=True, gaps=gaps)
    walked = _walked(walk, ca.veccat(*(ca.densify(one) for one in formulas)))
    values: list[ca.SX] = []
    slopes: list[ca.SX] = []
    for k, (one, at_zero) in enumerate(zip(walk.conditions, walk.at_zero, strict=True)):
        is_flat = ca.logic_and(one.smooth == 0, ca.sum2(ca.fabs(one.slopes)) == 0)
        value = ca.if_else(is_flat, 1.0 if at_zero else -1.0, one.smooth)
        is_read = walk.is_read(k, walked)
        values.append(_picked(is_read, value, 2 * walk.side_of(k) - 1))
        slopes.append(_picked(is_read, one.slopes, ca.SX(*one.slopes.shape)))
    return tuple(values), tuple(slopes)


def _walked(walk: _Walk, flat: Any) -> list[_Value]:
    """Return the entries of a formula, ``(n,)``."""
    symbols = symbols_in(flat)
    function: Any = ca.Function("formulas", symbols, [flat], {"cse": may_be_merged([flat])})
    if _ROOTS & {function.instruction_id(k) for k in range(function.n_instructions())}:
        first = replace(
            walk, sides=(), has_slopes=False, conditions=[], at_zero=[], roots=[], cells=[]
        )
        _walked_through(first, function, symbols, flat.numel())
        walk.decided = tuple(one.written for one in first.conditions)
    return _walked_through(walk, function, symbols, flat.numel())


def _walked_through(
    walk: _Walk, function: Any, symbols: Sequence[ca.SX], n_entries: int
) -> list[_Value]:
    """Return the outputs of a function of its symbols, ``(n_entries,)``."""
    work: dict[int, _Value] = {}
    entries = [walk.number(0.0)] * n_entries
    differentiated = _of_conditions(function) if walk.has_slopes else set[int]()
    nodes: Any = function.instructions_sx()
    for k in range(function.n_instructions()):
        walk.has_slopes = k in differentiated
        operation = function.instruction_id(k)
        given, taken = function.instruction_input(k), function.instruction_output(k)
        if operation == ca.OP_OUTPUT:
            entries[taken[1]] = work[given[0]]
        elif operation == ca.OP_INPUT:
            work[taken[0]] = walk.symbol(symbols[int(given[0])])
        elif operation == ca.OP_CONST:
            work[taken[0]] = walk.number(function.instruction_constant(k))
        elif operation == ca.OP_CALL:
            parts = [work[place] for place in given]
            work.update(zip(taken, walk.looked_up(nodes[k], parts), strict=True))
        else:
            work[taken[0]] = walk.on_branch(operation, [work[place] for place in given])
    return entries


def _of_conditions(function: Any) -> set[int]:
    """Return the indices of the instructions whose results the condition of a kink may need."""
    last: dict[int, int] = {}
    sources: list[list[int]] = []
    needed = set[int]()
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        takes = operation not in (ca.OP_INPUT, ca.OP_CONST)
        sources.append([last[place] for place in function.instruction_input(k)] if takes else [])
        if operation in _KINKS | _BOUNDED | _ROOTS | {ca.OP_HYPOT, ca.OP_CALL}:
            needed.add(k)
        if operation != ca.OP_OUTPUT:
            last.update((place, k) for place in function.instruction_output(k))
    for k in reversed(range(len(sources))):
        if k in needed:
            needed.update(sources[k])
    return needed
