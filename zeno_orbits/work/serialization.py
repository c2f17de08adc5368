"""Lossless conversion between values and plain data for JSON files, checkpoints and processes.

``to_plain`` converts a value to JSON data. ``from_plain`` converts the data back to the value, with
the types that the value's class declares. Every file of the package is read by ``from_plain``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field, fields, is_dataclass
from enum import Enum
from functools import cache
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

from zeno_orbits.errors import InputError

T = TypeVar("T")


def to_plain(value: Any, argument: str = "value") -> Any:
    """Return a value as numbers, texts, lists and mappings.

    Dataclasses become mappings of their fields with their ``kind``. Functions of a module become
    their names, and enumerations the names of their members. Complex numbers become pairs. Mappings
    whose keys are not texts become lists of pairs. Numbers that are not finite become texts that
    ``float`` reads.

    Args:
        value: A value of these types, JSON data, or an array.
        argument: Name of the value in an error.

    Raises:
        InputError: If the value has another type. Values are never omitted silently.
    """
    if isinstance(value, np.ndarray):
        return _plain_array(cast("Any", value), argument)
    if isinstance(value, np.generic):
        return to_plain(value.item(), argument)
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    if isinstance(value, complex):
        return [to_plain(value.real, argument), to_plain(value.imag, argument)]
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, Mapping):
        return _plain_mapping(cast("Mapping[Any, Any]", value), argument)
    if isinstance(value, Sequence):
        return [to_plain(entry, argument) for entry in cast("Sequence[Any]", value)]
    if is_dataclass(value) and not isinstance(value, type):
        own = {
            field.name: to_plain(getattr(value, field.name), argument) for field in fields(value)
        }
        return {"kind": _name(type(value)), **own} if "kind" not in own else own
    if getattr(value, "__qualname__", "<").isidentifier():
        return _name(value)
    wanted = "must consist of values, texts, dataclasses and functions of a module"
    raise InputError(f"Argument `{argument}` {wanted}, but it has a {_name(type(value))}.")


def _plain_mapping(value: Mapping[Any, Any], argument: str) -> Any:
    if all(isinstance(key, str) for key in value):
        return {key: to_plain(entry, argument) for key, entry in value.items()}
    return [[to_plain(key, argument), to_plain(entry, argument)] for key, entry in value.items()]


def _plain_array(value: Any, argument: str) -> Any:
    if value.ndim > 1 and not value.size:
        # The list of a matrix without rows would lose the number of columns.
        return {"shape": list(value.shape), "entries": []}
    return to_plain(value.tolist(), argument)


def _name(thing: Any) -> str:
    return f"{thing.__module__}.{thing.__qualname__}"


class EntryError(ValueError):
    """An entry of plain data is invalid.

    Attributes:
        name: Name of the entry, such as ``phases[0].start_time``.
        wanted: Required content of the entry.
        found: Actual content of the entry.
    """

    def __init__(self, name: str, wanted: str, found: str) -> None:
        super().__init__(f"`{name}` must be {wanted}, but it is {found}")
        self.name, self.wanted, self.found = name, wanted, found


def from_plain(kind: type[T], data: object, name: str = "data", *, finite: bool = False) -> T:
    """Return the value of a declared type from plain data: the inverse of `to_plain`.

    Args:
        kind: A dataclass, or any type that its fields may declare: numbers, texts, enumerations,
            arrays of doubles, tuples, mappings, optional values, dataclasses.
        data: Plain data. Fields of a dataclass with defaults may be missing, and unknown names are
            ignored.
        name: Name of the data in an error.
        finite: True rejects numbers that are not finite, as for files of results.

    Raises:
        EntryError: If an entry is missing or has a wrong type. The error names the entry.
    """
    return cast("T", _Reader(finite).value(kind, data, name))


class _Reader:
    """Converter from plain data to values, with the name of an invalid entry in its errors."""

    def __init__(self, finite: bool) -> None:
        self._finite = finite

    def value(self, kind: Any, data: Any, name: str) -> Any:
        """Return the value of a declared type."""
        origin, arguments = get_origin(kind), get_args(kind)
        if origin in (Union, UnionType):
            return self._union(arguments, data, name)
        if origin is tuple:
            return self._tuple(arguments, data, name)
        if origin is np.ndarray:
            return self._array(data, name)
        if isinstance(origin, type) and issubclass(origin, Mapping):
            return self._mapping(arguments, data, name)
        if isinstance(kind, type):
            return self._plain_type(kind, data, name)
        return data

    def _plain_type(self, kind: type, data: Any, name: str) -> Any:
        if is_dataclass(kind):
            return self._dataclass(kind, data, name)
        if issubclass(kind, Enum):
            known = {member.name: member for member in kind}
            return _of(data if isinstance(data, str) else None, known, name)
        if kind is float:
            return self._number(data, name)
        if kind is complex:
            real, imaginary = _listed(data, name, 2)
            return complex(self._number(real, name), self._number(imaginary, name))
        if kind in (bool, str, int) and type(data) is not kind:
            wanted = {bool: "true or false", str: "a text", int: "a whole number"}[kind]
            raise EntryError(name, wanted, _shown(data))
        return data

    def _union(self, arguments: tuple[Any, ...], data: Any, name: str) -> Any:
        if data is None and NoneType in arguments:
            return None
        kinds = [kind for kind in arguments if kind is not NoneType]
        said = cast("Any", data).get("kind") if isinstance(data, dict) else None
        for kind in kinds:
            if len(kinds) == 1 or (isinstance(kind, type) and said == _name(kind)):
                return self.value(kind, data, name)
        raise EntryError(name, "of a known kind", _shown(said))

    def _tuple(self, arguments: tuple[Any, ...], data: Any, name: str) -> tuple[Any, ...]:
        if len(arguments) == 2 and arguments[1] is Ellipsis:
            entries = _listed(data, name)
            kinds: Sequence[Any] = [arguments[0]] * len(entries)
        else:
            entries, kinds = _listed(data, name, len(arguments)), arguments
        pairs = enumerate(zip(kinds, entries, strict=True))
        return tuple(self.value(kind, entry, f"{name}[{k}]") for k, (kind, entry) in pairs)

    def _mapping(self, arguments: tuple[Any, ...], data: Any, name: str) -> dict[Any, Any]:
        key, kind = arguments
        if key is not str:
            pairs = [_listed(pair, name, 2) for pair in _listed(data, name)]
            return {self.value(key, k, name): self.value(kind, v, name) for k, v in pairs}
        entries = _named(data, name)
        return {word: self.value(kind, entry, f"{name}.{word}") for word, entry in entries.items()}

    def _array(self, data: Any, name: str) -> Any:
        if isinstance(data, dict):
            return np.zeros(_named(data, name)["shape"])
        try:
            found = np.array(data, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise EntryError(name, "a list of numbers", _shown(data)) from error
        if self._finite and not np.all(np.isfinite(found)):
            raise EntryError(name, "a list of finite numbers", _shown(data))
        return found

    def _number(self, data: Any, name: str) -> float:
        number = _as_float(data)
        if number is None:
            raise EntryError(name, "a number", _shown(data))
        if self._finite and not math.isfinite(number):
            raise EntryError(name, "a finite number", _shown(data))
        return number

    def _dataclass(self, kind: type, data: Any, name: str) -> Any:
        entries = _named(data, name)
        found: dict[str, Any] = {}
        within = "" if name == "data" else f"{name}."
        for field, declared in _declared(kind):
            if field.name in entries:
                place = f"{within}{field.name}"
                found[field.name] = self.value(declared, entries[field.name], place)
            elif field.default is MISSING and field.default_factory is MISSING:
                raise EntryError(f"{within}{field.name}", "there", "missing")
        return kind(**found)


_NOT_FINITE = ("inf", "-inf", "nan")


def _as_float(data: Any) -> float | None:
    """Return a number, or the text that `to_plain` writes for a non-finite number, as a float."""
    if isinstance(data, str) and data in _NOT_FINITE:
        return float(data)
    if isinstance(data, bool) or not isinstance(data, int | float):
        return None
    try:
        return float(data)
    except OverflowError:
        return math.inf if data > 0 else -math.inf


@cache
def _declared(kind: type) -> tuple[tuple[Field[Any], Any], ...]:
    hints = get_type_hints(kind)
    return tuple((field, hints[field.name]) for field in fields(kind) if field.init)


def _named(data: Any, name: str) -> dict[str, Any]:
    if not isinstance(data, dict):
        raise EntryError(name, "an object with names", _shown(data))
    return cast("dict[str, Any]", data)


def _listed(data: Any, name: str, count: int | None = None) -> list[Any]:
    found = cast("list[Any]", data) if isinstance(data, list) else None
    if found is None or (count is not None and len(found) != count):
        wanted = "a list" if count is None else f"a list of {count}"
        raise EntryError(name, wanted, _shown(data))
    return found


def _of(word: str | None, known: Mapping[str, Any], name: str) -> Any:
    if word is None or word not in known:
        raise EntryError(name, f"one of {', '.join(known)}", _shown(word))
    return known[word]


_MOST_SHOWN = 40


def _shown(data: Any) -> str:
    """Return data as in a JSON file, cut if it is long."""
    text = json.dumps(data, default=str)
    return text if len(text) <= _MOST_SHOWN else f"{text[:_MOST_SHOWN]}..."
