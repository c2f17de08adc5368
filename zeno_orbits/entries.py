"""The entries of a file of plain data, each refused by its name if it is not what it must be."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast


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
