"""Families of orbits that strike the stop once a turn and never rest on it."""

from __future__ import annotations

import numpy as np

from zeno_orbits.branches import Tell
from zeno_orbits.continuation import continuation_on
from zeno_orbits.corrector import Metric
from zeno_orbits.dispatch import Crew
from zeno_orbits.dynamics import Vector
from zeno_orbits.errors import SimulationError
from zeno_orbits.families import Continuation
from zeno_orbits.impact_returns import ImpactReturns
from zeno_orbits.models import compiled_model
from zeno_orbits.problem import Problem, Setting
from zeno_orbits.simulate import simulate
from zeno_orbits.tracks import ContinuationSettings, Course, Root, Track, check_box, line_in

_MOST_IMPACTS = 400
_SETTLED = 1e-3
_PATIENCE = 100.0
"""Longest flight [s]."""
_LONGER = 4.0


def continue_impacts(
    problem: Problem,
    setting: Setting,
    state: tuple[float, ...],
    parameter: str,
    box: tuple[float, float],
    *,
    settings: ContinuationSettings,
    tell: Tell,
    crew: Crew | None = None,
) -> Continuation:
    """Return the family of the orbit with one impact a turn that a motion settles to.

    Args:
        problem: The scene.
        setting: Its numbers at the start.
        state: Where the motion starts, ``(n_x,)``.
        parameter: Name of a gain or a parameter.
        box: Range in which to follow it, lower end first.
        settings: How.
        tell: Called with what happens.
        crew: Workers; by default this process does it all.

    Raises:
        InputError: If a name or a range does not fit.
        SimulationError: If the impacts do not settle.
        WorkError: If the work cannot be finished.
    """
    p = np.array(setting.values())
    value = float(p[problem.names.index(parameter)]) if parameter in problem.names else 0.0
    line = line_in(problem, p, parameter)
    check_box(problem, parameter, box, value)
    returns = ImpactReturns(
        compiled=compiled_model(problem), line=line, settings=settings.simulation
    )
    x, flight, scale = _settled(returns, np.array(state), value)
    course = Course(
        setting=setting,
        parameter=parameter,
        box=box,
        section=ImpactReturns,
        metric=Metric(scale=scale, unit=box[1] - box[0], horizon=_LONGER * flight),
        simulation=settings.simulation,
    )
    root = Root(track=Track(problem=problem, course=course), x=x, s=value)
    return continuation_on(root, settings=settings, tell=tell, crew=crew)


def _settled(returns: ImpactReturns, state: Vector, s: float) -> tuple[Vector, float, Vector]:
    """Return a state after an impact that nearly repeats, the flight's length, and sizes.

    Raises:
        SimulationError: If none does.
    """
    dynamics, x = returns.dynamics(s), state
    before: Vector | None = None
    for _ in range(_MOST_IMPACTS):
        run = simulate(dynamics, x, until=_PATIENCE, settings=returns.settings, releases=1)
        if not run.impacts:
            break
        impact = run.impacts[0]
        x = impact.state_plus
        sizes = np.max(np.abs(run.arcs[0].flow_states[:, : x.size]), axis=0)
        largest = float(np.max(sizes))
        scale = np.where(sizes > _SETTLED * largest, sizes, largest)
        if before is not None and float(np.max(np.abs(x - before) / scale)) < _SETTLED:
            return x, impact.time, scale
        before = x
    raise SimulationError(
        "The impacts do not settle to one a turn", time=_PATIENCE, state=tuple(x.tolist())
    )
