"""Notes on the values of a search: default free gains, suspect units, values at a bound."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zeno_orbits.model import ParameterValues, Problem


def free_gains(problem: Problem, fixed: Collection[str] = ()) -> dict[str, tuple[float, float]]:
    """Return the default free gains with their default ranges: all gains except the fixed gains.

    Args:
        problem: The problem.
        fixed: Names of the fixed gains.
    """
    return {g.name: (g.lower, g.upper) for g in problem.gains if g.name not in fixed}


def is_driven(problem: Problem) -> bool:
    """Return True if a drive, clock, switch or kink can supply the energy that impacts dissipate.

    Args:
        problem: The problem.
    """
    compiled = problem.compiled_graph()
    has_currents = len(problem.state_names) > 2 * compiled.n_q
    graph = compiled.graph
    return bool(problem.gains or graph.switches or graph.conditions) or has_currents


_FAR = 100.0
"""Factor between a value and the problem's default from which the unit may be wrong."""


def far_from_own(problem: Problem, values: ParameterValues) -> list[str]:
    """Return a warning for each value that is far from the problem's default: a wrong unit?"""
    found: list[str] = []
    for quantity in problem.quantities:
        own, given = quantity.default, values.number(quantity.name)
        if not own or not given or 1 / _FAR < abs(given / own) < _FAR:
            continue
        unit = "" if quantity.unit == "1" else f" {quantity.unit}"
        times = f"{abs(given / own):.4g} times the problem's own {own:g}{unit}"
        found.append(f"`{quantity.name}` is {given:g}{unit}, {times}: is its unit right?")
    return found


_AT_END = 1e-5
"""Part of its range within which a value lies at a bound, since solvers stop inside a range."""


def at_ends(
    problem: Problem,
    values: ParameterValues,
    free: Mapping[str, tuple[float, float]],
    wanted: Mapping[str, float],
) -> list[str]:
    """Return a note for each free value at a bound of its range. An optimum may be beyond it.

    Args:
        problem: The problem.
        values: Values of the orbit.
        free: Name to range of each free value.
        wanted: Name to target value. A value equal to its target is not a compromise.
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
