"""Bounds of a guard over a box hold every value in it, and shrink with the box."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from tests.support.cases import fast
from tests.support.watched import FORMULAS, watched
from zeno_orbits.integrators import guard_bounds, has_bounds

ROUNDING = 1e-12
"""What bounds may miss, as part of their size: they are not rounded outwards."""


@pytest.mark.parametrize("name", fast(6, FORMULAS))
def test_bounds_hold_every_value_in_a_box(name: str) -> None:
    function = watched(name)
    bounds = guard_bounds(function)
    rng = np.random.default_rng(3)
    for _ in range(100):
        low, number = rng.uniform(-2, 2, 2), rng.uniform(0.2, 1.5)
        high = low + 10.0 ** rng.uniform(-3, 0) * rng.random(2)
        found = np.array(bounds(np.concatenate([low, high]), number)).ravel()
        states = low + (high - low) * rng.random((40, 2))
        states[:4] = [low, high, (low[0], high[1]), (high[0], low[1])]
        values = np.array([np.array(function(state, number)).ravel() for state in states])
        slack = ROUNDING * (1 + np.abs(values).max(axis=0))
        assert np.all(found[[0, 2]] <= values.min(axis=0) + slack)
        assert np.all(found[[1, 3]] >= values.max(axis=0) - slack)


def test_bounds_of_a_small_box_are_as_narrow_as_the_guard_varies() -> None:
    y, p = ca.SX.sym("y", 2), ca.SX.sym("p")
    value = ca.sin(y[0]) * y[1] / (2 + ca.cos(y[0])) - p
    bounds = guard_bounds(ca.Function("watched", [y, p], [ca.vertcat(value, y[0])]))
    for width in (1e-2, 1e-4, 1e-6):
        low = np.array([0.3, 0.7])
        found = np.array(bounds(np.concatenate([low, low + width]), 1.0)).ravel()
        # Its slopes there are 0.25 and 0.1, and intervals overestimate them by a few times.
        assert 0.3 * width < found[1] - found[0] < 1.5 * width


def test_a_quotient_by_an_interval_around_zero_is_not_bounded() -> None:
    y, p = ca.SX.sym("y"), ca.SX.sym("p")
    bounds = guard_bounds(ca.Function("watched", [y, p], [ca.vertcat(1 / y + p, y)]))
    low, high, *_ = np.array(bounds([-0.1, 0.2], 0.0)).ravel()
    assert low <= -1e300
    assert high >= 1e300


def test_a_formula_with_an_operation_that_has_no_bounds_has_none() -> None:
    y, p = ca.SX.sym("y"), ca.SX.sym("p")
    assert not has_bounds(ca.Function("watched", [y, p], [ca.vertcat(ca.fmod(y, p), y)]))
