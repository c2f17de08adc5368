"""Notes on the numbers of a search: free ones, held ones, at an end of a range, in another unit."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from zeno_orbits.model import ParameterValues, Problem


def free_gains(problem: Problem, fixed: Collection[str] = ()) -> dict[str, tuple[float, float]]:
    """Return what is free where nothing else is said: all gains but some, in their own ranges.

    Args:
        problem: The problem.
        fixed: Names of the gains that are held.
    """
    return {g.name: (g.lower, g.upper) for g in problem.gains if g.name not in fixed}


_FAR = 100.0
"""Factor by which a number differs from the problem's own when its unit may be mistaken."""


def far_from_own(problem: Problem, values: ParameterValues) -> list[str]:
    """Return a sentence for each number that is far from the problem's own: a mistaken unit?"""
    found: list[str] = []
    for quantity in problem.quantities:
        own, given = quantity.default, values.number(quantity.name)
        if not own or not given or 1 / _FAR < abs(given / own) < _FAR:
            continue
        unit = "" if quantity.unit == "1" else f" {quantity.unit}"
        times = f"{abs(given / own):.4g} times the problem's own {own:g}{unit}"
        found.append(f"`{quantity.name}` is {given:g}{unit}, {times}: is its unit right?")
    return found


_AT_END = 1e-6
"""Part of its range within which a number lies at an end of it."""


def at_ends(
    problem: Problem,
    values: ParameterValues,
    free: Mapping[str, tuple[float, float]],
    wanted: Mapping[str, float],
) -> list[str]:
    """Return a sentence for each free number at an end of its range: beyond it may be better.

    Args:
        problem: The problem.
        values: The numbers of the orbit.
        free: Name to range of what was free.
        wanted: Name to value of what was asked for, which is no compromise.
    """
    found: list[str] = []
    for name, (low, high) in free.items():
        value = values.number(name)
        ends = {"lower": low, "upper": high}
        near = [w for w, end in ends.items() if abs(value - end) <= _AT_END * (high - low)]
        if not near or wanted.get(name) == value:
            continue
        quantity = problem.quantity(name)
        own = ends[near[0]] in (quantity.lower, quantity.upper)
        whose = "the problem's own range" if own else "its range"
        what = f"`{name}` = {value:.6g} is the {near[0]} end of {whose} {low:g}:{high:g}"
        found.append(f"{what}: beyond it there may be a better orbit.")
    return found
