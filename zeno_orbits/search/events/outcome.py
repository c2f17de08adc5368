"""Outcome of a search for orbits of events, and the candidates of several starts."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from zeno_orbits.maps import Push
from zeno_orbits.orbits import Bound, Orbit
from zeno_orbits.search.objectives import MaxMargin, MaxPush, Objective
from zeno_orbits.search.outcome import Accepted, StartAttempt, Verdict
from zeno_orbits.search.search_problem import listed
from zeno_orbits.search.settings import SearchMethod
from zeno_orbits.search.strength import said_of
from zeno_orbits.verification import OrbitCertificate

AcceptEvents = Callable[[Orbit], Verdict]
"""A check of the orbits of a search."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EventCandidate(Accepted):
    """An accepted orbit of events."""

    orbit: Orbit


@dataclass(frozen=True, slots=True, kw_only=True)
class EventSearchResult:
    """The best orbit of events in given ranges, or why there is none.

    Attributes:
        orbit: The orbit, or ``None``.
        free: Name to free value at the end of the search.
        objective: The objective.
        value: The objective at the search's own parameters.
        worst: The objective at the worst corner, or at the search's own parameters.
        worst_at: Name to value of the uncertain parameters there, empty at the search's own.
        mean: Mean of the objective over the corners, ``None`` without uncertain parameters.
        asked: The bounds with the ranges that the orbit reaches.
        vanishing: Speed of each impact that vanishes at the end of the search, by its stop.
        least_speeds: Bounds that keep a tenth of the first speeds of these impacts.
        n_orbits: Number of orbits that were closed.
        push: The least push at the worst corner, if the objective is the largest one.
        certificate: Certificate of the orbit, ``None`` without a check.
        detail: Reason why there is no orbit, or why the search ended early.
        candidates: The accepted orbits, the best first, if several were requested.
        attempts: Every start, in order, if several orbits were requested.
        n_states: Number of initial states in the search for other attractors at the best values.
        method: The method that found the optimum. Never `SearchMethod.AUTO`.
        iterations: Number of iterations of Ipopt.
        remarks: What one method says about the optimum of the other one, as sentences.
    """

    orbit: Orbit | None
    free: Mapping[str, float] = field(default_factory=dict[str, float])
    objective: Objective
    value: float = math.nan
    worst: float = math.nan
    worst_at: Mapping[str, float] = field(default_factory=dict[str, float])
    mean: float | None = None
    asked: tuple[Mapping[str, Any], ...] = ()
    vanishing: Mapping[str, float] = field(default_factory=dict[str, float])
    least_speeds: tuple[Bound, ...] = ()
    n_orbits: int = 0
    push: Push | None = None
    certificate: OrbitCertificate | None = None
    detail: str = ""
    candidates: tuple[EventCandidate, ...] = ()
    attempts: tuple[StartAttempt, ...] = ()
    n_states: int = 0
    method: SearchMethod = SearchMethod.SHOOTING
    iterations: int = 0
    remarks: tuple[str, ...] = ()

    @property
    def is_measured(self) -> bool:
        """True if the objective is a quantity of the orbit, and not a distance of values."""
        return bool(self.objective.is_sampled or self.objective.quantities)

    @property
    def score(self) -> float:
        """Score of the orbit. A lower score is better."""
        is_maximized = isinstance(self.objective, MaxPush | MaxMargin)
        return -self.worst if is_maximized else self.worst

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


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
