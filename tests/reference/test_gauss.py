"""Flows in many digits by Gauss's collocation, against functions that mpmath knows."""

import math
from collections.abc import Iterator, Sequence
from decimal import Decimal, localcontext
from typing import Any

import casadi as ca
import mpmath as mp
import numpy as np
import pytest
from flint import arb, ctx

from tests.reference.many_digits.execution import decimal
from tests.reference.many_digits.gauss import GaussFlow, ball_function
from tests.reference.many_digits.gauss_scheme import Real, gauss_scheme
from tests.reference.many_digits.system import ExtendedSystem
from zeno_orbits.errors import SimulationError, StepSizeError, TranslationError
from zeno_orbits.model import load_problem

DIGITS = 40
TINY = mp.mpf(10) ** -DIGITS


@pytest.fixture(autouse=True)
def _lengths() -> Iterator[None]:
    with ctx.workprec(180), mp.workdps(50):
        yield


def _mp(value: Real) -> mp.mpf:
    return mp.mpf(value.str(48, radius=False))


def _numbers(*values: float) -> list[Real]:
    return [arb(value) for value in values]


def _flow(
    rate: Sequence[Any], *, n: int, parameters: Sequence[float] = (1.0,), digits: int = DIGITS
) -> GaussFlow:
    """Return a flow of `(y, p)`, its guard the first entry of `y`."""
    y, p = ca.SX.sym("y", n), ca.SX.sym("p", len(parameters))
    function = ca.Function("rate", [y, p], [ca.vertcat(*(f(y, p) for f in rate))])
    return GaussFlow(function, parameters, np.ones(n), 0, digits)


def _swing(frequency: float = 1.0) -> GaussFlow:
    """Return `y0'' = -p^2 y0` as a flow."""
    return _flow([lambda y, _: y[1], lambda y, p: -(p**2) * y[0]], n=2, parameters=(frequency,))


def test_the_scheme_integrates_what_its_order_promises() -> None:
    # Gauss's quadrature is exact to degree 2 s - 1, the inner integrals to degree s - 1.
    scheme = gauss_scheme(6, ctx.prec)
    *inner, weights = scheme.matrix.table()
    for degree in range(12):
        found = sum(w * x**degree for w, x in zip(weights, scheme.nodes, strict=True))
        assert abs(_mp(found) - mp.mpf(1) / (degree + 1)) < TINY
    for node, row in zip(scheme.nodes, inner, strict=True):
        for degree in range(6):
            found = sum(w * x**degree for w, x in zip(row, scheme.nodes, strict=True))
            assert abs(_mp(found - node ** (degree + 1) / (degree + 1))) < TINY


def test_a_double_is_taken_exactly_and_a_decimal_to_all_digits() -> None:
    problem = load_problem("bouncing_ball")
    system = ExtendedSystem(problem, problem.values(), 60)
    with localcontext() as context, ctx.workprec(system.bits):
        context.prec = 60
        tenth, third = system.numbers([0.1, Decimal(1) / 3])
        assert abs(decimal(tenth) - Decimal.from_float(0.1)) < Decimal("1e-60")
        assert abs(decimal(third) - Decimal(1) / 3) < Decimal("1e-59")


def test_a_function_holds_all_digits() -> None:
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p", 2)
    outputs = [ca.sin(x[0]) * p[0] + 0.1, ca.vertcat(x[1], 0), ca.SX(0, 1)]
    function = ball_function(ca.Function("f", [x, p], outputs), (0.3, 7.0))
    (value,), (second, nothing), none = function(_numbers(0.7, 0.2))
    wanted = mp.sin(mp.mpf(0.7)) * mp.mpf(0.3) + mp.mpf(0.1)
    assert abs(_mp(value) - wanted) < TINY
    assert (float(second), float(nothing), none) == (0.2, 0.0, [])


def test_a_flow_holds_all_digits_and_its_guard_falls_where_the_cosine_does() -> None:
    time, (_, rate), fell = _swing().advance(_numbers(1.0, 0.0), arb(10))
    assert fell
    assert abs(_mp(time) - mp.pi / 2) < 10 * TINY
    assert abs(_mp(rate) + 1) < 10 * TINY


def test_a_flow_ends_when_its_time_is_over() -> None:
    time, (place, _), fell = _swing(2.0).advance(_numbers(1.0, 0.0), arb(0.75))
    assert not fell
    assert time == arb(0.75)
    assert abs(_mp(place) - mp.cos(mp.mpf(1.5))) < 10 * TINY


def test_a_root_at_the_start_does_not_count() -> None:
    time, _, fell = _swing().advance(_numbers(0.0, 1.0), arb(10), order=1)
    assert fell
    assert abs(_mp(time) - mp.pi) < 10 * TINY


@pytest.mark.parametrize("expected", [0.1, 3.0, 3.14159, 9.0])
def test_a_fall_is_the_first_one_whenever_it_was_expected(expected: float) -> None:
    flow = _swing()
    flow.advance(_numbers(0.0, 1.0), arb(10), order=1)
    time, _, fell = flow.advance(_numbers(0.0, 1.0), arb(10), order=1, unit=1e-3, expected=expected)
    assert fell
    assert abs(_mp(time) - mp.pi) < 10 * TINY


def test_a_root_of_order_three_at_the_start_does_not_count() -> None:
    # y0 = t^3 (1 - t) / 6, so y0''' = 1 - 4 t.
    chain = [lambda y, _, k=k: y[k + 1] for k in range(3)]
    flow = _flow([*chain, lambda y, p: -4 * p[0] + 0 * y[0]], n=4)
    time, _, fell = flow.advance(_numbers(0.0, 0.0, 0.0, 1.0), arb(5), order=3)
    assert fell
    assert abs(_mp(time) - 1) < 10 * TINY


def test_a_guard_that_falls_from_its_start_has_left() -> None:
    with pytest.raises(SimulationError, match="leaves the admissible set from its boundary"):
        _swing().advance(_numbers(0.0, -1.0), arb(10), order=1)


def test_a_guard_that_touches_zero_is_not_passed_over() -> None:
    # 1 + cos t touches zero at pi; rounding cannot tell whether it crosses.
    flow = _flow([lambda y, _: y[1], lambda y, p: p - y[0]], n=2)
    with pytest.raises(SimulationError, match="grazes zero"):
        flow.advance(_numbers(2.0, 0.0), arb(6))


def test_a_flow_that_blows_up_is_told() -> None:
    flow = _flow([lambda y, _: 0 * y[0], lambda y, _: ca.sqrt(y[1])], n=2)
    with pytest.raises(StepSizeError, match="not finite"):
        flow.advance(_numbers(1.0, -1.0), arb(2))


@pytest.mark.slow
def test_a_flow_that_blows_up_on_its_way_is_told() -> None:
    # y' = y^2 from 1 is infinite at 1.
    flow = _flow([lambda y, _: y[0] ** 2], n=1, digits=20)
    with pytest.raises(SimulationError, match="not finite"):
        flow.advance(_numbers(1.0), arb(2))


@pytest.mark.slow
def test_what_decays_fast_costs_few_more_steps_and_no_digits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # y1' = -k (y1 - cos t) - sin t from 3: y1 = cos t + 2 exp(-k t); the guard is cos t.
    steps: list[float] = []
    step = GaussFlow._step

    def counted(self: GaussFlow, *given: Any, **named: Any) -> Any:
        steps.append(1.0)
        return step(self, *given, **named)

    monkeypatch.setattr(GaussFlow, "_step", counted)
    counts: list[int] = []
    for k in (1e3, 1e6, 1e9):
        rate = [
            lambda y, _: y[1],
            lambda y, _: -y[0],
            lambda y, p: -p * (y[2] - y[0]) + y[1],
        ]
        flow = _flow(rate, n=3, parameters=(k,))
        flow._size = 1 / k
        steps.clear()
        time, (_, _, fast), fell = flow.advance(_numbers(1.0, 0.0, 3.0), arb(1.25))
        assert not fell
        assert abs(_mp(fast) - mp.cos(mp.mpf(1.25)) - 2 * mp.exp(-k * _mp(time))) < 100 * TINY
        counts.append(len(steps))
    # Steps may grow threefold, from the decay time to that of the cosine.
    assert counts[-1] - counts[0] <= math.log(1e6, 3.0) + 2


def test_an_operation_that_is_not_analytic_is_refused() -> None:
    with pytest.raises(TranslationError, match="one of them is `fabs`"):
        _flow([lambda y, _: -ca.fabs(y)], n=1)
