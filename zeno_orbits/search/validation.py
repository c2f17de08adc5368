"""Reject searches that are not valid for their problem."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from zeno_orbits.errors import InputError
from zeno_orbits.model import CompiledGraph, GraphDynamics, Problem, unknown
from zeno_orbits.orbits import (
    ENERGY,
    PERIOD,
    RELEASE_ROWS,
    Bound,
    course_signal_names,
    event_quantity_names,
    has_source,
    multipliers_of_return,
    require_event_quantity,
)
from zeno_orbits.search.closing.closing import require_no_other_start
from zeno_orbits.search.objectives import (
    LEAST_RADIUS,
    MinSpectralRadius,
    Objective,
    TargetPeriod,
)
from zeno_orbits.search.optimum.points import DIFFERENCED
from zeno_orbits.search.search_problem import SearchProblem
from zeno_orbits.search.starts.strategy import simulated
from zeno_orbits.simulation import steady_turn


def check_search(search: SearchProblem) -> None:
    """Reject a search with unknown names, or a search that cannot have a solution.

    Raises:
        InputError: If the search is not valid. The message names the invalid part.
    """
    problem, near = search.problem, search.near
    _check_boxes(problem, search.free)
    _check_impacts(search)
    for state in search.initial_states:
        problem.state_vector(state)
    check_objective(problem, search.objective, search.free)
    if isinstance(search.objective, TargetPeriod):
        _check_period(search, search.objective.target)
    _check_multipliers(search)
    check_bounds(problem.graph_dynamics(search.values), search.bounds)
    if near is not None:
        if near.problem != problem.name:
            message = f"must be of problem `{problem.name}`, but it is of `{near.problem}`"
            raise InputError(f"Argument `near` {message}.")
        require_no_other_start(search.initial_states, search.section)


def _check_boxes(problem: Problem, free: Mapping[str, tuple[float, float]]) -> None:
    for name, box in free.items():
        problem.require_range(name, box, argument="vary")


def _check_impacts(search: SearchProblem) -> None:
    """Reject elastic impacts if the shape of the orbits has a contact phase."""
    shape = search.shape or (search.near.phases_as if search.near is not None else None)
    if shape is None or not shape.n_releases:
        return
    _, highest = search.free.get("restitution", (0.0, None))
    bounciest = search.values
    if highest is not None:
        bounciest = bounciest.replaced({"restitution": highest})
    search.problem.require_zeno_points(bounciest)


_STEADY = 1e-9
"""Relative rounding error of a clock's frequency, and of the distance from a whole turn."""


def _check_period(search: SearchProblem, target: float) -> None:
    """Reject a period that the clock of a forced problem excludes (theory (1.9)).

    Raises:
        InputError: If the period is excluded. The message contains the period of the clock and the
            parameters that change it.
    """
    own = _turn(search, {})
    if own is None:
        return
    moving = [
        quantity.name
        for quantity in search.problem.quantities
        if (value := search.values.number(quantity.name))
        and (turn := _turn(search, {quantity.name: _NUDGED * value})) is not None
        and abs(turn / own - 1) > _STEADY
    ]
    free = [name for name in moving if name in search.free]
    possible = [own]
    for name in free:
        possible += [turn for end in search.free[name] if (turn := _turn(search, {name: end}))]
    shortest, longest = min(possible), max(possible)
    turns = max(1, math.floor(target / shortest * (1 + _STEADY)))
    if shortest * turns * (1 - _STEADY) <= target <= longest * turns * (1 + _STEADY):
        return
    wanted = f"must be a whole number of turns of the clock, {shortest:.6g} s each"
    if free:
        wanted = f"must be a whole number of turns of the clock, {shortest:.6g} to {longest:.6g} s"
    remedy = f": widen {', '.join(free)}" if free else f": free {' or '.join(moving)}"
    message = f"{wanted}, but it is {target:g} s. The clock fixes the period"
    raise InputError(f"Argument `objective` {message}{remedy if moving else ''}.")


_NUDGED = 1.01
"""Factor that perturbs a value to detect whether the clock depends on it."""


def _turn(search: SearchProblem, numbers: Mapping[str, float]) -> float | None:
    """Return the period of the clock at given values [s], or ``None`` without a steady clock."""
    values = search.values.replaced(numbers)
    try:
        dynamics, start = search.first_system(values), search.starts_at(values)[0]
    except InputError:
        return None
    return steady_turn(dynamics, np.array(start))


def _check_multipliers(search: SearchProblem) -> None:
    """Reject an objective or a bound on the multipliers of orbits without multipliers.

    Raises:
        InputError: If the orbits do not have multipliers. The message contains the remedy.
    """
    bounded = any(bound.name == "spectral_radius" for bound in search.bounds)
    if not (bounded or isinstance(search.objective, MinSpectralRadius)):
        return
    dynamics = search.first_system(search.values)
    start = np.array(search.starts_at(search.values)[0])
    if len(start) - dynamics.holonomic(start).size > len(RELEASE_ROWS):
        return
    found = None if _is_without_release(search) else simulated(search, search.values).found
    graph = search.problem.graph_dynamics(search.values)
    if found is not None and not multipliers_of_return(graph, found):
        option = "bounds" if bounded else "objective"
        message = "must not ask for multipliers: the section of its releases is a point"
        raise InputError(f"Argument `{option}` {message}. Choose another objective or bound.")


def _is_without_release(search: SearchProblem) -> bool:
    shape = search.shape or (search.near.phases_as if search.near is not None else None)
    return shape is not None and not shape.n_releases


def check_objective(
    problem: Problem, objective: Objective, free: Mapping[str, tuple[float, float]]
) -> None:
    """Reject an objective that a problem does not have.

    Args:
        problem: The problem.
        objective: The objective.
        free: Name to range of the free values.

    Raises:
        InputError: If the objective is not valid. The message names the invalid part.
    """
    objective.check(problem, free)
    if objective.needs_source:
        _require_source(problem.compiled_graph(), "objective", objective.wish)


def check_bounds(graph: GraphDynamics, bounds: Sequence[Bound]) -> None:
    """Reject bounds on unknown quantities, on numbers of events, and bounds that nothing keeps.

    Args:
        graph: The graph of modes.
        bounds: The bounds.

    Raises:
        InputError: If a bound is not valid. The message names it.
    """
    signals = course_signal_names(graph.compiled)
    numbers = (PERIOD, ENERGY, *DIFFERENCED)
    for name in [bound.name for bound in bounds]:
        if "." not in name and name not in (*signals, *numbers):
            raise InputError(
                unknown("bounds", name, (*signals, *numbers, *event_quantity_names(graph)))
            )
        if name == ENERGY and name not in signals:
            _require_source(graph.compiled, "bounds", "the energy")
        if "." in name:
            require_event_quantity(name, graph, "bounds")
        if ".impacts" in name:
            raise InputError(
                f"Argument `bounds` must not bound the number `{name}`: bound a speed or a time."
            )
    require_possible_bounds(bounds)


def _require_source(compiled: CompiledGraph, argument: str, what: str) -> None:
    if not has_source(compiled):
        raise InputError(
            f"Argument `{argument}` asks for {what}, but the machine lacks a source of energy: "
            "give its drive an `input_power`, or ask for another quantity."
        )


def require_possible_bounds(bounds: Sequence[Bound]) -> None:
    """Reject bounds that no orbit can satisfy, and a quantity with two bounds.

    Args:
        bounds: The bounds.

    Raises:
        InputError: If a bound is not possible. The message contains the bound.
    """
    for k, bound in enumerate(bounds):
        if bound.name in [other.name for other in bounds[:k]]:
            message = f"must bound `{bound.name}` once, not twice"
            raise InputError(f"Argument `bounds` {message}.")
        if bound.name == "spectral_radius" and not math.isinf(bound.lower):
            message = "must bound `spectral_radius` from above only"
            raise InputError(f"Argument `bounds` {message}, but it has {bound.text}.")
        if bound.name == "spectral_radius" and bound.upper < LEAST_RADIUS:
            message = f"must bound `spectral_radius` by {LEAST_RADIUS:g} or more, as good as zero"
            raise InputError(f"Argument `bounds` {message}, but it has {bound.text}.")
        if bound.name == "margin" and bound.lower >= 1.0:
            message = "must ask for a `margin` below 1, the share that is left"
            raise InputError(f"Argument `bounds` {message}, but it has {bound.text}.")
        if bound.name == "period" and bound.upper <= 0.0:
            message = "must leave a positive `period`"
            raise InputError(f"Argument `bounds` {message}, but it has {bound.text}.")
