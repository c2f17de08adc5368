"""One start of a search from beginning to end: what it found, measured and judged."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.orbits.bounds import objection_to
from zeno_orbits.orbits.orbit import ZenoOrbit
from zeno_orbits.search.refinement import Hunt
from zeno_orbits.search.settings import Find, SearchStatus, Start, listed
from zeno_orbits.search.strategy import from_start
from zeno_orbits.simulation.signals import Extent
from zeno_orbits.verification.certificate import OrbitCertificate
from zeno_orbits.verification.measurement import measure


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """What a check says of an orbit.

    Attributes:
        objection: Why it will not do; empty if it will.
        certificate: What the check saw, if it keeps a record.
    """

    objection: str = ""
    certificate: OrbitCertificate | None = None


Accept = Callable[[ZenoOrbit], Judgement]
"""Says why an orbit will not do, or nothing if it will."""


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
class Trial:
    """What came of one start, judged.

    Attributes:
        status: How it ended.
        detail: The reason in words, if nothing was accepted.
        residuals: Row name to scaled violation in its last program.
        agreement: Relative difference of program and simulation over one period.
        closure_error: Estimated error of the Zeno closure, relative.
        n_unknowns: Unknowns of the program.
        iterations: Ipopt's iterations in it.
        solve_time: Wall time in Ipopt in it [s].
        shortfall: How far from a wanted value it ended, or by how much it passes its bounds.
        candidate: The orbit with what was measured of it, if it was accepted.
    """

    status: SearchStatus
    detail: str = ""
    residuals: Mapping[str, float] = field(default_factory=dict[str, float])
    agreement: float = np.inf
    closure_error: float = np.inf
    n_unknowns: int = 0
    iterations: int = 0
    solve_time: float = 0.0
    shortfall: float = np.inf
    candidate: Candidate | None = None


def tried(hunt: Hunt, start: Start, accept: Accept | None, number: int) -> Trial:
    """Search from one start and judge what comes of it.

    Args:
        hunt: The search.
        start: Where it starts.
        accept: Says why an orbit will not do; any will by default.
        number: Which start it is, for words of progress.
    """
    hunt.tell(f"start {number}: simulating {listed(hunt.numbers(start.values))}")
    return _judged(hunt, from_start(hunt, start), accept, number)


def _judged(hunt: Hunt, find: Find, accept: Accept | None, number: int) -> Trial:
    """Measure what a start found on a simulation, and let it be accepted or refused."""
    orbit = find.orbit
    if find.status is not SearchStatus.FOUND or orbit is None:
        return _trial(find)
    try:
        extents = _measured(hunt, orbit, number)
    except ZenoOrbitsError as error:
        return _trial(replace(find, status=SearchStatus.NOT_ACCEPTED, detail=str(error)))
    objection, certificate = objection_to(hunt.bounds, extents), None
    if not objection and accept is not None:
        hunt.tell(f"start {number}: verifying")
        judgement = accept(orbit)
        objection, certificate = judgement.objection, judgement.certificate
    if objection:
        return _trial(replace(find, status=SearchStatus.NOT_ACCEPTED, detail=objection))
    score = _score(hunt, orbit, extents)
    candidate = Candidate(orbit=orbit, score=score, extents=extents, certificate=certificate)
    return _trial(find, candidate)


def _measured(hunt: Hunt, orbit: ZenoOrbit, number: int) -> Mapping[str, Extent]:
    names = [bound.name for bound in hunt.bounds]
    if hunt.free:
        names = [*hunt.objective.quantities, *names]
    if not names:
        return {}
    hunt.tell(f"start {number}: measuring {', '.join(dict.fromkeys(names))}")
    return measure(orbit, hunt.problem, names)


def _score(hunt: Hunt, orbit: ZenoOrbit, extents: Mapping[str, Extent]) -> float:
    if not hunt.free:
        return 0.0
    found = orbit.values(hunt.problem)
    return hunt.objective.score(
        {name: found.number(name) for name in hunt.free},
        {name: hunt.values.number(name) for name in hunt.free},
        extents,
    )


def _trial(find: Find, candidate: Candidate | None = None) -> Trial:
    solution = find.solution
    return Trial(
        status=find.status,
        detail=find.detail,
        residuals={} if solution is None else solution.residuals,
        agreement=find.agreement,
        closure_error=find.closure_error,
        n_unknowns=find.n_unknowns,
        iterations=0 if solution is None else solution.iterations,
        solve_time=0.0 if solution is None else solution.wall_time,
        shortfall=find.shortfall,
        candidate=candidate,
    )
