"""Executions of the loop and of the plain simulator, side by side."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.model import Problem
from zeno_orbits.simulation import (
    Execution,
    Impact,
    Release,
    SimulationSettings,
    SimulationTask,
    ZenoPoint,
    by_reference,
    simulate,
)

needs_compiler = pytest.mark.skipif(
    shutil.which("cc") is None, reason="the C compiler `cc` is missing"
)

_FIELDS: Mapping[type, tuple[str, ...]] = {
    Impact: ("time", "state_minus", "state_plus", "approach_rate"),
    ZenoPoint: ("time", "state", "limit_error", "tail", "last_speed"),
    Release: ("time", "state"),
}


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """An execution, or the error that ended it with what came before."""

    execution: Execution | None
    error: SimulationError | None


def task_of(
    problem: Problem,
    *,
    until: float,
    start: int = 0,
    values: Mapping[str, float] | None = None,
    settings: SimulationSettings | None = None,
    **limits: float,
) -> SimulationTask:
    """Return a task from one of a problem's starts, with other numbers for its parameters."""
    chosen = problem.values(parameters=dict(values or {}))
    return SimulationTask(
        dynamics=problem.dynamics(chosen),
        state=np.array(problem.state_vector(problem.starts[start])),
        until=until,
        settings=settings or SimulationSettings(),
        **limits,
    )


def looped(task: SimulationTask) -> Outcome:
    """Return what `simulate` gives, which must be the loop's."""
    found = _outcome(
        lambda: simulate(
            task.dynamics,
            task.state,
            until=task.until,
            releases=_count(task.most_releases),
            impacts=_count(task.most_impacts),
            settings=task.settings,
        )
    )
    if found.execution is not None:
        # The loop's executions are recorded: a kind of their own.
        assert type(found.execution) is not Execution
    return found


def followed(task: SimulationTask) -> Outcome:
    """Return what the plain simulator gives."""
    found = _outcome(lambda: by_reference(task))
    assert found.execution is None or type(found.execution) is Execution
    return found


def _count(most: float) -> int | None:
    return None if most == np.inf else int(most)


def _outcome(run: Any) -> Outcome:
    try:
        return Outcome(execution=run(), error=None)
    except SimulationError as error:
        return Outcome(execution=error.execution, error=error)


def numbers_of(execution: Execution) -> list[Vector]:
    """Return all numbers of the events and ends of the arcs, in order."""
    numbers: list[Vector] = []
    for event in execution.events:
        numbers += [np.atleast_1d(getattr(event, name)) for name in _FIELDS[type(event)]]
    for arc in execution.arcs:
        numbers += [arc.start_state, arc.end_state]
        numbers.append(np.array([arc.start_time, arc.end_time, arc.time_unit, arc.duration]))
        numbers.append(np.array([arc.impact_index]))
    return numbers


def require_same_kinds(found: Execution, expected: Execution) -> None:
    """Require the same events and arcs in the same order."""
    assert [type(event) for event in found.events] == [type(event) for event in expected.events]
    assert [(arc.mode, arc.ending) for arc in found.arcs] == [
        (arc.mode, arc.ending) for arc in expected.arcs
    ]


def difference(found: Execution, expected: Execution) -> float:
    """Return the largest difference of two executions, relative to ``1 + |x|``."""
    require_same_kinds(found, expected)
    pairs = zip(numbers_of(found), numbers_of(expected), strict=True)
    return max(float(np.max(np.abs(a - b) / (1 + np.abs(b)))) for a, b in pairs)


def require_equal(task: SimulationTask) -> Execution | None:
    """Require that loop and plain simulator agree in every bit, errors included."""
    found, expected = looped(task), followed(task)
    _require_same_error(found, expected)
    if found.error is not None and expected.error is not None:
        assert found.error.time == expected.error.time
        assert found.error.state == expected.error.state
    if found.execution is None or expected.execution is None:
        return None
    require_same_kinds(found.execution, expected.execution)
    for mine, other in zip(
        numbers_of(found.execution), numbers_of(expected.execution), strict=True
    ):
        assert mine.tolist() == other.tolist()
    for mine, other in zip(found.execution.arcs, expected.execution.arcs, strict=True):
        assert mine.flow_times.tolist() == other.flow_times.tolist()
        assert mine.flow_states.tolist() == other.flow_states.tolist()
    return found.execution


def require_close(task: SimulationTask, tolerance: float) -> Execution | None:
    """Require that loop and plain simulator agree to rounding, which implicit steps magnify."""
    found, expected = looped(task), followed(task)
    _require_same_error(found, expected)
    if found.execution is None or expected.execution is None:
        return None
    assert difference(found.execution, expected.execution) < tolerance
    return found.execution


def _require_same_error(found: Outcome, expected: Outcome) -> None:
    assert type(found.error) is type(expected.error)
    assert (found.execution is None) == (expected.execution is None)
    if found.error is not None and expected.error is not None:
        assert found.error.reason == expected.error.reason


def n_implicit(execution: Execution) -> int:
    """Return how many implicit steps the loop took."""
    ways = [arc.trajectory for arc in execution.arcs]
    return sum(len(getattr(way, "_polynomials", ())) for way in ways)
