"""A search as a value: its problem, its objective with bounds, its check and its settings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from zeno_orbits.model import HybridDynamics, ParameterValues, Problem
from zeno_orbits.orbits import Bound, EventSequence, Orbit
from zeno_orbits.search.nearness import nearness_of
from zeno_orbits.search.objectives import NearestGains, Objective
from zeno_orbits.search.settings import SearchMethod, SearchSettings
from zeno_orbits.simulation import Extent
from zeno_orbits.verification import OrbitCertificate
from zeno_orbits.work import Progress, silent

_OF_THIS_PROCESS = ("problem", "on_progress")


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
class SearchProblem:
    """A search: its problem, its objective with bounds, its check and its settings.

    Attributes:
        problem: The problem.
        values: Values of its gains and parameters. By default free values stay near them.
        free: Name to bounds of the gains and parameters to be found.
        objective: The objective.
        bounds: Bounds that the orbit must satisfy.
        near: A known orbit to start from.
        shape: The shape of the orbit. By default any shape is accepted.
        section: Name of the event at which the period starts and ends. By default it is chosen.
        method: How an optimum is found.
        accept: Check of the orbits. By default all orbits are accepted.
        initial_states: Initial states of the simulations that find orbits, name to value. If it is
            empty, they are the problem's own.
        order: Indices of the scan points at which it starts, in order. ``None`` before a scan.
        settings: Limits and tolerances of the search.
        on_progress: Receives progress reports.
    """

    problem: Problem
    values: ParameterValues
    free: Mapping[str, tuple[float, float]]
    objective: Objective
    bounds: tuple[Bound, ...] = ()
    near: Orbit | None = None
    shape: EventSequence | None = None
    section: str | None = None
    method: SearchMethod = SearchMethod.AUTO
    accept: Accept | None = None
    initial_states: tuple[Mapping[str, float], ...]
    order: tuple[int, ...] | None = None
    settings: SearchSettings
    on_progress: Progress = silent

    def starts_at(self, values: ParameterValues) -> tuple[tuple[float, ...], ...]:
        """Return the initial states of the simulations, each ``(n_x,)``.

        Args:
            values: The values of the simulations.

        Raises:
            InputError: If no start of the problem is admissible at the values.
        """
        given = tuple(self.problem.state_vector(start) for start in self.initial_states)
        return given or self.problem.admissible_starts(values)

    @property
    def seeks_optimum(self) -> bool:
        """True if starts all over the box are compared, False for the nearest orbit."""
        several = self.free and self.settings.n_starts > 0 and self.near is None
        return bool(several and self.objective.is_measured)

    def score(self, values: ParameterValues, extents: Mapping[str, Extent]) -> float:
        """Return the score of an orbit. A lower score is better.

        Args:
            values: Values of the orbit.
            extents: Measured quantities of the orbit.
        """
        if not self.free:
            return 0.0
        numbers = {name: values.number(name) for name in self.free}
        return self.objective.score(numbers, nearness_of(self.values, self.free), extents)

    def first_system(self, values: ParameterValues) -> HybridDynamics:
        """Return the system of the first stop at given values."""
        return self.problem.first_system(values)

    def numbers(self, values: ParameterValues) -> dict[str, float]:
        """Return the values that describe a start: all gains, and the free parameters."""
        return {**values.gains, **{name: values.number(name) for name in self.free}}

    def tell(self, stage: str) -> None:
        """Report the current stage of the search."""
        self.on_progress(stage, None)

    def question(self) -> dict[str, Any]:
        """Return the fields that are valid in another process: all fields except the problem."""
        names = [field.name for field in fields(self) if field.name not in _OF_THIS_PROCESS]
        return {name: getattr(self, name) for name in names}


def with_defaults(search: SearchProblem) -> SearchProblem:
    """Return the search with the shape of its known orbit and with complete targets.

    For `NearestGains`, values without a target stay near their start, and the search starts where
    the targets can be reached.
    """
    near, shape = search.near, search.shape
    if near is not None:
        agreed = near.phases_as if shape is None else near.shape.agreed(shape)
        search = replace(search, shape=agreed)
    if isinstance(search.objective, NearestGains):
        values = clipped(search.values.replaced(search.objective.target), search.free)
        named = {**values.gains, **{name: values.number(name) for name in search.free}}
        search = replace(search, values=values, objective=NearestGains(target=named))
    return search


def clipped(values: ParameterValues, free: Mapping[str, tuple[float, float]]) -> ParameterValues:
    """Return values clipped to the box of the free values."""
    return values.replaced(
        {name: min(max(values.number(name), low), high) for name, (low, high) in free.items()}
    )


def listed(numbers: Mapping[str, float]) -> str:
    """Format names and values as text."""
    return ", ".join(f"{name} = {value:.6g}" for name, value in numbers.items()) or "the problem"
