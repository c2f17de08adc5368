"""Plain lines and tables on standard output, one line of error on standard error.

Rich is imported with the first table: progress, errors and JSON need none of it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table


def print_lines(lines: Iterable[str]) -> None:
    """Print plain lines."""
    for line in lines:
        plain_console().print(line, soft_wrap=True)


def print_error(message: str) -> None:
    """Print one line on standard error."""
    sys.stderr.write(f"zeno-orbits: {' '.join(message.split())}\n")


def table_of(*columns: str) -> Table:
    """Return an empty table with these heads."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    for column in columns:
        table.add_column(column)
    return table


def plain_console() -> Console:
    """Return a console that prints text as it is and leaves a broken pipe to the caller."""
    from rich.console import Console

    class Plain(Console):
        def on_broken_pipe(self) -> None:
            """Say so; rich would exit."""
            raise BrokenPipeError

    # A file has no width of its own; a hundred columns split no cell of ours.
    width = None if sys.stdout.isatty() else 100
    return Plain(highlight=False, markup=False, width=width)


def print_table(table: Table) -> None:
    """Print a table and a line of space."""
    console = plain_console()
    console.print(table)
    console.print()
