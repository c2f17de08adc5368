"""A problem in numbers of a given length: its flows, its contact and its reset map."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from decimal import Decimal
from typing import Any

import casadi as ca
import numpy as np
from flint import arb, ctx

from tests.reference.many_digits.gauss import GaussFlow, ball_function
from tests.reference.many_digits.gauss_scheme import Real
from zeno_orbits.model import ContactQuantities, ImpactLaw, ParameterValues, Problem

State = list[Real]

_SPARE_BITS = 32
_LOST = 3
"""Digits that conditions on the stop lose against the numbers they are made of."""


class ExtendedSystem:
    """A problem at fixed numbers, in numbers of a length: flows, contact and reset map.

    Attributes:
        digits: Decimal digits that count.
        bits: Length of the numbers; all that is done with them is done in this length.
        sizes: Size of each state of the problem, ``(n_x,)``.
    """

    def __init__(self, problem: Problem, values: ParameterValues, digits: int) -> None:
        """Translate the problem.

        Args:
            problem: The problem.
            values: Its numbers, exactly.
            digits: Decimal digits that count.
        """
        self.digits, self.bits = digits, math.ceil(digits * math.log2(10.0)) + _SPARE_BITS
        self.own = problem.dynamics(values).own
        compiled, p = problem.compiled(), values.vector
        n_x = compiled.n_x
        self.sizes = self.own.states(n_x)
        y, q = ca.SX.sym("y", n_x + 3), ca.SX.sym("p", len(p))
        flight = compiled.flight.rate(y[: n_x + 2], ca.vertcat(q, y[n_x + 2]))
        guard_rate = compiled.locked.guard(y[:n_x], q)[1]
        locked = ca.vertcat(compiled.locked.rate(y[:n_x], q), guard_rate)
        struck = compiled.reset(y[:n_x], q, y[n_x])
        law = compiled.law_at(q)

        def flow(name: str, rate: ca.SX, n_in: int, sizes: list[float]) -> GaussFlow:
            function = ca.Function(name, [y[:n_in], q], [rate])
            return GaussFlow(function, p, np.append(self.sizes, sizes), n_x, digits)

        with ctx.workprec(self.bits):
            gap = [self.own.gap, self.own.gap_rate]
            self.flight = flow("flight", flight, n_x + 3, gap)
            self.locked = flow("locked", locked, n_x + 1, [self.own.multiplier])
            self._contact = ball_function(compiled.contact, p)
            self._holonomic = ball_function(compiled.holonomic, p)
            self._resting = ball_function(compiled.resting, p)
            strike = ca.Function(
                "strike", [y[: n_x + 1], q], [struck, law.restitution, law.at(-y[n_x])]
            )
            self._strike = ball_function(strike, p)

    @property
    def smallest(self) -> float:
        """Part of its size below which a condition on the stop counts as zero."""
        return 10.0 ** (_LOST - self.digits)

    @property
    def smallest_speed(self) -> Real:
        """Speed after an impact whose square is below rounding."""
        return self.own.gap_rate * arb(10) ** (-(self.digits + _LOST) / arb(2))

    def numbers(self, values: Sequence[float | Decimal | Real]) -> State:
        """Return values in this length, exactly if they fit."""
        exact = [str(value) if isinstance(value, Decimal) else value for value in values]
        return [arb(value).mid() for value in exact]

    def contact(self, x: State) -> ContactQuantities:
        """Return the contact quantities at a state."""
        return ContactQuantities(*_middles(self._contact(x)[0]))

    def conditions(self, x: State) -> State:
        """Return what is zero where the stop lets go: gap, gap rate, multiplier, constraints."""
        at = self.contact(x)
        return [at.gap, at.gap_rate, at.multiplier, *_middles(self._holonomic(x)[0])]

    def resting(self, x: State) -> tuple[State, Real, State]:
        """Return a state moved onto the stop, its d2h/dt2 and its constrained flow."""
        state, (acceleration,), rate = map(_middles, self._resting(x))
        return state, acceleration, rate

    def strike(self, x: State, approach_rate: Real) -> tuple[State, ImpactLaw]:
        """Return the state after an impact, and the law with its numbers for that impact."""
        after, (slowest,), (here,) = map(_middles, self._strike([*x, approach_rate]))
        return after, ImpactLaw(slowest, lambda _: here)


def along(x: State, length: Real, direction: State) -> State:
    """Return ``x + length direction``.

    Args:
        x: A state, ``(n_x,)``.
        length: How far.
        direction: Direction, ``(n_x,)``.
    """
    return [(value + length * d).mid() for value, d in zip(x, direction, strict=True)]


def relative_difference(x: State, other: State, sizes: Iterable[float]) -> float:
    """Return the largest difference of two vectors, relative to a size plus the second.

    Args:
        x: One.
        other: The other.
        sizes: Of the entries.
    """
    rows = zip(x, other, sizes, strict=True)
    return max((float(abs(a - b) / (s + abs(b))) for a, b, s in rows), default=0.0)


def _middles(x: Sequence[Any]) -> State:
    return [value.mid() for value in x]
