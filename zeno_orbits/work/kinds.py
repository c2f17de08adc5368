"""Arguments of a wrong kind: refused by the annotations of functions and of settings.

A caller in Python may pass anything. What an annotation excludes is refused before any work, in
one line that names the argument. Ranges are checked where values are used.
"""

from __future__ import annotations

import inspect
import math
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import cache, wraps
from importlib import import_module
from operator import index
from pathlib import Path
from pkgutil import iter_modules
from types import NoneType, UnionType
from typing import Any, ParamSpec, TypeVar, get_args, get_origin

import zeno_orbits
from zeno_orbits.errors import InputError, any_number, named_numbers, shown

_P = ParamSpec("_P")
_R = TypeVar("_R")

_WORDS: Mapping[Any, str] = {
    float: "a number",
    int: "a whole number of at most 18 digits",
    str: "a text",
    bool: "True or False",
    Path: "a path",
    NoneType: "None",
}


_LARGEST = 2**63
"""No count comes near it, and compiled code cannot hold it."""


def checked(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Return a function that refuses arguments whose kind its annotations exclude.

    Args:
        function: The function. Its defaults are not checked.
    """
    known = inspect.signature(function).parameters

    @wraps(function)
    def called(*args: _P.args, **options: _P.kwargs) -> _R:
        for name, value in (*zip(known, args, strict=False), *options.items()):
            if name in known and value is not known[name].default:
                _require(name, value, _kinds(function.__module__, str(known[name].annotation)))
        return function(*args, **options)

    return called


def require_kinds(settings: Any) -> None:
    """Refuse settings with a value whose kind the annotation of its field excludes.

    Args:
        settings: An instance of a dataclass, whose ``__post_init__`` calls this function.

    Raises:
        InputError: If a value is of another kind.
    """
    module = type(settings).__module__
    for field in fields(settings):
        _require(field.name, getattr(settings, field.name), _kinds(module, str(field.type)))


class Checked:
    """A dataclass that refuses values of a wrong kind, and NaN."""

    __slots__ = ()

    def __post_init__(self) -> None:
        """Refuse values of a wrong kind, and NaN."""
        require_kinds(self)
        for field in fields(self):  # pyright: ignore[reportArgumentType]
            value = getattr(self, field.name)
            if isinstance(value, float) and math.isnan(value):
                raise InputError(f"Argument `{field.name}` must be a number, but it is NaN.")


class _Names(dict[str, Any]):
    """The names of a module, then those of the rooms: a module may import them for types alone."""

    def __missing__(self, name: str) -> Any:
        return getattr(import_module(_rooms()[name]), name)


@cache
def _rooms() -> dict[str, str]:
    """Return the room that offers each name."""
    offering = dict[str, str]()
    for found in iter_modules(zeno_orbits.__path__, "zeno_orbits."):
        for name in getattr(import_module(found.name), "__all__", ()) if found.ispkg else ():
            offering.setdefault(name, found.name)
    return offering


@cache
def _kinds(module: str, annotation: str) -> tuple[Any, ...]:
    """Return the kinds that an annotation names; none if it uses names of type checkers alone."""
    if annotation == str(inspect.Parameter.empty):
        return ()
    try:
        hint = eval(annotation, {}, _Names(vars(sys.modules[module])))
    except NameError:
        return ()
    return get_args(hint) if isinstance(hint, UnionType) else (hint,)


def _require(argument: str, value: Any, kinds: tuple[Any, ...]) -> None:
    if Path in kinds and isinstance(value, str | Path) and not _is_path(value):
        raise InputError(f"Argument `{argument}` must be a path, but it is {shown(value)}.")
    if not kinds or any(_is(value, kind) for kind in kinds):
        return
    wanted = [kind for kind in kinds if kind is not NoneType]
    # A number or mapping of a wrong kind has a message that says why.
    if wanted == [float]:
        any_number(argument, value)
    if [get_origin(kind) for kind in wanted] == [Mapping]:
        named_numbers(argument, value)
    words = [_words(kind) for kind in kinds]
    listed = words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"
    raise InputError(f"Argument `{argument}` must be {listed}, but it is {shown(value)}.")


def _is(value: Any, kind: Any) -> bool:
    """Return True if a value is of a kind, or the kind cannot be checked."""
    if kind is float:
        return _is_number(value)
    if kind is int:
        return _is_whole(value)
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Sequence:
        return _is_sequence(value) and all(_is(entry, inner[0]) for entry in value)
    if origin is not None:
        # Entries of tuples and values of mappings have messages of their own where they are used.
        return _is_sequence(value) if origin is tuple else isinstance(value, origin)
    if kind is Any or not isinstance(kind, type):
        return True
    if kind is bool:
        # `str` also covers the truth values of NumPy.
        return str(value) in ("True", "False") and not isinstance(value, str)
    if getattr(kind, "_is_protocol", False):
        wanted = [name for name in vars(kind) if name[0] != "_" or name == "__call__"]
        return all(hasattr(value, name) for name in wanted)
    return isinstance(value, kind)


def _is_path(value: str | Path) -> bool:
    """Return True if the system can store a text as a path."""
    try:
        return b"\0" not in os.fsencode(value)
    except UnicodeEncodeError:
        return False


def _is_sequence(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str | bytes)


def _is_number(value: Any) -> bool:
    try:
        any_number("", value)
    except InputError:
        return False
    return not isinstance(value, bool)


def _is_whole(value: Any) -> bool:
    try:
        return not isinstance(value, bool) and abs(index(value)) < _LARGEST
    except TypeError:
        return False


def _words(kind: Any) -> str:
    if kind in _WORDS:
        return _WORDS[kind]
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Sequence:
        return f"a sequence with each entry {_words(inner[0])}"
    if origin is not None:
        return "a mapping" if origin is Mapping else "a sequence"
    return f"a `{kind.__name__}`"
