"""CasADi functions as heyoka expressions: the formulas of a model for Taylor's method.

heyoka is the optional extra `taylor`; it is imported when it is first needed, and nowhere else.
"""

from __future__ import annotations

import importlib
import operator
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from typing import Any

import casadi as ca

from zeno_orbits.errors import InputError, TranslationError

_SPELLED = {"lt": "<", "le": "<=", "eq": "==", "ne": "!=", "if_else_zero": "if_else"}
"""Operations as a user writes them, where CasADi's own name is another."""

_OTHER_REASONS = {
    "erfinv": "which heyoka does not have",
    "printme": "which heyoka does not have",
    "call": "a function that CasADi keeps closed, such as a table or an integrator",
    "parameter": "a symbol that is no input of it",
}
"""Why an operation is refused, if not for its smoothness."""


def heyoka_is_installed() -> bool:
    """Return True if heyoka is installed; it is not loaded."""
    return find_spec("heyoka") is not None


def load_heyoka() -> Any:
    """Return the module heyoka.

    Raises:
        InputError: If it is not installed.
    """
    try:
        return importlib.import_module("heyoka")
    except ImportError as error:
        message = "Taylor's method needs heyoka: run `pip install 'zeno_orbits[taylor]'`"
        raise InputError(f"{message} ({error}).") from error


def translate(function: ca.Function, arguments: Sequence[Sequence[Any]]) -> list[Any]:
    """Return the outputs of a CasADi function as heyoka expressions of its inputs.

    Operation by operation, so a value shared by two outputs is one node in both. A power with an
    exponent that depends on the variables is ``exp(y log x)``, and so asks for a positive base.

    Args:
        function: The function; of type MX it is expanded first.
        arguments: For every input its entries, column by column, zeros of its sparsity included.

    Returns:
        The entries of all outputs, one output after the other, column by column, dense.

    Raises:
        InputError: If heyoka is missing or the arguments do not fit the inputs.
        TranslationError: If an operation has no translation, above all one that is not analytic.
    """
    heyoka = load_heyoka()
    if not function.is_a("SXFunction"):
        function = function.expand()
    inputs = _entries(function, arguments)
    outputs = [[heyoka.expression(0.0)] * function.numel_out(k) for k in _outs(function)]
    places = [_places(function.sparsity_out(k)) for k in _outs(function)]
    table = _operations(heyoka)
    work: dict[int, Any] = {}
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        takes, gives = function.instruction_input(k), function.instruction_output(k)
        if code == ca.OP_INPUT:
            work[gives[0]] = inputs[takes[0]][takes[1]]
        elif code == ca.OP_OUTPUT:
            outputs[gives[0]][places[gives[0]][gives[1]]] = work[takes[0]]
        elif code == ca.OP_CONST:
            work[gives[0]] = heyoka.expression(function.instruction_constant(k))
        elif code in table:
            work[gives[0]] = table[code](*(work[place] for place in takes))
        else:
            raise _refusal(code)
    return [entry for output in outputs for entry in output]


def _entries(function: ca.Function, arguments: Sequence[Sequence[Any]]) -> list[list[Any]]:
    """Return the arguments at the stored entries of every input."""
    given = [len(argument) for argument in arguments]
    wanted = [function.numel_in(k) for k in range(function.n_in())]
    if given != wanted:
        raise InputError(f"Argument `arguments` must have {wanted} entries, but it has {given}.")
    return [
        [argument[place] for place in _places(function.sparsity_in(k))]
        for k, argument in enumerate(arguments)
    ]


def _outs(function: ca.Function) -> range:
    return range(function.n_out())


def _places(sparsity: ca.Sparsity) -> list[int]:
    """Return where the stored entries are among all of them, column by column."""
    return list(sparsity.find())


def _operations(h: Any) -> Mapping[int, Callable[..., Any]]:
    """Return the translation of every operation that has one, under CasADi's code for it."""

    def power(base: Any, exponent: Any) -> Any:
        # heyoka's series of a power wants an exponent that does not change with time.
        return h.exp(exponent * h.log(base)) if h.get_variables(exponent) else base**exponent

    def hypotenuse(x: Any, y: Any) -> Any:
        return h.sqrt(x * x + y * y)

    return {
        ca.OP_ASSIGN: operator.pos,
        ca.OP_LIFT: _first,
        ca.OP_ADD: operator.add,
        ca.OP_SUB: operator.sub,
        ca.OP_MUL: operator.mul,
        ca.OP_DIV: _quotient,
        ca.OP_NEG: operator.neg,
        ca.OP_TWICE: _twice,
        ca.OP_SQ: _square,
        ca.OP_INV: _inverse,
        ca.OP_POW: power,
        ca.OP_CONSTPOW: power,
        ca.OP_SQRT: h.sqrt,
        ca.OP_HYPOT: hypotenuse,
        ca.OP_EXP: h.exp,
        ca.OP_EXPM1: h.expm1,
        ca.OP_LOG: h.log,
        ca.OP_LOG1P: h.log1p,
        ca.OP_SIN: h.sin,
        ca.OP_COS: h.cos,
        ca.OP_TAN: h.tan,
        ca.OP_ASIN: h.asin,
        ca.OP_ACOS: h.acos,
        ca.OP_ATAN: h.atan,
        ca.OP_ATAN2: h.atan2,
        ca.OP_SINH: h.sinh,
        ca.OP_COSH: h.cosh,
        ca.OP_TANH: h.tanh,
        ca.OP_ASINH: h.asinh,
        ca.OP_ACOSH: h.acosh,
        ca.OP_ATANH: h.atanh,
        ca.OP_ERF: h.erf,
    }


def _first(x: Any, _: Any) -> Any:
    return x


def _quotient(x: Any, y: Any) -> Any:
    return x / y


def _twice(x: Any) -> Any:
    return 2.0 * x


def _square(x: Any) -> Any:
    return x * x


def _inverse(x: Any) -> Any:
    return 1.0 / x


def _refusal(code: int) -> TranslationError:
    names = (name for name in dir(ca) if name.startswith("OP_") and getattr(ca, name) == code)
    name = next(names, f"OP_{code}").removeprefix("OP_").lower()
    reason = _OTHER_REASONS.get(name, "which is not analytic")
    return TranslationError(_SPELLED.get(name, name), reason)
