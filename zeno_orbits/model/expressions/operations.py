"""The operations of formulas: their names, and function calls as formulas.

Every formula of a model consists of CasADi's scalar operations. A call of another function is one
operation too, which only CasADi itself can evaluate. It is expanded when a model is built, or it is
refused by name.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import casadi as ca
import numpy as np

from zeno_orbits.integrators import lookup_of
from zeno_orbits.model.expressions.tables import of_interpolant

_SIGNS = {ca.OP_EQ: "==", ca.OP_NE: "!=", ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_DIV: "/"}
_NAMES: dict[int, str] = {
    getattr(ca, name): name.removeprefix("OP_").lower()
    for name in dir(ca)
    if name.startswith("OP_")
} | _SIGNS


def operation_name(operation: int) -> str:
    """Return the name of an operation of CasADi for a message.

    Args:
        operation: Its number, `casadi.OP_FLOOR` for instance.
    """
    return _NAMES.get(operation, f"number {operation}")


def symbols_in(formula: ca.SX) -> list[ca.SX]:
    """Return the symbols of a formula.

    Args:
        formula: The formula.
    """
    return ca.symvar(formula)


def without_calls(formula: ca.SX) -> ca.SX:
    """Return a formula with the calls of functions in it as formulas.

    A call of a function of scalar operations is inlined. A `casadi.interpolant` of one or two
    arguments becomes a table.

    Args:
        formula: The formula.

    Raises:
        ValueError: If a function cannot be expanded. The message names the function.
    """
    if not _has_calls(formula):
        return formula
    known = _Known()
    entries = [_rebuilt(entry, known) for entry in _entries(formula)]
    return ca.SX(formula.sparsity(), ca.vertcat(*entries))


def expand_calls(declared: Any) -> None:
    """Expand the calls of functions in the formulas of a frozen dataclass that is being made.

    Args:
        declared: The instance, whose ``__post_init__`` calls this function.

    Raises:
        ValueError: If a function cannot be expanded. The message names the function.
    """
    for one in fields(declared):
        formula = getattr(declared, one.name)
        if isinstance(formula, ca.SX):
            object.__setattr__(declared, one.name, without_calls(formula))


def _entries(formula: Any) -> list[ca.SX]:
    """Return the stored entries of a formula."""
    return list(formula.nonzeros())


def _has_calls(formula: ca.SX) -> bool:
    function = ca.Function("formula", symbols_in(formula), [formula])
    return any(function.instruction_id(k) == ca.OP_CALL for k in range(function.n_instructions()))


@dataclass(frozen=True, slots=True)
class _Known:
    """What was rebuilt before.

    Attributes:
        nodes: Formulas by the node that they replace.
        calls: Outputs of a function by the call that they replace.
    """

    nodes: dict[int, ca.SX] = field(default_factory=dict[int, ca.SX])
    calls: dict[int, list[ca.SX]] = field(default_factory=dict[int, "list[ca.SX]"])


def _rebuilt(formula: ca.SX, memory: _Known) -> ca.SX:
    """Return a scalar without calls."""
    known = memory.nodes
    waiting: list[Any] = [formula]
    while waiting:
        node = waiting[-1]
        key = node.element_hash()
        parts = _parts(node)
        missing = [part for part in parts if part.element_hash() not in known]
        if key in known or not missing:
            waiting.pop()
        if key not in known and not missing:
            known[key] = _node(node, [known[part.element_hash()] for part in parts], memory)
        waiting += missing
    return known[formula.element_hash()]


def _parts(node: Any) -> list[Any]:
    """Return the operands of a node, or the arguments of the function whose output it is."""
    call = node.dep(0) if node.is_output() else node
    return [] if call.is_leaf() else [call.dep(k) for k in range(call.n_dep())]


def _node(node: Any, parts: list[ca.SX], memory: _Known) -> ca.SX:
    if node.is_output():
        call: Any = node.dep(0)
        key = call.element_hash()
        if key not in memory.calls:
            memory.calls[key] = _called(call.which_function(), parts)
        return memory.calls[key][int(node.which_output())]
    if node.is_leaf():
        return ca.SX(node)
    return ca.SX.unary(node.op(), *parts) if len(parts) == 1 else ca.SX.binary(node.op(), *parts)


def _called(function: Any, arguments: list[ca.SX]) -> list[ca.SX]:
    """Return all output entries of a function at the entries of its inputs.

    Raises:
        ValueError: If the function consists of other than scalar operations.
    """
    kind = function.class_name()
    if lookup_of(function) is not None:
        return _entries(ca.densify(function(*arguments)))
    if kind == "SXFunction":
        return _inlined(function, arguments)
    if kind in ("LinearInterpolant", "BSplineInterpolant"):
        return of_interpolant(function, arguments)
    raise ValueError(
        f"Argument `model`: a formula calls the function `{function.name()}` ({kind}), which has "
        "no formula here: write it in `casadi.SX` operations."
    )


def _inlined(function: Any, arguments: list[ca.SX]) -> list[ca.SX]:
    """Return the outputs of a function of scalar operations."""
    made = function.instructions_sx()
    work: dict[int, ca.SX] = {}
    outputs: list[ca.SX] = []
    offsets = np.cumsum([0, *(function.nnz_in(k) for k in range(function.n_in()))]).tolist()
    symbols: list[ca.SX] = list(function.sx_in())
    inputs = ca.vertcat(*map(ca.vec, symbols))
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        given, taken = function.instruction_input(k), function.instruction_output(k)
        if operation == ca.OP_OUTPUT:
            outputs.append(work[given[0]])
        elif operation == ca.OP_INPUT:
            work[taken[0]] = inputs[offsets[given[0]] + given[1]]
        elif operation == ca.OP_CALL:
            work.update((place, made[k].get_output(j)) for j, place in enumerate(taken))
        else:
            work[taken[0]] = made[k]
    found: Any = ca.substitute(ca.vertcat(*outputs), inputs, ca.vertcat(*arguments))
    return _entries(without_calls(found)) if outputs else []
