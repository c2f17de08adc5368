"""Outcomes of a search: of each start, and of all of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from zeno_orbits.arrays import Array
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.model import ParameterValues
from zeno_orbits.orbits import Cycle, ZenoOrbit
from zeno_orbits.search.settings import SearchStatus
from zeno_orbits.simulation import Extent
from zeno_orbits.verification import OrbitCertificate
from zeno_orbits.work import Columns, Displayed, by_name


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """The verdict of a check on an orbit.

    Attributes:
        objection: Reason of a refusal; empty if the orbit is accepted.
        certificate: The certificate of the check, if it keeps one.
    """

    objection: str = ""
    certificate: OrbitCertificate | None = None

    @property
    def repels(self) -> bool:
        """Return True if the orbit is refused although it is one: it does not attract."""
        certificate = self.certificate
        return bool(
            self.objection and certificate and certificate.passed and not certificate.stable
        )


Accept = Callable[[ZenoOrbit], Judgement]
"""A check of the orbits that a search finds."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """An accepted orbit.

    Attributes:
        orbit: The orbit.
        score: Its score; less is better.
        extents: Measured quantities, those of the objective and the bounded ones, by name.
        certificate: The certificate of the check, if it keeps one.
        starts: Number of starts that led to it: an optimum that one start found may be local.
    """

    orbit: ZenoOrbit
    score: float
    extents: Mapping[str, Extent]
    certificate: OrbitCertificate | None
    starts: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedSolution:
    """A solution of a program and the period that a simulation makes of it.

    Attributes:
        values: Numbers of the solution.
        cycle: The period.
        unknowns: Name of each block of unknowns and each report to its values.
        orbit: The orbit, if program and simulation agree.
        excesses: Name to the amount by which the period passes a bound.
    """

    values: ParameterValues
    cycle: Cycle
    unknowns: Mapping[str, Array]
    orbit: ZenoOrbit | None
    excesses: Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class StartOutcome:
    """Outcome of one start, or of one of its programs.

    Attributes:
        status: The end.
        start: Name to value of what is free where it started.
        detail: The reason in words, if nothing was accepted.
        undecided: True if a motion had settled to nothing when its time was over.
        repels: True if the orbit was refused because it does not attract.
        residuals: Row name to scaled violation in its last program.
        agreement: Relative difference of program and simulation over one period.
        closure_error: Estimated error of the Zeno closure, relative.
        n_unknowns: Unknowns of the program.
        iterations: Ipopt's iterations in it.
        solve_time: Wall time in Ipopt in it [s].
        shortfall: Distance from a target at which it ended, or by how much it passes its bounds, in
            units of their sizes.
        solution: The simulated solution of the program, if there is one; it does not leave the
            process.
        candidate: The orbit with what was measured of it, if it was accepted.
    """

    status: SearchStatus
    start: Mapping[str, float] = field(default_factory=dict[str, float])
    detail: str = ""
    undecided: bool = False
    repels: bool = False
    residuals: Mapping[str, float] = field(default_factory=dict[str, float])
    agreement: float = np.inf
    closure_error: float = np.inf
    n_unknowns: int = 0
    iterations: int = 0
    solve_time: float = 0.0
    shortfall: float = np.inf
    solution: SimulatedSolution | None = None
    candidate: Candidate | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class StartAttempt:
    """One start of a search, for the user.

    Attributes:
        gains: Gains where it started.
        parameters: Free parameters where it started.
        status: The end.
        detail: The reason in words, for a start that found nothing.
    """

    gains: Mapping[str, float]
    parameters: Mapping[str, float] = field(default_factory=dict[str, float])
    status: SearchStatus
    detail: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class SearchResult(Displayed):
    """Outcome of a search, successful or not.

    Attributes:
        status: The end.
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
        undecided: True if a motion had settled to nothing when its time was over: a longer wait may
            tell.
        repels: True if an orbit was refused because it does not attract.
        scan: What motions settle to all over the box, if there is no orbit and it was looked at.
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
    attempts: tuple[StartAttempt, ...]
    candidates: tuple[Candidate, ...] = ()
    detail: str = ""
    undecided: bool = False
    repels: bool = False
    scan: str = ""

    def __repr__(self) -> str:
        """Return a few lines: the status and the best orbit."""
        best = f"\n  {self.orbit!r}" if self.orbit is not None else ""
        detail = f"{self.status.value} {self.detail}".strip()
        return (
            f"<SearchResult {self.status.name}: {detail} starts={len(self.attempts)}, "
            f"candidates={len(self.candidates)}, wall_time={self.wall_time:.1f} s{best}>"
        )

    def _columns(self) -> Columns:
        """Return the accepted orbits, the best first."""
        orbits = [candidate.orbit for candidate in self.candidates]
        return {
            **by_name([orbit.gains for orbit in orbits]),
            "period": [orbit.period for orbit in orbits],
            "impacts": [len(orbit.impacts) for orbit in orbits],
            "score": [candidate.score for candidate in self.candidates],
        }

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
        result: The outcome.
    """

    def __init__(self, result: SearchResult) -> None:
        super().__init__(f"{result.status.value} {result.detail}".strip())
        self.result = result
