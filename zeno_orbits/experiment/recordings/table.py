"""Tables of values in text files with any separator, decimal commas, gaps and incomplete rows.

A file of ten million rows is read in pieces by NumPy's parser. Only a piece that this parser
rejects is read line by line, which finds the invalid line.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import DataFileError
from zeno_orbits.experiment.recordings.heads import (
    COMMENT,
    MISSING,
    Head,
    number_of,
    short,
)
from zeno_orbits.experiment.recordings.text_files import opened, pieces_of

_CLOCK = re.compile(r"\d:\d\d")
"""A time of the day."""
_THOUSANDS = re.compile(r"[-+]?\d{1,3}([.,]\d{3})+([.,]\d+)?")
"""A number with separators between its thousands."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ColumnTable:
    """Chosen columns of a table.

    Attributes:
        values: One row per column, ``(n_columns, n_rows)``. A missing value is NaN.
        lines: Number in the file of each row's line, ``(n_rows,)``.
        remarks: Omitted rows with reasons.
    """

    values: Vector
    lines: NDArray[np.int64]
    remarks: tuple[str, ...]


def read_table(path: Path, head: Head, chosen: Sequence[int]) -> ColumnTable:
    """Return the values of chosen columns.

    An incomplete last line without a line end is omitted, because a logger that is switched off
    leaves such a line. Any other invalid line is an error.

    Args:
        path: The file.
        head: Header of the file.
        chosen: Indices of the columns, from 0.

    Raises:
        DataFileError: If a line has a different number of columns, or a text in place of a value.
    """
    reader = _Reader(path, head, tuple(chosen))
    with opened(path) as file:
        for piece in pieces_of(file):
            reader.take(piece)
    return reader.table()


class _Reader:
    """Collector of the pieces of one file, used for a single reading."""

    def __init__(self, path: Path, head: Head, chosen: tuple[int, ...]) -> None:
        self.path, self.head, self.chosen = path, head, chosen
        self.blocks: list[tuple[Vector, NDArray[np.int64]] | None] = []
        self.remarks: list[str] = []
        self.decimal = ""
        self.line = 0

    def take(self, piece: str) -> None:
        """Read one piece of whole lines."""
        first, self.line = self.line + 1, self.line + piece.count("\n")
        if not piece.endswith("\n"):
            self.line += 1
        if first <= self.head.last:
            skipped = min(self.head.last - first + 1, piece.count("\n") + 1)
            for _ in range(skipped):
                _, _, piece = piece.partition("\n")
            first += skipped
        if piece:
            values = self.quick(piece)
            if values is None:
                self.blocks.append(self.slow(piece, first))
            else:
                lines = np.arange(first, first + len(values), dtype=np.int64)
                self.blocks.append((values, lines))

    def quick(self, piece: str) -> Vector | None:
        """Return the rows of a piece by the library's parser, or nothing if it is not all plain."""
        n_rows, separator = piece.count("\n"), self.head.separator
        plain = piece.endswith("\n") and "#" not in piece and '"' not in piece
        if not plain or piece.count(separator) != n_rows * (len(self.head.columns) - 1):
            return None
        if separator != "," and "," in piece:
            if "." in piece or self.decimal == ".":
                return None
            self.decimal, piece = ",", piece.replace(",", ".")
        elif "." in piece:
            if self.decimal == ",":
                return None
            self.decimal = "."
        if separator + separator in piece or separator + "\n" in piece:
            # Empty entries, twice: a run of three separators holds two of them.
            for _ in range(2):
                piece = piece.replace(2 * separator, f"{separator}nan{separator}")
            piece = piece.replace(f"{separator}\n", f"{separator}nan\n")
        try:
            values = np.loadtxt(
                io.StringIO(piece),
                delimiter=separator,
                usecols=self.chosen,
                comments=None,
                ndmin=2,
            )
        except ValueError:
            return None
        return values if len(values) == n_rows else None

    def slow(self, piece: str, first: int) -> tuple[Vector, NDArray[np.int64]]:
        """Return the rows of a piece, line by line."""
        rows: list[list[float]] = []
        lines: list[int] = []
        texts = piece.split("\n")
        for k, text in enumerate(texts):
            if not text.strip() or text.lstrip().startswith("#"):
                continue
            cut_short = k == len(texts) - 1
            row = self.row(text, first + k, cut_short=cut_short)
            if row is not None:
                rows.append(row)
                lines.append(first + k)
        values = np.array(rows, dtype=np.float64).reshape(-1, len(self.chosen))
        return values, np.array(lines, dtype=np.int64)

    def row(self, text: str, line: int, *, cut_short: bool) -> list[float] | None:
        parts = [part.strip().strip('"').strip() for part in text.split(self.head.separator)]
        n_columns = len(self.head.columns)
        if len(parts) == n_columns - 1 and self.head.columns[-1].lower() == COMMENT:
            parts.append("")
        if len(parts) < n_columns and cut_short:
            self.remarks.append(f"line {line}, the last, is cut short and was left out")
            return None
        if len(parts) != n_columns:
            # A trailing separator makes an empty column. Titles without a trailing separator have
            # one column less.
            if len(parts) == n_columns + 1 and not parts[-1]:
                parts.pop()
            else:
                raise DataFileError(self.path, self.miscounted(line, len(parts)))
        return [self.entry(parts[k], k, line) for k in self.chosen]

    def entry(self, text: str, column: int, line: int) -> float:
        if text.lower() in MISSING:
            return math.nan
        sign = "," if "," in text else "." if "." in text else ""
        if sign and self.decimal and sign != self.decimal:
            reason = f"writes decimals with `{sign}` and other lines with `{self.decimal}`"
            raise DataFileError(self.path, f"line {line} {reason}: `{short(text)}`")
        self.decimal = sign or self.decimal
        number = number_of(text.replace(",", ".")) if text.count(",") < 2 else None
        if number is None:
            title = self.head.columns[column]
            message = f"line {line} has `{short(text)}` where column `{title}` has a number"
            if _CLOCK.search(text):
                raise DataFileError(self.path, f"{message}: write seconds since the start")
            if _THOUSANDS.fullmatch(text):
                raise DataFileError(self.path, f"{message}: write it without thousands separators")
            raise DataFileError(self.path, f"{message}: correct or empty it")
        return number

    def miscounted(self, line: int, found: int) -> str:
        n_columns = len(self.head.columns)
        columns = f"{found} column{'s' if found != 1 else ''}"
        message = f"line {line} has {columns} where line {self.head.line} names {n_columns}"
        if self.head.separator == "," and found == 2 * n_columns:
            return f"{message}; with decimal commas, separate the columns by semicolons or tabs"
        if found == 1 < n_columns and self.head.separator.strip():
            return f"{message}, separated by `{self.head.separator}`: use one separator"
        return f"{message}: correct or delete the line"

    def table(self) -> ColumnTable:
        n_rows = sum(len(block[1]) for block in self.blocks if block is not None)
        values = np.empty((len(self.chosen), n_rows))
        lines = np.empty(n_rows, dtype=np.int64)
        at = 0
        for k, block in enumerate(self.blocks):
            if block is not None:
                after = at + len(block[1])
                values[:, at:after], lines[at:after] = block[0].T, block[1]
                at = after
            # Each piece is given back as soon as it is copied, so that only one copy is held.
            self.blocks[k] = None
        return ColumnTable(values=values, lines=lines, remarks=tuple(self.remarks))
