"""A search as a value: its problem, its question and its settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from zeno_orbits.model import CompiledSystem, HybridDynamics, ParameterValues, Problem
from zeno_orbits.orbits import Bound, OrbitShape, ZenoOrbit
from zeno_orbits.search.objectives import NearestGains, Objective
from zeno_orbits.search.settings import SearchSettings
from zeno_orbits.work import Progress, silent

_OF_THIS_PROCESS = ("problem", "on_progress")


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
    settings: SearchSettings
    on_progress: Progress = silent

    @property
    def compiled(self) -> CompiledSystem:
        """The functions of the problem."""
        return self.problem.compiled()

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
    """Return the search with each free number and each gain given its nearest target.

    What has no target stays near its start, and the search starts where the targets can be met.
    """
    if not isinstance(search.objective, NearestGains):
        return search
    values = clipped(search.values.replaced(search.objective.target), search.free)
    named = {**values.gains, **{name: values.number(name) for name in search.free}}
    return replace(search, values=values, objective=NearestGains(target=named))


def clipped(values: ParameterValues, free: Mapping[str, tuple[float, float]]) -> ParameterValues:
    """Return values moved into the box of what is free."""
    return values.replaced(
        {name: min(max(values.number(name), low), high) for name, (low, high) in free.items()}
    )


def listed(numbers: Mapping[str, float]) -> str:
    """Return names and numbers in words."""
    return ", ".join(f"{name} = {value:.6g}" for name, value in numbers.items()) or "the problem"
