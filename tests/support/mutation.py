"""Small faults in Python code, one at a time: what a mutation study asks the tests to notice."""

from __future__ import annotations

import ast
import copy
import difflib
from collections.abc import Iterator
from dataclasses import dataclass

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Div,
    ast.Mod: ast.FloorDiv,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
SWAPPED = {
    "min": "max",
    "minimum": "maximum",
    "fmin": "fmax",
    "any": "all",
    "argmin": "argmax",
    "floor": "ceil",
    "sin": "cos",
    "first": "last",
}
SWAPPED |= {new: old for old, new in SWAPPED.items()}
UNWRAPPED = {"abs", "fabs", "sorted", "reversed", "sqrt", "exp", "log"}
"""Functions of one argument that a fault may leave out."""
NAMED = {"ca.SX.sym", "ca.MX.sym", "TypeVar", "cast"}
"""Functions whose first argument is a name, or a type that is read by type checkers alone."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Mutant:
    """A module with one fault.

    Attributes:
        line: First line of the fault.
        last: Last line.
        kind: The kind of fault.
        source: The module with it.
    """

    line: int
    last: int
    kind: str
    source: str

    def diff(self, original: str) -> str:
        """Return the lines that differ from the module without the fault."""
        lines = difflib.unified_diff(
            original.splitlines(), self.source.splitlines(), lineterm="", n=0
        )
        return "\n".join(line for line in lines if not line.startswith(("---", "+++", "@@")))


def mutants_of(source: str) -> Iterator[Mutant]:
    """Yield every mutant of a module, in order of its lines.

    Annotations, decorators, docstrings, imports and sentences are left alone, and so is what no
    answer depends on: names of symbols and type variables, encodings, and `strict=` of a `zip`.

    Args:
        source: The module.
    """
    encoded = source.encode()
    starts = [0]
    for line in encoded.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    for node in _nodes(ast.parse(source)):
        begin = starts[node.lineno - 1] + node.col_offset
        end = starts[(node.end_lineno or node.lineno) - 1] + (node.end_col_offset or 0)
        for kind, new in _faults(node):
            text = ast.unparse(new)
            text = f"({text})" if isinstance(new, ast.expr) and _wants_brackets(new) else text
            changed = (encoded[:begin] + text.encode() + encoded[end:]).decode()
            last = node.end_lineno or node.lineno
            yield Mutant(line=node.lineno, last=last, kind=kind, source=changed)


def _wants_brackets(node: ast.expr) -> bool:
    return isinstance(node, ast.BinOp | ast.BoolOp | ast.Compare | ast.UnaryOp | ast.IfExp)


def _nodes(node: ast.AST) -> Iterator[ast.expr | ast.stmt]:
    """Yield the expressions and statements in which a fault makes sense."""
    skipped: list[ast.AST] = []
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        skipped += node.decorator_list
    if isinstance(node, ast.FunctionDef):
        skipped += [node.returns] if node.returns is not None else []
    if isinstance(node, ast.Raise | ast.Import | ast.ImportFrom | ast.JoinedStr | ast.arg):
        return
    if isinstance(node, ast.AnnAssign):
        skipped.append(node.annotation)
    if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
        return
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return
    if isinstance(node, ast.Call):
        skipped += _of_no_account(node)
    if isinstance(node, ast.expr | ast.stmt):
        yield node
    for child in ast.iter_child_nodes(node):
        if child not in skipped:
            yield from _nodes(child)


def _of_no_account(node: ast.Call) -> list[ast.AST]:
    """Return the arguments of a call that no answer depends on."""
    of_keywords: list[ast.AST] = [k for k in node.keywords if k.arg in ("strict", "encoding")]
    return [*of_keywords, *(node.args[:1] if ast.unparse(node.func) in NAMED else ())]


def _faults(node: ast.expr | ast.stmt) -> Iterator[tuple[str, ast.expr | ast.stmt]]:
    if isinstance(node, ast.stmt):
        yield from _of_statement(node)
        return
    match node:
        case ast.Compare():
            for k, operator in enumerate(node.ops):
                for other in COMPARISONS[type(operator)]:
                    new = copy.deepcopy(node)
                    new.ops[k] = other()
                    yield "comparison", new
        case ast.BinOp() if type(node.op) in ARITHMETIC:
            yield "arithmetic", ast.BinOp(node.left, ARITHMETIC[type(node.op)](), node.right)
        case ast.UnaryOp(op=ast.USub() | ast.Not()):
            yield "sign", node.operand
        case ast.BoolOp():
            other_op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
            yield "logic", ast.BoolOp(other_op, node.values)
        case ast.IfExp():
            yield "branches", ast.IfExp(node.test, node.orelse, node.body)
        case ast.Constant():
            yield from _of_constant(node)
        case ast.Call():
            yield from _of_call(node)
        case _:
            pass


def _of_constant(node: ast.Constant) -> Iterator[tuple[str, ast.expr]]:
    value = node.value
    if isinstance(value, bool):
        yield "constant", ast.Constant(not value)
    elif isinstance(value, int):
        yield "constant", ast.Constant(value + 1)
    elif isinstance(value, float):
        yield "constant", ast.Constant(1.0 if value == 0.0 else 2.0 * value)
    elif isinstance(value, str) and value and not any(map(str.isspace, value)):
        yield "text", ast.Constant(f"{value}?")


def _of_call(node: ast.Call) -> Iterator[tuple[str, ast.expr]]:
    function = node.func
    name = function.attr if isinstance(function, ast.Attribute) else ast.unparse(function)
    if name in SWAPPED:
        new = copy.deepcopy(node)
        if isinstance(new.func, ast.Attribute):
            new.func.attr = SWAPPED[name]
        else:
            new.func = ast.Name(SWAPPED[name])
        yield "function", new
    if name in UNWRAPPED and len(node.args) == 1:
        yield "function", node.args[0]


def _of_statement(node: ast.stmt) -> Iterator[tuple[str, ast.stmt]]:
    match node:
        case ast.Return(value=value) if value is not None and not _is_none(value):
            yield "return", ast.Return(ast.Constant(None))
        case ast.Expr(value=ast.Call() | ast.Yield() | ast.YieldFrom()):
            yield "statement", ast.Pass()
        case ast.AugAssign() | ast.Continue() | ast.Break():
            yield "statement", ast.Pass()
        case ast.Assign(targets=[ast.Subscript() | ast.Attribute()]):
            yield "statement", ast.Pass()
        case _:
            pass


def _is_none(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and node.value is None
