"""Plain lines and tables on standard output, one line of error on standard error.

Rich is imported with the first table: progress, errors and JSON do without it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from shutil import get_terminal_size
from textwrap import fill
from typing import TYPE_CHECKING, Any

from zeno_orbits.errors import printable
from zeno_orbits.report.table import Cell, Item, TableColumn

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

_FILE_WIDTH = 80
"""Width of tables in a file [characters]."""
_GAP = 2
"""Columns of space between the columns of a table."""


def print_lines(lines: Iterable[str], style: str = "") -> None:
    """Print sentences, unbroken to a file and broken between words in a terminal.

    Args:
        lines: The sentences. A continuation line has the indentation of the first line.
        style: Colour of the sentences in a terminal.
    """
    for line in map(printable, lines):
        shown = _folded(line) if sys.stdout.isatty() else line
        plain_console().print(shown, style=style, soft_wrap=True)


def _folded(line: str) -> str:
    """Return a line broken between words, as a terminal has room."""
    indent = " " * (len(line) - len(line.lstrip()))
    look: dict[str, Any] = {"break_long_words": False, "break_on_hyphens": False}
    return fill(line, line_width(), subsequent_indent=indent, **look)


def line_width() -> int:
    """Return the characters of a line of the terminal, or of a file."""
    return get_terminal_size().columns if sys.stdout.isatty() else _FILE_WIDTH


def print_whole(lines: Iterable[str]) -> None:
    """Print lines that a reader may copy, a path or a command: no end of line is put into one."""
    for line in lines:
        plain_console().print(printable(line), soft_wrap=True)


def print_error(message: str) -> None:
    """Print one line on standard error, broken between words in a terminal."""
    line = f"zeno-orbits: {printable(' '.join(message.split()))}"
    sys.stderr.write(f"{_folded(line) if sys.stderr.isatty() else line}\n")


def plain_console(width: int | None = None) -> Console:
    """Return a console that prints text as it is and leaves a broken pipe to the caller.

    Args:
        width: Characters per line, by default the width of the terminal.
    """
    from rich.console import Console

    class Plain(Console):
        def on_broken_pipe(self) -> None:
            """Raise the error in place of rich's exit."""
            raise BrokenPipeError

    return Plain(highlight=False, markup=False, width=width or line_width())


def print_table(
    columns: Sequence[TableColumn[Item]], items: Iterable[Item], repeated: int = 1
) -> None:
    """Print a table with one row per item, followed by an empty line.

    Words of text may go to the next line. No word, number or name is ever cut: a table that is too
    wide for the terminal even so is printed in parts.

    Args:
        columns: Its columns.
        items: The items, in order.
        repeated: Number of first columns that each part of a wide table contains.
    """
    columns = [replace(column, heading=printable(column.heading)) for column in columns]
    rows = [[_printable(column.cell(item)) for column in columns] for item in items]
    cells = [[row[k] for row in rows] for k in range(len(columns))]
    widths = _widths(columns, cells, line_width())
    for part in _parts(widths, line_width(), repeated):
        _print_part([(columns[k], widths[k], cells[k]) for k in part])


def _parts(widths: Sequence[int], room: int, repeated: int) -> list[list[int]]:
    """Return the indices of the columns of each part of a table."""
    first = list(range(min(repeated, len(widths))))
    parts = [first]
    for k in range(len(first), len(widths)):
        other = [*parts[-1], k]
        if len(parts[-1]) > len(first) and sum(widths[i] + _GAP for i in other) - _GAP > room:
            parts.append([*first, k])
        else:
            parts[-1] = other
    return parts


def _print_part(shown: Sequence[tuple[TableColumn[Item], int, Sequence[Cell]]]) -> None:
    """Print columns with their widths and cells, and an empty line."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    for column, width, _ in shown:
        side = "right" if column.is_number else "left"
        table.add_column(column.heading, width=width, overflow="fold", justify=side)
    for row in zip(*(cells for _, _, cells in shown), strict=True):
        table.add_row(*map(_shown, row))
    console = plain_console(max(line_width(), sum(width + _GAP for _, width, _ in shown)))
    console.print(table)
    console.print()


def _widths(
    columns: Sequence[TableColumn[Item]], cells: Sequence[Sequence[Cell]], room: int
) -> list[int]:
    """Return the widths of columns: the full widths, or a smaller width of the widest columns.

    Headings are broken first, which costs one line, and then the texts of cells.
    """
    pairs = list(zip(columns, cells, strict=True))
    widths = [max(_heading(c, whole=True), _cells(c, own, whole=True)) for c, own in pairs]
    for whole in (True, False):
        least = [max(_heading(c, whole=False), _cells(c, own, whole=whole)) for c, own in pairs]
        while sum(widths) + _GAP * (len(widths) - 1) > room:
            spare = [k for k in range(len(widths)) if widths[k] > least[k]]
            if not spare:
                break
            widths[max(spare, key=lambda k: widths[k])] -= 1
    return widths


def _heading(column: TableColumn[Item], *, whole: bool) -> int:
    """Return the width of a heading, or of its longest word."""
    return max(map(len, [column.heading] if whole else column.heading.split()), default=0)


def _cells(column: TableColumn[Item], cells: Sequence[Cell], *, whole: bool) -> int:
    """Return the width of the longest cell, or of the longest word where text may be wrapped."""
    texts = [cell for cell in cells if isinstance(cell, str)]
    if not (whole or column.is_number or column.is_whole):
        texts = [word for text in texts for word in text.split()]
    return max(map(len, [*texts, "ok"]))


def _printable(cell: Cell) -> Cell:
    return printable(cell) if isinstance(cell, str) else cell


def _shown(cell: Cell) -> str | Text:
    from rich.text import Text

    if isinstance(cell, bool):
        return Text("ok", "green") if cell else Text("no", "red")
    return cell
