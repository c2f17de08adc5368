"""Values as plain data, every bit kept: what JSON holds and what tells one work from another."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
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
