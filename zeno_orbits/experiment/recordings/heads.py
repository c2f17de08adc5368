"""The head of a table of values in a text file: its separator, its titles, and where values begin.

Instruments write lines of their own above the titles, and some write the units in a line below
them. Values begin at the first line whose columns of numbers go on.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

from zeno_orbits.errors import CONTROLS, DataFileError
from zeno_orbits.experiment.recordings.text_files import opened, pieces_of
from zeno_orbits.model import in_si

_SEPARATORS = ("\t", ";", ",")
"""In the order of the search: a comma may also be a decimal sign."""

MISSING = frozenset(
    {
        *("", "-", "--", "nan", "na", "n/a", "#n/a", "null", "none", "missing", "x"),
        *("1.#qnan", "-1.#qnan", "1.#ind", "-1.#ind"),
    }
)
"""Marks for a missing value, in lower case. Logic analysers write `X`, old programs `1.#QNAN`."""

_TIME_ALONE = re.compile(r"t(ime)?\s*([\[(][^\])]*[\])])?", flags=re.IGNORECASE)
"""A line of titles that names the time and nothing else."""

_LABELLED = re.compile(r"[^\d\s:][^:]*:\s*[-+.\d][-+.\deE]*")
"""An entry that names its quantity beside the number."""
COMMENT = "comment"
"""Title of a last column, in lower case, that lines of values may lack."""
_MOST_LINES = 400
"""Lines in which the values must begin."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Head:
    """Header of a file: the lines above the values.

    Attributes:
        comments: The lines that begin with ``#``, without it.
        columns: The titles, as they are written, or numbers from 1 without titles.
        units: What the line below the titles says of each column, or empty without such a line.
        numeric: For each column, whether the first line of values has a number, or a mark for a
            missing value.
        separator: Between columns.
        line: Number of the line of titles, from 1.
        last: Number of the last line above the values.
    """

    comments: tuple[str, ...]
    columns: tuple[str, ...]
    separator: str
    line: int
    last: int
    units: tuple[str, ...] = ()
    numeric: tuple[bool, ...] = ()


def read_head(path: Path, *, untitled: bool = False) -> Head:
    """Return the header of a file.

    Args:
        path: The file.
        untitled: Whether a file without titles is accepted. Its columns are numbered.

    Raises:
        DataFileError: If the file cannot be read, is not text, or lacks a line of titles.
    """
    comments: list[str] = []
    lines: list[tuple[int, str]] = []
    with opened(path) as file:
        for number, line in enumerate(islice(_lines(pieces_of(file)), _MOST_LINES), start=1):
            text = line.strip()
            if text.startswith("#") and not lines:
                comments.append(text[1:].strip())
            elif text and not text.startswith("#"):
                # A separator at an end stands for an empty entry.
                lines.append((number, line.strip(" \r")))
    if not lines:
        raise DataFileError(
            path, "a line of column titles is missing, such as `time [s],angle [rad]`"
        )
    head = _above_values(lines, tuple(comments), untitled=untitled)
    if head is None:
        number, text = lines[0]
        head = _of_titles(path, text.strip(), tuple(comments), number)
    earlier = next((n for n, text in lines if n < head.line and _is_like(text, head)), None)
    if earlier is not None and head.numeric:
        told = f"line {earlier} has values above the titles in line {head.line}"
        raise DataFileError(path, f"{told}: split the file there, or delete the part above")
    if any(map(CONTROLS.search, head.columns)):
        raise DataFileError(path, f"line {head.line} holds control characters in a title")
    return head


def _is_like(text: str, head: Head) -> bool:
    """Return True if a line has numbers in the columns of numbers of a header."""
    row = _parts(text, head.separator)
    known = zip(_numbers(row, missing=True), head.numeric, strict=False)
    fits = len(row) in (len(head.columns), len(head.columns) - 1)
    return fits and sum(_numbers(row)) > 1 and all(one for one, wanted in known if wanted)


def _above_values(
    lines: Sequence[tuple[int, str]], comments: tuple[str, ...], *, untitled: bool
) -> Head | None:
    """Return the header above the first lines of values, or ``None`` if values come first.

    Args:
        lines: Number and text of each line.
        comments: The comments above.
        untitled: Whether titles may be missing.
    """
    best: tuple[int, int, str] | None = None
    for separator in _SEPARATORS:
        rows = [_parts(text, separator) for _, text in lines]
        first = next((k for k, row in enumerate(rows) if _go_on(row, rows[k + 1 :])), None)
        n_found = 0 if first is None else sum(_numbers(rows[first]))
        if first is not None and (best is None or n_found > best[0]):
            best = n_found, first, separator
    if best is None:
        return None
    _, first, separator = best
    return _head_at(lines, first, separator, comments, untitled=untitled)


def _head_at(
    lines: Sequence[tuple[int, str]],
    first: int,
    separator: str,
    comments: tuple[str, ...],
    *,
    untitled: bool,
) -> Head | None:
    """Return the header of values that begin at a line, or ``None`` if no titles fit them."""
    values = _parts(lines[first][1], separator)
    last = lines[first - 1][0] if first else lines[0][0] - 1
    above = [_parts(text, separator) for _, text in lines[max(0, first - 2) : first]]
    if above and len(above[-1]) == len(values) + 1 and above[-1][-1].lower() == COMMENT:
        values.append("no comment")
    numeric = _numbers(values, missing=True)
    titles = above[-1] if above and _names(above[-1], values) else None
    # A wrong line among the values is no line of titles, and those above it are not left out.
    numbers = [_numbers(row) for row in above]
    is_cut = titles is None and bool(above) and len(above[-1]) == len(values) and any(numbers[-1])
    if is_cut or (titles is None and not untitled) or _numbers(values) in numbers[:-1]:
        return None
    head = Head(
        comments=comments,
        columns=tuple(titles or (str(k + 1) for k in range(len(values)))),
        separator=separator,
        line=last,
        last=last,
        numeric=numeric,
    )
    has_units = titles is not None and len(above) == 2 and _are_units(titles, numeric)
    if titles is None or not has_units or not _names(above[0], values):
        return head
    units = tuple(map(_unit_said, titles))
    return replace(head, columns=tuple(above[0]), units=units, line=lines[first - 2][0])


def _names(row: Sequence[str], values: Sequence[str]) -> bool:
    """Return True if a line names each column of numbers, and no line of values is as long."""
    fits = len(row) == len(values) or (len(values) == len(row) + 1 and not values[-1])
    numbers = _numbers(values)
    return fits and all(
        title and number_of(title.replace(",", ".")) is None
        for title, is_number in zip(row, numbers, strict=False)
        if is_number
    )


def _are_units(row: Sequence[str], numeric: Sequence[bool]) -> bool:
    """Return True if a line has a unit for every column of numbers that it says something of."""
    said = [_unit_said(one) for one, is_number in zip(row, numeric, strict=False) if is_number]
    return any(said) and all(not one or _is_unit(one) for one in said)


def _unit_said(text: str) -> str:
    """Return a unit without brackets. Some instruments write `Volt` for `volt`."""
    unit = text.strip("()[]")
    return unit if _is_unit(unit) or not _is_unit(unit.lower()) else unit.lower()


def _is_unit(text: str) -> bool:
    try:
        in_si(text)
    except ValueError:
        return False
    return True


def _numbers(row: Sequence[str], *, missing: bool = False) -> tuple[bool, ...]:
    """Return for each entry of a line whether it is a number, or also a mark for none."""
    return tuple(
        (missing and part.lower() in MISSING)
        or (part.count(",") < 2 and number_of(part.replace(",", ".")) is not None)
        for part in row
    )


def _go_on(row: Sequence[str], later: Sequence[Sequence[str]]) -> bool:
    """Return True if a line has numbers, and later lines have numbers or gaps in their columns."""
    here = _numbers(row)
    if len(row) < 2 or not any(here):
        return False
    for other in later:
        there, gaps = _numbers(other), _numbers(other, missing=True)
        both = [one and two for one, two in zip(here, there, strict=False)]
        kept = all(two for one, two in zip(here, gaps, strict=False) if one)
        if not (kept and any(both) and len(other) <= len(row) + 1):
            return False
    return True


def _parts(text: str, separator: str) -> list[str]:
    return [part.strip().strip('"').strip() for part in text.split(separator)]


def _of_titles(path: Path, text: str, comments: tuple[str, ...], line: int) -> Head:
    """Return the header of a file whose first line holds titles.

    Raises:
        DataFileError: If it does not.
    """
    separator = next((one for one in _SEPARATORS if one in text), None)
    if separator is None and _TIME_ALONE.fullmatch(text):
        told = f"line {line} names one column, `{short(text)}`"
        remedy = "separate the columns by commas, semicolons or tabs, and record a signal"
        raise DataFileError(path, f"{told}: {remedy}")
    if separator is None:
        wanted = "must separate its columns by commas, semicolons or tabs"
        raise DataFileError(path, f"line {line} {wanted}: `{short(text)}`")
    columns = tuple(_parts(text, separator))
    if all(map(_LABELLED.fullmatch, columns)):
        told = f"line {line} names a quantity beside each number, `{short(columns[0])}`"
        raise DataFileError(path, f"{told}: write a line of titles, and numbers alone below it")
    if all(number_of(part.replace(",", ".")) is not None for part in columns):
        raise DataFileError(
            path,
            f"line {line} holds numbers in place of the column titles: add a line such as "
            "`time [s],angle [rad]`",
        )
    return Head(comments=comments, columns=columns, separator=separator, line=line, last=line)


def _lines(pieces: Iterator[str]) -> Iterator[str]:
    for piece in pieces:
        yield from piece.removesuffix("\n").split("\n")


def number_of(text: str) -> float | None:
    """Return the number that a text is, or ``None``."""
    # `float` reads underscores too, which no instrument writes.
    if "_" in text:
        return None
    try:
        # Typeset tables have a minus sign of their own.
        return float(text.replace("\N{MINUS SIGN}", "-"))
    except ValueError:
        return None


def short(text: str) -> str:
    """Return the beginning of a text, for a message."""
    return text if len(text) <= 40 else text[:37] + "..."
