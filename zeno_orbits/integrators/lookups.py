r"""Look-ups: the cell of a value between knots, and the numbers of a cell.

A look-up is a call of a CasADi function in a formula. It is constant between two knots, so its
derivatives are zero. CasADi writes that for whole numbers alone: a number `c` of a cell is
:math:`\lfloor 2^s c \rfloor\,2^{-s}` in a formula, which is `c` itself, since :math:`2^s c` is
whole. The loop carries out a look-up as one instruction each for cell and number.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from zeno_orbits.arrays import Vector

_ca: Any = ca
"""CasADi, whose stubs do not know the types of these functions."""
_OPTIONS = {"is_diff_in": [False], "never_inline": True}
_VANISHING = 2.0**-600
"""Share of the largest number of a row below which a number counts as zero."""
_GUARD = 4
"""Rows that describe the guard of a cell."""
TABLE_HEAD = 7
"""Rows before the numbers of a cell: its guard, its width, and the lengths that a step may pass."""
_AROUND = 1e-6
"""Part of a cell around it that counts as in it, because an event is on a knot to rounding."""
_HEAD = 6
"""Numbers before the knots in a table of the loop."""


class Side(Enum):
    """The cells that a look-up finds: all, or those of an even or odd index and beyond their ends.

    A look-up of even cells gives the nearest even cell to a value in an odd cell, so a step of the
    flow may pass a knot before the event there is found.
    """

    ALL = 0
    EVEN = 1
    ODD = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Lookup:
    """What a function that a formula calls stands for.

    Attributes:
        table: The table.
        side: Cells that are found, or ``None`` for the numbers of a cell.
    """

    table: CellTable
    side: Side | None


@dataclass(frozen=True, kw_only=True, eq=False)
class CellTable:
    """Knots, and numbers for every cell between two of them.

    Attributes:
        name: Name for messages.
        knots: Knots in increasing order, ``(n + 1,)``. Without knots, ``(0,)``, cells are found by
            other tables.
        columns: Numbers of every cell, ``(m, n)``. A number below 1e-180 of the largest of its row
            counts as zero: samples that decay reach 1e-320, which no scale makes whole with 1. With
            knots, the first four columns describe the guard of a cell: its knot and the
            coefficients of a parabola there; of phases, cosine and sine of the middle, and tangent
            and cotangent of a quarter of the cell. The next three are its width, and the lengths
            from the knot or the middle, back and on, that a step may pass.
        is_kinked: Whether a knot is an event.
        refuses: Whether a value outside of the knots lacks a cell. Else an outer cell goes on.
        turns: Whether the knots are phases of a turn [rad], from 0 to 2 pi.
    """

    name: str
    knots: Vector
    columns: Vector
    is_kinked: bool = False
    refuses: bool = False
    turns: bool = False

    def __post_init__(self) -> None:
        columns = np.array(self.columns, dtype=np.float64)
        for row in columns[TABLE_HEAD if self.knots.size else 0 :]:
            sizes = np.abs(row)
            row[sizes < _VANISHING * np.max(sizes)] = 0.0
        object.__setattr__(self, "columns", columns)

    @property
    def n(self) -> int:
        """Number of cells."""
        return self.columns.shape[1]

    @cached_property
    def digest(self) -> str:
        """Digest of all that the functions of the table and its messages depend on."""
        text = hashlib.sha256(self.numbers.tobytes())
        text.update(f"{self.name} {self.is_kinked} {self.refuses} {self.turns}".encode())
        return text.hexdigest()[:16]

    @cached_property
    def numbers(self) -> Vector:
        """The table as the loop reads it, ``(k,)``.

        It begins with the number of cells, first and last knot, the number of buckets, and whether
        it refuses and turns. Knots, the first cell of every bucket and the columns follow. The
        least and the largest number of a column follow its cells.
        """
        head = np.zeros(_HEAD)
        head[0] = self.n
        head[4:] = self.refuses, self.turns
        parts = [head]
        if self.knots.size:
            buckets = self.n
            head[1:4] = self.knots[0], self.knots[-1], buckets
            edges = self.knots[0] + (self.knots[-1] - self.knots[0]) * np.arange(buckets) / buckets
            cells = np.array(np.searchsorted(self.knots, edges, side="right"), dtype=np.float64)
            parts += [self.knots, np.clip(cells - 2.0, 0.0, self.n - 1.0)]
        for column in self.columns:
            parts += [column, [float(np.min(column)), float(np.max(column))]]
        return np.concatenate(parts)

    def place_of(self, column: int) -> int:
        """Return the index of the first number of a column in `numbers`."""
        before = 2 * self.n + 1 if self.knots.size else 0
        return _HEAD + before + column * (self.n + 2)

    @cached_property
    def power(self) -> int:
        """The least `s` for which all columns times ``2**s`` are whole.

        Raises:
            ValueError: If the numbers are of too different sizes.
        """
        entries = np.abs(self.columns[self.columns != 0.0])
        if not entries.size:
            return 0
        wholes, exponents = np.frexp(entries)
        bits = (wholes * 2.0**53).astype(np.int64)
        lowest = int(np.min(exponents - 54 + np.frexp((bits & -bits).astype(np.float64))[1]))
        if int(np.max(exponents)) - lowest > 1000:
            raise ValueError(
                f"Argument `values` of {self.name} must be of comparable sizes, but the numbers of "
                f"its cells reach from {np.min(entries):.3g} to {np.max(entries):.3g}."
            )
        return -lowest

    def cell(self, *x: ca.SX) -> ca.SX:
        """Return the index of the cell of a value, or of cosine and sine of a phase."""
        found: Any = self._cells[Side.ALL](*x)
        return _ca.floor(found)

    def numbers_of(self, cell: ca.SX) -> list[ca.SX]:
        """Return the numbers of a cell, ``(m,)``."""
        found: Any = self._pick(cell)
        up, down = 2.0**self.power, 2.0**-self.power
        return [_ca.floor(found[k] * up) * down for k in range(self.columns.shape[0])]

    def guard(self, cell: ca.SX, x: Sequence[ca.SX]) -> ca.SX:
        r"""Return a formula that is zero at the ends of a cell, with slopes of one.

        It is :math:`(x - l)(r - x)/(r - l)` between knots `l` and `r`, of outer cells
        :math:`r - x` and :math:`x - l`, and that of `piecewise` for phases. Its sign changes
        nowhere else.

        Args:
            cell: Index of the cell.
            x: The value, or cosine and sine of a phase.
        """
        first, second, third, fourth = self.numbers_of(_ca.floor(cell))[:_GUARD]
        if self.turns:
            far = (x[0] + first) ** 2 + (x[1] + second) ** 2
            near = (x[0] - first) ** 2 + (x[1] - second) ** 2
            return (third * far - fourth * near) / 4
        u = x[0] - first
        return second + u * (third + u * fourth)

    def alternating(self, cell: ca.SX, x: Sequence[ca.SX]) -> ca.SX:
        """Return the guard of the cell of a value, negative in cells of an odd index."""
        k = _ca.floor(cell)
        return (1 - 2 * (k - 2 * _ca.floor(k / 2))) * self.guard(k, x)

    def on_side(self, side: Side) -> Any:
        """Return the function that finds the cells of a side."""
        return self._cells[side]

    @cached_property
    def _pick(self) -> Any:
        n, columns = self.n, self.columns
        if n == 1:
            columns = np.repeat(columns, 2, axis=1)
        places = np.arange(columns.shape[1], dtype=np.float64)
        options = {"lookup_mode": ["exact"], **_OPTIONS}
        name = f"pick_{self.digest}"
        del options["never_inline"]
        found = ca.interpolant(name, "linear", [places], columns.T.ravel(), options)
        return _kept(name, found, Lookup(table=self, side=None))

    @cached_property
    def _cells(self) -> dict[Side, Any]:
        made = self._cells_by_turn if self.turns else self._cell_function
        return {side: made(side) for side in Side}

    def on_phase(self, side: Side) -> Any:
        """Return the function that finds the cells of a side by the phase itself."""
        return self._phases[side]

    @cached_property
    def _phases(self) -> dict[Side, Any]:
        return {side: self._cell_function(side) for side in Side}

    def _cells_by_turn(self, side: Side) -> Any:
        """Return the function that finds a cell by cosine and sine of a phase."""
        c, s = ca.MX.sym("c"), ca.MX.sym("s")
        angle: Any = _ca.atan2(s, c)
        phase = _ca.if_else(angle < 0, angle + self.knots[-1], angle)
        name = f"turn{side.value}_{self.digest}"
        options = {**_OPTIONS, "is_diff_in": [False, False]}
        found = ca.Function(name, [c, s], [self.on_phase(side)(phase)], options)
        return _kept(name, found, Lookup(table=self, side=side))

    def _cell_function(self, side: Side) -> Any:
        """Return the function that finds a cell, by the same comparisons as the loop."""
        x, n = ca.MX.sym("x"), self.n
        index = ca.interpolant(
            "index", "linear", [self.knots], np.arange(n + 1.0), {"lookup_mode": ["binary"]}
        )
        ends = np.stack([self.knots[:-1], self.knots[1:]], axis=1)
        ends = np.repeat(ends, 2, axis=0) if n == 1 else ends
        places = np.arange(float(len(ends)))
        pair: Any = ca.interpolant("ends", "linear", [places], ends.ravel(), _EXACT)
        k: Any = _ca.fmin(_ca.fmax(_ca.floor(index(x)), 0), n - 1)
        around = pair(k)
        k = k - _ca.logic_and(x < around[0], k > 0) + _ca.logic_and(x >= around[1], k < n - 1)
        if side is not Side.ALL and n > 1:
            around = pair(k)
            is_odd = k - 2 * _ca.floor(k / 2)
            other = is_odd == 0 if side is Side.ODD else is_odd == 1
            nearer = _ca.if_else(2 * x < around[0] + around[1], k - 1, k + 1)
            if self.turns:
                nearer = _ca.if_else(nearer < 0, n - 1, _ca.if_else(nearer >= n, 0, nearer))
            else:
                nearer = _ca.if_else(k == 0, 1, _ca.if_else(k == n - 1, n - 2, nearer))
            k = _ca.if_else(other, nearer, k)
        # The comparisons are false for a number that is none.
        within = _ca.logic_and(x >= self.knots[0], x <= self.knots[-1]) if self.refuses else x == x
        name = f"cell{side.value}_{self.digest}"
        found = ca.Function(name, [x], [_ca.if_else(within, k, math.nan)], _OPTIONS)
        return _kept(name, found, Lookup(table=self, side=side))


_EXACT = {"lookup_mode": ["exact"]}


_known: dict[str, tuple[Any, Lookup]] = {}


def longest_step(y: ca.SX, rate: ca.SX) -> ca.SX | None:
    r"""Return the time in which no table of a flow passes what a step may pass, or ``None``.

    It is the end of a span of a smooth table, so that no step passes a pulse unseen. It is the
    middle of the next cell of a table whose knots are events, up to which a side has its formula.

    An argument `x` with the rate `v` and the second derivative `a` along the flow stays within the
    lengths :math:`d_+` ahead and :math:`d_-` behind it for

    .. math:: \min\left(\frac{2 d_+}{|v| + \sqrt{v^2 + 2 |a| d_+}},\
        \frac{|v| + \sqrt{v^2 + 2 |a| d_-}}{|a|}\right)

    Args:
        y: The states, ``(n_y,)``.
        rate: The flow, ``(n_y,)``.
    """
    found = [_time_within(*one, y, rate) for one in _looked_up(rate)]
    if not found:
        return None
    least = ca.SX(_FOREVER)
    for one in found:
        least = _ca.fmin(least, one)
    return least


_FOREVER = 1e300
"""A time that no step reaches."""


def _looked_up(formula: ca.SX) -> list[tuple[Lookup, list[ca.SX]]]:
    """Return the look-ups of cells in a formula, with their arguments."""
    if not lookups_in([formula]):
        return []
    function: Any = ca.Function("formula", ca.symvar(formula), [formula])
    nodes = function.instructions_sx()
    found: dict[tuple[str, tuple[int, ...]], tuple[Lookup, list[ca.SX]]] = {}
    for k in range(function.n_instructions()):
        lookup = called(nodes[k])[1] if function.instruction_id(k) == ca.OP_CALL else None
        if lookup is not None and lookup.side is not None:
            x = [nodes[k].dep(i) for i in range(nodes[k].n_dep())]
            key = f"{lookup.side} {lookup.table.digest}", tuple(one.element_hash() for one in x)
            found[key] = lookup, x
    return list(found.values())


def _time_within(lookup: Lookup, x: Sequence[ca.SX], y: ca.SX, rate: ca.SX) -> ca.SX:
    """Return the time in which an argument stays within the lengths of its cell."""
    table = lookup.table
    cell: Any = table.on_side(lookup.side or Side.ALL)(*x)
    numbers = table.numbers_of(_ca.floor(cell))
    (first, second), (width, behind, ahead) = numbers[:2], numbers[_GUARD:TABLE_HEAD]
    if table.turns:
        way = _ca.asin(x[1] * first - x[0] * second)
        c, s = (_ca.jtimes(one, y, rate) for one in x)
        speed, bend = x[0] * s - x[1] * c, ca.SX(0)
    else:
        way = x[0] - first
        speed = _ca.jtimes(x[0], y, rate)
        bend = _ca.fabs(_ca.jtimes(speed, y, rate))
    forward = speed >= 0
    on, back = ahead - way, behind + way
    near, far = _ca.if_else(forward, on, back), _ca.if_else(forward, back, on)
    fast = _ca.fabs(speed)
    until = 2 * near / (fast + _ca.sqrt(fast**2 + 2 * bend * near))
    if not bend.is_zero():
        until = _ca.fmin(until, (fast + _ca.sqrt(fast**2 + 2 * bend * far)) / bend)
    is_within = near > 0
    if table.is_kinked:
        # A side looks up some cell even far from its own, where nothing can be bounded.
        middle = ca.SX(0) if table.turns else width / 2
        is_within = _ca.fabs(way - middle) <= (0.5 + _AROUND) * width
    return _ca.if_else(is_within, until, _FOREVER)


def _kept(name: str, function: Any, lookup: Lookup) -> Any:
    """Return the function of a name, the first one that was made."""
    return _known.setdefault(name, (function, lookup))[0]


def lookup_of(function: Any) -> Lookup | None:
    """Return what a called function stands for, or ``None`` for any other function.

    Args:
        function: A `casadi.Function`.
    """
    found = _known.get(function.name())
    return None if found is None else found[1]


def called(node: Any) -> tuple[Any, Lookup | None]:
    """Return the function that an instruction calls, and what it stands for.

    Args:
        node: The instruction as `casadi.Function.instructions_sx` has it.
    """
    function = node.which_function()
    return function, lookup_of(function)


def called_table(function: ca.Function, k: int) -> str:
    """Return the name of the table that an instruction of a function looks up.

    Args:
        function: The function.
        k: Index of the instruction.
    """
    nodes: Any = function.instructions_sx()
    other, lookup = called(nodes[k])
    return f"the function `{other.name()}`" if lookup is None else lookup.table.name


def lookups_in(formulas: Sequence[ca.SX]) -> list[Lookup]:
    """Return the look-ups in formulas.

    Args:
        formulas: The formulas.
    """
    if not _known:
        return []
    flat = ca.SX(_ca.veccat(*formulas))
    function: Any = ca.Function("formulas", ca.symvar(flat), [flat])
    made = function.instructions_sx()
    found = [
        called(made[k])[1]
        for k in range(function.n_instructions())
        if function.instruction_id(k) == ca.OP_CALL
    ]
    return [one for one in found if one is not None]


def may_be_merged(formulas: Sequence[ca.SX]) -> bool:
    """Return True if CasADi finds common parts of formulas fast: not around a call of a table.

    Args:
        formulas: The formulas.
    """
    return not lookups_in(formulas)
