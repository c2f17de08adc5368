"""The file that declares a problem, by which a problem is compared, copied and pickled."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import Field, dataclass, fields, replace
from typing import Any, ClassVar, Protocol, Self, SupportsIndex, TypeVar

_Declared = TypeVar("_Declared", bound="Declared")


class ProblemSource(Hashable, Protocol):
    """A file of a problem that other processes can load. It can be pickled."""

    @property
    def restored(self) -> Callable[[Mapping[str, Any]], Declared]:
        """From changed fields to the problem of the file with these changes."""
        ...

    def reduced_model(self, fidelity: str) -> ProblemSource:
        """Return the file of a reduced model."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Origin:
    """The file of a problem, and the problem as the file declares it.

    Attributes:
        file: The file.
        declared: The problem, without the changes of ``dataclasses.replace``.
    """

    file: ProblemSource
    declared: Declared

    def reduced_model(self, fidelity: str, model: _Declared) -> _Declared:
        """Return a reduced model with its own origin.

        Args:
            fidelity: Word after the ``@``.
            model: The reduced model of the problem that has this origin.
        """
        return with_origin(model, self.file.reduced_model(fidelity))


def with_origin(declared: _Declared, file: ProblemSource) -> _Declared:
    """Return a problem with a reference to the file that declares it."""
    return replace(declared, origin=Origin(file=file, declared=declared))


class Declared:
    """A problem that is compared, hashed, pickled and copied by the file that declares it."""

    __slots__ = ()

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]
    origin: Origin | None

    @property
    def file(self) -> Any:
        """The ``ProblemFile`` that declares the problem as it is, or None without a file."""
        if self.origin is None or _changes(self, self.origin):
            return None
        return self.origin.file

    def __eq__(self, other: object) -> bool:
        """Return True for the same file with the same changes, or for the same object."""
        return self is other or (isinstance(other, type(self)) and _same_origin(self, other))

    def __hash__(self) -> int:
        """Return a hash of the file, if there is one."""
        return id(self) if self.origin is None else hash(self.origin.file)

    def __reduce_ex__(self, protocol: SupportsIndex) -> str | tuple[Any, ...]:
        """Return the file and the changes in place of functions, if there is a file."""
        if self.origin is None:
            return object.__reduce_ex__(self, protocol)
        return self.origin.file.restored, (_changes(self, self.origin),)

    def __copy__(self) -> Self:
        """Return the problem itself: it never changes."""
        return self

    def __deepcopy__(self, _memo: dict[int, Any]) -> Self:
        """Return the problem itself: it never changes."""
        return self


def _same_origin(one: Declared, other: Declared) -> bool:
    if one.origin is None or other.origin is None or one.origin.file != other.origin.file:
        return False
    return _changes(one, one.origin) == _changes(other, other.origin)


def _changes(problem: Any, origin: Origin) -> dict[str, Any]:
    """Return name to value of the fields that differ from the declared problem."""
    names = (one.name for one in fields(problem) if one.name != "origin")
    return {
        name: getattr(problem, name)
        for name in names
        if getattr(problem, name) is not getattr(origin.declared, name)
    }
