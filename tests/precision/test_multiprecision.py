"""Flows and functions in many digits, against functions that mpmath knows to all of them."""

from decimal import Decimal, localcontext

import casadi as ca
import mpmath as mp
import pytest

from zeno_orbits.errors import SimulationError, StepSizeError
from zeno_orbits.precision.multiprecision import Arithmetic, Formula, Real, decimal, flow_of

pytest.importorskip("heyoka", reason="needs the extra `taylor`")

ARITHMETIC = Arithmetic(digits=40)


def _mp(value: Real) -> mp.mpf:
    return mp.mpf(str(value))


def _swing(rate: float = 1.0) -> ca.Function:
    """Return `y0'' = -rate^2 y0` as a flow of `(y, p)`."""
    y, p = ca.SX.sym("y", 2), ca.SX.sym("p")
    return ca.Function("swing", [y, p], [ca.vertcat(y[1], -p * p * y[0]) * rate])


def test_a_double_is_taken_exactly_and_a_decimal_to_all_digits() -> None:
    with localcontext() as context:
        context.prec = 60
        tenth = decimal(Arithmetic(digits=60).number(0.1))
        assert abs(tenth - Decimal.from_float(0.1)) < Decimal("1e-60")
        third = Decimal(1) / 3
        assert abs(decimal(ARITHMETIC.number(third)) - third) < Decimal("1e-40")


def test_a_formula_holds_all_digits() -> None:
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p", 2)
    function = ca.Function("f", [x, p], [ca.sin(x[0]) * p[0] + 0.1, ca.vertcat(x[1], 0)])
    formula = Formula(ARITHMETIC, function, (0.3, 7.0))
    (value,), (second, nothing) = formula(ARITHMETIC.numbers([0.7, 0.2]))
    with mp.workdps(45):
        wanted = mp.sin(mp.mpf(0.7)) * mp.mpf(0.3) + mp.mpf(0.1)
        assert abs(_mp(value) - wanted) < mp.mpf(10) ** -40
        assert (float(second), float(nothing)) == (0.2, 0.0)


def test_a_formula_without_outputs_has_none() -> None:
    x, p = ca.SX.sym("x"), ca.SX.sym("p")
    assert Formula(ARITHMETIC, ca.Function("f", [x, p], [ca.SX(0, 1)]), (1.0,))([1.0]) == [[]]


def test_a_flow_holds_all_digits_and_its_guard_falls_where_the_cosine_does() -> None:
    flow = flow_of(ARITHMETIC, _swing(), (1.0,))
    start = ARITHMETIC.numbers([1.0, 0.0])
    for step in flow.steps(start, ARITHMETIC.number(10.0)):
        root = step.fall(0, 0)
        if root is not None:
            with mp.workdps(45):
                off = _mp(step.start + root) - mp.pi / 2
                assert abs(off) < 10 * mp.mpf(10) ** -40
                assert abs(_mp(step.state(root)[1]) + 1) < 10 * mp.mpf(10) ** -40
            return
    pytest.fail("no root")


def test_a_root_at_the_start_does_not_count() -> None:
    flow = flow_of(ARITHMETIC, _swing(), (1.0,))
    order = 1
    for step in flow.steps(ARITHMETIC.numbers([0.0, 1.0]), ARITHMETIC.number(10.0)):
        root = step.fall(0, order)
        order = 0
        if root is not None:
            with mp.workdps(45):
                assert abs(_mp(step.start + root) - mp.pi) < 10 * mp.mpf(10) ** -40
            return
    pytest.fail("no root")


def test_a_guard_that_falls_from_its_start_has_left() -> None:
    flow = flow_of(ARITHMETIC, _swing(), (1.0,))
    step = next(flow.steps(ARITHMETIC.numbers([0.0, -1.0]), ARITHMETIC.number(10.0)))
    with pytest.raises(SimulationError, match="leaves the admissible set from its boundary"):
        step.fall(0, 1)


def test_a_guard_that_touches_zero_is_not_passed_over() -> None:
    # 1 + cos t touches zero at pi; rounding cannot tell whether it crosses.
    y, p = ca.SX.sym("y", 2), ca.SX.sym("p")
    flow = flow_of(ARITHMETIC, ca.Function("f", [y, p], [ca.vertcat(y[1], p - y[0])]), (1.0,))
    steps = flow.steps(ARITHMETIC.numbers([2.0, 0.0]), ARITHMETIC.number(6.0))
    with pytest.raises(SimulationError, match="grazes zero"):
        [step.fall(0, 0) for step in steps]


def test_a_parameter_can_be_changed_between_two_runs() -> None:
    flow = flow_of(ARITHMETIC, _swing(), (1.0,))
    flow.set_parameter(0, ARITHMETIC.number(2.0))
    *_, last = flow.steps(ARITHMETIC.numbers([1.0, 0.0]), ARITHMETIC.number(1.0))
    with mp.workdps(45):
        assert abs(_mp(last.state(last.size)[0]) - mp.cos(2)) < 20 * mp.mpf(10) ** -40


def test_a_flow_that_blows_up_is_told() -> None:
    y, p = ca.SX.sym("y"), ca.SX.sym("p")
    flow = flow_of(ARITHMETIC, ca.Function("f", [y, p], [ca.sqrt(y)]), (1.0,))
    with pytest.raises(StepSizeError, match="not finite"):
        list(flow.steps(ARITHMETIC.numbers([-1.0]), ARITHMETIC.number(2.0)))
