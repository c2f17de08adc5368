"""Results as tables: in notebooks and as data frames of pandas."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from zeno_orbits.errors import InputError
from zeno_orbits.work.values import ByValue

Columns = Mapping[str, Any]
"""Column name to entries, lists or arrays of the same length."""

_MOST_ROWS = 12
"""Number of rows in a notebook."""
_RULES = "border-collapse:collapse;font-variant-numeric:tabular-nums"


class TableRepr(ByValue):
    """A result that can also be shown as a table."""

    __slots__ = ()

    def to_pandas(self) -> Any:
        """Return the result as a `pandas.DataFrame`, numbers in the units of the problem.

        Raises:
            InputError: If pandas is not installed.
        """
        try:
            pandas: Any = importlib.import_module("pandas")
        except ImportError as error:
            message = "A table needs pandas: run `pip install 'zeno_orbits[tables]'`"
            raise InputError(f"{message} ({error}).") from error
        return pandas.DataFrame(dict(self._columns()))

    def _columns(self) -> Columns:
        """Return the whole table."""
        raise NotImplementedError

    def _shown_columns(self) -> Columns:
        """Return the table whose first rows a notebook shows."""
        return self._columns()

    def _repr_html_(self) -> str:
        """Return the printed form, followed by the first rows of the table."""
        columns = self._shown_columns()
        rows = list(zip(*columns.values(), strict=True))
        head = "".join(f"<th>{escape(name)}</th>" for name in columns)
        body = "".join(
            f"<tr>{''.join(f'<td>{escape(_cell(one))}</td>' for one in row)}</tr>"
            for row in rows[:_MOST_ROWS]
        )
        more = len(rows) - _MOST_ROWS
        rest = f"<p>and {more} more rows</p>" if more > 0 else ""
        table = f'<table style="{_RULES}"><tr>{head}</tr>{body}</table>' if rows else ""
        return f'<pre style="white-space:pre-wrap">{escape(repr(self))}</pre>{table}{rest}'


def _cell(value: Any) -> str:
    """Return an entry as text, with numbers rounded to seven digits."""
    return f"{value:.7g}" if isinstance(value, float) else str(value)


def by_name(entries: Sequence[Mapping[str, float]]) -> dict[str, list[float]]:
    """Return columns, name to values, of entries with the same names or part of them.

    Args:
        entries: Name to value, one entry per row. A missing name becomes NaN.
    """
    names = dict.fromkeys(name for entry in entries for name in entry)
    return {name: [entry.get(name, float("nan")) for entry in entries] for name in names}
