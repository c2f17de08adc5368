"""Steps in balls hold the motions, stiff or not, and rounding goes outward."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from flint import arb, ctx

from zeno_orbits.proof.arithmetic.balls import matrix
from zeno_orbits.proof.integration.flow import BallFlow, enclose
from zeno_orbits.proof.integration.sets import start_set


def _linear(rate: float) -> BallFlow:
    x, p = ca.SX.sym("x"), ca.SX.sym("p")
    return BallFlow(x, p, p * x, None, [arb(rate)])


@pytest.mark.parametrize("rate", [1.0, -1.0, -3000.0])
@pytest.mark.parametrize("size", [2.0**-10, 2.0**-11])
def test_a_step_holds_the_exponential_and_its_derivative(rate: float, size: float) -> None:
    with ctx.workprec(96):
        flow = _linear(rate)
        box = [arb(2, 1e-6)]
        step = enclose(flow, flow.series(box, 28), arb(size), (34, 28))
        assert step is not None
        with ctx.workprec(256):
            grown = (arb(rate) * size).exp()
        point = step.point(flow.point_series([arb(2)], 34), arb(size))[0]
        assert point.overlaps(2 * grown)
        assert abs(point - 2 * grown) < 1e-12
        assert step.derivative(arb(size))[0, 0].contains(grown)
        assert all(step.box[0].contains(2 * (arb(rate) * size * k / 8).exp()) for k in range(9))


def test_a_step_that_is_too_long_has_no_box() -> None:
    x = ca.SX.sym("x")
    flow = BallFlow(x, ca.SX(0, 1), x**2, None, [])
    with ctx.workprec(96):
        series = flow.series([arb(1)], 20)
        # The motion 1 / (1 - t) leaves every box by t = 1.
        assert enclose(flow, series, arb(2), (20, 20)) is None
        assert enclose(flow, series, arb(0.25), (20, 20)) is not None


def test_halving_a_step_tightens_what_is_handed_on() -> None:
    x = ca.SX.sym("x", 2)
    flow = BallFlow(x, ca.SX(0, 1), ca.vertcat(x[1], -ca.sin(x[0])), None, [])
    widths = []
    with ctx.workprec(96):
        for halvings in (0, 1, 2):
            size = arb(0.5) / 2**halvings
            at = start_set([arb(1), arb(0)], matrix([[1, 0], [0, 1]], 2), [arb(0, 1e-9)] * 2, ())
            for _ in range(2**halvings):
                step = enclose(flow, flow.series(at.box, 10), size, (12, 10))
                assert step is not None
                image = step.point(flow.point_series(at.m, 12), size)
                at = at.mapped(image, step.derivative(size), [0, 1], np.ones(2))
            widths.append(max(one.rad() for one in at.derivative.entries()))
    assert widths[2] < widths[1] < widths[0]
