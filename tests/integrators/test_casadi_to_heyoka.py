"""CasADi functions as heyoka expressions: the same numbers, and a refusal by name for the rest."""

import importlib
from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

from zeno_orbits.errors import InputError, TranslationError
from zeno_orbits.integrators.taylor.casadi_to_heyoka import (
    _SPELLED,
    _operations,
    load_heyoka,
    translate,
)
from zeno_orbits.model.library import load_problem

heyoka = pytest.importorskip("heyoka", reason="needs the extra `taylor`")

ROUNDING = 2.0**-52

UNARY: dict[str, Callable[[ca.SX], ca.SX]] = {
    "neg": lambda x: -x,
    "twice": lambda x: 2 * x,
    "sq": lambda x: x**2,
    "inv": lambda x: 1 / x,
    "sqrt": ca.sqrt,
    "exp": ca.exp,
    "expm1": ca.expm1,
    "log": ca.log,
    "log1p": ca.log1p,
    "sin": ca.sin,
    "cos": ca.cos,
    "tan": ca.tan,
    "asin": ca.asin,
    "acos": ca.acos,
    "atan": ca.atan,
    "sinh": ca.sinh,
    "cosh": ca.cosh,
    "tanh": ca.tanh,
    "asinh": ca.asinh,
    "acosh": lambda x: ca.acosh(1 + x),
    "atanh": ca.atanh,
    "erf": ca.erf,
    "cube": lambda x: x**3,
    "odd power": lambda x: x**2.7,
    "negative power": lambda x: x**-1.5,
    "constant": lambda x: x * 0 + 0.1,
}
BINARY: dict[str, Callable[[ca.SX, ca.SX], ca.SX]] = {
    "add": lambda x, y: x + y,
    "sub": lambda x, y: x - y,
    "mul": lambda x, y: x * y,
    "div": lambda x, y: x / y,
    "pow": lambda x, y: x**y,
    "atan2": ca.atan2,
    "hypot": ca.hypot,
    "lift": lambda x, y: ca.SX.binary(ca.OP_LIFT, x, y),
}
REFUSED: dict[str, Callable[[ca.SX, ca.SX], ca.SX]] = {
    "fabs": lambda x, _: ca.fabs(x),
    "sign": lambda x, _: ca.sign(x),
    "floor": lambda x, _: ca.floor(x),
    "ceil": lambda x, _: ca.ceil(x),
    "fmin": ca.fmin,
    "fmax": ca.fmax,
    "fmod": ca.fmod,
    "remainder": ca.remainder,
    "copysign": ca.copysign,
    "<": lambda x, y: x < y,
    "<=": lambda x, y: x <= y,
    "==": lambda x, y: x == y,
    "!=": lambda x, y: x != y,
    "and": ca.logic_and,
    "or": ca.logic_or,
    "not": lambda x, _: ca.logic_not(x),
    "if_else": lambda x, y: ca.SX.binary(ca.OP_IF_ELSE_ZERO, x, y),
}


def _function(*outputs: ca.SX, inputs: list[ca.SX]) -> ca.Function:
    return ca.Function("f", inputs, list(outputs))


def _evaluator(function: ca.Function) -> Callable[..., np.ndarray]:
    """Return all outputs as a function of numbers, by way of heyoka's expressions."""
    arguments = [
        [heyoka.expression(f"x{k}_{j}") for j in range(function.numel_in(k))]
        for k in range(function.n_in())
    ]
    names = [symbol for argument in arguments for symbol in argument]
    compiled = heyoka.cfunc(translate(function, arguments), vars=names)
    return lambda *points: compiled(np.concatenate(points))


def _values(function: ca.Function, *points: np.ndarray) -> np.ndarray:
    """Return all outputs at numbers, by way of heyoka's expressions."""
    return _evaluator(function)(*points)


def _own(function: ca.Function, *points: np.ndarray) -> np.ndarray:
    """Return all outputs at numbers, by CasADi itself."""
    outputs = function.call([ca.DM(point) for point in points])
    return np.concatenate([np.array(output.full()).ravel(order="F") for output in outputs])


@pytest.mark.parametrize("name", UNARY)
def test_an_operation_of_one_number_has_casadis_value(name: str) -> None:
    x = ca.SX.sym("x")
    function = _function(UNARY[name](x), inputs=[x])
    values = _evaluator(function)
    for value in np.random.default_rng(1).uniform(0.05, 0.95, 5):
        point = np.array([value])
        assert values(point) == pytest.approx(_own(function, point), rel=8 * ROUNDING)


@pytest.mark.parametrize("name", BINARY)
def test_an_operation_of_two_numbers_has_casadis_value(name: str) -> None:
    x = ca.SX.sym("x", 2)
    function = _function(BINARY[name](x[0], x[1]), inputs=[x])
    values = _evaluator(function)
    for point in np.random.default_rng(2).uniform(0.05, 0.95, (5, 2)):
        assert values(point) == pytest.approx(_own(function, point), rel=8 * ROUNDING)


@pytest.mark.parametrize("name", REFUSED)
def test_an_operation_that_is_not_analytic_is_refused_by_name(name: str) -> None:
    x = ca.SX.sym("x", 2)
    function = _function(x[0] + REFUSED[name](x[0], x[1]), inputs=[x])
    with pytest.raises(TranslationError, match=r"^Argument `system` must .*not analytic\.$") as hit:
        _values(function, np.array([0.3, 0.4]))
    assert hit.value.operation == name
    assert f"it uses `{name}`" in str(hit.value)


def test_a_choice_between_two_formulas_is_refused() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(TranslationError, match="`<`, which is not analytic"):
        _values(_function(ca.if_else(x > 0, x, x**2), inputs=[x]), np.array([0.3]))


def test_what_heyoka_does_not_know_is_refused_for_that_reason() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(TranslationError, match="`erfinv`, which heyoka does not have"):
        _values(_function(ca.erfinv(x), inputs=[x]), np.array([0.3]))
    loose = ca.Function("f", [x], [x * ca.SX.sym("k")], {"allow_free": True})
    with pytest.raises(TranslationError, match="`parameter`, a symbol that is no input"):
        _values(loose, np.array([0.3]))


def test_no_operation_of_casadi_is_forgotten() -> None:
    # Up to OP_CONST CasADi numbers the operations on numbers without a gap; a few came later.
    names = {getattr(ca, name): name[3:].lower() for name in dir(ca) if name.startswith("OP_")}
    later = (ca.OP_ERFINV, ca.OP_LIFT, ca.OP_LOG1P, ca.OP_EXPM1, ca.OP_HYPOT, ca.OP_REMAINDER)
    for code in (*range(ca.OP_CONST), *later):
        spelled = _SPELLED.get(names[code], names[code])
        assert (code in _operations(heyoka)) != (spelled in {*REFUSED, "erfinv"}), spelled
        assert spelled in {*UNARY, *BINARY, *REFUSED, "erfinv", "assign", "constpow"}, spelled


def test_matrices_are_read_and_written_column_by_column_with_their_zeros() -> None:
    x = ca.SX.sym("x", ca.Sparsity.lower(2))
    y = ca.SX.sym("y", 2)
    outputs = (ca.diag(y), x @ y, ca.SX(1, 2), x.T)
    function = ca.Function("f", [x, y], outputs)
    points = np.array([1.5, 2.5, 0.0, 3.5]), np.array([0.3, 0.7])
    own = np.concatenate(
        [
            np.array([0.3, 0.0, 0.0, 0.7]),
            np.array([1.5 * 0.3, 2.5 * 0.3 + 3.5 * 0.7]),
            np.zeros(2),
            np.array([1.5, 0.0, 2.5, 3.5]),
        ]
    )
    assert _values(function, *points) == pytest.approx(own, rel=4 * ROUNDING)


def test_a_function_of_matrices_is_expanded_first() -> None:
    x = ca.MX.sym("x", 2)
    function = ca.Function("f", [x], [ca.solve(ca.diag(1 + x), ca.sin(x))])
    point = np.array([0.3, 0.8])
    assert _values(function, point) == pytest.approx(np.sin(point) / (1 + point), rel=8 * ROUNDING)


def test_a_table_is_refused() -> None:
    x = ca.MX.sym("x")
    table = ca.interpolant("table", "linear", [[0.0, 1.0, 2.0]], [0.0, 1.0, 4.0])
    with pytest.raises(TranslationError, match="`call`, a function that CasADi keeps closed"):
        _values(ca.Function("f", [x], [table(x)]), np.array([0.3]))


def test_arguments_that_do_not_fit_are_refused() -> None:
    x = ca.SX.sym("x", 2)
    with pytest.raises(InputError, match=r"must have \[2\] entries, but it has \[1\]"):
        translate(_function(x, inputs=[x]), [[heyoka.expression("a")]])


def test_a_power_of_two_variables_has_the_series_of_exp_and_log() -> None:
    # x' = x^y with y' = 0 and y = 2: x = 1 / (1/x0 - t).
    x = ca.SX.sym("x", 2)
    names = list(heyoka.make_vars("x", "y"))
    rates = translate(_function(ca.vertcat(x[0] ** x[1], 0), inputs=[x]), [names])
    taylor = heyoka.taylor_adaptive(list(zip(names, rates, strict=True)), [0.5, 2.0])
    taylor.propagate_until(1.0)
    assert taylor.state[0] == pytest.approx(1.0, rel=10 * ROUNDING)


@pytest.mark.parametrize("mode", ["free", "locked", "flight"])
@pytest.mark.parametrize("part", ["rate", "guard"])
def test_the_pendulum_moves_by_the_same_numbers(mode: str, part: str) -> None:
    problem = load_problem("motor_pendulum")
    function = getattr(getattr(problem.compiled(), mode), part)
    parameters = np.array(problem.values().vector)
    if mode == "flight":
        parameters = np.append(parameters, 0.37)
    values = _evaluator(function)
    random = np.random.default_rng(3)
    for _ in range(20):
        state = random.uniform(-3, 3, function.numel_in(0))
        own = _own(function, state, parameters)
        # Terms of both signs cancel: the error is that of the largest of them.
        bound = 1e-14 * max(1.0, float(np.max(np.abs(own))))
        assert values(state, parameters) == pytest.approx(own, rel=1e-14, abs=bound)


@pytest.mark.parametrize("name", ["contact", "impulse", "energy"])
def test_what_an_impact_needs_has_the_same_numbers(name: str) -> None:
    problem = load_problem("motor_pendulum")
    function = getattr(problem.compiled(), name)
    parameters = np.array(problem.values().vector)
    state = np.array([0.4, 0.2, -1.0, 2.0, 0.5])
    own = _own(function, state, parameters)
    bound = 1e-14 * float(np.max(np.abs(own)))
    assert _values(function, state, parameters) == pytest.approx(own, rel=1e-14, abs=bound)


def test_without_heyoka_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ModuleNotFoundError(f"No module named {name!r}")

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(InputError, match=r"pip install 'zeno_orbits\[taylor\]'") as refusal:
        load_heyoka()
    assert "\n" not in str(refusal.value)
