"""The setup and the start of a family: parameter values, return map, and units."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.branch import FamilySteps
from zeno_orbits.continuation.corrector import FamilyMetric
from zeno_orbits.continuation.return_maps import PATIENCE, Composed, EventReturns, FamilyMap
from zeno_orbits.continuation.two_parameters.plane import CurveSteps, ParameterPlane
from zeno_orbits.errors import InputError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import (
    EventReturn,
    EventSection,
    Line,
    Orbit,
    SectionMode,
    event_return,
    orbit_event_name,
    section_of_family,
)
from zeno_orbits.simulation import SimulationSettings, state_after
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
        section: The section of a single return.
        metric: Units.
        simulation: Accuracy of a return.
        n_returns: Number of returns after which the orbits close.
    """

    values: ParameterValues
    parameter: str
    box: tuple[float, float]
    section: EventSection
    metric: FamilyMetric
    simulation: SimulationSettings
    n_returns: int = ONE_RETURN

    def returns(self, problem: Problem) -> FamilyMap:
        """Return the return map under which the orbits close."""
        line = line_in(problem, np.array(self.values.vector), self.parameter)
        once = EventReturns(
            compiled=problem.compiled_graph(),
            start=tuple(self.values.vector),
            line=line,
            settings=self.simulation,
            section=self.section,
        )
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


_SAMPLES = 20
"""Least number of samples per arc for the sizes of states."""
_SMALL = 1e-3
"""Least size of a state, relative to the problem's scale."""
_LONGER = 1e-6
"""Relative difference of two returns by which one is longer."""


def start_of_family(
    problem: Problem,
    orbit: Orbit,
    parameter: str,
    box: tuple[float, float],
    settings: ContinuationSettings,
) -> FamilyStart:
    """Return a state of an orbit after an event as the start of its family.

    Args:
        problem: The problem.
        orbit: An orbit of the problem, stable or not.
        parameter: Name of a gain or a parameter.
        box: Range of the parameter, lower end first.
        settings: Settings of the continuation.

    Raises:
        InputError: If a name or a range does not fit, or the orbit belongs to another problem.
        SimulationError: If the orbit does not return.
    """
    if orbit.problem != problem.name:
        message = f"must be of problem `{problem.name}`, but it is of `{orbit.problem}`"
        raise InputError(f"Argument `orbit` {message}.")
    values = orbit.values(problem)
    s = _checked(problem, values, "parameter", parameter, box)
    graph = problem.graph_dynamics(values)
    found = event_return(
        graph,
        np.array(problem.state_vector(orbit.start_state)),
        section=orbit.section,
        n_returns=orbit.n_returns,
        guess=orbit.period,
        settings=settings.simulation,
    )
    section, n_returns, x = _single_return(found, *section_of_family(found))
    largest = np.max(np.abs(found.execution.sampled(_SAMPLES)[1]), axis=0)
    setup = Setup(
        values=values,
        parameter=parameter,
        box=box,
        section=section,
        metric=FamilyMetric(
            # A state may be small at every event, such as the phase of a clock.
            scale=graph.own.not_small(largest, _SMALL),
            unit=box[1] - box[0],
            horizon=PATIENCE * found.period / n_returns,
        ),
        simulation=settings.simulation,
        n_returns=n_returns,
    )
    return FamilyStart(setup=setup, x=x, s=s)


def _single_return(
    found: EventReturn, section: EventSection, x: Vector
) -> tuple[EventSection, int, Vector]:
    """Return the section of one of several equal event sequences, their number, and a start.

    A period may repeat its event sequence, in the same modes. It starts at the end of the longest
    sequence, so that the returns of its family are counted from there.

    Args:
        found: The return of the orbit.
        section: The section of the whole period.
        x: The state of the orbit on it.
    """
    marks = [event for event in found.events if orbit_event_name(event) == section.name]
    starts_at_end = section.name == orbit_event_name(found.events[-1])
    for n in range(section.n_returns, 1, -1):
        each = section.n_returns // n
        size = len(section.sequence) // n
        if section.n_returns % n or section.sequence != n * section.sequence[:size]:
            continue
        first = each - 1 if starts_at_end else 0
        ends = marks[first::each]
        modes = [SectionMode.after(found.execution, section.name, one.time) for one in ends]
        if any(mode not in (None, section.mode) for mode in modes):
            continue
        waits = np.diff([ends[-1].time - found.period, *(one.time for one in ends)])
        own = len(ends) - 1 if starts_at_end else 0
        longest = int(np.argmax(waits))
        if waits[longest] > (1 + _LONGER) * waits[own]:
            x = state_after(ends[longest])
        one = replace(
            section,
            n_returns=each,
            sequence=section.sequence[:size],
            openings=section.openings[::n],
        )
        return one, n, x
    return section, 1, x


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
        wider = f"{parameter}={min(low, value):g}:{max(high, value):g}"
        message = f"must contain the value of the orbit, {parameter} = {value:g}, but it is"
        raise InputError(f"Argument `{argument}` {message} {low:g}:{high:g}. Take {wider}.")
    return value
