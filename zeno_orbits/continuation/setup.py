"""The setup and the start of a family: parameter values, return map, and units."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.branch import FamilySteps
from zeno_orbits.continuation.corrector import FamilyMetric
from zeno_orbits.continuation.event_returns import EventReturns
from zeno_orbits.continuation.return_maps import (
    PATIENCE,
    Composed,
    ImpactReturns,
    ReleaseReturns,
    ReturnMap,
)
from zeno_orbits.continuation.two_parameters.plane import CurveSteps, ParameterPlane
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import (
    Cycle,
    EventSection,
    Line,
    Orbit,
    cycle_of,
    event_return,
    section_of_family,
)
from zeno_orbits.search import run_to_attractor
from zeno_orbits.simulation import SimulationSettings
from zeno_orbits.work import Checked

ONE_RETURN = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class ContinuationSettings(Checked):
    """Settings of a continuation.

    Attributes:
        steps: Steps along a family.
        simulation: Accuracy of a return.
        curve: Steps along a curve in two parameters.
        doublings: Number of successive period doublings at which the branch of twice the period is
            followed.
    """

    steps: FamilySteps = field(default_factory=FamilySteps)
    simulation: SimulationSettings = field(default_factory=SimulationSettings)
    curve: CurveSteps = field(default_factory=CurveSteps)
    doublings: int = 1


@dataclass(frozen=True, kw_only=True)
class Setup:
    """All inputs of a family except its problem, which cannot be sent to a worker.

    Attributes:
        values: The problem's parameter values at the start.
        parameter: Name of the parameter that changes.
        box: Its range.
        section: Class of the return map of a single return, or the section of a machine with
            several stops or switches.
        metric: Units.
        simulation: Accuracy of a return.
        n_returns: Number of returns after which the orbits close.
    """

    values: ParameterValues
    parameter: str
    box: tuple[float, float]
    section: type[ReleaseReturns] | type[ImpactReturns] | EventSection
    metric: FamilyMetric
    simulation: SimulationSettings
    n_returns: int = ONE_RETURN

    def returns(self, problem: Problem) -> ReturnMap:
        """Return the return map under which the orbits close."""
        line = line_in(problem, np.array(self.values.vector), self.parameter)
        once: ReturnMap
        if isinstance(self.section, EventSection):
            once = EventReturns(
                compiled=problem.compiled_graph(),
                line=line,
                settings=self.simulation,
                section=self.section,
            )
        else:
            once = self.section(compiled=problem.compiled(), line=line, settings=self.simulation)
        if self.n_returns == ONE_RETURN:
            return once
        return Composed(maps=self.n_returns * (once,))

    def doubled(self) -> Setup:
        """Return this setup for orbits that close after twice as many returns."""
        return replace(self, n_returns=2 * self.n_returns)


@dataclass(frozen=True, kw_only=True)
class FamilyStart:
    """The start of a family.

    Attributes:
        setup: The setup of the family.
        x: A state near a fixed point of the return map, ``(n_x,)``.
        s: Value of the parameter at the state.
    """

    setup: Setup
    x: Vector
    s: float


def start_at_release(
    problem: Problem,
    orbit: Orbit,
    parameter: str,
    box: tuple[float, float],
    settings: ContinuationSettings,
) -> FamilyStart:
    """Return the release of an orbit as the start of its family.

    Args:
        problem: The problem.
        orbit: An orbit of the problem with one release per period.
        parameter: Name of a gain or a parameter.
        box: Range of the parameter, lower end first.
        settings: Settings of the continuation.

    Raises:
        InputError: If a name or a range does not fit, or the orbit belongs to another problem.
    """
    _require_orbit_of(problem, orbit.problem)
    orbit.shape.require_one_release()
    values = orbit.values(problem)
    x = np.array(problem.state_vector(orbit.release_state))
    cycle = cycle_of(
        problem.dynamics(values),
        x,
        orbit.shape,
        horizon=PATIENCE * orbit.period,
        settings=settings.simulation,
    )
    setup = Setup(
        values=values,
        parameter=parameter,
        box=box,
        section=ReleaseReturns,
        metric=_metric(cycle, box, orbit.period),
        simulation=settings.simulation,
    )
    return FamilyStart(setup=setup, x=x, s=_checked(problem, values, "parameter", parameter, box))


_SAMPLES = 20
"""Least number of samples per arc for the sizes of states."""
_SETTLED = 1e-3
"""Largest change of the state over a period, relative to its size, at which it nearly repeats."""


def start_at_impact(
    problem: Problem,
    values: ParameterValues,
    state: tuple[float, ...],
    parameter: str,
    box: tuple[float, float],
    settings: ContinuationSettings,
) -> FamilyStart:
    """Return a state after an impact that nearly repeats as the start of its family.

    Args:
        problem: The problem.
        values: Its parameter values at the start.
        state: Initial state of a motion whose impacts converge to a periodic sequence, ``(n_x,)``.
        parameter: Name of a gain or a parameter.
        box: Range of the parameter, lower end first.
        settings: Settings of the continuation.

    Raises:
        InputError: If a name or a range does not fit.
        SimulationError: If the impacts do not converge, or contact persists.
    """
    s = _checked(problem, values, "parameter", parameter, box)
    settling = run_to_attractor(problem.dynamics(values), [state], problem=problem)
    cycle = settling.cycle
    lacking = "The motion does not converge to an orbit without a Zeno point"
    if cycle is None or cycle.drift(cycle.scale_at_events()) > _SETTLED:
        reason = f"{lacking}: {settling.reason}" if settling.reason else lacking
        raise SimulationError(reason, time=settling.waited, state=state)
    if not cycle.shape.without_contact:
        reason = f"{lacking}: its shape is `{cycle.shape.text}`"
        raise SimulationError(reason, time=settling.waited, state=state)
    return _start_of_impacts(values, parameter, box, settings, cycle, s)


def start_at_impacts_of(
    problem: Problem,
    orbit: Orbit,
    parameter: str,
    box: tuple[float, float],
    settings: ContinuationSettings,
) -> FamilyStart:
    """Return an impact of an orbit without a contact phase as the start of its family.

    Args:
        problem: The problem.
        orbit: An orbit of the problem, stable or not, whose phases are impacts.
        parameter: Name of a gain or a parameter.
        box: Range of the parameter, lower end first.
        settings: Settings of the continuation.

    Raises:
        InputError: If a name or a range does not fit, or the orbit belongs to another problem.
        SimulationError: If the motion from the start of the orbit has another shape.
    """
    _require_orbit_of(problem, orbit.problem)
    values = orbit.values(problem)
    s = _checked(problem, values, "parameter", parameter, box)
    cycle = cycle_of(
        problem.dynamics(values),
        np.array(problem.state_vector(orbit.start_state)),
        orbit.shape,
        horizon=PATIENCE * orbit.period,
        settings=settings.simulation,
    )
    return _start_of_impacts(values, parameter, box, settings, cycle, s)


def _metric(cycle: Cycle, box: tuple[float, float], period: float) -> FamilyMetric:
    # A state may be small at every event.
    scale = cycle.execution.own.not_small(cycle.scale(), _SETTLED)
    return FamilyMetric(scale=scale, unit=box[1] - box[0], horizon=PATIENCE * period)


def _start_of_impacts(
    values: ParameterValues,
    parameter: str,
    box: tuple[float, float],
    settings: ContinuationSettings,
    cycle: Cycle,
    s: float,
) -> FamilyStart:
    """Return the state after the impact that ends the longest flight of a cycle as a start."""
    setup = Setup(
        values=values,
        parameter=parameter,
        box=box,
        section=ImpactReturns,
        metric=_metric(cycle, box, cycle.period),
        simulation=settings.simulation,
        n_returns=cycle.shape.n_phases,
    )
    longest = max(cycle.phases, key=lambda phase: phase.end.time - phase.start.time)
    return FamilyStart(setup=setup, x=longest.end.state, s=s)


def start_at_event(
    problem: Problem,
    orbit: Orbit,
    parameter: str,
    box: tuple[float, float],
    settings: ContinuationSettings,
) -> FamilyStart:
    """Return the start of an orbit given by its events as the start of its family.

    Args:
        problem: The problem.
        orbit: An orbit of the problem.
        parameter: Name of a gain or a parameter.
        box: Range of the parameter, lower end first.
        settings: Settings of the continuation.

    Raises:
        InputError: If a name or a range does not fit, or the orbit belongs to another problem.
        SimulationError: If the orbit does not return.
    """
    _require_orbit_of(problem, orbit.problem)
    values = orbit.values(problem)
    s = _checked(problem, values, "parameter", parameter, box)
    graph = problem.graph_dynamics(values)
    x = np.array(problem.state_vector(orbit.start_state))
    found = event_return(
        graph,
        x,
        section=orbit.section,
        n_returns=orbit.n_returns,
        guess=orbit.period,
        settings=settings.simulation,
    )
    section, x = section_of_family(found)
    setup = Setup(
        values=values,
        parameter=parameter,
        box=box,
        section=section,
        metric=FamilyMetric(
            # A state may be small at every event, such as the phase of a clock.
            scale=graph.own.not_small(
                np.max(np.abs(found.execution.sampled(_SAMPLES)[1]), axis=0), _SETTLED
            ),
            unit=box[1] - box[0],
            horizon=PATIENCE * orbit.period,
        ),
        simulation=settings.simulation,
    )
    return FamilyStart(setup=setup, x=x, s=s)


def plane_of(
    problem: Problem, values: ParameterValues, first: Setup, second: str, box: tuple[float, float]
) -> ParameterPlane:
    """Return the plane of two parameters, with all other parameters at given values.

    Args:
        problem: The problem.
        values: Its parameter values at the start.
        first: Setup of the family in the first parameter.
        second: Name of the second parameter.
        box: Its range, lower end first.

    Raises:
        InputError: If the name or the range does not fit.
    """
    if first.parameter == second:
        raise InputError(
            f"Argument `parameter2` must differ from the first parameter, but both are `{second}`."
        )
    _checked(problem, values, "parameter2", second, box)
    names = (first.parameter, second)
    return ParameterPlane(
        names=names,
        places=(problem.names.index(names[0]), problem.names.index(names[1])),
        box=np.array((first.box, box)),
        p=np.array(values.vector),
    )


def line_in(problem: Problem, p: Vector, parameter: str) -> Line:
    """Return the line along which one parameter changes.

    Args:
        problem: The problem.
        p: All parameter values, ``(n_p,)``.
        parameter: Name of the parameter that changes.
    """
    direction = np.zeros(p.size)
    direction[problem.place(parameter, argument="parameter")] = 1.0
    return Line(origin=p * (1 - direction), direction=direction)


def _require_orbit_of(problem: Problem, name: str) -> None:
    """Reject an orbit of another problem.

    Raises:
        InputError: If the name is another.
    """
    if name != problem.name:
        message = f"must be of problem `{problem.name}`, but it is of `{name}`"
        raise InputError(f"Argument `orbit` {message}.")


def _checked(
    problem: Problem,
    values: ParameterValues,
    argument: str,
    parameter: str,
    box: tuple[float, float],
) -> float:
    """Return the value of a parameter at the start, inside its range.

    Raises:
        InputError: If the parameter is unknown, or its range is empty, contains forbidden values,
            or does not contain the value at the start.
    """
    problem.require_range(parameter, box, argument=argument)
    low, high = box
    value = values.number(parameter)
    if not low <= value <= high:
        message = f"must hold the start, {parameter} = {value:g}, but it is {low:g}:{high:g}"
        raise InputError(f"Argument `{argument}` {message}.")
    return value
