"""Bounds that the library takes in numbers are those of the formulas in intervals."""

from __future__ import annotations

import ctypes
import math

import casadi as ca
import numpy as np
import pytest

from tests.loop.agreement import needs_compiler
from tests.support.watched import FORMULAS, watched
from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import guard_bounds
from zeno_orbits.loop import Tape, TapedProblem, binding, loop_library, tape_of

pytestmark = needs_compiler


class _Bounded:
    """A formula in the place of the guard that is watched, off the stop."""

    def __init__(self, function: ca.Function) -> None:
        tapes = [Tape.empty()] * binding.TAPES
        tapes[binding.WATCHED] = tape_of(function)
        n_y, n_p = function.size1_in(0), function.size1_in(1)
        self._problem = TapedProblem(loop_library(), tapes, (), n_y, 0, n_p)
        self._memory, self._settings = self._problem.borrowed(), binding.SettingsType()

    def over(self, box: Vector, p: Vector) -> Vector:
        library, problem = self._problem.library, self._problem.address
        run, found = ctypes.addressof(self._memory), np.full(6, math.nan)
        settings = ctypes.addressof(self._settings)
        library.zl_begin(problem, run, settings, p.ctypes.data, box.ctypes.data)
        library.zl_evaluate(problem, run, binding.WATCHED, box.ctypes.data, found.ctypes.data)
        return found


@pytest.mark.parametrize("name", FORMULAS)
def test_bounds_are_those_of_the_formula(name: str) -> None:
    function = watched(name)
    expected, found = guard_bounds(function), _Bounded(function)
    rng = np.random.default_rng(8)
    for _ in range(200):
        p, low = rng.uniform(0.2, 1.5, 1), rng.uniform(-5, 4, 2)
        # Ends of domains, points, and boxes around the places where formulas have corners.
        high = low + rng.choice([0.0, 1e-9, 1e-3, 1.0, 9.0]) * rng.random(2)
        box = np.concatenate([low, high])
        box[:2] -= rng.choice([0.0, 1.0]) * np.remainder(box[:2], 1.0)
        bounds = np.array(expected(box, p)).ravel()
        np.testing.assert_allclose(found.over(box, p), bounds, rtol=1e-14, atol=1e-14)
