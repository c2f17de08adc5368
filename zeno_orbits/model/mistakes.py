"""Mistakes in problem files: line, problem and remedy of an error."""

from __future__ import annotations

import ast
import inspect
import math
import re
import sys
import traceback
from collections.abc import Callable, Iterator
from operator import attrgetter
from pathlib import Path
from typing import Any

import casadi as ca

from zeno_orbits.errors import did_you_mean

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
_CALLED_MODEL = (
    "argument `model` must be a function of the gains and parameters, but the file calls it. "
    "Write `model=model`"
)
_JUMP = re.compile(r"Argument `model`: a formula holds `([^`]+)` of the states")
_ARGUMENTS = re.compile(
    r"([\w.]+)\(\) (got an unexpected keyword argument|missing \d+ required .*arguments?:)"
    r" '(\w+)'"
)
"""Python's words about the arguments of a call."""
_USUAL_IMPORTS = {
    "ca": "import casadi as ca",
    "casadi": "import casadi",
    "math": "import math",
    "np": "import numpy as np",
    "numpy": "import numpy",
    "zeno_orbits": "import zeno_orbits",
    "zo": "import zeno_orbits as zo",
}
"""Name to the line that imports it."""
_IMPORTED = re.compile(r"cannot import name '(\w+)'")
"""Python's words about a name that a module lacks."""
_SIGNS = {"==": ast.Eq, "!=": ast.NotEq}
_ROUNDING = ("floor", "round", "rint")
"""Functions of Python and NumPy whose formula holds `floor`."""
_OPERATORS = {"^": "Write `**` for a power", "@": "Write `ca.mtimes(a, b)`"}
"""Operators that formulas lack, and the remedy."""
_IS_NUMERIC = re.compile(r"it is not finite$|appears nowhere")
"""Messages whose cause may be a numeric function of a symbol."""
_TWO_SYMBOLS = {"SX", "MX"}
_NUMERIC = ("math", "cmath")
"""Modules whose functions turn a symbol into a number."""


class NotSymbolicError(ValueError):
    """A formula holds NaN, since a numeric function was given a symbol."""

    def __init__(self) -> None:
        super().__init__(f"{_NOT_SYMBOLIC}.")


class FormulaError(ValueError):
    """A formula of the model is wrong.

    Attributes:
        keywords: Arguments of a problem file that may give the formula.
        owner: Name of the stop or switch that the formula belongs to, or an empty text.
        operation: Name of the operation at fault, or an empty text.
    """

    def __init__(
        self, text: str, *, keywords: tuple[str, ...], owner: str = "", operation: str = ""
    ) -> None:
        super().__init__(text)
        self.keywords, self.owner, self.operation = keywords, owner, operation


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
        return _about_syntax(error), error.lineno
    text = " ".join(str(error).split()).removesuffix(".")
    tree = _tree_of(file)
    numeric = next(_numeric_calls(tree), None)
    if isinstance(error, NotSymbolicError) or (_IS_NUMERIC.search(text) and numeric):
        return _NOT_SYMBOLIC, numeric
    if isinstance(error, FormulaError):
        return text, _line_of_formula(tree, error)
    text = _about_inductance(text, tree)
    called = _called_model(tree)
    if isinstance(error, TypeError | KeyError) and called is not None:
        return _CALLED_MODEL, called
    line = _line_of_argument(tree, text, _line_in_trace(error, file))
    jump = _JUMP.match(text)
    if jump is not None:
        text = text.removeprefix("Argument `model`: ")
        for name in _ROUNDING if jump[1] == "floor" else (jump[1],):
            if (used := _only(_uses(tree, name))) is not None:
                return text.replace(f"`{jump[1]}`", f"`{name}`", 1), used
        return text, line
    if _NO_TRUTH in text:
        return _CONDITION, line
    if set(re.findall(r"'(\w+)'", text)) >= _TWO_SYMBOLS:
        return "symbols of two kinds. Write `ca.SX.sym` for every symbol", line
    if "Assertion" in text and "casadi" in text:
        reason = text.partition("failed:")[2].strip() or "a dimension is wrong"
        return f"formulas whose shapes do not fit ({reason}). Make their sizes equal", line
    if isinstance(error, ValueError):
        return text, line
    return _about_python(error, text), line


def _called_model(tree: ast.AST) -> int | None:
    """Return the line of an argument `model` that is a call of a model without symbols.

    Such a call has None or an empty mapping as its argument, as ``model=model({})``.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.keyword) and node.arg == "model":
            given = node.value.args if isinstance(node.value, ast.Call) else []
            if any(ast.unparse(one) in ("None", "{}", "dict()") for one in given):
                return node.lineno
    return None


def _about_syntax(error: SyntaxError) -> str:
    """Return the message about a file that Python cannot parse."""
    text = str(error.msg)
    if isinstance(error, IndentationError):
        return f"{text}. Indent the line like its neighbours"
    if "was never closed" in text:
        return f"{text}. Add the closing bracket"
    if "codec can't decode" in text:
        return "a character is not UTF-8. Save the file as UTF-8"
    if "unterminated" in text and "string" in text:
        return f"{text}. Close the quotation mark"
    if text.startswith("positional argument follows"):
        return f"{text}. Name the value, or write a decimal point, as in `1.5`"
    return text


def _about_python(error: BaseException, text: str) -> str:
    """Return the message about an exception of Python itself, with its remedy."""
    if isinstance(error, AttributeError) and isinstance(error.obj, dict):
        return f'a mapping lacks the attribute `{error.name}`. Write `p["{error.name}"]`'
    if isinstance(error, AttributeError) and error.name:
        owner = getattr(error.obj, "__name__", type(error.obj).__name__)
        known = [name for name in dir(error.obj) if not name.startswith("_")]
        near = did_you_mean(error.name, known) or " See its documentation."
        return f"`{owner}` lacks the attribute `{error.name}`.{near}"
    if isinstance(error, NameError) and error.name:
        return f"the name `{error.name}` is not defined. {_remedy_of_name(error.name)}"
    if isinstance(error, KeyError):
        return f"the name {text} is neither a state nor declared. Declare it, or write another name"
    if isinstance(error, ImportError) and error.name:
        name = _IMPORTED.match(text)
        module = sys.modules.get(error.name)
        if name is not None and module is not None:
            near = did_you_mean(name[1], dir(module)) or " See its documentation."
            return f"`{error.name}` lacks the name `{name[1]}`.{near}"
        return f"{text}. Install the package, or remove the import"
    if isinstance(error, SystemExit):
        return "the file ends the program (`sys.exit`). Remove the call"
    if isinstance(error, EOFError):
        return "the file waits for an input. Write the value into the file"
    if isinstance(error, FileNotFoundError):
        return f"the file `{error.filename}` is missing. Write `Path(__file__).parent / ...`"
    words = _ARGUMENTS.match(text)
    if words is not None:
        return _about_arguments(words[1].removesuffix(".__init__"), words[2], words[3], text)
    owner = re.match(r"(?:(\w+)\.)?(\w+)\(\) takes (?:from )?\d.* positional argument", text)
    if owner is not None:
        return _about_positions(owner[1] or "", owner[2], text)
    if re.match(r"'(SX|MX|float|int)' object is not callable", text):
        remedy = "Write `*` before its parenthesis, or leave out `()`"
        return f"a formula or number is called (`{text}`). {remedy}"
    if text == "'dict' object is not callable":
        return 'a mapping is called. Write square brackets, as in `p["m"]`'
    if "unsupported operand" in text:
        sign = re.search(r"for (\S+?):", text)
        remedy = "Write numbers and `ca.SX` symbols on both sides"
        return f"{text}. {_OPERATORS.get(sign[1], remedy) if sign else remedy}"
    if "to_int not defined" in text:
        return "a whole number of a symbol, such as `int(q)` or `range(q)`. Write the symbol"
    return f"{type(error).__name__}: {text}"


def _about_positions(owner: str, function: str, text: str) -> str:
    """Return the message about a call with more values without a name than it takes.

    Args:
        owner: The class, or an empty text.
        function: The function or method.
        text: The message of Python, which counts the values with the object or class itself.
    """
    counts = re.search(r"(\d+) positional arguments? but (\d+)", text)
    word = owner if function == "__init__" else ".".join(filter(None, (owner, function)))
    most, given = (int(counts[k]) - bool(owner) for k in (1, 2)) if counts else (0, 0)
    if most > 0:
        return (
            f"`{word}` takes at most {most} values without a name, and {given} are given. Name "
            "the others, and write a decimal point, as in `1.5`"
        )
    first = next(iter(_arguments_of(word)), "name")
    return f"`{word}` takes named arguments alone. Write `{word}({first}=..., ...)`"


def _remedy_of_name(name: str) -> str:
    """Return the remedy for a name that a file uses and does not define."""
    if name in _USUAL_IMPORTS:
        return f"Add `{_USUAL_IMPORTS[name]}`"
    import zeno_orbits

    if callable(getattr(ca, name, None)):
        return f"Write `ca.{name}`"
    if name in zeno_orbits.__all__:
        return f"Write `zo.{name}`"
    return f'Define or import it, or write `p["{name}"]` for a declared parameter'


def _about_arguments(owner: str, what: str, name: str, text: str) -> str:
    """Return the message about an argument that a call lacks or does not know.

    Args:
        owner: The function or class.
        what: Python's words about the argument.
        name: The argument.
        text: The whole message of Python, which lists all arguments that are missing.
    """
    if what.startswith("missing"):
        names = re.findall(r"'(\w+)'", text.partition("missing")[2])
        noun = "argument" if len(names) == 1 else "arguments"
        listed = ", ".join(f"`{one}`" for one in names)
        return f"`{owner}` lacks the {noun} {listed}. Write `{name}=...`"
    known = _arguments_of(owner)
    near = did_you_mean(name, known) or " Remove it."
    listed = f" Known: {', '.join(known)}" if known else ""
    return f"`{owner}` does not take the argument `{name}`.{near}{listed}"


def _arguments_of(owner: str) -> list[str]:
    """Return the names of the arguments of a public function or class, or nothing."""
    import zeno_orbits

    try:
        found = attrgetter(owner)(zeno_orbits)
        return list(inspect.signature(found).parameters)
    except (AttributeError, TypeError, ValueError):
        return []


def _line_of_formula(tree: ast.AST, error: FormulaError) -> int | None:
    """Return the line of the operation at fault, or else of the argument that gives the formula."""
    line = _only(_uses(tree, error.operation))
    if line is not None:
        return line
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    if error.owner:
        calls = [
            call
            for call in calls
            if any(isinstance(x, ast.Constant) and x.value == error.owner for x in _names(call))
        ]
    given = [
        word
        for name in error.keywords
        for call in calls
        for word in call.keywords
        if word.arg == name
    ]
    if not given:
        return None
    value = given[0].value
    if isinstance(value, ast.Name):
        # A name stands for the formula that was assigned to it last.
        before = [
            node.lineno
            for node in ast.walk(tree)
            if isinstance(node, ast.Assign)
            and node.lineno <= given[0].lineno
            and any(isinstance(one, ast.Name) and one.id == value.id for one in node.targets)
        ]
        return max(before, default=given[0].lineno)
    return given[0].lineno


def _uses(tree: ast.AST, operation: str) -> list[int]:
    """Return the lines of the calls of an operation, or of its sign."""
    sign = _SIGNS.get(operation)
    return [
        node.lineno
        for node in ast.walk(tree)
        if (
            isinstance(node, ast.Call)
            and operation
            and operation in (getattr(node.func, "attr", ""), getattr(node.func, "id", ""))
        )
        or (isinstance(node, ast.Compare) and sign and isinstance(node.ops[0], sign))
    ]


def _only(lines: list[int]) -> int | None:
    """Return the one line of a list, or None if there are several or none."""
    return lines[0] if len(lines) == 1 else None


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
    for name in () if "appears twice" in text else names:
        for call in calls:
            if any(word.arg == name for word in call.keywords):
                return next(word.lineno for word in call.keywords if word.arg == name)
    makers = [
        node
        for call in calls[:1]
        for node in ast.walk(call)
        if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == names[0]
    ]
    if len(makers) == 1:
        return makers[0].lineno
    mistake = re.split(r": write| Known | Did you mean", text)[0]
    values = re.findall(r"`'?([^`']+)'?`", mistake)
    for value in reversed(values) if line is not None else ():
        nodes = [node for call in calls for node in ast.walk(call)]
        # A declared name is the first argument of its `Quantity`, or `name`.
        declared = [one for node in nodes if isinstance(node, ast.Call) for one in _names(node)]
        found = list[int]()
        for node in (*declared, *nodes):
            if isinstance(node, ast.Constant) and node.value == value:
                found.append(node.lineno)
        if found:
            return found[1] if "appears twice" in text and len(found) > 1 else found[0]
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


def place_in_file(error: BaseException, function: Callable[..., Any]) -> str:
    """Return the file and the line of a function that raised an error, for a message, or nothing.

    Args:
        error: The error.
        function: The function, of a problem file.
    """
    code = getattr(function, "__code__", None)
    line = None if code is None else _line_in_trace(error, Path(code.co_filename))
    return "" if code is None or line is None else f", {Path(code.co_filename).name}, line {line}"


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
