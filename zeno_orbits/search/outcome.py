"""Outcomes of a search, for each start and in total."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from zeno_orbits.arrays import Array
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.model import ParameterValues
from zeno_orbits.orbits import Cycle, Orbit
from zeno_orbits.search.settings import SearchStatus
from zeno_orbits.simulation import Extent
from zeno_orbits.verification import OrbitCertificate
from zeno_orbits.work import Columns, TableRepr, by_name


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """The verdict of a check on an orbit.

    Attributes:
        objection: Reason of a rejection. Empty for an accepted orbit.
        certificate: The certificate of the check, if available.
    """

    objection: str = ""
    certificate: OrbitCertificate | None = None

    @property
    def repels(self) -> bool:
        """Return True if the orbit is rejected only because it is unstable."""
        certificate = self.certificate
        return bool(
            self.objection and certificate and certificate.passed and not certificate.stable
        )


Accept = Callable[[Orbit], Verdict]
"""A check of the orbits of a search."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Accepted:
    """The rank of an accepted orbit.

    Attributes:
        score: Score of the orbit. A lower score is better.
        certificate: The certificate of the check, if available.
        starts: Number of starts that led to the orbit. An optimum from a single start may be local.
    """

    score: float
    certificate: OrbitCertificate | None
    starts: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate(Accepted):
    """An accepted orbit, with the measured quantities of the objective and the bounds by name."""

    orbit: Orbit
    extents: Mapping[str, Extent]


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedSolution:
    """A solution of a program and its simulated period.

    Attributes:
        values: Gains and parameters of the solution.
        cycle: The period.
        unknowns: Name of each block of unknowns and each report to its values.
        orbit: The orbit, if program and simulation agree.
        excesses: Name to the excess of the period over a bound.
    """

    values: ParameterValues
    cycle: Cycle
    unknowns: Mapping[str, Array]
    orbit: Orbit | None
    excesses: Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class StartOutcome:
    """Outcome of one start, or of one of its programs.

    Attributes:
        status: Status of the start.
        start: Name to initial value of each free value.
        detail: Reason of a failure, or a remark on the orbit, as a sentence.
        undecided: True if a simulation had not converged at its time limit.
        repels: True if the orbit was rejected because it is unstable.
        residuals: Row name to scaled violation in the last program.
        agreement: Relative difference of program and simulation over one period.
        closure_error: Estimated relative error of the Zeno closure.
        n_unknowns: Number of unknowns of the program.
        iterations: Number of Ipopt iterations for the program.
        solve_time: Wall time in Ipopt for the program [s].
        shortfall: Remaining distance from a target, or violation of the bounds in units of their
            sizes.
        solution: The simulated solution of the program, if available. Other processes
            do not receive it.
        candidate: The orbit with its measured quantities, if it was accepted.
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
        gains: Initial values of the gains.
        parameters: Initial values of the free parameters.
        status: Status of the start.
        detail: Reason of a failure, as a sentence.
    """

    gains: Mapping[str, float]
    parameters: Mapping[str, float] = field(default_factory=dict[str, float])
    status: SearchStatus
    detail: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class SearchResult(TableRepr):
    """Outcome of a search, successful or not.

    Attributes:
        status: Status of the search.
        orbit: The best orbit, or ``None`` after a failure.
        residuals: Row name to scaled violation in the program of the best start.
        agreement: Relative difference of program and simulation over one period.
        closure_error: Estimated relative error of the Zeno closure.
        n_unknowns: Number of unknowns of the program.
        iterations: Number of Ipopt iterations for the program.
        solve_time: Wall time in Ipopt for the program [s].
        wall_time: Wall time of the search [s].
        attempts: Every start, in order.
        candidates: The accepted orbits, the best first.
        detail: Reason of a failure, or a remark on the best orbit, as a sentence.
        undecided: True if a simulation had not converged at its time limit. A larger limit may
            help.
        repels: True if an orbit was rejected because it is unstable.
        scan: Attractors all over the box, as a sentence, if no orbit was found and the box was
            scanned.
        n_states: Number of initial states in the search for other attractors at the best values.
    """

    status: SearchStatus
    orbit: Orbit | None
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
    n_states: int = 0

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

    def unwrap(self) -> Orbit:
        """Return the best orbit.

        Raises:
            OrbitNotFoundError: If no orbit was found. The error contains this result.
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
