"""Find orbits: one start after another, until enough are found and accepted, ranked."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from zeno_orbits.approach import from_start
from zeno_orbits.bounds import Bound, Extent, objection_to
from zeno_orbits.certificate import OrbitCertificate
from zeno_orbits.errors import InputError, ZenoOrbitsError
from zeno_orbits.finds import Find, SearchSettings, SearchStatus, Start, listed
from zeno_orbits.hunt import Hunt
from zeno_orbits.measures import measure
from zeno_orbits.models import compiled_model
from zeno_orbits.objectives import NearestGains, Objective, WantedAmplitude, WantedPeriod
from zeno_orbits.orbit import ZenoOrbit
from zeno_orbits.problem import Problem, Setting
from zeno_orbits.questions import Question, clipped, require_sense

__all__ = [
    "Attempt",
    "Candidate",
    "Judgement",
    "OrbitNotFoundError",
    "SearchResult",
    "SearchSettings",
    "SearchStatus",
    "find_orbit",
    "search_gains",
]

_SAME = 1e-6
"""Orbits whose free numbers and periods differ by less, relative, are the same candidate."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """What a check says of an orbit.

    Attributes:
        objection: Why it will not do; empty if it will.
        certificate: What the check saw, if it keeps a record.
    """

    objection: str = ""
    certificate: OrbitCertificate | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """An accepted orbit.

    Attributes:
        orbit: The orbit.
        score: How good it is; less is better.
        extents: What was measured of it: what is asked, and what is bounded.
        certificate: What the check saw, if it keeps a record.
    """

    orbit: ZenoOrbit
    score: float
    extents: Mapping[str, Extent]
    certificate: OrbitCertificate | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt:
    """One start of a search.

    Attributes:
        gains: Gains where it started.
        parameters: Free parameters where it started.
        status: How it ended.
        detail: The reason in words, for a start that found nothing.
    """

    gains: Mapping[str, float]
    parameters: Mapping[str, float] = field(default_factory=dict[str, float])
    status: SearchStatus
    detail: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchResult:
    """Outcome of a search, successful or not.

    Attributes:
        status: How it ended.
        orbit: The best orbit, if there is one.
        residuals: Row name to scaled violation in the program of the best.
        agreement: Relative difference of program and simulation over one period.
        closure_error: Estimated error of the Zeno closure, relative.
        n_unknowns: Unknowns of the program.
        iterations: Ipopt's iterations in it.
        solve_time: Wall time in Ipopt in it [s].
        wall_time: Wall time of the search [s].
        attempts: Every start, in order.
        candidates: The accepted orbits, the best first.
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
    candidates: tuple[Candidate, ...] = ()
    detail: str = ""

    def unwrap(self) -> ZenoOrbit:
        """Return the best orbit.

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """What came of one start, judged.

    Attributes:
        find: What was found.
        candidate: The orbit with what was measured of it, if it was accepted.
    """

    find: Find
    candidate: Candidate | None = None


def find_orbit(
    problem: Problem, setting: Setting, *, settings: SearchSettings | None = None
) -> SearchResult:
    """Find the orbit at given gains: as many conditions as unknowns.

    Args:
        problem: The scene.
        setting: Its numbers; there is one start.
        settings: How hard to look.
    """
    settings = replace(settings or SearchSettings(), n_starts=0)
    return search_gains(problem, setting, free={}, settings=settings)


def search_gains(
    problem: Problem,
    setting: Setting,
    *,
    free: Mapping[str, tuple[float, float]],
    objective: Objective | None = None,
    bounds: Sequence[Bound] = (),
    near: ZenoOrbit | None = None,
    settings: SearchSettings | None = None,
    accept: Callable[[ZenoOrbit], Judgement] | None = None,
    on_progress: Callable[[str], None] | None = None,
) -> SearchResult:
    """Find gains, parameters and initial states of an orbit, from one start after another.

    Args:
        problem: The scene.
        setting: Its numbers; what is free starts here, then at quasi-random places in its box.
        free: Name to bounds of the gains and parameters to be found; none at fixed numbers. What
            the scene derives from a free parameter keeps its number in ``setting``.
        objective: What is asked; by default numbers near their start.
        bounds: What the orbit must keep, whatever is asked.
        near: A known orbit of the scene to start from, at these numbers or near them.
        settings: How hard to look, and how many orbits to rank.
        accept: Says why an orbit will not do, or nothing if it will; any orbit does by default.
        on_progress: Called with what is being done.

    Returns:
        The accepted orbits, the best first, or why there is none.

    Raises:
        InputError: If a name is unknown or bounds are the wrong way round.
    """
    question = Question(free=free, objective=objective, bounds=tuple(bounds), near=near)
    require_sense(problem, question)
    objective = objective or NearestGains(target={})
    if isinstance(objective, NearestGains):
        # What has no target stays near its start, so the start is where the target can be met.
        setting = setting.replaced(objective.target)
        setting = clipped(setting, free)
        named = {**setting.gains, **{name: setting.number(name) for name in free}}
        objective = NearestGains(target=named)
    hunt = Hunt(
        problem=problem,
        compiled=compiled_model(problem),
        setting=setting,
        free=free,
        objective=objective,
        bounds=tuple(bounds),
        settings=settings or SearchSettings(),
        tell=on_progress or (lambda _: None),
    )
    return _search(hunt, near, accept)


def _search(
    hunt: Hunt, near: ZenoOrbit | None, accept: Callable[[ZenoOrbit], Judgement] | None
) -> SearchResult:
    started = time.perf_counter()
    attempts: list[Attempt] = []
    candidates: list[Candidate] = []
    best: Find | None = None
    failures = 0
    for start in _starts(hunt, near):
        numbers = hunt.numbers(start.setting)
        hunt.tell(f"start {len(attempts) + 1}: simulating {listed(numbers)}")
        trial = judged(hunt, from_start(hunt, start), accept, len(attempts) + 1)
        find = trial.find
        attempts.append(_attempt(hunt, start, find))
        failures += find.status not in (SearchStatus.NO_GUESS, SearchStatus.FOUND)
        if trial.candidate is None:
            best = find if best is None else max(best, find, key=_merit)
        else:
            if not any(_same(hunt, trial.candidate, other) for other in candidates):
                candidates.append(trial.candidate)
            if min(candidates, key=lambda one: one.score) is trial.candidate:
                best = find
        if len(candidates) >= hunt.settings.candidates:
            break
        if not candidates and failures >= _enough_failures(hunt):
            break
    if best is None:
        raise InputError("Argument `settings` must allow a start, but it allows none.")
    ranked = tuple(sorted(candidates, key=lambda one: one.score))
    return SearchResult(
        status=best.status,
        orbit=ranked[0].orbit if ranked else None,
        residuals={} if best.solution is None else best.solution.residuals,
        agreement=best.agreement,
        closure_error=best.closure_error,
        n_unknowns=best.n_unknowns,
        iterations=0 if best.solution is None else best.solution.iterations,
        solve_time=0.0 if best.solution is None else best.solution.wall_time,
        wall_time=time.perf_counter() - started,
        attempts=tuple(attempts),
        candidates=ranked,
        detail=best.detail,
    )


def judged(
    hunt: Hunt, find: Find, accept: Callable[[ZenoOrbit], Judgement] | None, number: int
) -> Trial:
    """Measure what a start found on a simulation, and let it be accepted or refused."""
    orbit = find.orbit
    if find.status is not SearchStatus.FOUND or orbit is None:
        return Trial(find=find)
    names = [*hunt.objective.quantities, *(bound.name for bound in hunt.bounds)]
    if not hunt.free:
        names = [bound.name for bound in hunt.bounds]
    extents: Mapping[str, Extent] = {}
    if names:
        hunt.tell(f"start {number}: measuring {', '.join(dict.fromkeys(names))}")
        try:
            extents = measure(orbit, hunt.problem, names)
        except ZenoOrbitsError as error:
            return Trial(
                find=replace(find, status=SearchStatus.NOT_ACCEPTED, orbit=None, detail=str(error))
            )
    objection, certificate = objection_to(hunt.bounds, extents), None
    if not objection and accept is not None:
        hunt.tell(f"start {number}: verifying")
        judgement = accept(orbit)
        objection, certificate = judgement.objection, judgement.certificate
    if objection:
        return Trial(find=replace(find, status=SearchStatus.NOT_ACCEPTED, detail=objection))
    found = orbit.setting(hunt.problem)
    score = 0.0
    if hunt.free:
        score = hunt.objective.score(
            {name: found.number(name) for name in hunt.free},
            {name: hunt.setting.number(name) for name in hunt.free},
            extents,
        )
    candidate = Candidate(orbit=orbit, score=score, extents=extents, certificate=certificate)
    return Trial(find=find, candidate=candidate)


def _attempt(hunt: Hunt, start: Start, find: Find) -> Attempt:
    parameters = start.setting.parameters
    return Attempt(
        gains=start.setting.gains,
        parameters={name: parameters[name] for name in hunt.free if name in parameters},
        status=find.status,
        detail=find.detail,
    )


def _same(hunt: Hunt, one: Candidate, other: Candidate) -> bool:
    """Tell whether two candidates are the same orbit at the same numbers."""
    a, b = one.orbit.setting(hunt.problem), other.orbit.setting(hunt.problem)
    pairs = [(a.number(name), b.number(name)) for name in hunt.free]
    pairs.append((one.orbit.period, other.orbit.period))
    return all(abs(p - q) <= _SAME * max(abs(p), abs(q)) for p, q in pairs)


def _enough_failures(hunt: Hunt) -> int:
    """Return how many starts with a good guess may fail before a search gives up.

    A wanted value or a bound is approached step by step from every start, which takes long and
    ends at much the same place.
    """
    slow = isinstance(hunt.objective, WantedPeriod | WantedAmplitude) or hunt.bounds
    return 2 if slow else 5


_RANK = {
    SearchStatus.NO_GUESS: 0,
    SearchStatus.NOT_SOLVED: 1,
    SearchStatus.NOT_FOLLOWED: 2,
    SearchStatus.NOT_ACCEPTED: 3,
    SearchStatus.FOUND: 4,
}


def _merit(find: Find) -> tuple[int, float]:
    return _RANK[find.status], -find.shortfall


def _starts(hunt: Hunt, near: ZenoOrbit | None) -> Iterator[Start]:
    """Yield the given numbers, moved into their box, then a Halton sequence in the box."""
    setting, free = hunt.setting, hunt.free
    first = clipped(setting, free)
    known = None
    if near is not None:
        release = np.array(hunt.problem.state_vector(near.release_state))
        known = (near.setting(hunt.problem), release)
    yield Start(setting=first, known=known, easy=_easy_settings(hunt.problem, first))
    if not free:
        return
    # SciPy's statistics take half a second to import, and most searches end at their first start.
    from scipy.stats import qmc

    lower, upper = np.array(list(free.values())).T
    sampler = qmc.Halton(len(free), seed=hunt.settings.seed)
    for point in sampler.random(hunt.settings.n_starts):
        chosen = dict(zip(free, map(float, lower + point * (upper - lower)), strict=True))
        yield Start(setting=setting.replaced(chosen))


def _easy_settings(problem: Problem, setting: Setting) -> tuple[Setting, ...]:
    """Return where an orbit is to be had more easily: the scene's own gains, a duller stop."""
    gains = {gain.name: gain.default for gain in problem.gains if gain.default is not None}
    own = setting.replaced(gains)
    dull = {"restitution": setting.parameters["restitution"] / 2}
    found = [own, setting.replaced(dull), own.replaced(dull), problem.setting()]
    return tuple(one for k, one in enumerate(found) if one != setting and one not in found[:k])
