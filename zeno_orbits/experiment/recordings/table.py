"""Tables of values in text files with any separator, decimal commas, gaps and incomplete rows.

A file of ten million rows is read in pieces by NumPy's parser. Only a piece that this parser
rejects is read line by line, which finds the invalid line.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import CONTROLS, DataFileError

_PIECE = 1 << 22
"""Bytes per piece: large enough for an efficient parser, and small compared with the values."""

_SEPARATORS = ("\t", ";", ",")
"""In the order of the search: a comma may also be a decimal sign."""

_MISSING = frozenset({"", "-", "nan", "na", "n/a", "#n/a", "null", "none", "missing"})
"""Marks for a missing value, in lower case."""

_TIME_ALONE = re.compile(r"t(ime)?\s*([\[(][^\])]*[\])])?", flags=re.IGNORECASE)
"""A line of titles that names the time and nothing else."""

_UTF16 = (b"\xff\xfe", b"\xfe\xff")


@dataclass(frozen=True, slots=True, kw_only=True)
class Head:
    """Header of a file: the lines above the values.

    Attributes:
        comments: The lines that begin with ``#``, without it.
        columns: The titles, as they are written.
        separator: Between columns.
        line: Number of the line of titles, from 1.
    """

    comments: tuple[str, ...]
    columns: tuple[str, ...]
    separator: str
    line: int


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


def read_head(path: Path) -> Head:
    """Return the header of a file.

    Raises:
        DataFileError: If the file cannot be read, is not text, or lacks a line of titles.
    """
    comments: list[str] = []
    with _opened(path) as file:
        for number, line in enumerate(_lines(_pieces(file)), start=1):
            text = line.strip()
            if text.startswith("#"):
                comments.append(text[1:].strip())
            elif text:
                return _head(path, text, tuple(comments), number)
    raise DataFileError(path, "a line of column titles is missing, such as `time [s],angle [rad]`")


def _head(path: Path, text: str, comments: tuple[str, ...], line: int) -> Head:
    if text[0] in "{[":
        raise DataFileError(path, f"it is JSON and no table. Line {line} must hold column titles")
    separator = next((one for one in _SEPARATORS if one in text), None)
    if separator is None and _TIME_ALONE.fullmatch(text):
        told = f"line {line} names one column, `{_short(text)}`"
        remedy = "separate the columns by commas, semicolons or tabs, and record a signal"
        raise DataFileError(path, f"{told}: {remedy}")
    if separator is None:
        wanted = "must separate its columns by commas, semicolons or tabs"
        raise DataFileError(path, f"line {line} {wanted}: `{_short(text)}`")
    columns = tuple(part.strip().strip('"').strip() for part in text.split(separator))
    if any(map(CONTROLS.search, columns)):
        raise DataFileError(path, f"line {line} holds control characters in a title")
    if all(_number(part.replace(",", ".")) is not None for part in columns):
        raise DataFileError(
            path,
            f"line {line} holds numbers in place of the column titles: add a line such as "
            "`time [s],angle [rad]`",
        )
    return Head(comments=comments, columns=columns, separator=separator, line=line)


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
    with _opened(path) as file:
        for piece in _pieces(file):
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
        if first <= self.head.line:
            skipped = min(self.head.line - first + 1, piece.count("\n") + 1)
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
        if text.lower() in _MISSING:
            return math.nan
        sign = "," if "," in text else "." if "." in text else ""
        if sign and self.decimal and sign != self.decimal:
            reason = f"writes decimals with `{sign}` and other lines with `{self.decimal}`"
            raise DataFileError(self.path, f"line {line} {reason}: `{_short(text)}`")
        self.decimal = sign or self.decimal
        number = _number(text.replace(",", ".")) if text.count(",") < 2 else None
        if number is None:
            title = self.head.columns[column]
            message = f"line {line} has `{_short(text)}` where column `{title}` has a number"
            raise DataFileError(self.path, f"{message}: correct or empty it")
        return number

    def miscounted(self, line: int, found: int) -> str:
        n_columns = len(self.head.columns)
        columns = f"{found} column{'s' if found != 1 else ''}"
        message = f"line {line} has {columns} where line {self.head.line} names {n_columns}"
        if self.head.separator == "," and found == 2 * n_columns:
            return f"{message}; with decimal commas, separate the columns by semicolons or tabs"
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


def _opened(path: Path) -> BinaryIO:
    try:
        if not path.is_dir() and path.exists() and not path.is_file():
            # A pipe or a device may not end.
            raise DataFileError(path, "it is a pipe or a device, and not a file")
        return path.open("rb")
    except OSError as error:
        raise DataFileError(path, f"it cannot be read ({error.strerror})") from error


def _pieces(file: BinaryIO) -> Iterator[str]:
    """Yield a file in pieces of whole lines with normalised line ends. The last line may be cut."""
    path = Path(file.name)
    rest = b""
    first = True
    while data := file.read(_PIECE):
        if first and data.startswith(_UTF16):
            raise DataFileError(path, "it is UTF-16 text; save it as UTF-8")
        if b"\0" in data:
            raise DataFileError(
                path, "it holds zero bytes, which no text has: save it as text, such as CSV"
            )
        data = rest + (data.removeprefix(b"\xef\xbb\xbf") if first else data)
        first = False
        # A return at the very end may be half of the pair that ends a line in other systems.
        end = max(data.rfind(b"\n"), data.rfind(b"\r", 0, len(data) - 1)) + 1
        rest = data[end:]
        if end:
            yield _text(data[:end])
    if rest:
        yield _text(rest)


def _text(data: bytes) -> str:
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def _lines(pieces: Iterator[str]) -> Iterator[str]:
    for piece in pieces:
        yield from piece.removesuffix("\n").split("\n")


def _number(text: str) -> float | None:
    # `float` reads underscores too, which no instrument writes.
    if "_" in text:
        return None
    try:
        return float(text)
    except ValueError:
        return None


def _short(text: str) -> str:
    return text if len(text) <= 40 else text[:37] + "..."
