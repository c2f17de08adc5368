"""Mistakes in problem files: line, problem and remedy of an error."""

from __future__ import annotations

import ast
import math
import re
import traceback
from collections.abc import Iterator
from pathlib import Path

import casadi as ca

_NO_TRUTH = "Cannot compute the truth value"
"""CasADi's words about the truth of a symbol."""
_CONDITION = (
    "a condition on a symbol. Write `ca.if_else(q > 0, a, b)` for `a if q > 0 else b`, "
    "`ca.logic_and` for `and`, `ca.fmax` for `max`"
)
_NOT_SYMBOLIC = (
    "a formula of the model holds NaN, as `math.sin(q)` or `float(q)` of a symbol give. "
    "Write `ca.sin(q)`, or the symbol"
)
_TWO_SYMBOLS = {"SX", "MX"}
_NUMERIC = ("math", "cmath")
"""Modules whose functions turn a symbol into a number."""


class NotSymbolicError(ValueError):
    """A formula holds NaN, since a numeric function was given a symbol."""

    def __init__(self) -> None:
        super().__init__(f"{_NOT_SYMBOLIC}.")


def holds_nan(formula: ca.SX) -> bool:
    """Return True if a formula holds the constant NaN."""
    function = ca.Function("formula", ca.symvar(formula), [ca.densify(formula)])
    return any(
        function.instruction_id(k) == ca.OP_CONST and math.isnan(function.instruction_constant(k))
        for k in range(function.n_instructions())
    )


def account_of(error: BaseException, file: Path) -> tuple[str, int | None]:
    """Return what an error of a problem's code says in one line, and its line in the file.

    Args:
        error: The error.
        file: The file.
    """
    if isinstance(error, SyntaxError):
        return str(error.msg), error.lineno
    text = " ".join(str(error).split()).removesuffix(".")
    tree = _tree_of(file)
    numeric = next(_numeric_calls(tree), None)
    if isinstance(error, NotSymbolicError) or (text.endswith("it is not finite") and numeric):
        return _NOT_SYMBOLIC, numeric
    text = _about_inductance(text, tree)
    line = _line_of_argument(tree, text, _line_in_trace(error, file))
    if _NO_TRUTH in text:
        return _CONDITION, line
    if set(re.findall(r"'(\w+)'", text)) >= _TWO_SYMBOLS:
        return "symbols of two kinds. Write `ca.SX.sym` for every symbol", line
    if "Assertion" in text and "casadi" in text:
        reason = text.partition("failed:")[2].strip() or "a dimension is wrong"
        return f"formulas whose shapes do not fit ({reason})", line
    if isinstance(error, ValueError):
        return text, line
    return f"{type(error).__name__}: {text}", line


def _about_inductance(text: str, tree: ast.AST) -> str:
    """Return a message about the coenergy in the word of a file that gives an inductance."""
    if not text.startswith("Argument `coenergy`") or next(_arguments(tree, "coenergy"), None):
        return text
    return "Argument `inductance` must be positive (definite for several motors)"


def _line_of_argument(tree: ast.AST, text: str, line: int | None) -> int | None:
    """Return the line of the argument that a message names, in the call that a trace ends in.

    Args:
        tree: The file.
        text: The message.
        line: Line of the trace, or None for a check after the file was read.
    """
    names = [_argument_in(text), *(("kinetic", "mass_matrix") if "mass matrix" in text else ())]
    calls = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and line in (None, node.lineno)
    ]
    if line is not None:
        # The call itself is the outermost of those that begin in its line.
        calls = calls[:1]
    for name in names:
        for call in calls:
            if any(word.arg == name for word in call.keywords):
                return next(word.lineno for word in call.keywords if word.arg == name)
    mistake = re.split(r": write| Known | Did you mean", text)[0]
    values = re.findall(r"`'?([^`']+)'?`", mistake)
    for value in reversed(values) if line is not None else ():
        nodes = [node for call in calls for node in ast.walk(call)]
        # A declared name is the first argument of its `Quantity`, or `name`.
        declared = [one for node in nodes if isinstance(node, ast.Call) for one in _names(node)]
        for node in (*declared, *nodes):
            if isinstance(node, ast.Constant) and node.value == value:
                return node.lineno
    elsewhere = list(_arguments(tree, names[0])) if calls else []
    return elsewhere[0] if len(elsewhere) == 1 else line


def _names(call: ast.Call) -> list[ast.expr]:
    """Return the expressions that name what a call makes."""
    return [*call.args[:1], *(word.value for word in call.keywords if word.arg == "name")]


def _line_in_trace(error: BaseException, file: Path) -> int | None:
    """Return the innermost line of the file that led to an error, or to the error before it."""
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if Path(frame.filename) == file]
    if lines or error.__cause__ is None:
        return lines[-1] if lines else None
    return _line_in_trace(error.__cause__, file)


def _tree_of(file: Path) -> ast.AST:
    """Return the syntax tree of a file, empty if it cannot be read."""
    try:
        return ast.parse(file.read_text(encoding="utf-8"))
    except (OSError, SyntaxError, ValueError):
        return ast.Module(body=[], type_ignores=[])


def _argument_in(text: str) -> str:
    """Return the argument that a message names, or an empty text."""
    named = re.search(r"Argument `(\w+)`", text)
    return named[1] if named else "starts" if text.startswith("Start ") else ""


def _numeric_calls(tree: ast.AST) -> Iterator[int]:
    """Yield the lines in which a function calls one of `math`, or `float`, with a formula."""
    for function in ast.walk(tree):
        if not isinstance(function, ast.FunctionDef):
            continue
        for node in ast.walk(function):
            if not isinstance(node, ast.Call) or all(_is_number(one) for one in node.args):
                continue
            called = node.func
            if isinstance(called, ast.Attribute) and isinstance(called.value, ast.Name):
                if called.value.id in _NUMERIC:
                    yield node.lineno
            elif isinstance(called, ast.Name) and called.id == "float":
                yield node.lineno


def _is_number(node: ast.expr) -> bool:
    return not any(isinstance(one, ast.Name) and one.id not in _NUMERIC for one in ast.walk(node))


def _arguments(tree: ast.AST, name: str) -> Iterator[int]:
    """Yield the lines of a call's argument of that name."""
    for node in ast.walk(tree):
        if isinstance(node, ast.keyword) and node.arg == name:
            yield node.lineno
