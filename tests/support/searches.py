"""Questions of a search for tests that ask its parts, not the whole."""

from __future__ import annotations

from typing import Any

from zeno_orbits.model import Problem
from zeno_orbits.search import NearestGains, SearchSettings
from zeno_orbits.search.search_problem import SearchProblem


def question_of(problem: Problem, **changes: Any) -> SearchProblem:
    """Return a search for the orbit nearest to the problem's own numbers, with `Kp` free.

    Args:
        problem: The problem.
        changes: Fields that are otherwise.
    """
    told: dict[str, Any] = {
        "problem": problem,
        "values": problem.values(),
        "free": {"Kp": (2.0, 4.0)},
        "objective": NearestGains(target={}),
        "initial_states": problem.starts,
        "settings": SearchSettings(),
    }
    return SearchProblem(**told | changes)
