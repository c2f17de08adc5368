r"""The columns of a file: which quantity each one is, in which unit, and what is missing for that.

A title says the name and the unit of a column. Where it does not, or says it otherwise than the
problem, the user says it: the recorded value :math:`v` of a quantity stands for
:math:`(v - v_0)\,c` of an SI unit.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from zeno_orbits.errors import (
    InputError,
    finite_number,
    named_numbers,
    not_known,
    shown,
)
from zeno_orbits.experiment.recordings.heads import Head
from zeno_orbits.model import in_si, powers_of
from zeno_orbits.work import checked, require_kinds

TIMES = ("time", "t")
"""Names of a column of times, in lower case."""
_FRAMES = ("frame", "frames", "frame number", "frame no", "image")
"""Names of a column of frame numbers, in lower case."""
_TITLE = re.compile(r"(.*?)\s*(?:\[(.*)\]|\((.*)\))\s*")
_SIZED = re.compile(r"\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*(.*)")
_POWERS = str.maketrans({"²": "^2", "³": "^3", "·": "*"})
"""Signs of units that have another spelling in problems."""
_WORD = 4
"""Letters at least of a unit in words, which no symbol of a quantity is."""
_GRAVITY = 9.80665
"""Standard gravity [m/s^2], in which many instruments count accelerations."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnNotes:
    """What a user knows of the columns of a file, beside its titles.

    Attributes:
        names: Title of a column, or its number from 1, to the name of its quantity.
        units: Name of a quantity to its unit, with the number of them that one recorded unit is,
            such as ``deg``, ``-0.7843 mm`` or ``9.81 m/s^2``.
        zeros: Name of a quantity to the recorded value that stands for zero.
        frame_rate: Frames per second, if the file has frames in place of times.
    """

    names: Mapping[str, str] = field(default_factory=dict[str, str])
    units: Mapping[str, str] = field(default_factory=dict[str, str])
    zeros: Mapping[str, float] = field(default_factory=dict[str, float])
    frame_rate: float | None = None

    def __post_init__(self) -> None:
        """Refuse values of a wrong kind, an unknown unit, and a rate that is not positive."""
        require_kinds(self)
        given_texts: dict[str, Mapping[Any, Any]] = {"names": self.names, "units": self.units}
        for argument, texts in given_texts.items():
            for title, text in texts.items():
                if not (isinstance(title, str) and isinstance(text, str)):
                    wanted = "must map texts to texts"
                    given = f"{shown(title)}: {shown(text)}"
                    raise InputError(f"Argument `{argument}` {wanted}, but it has {given}.")
        for name, unit in self.units.items():
            sized(name, unit)
        for name, zero in named_numbers("zeros", self.zeros).items():
            finite_number(f"zeros[{name}]", zero)
        if self.frame_rate is not None and not (
            math.isfinite(self.frame_rate) and self.frame_rate > 0.0
        ):
            wanted = "must be a positive number of frames per second"
            raise InputError(f"Argument `frame_rate` {wanted}, but it is {self.frame_rate}.")


@dataclass(frozen=True, slots=True, kw_only=True)
class Column:
    """A column of a file.

    Attributes:
        title: Its title, as it is written.
        name: Name of its quantity.
        unit: SI unit of the quantity, empty if it is unknown.
        size: Size of one recorded unit in the SI unit.
        zero: Recorded value that stands for zero.
        is_time: Whether it holds the times.
        holds_text: Whether its first value is text.
        trouble: Reason why it cannot be read as a quantity, as a clause, or empty.
    """

    title: str
    name: str
    unit: str = ""
    size: float = 1.0
    zero: float = 0.0
    is_time: bool = False
    holds_text: bool = False
    trouble: str = ""


def sized(name: str, text: str) -> tuple[str, float]:
    """Return the SI unit that a user gives to a quantity, and the size of one recorded unit in it.

    Args:
        name: Name of the quantity.
        text: A unit, or a number of units.

    Raises:
        InputError: If the unit is unknown, or its size is not positive.
    """
    found = _SIZED.fullmatch(text)
    number, unit = (found[1], found[2]) if found and found[2] else ("1", text)
    try:
        si, size = in_si(unit.translate(_POWERS))
        size *= float(number)
    except ValueError as error:
        raise InputError(f"Argument `units`: {error}") from error
    if size == 0.0 or not math.isfinite(size):
        raise InputError(f"Argument `units` has for `{name}` a unit of size {size:g}.")
    return si, size


@checked
def columns_of(head: Head, known: Mapping[str, str], notes: ColumnNotes) -> tuple[Column, ...]:
    """Return the columns of a file.

    Args:
        head: Its header.
        known: Unit of the signals that a problem has, by name.
        notes: What the user says of the columns.

    Raises:
        InputError: If the notes name a column or quantity that the file does not have.
    """
    titled = [_split(title) for title in head.columns]
    units = head.units or (None,) * len(titled)
    titled = [
        (name, unit if below is None or unit is not None else below)
        for (name, unit), below in zip(titled, units, strict=False)
    ]
    titled = [(name, unit_in_words(name) if unit is None else unit) for name, unit in titled]
    named = [name for name, _ in titled]
    for title in notes.names:
        if _place(title, head.columns, named) is None:
            raise InputError(f"Argument `names`: {not_known(title, head.columns)}")
    renamed = {_place(title, head.columns, named): name for title, name in notes.names.items()}
    found: list[Column] = []
    for k, (title, (name, unit)) in enumerate(zip(head.columns, titled, strict=True)):
        one = _column(head, title, renamed.get(k, name), unit, known, notes)
        is_text = bool(head.numeric) and not head.numeric[k]
        # A title with a unit promises numbers.
        if is_text and not unit and not one.unit and one.name not in known:
            told = f"line {head.last + 1}: column `{one.name}` holds text, not numbers"
            one = replace(one, holds_text=True, trouble=told)
        found.append(one)
    names = {one.name for one in found}
    for argument, given in (("units", notes.units), ("zeros", notes.zeros)):
        for name in given:
            if name not in names:
                raise InputError(f"Argument `{argument}`: {not_known(name, sorted(names))}")
    return tuple(found)


def _place(title: str, titles: Sequence[str], names: Sequence[str]) -> int | None:
    """Return the index of a column by its title, by its name alone, or by its number from 1."""
    for known in (titles, names):
        if title in known:
            return list(known).index(title)
    number = int(title) if title.isascii() and title.isdigit() and len(title) < 9 else 0
    return number - 1 if 1 <= number <= len(titles) else None


def unit_in_words(title: str) -> str | None:
    """Return the unit that a whole title is, such as `Volt`, or ``None`` for another title."""
    word = title.strip().lower()
    try:
        return word if len(word) >= _WORD and in_si(word) else None
    except ValueError:
        return None


def _split(title: str) -> tuple[str, str | None]:
    found = _TITLE.fullmatch(title)
    return (found[1], found[2] or found[3] or "") if found else (title, None)


def _column(
    head: Head,
    title: str,
    name: str,
    unit: str | None,
    known: Mapping[str, str],
    notes: ColumnNotes,
) -> Column:
    """Return a column by its title and what the user says of it."""
    one = Column(title=title, name=name, zero=notes.zeros.get(name, 0.0))
    if name.lower() in _FRAMES and notes.frame_rate is not None:
        return replace(one, name="time", unit="s", size=1.0 / notes.frame_rate, is_time=True)
    # Some instruments write units in place of titles.
    one = replace(one, is_time=name.lower() in (*TIMES, "second", "seconds"))
    where = f"line {head.line}"
    if name in notes.units:
        si, size = sized(name, notes.units[name])
    elif unit is None:
        likely = "s" if one.is_time else known.get(name, "rad")
        told = f"{where}: column `{name}` lacks a unit: write for instance `{name} [{likely}]`"
        return replace(one, trouble=told)
    elif unit.strip() in ("g", "G") and _is_acceleration(name, known):
        si, size = "m/s^2", _GRAVITY
    else:
        try:
            si, size = in_si(unit.translate(_POWERS))
        except ValueError as error:
            told = f"{where}: the unit of column `{name}` is not clear: {error}"
            return replace(one, trouble=told)
    if name in known and powers_of(si) != powers_of(known[name]):
        recorded = notes.units.get(name, unit)
        told = f"{where}: column `{name}` has the unit {recorded}, but the signal is in"
        return replace(one, trouble=f"{told} {known[name]}: correct the title")
    if one.is_time and si != "s":
        told = f"{where}: column `{title}` is not a time: write `time [s]` or `time [ms]`"
        return replace(one, trouble=told)
    return replace(one, unit=si, size=size)


def _is_acceleration(name: str, known: Mapping[str, str]) -> bool:
    """Return True if a quantity is an acceleration, which counts in g, by its name or its unit."""
    if name in known:
        return powers_of(known[name]) == powers_of("m/s^2")
    return "accel" in name.lower() or name.lower().startswith(("acc ", "acc_", "acc."))
