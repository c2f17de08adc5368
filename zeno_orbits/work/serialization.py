"""Values as plain data, every bit kept: what JSON holds and what tells one work from another.

The entries of a file of plain data, each refused by its name if it is not what it must be.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any, cast

import numpy as np

from zeno_orbits.errors import InputError


def plain(value: Any, argument: str = "value") -> Any:
    """Return a value as numbers, texts, lists and mappings.

    Dataclasses become mappings of their fields with their ``kind``, functions of a module their
    names, and numbers that are not finite the texts that ``float`` reads.

    Args:
        value: Of these, or of what JSON holds, enumerations, complex numbers and arrays.
        argument: What to call it in an error.

    Raises:
        InputError: If it is none of these; nothing is left out silently.
    """
    if isinstance(value, np.ndarray | np.generic):
        return plain(cast("Any", value).tolist(), argument)
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    if isinstance(value, complex):
        return [plain(value.real, argument), plain(value.imag, argument)]
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, Mapping):
        entries = cast("Mapping[Any, Any]", value)
        return {str(name): plain(entry, argument) for name, entry in entries.items()}
    if isinstance(value, Sequence):
        return [plain(entry, argument) for entry in cast("Sequence[Any]", value)]
    if is_dataclass(value) and not isinstance(value, type):
        own = {field.name: plain(getattr(value, field.name), argument) for field in fields(value)}
        return {"kind": _name(type(value)), **own}
    if getattr(value, "__qualname__", "<").isidentifier():
        return _name(value)
    wanted = "must be made of numbers, texts, dataclasses and functions of a module"
    raise InputError(f"Argument `{argument}` {wanted}, but it has a {_name(type(value))}.")


def _name(thing: Any) -> str:
    return f"{thing.__module__}.{thing.__qualname__}"


class Entries:
    """Reads entries of one file.

    Args:
        path: The file, for messages.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def refuse(self, reason: str) -> Exception:
        """Return what is raised of a file; a kind of file has its own."""
        return ValueError(f"File `{self.path}` must hold plain data, but {reason}.")

    def get(self, entries: Mapping[str, Any], name: str) -> Any:
        """Return an entry that there must be."""
        if name not in entries:
            raise self.refuse(f"it has no `{name}`")
        return entries[name]

    def mapping(self, value: object, name: str) -> Mapping[str, Any]:
        """Return what must be an object with names."""
        if not isinstance(value, dict):
            raise self.refuse(f"`{name}` is not an object with names")
        return cast("dict[str, Any]", value)

    def sequence(self, entries: Mapping[str, Any], name: str) -> Sequence[Any]:
        """Return an entry that must be a list."""
        value = self.get(entries, name)
        if not isinstance(value, list):
            raise self.refuse(f"`{name}` is not a list")
        return cast("list[Any]", value)

    def text(self, value: object, name: str) -> str:
        """Return what must be a text."""
        if not isinstance(value, str):
            raise self.refuse(f"`{name}` is not a text")
        return value

    def number(self, value: object, name: str) -> float:
        """Return what must be a finite number."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.refuse(f"`{name}` is not a number")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise self.refuse(f"`{name}` is not finite")
        return number

    def positive(self, value: object, name: str) -> float:
        """Return what must be a positive number."""
        number = self.number(value, name)
        if number <= 0.0:
            raise self.refuse(f"`{name}` is not positive")
        return number

    def numbers(self, value: object, name: str) -> dict[str, float]:
        """Return name to number of what must be an object."""
        entries = self.mapping(value, name)
        return {key: self.number(entry, f"{name}.{key}") for key, entry in entries.items()}
