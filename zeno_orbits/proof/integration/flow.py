r"""One step of a flow in balls: Taylor's method with a proved remainder, and its derivative.

Let :math:`c_j` be the Taylor coefficients over a box `X`, and `B` a box that contains the motions
from `X` over the whole step. Then
:math:`\varphi_s(X) \subset \sum_{j \le k} c_j(X) s^j + c_{k+1}(B) s^{k+1}`. `B` is such a box if
this expression over all `s` in ``[0, h]`` lies inside `B`, for stiff flows as well. The derivative
`V` with respect to the start is enclosed in the same way [NedialkovJacksonCorliss1999]_.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
from flint import arb, ctx

from zeno_orbits.proof.arithmetic.balls import (
    UNIT,
    ZERO,
    Ball,
    Matrix,
    all_finite,
    identity,
    matrix,
    scaled,
    within,
)
from zeno_orbits.proof.arithmetic.program import BallProgram
from zeno_orbits.proof.arithmetic.recurrences import Series

_WIDER = 1 + 1 / 16
"""Factor by which the box of a step is wider than the range of its series."""

_SPARE_BITS = 6


class BallFlow:
    """A flow ``y' = f(y)`` in balls, with its derivative and an optional guard."""

    def __init__(
        self, states: ca.SX, numbers: ca.SX, rate: ca.SX, guard: ca.SX | None, values: list[Ball]
    ) -> None:
        """Translate a flow.

        Args:
            states: ``y``, ``(n,)``, symbols.
            numbers: Symbols of the parameters and constants in the flow.
            rate: ``f``, ``(n,)``.
            guard: A function of the states that is evaluated along the flow.
            values: Values of these symbols.
        """
        self.n = states.numel()
        slopes = ca.jacobian(rate, states)
        guard = ca.SX(0) if guard is None else guard
        gradient = ca.jacobian(guard, states)
        outputs = [ca.densify(rate), slopes, ca.densify(guard), gradient]
        function = ca.Function("flow", [states, numbers], outputs, {"cse": True})
        self._program = BallProgram(function, values, n_flow=self.n)
        self._slopes = list(zip(*slopes.sparsity().get_triplet(), strict=True))
        self._gradient = list(gradient.sparsity().get_triplet()[1])

    def point_series(self, y: Sequence[Ball], order: int) -> list[Series]:
        """Return the Taylor coefficients of the motion from a state, ``(n, order + 1)``."""
        return self._program.flow_series(y, order)[: self.n]

    def series(self, y: Sequence[Ball], order: int, longer: int = 0) -> FlowSeries:
        """Return the coefficients of the motion and of its derivative.

        Args:
            y: A box of states, ``(n,)``.
            order: Order of the last coefficient of both.
            longer: Order of the last coefficient of the motion, if it is higher.
        """
        series = self._program.flow_series(y, max(order, longer))
        slopes = self._program.follow(series, order - 1)[1]
        n, zeros = self.n, [ZERO] * (self.n * self.n)
        powers: list[Matrix] = []
        for j in range(order):
            rows = zeros[:]
            for (row, col), one in zip(self._slopes, slopes, strict=True):
                rows[row * n + col] = one[j]
            powers.append(matrix([rows[k * n : k * n + n] for k in range(n)], n))
        derivative = [identity(n)]
        for j in range(order):
            total = powers[0] * derivative[j]
            for i in range(1, j + 1):
                total += powers[i] * derivative[j - i]
            derivative.append(total / (j + 1))
        return FlowSeries(states=series[:n], derivative=derivative)

    def rate(self, y: Sequence[Ball]) -> list[Ball]:
        """Return ``f``, ``(n,)``."""
        return self._program(y)[0]

    def guard(self, y: Sequence[Ball]) -> tuple[Ball, list[Ball], list[Ball]]:
        """Return the guard, its gradient, ``(n,)``, and the rate of the states, ``(n,)``."""
        rate, _, (value,), slopes = self._program(y)
        gradient = [ZERO] * self.n
        for place, slope in zip(self._gradient, slopes, strict=True):
            gradient[place] = slope
        return value, gradient, rate


@dataclass(frozen=True, slots=True, kw_only=True)
class FlowSeries:
    """Taylor coefficients over a box.

    Attributes:
        states: Coefficients of the states, ``(n, order + 1)`` or longer.
        derivative: Coefficients of the derivative with respect to the start, ``order + 1``
            matrices.
    """

    states: list[Series]
    derivative: list[Matrix]


@dataclass(frozen=True, slots=True, kw_only=True)
class FlowStep:
    """A step with its proved remainders.

    Attributes:
        size: Length of the step, exact.
        orders: Order of the last coefficient for a point, and for the derivative.
        box: Box that contains all motions over the step, ``(n,)``.
        series: Over the start.
        rest: Coefficient of the remainder for a point, ``(n,)``.
        low_rest: The same at the order of the derivative, ``(n,)``.
        derivative_rest: Coefficient of the remainder for the derivative.
    """

    size: Ball
    orders: tuple[int, int]
    box: list[Ball]
    series: FlowSeries
    rest: list[Ball]
    low_rest: list[Ball]
    derivative_rest: Matrix

    def point(self, series: list[Series], time: Ball) -> list[Ball]:
        """Return the states of a point at times of the step, from its coefficients, ``(n,)``."""
        found: list[Ball] = []
        for coefficients, value in zip(series, self.rest, strict=True):
            for one in coefficients[self.orders[0] :: -1]:
                value = value * time + one
            found.append(value)
        return found

    def derivative(self, time: Ball) -> Matrix:
        """Return the derivative of the flow at times of the step, over the whole start."""
        total = self.derivative_rest
        for one in self.series.derivative[self.orders[1] :: -1]:
            total = total * time + one
        return total


def enclose(
    flow: BallFlow, series: FlowSeries, size: Ball, orders: tuple[int, int]
) -> FlowStep | None:
    """Return a step of a given length, or None if no enclosing box is found.

    Args:
        flow: The flow.
        series: Coefficients over the start, to the second order at least.
        size: Length, exact.
        orders: Order of the last coefficient for a point, and a lower or equal order for the
            derivative.
    """
    n, (order, order_v) = flow.n, orders
    filled, filled_v = _filled(series, size, order_v)
    box = [_wider(one) for one in filled]
    box_v = [_wider(one) for one in filled_v.entries()]
    if not (all_finite(box) and all_finite(box_v)):
        return None
    last = order_v + 1
    over = flow.series(box, last, order + 1)
    box_v_matrix = matrix([box_v[k * n : k * n + n] for k in range(n)], n)
    rest_v = over.derivative[last] * box_v_matrix
    span = UNIT * size**last
    holds = all(
        within(one + span * coefficients[last], outer)
        for one, coefficients, outer in zip(filled, over.states, box, strict=True)
    ) and all(
        within(one + span * coefficient, outer)
        for one, coefficient, outer in zip(filled_v.entries(), rest_v.entries(), box_v, strict=True)
    )
    if not holds:
        return None
    return FlowStep(
        size=size,
        orders=orders,
        box=box,
        series=series,
        rest=[coefficients[order + 1] for coefficients in over.states],
        low_rest=[coefficients[last] for coefficients in over.states],
        derivative_rest=rest_v,
    )


def _filled(series: FlowSeries, size: Ball, order: int) -> tuple[list[Ball], Matrix]:
    """Return the sums of the hulls of zero and each term except the first, over a whole step."""
    filled: list[Ball] = []
    powers = [size**j for j in range(order + 1)]
    for coefficients in series.states:
        terms = (UNIT * (coefficients[j] * powers[j]) for j in range(1, order + 1))
        filled.append(sum(terms, coefficients[0]))
    total = series.derivative[0]
    for j in range(1, order + 1):
        total = total + series.derivative[j] * (UNIT * powers[j])
    return filled, total


def _wider(x: Ball) -> Ball:
    if x.is_exact():
        return x
    # A short step moves a state by less than its rounding error. The box must contain both.
    rounding = x.abs_upper() * arb(2) ** (_SPARE_BITS - ctx.prec)
    return scaled(x, _WIDER) + arb(0, rounding)
