"""Accuracy and limits of a simulation task in the loop's format."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from zeno_orbits.integrators import Tolerance
from zeno_orbits.loop import RunSettings, binding
from zeno_orbits.model import CharacteristicScales
from zeno_orbits.simulation.compiled.steps import loop_steps
from zeno_orbits.simulation.settings import SimulationSettings, SimulationTask
from zeno_orbits.simulation.zeno.completion import (
    FixedImpacts,
    PlasticAfter,
    Truncation,
    ZenoExtrapolation,
    ZenoPassage,
)

_COMPLETIONS: dict[type, int] = {
    ZenoExtrapolation: binding.EXTRAPOLATION,
    ZenoPassage: binding.PASSAGE,
    Truncation: binding.TRUNCATION,
    FixedImpacts: binding.FIXED_IMPACTS,
    PlasticAfter: binding.PLASTIC_AFTER,
}


def are_known(settings: SimulationSettings) -> bool:
    """Return True if steps and completion of settings are those of the loop.

    Args:
        settings: The settings.
    """
    return loop_steps(settings.engine) is not None and type(settings.completion) in _COMPLETIONS


def tolerance_of(task: SimulationTask) -> Tolerance:
    """Return the local error of all steps of a task.

    Args:
        task: The simulation task.
    """
    return task.settings.tolerance.times(task.graph.own.least)


def run_settings(task: SimulationTask, **others: Any) -> list[RunSettings]:
    """Return accuracy and limits at every stop, with some of the values replaced.

    Args:
        task: The simulation task.
        others: Values that replace the values of the task.
    """
    values = {**_own_limits(task), **others}
    return [replace(_shared(*one), **values) for one in _shared_by_stop(task)]


def filled_settings(task: SimulationTask) -> Any:
    """Return the same as an array in memory of its own. Most tasks share all but their limits.

    Args:
        task: The simulation task.
    """
    shared = [_shared_memory(*one) for one in _shared_by_stop(task)]
    places = (binding.SettingsType * len(shared))(*shared)
    for place in places:
        for name, value in _own_limits(task).items():
            setattr(place, name, value)
    return places


def _own_limits(task: SimulationTask) -> dict[str, float]:
    return {
        "until": task.until,
        "most_releases": task.most_releases,
        "most_landings": task.most_impacts,
        "past": task.past_switch,
    }


_Shared = tuple[SimulationSettings, Tolerance, CharacteristicScales, float, bool, int, int]


def _shared_by_stop(task: SimulationTask) -> Sequence[_Shared]:
    """Return what the settings of every stop depend on, apart from the limits of the task."""
    graph, chosen = task.graph, task.settings
    if isinstance(chosen.far, list):
        chosen = replace(chosen, far=tuple(chosen.far))
    sizes = (len(graph.state_names), graph.n_q)
    tolerance = tolerance_of(task)
    return [
        (chosen, tolerance, view.own, view.restitution, view.restitution_at is not None, *sizes)
        for view in graph.open_views
    ]


@lru_cache(maxsize=64)
def _shared_memory(*shared: Any) -> binding.SettingsType:
    return _shared(*shared).filled()


def _shared(
    chosen: SimulationSettings,
    tolerance: Tolerance,
    own: CharacteristicScales,
    restitution: float,
    varies: bool,
    n_x: int,
    n_q: int,
) -> RunSettings:
    """Return accuracy and limits of all tasks at stops with some scales and a restitution."""
    rule = chosen.completion
    steps = loop_steps(chosen.engine)
    if steps is None:
        raise ValueError("Argument `task` must have an engine that the compiled loop supports.")
    extrapolates = isinstance(rule, ZenoExtrapolation | ZenoPassage)
    return RunSettings(
        until=math.inf,
        relative=tolerance.relative,
        absolute=tolerance.absolute,
        contact=chosen.contact,
        restitution=restitution,
        time=own.time,
        gap=own.gap,
        gap_rate=own.gap_rate,
        gap_acceleration=own.gap_acceleration,
        multiplier=own.multiplier,
        sizes=own.states(n_x).tolist(),
        weights=own.weights(n_x),
        flight_weights=own.flight_weights(n_x),
        reach=np.broadcast_to(np.asarray(chosen.far, dtype=np.float64), n_q).tolist(),
        **steps._asdict(),
        completion=_COMPLETIONS[type(rule)],
        limit_tolerance=rule.tolerance if extrapolates else 0.0,
        resolved=rule.resolved if extrapolates else 0.0,
        delta=rule.delta if isinstance(rule, Truncation) else 0.0,
        n_fixed=rule.n_impacts if isinstance(rule, FixedImpacts | PlasticAfter) else 0,
        most_releases=math.inf,
        most_landings=math.inf,
        most_steps=chosen.most_steps,
        most_impacts=chosen.most_impacts,
        varies=varies,
    )
