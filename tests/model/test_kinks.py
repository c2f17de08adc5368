"""Formulas on a branch of their kinks are the formulas as CasADi evaluates them, call by call."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi
import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.mechanisms import machine_of
from tests.support.random_formulas import BINARY, JUMPS, UNARY, random_formula
from zeno_orbits.model.expressions.kinks import branched, sided
from zeno_orbits.model.expressions.operations import without_calls

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
        # The branch cut of an angle is moved, not removed. A root has both signs beyond its base.
        moved = used & {"atan", "atan2"} or there.roots
        assert moved or not branched(there.formulas, X).conditions
        got = float(ca.Function("there", [X, P], [there.formulas[0]])(x, p))
        assert got == pytest.approx(want, rel=1e-9, abs=1e-9), (seed, formula)
        checked += 1
    return checked


@pytest.mark.slow
def test_a_branch_of_a_random_formula_is_the_formula() -> None:
    # About one point in three is outside of the domain of an operation.
    assert sum(_checked_points(seed) for seed in range(40)) > 60


@pytest.mark.slow
def test_a_branch_of_a_thousand_random_formulas_is_the_formula() -> None:
    assert sum(_checked_points(seed) for seed in range(40, 1100)) > 1590


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
        (lambda: ca.interpolant("solid", "linear", [[0, 1]] * 3, [0.0] * 8)(X[:3]), "solid"),
        (lambda: _callback(X[0]), "doubled"),
    ],
)
def test_a_call_without_a_formula_is_refused_by_name(formula: Callable[[], Any], name: str) -> None:
    with pytest.raises(ValueError, match=f"calls the (function|table) `{name}`") as caught:
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

    assert not machine(-ca.fmax(q - d, 0)).graph.reason
    assert not machine(-ca.fmax(3 * (q - d), 0)).graph.reason
    assert len(machine(-ca.fmax(q - 0.9 * d, 0)).graph.conditions) == 1
    # Beside a narrow bump the condition is the gap, to the last digit.
    for bump in (ca.exp(-((v / 0.09) ** 2)), 1 - ca.tanh(v / 0.01) ** 2, 1 / ca.cosh(q / 0.001)):
        assert len(machine(ca.fmax(0.1 * bump - (d - q), 0)).graph.conditions) == 1
    with pytest.raises(ValueError, match="jumps where the gap of a stop is zero"):
        machine(ca.if_else(q < d, 0.0, 40.0))


ROOTS: dict[str, tuple[Callable[[Any], Any], int]] = {
    "of a multiple": (lambda x: ca.sqrt(3 * x[0] ** 2), 1),
    "of a parameter times a square": (lambda x: ca.sqrt(ca.exp(P) * x[0] ** 2), 1),
    "of a product": (lambda x: ca.sqrt(4 * x[0] * x[0] * (1 + x[1] ** 2)), 1),
    "of a quotient": (lambda x: ca.sqrt(x[0] ** 2 / (1 + x[1] ** 2)), 1),
    "of a sum": (lambda x: ca.sqrt(2 * x[0] ** 2 + x[0] ** 2 / 3), 1),
    "of two squares": (lambda x: ca.sqrt(2 * x[0] ** 2 * x[1] ** 2), 1),
    "of a power": (lambda x: ca.sqrt(2 * x[0] ** 6), 1),
    "power 1.5": (lambda x: (2 * x[0] ** 2) ** 1.5, 1),
    "of a fourth power": (lambda x: ca.sqrt(2 * x[0] ** 4), 0),
    "of another length": (lambda x: ca.sqrt(x[0] ** 2 + 2 * x[1] ** 2), 0),
    "without a zero": (lambda x: ca.sqrt(x[0] ** 2 + 1), 0),
}


@pytest.mark.parametrize("name", ROOTS)
def test_a_root_of_a_square_is_a_kink(name: str) -> None:
    formula, n = ROOTS[name]
    written = formula(X)
    conditions = branched([written], X).conditions
    assert len(conditions) == n
    original = ca.Function("original", [X, P], [written])
    guards = [ca.Function("guard", [X, P], [one]) for one in conditions]
    for x in np.random.default_rng(0).normal(size=(20, 3)):
        sides = tuple(bool(guard(x, 0.3) > 0) for guard in guards)
        smooth = branched([written], X, sides).formulas[0]
        there = ca.Function("there", [X, P], [smooth, ca.jacobian(smooth, X)])
        assert float(there(x, 0.3)[0]) == pytest.approx(float(original(x, 0.3)), rel=1e-13)
        # Beyond the zero of its base, the branch goes on with its sign.
        turned = np.array([-x[0], x[1], x[2]])
        expected = (-1) ** n * float(original(x, 0.3))
        assert float(there(turned, 0.3)[0]) == pytest.approx(expected, rel=1e-13)


def _driven(force: Callable[[Any, Any], Any], start: dict[str, float]) -> zo.Problem:
    def model(p: Any) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        mass = zo.HybridLagrangian.from_energies(
            q=q, v=v, kinetic=v**2 / 2, potential=0 * q, passive_force=force(q, v), gap=q
        )
        return zo.hybrid_system(mass, zo.no_drive(mass), p["restitution"])

    problem = machine_of(model, {"q": "m", "v": "m/s"}, {"restitution": 0.5})
    return replace(problem, starts=(start,))


DRAGS: dict[str, Callable[[Any], Any]] = {
    "root of a multiple": lambda v: ca.sqrt(0.04 * v**2) * v,
    "root of a product": lambda v: ca.sqrt(v * 0.04 * v) * v,
}


@pytest.mark.parametrize("name", DRAGS)
def test_drag_by_a_root_of_a_square_moves_in_closed_form(name: str) -> None:
    # Rising: v' = -g - k v^2, v = c tan(a - b t), c = sqrt(g/k), b = sqrt(g k). Falling: -c tanh.
    g, k, up = 9.81, 0.2, 6.0
    c, b = math.sqrt(g / k), math.sqrt(g * k)
    top = math.atan(up / c) / b
    height = 1.0 + math.log(1 + up**2 / c**2) / (2 * k)
    fall = math.acosh(math.exp(k * height)) / b
    run = zo.simulate(
        _driven(lambda _, v: -g - DRAGS[name](v), {"q": 1.0, "v": up}), until=top + fall + 0.1
    )
    assert run.impacts[0].time == pytest.approx(top + fall, abs=1e-11)
    assert run.impacts[0].approach_rate == pytest.approx(-c * math.tanh(b * fall), abs=1e-10)
    assert run.switches[0].time == pytest.approx(top, abs=1e-11)


POLES: dict[str, Callable[[Any, Any], Any]] = {
    "fmin": lambda q, _v: ca.fmin(1, 1 / (q - 3)),
    "nested": lambda _q, v: ca.fmax(-1, ca.fmin(1, 1 / v)),
    "comparison": lambda q, _v: ca.if_else(1 / (q - 3) > 0, 1, 2),
    "sign": lambda _q, v: ca.sign(1 / v),
    "tangent": lambda _q, v: ca.fmin(1, ca.tan(v)),
    "odd power": lambda _q, v: ca.fmin(1, v ** (-3)),
    "a product": lambda q, v: ca.fmin(1, q / (v * (1 + q**2))),
}


@pytest.mark.parametrize("name", POLES)
def test_a_condition_that_jumps_at_a_pole_is_refused_when_the_problem_is_loaded(name: str) -> None:
    with pytest.raises(ValueError, match="of a quotient, which jumps where a denominator"):
        _driven(POLES[name], {"q": 1.0}).checked()


WITHOUT_A_JUMP: dict[str, Callable[[Any, Any], Any]] = {
    "above the stop": lambda q, _v: ca.fmin(1, 1 / (q + 0.3)),
    "a power above the stop": lambda q, _v: ca.fmin(1, 1 / (2 * q + 0.3) ** 3),
    "even": lambda q, _v: ca.fmin(1, 1 / (q - 0.3) ** 2),
    "positive in its form": lambda _q, v: ca.fmin(1, v / (1 + ca.fabs(v))),
    "of a parameter": lambda _q, v: ca.fmin(1, v / 0.2),
}


@pytest.mark.parametrize("name", WITHOUT_A_JUMP)
def test_a_quotient_without_a_jump_is_kept(name: str) -> None:
    _driven(WITHOUT_A_JUMP[name], {"q": 1.0}).checked()


@pytest.mark.parametrize(
    ("quotient", "is_refused"),
    [
        (lambda q, a: 1 / (q + a), False),
        (lambda q, a: 1 / (a**2 * q + a / (1 + a)), False),
        (lambda q, a: 1 / (q + (0.3 + a) - 0.3), False),
        # Positive at the default a = 0.5 and at most others, but a pole at a < 0.4.
        (lambda q, a: 1 / (q + a - 0.4), True),
        (lambda q, a: 1 / ((a - 0.4) * q + 1), True),
        (lambda q, a: 1 / (q + a + q**2 - 3), True),
    ],
)
def test_a_denominator_above_the_gap_is_decided_by_its_form(
    quotient: Callable[[Any, Any], Any], *, is_refused: bool
) -> None:
    def model(p: Any) -> zo.CompletedSystem:
        q, v = ca.SX.sym("q"), ca.SX.sym("v")
        force = -ca.fmin(1, quotient(q, p["a"]))
        mass = zo.HybridLagrangian.from_energies(
            q=q, v=v, kinetic=v**2 / 2, potential=0 * q, passive_force=force, gap=q
        )
        return zo.hybrid_system(mass, zo.no_drive(mass), p["restitution"])

    machine = machine_of(model, {"q": "m", "v": "m/s"}, {"restitution": 0.5, "a": 0.5})
    machine = replace(machine, starts=({"q": 1.0},))
    if not is_refused:
        machine.checked()
        return
    with pytest.raises(ValueError, match="of a quotient, which jumps where a denominator"):
        machine.checked()
