"""Series in balls hold the exact ones, and every operation has the right recurrence."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import casadi as ca
import pytest
from flint import arb, ctx, fmpq
from hypothesis import given, settings
from hypothesis import strategies as st

from zeno_orbits.errors import TranslationError
from zeno_orbits.proof import BallProgram

_ORDER = 8


def _program(rate: ca.SX, x: ca.SX) -> BallProgram:
    outputs = [rate, ca.densify(ca.jacobian(rate, x))]
    return BallProgram(ca.Function("f", [x, ca.SX(0, 1)], outputs), [], n_flow=x.numel())


def _exact(value: Fraction) -> arb:
    return arb(fmpq(value.numerator, value.denominator))


def _product(a: list[Fraction], b: list[Fraction], k: int) -> Fraction:
    return sum((a[j] * b[k - j] for j in range(k + 1)), Fraction(0))


@settings(max_examples=25)
@given(st.lists(st.integers(-9, 9), min_size=6, max_size=6), st.integers(0, 20))
def test_series_of_a_polynomial_flow_hold_the_rational_ones(numbers: list[int], width: int) -> None:
    a, b, c, d, x0, y0 = (Fraction(n, 7) for n in numbers)
    v = ca.SX.sym("v", 2)
    # Sevenths are no doubles: they enter as carried constants, states of rate zero.
    w = ca.vertcat(v, ca.SX.sym("w", 4))
    rate = ca.vertcat(w[2] * v[0] * v[1] + w[3], w[4] * v[0] ** 2 - w[5] * v[1], ca.SX.zeros(4))
    x, y = [x0], [y0]
    for k in range(_ORDER):
        first = a * _product(x, y, k) + (b if k == 0 else 0)
        second = c * _product(x, x, k) - d * y[k]
        x.append(first / (k + 1))
        y.append(second / (k + 1))
    wide = arb(0, Fraction(width, 100).__float__())
    start = [_exact(x0) + wide, _exact(y0) + wide, *(_exact(one) for one in (a, b, c, d))]
    series = _program(rate, w).flow_series(start, _ORDER)
    for found, truth in ((series[0], x), (series[1], y)):
        assert all(ball.contains(_exact(one)) for ball, one in zip(found, truth, strict=True))


def test_every_operation_gives_the_series_of_its_values_along_a_line() -> None:
    x = ca.SX.sym("x", 2)
    u, v = x[0], x[1]
    terms = (
        *(ca.sin(u), ca.cos(v), ca.tan(u), ca.exp(u), ca.expm1(v), ca.log(u), ca.log1p(v)),
        *(ca.sqrt(u), ca.asin(v), ca.acos(v), ca.atan(u), ca.sinh(u), ca.cosh(v), ca.tanh(u)),
        *(ca.asinh(u), ca.acosh(2 + u), ca.atanh(v), u / v, 1 / u, 3 - v, u - 3, u / 3, 2 / v),
        *(u**3, u**-2, u**1.5, u**v, -u, u * u, u + u, ca.hypot(u, v)),
    )
    outputs = [ca.SX([1.0, 0.5]), ca.vertcat(*terms)]
    with ctx.workprec(160):
        function = ca.Function("f", [x, ca.SX(0, 1)], outputs)
        program = BallProgram(function, [], n_flow=2)
        start = [arb("0.4"), arb("0.3")]
        along = program.follow(program.flow_series(start, 25), 24)[1]
        step = arb("1e-5")
        values = program([start[0] + step, start[1] + step / 2])[1]
        for series, value in zip(along, values, strict=True):
            total = arb(0)
            for one in reversed(series):
                total = total * step + one
            # Twenty-five terms leave a remainder of about (1e-5 / 0.3) ** 25.
            assert abs(total - value) < 1e-40


def test_an_operation_that_is_not_analytic_is_refused() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(TranslationError):
        _program(ca.fabs(x), x)


def test_more_digits_and_smaller_boxes_only_tighten_a_series() -> None:
    x = ca.SX.sym("x", 2)
    program = _program(ca.vertcat(x[1], -ca.sin(x[0]) / (1 + x[1] ** 2)), x)
    boxes = []
    for bits, radius in ((64, 1e-3), (64, 1e-6), (128, 1e-6), (128, 0.0)):
        with ctx.workprec(bits):
            start = [arb(1, radius), arb(0.5, radius)]
            boxes.append(program.flow_series(start, _ORDER)[0])
    for outer, inner in pairwise(boxes):
        assert all(a.overlaps(b) and b.rad() <= a.rad() for a, b in zip(outer, inner, strict=True))
