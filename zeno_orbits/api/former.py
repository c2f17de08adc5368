"""Former entries of `find_orbit` and `search_gains`, with the arguments that have changed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from zeno_orbits.api.inputs import Named, whole
from zeno_orbits.api.orbit_search import find_orbit, search_gains
from zeno_orbits.orbits import Orbit
from zeno_orbits.work import checked

if TYPE_CHECKING:
    from zeno_orbits.search import SearchResult, SearchSettings
    from zeno_orbits.simulation import SimulationSettings


@checked
def find_event_orbit(
    problem: Named, *, settings: SimulationSettings | None = None, **asked: Any
) -> Orbit:
    """Return the orbit of `find_orbit`, stable or not.

    Args:
        problem: As for `find_orbit`.
        settings: Integrator and accuracy.
        asked: Further arguments of `find_orbit`.

    Raises:
        InputError: If a name is unknown or a value is out of range.
        OrbitNotFoundError: If no orbit is found and verified.
    """
    own = _settings(settings)
    return find_orbit(problem, settings=own, allow_unstable=True, **asked).unwrap()


@checked
def search_event_gains(
    problem: Named,
    *,
    n_starts: int = 12,
    seed: int = 0,
    candidates: int = 1,
    settings: SimulationSettings | None = None,
    **asked: Any,
) -> SearchResult:
    """Return the result of `search_gains`.

    Args:
        problem: As for `search_gains`.
        n_starts: As for `SearchSettings`.
        seed: As for `SearchSettings`.
        candidates: As for `SearchSettings`.
        settings: Integrator and accuracy.
        asked: Further arguments of `search_gains`.

    Raises:
        InputError: If a name is unknown, a value is out of range, or the objective needs another
            machine.
        WorkError: If the workers cannot finish.
    """
    own = replace(
        _settings(settings), n_starts=n_starts, seed=whole("seed", seed), candidates=candidates
    )
    return search_gains(problem, settings=own, **asked)


def _settings(simulation: SimulationSettings | None) -> SearchSettings:
    from zeno_orbits.search import SearchSettings
    from zeno_orbits.simulation import SimulationSettings

    return SearchSettings(simulation=simulation or SimulationSettings())
