"""What a search is asked, and whether it makes sense for a problem."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from zeno_orbits.errors import InputError
from zeno_orbits.model.problem import ParameterValues, Problem
from zeno_orbits.orbits.bounds import Bound
from zeno_orbits.orbits.orbit import ZenoOrbit
from zeno_orbits.search.objectives import (
    LeastPeak,
    NearestGains,
    Objective,
    WantedAmplitude,
    WantedPeriod,
)
from zeno_orbits.search.spectral_radius import LEAST_RADIUS
from zeno_orbits.verification.measurement import require_quantities


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """What a search is asked.

    Attributes:
        free: Name to bounds of the gains and parameters to be found.
        objective: What is asked.
        bounds: What the orbit must keep.
        near: A known orbit to start from.
    """

    free: Mapping[str, tuple[float, float]]
    objective: Objective | None
    bounds: tuple[Bound, ...]
    near: ZenoOrbit | None


def require_sense(problem: Problem, question: Question) -> None:
    """Refuse a question that names what the problem has not, or that nothing can answer.

    Raises:
        InputError: It names what is wrong.
    """
    _check_boxes(problem, question.free)
    _check_objective(problem, question)
    _check_bounds(problem, question.bounds)
    if question.near is not None and question.near.problem != problem.name:
        message = f"must be of problem `{problem.name}`, but it is of `{question.near.problem}`"
        raise InputError(f"Argument `near` {message}.")


def clipped(values: ParameterValues, free: Mapping[str, tuple[float, float]]) -> ParameterValues:
    """Return a setting moved into the box of what is free."""
    return values.replaced(
        {name: min(max(values.number(name), low), high) for name, (low, high) in free.items()}
    )


def _check_boxes(problem: Problem, free: Mapping[str, tuple[float, float]]) -> None:
    for name, box in free.items():
        problem.require_range(name, box, argument="free")


def _check_objective(problem: Problem, question: Question) -> None:
    objective = question.objective
    if isinstance(objective, NearestGains):
        known = [*(gain.name for gain in problem.gains)]
        known += [name for name in question.free if name not in known]
        for name, value in objective.target.items():
            if name not in known:
                listed = ", ".join(known) or "none"
                wanted = f"must name gains of the problem or what is free ({listed})"
                raise InputError(f"Argument `objective` {wanted}, but it names `{name}`.")
            if not math.isfinite(value):
                message = f"must be finite for `{name}`, but it is {value}"
                raise InputError(f"Argument `objective` {message}.")
    if isinstance(objective, WantedAmplitude) and objective.state not in problem.state_names:
        wanted = f"must name a state ({', '.join(problem.state_names)})"
        raise InputError(f"Argument `objective` {wanted}, but it names `{objective.state}`.")
    if isinstance(objective, LeastPeak):
        require_quantities([objective.signal], problem, "objective")
    if isinstance(objective, WantedPeriod | WantedAmplitude) and not (
        0.0 < objective.target < math.inf
    ):
        message = f"must have a positive target, but it is {objective.target:g}"
        raise InputError(f"Argument `objective` {message}.")


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
