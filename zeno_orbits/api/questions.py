"""The inputs of a search: ranges, objective and settings, with notes for the user."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from zeno_orbits.search import free_gains as free_gains
from zeno_orbits.search import objective_help as objective_help
from zeno_orbits.search import objectives

if TYPE_CHECKING:
    from zeno_orbits.model import ParameterValues, Problem
    from zeno_orbits.orbits import Bound, Orbit
    from zeno_orbits.search import Objective, ObjectiveWord, SearchSettings


def objective_words() -> Mapping[str, ObjectiveWord]:
    """Return the objectives of a search, keyed by their words."""
    return objectives.OBJECTIVES


def search_settings(
    *, horizon: float | None = None, n_starts: int, seed: int = 0, candidates: int = 1
) -> SearchSettings:
    """Return the settings of a search.

    Args:
        horizon: Longest time of a simulation until it repeats [s].
        n_starts: Largest number of initial guesses after the first.
        seed: Random seed of these guesses.
        candidates: Number of orbits to rank.
    """
    from zeno_orbits.search import SearchSettings, TransientSettings

    settling = TransientSettings(horizon=horizon)
    return SearchSettings(settling=settling, n_starts=n_starts, seed=seed, candidates=candidates)


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchNotes:
    """The inputs of a search, with notes on its values.

    Attributes:
        free: Name to range of the unknowns.
        objective: The objective.
        bounds: The bounds that the orbit has to keep.
        held: Parameters that derive from unknowns and keep their values.
        far: Sentences on values far from their defaults, which may explain a failure.
        driven: True if a drive or a clock can supply the energy that impacts dissipate.
    """

    free: Mapping[str, tuple[float, float]]
    objective: Objective
    bounds: Sequence[Bound]
    held: Sequence[str]
    far: Sequence[str]
    driven: bool = True

    def at_ends(self, problem: Problem, orbit: Orbit) -> list[str]:
        """Return a sentence for each decision variable of an orbit at an end of its range.

        Args:
            problem: The problem.
            orbit: The orbit.
        """
        from zeno_orbits.search import number_notes

        goal: Mapping[str, Any] = self.objective.goal
        return number_notes.at_ends(problem, orbit.values(problem), self.free, goal)


def unit_notes(problem: Problem, numbers: Mapping[str, float]) -> list[str]:
    """Return a sentence for each given value that is 100 times the problem's own, or a part.

    Args:
        problem: The problem.
        numbers: Name to value of gains and parameters.
    """
    from zeno_orbits.search import far_from_own

    return far_from_own(problem, problem.values().replaced(numbers))


def energy_notes(problem: Problem, numbers: Mapping[str, float], named: str = "") -> list[str]:
    """Return a sentence for each part of a machine that supplies energy by a sign.

    Args:
        problem: The problem.
        numbers: Name to value of gains and parameters.
        named: Name or path of the problem as given. The signs of bundled problems are tested.
    """
    from zeno_orbits.model import bundled_problems, energy_sources

    if named in bundled_problems():
        return []
    return [one.text for one in energy_sources(problem, problem.values().replaced(numbers))]


def search_notes(
    problem: Problem,
    values: ParameterValues,
    *,
    free: Mapping[str, tuple[float, float]],
    objective: Objective,
    bounds: Sequence[Bound] = (),
) -> SearchNotes:
    """Return the inputs of a search, with notes on its values.

    Args:
        problem: The problem.
        values: The values from which the search starts.
        free: Name to range of the unknowns.
        objective: The objective.
        bounds: The bounds that the orbit has to keep.
    """
    from zeno_orbits.search import far_from_own, is_driven

    return SearchNotes(
        free=free,
        objective=objective,
        bounds=bounds,
        held=problem.derived_from(free, values.parameters),
        far=far_from_own(problem, values),
        driven=is_driven(problem),
    )
