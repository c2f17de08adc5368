"""Lossless conversion between values and plain data for JSON files, checkpoints and processes.

``to_plain`` converts a value to JSON data. ``from_plain`` converts the data back to the value, with
the types that the value's class declares. Every file of the package is read by ``from_plain``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from functools import cache, partial
from itertools import repeat
from types import NoneType, UnionType
from typing import Any, NoReturn, TypeVar, Union, cast, get_args, get_origin, get_type_hints

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
        is_absent = (wanted, found) == ("there", "missing")
        told = f"`{name}` must be {wanted}, but it is {found}"
        super().__init__(f"`{name}` is missing" if is_absent else told)
        self.name, self.wanted, self.found = name, wanted, found

    def inside(self, place: str) -> EntryError:
        """Return it for the value that has this entry at a place, such as ``[2]``."""
        return EntryError(f"{place}{self.name}", self.wanted, self.found)


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
    try:
        return cast("T", _converter(kind, finite)(data))
    except EntryError as error:
        # The fields of the outermost dataclass have no name before theirs.
        outer = "" if name == "data" and error.name.startswith(".") else name
        whole = f"{outer}{error.name}".removeprefix("" if outer else ".")
        raise EntryError(whole, error.wanted, error.found) from None


_Converter = Callable[[Any], Any]
"""Function from plain data to a value. Its errors name the entry relative to the value."""


@cache
def _converter(kind: Any, finite: bool) -> _Converter:
    """Return the conversion of plain data to a declared type, made once for all data."""
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        return _of_union(arguments, finite)
    if origin is tuple:
        return _of_tuple(arguments, finite)
    if origin is np.ndarray:
        return partial(_array, finite=finite)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return _of_mapping(arguments, finite)
    if not isinstance(kind, type):
        return _unchanged
    if is_dataclass(kind):
        return _of_dataclass(kind, finite)
    if issubclass(kind, Enum):
        return _of_members(kind)
    if kind is float:
        return partial(_number, finite=finite)
    if kind is complex:
        return partial(_complex, finite=finite)
    return _of_builtin(kind) if kind in _BUILTIN else _unchanged


_BUILTIN = {bool: "true or false", str: "a text", int: "a whole number"}


def _unchanged(data: Any) -> Any:
    return data


def _of_builtin(kind: type) -> _Converter:
    def read(data: Any) -> Any:
        if type(data) is not kind:
            raise EntryError("", _BUILTIN[kind], _shown(data))
        return data

    return read


def _of_members(kind: type[Enum]) -> _Converter:
    known = {member.name: member for member in kind}

    def read(data: Any) -> Any:
        found = known.get(data) if isinstance(data, str) else None
        if found is None:
            word = data if isinstance(data, str) else None
            raise EntryError("", f"one of {', '.join(known)}", _shown(word))
        return found

    return read


def _of_union(arguments: tuple[Any, ...], finite: bool) -> _Converter:
    kinds = [kind for kind in arguments if kind is not NoneType]
    named = {_name(kind): kind for kind in kinds if isinstance(kind, type)}

    def read(data: Any) -> Any:
        if data is None and NoneType in arguments:
            return None
        said = cast("Any", data).get("kind") if isinstance(data, dict) else None
        kind = kinds[0] if len(kinds) == 1 else named.get(said) if isinstance(said, str) else None
        if kind is None:
            raise EntryError("", "of a known kind", _shown(said))
        return _converter(kind, finite)(data)

    return read


def _of_tuple(arguments: tuple[Any, ...], finite: bool) -> _Converter:
    if len(arguments) == 2 and arguments[1] is Ellipsis:
        kind, own = arguments[0], _converter(arguments[0], finite)

        def read_all(data: Any) -> Any:
            entries = _listed(data)
            if kind in _BUILTIN and all(type(entry) is kind for entry in entries):
                return tuple(entries)
            return _entries(zip(repeat(own), entries))

        return read_all
    each = [_converter(kind, finite) for kind in arguments]

    def read(data: Any) -> Any:
        return _entries(zip(each, _listed(data, len(each)), strict=True))

    return read


def _entries(pairs: Iterable[tuple[_Converter, Any]]) -> tuple[Any, ...]:
    """Return the values of a list, and name an entry only if it is invalid."""
    found: list[Any] = []
    try:
        found.extend(own(entry) for own, entry in pairs)
    except EntryError as error:
        raise error.inside(f"[{len(found)}]") from None
    return tuple(found)


def _of_mapping(arguments: tuple[Any, ...], finite: bool) -> _Converter:
    key, value = (_converter(kind, finite) for kind in arguments)

    def read(data: Any) -> Any:
        found: dict[str, Any] = {}
        entries, word = _named(data), ""
        if arguments[1] is float and _are_finite(entries.values()):
            return dict(entries)
        try:
            for word, entry in entries.items():
                found[word] = value(entry)
        except EntryError as error:
            raise error.inside(f".{word}") from None
        return found

    def read_pairs(data: Any) -> Any:
        pairs = [_listed(pair, 2) for pair in _listed(data)]
        return {key(k): value(entry) for k, entry in pairs}

    return read if arguments[0] is str else read_pairs


def _are_finite(numbers: Collection[Any]) -> bool:
    """Return True if all are floats with a finite sum, so that each of them is finite."""
    return set(map(type, numbers)) == {float} and math.isfinite(sum(numbers))


def _of_dataclass(kind: Any, finite: bool) -> _Converter:
    def read(data: Any) -> Any:
        found: dict[str, Any] = {}
        entries, name = _named(data), ""
        known, required = _read_fields(kind, finite)
        try:
            for name in required:
                if name not in entries:
                    _refuse_absence()
            for name, entry in entries.items():
                own = known.get(name)
                if own is not None:
                    found[name] = own(entry)
        except EntryError as error:
            raise error.inside(f".{name}") from None
        return kind(**found)

    return read


def _refuse_absence() -> NoReturn:
    raise EntryError("", "there", "missing")


@cache
def _read_fields(kind: type, finite: bool) -> tuple[dict[str, _Converter], tuple[str, ...]]:
    """Return the conversion of each field of a dataclass, and the names of required fields."""
    hints = get_type_hints(kind)
    read = [field for field in fields(kind) if field.init]
    return (
        {field.name: _converter(hints[field.name], finite) for field in read},
        tuple(
            field.name
            for field in read
            if field.default is MISSING and field.default_factory is MISSING
        ),
    )


def _array(data: Any, *, finite: bool) -> Any:
    if isinstance(data, dict):
        return np.zeros(_named(data)["shape"])
    try:
        found = np.array(data, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise EntryError("", "a list of numbers", _shown(data)) from error
    if finite and not np.all(np.isfinite(found)):
        raise EntryError("", "a list of finite numbers", _shown(data))
    return found


def _number(data: Any, *, finite: bool) -> float:
    number = data if type(data) is float else _as_float(data)
    if number is None:
        raise EntryError("", "a number", _shown(data))
    if finite and not math.isfinite(number):
        raise EntryError("", "a finite number", _shown(data))
    return number


def _complex(data: Any, *, finite: bool) -> complex:
    real, imaginary = _listed(data, 2)
    if type(real) is type(imaginary) is float and math.isfinite(real) and math.isfinite(imaginary):
        return complex(real, imaginary)
    return complex(_number(real, finite=finite), _number(imaginary, finite=finite))


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


def _named(data: Any) -> dict[str, Any]:
    if not isinstance(data, dict):
        raise EntryError("", "an object with names", _shown(data))
    return cast("dict[str, Any]", data)


def _listed(data: Any, count: int | None = None) -> list[Any]:
    found = cast("list[Any]", data) if isinstance(data, list) else None
    if found is None or (count is not None and len(found) != count):
        wanted = "a list" if count is None else f"a list of {count}"
        raise EntryError("", wanted, _shown(data))
    return found


_MOST_SHOWN = 40


def _shown(data: Any) -> str:
    """Return data as in a JSON file, cut if it is long."""
    text = json.dumps(data, default=str)
    return text if len(text) <= _MOST_SHOWN else f"{text[:_MOST_SHOWN]}..."
