"""A CasADi function as a tape: register instructions that `tape.c` executes.

A tape consists of CasADi's own instructions. Each instruction is one floating-point operation, so
both give the same result, bit for bit. Instructions that depend only on parameters come first and
are executed once per run. The other instructions are ordered by their depth: neighbours do not wait
for each other, so a processor executes several at once.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.integrators import CellTable, Side, called

_OPERATIONS = (
    *("ASSIGN", "ADD", "SUB", "MUL", "DIV", "NEG", "SQ", "TWICE", "INV", "SQRT", "SIN", "COS"),
    *("TAN", "ASIN", "ACOS", "ATAN", "ATAN2", "SINH", "COSH", "TANH", "ASINH", "ACOSH", "ATANH"),
    *("EXP", "EXPM1", "LOG", "LOG1P", "POW", "HYPOT", "ERF", "FABS", "SIGN", "COPYSIGN", "FMIN"),
    *("FMAX", "FLOOR", "CEIL", "FMOD", "REMAINDER", "LT", "LE", "EQ", "NE", "NOT", "AND", "OR"),
    "IF_ELSE_ZERO",
)
"""CasADi's names of the operations, in the order of `tape.c`."""

_NUMBERS: dict[int, int] = {
    getattr(ca, f"OP_{name}"): number for number, name in enumerate(_OPERATIONS)
}
_NUMBERS[ca.OP_CONSTPOW] = _NUMBERS[ca.OP_POW]

_MULTIPLY, _ADD, _SUBTRACT = (_NUMBERS[op] for op in (ca.OP_MUL, ca.OP_ADD, ca.OP_SUB))
_MULTIPLY_ADD, _MULTIPLY_SUBTRACT, _SUBTRACT_PRODUCT = range(len(_OPERATIONS), len(_OPERATIONS) + 3)
"""A product and a sum in one instruction, each rounded."""
_CELL, _TURN, _PICK = range(len(_OPERATIONS) + 3, len(_OPERATIONS) + 6)
"""Look-ups in tables."""
_FLOOR = _NUMBERS[ca.OP_FLOOR]

_NAMES: dict[int, str] = {
    getattr(ca, name): name.removeprefix("OP_").lower()
    for name in dir(ca)
    if name.startswith("OP_")
}


class UnknownOperationError(Exception):
    """Error for an operation that tapes do not support. The message names the operation."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Tape:
    """A formula as instructions.

    Its registers are: varying entries, parameters, constants, results.

    Attributes:
        n_varying: Number of inputs that vary from call to call.
        n_parameters: Number of inputs that are constant in a run.
        n_registers: Number of registers.
        n_once: Number of instructions that depend only on parameters and constants. They come
            first.
        n_first: Number of further instructions that the first output needs. They come next.
        code: Operation, result and three operands of every instruction, ``(n, 5)``.
        constants: Values of the constants.
        outputs: Register of every output.
        tables: Numbers of the tables that it looks into.
    """

    n_varying: int
    n_parameters: int
    n_registers: int
    n_once: int
    n_first: int
    code: NDArray[np.int32]
    constants: NDArray[np.float64]
    outputs: NDArray[np.int32]
    tables: tuple[Vector, ...] = ()

    @cached_property
    def table_places(self) -> NDArray[np.uint64]:
        """Address of every table in memory."""
        return np.array([one.ctypes.data for one in self.tables] or [0], dtype=np.uint64)

    @classmethod
    def empty(cls) -> Tape:
        """Return a tape without outputs."""
        none = np.zeros(0, dtype=np.int32)
        return cls(
            n_varying=0,
            n_parameters=0,
            n_registers=0,
            n_once=0,
            n_first=0,
            code=none.reshape(0, 5),
            constants=np.zeros(0),
            outputs=none,
        )


@dataclass(slots=True)
class _Registers:
    """Registers of results, given out and taken back."""

    n: int
    free: list[int] = field(default_factory=list[int])

    def take(self) -> int:
        if self.free:
            return self.free.pop()
        self.n += 1
        return self.n - 1


_Value = int
"""A value: an input entry, a constant or the result of an instruction, numbered in this order."""


_Made = tuple[int, _Value, _Value, _Value]
"""An operation and its operands."""


@dataclass(slots=True, kw_only=True)
class _Formula:
    """The instructions of a function, each value made once.

    Attributes:
        offsets: Index of the first entry of every input.
        constants: Values of the constants.
        made: Operation and operands of every result. An unused operand repeats the first operand.
        outputs: Value of every requested output.
        tables: Tables that it looks into, by their digests.
    """

    offsets: list[int]
    constants: list[float] = field(default_factory=list[float])
    made: list[_Made] = field(default_factory=list[tuple[int, int, int, int]])
    outputs: list[_Value] = field(default_factory=list[int])
    tables: dict[str, CellTable] = field(default_factory=dict[str, CellTable])
    _known: dict[str, _Value] = field(default_factory=dict[str, int])
    _once: dict[_Made, _Value] = field(default_factory=dict[tuple[int, int, int, int], int])

    def constant(self, number: float) -> _Value:
        """Return the value of a number, which is kept once."""
        # By its digits: zero has two signs.
        key = number.hex()
        if key not in self._known:
            self._known[key] = _CONSTANT + len(self.constants)
            self.constants.append(number)
        return self._known[key]

    def result(self, made: _Made) -> _Value:
        """Return the value of an instruction."""
        self.made.append(made)
        return _RESULT + len(self.made) - 1

    def result_once(self, made: _Made) -> _Value:
        """Return the value of an instruction that may have been made before."""
        if made not in self._once:
            self._once[made] = self.result(made)
        return self._once[made]


_CONSTANT, _RESULT = 1 << 24, 1 << 28
"""Numbers of the first constant and of the first result."""


def tape_of(
    function: ca.Function,
    *,
    parameters: int = 1,
    wanted: Sequence[tuple[int, int]] | None = None,
) -> Tape:
    """Return a function of scalar instructions as a tape.

    Args:
        function: The function, its outputs dense.
        parameters: Index of the input that is constant in a run. All other inputs vary.
        wanted: Requested outputs and entries, by default all in order.

    Raises:
        UnknownOperationError: If the function contains an operation that tapes do not support.
    """
    formula = _fused(_read(function, wanted))
    sizes = [function.numel_in(k) for k in range(function.n_in())]
    varying = [k for k in range(len(sizes)) if k != parameters]
    place: dict[_Value, int] = {}
    for k in (*varying, parameters):
        for entry in range(sizes[k]):
            place[formula.offsets[k] + entry] = len(place)
    n_varying = sum(sizes[k] for k in varying)
    begin = formula.offsets[parameters]
    end = begin + sizes[parameters]
    for k in range(len(formula.constants)):
        place[_CONSTANT + k] = len(place)
    needed, first = _needed(formula, formula.outputs), set(_needed(formula, formula.outputs[:1]))
    once = _independent(formula, needed, range(begin, end))
    first -= once
    level = _levels(formula, needed)
    order = sorted(needed, key=lambda k: (k not in once, k not in first, level[k]))
    code, n_registers = _allocated(formula, order, place, once)
    return Tape(
        n_varying=n_varying,
        n_parameters=sizes[parameters],
        n_registers=n_registers,
        n_once=len(once),
        n_first=len(first),
        code=np.array(code, dtype=np.int32).reshape(-1, 5),
        constants=np.array(formula.constants, dtype=np.float64),
        outputs=np.array([place[value] for value in formula.outputs], dtype=np.int32),
        tables=tuple(one.numbers for one in formula.tables.values()),
    )


def _read(function: ca.Function, wanted: Sequence[tuple[int, int]] | None) -> _Formula:
    """Return the instructions of a function with every value numbered once."""
    sizes = [function.numel_in(k) for k in range(function.n_in())]
    formula = _Formula(offsets=[sum(sizes[:k]) for k in range(len(sizes))])
    work: dict[int, _Value] = {}
    found: dict[tuple[int, int], _Value] = {}
    has_calls = _calls(function)
    nodes: Any = function.instructions_sx() if has_calls else []
    # CasADi has merged equal instructions of a function without calls.
    add = formula.result_once if has_calls else formula.result
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        given, taken = function.instruction_input(k), function.instruction_output(k)
        if operation == ca.OP_INPUT:
            work[taken[0]] = formula.offsets[given[0]] + given[1]
        elif operation == ca.OP_OUTPUT:
            found[taken[0], taken[1]] = work[given[0]]
        elif operation == ca.OP_CONST:
            work[taken[0]] = formula.constant(function.instruction_constant(k))
        elif operation == ca.OP_CALL:
            values = _looked_up(formula, nodes[k], [work[place] for place in given], len(taken))
            work.update(zip(taken, values, strict=True))
        else:
            if operation not in _NUMBERS:
                raise UnknownOperationError(_NAMES.get(operation, f"number {operation}"))
            operands = [work[place] for place in given]
            made = (_NUMBERS[operation], operands[0], operands[-1], operands[0])
            work[taken[0]] = (has_calls and _unscaled(formula, made)) or add(made)
    chosen = wanted
    if chosen is None:
        sparsities = [function.numel_out(k) for k in range(function.n_out())]
        chosen = [(k, entry) for k, n in enumerate(sparsities) for entry in range(n)]
    formula.outputs = [found[place] for place in chosen]
    return formula


def _calls(function: ca.Function) -> bool:
    return any(function.instruction_id(k) == ca.OP_CALL for k in range(function.n_instructions()))


def _looked_up(
    formula: _Formula, node: Any, operands: Sequence[_Value], n_outputs: int
) -> list[_Value]:
    """Return the results of a call, which is a look-up.

    Raises:
        UnknownOperationError: If it is unknown.
    """
    function, lookup = called(node)
    if lookup is None:
        raise UnknownOperationError(f"call of {function.name()}")
    table = lookup.table
    formula.tables.setdefault(table.digest, table)
    which = list(formula.tables).index(table.digest)
    if lookup.side is None:
        index, cell = formula.constant(float(which)), operands[0]
        places = [formula.constant(float(table.place_of(k))) for k in range(n_outputs)]
        return [formula.result_once((_PICK, cell, index, place)) for place in places]
    code = formula.constant(float(len(Side) * which + lookup.side.value))
    if len(operands) == 1:
        return [formula.result_once((_CELL, operands[0], code, operands[0]))]
    return [formula.result_once((_TURN, operands[0], operands[1], code))]


def _unscaled(formula: _Formula, made: _Made) -> _Value | None:
    """Return the look-up that an instruction gives anew, if it does so.

    A whole number of a cell is its own floor, and a number that was scaled to be whole is the
    number if it is scaled back.
    """

    def behind(value: _Value, operation: int) -> _Made | None:
        found = formula.made[value - _RESULT] if value >= _RESULT else None
        return found if found is not None and found[0] == operation else None

    operation, first, last, _ = made
    if operation == _FLOOR:
        is_cell = behind(first, _CELL) is not None or behind(first, _TURN) is not None
        return first if is_cell else None
    if operation != _MULTIPLY:
        return None
    for factor, value in ((first, last), (last, first)):
        floor = behind(value, _FLOOR)
        product = None if floor is None else behind(floor[1], _MULTIPLY)
        if product is None or not _CONSTANT <= factor < _RESULT:
            continue
        for scale, number in ((product[1], product[2]), (product[2], product[1])):
            if not _CONSTANT <= scale < _RESULT or behind(number, _PICK) is None:
                continue
            scales = formula.constants[scale - _CONSTANT], formula.constants[factor - _CONSTANT]
            if scales[0] * scales[1] == 1.0 and math.frexp(scales[0])[0] == 0.5:
                return number
    return None


def _fused(formula: _Formula) -> _Formula:
    """Return a formula in which a product that is only summed is one instruction with the sum."""
    counts = Counter(value for made in formula.made for value in set(made[1:]))
    counts.update(formula.outputs)
    for k, (operation, first, second, _) in enumerate(formula.made):
        if operation not in (_ADD, _SUBTRACT) or first == second:
            continue
        for product, other in ((second, first), (first, second)):
            if product < _RESULT or counts[product] != 1:
                continue
            factor, one, two, _ = formula.made[product - _RESULT]
            if factor != _MULTIPLY:
                continue
            fused = _MULTIPLY_ADD
            if operation == _SUBTRACT:
                fused = _SUBTRACT_PRODUCT if product == second else _MULTIPLY_SUBTRACT
            formula.made[k] = (fused, one, two, other)
            counts.update({one, two})
            break
    return formula


def _needed(formula: _Formula, outputs: Sequence[_Value]) -> list[int]:
    """Return the indices of the results that some outputs depend on, in order."""
    needed = {value - _RESULT for value in outputs if value >= _RESULT}
    for k in reversed(range(len(formula.made))):
        if k in needed:
            needed.update(value - _RESULT for value in formula.made[k][1:] if value >= _RESULT)
    return sorted(needed)


def _levels(formula: _Formula, needed: Sequence[int]) -> dict[int, int]:
    """Return the depth of results: one more than that of the deepest operand."""
    levels: dict[int, int] = {}
    for k in needed:
        operands = (value - _RESULT for value in formula.made[k][1:] if value >= _RESULT)
        levels[k] = 1 + max((levels[one] for one in operands), default=0)
    return levels


def _independent(
    formula: _Formula, needed: Sequence[int], parameters: Collection[int]
) -> frozenset[int]:
    """Return the indices of the results that depend only on parameters and constants."""
    found: set[int] = set()
    for k in needed:
        if all(
            value - _RESULT in found
            if value >= _RESULT
            else value >= _CONSTANT or value in parameters
            for value in formula.made[k][1:]
        ):
            found.add(k)
    return frozenset(found)


def _allocated(
    formula: _Formula, order: Sequence[int], place: dict[_Value, int], once: Collection[int]
) -> tuple[list[tuple[int, ...]], int]:
    """Return the instructions with registers, and how many registers there are.

    A result's register is used again after its last use, unless it is an output or made once.
    """
    kept = {*formula.outputs, *(_RESULT + k for k in once)}
    uses = {value: at for at, k in enumerate(order) for value in formula.made[k][1:]}
    registers = _Registers(len(place))
    code: list[tuple[int, ...]] = []
    for at, k in enumerate(order):
        operation, *values = formula.made[k]
        operands = [place[value] for value in values]
        for value in set(values):
            if value >= _RESULT and uses[value] == at and value not in kept:
                registers.free.append(place[value])
        place[_RESULT + k] = registers.take()
        code.append((operation, place[_RESULT + k], *operands))
    return code, registers.n
