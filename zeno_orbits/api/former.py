"""Former entries of `find_orbit` and `search_gains`, with their former arguments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from zeno_orbits.api.inputs import Named, Numbers, front_door, whole
from zeno_orbits.api.orbit_search import find_orbit, search_gains
from zeno_orbits.orbits import Orbit
from zeno_orbits.work import ExecutionPlan, Progress, silent

if TYPE_CHECKING:
    from zeno_orbits.orbits import Bound, EventSequence
    from zeno_orbits.search import Objective, SearchMethod, SearchResult, SearchSettings
    from zeno_orbits.simulation import SimulationSettings


@front_door
def find_event_orbit(
    problem: Named,
    *,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    near: Orbit | str | Path | None = None,
    start: Numbers | None = None,
    section: str | None = None,
    shape: EventSequence | None = None,
    until: float | None = None,
    settings: SimulationSettings | None = None,
    on_progress: Progress = silent,
) -> Orbit:
    """Return the orbit of `find_orbit`, stable or not.

    Args:
        problem: As for `find_orbit`.
        gains: As for `find_orbit`.
        parameters: As for `find_orbit`.
        near: As for `find_orbit`.
        start: As for `find_orbit`.
        section: As for `find_orbit`.
        shape: As for `find_orbit`.
        until: Longest time to settle [s].
        settings: Integrator and accuracy.
        on_progress: As for `find_orbit`.

    Raises:
        InputError: If a name is unknown or a value is out of range.
        OrbitNotFoundError: If no orbit is found and verified.
    """
    return find_orbit(
        problem,
        gains=gains,
        parameters=parameters,
        near=near,
        start=start,
        section=section,
        shape=shape,
        until=until,
        settings=_settings(settings),
        allow_unstable=True,
        on_progress=on_progress,
    ).unwrap()


@front_door
def search_event_gains(
    problem: Named,
    *,
    vary: Mapping[str, tuple[float, float]] | None = None,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    start: Numbers | None = None,
    near: Orbit | str | Path | None = None,
    objective: Objective | None = None,
    bounds: Sequence[Bound] = (),
    section: str | None = None,
    shape: EventSequence | None = None,
    until: float | None = None,
    n_starts: int = 12,
    seed: int = 0,
    candidates: int = 1,
    method: SearchMethod | None = None,
    allow_unstable: bool = False,
    settings: SimulationSettings | None = None,
    workers: int = 1,
    plan: ExecutionPlan | None = None,
    on_progress: Progress = silent,
) -> SearchResult:
    """Return the result of `search_gains`.

    Args:
        problem: As for `search_gains`.
        vary: As for `search_gains`.
        gains: As for `search_gains`.
        parameters: As for `search_gains`.
        start: As for `search_gains`.
        near: As for `search_gains`.
        objective: As for `search_gains`.
        bounds: As for `search_gains`.
        section: As for `search_gains`.
        shape: As for `search_gains`.
        until: Longest time to settle [s].
        n_starts: As for `SearchSettings`.
        seed: As for `SearchSettings`.
        candidates: As for `SearchSettings`.
        method: As for `search_gains`.
        allow_unstable: As for `search_gains`.
        settings: Integrator and accuracy.
        workers: As for `search_gains`.
        plan: As for `search_gains`.
        on_progress: As for `search_gains`.

    Raises:
        InputError: If a name is unknown, a value is out of range, or the objective needs another
            machine.
        WorkError: If the workers cannot finish.
    """
    from dataclasses import replace

    own = replace(
        _settings(settings),
        n_starts=n_starts,
        seed=whole("seed", seed),
        candidates=candidates,
    )
    return search_gains(
        problem,
        vary=vary,
        gains=gains,
        parameters=parameters,
        start=start,
        near=near,
        objective=objective,
        bounds=bounds,
        section=section,
        shape=shape,
        until=until,
        method=method,
        settings=own,
        allow_unstable=allow_unstable,
        workers=workers,
        plan=plan,
        on_progress=on_progress,
    )


def _settings(simulation: SimulationSettings | None) -> SearchSettings:
    from zeno_orbits.search import SearchSettings
    from zeno_orbits.simulation import SimulationSettings

    return SearchSettings(simulation=simulation or SimulationSettings())
