"""Refuse searches that make no sense for their problem."""

from __future__ import annotations

import math
from collections.abc import Mapping

from zeno_orbits.errors import InputError
from zeno_orbits.model import Problem
from zeno_orbits.orbits import Bound
from zeno_orbits.search.objectives import LEAST_RADIUS
from zeno_orbits.search.search_problem import SearchProblem
from zeno_orbits.verification import require_quantities


def check_search(search: SearchProblem) -> None:
    """Refuse a search that names what the problem has not, or that nothing can answer.

    Raises:
        InputError: It names what is wrong.
    """
    problem, near = search.problem, search.near
    _check_boxes(problem, search.free)
    for state in search.initial_states:
        problem.state_vector(state)
    search.objective.check(problem, search.free)
    _check_bounds(problem, search.bounds)
    if near is not None and near.problem != problem.name:
        message = f"must be of problem `{problem.name}`, but it is of `{near.problem}`"
        raise InputError(f"Argument `near` {message}.")


def _check_boxes(problem: Problem, free: Mapping[str, tuple[float, float]]) -> None:
    for name, box in free.items():
        problem.require_range(name, box, argument="free")


def _check_bounds(problem: Problem, bounds: tuple[Bound, ...]) -> None:
    require_quantities([bound.name for bound in bounds], problem, "keep")
    for k, bound in enumerate(bounds):
        if bound.name in [other.name for other in bounds[:k]]:
            message = f"must bound `{bound.name}` once, but it does so twice"
            raise InputError(f"Argument `keep` {message}.")
        if bound.name == "spectral_radius" and not math.isinf(bound.lower):
            message = "must bound `spectral_radius` from above only"
            raise InputError(f"Argument `keep` {message}, but it has {bound.text}.")
        if bound.name == "spectral_radius" and bound.upper < LEAST_RADIUS:
            message = f"must bound `spectral_radius` by {LEAST_RADIUS:g} or more, as good as zero"
            raise InputError(f"Argument `keep` {message}, but it has {bound.text}.")
        if bound.name == "margin" and bound.lower >= 1.0:
            message = "must ask for a `margin` below 1, the share that is left"
            raise InputError(f"Argument `keep` {message}, but it has {bound.text}.")
        if bound.name == "period" and bound.upper <= 0.0:
            message = "must leave a positive `period`"
            raise InputError(f"Argument `keep` {message}, but it has {bound.text}.")
