"""Outcomes of a search, for each start and in total."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.maps import Push
from zeno_orbits.model import ParameterValues
from zeno_orbits.orbits import Bound, EventReturn, Orbit
from zeno_orbits.search.objectives import NearestGains, Objective
from zeno_orbits.search.search_problem import listed
from zeno_orbits.search.settings import SearchMethod, SearchStatus
from zeno_orbits.simulation import Extent
from zeno_orbits.verification import OrbitCertificate
from zeno_orbits.work import Columns, TableRepr, by_name


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """An accepted orbit, and its rank.

    Attributes:
        orbit: The orbit.
        score: Score of the orbit. A lower score is better.
        extents: Name to range of the measured quantities of the objective and the bounds.
        certificate: The certificate of the check, if available.
        starts: Number of starts that led to the orbit. An optimum from a single start may be local.
    """

    orbit: Orbit
    score: float
    extents: Mapping[str, Extent]
    certificate: OrbitCertificate | None
    starts: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulatedOrbit:
    """An orbit of a start, closed by simulation.

    Attributes:
        values: Its gains and parameters.
        found: The periodic return.
        orbit: The same as an orbit, not verified.
        extents: Name to range of the quantities of objective and bounds.
        result: The result of the search that led to it.
    """

    values: ParameterValues
    found: EventReturn
    orbit: Orbit
    extents: Mapping[str, Extent]
    result: SearchResult


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
        solution: The simulated orbit, if there is one. Other processes do not receive it.
        is_last: True if the orbit is the last before the end of a family.
        candidate: The orbit with its measured quantities, if it was accepted.
        result: The result of the search from the start without its orbit, if there was an orbit.
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
    solution: SimulatedOrbit | None = None
    is_last: bool = False
    candidate: Candidate | None = None
    result: SearchResult | None = None


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
        certificate: Certificate of the orbit, ``None`` without a check.
        objective: The objective.
        free: Name to free value at the end of the search.
        value: The objective at the search's own parameters.
        worst: The objective at the worst corner, or at the search's own parameters.
        worst_at: Name to value of the uncertain parameters there, empty at the search's own.
        mean: Mean of the objective over the corners, ``None`` without uncertain parameters.
        asked: The bounds with the ranges that the orbit reaches.
        vanishing: Speed of each impact that vanishes at the end of the search, by its stop.
        least_speeds: Bounds that keep a tenth of the first speeds of these impacts.
        n_orbits: Number of orbits that were closed from all starts.
        push: The least push at the worst corner, if the objective is the largest one.
        method: The method that found the optimum. Never `SearchMethod.AUTO`.
        remarks: What one method says about the optimum of the other one, as sentences.
        residuals: Row name to scaled violation in the program of the best start.
        agreement: Relative difference of program and simulation over one period. Infinite without a
            program, as for shooting.
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
    certificate: OrbitCertificate | None = None
    objective: Objective = field(default_factory=lambda: NearestGains(target={}))
    free: Mapping[str, float] = field(default_factory=dict[str, float])
    value: float = math.nan
    worst: float = math.nan
    worst_at: Mapping[str, float] = field(default_factory=dict[str, float])
    mean: float | None = None
    asked: tuple[Mapping[str, Any], ...] = ()
    vanishing: Mapping[str, float] = field(default_factory=dict[str, float])
    least_speeds: tuple[Bound, ...] = ()
    n_orbits: int = 0
    push: Push | None = None
    method: SearchMethod = SearchMethod.SHOOTING
    remarks: tuple[str, ...] = ()
    residuals: Mapping[str, float] = field(default_factory=dict[str, float])
    agreement: float = math.inf
    closure_error: float = math.inf
    n_unknowns: int = 0
    iterations: int = 0
    solve_time: float = 0.0
    wall_time: float = 0.0
    attempts: tuple[StartAttempt, ...] = ()
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
            OrbitNotFoundError: If no orbit was found and accepted. The error contains this result.
        """
        if self.orbit is None or self.status is not SearchStatus.FOUND:
            raise OrbitNotFoundError(self)
        return self.orbit

    @property
    def is_measured(self) -> bool:
        """True if the objective is a quantity of the orbit, and not a distance of values."""
        return self.objective.is_measured

    @property
    def score(self) -> float:
        """Score of the orbit. A lower score is better."""
        return -self.worst if self.objective.is_maximized else self.worst

    @property
    def told_push(self) -> str:
        """The least push, where it occurs and the motion beyond it. Empty for other objectives."""
        if self.push is None:
            return ""
        return said_of(self.push, f" (at {listed(self.worst_at)})" if self.worst_at else "")

    def as_json(self) -> dict[str, Any]:
        """Return the outcome without the orbit, as plain data."""
        return {
            "free": dict(self.free),
            "objective": self.objective.wish,
            "value": _finite(self.value),
            "worst": _finite(self.worst),
            "worst_at": dict(self.worst_at),
            "mean": self.mean,
            "asked": [dict(one) for one in self.asked],
            "vanishing": dict(self.vanishing),
            "n_orbits": self.n_orbits,
            "push": None if self.push is None else self.push.as_json(),
            "detail": self.detail,
            "method": self.method.value,
            "iterations": self.iterations,
            "remarks": list(self.remarks),
        }


class OrbitNotFoundError(ZenoOrbitsError):
    """A search ended without an orbit.

    Attributes:
        result: The outcome.
    """

    def __init__(self, result: SearchResult) -> None:
        super().__init__(f"{result.status.value} {result.detail}".strip())
        self.result = result


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def said_of(push: Push, at: str = "") -> str:
    """Return a least push and the motion beyond it, as sentences.

    Args:
        push: The push.
        at: Where it occurs, in words that begin with a blank.
    """
    if not math.isfinite(push.largest):
        return f"No push up to {push.searched:.4g} {push.unit} is lost."
    said = f"{push.largest:.4g} {push.unit} along {push.name}"
    return f"The least push is {said} at phase {push.phase:.4g}{at}. Beyond it: {push.beyond}."
