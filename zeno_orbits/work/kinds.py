"""Arguments of a wrong kind: refused by the annotations of functions and of settings.

A caller in Python may pass anything. What an annotation excludes is refused before any work, in
one line that names the argument. A number or matrix becomes a formula where an annotation asks for
a formula of CasADi. Ranges are checked where values are used.
"""

from __future__ import annotations

import inspect
import math
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from decimal import Decimal
from fractions import Fraction
from functools import cache, wraps
from importlib import import_module
from operator import index
from pathlib import Path
from pkgutil import iter_modules
from types import NoneType, UnionType
from typing import Any, ParamSpec, TypeVar, cast, get_args, get_origin

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
        def taken(name: str, value: Any) -> Any:
            if name not in known or value is known[name].default:
                return value
            return _taken(name, value, _kinds(function.__module__, str(known[name].annotation)))

        run: Any = function
        named = {name: taken(name, value) for name, value in options.items()}
        return run(*map(taken, known, args), *args[len(known) :], **named)

    return called


def require_kinds(settings: Any) -> None:
    """Refuse settings with a value whose kind the annotation of its field excludes.

    Args:
        settings: An instance of a dataclass, whose ``__post_init__`` calls this function. Its
            formulas may be numbers, which become formulas.

    Raises:
        InputError: If a value is of another kind.
    """
    module = type(settings).__module__
    for field in fields(settings):
        value = getattr(settings, field.name)
        taken = _taken(field.name, value, _kinds(module, str(field.type)))
        if taken is not value:
            object.__setattr__(settings, field.name, taken)


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
    """Return the module that offers each name: the front door, or a room."""
    offering = dict.fromkeys(zeno_orbits.__all__, "zeno_orbits")
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


def _taken(argument: str, value: Any, kinds: tuple[Any, ...]) -> Any:
    """Return the value of an argument: itself, or the formula that it becomes.

    Raises:
        InputError: If its kind is not in the list.
    """
    formula = next(filter(_is_formula_kind, kinds), None)
    if formula is None:
        _require(argument, value, kinds)
        # Other kinds of numbers, such as `Decimal`, compare in ways of their own.
        return float(value) if float in kinds and isinstance(value, Decimal | Fraction) else value
    if not (value is None and NoneType in kinds):
        found = _formula(argument, value, formula)
        return value if float in kinds else found
    return value


def _is_formula_kind(kind: Any) -> bool:
    """Return True for the symbolic matrices of CasADi, which is not imported for this question."""
    return isinstance(kind, type) and (kind.__module__, kind.__name__) == ("casadi.casadi", "SX")


def _formula(argument: str, value: Any, kind: Any) -> Any:
    """Return a number, a matrix or a formula as a formula.

    Raises:
        InputError: If the value is something else, or not finite.
    """
    wanted = "must be a number or a formula of `casadi.SX` symbols"
    try:
        found: Any = value if isinstance(value, kind) else kind(value)
    except (NotImplementedError, OverflowError, RuntimeError, TypeError, ValueError) as error:
        what = "None" if value is None else f"a `{_kind_name(value)}`"
        raise InputError(f"Argument `{argument}` {wanted}, but it is {what}.") from error
    if found.is_constant() and not found.is_regular():
        raise InputError(f"Argument `{argument}` {wanted}, but it is not finite.")
    return found


def _kind_name(value: Any) -> str:
    room = type(value).__module__.partition(".")[0]
    return f"{room}.{type(value).__name__}".removeprefix("builtins.")


def _require(argument: str, value: Any, kinds: tuple[Any, ...]) -> None:
    if Path in kinds and isinstance(value, str | Path) and not _is_path(value):
        raise InputError(f"Argument `{argument}` must be a path, but it is {shown(value)}.")
    if not kinds or any(_is(value, kind) for kind in kinds):
        return
    wanted = [kind for kind in kinds if kind is not NoneType]
    # A number or mapping of a wrong kind has a message that says why.
    if wanted == [float]:
        any_number(argument, value)
    if [get_origin(kind) for kind in wanted] == [Mapping] and get_args(wanted[0])[1] is not str:
        named_numbers(argument, value)
    words = [_words(kind) for kind in kinds]
    listed = words[0] if len(words) == 1 else f"{', '.join(words[:-1])} or {words[-1]}"
    comma = _missing_comma(argument, value, wanted)
    raise InputError(f"Argument `{argument}` must be {listed}, but it is {shown(value)}.{comma}")


def _missing_comma(argument: str, value: Any, kinds: Sequence[Any]) -> str:
    """Return the remedy for one entry where a sequence of entries is wanted, or an empty text."""
    for kind in kinds:
        inner = get_args(kind)
        if (get_origin(kind) is Sequence or inner[1:] == (Ellipsis,)) and _is(value, inner[0]):
            return f" For one entry, write `{argument}=(...,)`, with a comma."
    return ""


def _is(value: Any, kind: Any) -> bool:
    """Return True if a value is of a kind, or the kind cannot be checked."""
    if kind is float:
        return _is_number(value)
    if kind is int:
        return _is_whole(value)
    origin, inner = get_origin(kind), get_args(kind)
    if origin is UnionType:
        return any(_is(value, one) for one in inner)
    if origin is Sequence or inner[1:] == (Ellipsis,):
        return _is_sequence(value) and all(_is(entry, inner[0]) for entry in value)
    if origin is tuple:
        # Entries of different kinds have messages of their own where they are used.
        return _is_sequence(value)
    if origin is Mapping and is_dataclass(inner[1]):
        known = cast("Mapping[Any, Any]", value) if isinstance(value, Mapping) else None
        return known is not None and all(_is(one, inner[1]) for one in known.values())
    if origin is not None:
        return isinstance(value, origin)
    if isinstance(kind, TypeVar):
        return any(_is(value, one) for one in kind.__constraints__ or (object,))
    if _is_formula_kind(kind):
        return isinstance(value, kind) or _is_number(value)
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
    if origin is UnionType:
        return " or ".join(map(_words, inner))
    if origin is Sequence or inner[1:] == (Ellipsis,):
        return f"a sequence with each entry {_words(inner[0])}"
    if origin is not None:
        return _KINDS_WITH_ENTRIES.get(origin.__name__, "a sequence")
    if isinstance(kind, TypeVar):
        return " or ".join(map(_words, kind.__constraints__))
    return f"a `{kind.__name__}`"


_KINDS_WITH_ENTRIES: Mapping[str, str] = {
    "Mapping": "a mapping",
    "Callable": "a function",
    "ndarray": "an array of NumPy",
}
