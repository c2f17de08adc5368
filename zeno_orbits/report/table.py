"""Tables as data: each column consists of a heading and a function from an item to its cell.

The terminal and the page print the same tables. A new column is one entry of a list.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

Item = TypeVar("Item")

Cell = str | bool
"""A text, or whether something holds."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TableColumn(Generic[Item]):
    """A column of a table.

    Attributes:
        heading: Its heading, with a unit in brackets where it has one.
        cell: Function from an item to its cell.
        is_number: Whether it holds numbers, which are set to the right.
        is_whole: Whether its cells must be legible whole in a narrow terminal, as names that a
            reader will type must be.
    """

    heading: str
    cell: Callable[[Item], Cell]
    is_number: bool = False
    is_whole: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Table(Generic[Item]):
    """A table.

    Attributes:
        caption: Its subject.
        columns: Its columns.
        rows: The cells, row by row.
        is_titled: Whether a title above the table already contains its caption.
    """

    caption: str
    columns: tuple[TableColumn[Item], ...]
    rows: tuple[tuple[Cell, ...], ...]
    is_titled: bool = False


def shown_number(value: float, digits: int) -> str:
    """Return a value to some digits. Zero is 0, without sign."""
    return f"{value + 0.0:.{digits}g}"


def shown_with_error(value: float, error: float, *, sign: str = "") -> str:
    """Return a value to the second digit of its error, or to seven digits for an unknown error.

    Args:
        value: The value.
        error: Its standard error.
        sign: ``+`` to show the sign of a positive value.
    """
    if not (math.isfinite(error) and error > 0.0):
        return f"{value + 0.0:{sign}.7g}"
    decimals = 1 - math.floor(math.log10(error))
    if decimals > 14 or decimals < 0:
        return f"{value + 0.0:{sign}.3g}"
    rounded = round(value, decimals) + 0.0
    return f"{rounded:{sign}.{decimals}f}" if abs(rounded) >= 1e-4 else f"{rounded:{sign}.2g}"


def prefixed(unit: str, *sizes: float) -> tuple[str, float]:
    """Return a unit with a prefix for small quantities, and its size in the unit.

    Args:
        unit: A unit. Its first symbol takes the prefix, if it may have one.
        sizes: Quantities in this unit. The largest quantity determines the prefix.
    """
    size = max((abs(one) for one in sizes if math.isfinite(one)), default=0.0)
    symbol = re.match(r"[A-Za-z]+(?![A-Za-z^])", unit)
    if symbol is None or symbol[0] not in _PREFIXED or not _NO_SIZE < size < _SMALL:
        return unit, 1.0
    for prefix, factor in _PREFIXES:
        if size >= factor or prefix == _PREFIXES[-1][0]:
            return prefix + unit, factor
    return unit, 1.0


_PREFIXED = frozenset({"s", "m", "rad", "A", "V", "N", "J", "W"})
_PREFIXES = (("m", 1e-3), ("u", 1e-6), ("n", 1e-9))
_SMALL, _NO_SIZE = 1e-2, 1e-15
"""Quantities below the first value get a prefix. Quantities below the second value are rounding."""


def shown_size(size: float) -> str:
    """Return the size of an error to two digits. Zero is 0."""
    return "0" if size == 0.0 else f"{size:.1e}"


def shown_multiplier(value: float, error: float, digits: int) -> str:
    """Return a part of a Floquet multiplier, or 0 if it is smaller than its error.

    Args:
        value: Its real part, imaginary part or modulus.
        error: Error of the largest multiplier.
        digits: Digits to show.
    """
    return "0" if abs(value) < min(error, _NOTHING) else f"{value:.{digits}g}"


def shown_complex(value: complex, error: float, digits: int) -> str:
    """Return a Floquet multiplier without parts that are smaller than its error.

    Args:
        value: The multiplier.
        error: Error of the largest multiplier.
        digits: Digits to show.
    """
    real, imaginary = (shown_multiplier(p, error, digits) for p in (value.real, value.imag))
    if imaginary == "0":
        return real
    return f"{real} {'' if imaginary.startswith('-') else '+'}{imaginary} i"


def shown_multipliers(values: Sequence[complex], error: float, digits: int) -> str:
    """Return Floquet multipliers in a row, and the number of those below rounding.

    Args:
        values: The multipliers, the largest first.
        error: Error of the largest multiplier.
        digits: Digits to show.
    """
    every = [shown_complex(value, error, digits) for value in values]
    known = [text for text in every if text != "0"]
    zeros = len(every) - len(known)
    if zeros:
        known.append(BELOW_ROUNDING if zeros == 1 else f"{zeros} x {BELOW_ROUNDING}")
    return ", ".join(known)


BELOW_ROUNDING = "0 (below rounding)"
"""A multiplier that is smaller than its error."""
_NOTHING = 1e-9
"""A multiplier above this value is printed even if its uncertainty is large."""


def text_column(heading: str, cell: Callable[[Item], Cell]) -> TableColumn[Item]:
    """Return a column of text."""
    return TableColumn(heading=heading, cell=cell)


def number_column(heading: str, cell: Callable[[Item], str]) -> TableColumn[Item]:
    """Return a column of values."""
    return TableColumn(heading=heading, cell=cell, is_number=True)


def name_column(heading: str, cell: Callable[[Item], str]) -> TableColumn[Item]:
    """Return a column of names that a reader may type: they are never cut."""
    return TableColumn(heading=heading, cell=cell, is_whole=True)


def table_of(
    caption: str, columns: Sequence[TableColumn[Item]], items: Iterable[Item]
) -> Table[Item]:
    """Return a table with one row per item.

    Args:
        caption: Its subject.
        columns: Its columns.
        items: The items, in order.
    """
    rows = tuple(tuple(column.cell(item) for column in columns) for item in items)
    return Table(caption=caption, columns=tuple(columns), rows=rows)


def _limit(value: object) -> str:
    return f"{value:.8g}" if isinstance(value, int | float) else "-"


BOUNDS: list[TableColumn[Mapping[str, Any]]] = [
    text_column("to be kept", lambda one: str(one.get("quantity", ""))),
    number_column("from", lambda one: _limit(one.get("lower"))),
    number_column("to", lambda one: _limit(one.get("upper"))),
    number_column("reached from", lambda one: _limit(one.get("lowest"))),
    number_column("reached to", lambda one: _limit(one.get("highest"))),
]
"""Columns of the bounds of a search, from its certificate."""


def with_unit(value: str, unit: str) -> str:
    """Return a value with its unit, if it has a unit.

    Args:
        value: The value as text.
        unit: Unit of the value, or ``1`` for a pure number.
    """
    return value if unit == "1" else f"{value} {unit}"
