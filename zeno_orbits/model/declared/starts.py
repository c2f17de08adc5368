"""Initial states that a problem declares, whose entries may be formulas of its parameters."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, cast

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, did_you_mean, finite_number, named_numbers, shown
from zeno_orbits.model.declared.quantities import unknown

StartFormula = Callable[[Mapping[str, float]], float]
"""Function from the values of gains and parameters by name to the initial value of a state."""

Start = Mapping[str, float | StartFormula]
"""State name to initial value. A missing state is zero."""

Starts = Callable[[Sequence[float] | Vector], tuple[tuple[float, ...], ...]]
"""Function from the parameter vector to the initial states of a problem, each ``(n_x,)``."""


def no_starts(p: Sequence[float] | Vector) -> tuple[tuple[float, ...], ...]:
    """Return no initial state: those of a system without a problem are unknown.

    Args:
        p: The parameter vector.
    """
    del p
    return ()


def require_starts(starts: Any, states: Collection[str]) -> None:
    """Refuse initial states of the wrong type, or with unknown states.

    Args:
        starts: The initial states.
        states: Names of the states.

    Raises:
        InputError: If starts are missing, or a start is not a mapping of states.
    """
    if not isinstance(starts, tuple | list):
        wanted = 'must be a tuple of mappings, as ({"q": 1.0},) is'
        raise InputError(f"Argument `starts` {wanted}, but it is {shown(starts)}.")
    if not starts:
        raise InputError("Argument `starts` must hold a state to start from, but it is empty.")
    for start in cast("Sequence[Any]", starts):
        for name in named_numbers("starts", start):
            if name not in states:
                known = ", ".join(states)
                raise InputError(
                    f"Argument `starts` must name states ({known}), but it names `{name}`."
                    f"{did_you_mean(name, states)}"
                )


def state_of(
    start: Start, names: tuple[str, ...], values: Callable[[], Mapping[str, float]]
) -> tuple[float, ...]:
    """Return the state with the named entries, the others zero, ``(n_x,)``.

    Args:
        start: Values, or formulas of gains and parameters, by state name.
        names: Names of the states, ``(n_x,)``.
        values: Function that returns the values of gains and parameters, called for formulas only.

    Raises:
        InputError: If a name is not a state, a value is not a finite number, or a formula fails.
    """
    given = named_numbers("start", start)
    for name in given:
        if name not in names:
            raise InputError(unknown("state", name, names))
    return tuple(_number(name, given.get(name, 0.0), values) for name in names)


def _number(name: str, value: Any, values: Callable[[], Mapping[str, float]]) -> float:
    """Return the initial value of a state."""
    if not callable(value):
        return finite_number(name, value)
    numbers = values()
    wanted = f"Argument `starts`: the formula of `{name}` must return a finite number"
    try:
        found = value(numbers)
    except KeyError as error:
        asked, known = str(*error.args[:1]), tuple(numbers)
        said = f"which is not a gain or parameter ({', '.join(known) or 'none'})"
        raise InputError(
            f"Argument `starts`: the formula of `{name}` asks for `{asked}`, {said}."
        ) from error
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(f"{wanted}, but it raises {reason}.") from error
    try:
        return finite_number(name, found)
    except InputError as error:
        raise InputError(f"{wanted}, but it returns {shown(found)}.") from error
