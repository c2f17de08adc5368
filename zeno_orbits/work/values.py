"""Equality of results by their values, including arrays and NaN."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, cast


class ByValue:
    """A dataclass whose ``==`` compares every compared field, entry by entry.

    The default comparison of a dataclass fails for arrays, whose truth value is undefined, and
    returns False for NaN, which differs from itself.
    """

    __slots__ = ()

    def __init_subclass__(cls, **options: Any) -> None:
        """Prevent the dataclass from generating its own comparison."""
        super().__init_subclass__(**options)
        cls.__eq__ = _equal  # pyright: ignore[reportAttributeAccessIssue]
        cls.__hash__ = None  # pyright: ignore[reportAttributeAccessIssue]


def _equal(one: object, other: object) -> bool:
    return type(one) is type(other) and same(one, other)


def same(one: Any, other: Any) -> bool:
    """Return True if two values have the same type and entries. NaN equals NaN."""
    if one is other:
        return True
    if hasattr(one, "__array__") or hasattr(other, "__array__"):
        return _same_array(one, other)
    if type(one) is not type(other):
        return bool(one == other)
    if isinstance(one, float):
        return one == other or (one != one and other != other)
    if isinstance(one, Mapping):
        first, second = cast("Mapping[Any, Any]", one), cast("Mapping[Any, Any]", other)
        return first.keys() == second.keys() and all(same(first[k], second[k]) for k in first)
    if isinstance(one, Sequence) and not isinstance(one, str | bytes):
        first, second = cast("Sequence[Any]", one), cast("Sequence[Any]", other)
        return len(first) == len(second) and all(map(same, first, second))
    if is_dataclass(one) and _by_fields(one):
        names = [field.name for field in fields(one) if field.compare]
        return all(same(getattr(one, name), getattr(other, name)) for name in names)
    return bool(one == other)


def _by_fields(one: object) -> bool:
    """Return False for a dataclass that inherits a comparison of its own, such as a problem."""
    kind = cast("Any", one).__class__
    return kind.__dataclass_params__.eq or kind.__eq__ in (_equal, object.__eq__)


def _same_array(one: Any, other: Any) -> bool:
    import numpy as np  # NumPy is already loaded if a value is an array.

    first, second = np.asarray(one), np.asarray(other)
    floats = first.dtype.kind in "fc" and second.dtype.kind in "fc"
    return bool(np.array_equal(first, second, equal_nan=floats))
