"""Tables as data: a column is a heading and a function from an item to its cell.

The terminal and the page both print these; a new column is one entry of a list.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

Item = TypeVar("Item")

Cell = str | bool
"""A text, or whether something holds."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Column(Generic[Item]):
    """A column of a table.

    Attributes:
        heading: Its heading, with a unit in brackets where it has one.
        cell: From an item to its cell.
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
        is_titled: Whether it stands under a title that says its caption already.
    """

    caption: str
    columns: tuple[Column[Item], ...]
    rows: tuple[tuple[Cell, ...], ...]
    is_titled: bool = False


def shown_number(value: float, digits: int) -> str:
    """Return a number to some digits; zero is 0, without sign."""
    return f"{value + 0.0:.{digits}g}"


def shown_size(size: float) -> str:
    """Return the size of an error to two digits; zero is 0."""
    return "0" if size == 0.0 else f"{size:.1e}"


def shown_multiplier(value: float, error: float, digits: int) -> str:
    """Return a part of a Floquet multiplier; what is smaller than its error is 0.

    Args:
        value: Its real part, imaginary part or modulus.
        error: Error of the largest multiplier.
        digits: Digits to show.
    """
    return "0" if abs(value) < min(error, _NOTHING) else f"{value:.{digits}g}"


def shown_complex(value: complex, error: float, digits: int) -> str:
    """Return a Floquet multiplier; parts that are smaller than its error are left out.

    Args:
        value: The multiplier.
        error: Error of the largest multiplier.
        digits: Digits to show.
    """
    real, imaginary = (shown_multiplier(p, error, digits) for p in (value.real, value.imag))
    if imaginary == "0":
        return real
    return f"{real} {'' if imaginary.startswith('-') else '+'}{imaginary} i"


_NOTHING = 1e-9
"""A multiplier above this is told, however uncertain it is."""


def text_column(heading: str, cell: Callable[[Item], Cell]) -> Column[Item]:
    """Return a column of text."""
    return Column(heading=heading, cell=cell)


def number_column(heading: str, cell: Callable[[Item], str]) -> Column[Item]:
    """Return a column of numbers."""
    return Column(heading=heading, cell=cell, is_number=True)


def name_column(heading: str, cell: Callable[[Item], str]) -> Column[Item]:
    """Return a column of names that a reader may type: they are never cut."""
    return Column(heading=heading, cell=cell, is_whole=True)


def table_of(caption: str, columns: Sequence[Column[Item]], items: Iterable[Item]) -> Table[Item]:
    """Return a table with a row an item.

    Args:
        caption: Its subject.
        columns: Its columns.
        items: The items, in order.
    """
    rows = tuple(tuple(column.cell(item) for column in columns) for item in items)
    return Table(caption=caption, columns=tuple(columns), rows=rows)


def _limit(value: object) -> str:
    return f"{value:.8g}" if isinstance(value, int | float) else "-"


BOUNDS: list[Column[Mapping[str, Any]]] = [
    text_column("to be kept", lambda one: str(one.get("quantity", ""))),
    number_column("from", lambda one: _limit(one.get("lower"))),
    number_column("to", lambda one: _limit(one.get("upper"))),
    number_column("reached from", lambda one: _limit(one.get("lowest"))),
    number_column("reached to", lambda one: _limit(one.get("highest"))),
]
"""Of the bounds that a search was asked to keep, as its certificate has them."""
