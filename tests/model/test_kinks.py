"""Formulas on a branch of their kinks are the formulas as CasADi evaluates them, call by call."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import casadi
import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.random_formulas import BINARY, JUMPS, UNARY, random_formula
from zeno_orbits.model.kinks import branched, sided
from zeno_orbits.model.operations import without_calls

ca: Any = casadi

X, P = ca.SX.sym("x", 3), ca.SX.sym("p")
LOGIC = {"not", "and", "or"}


def _checked_points(seed: int, n: int = 4) -> int:
    """Return the number of points at which the branches of a random formula are right."""
    random = np.random.default_rng(seed)
    without = JUMPS | LOGIC if seed % 4 else set[str]()
    size = int(random.integers(4, 14))
    formula, used = random_formula(random, [X[0], X[1], X[2], P], size, without=without)
    written = ca.Function("written", [X, P], [formula])
    expanded = without_calls(formula)
    try:
        conditions = branched([expanded], X).conditions
    except ValueError as error:
        refused = str(error)
        conditions = ()
    else:
        refused = ""
    if refused:
        assert used & (JUMPS | LOGIC) or "of a quotient" in refused
        return 0
    sides = ca.SX.sym("side", len(conditions))
    values, _ = sided([expanded], X, sides, ())
    guards = ca.Function("guards", [X, P, sides], [ca.vertcat(*values)])
    checked = 0
    for _ in range(n):
        x, p = random.normal(size=3), random.normal()
        taken = np.ones(len(conditions))
        zero_or_undefined = False
        for k in range(len(conditions)):
            value = float(guards(x, p, taken)[k])
            taken[k] = value > 0.0
            zero_or_undefined |= value == 0.0 or math.isnan(value)
        want = float(written(x, p))
        if zero_or_undefined or not math.isfinite(want):
            continue
        there = branched([expanded], X, tuple(bool(one) for one in taken))
        # The branch cut of an angle is moved, not removed.
        assert used & {"atan", "atan2"} or not branched(there.formulas, X).conditions
        got = float(ca.Function("there", [X, P], [there.formulas[0]])(x, p))
        assert got == pytest.approx(want, rel=1e-9, abs=1e-9), (seed, formula)
        checked += 1
    return checked


def test_a_branch_of_a_random_formula_is_the_formula() -> None:
    # About one point in three is outside of the domain of an operation.
    assert sum(_checked_points(seed) for seed in range(100)) > 150


@pytest.mark.slow
def test_a_branch_of_a_thousand_random_formulas_is_the_formula() -> None:
    assert sum(_checked_points(seed) for seed in range(100, 1100)) > 1500


@pytest.mark.parametrize("name", [*UNARY, *BINARY])
def test_each_operation_is_kept_or_refused_by_name(name: str) -> None:
    operation: Callable[..., Any] = (UNARY | BINARY)[name]
    inputs = [X[0], X[1]][: 1 if name in UNARY else 2]
    formula = operation(*inputs) + X[2]
    if name in JUMPS | LOGIC:
        with pytest.raises(ValueError, match="jumps without an event"):
            branched([formula], X)
        return
    written = ca.Function("written", [X], [formula])
    random = np.random.default_rng(1)
    n = 0
    for _ in range(40):
        x = random.uniform(-3.0, 3.0, 3)
        if not math.isfinite(float(written(x))):
            continue
        conditions = branched([formula], X).conditions
        sides = tuple(float(ca.Function("c", [X], [one])(x)) > 0 for one in conditions)
        there = branched([formula], X, sides).formulas[0]
        assert float(ca.Function("there", [X], [there])(x)) == pytest.approx(
            float(written(x)), rel=1e-12, abs=1e-14
        )
        n += 1
    assert n >= 5


@pytest.mark.parametrize(
    ("formula", "name"),
    [
        (lambda: ca.interpolant("spline", "bspline", [[0, 1, 2, 3]], [0, 1, 4, 2])(X[0]), "spline"),
        (lambda: ca.interpolant("area", "linear", [[0, 1], [0, 1]], [0, 1, 2, 3])(X[:2]), "area"),
        (lambda: _callback(X[0]), "doubled"),
    ],
)
def test_a_call_without_a_formula_is_refused_by_name(formula: Callable[[], Any], name: str) -> None:
    with pytest.raises(ValueError, match=f"calls the function `{name}`") as caught:
        without_calls(formula())
    assert "\n" not in str(caught.value)


class _Doubled(casadi.Callback):
    def __init__(self) -> None:
        casadi.Callback.__init__(self)
        self.construct("doubled", {})

    def eval(self, arg: Any) -> list[Any]:
        return [2 * arg[0]]


_CALLBACK: Any = _Doubled()


def _callback(x: Any) -> Any:
    return _CALLBACK(x)


@pytest.mark.parametrize("angle", np.linspace(-3.1, 3.1, 13).tolist())
@pytest.mark.parametrize("shift", [-0.2, 0.2])
def test_an_angle_goes_on_smoothly_beyond_both_borders_of_its_side(
    angle: float, shift: float
) -> None:
    formula = ca.atan2(X[0], X[1])
    x = np.array([math.sin(angle), math.cos(angle), 0.0])
    condition = float(ca.Function("c", [X], branched([formula], X).conditions)(x))
    there = branched([formula], X, (condition > 0.0,)).formulas[0]
    at = ca.Function("angle", [X], [there])
    assert float(at(x)) == pytest.approx(angle, abs=1e-15)
    # An unwrapped angle.
    beyond = [math.sin(angle + shift), math.cos(angle + shift), 0.0]
    assert float(at(beyond)) == pytest.approx(angle + shift, abs=1e-14)


def test_a_kink_that_lies_on_a_stop_is_no_kink() -> None:
    q, v, d = (ca.SX.sym(name) for name in ("q", "v", "d"))

    def machine(bumper: Any) -> Any:
        mass = zo.HybridLagrangian.from_energies(
            q=q, v=v, kinetic=v**2 / 2, potential=9.81 * q, gap=d - q, passive_force=bumper
        )
        return zo.hybrid_system(mass, zo.no_drive(mass), 0.5)

    assert machine(-ca.fmax(q - d, 0)).graph is None
    assert machine(-ca.fmax(3 * (q - d), 0)).graph is None
    assert len(machine(-ca.fmax(q - 0.9 * d, 0)).graph.conditions) == 1
