"""A search as a value: its problem, its question and its settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

from zeno_orbits.model import CompiledSystem, HybridDynamics, ParameterValues, Problem
from zeno_orbits.orbits import Bound, OrbitShape, ZenoOrbit
from zeno_orbits.search.objectives import NearestGains, Objective
from zeno_orbits.search.settings import SearchSettings
from zeno_orbits.search.transcription.nearness import Nearness
from zeno_orbits.simulation import Extent
from zeno_orbits.work import Progress, silent

_OF_THIS_PROCESS = ("problem", "on_progress")

_SMALLEST_SIZE = 1e-3
"""Part of its range that the size of a free number near zero is."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchProblem:
    """A search: its problem, its question and its settings.

    Attributes:
        problem: The problem.
        values: Its numbers; what is free stays near them if nothing else is asked.
        free: Name to bounds of the gains and parameters to be found.
        objective: The objective.
        bounds: Bounds that the orbit must keep.
        near: A known orbit to start from.
        shape: The shape of the orbit; any by default.
        initial_states: States from which simulations look for orbits, name to value.
        sizes: Name to size of what is free, in which its changes are measured.
        order: Numbers of the places where it starts, in order; they are not known before a scan.
        settings: Limits and tolerances of the search.
        on_progress: Receives progress reports.
    """

    problem: Problem
    values: ParameterValues
    free: Mapping[str, tuple[float, float]]
    objective: Objective
    bounds: tuple[Bound, ...] = ()
    near: ZenoOrbit | None = None
    shape: OrbitShape | None = None
    initial_states: tuple[Mapping[str, float], ...]
    sizes: Mapping[str, float] = field(default_factory=dict[str, float])
    order: tuple[int, ...] | None = None
    settings: SearchSettings
    on_progress: Progress = silent

    @property
    def compiled(self) -> CompiledSystem:
        """The functions of the problem."""
        return self.problem.compiled()

    @property
    def seeks_optimum(self) -> bool:
        """True if starts all over the box are compared, rather than the nearest orbit taken."""
        several = self.free and self.settings.n_starts > 0 and self.near is None
        return bool(several and self.objective.quantities)

    def nearness(self, origin: ParameterValues) -> Nearness:
        """Return the measure of how near what is free is to given numbers."""
        first = {name: origin.number(name) for name in self.free}
        return Nearness(first=first, sizes=self.sizes)

    def score(self, values: ParameterValues, extents: Mapping[str, Extent]) -> float:
        """Return the score of an orbit; less is better.

        Args:
            values: Its numbers.
            extents: What was measured of it.
        """
        if not self.free:
            return 0.0
        numbers = {name: values.number(name) for name in self.free}
        return self.objective.score(numbers, self.nearness(self.values), extents)

    def dynamics(self, values: ParameterValues) -> HybridDynamics:
        """Return the system at given numbers."""
        return self.problem.dynamics(values)

    def numbers(self, values: ParameterValues) -> dict[str, float]:
        """Return the numbers to name a start by: all gains, and the parameters that are free."""
        return {**values.gains, **{name: values.number(name) for name in self.free}}

    def tell(self, stage: str) -> None:
        """Report the present stage of the search."""
        self.on_progress(stage, None)

    def question(self) -> dict[str, Any]:
        """Return the fields that mean the same in another process: all but the problem."""
        names = [field.name for field in fields(self) if field.name not in _OF_THIS_PROCESS]
        return {name: getattr(self, name) for name in names}


def with_targets(search: SearchProblem) -> SearchProblem:
    """Return the search with the size of each free number, and its nearest target if that is asked.

    What has no target stays near its start, and the search starts where the targets can be met.
    """
    if isinstance(search.objective, NearestGains):
        values = clipped(search.values.replaced(search.objective.target), search.free)
        named = {**values.gains, **{name: values.number(name) for name in search.free}}
        search = replace(search, values=values, objective=NearestGains(target=named))
    sizes = {
        name: max(abs(search.values.number(name)), _SMALLEST_SIZE * (high - low))
        for name, (low, high) in search.free.items()
    }
    return replace(search, sizes=sizes)


def clipped(values: ParameterValues, free: Mapping[str, tuple[float, float]]) -> ParameterValues:
    """Return values moved into the box of what is free."""
    return values.replaced(
        {name: min(max(values.number(name), low), high) for name, (low, high) in free.items()}
    )


def listed(numbers: Mapping[str, float]) -> str:
    """Return names and numbers in words."""
    return ", ".join(f"{name} = {value:.6g}" for name, value in numbers.items()) or "the problem"
