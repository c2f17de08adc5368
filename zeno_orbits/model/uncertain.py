"""Ranges of uncertain parameters and their corners, at which a result is wanted too."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

from zeno_orbits.errors import InputError
from zeno_orbits.model.declared.quantities import unknown
from zeno_orbits.model.problem import Problem


def corners_of(uncertain: Mapping[str, tuple[float, float]]) -> list[dict[str, float]]:
    """Return the corners of uncertain ranges, name to value. Empty without a range.

    Args:
        uncertain: Name to range of the uncertain parameters.
    """
    if not uncertain:
        return []
    return [dict(zip(uncertain, corner, strict=True)) for corner in product(*uncertain.values())]


def check_uncertain(
    uncertain: Mapping[str, tuple[float, float]],
    problem: Problem,
    free: Mapping[str, tuple[float, float]],
    *,
    gains: bool = False,
) -> None:
    """Reject uncertain ranges without a meaning.

    Args:
        uncertain: Name to range of the uncertain parameters.
        problem: The problem.
        free: Name to range of the decision variables.
        gains: Whether gains may be uncertain too.

    Raises:
        InputError: If there are too many ranges, a name is unknown or free, a range is empty, or a
            corner has invalid parameters.
    """
    if len(uncertain) > _MOST_UNCERTAIN:
        wanted = f"must have at most {_MOST_UNCERTAIN} ranges, but it has {len(uncertain)}"
        raise InputError(f"Argument `uncertain` {wanted}.")
    known = problem.names if gains else tuple(one.name for one in problem.parameters)
    for name, (low, high) in uncertain.items():
        if name in problem.names and name not in known:
            raise InputError(f"Argument `uncertain` must name parameters, but `{name}` is a gain.")
        if name not in known:
            raise InputError(unknown("uncertain", name, known))
        if name in free:
            raise InputError(f"Argument `uncertain` must not name the unknown `{name}`.")
        if not low < high:
            wanted = f"must have a lower end below its upper end for `{name}`"
            raise InputError(f"Argument `uncertain` {wanted}, but it is {low:g}:{high:g}.")
    for corner in corners_of(uncertain):
        try:
            problem.values(numbers=corner)
        except InputError as error:
            if not str(error).startswith("Argument `parameters`"):
                raise
            where = ", ".join(f"{name} = {value:g}" for name, value in corner.items())
            wanted = f"must leave valid parameters at the corner {where}"
            raise InputError(f"Argument `uncertain` {wanted}, but: {error}") from error


_MOST_UNCERTAIN = 4
"""Largest number of uncertain parameters. Each doubles the time."""
