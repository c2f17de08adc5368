"""Find orbits: one start after another, until one is found and accepted."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.errors import InputError, ZenoOrbitsError
from zeno_orbits.hunt import Find, Hunt, SearchSettings, SearchStatus, listed
from zeno_orbits.models import compiled_model
from zeno_orbits.objectives import NearestGains, Objective, WantedAmplitude, WantedPeriod
from zeno_orbits.orbit import ZenoOrbit
from zeno_orbits.problem import Problem, Setting

__all__ = [
    "Attempt",
    "OrbitNotFoundError",
    "SearchResult",
    "SearchSettings",
    "SearchStatus",
    "find_orbit",
    "search_gains",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt:
    """One start of a search.

    Attributes:
        gains: Where it started.
        status: How it ended.
        detail: The reason in words, for a start that found nothing.
    """

    gains: Mapping[str, float]
    status: SearchStatus
    detail: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchResult:
    """Outcome of a search, successful or not.

    Attributes:
        status: How it ended.
        orbit: The orbit, if there is one.
        residuals: Row name to scaled violation in the last program solved.
        agreement: Relative difference of program and simulation over one period.
        closure_error: Estimated error of the Zeno closure, relative.
        n_unknowns: Unknowns of the last program.
        iterations: Ipopt's iterations in it.
        solve_time: Wall time in Ipopt in it [s].
        wall_time: Wall time of the search [s].
        attempts: Every start, in order.
        detail: The reason in words, if there is no orbit.
    """

    status: SearchStatus
    orbit: ZenoOrbit | None
    residuals: Mapping[str, float]
    agreement: float
    closure_error: float
    n_unknowns: int
    iterations: int
    solve_time: float
    wall_time: float
    attempts: tuple[Attempt, ...]
    detail: str = ""

    def unwrap(self) -> ZenoOrbit:
        """Return the orbit.

        Raises:
            OrbitNotFoundError: If there is none; the error carries this result.
        """
        if self.orbit is None:
            raise OrbitNotFoundError(self)
        return self.orbit


class OrbitNotFoundError(ZenoOrbitsError):
    """A search ended without an orbit.

    Attributes:
        result: How it ended.
    """

    def __init__(self, result: SearchResult) -> None:
        super().__init__(f"{result.status.value} {result.detail}".strip())
        self.result = result


def find_orbit(
    problem: Problem, setting: Setting, *, settings: SearchSettings | None = None
) -> SearchResult:
    """Find the orbit at given gains: as many conditions as unknowns.

    Args:
        problem: The scene.
        setting: Its numbers.
        settings: How hard to look; there is one start.
    """
    settings = replace(settings or SearchSettings(), n_starts=0)
    return search_gains(problem, setting, free_gains={}, settings=settings)


def search_gains(
    problem: Problem,
    setting: Setting,
    *,
    free_gains: Mapping[str, tuple[float, float]],
    objective: Objective | None = None,
    settings: SearchSettings | None = None,
    accept: Callable[[ZenoOrbit], str] | None = None,
    on_progress: Callable[[str], None] | None = None,
) -> SearchResult:
    """Find gains and initial states of an orbit, from one start after another.

    Args:
        problem: The scene.
        setting: Its numbers; the free gains start here, then at quasi-random places in their box.
        free_gains: Name to bounds of the gains to be found; none for a search at fixed gains.
        objective: What is asked; by default gains near their start.
        settings: How hard to look.
        accept: Says why an orbit will not do, or nothing if it will; any orbit does by default.
        on_progress: Called with what is being done.

    Returns:
        The first accepted orbit, or why there is none.

    Raises:
        InputError: If a gain is unknown or its bounds are the wrong way round.
    """
    _check_box(problem, free_gains)
    _check_objective(problem, objective)
    started = time.perf_counter()
    objective = objective or NearestGains(target={})
    if isinstance(objective, NearestGains):
        # What has no target stays near its start, so the start is where the target can be met.
        setting = replace(setting, gains={**setting.gains, **objective.target})
        objective = NearestGains(target=_clipped(setting.gains, free_gains))
    hunt = Hunt(
        problem=problem,
        compiled=compiled_model(problem),
        setting=setting,
        free_gains=free_gains,
        objective=objective,
        settings=settings or SearchSettings(),
        tell=on_progress or (lambda _: None),
    )
    attempts: list[Attempt] = []
    best: Find | None = None
    failures = 0
    for gains in _starting_gains(setting.gains, free_gains, hunt.settings):
        hunt.tell(f"start {len(attempts) + 1}: simulating {listed(gains)}")
        find = hunt.from_gains(gains)
        if find.status is SearchStatus.FOUND and find.orbit is not None and accept is not None:
            hunt.tell(f"start {len(attempts) + 1}: verifying")
            objection = accept(find.orbit)
            if objection:
                find = replace(find, status=SearchStatus.NOT_ACCEPTED, detail=objection)
        attempts.append(Attempt(gains=gains, status=find.status, detail=find.detail))
        best = find if best is None else max(best, find, key=_merit)
        if find.status is SearchStatus.FOUND:
            break
        failures += find.status is not SearchStatus.NO_GUESS
        if failures >= _enough_failures(hunt.objective):
            break
    if best is None:
        raise InputError("Argument `settings` must allow a start, but it allows none.")
    return SearchResult(
        status=best.status,
        orbit=best.orbit if best.status is SearchStatus.FOUND else None,
        residuals={} if best.solution is None else best.solution.residuals,
        agreement=best.agreement,
        closure_error=best.closure_error,
        n_unknowns=best.n_unknowns,
        iterations=0 if best.solution is None else best.solution.iterations,
        solve_time=0.0 if best.solution is None else best.solution.wall_time,
        wall_time=time.perf_counter() - started,
        attempts=tuple(attempts),
        detail=best.detail,
    )


def _enough_failures(objective: Objective) -> int:
    """Return how many starts with a good guess may fail before a search gives up.

    A wanted value is approached step by step from every start, which takes long and ends at much
    the same place.
    """
    return 2 if isinstance(objective, WantedPeriod | WantedAmplitude) else 5


_RANK = {
    SearchStatus.NO_GUESS: 0,
    SearchStatus.NOT_SOLVED: 1,
    SearchStatus.NOT_FOLLOWED: 2,
    SearchStatus.NOT_ACCEPTED: 3,
    SearchStatus.FOUND: 4,
}


def _merit(find: Find) -> tuple[int, float]:
    return _RANK[find.status], -find.shortfall


def _starting_gains(
    given: Mapping[str, float],
    free: Mapping[str, tuple[float, float]],
    settings: SearchSettings,
) -> Iterator[dict[str, float]]:
    """Yield the given gains, moved into their box, then a Halton sequence in the box."""
    yield _clipped(given, free)
    if not free:
        return
    # SciPy's statistics take half a second to import, and most searches end at their first start.
    from scipy.stats import qmc

    lower, upper = np.array(list(free.values())).T
    sampler = qmc.Halton(len(free), seed=settings.seed)
    for point in sampler.random(settings.n_starts):
        chosen = dict(zip(free, map(float, lower + point * (upper - lower)), strict=True))
        yield {**given, **chosen}


def _check_objective(problem: Problem, objective: Objective | None) -> None:
    """Refuse a wish that names what the scene has not, or a value that nothing can have."""
    if isinstance(objective, NearestGains):
        known = [gain.name for gain in problem.gains]
        for name, value in objective.target.items():
            if name not in known:
                wanted = f"must name gains of the scene ({', '.join(known) or 'none'})"
                raise InputError(f"Argument `objective` {wanted}, but it names `{name}`.")
            if not math.isfinite(value):
                message = f"must be finite for `{name}`, but it is {value}"
                raise InputError(f"Argument `objective` {message}.")
    if isinstance(objective, WantedAmplitude) and objective.state not in problem.state_names:
        wanted = f"must name a state ({', '.join(problem.state_names)})"
        raise InputError(f"Argument `objective` {wanted}, but it names `{objective.state}`.")
    if isinstance(objective, WantedPeriod | WantedAmplitude) and not (
        0.0 < objective.target < math.inf
    ):
        message = f"must have a positive target, but it is {objective.target:g}"
        raise InputError(f"Argument `objective` {message}.")


def _clipped(
    gains: Mapping[str, float], box: Mapping[str, tuple[float, float]]
) -> dict[str, float]:
    return {n: min(max(v, box[n][0]), box[n][1]) if n in box else v for n, v in gains.items()}


def _check_box(problem: Problem, free_gains: Mapping[str, tuple[float, float]]) -> None:
    known = [gain.name for gain in problem.gains]
    for name, (lower, upper) in free_gains.items():
        if name not in known:
            message = (
                f"Argument `gain` must be one of {', '.join(known) or 'none'}, but it is `{name}`."
            )
            raise InputError(message)
        if not (np.isfinite(lower) and np.isfinite(upper) and lower < upper):
            wanted = "must have finite bounds LOWER < UPPER"
            raise InputError(f"Argument `{name}` {wanted}, but they are {lower:g}:{upper:g}.")
