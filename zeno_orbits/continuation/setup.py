r"""What a family is followed on: a problem, the number that changes, a return map and units."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.continuation.branch import Steps
from zeno_orbits.continuation.corrector import Metric
from zeno_orbits.continuation.return_maps import Composed, ImpactReturns, ReleaseReturns, ReturnMap
from zeno_orbits.continuation.two_parameters.plane import CurveSteps, Plane
from zeno_orbits.errors import InputError
from zeno_orbits.model.problem import ParameterValues, Problem
from zeno_orbits.orbits.orbit import ZenoOrbit
from zeno_orbits.orbits.section import Line
from zeno_orbits.simulation.simulator import SimulationSettings

_PATIENCE = 4.0
"""Periods of the start to wait for a return."""
ONE_RETURN = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class ContinuationSettings:
    """How to follow families.

    Attributes:
        steps: The steps.
        simulation: Accuracy of a return.
        curve: Steps of a boundary in two parameters.
        doublings: How often a branch of twice the period is followed where a flip throws it off.
    """

    steps: Steps = field(default_factory=Steps)
    simulation: SimulationSettings = field(default_factory=SimulationSettings)
    curve: CurveSteps = field(default_factory=CurveSteps)
    doublings: int = 1


@dataclass(frozen=True, kw_only=True)
class Course:
    """What a family is followed on, but for the problem: that holds functions and cannot travel.

    Attributes:
        values: Its numbers at the start.
        parameter: The number that changes.
        box: Its range.
        section: From which kind of states to which its returns lead.
        metric: Units.
        simulation: Accuracy of a return.
        n_returns: Returns after which its orbits close.
    """

    values: ParameterValues
    parameter: str
    box: tuple[float, float]
    section: type[ReleaseReturns] | type[ImpactReturns]
    metric: Metric
    simulation: SimulationSettings
    n_returns: int = ONE_RETURN


@dataclass(frozen=True, kw_only=True)
class Track:
    """What a family is followed on: the map, the units, the box, and how to name things.

    Attributes:
        problem: The problem.
        course: All else.
    """

    problem: Problem
    course: Course

    @cached_property
    def returns(self) -> ReturnMap:
        """The return map."""
        course = self.course
        once = course.section(
            compiled=self.problem.compiled(),
            line=line_in(self.problem, np.array(course.values.vector), course.parameter),
            settings=course.simulation,
        )
        if course.n_returns == ONE_RETURN:
            return once
        return Composed(maps=course.n_returns * (once,))

    @property
    def metric(self) -> Metric:
        """Units."""
        return self.course.metric

    @property
    def n_returns(self) -> int:
        """Returns after which its orbits close."""
        return self.course.n_returns

    def restitution(self, s: float) -> float:
        """Return the restitution at a place on the line."""
        return float(self.returns.line.at(s)[self.problem.names.index("restitution")])

    def on_line(self, line: Line) -> ReturnMap:
        """Return the same return map along another line of parameters."""
        return self.returns.moved_to(line)

    def doubled(self) -> Track:
        """Return the same for orbits that close after twice as many returns."""
        return replace(self, course=replace(self.course, n_returns=2 * self.n_returns))


@dataclass(frozen=True, kw_only=True)
class Root:
    """Where a family begins.

    Attributes:
        track: What it is followed on.
        x: A state near a fixed point of the return map, ``(n_x,)``.
        s: The parameter there.
    """

    track: Track
    x: Vector
    s: float


def numbers(problem: Problem, orbit: ZenoOrbit) -> Vector:
    """Return the parameter vector of an orbit, ``(n_p,)``."""
    return np.array(orbit.values(problem).vector)


def track_of(
    problem: Problem,
    orbit: ZenoOrbit,
    parameter: str,
    box: tuple[float, float],
    settings: ContinuationSettings,
) -> Track:
    """Return what an orbit's family is followed on, from release to release.

    Raises:
        InputError: If a name or a range does not fit, or the orbit is of another problem.
    """
    if orbit.problem != problem.name:
        message = f"must be of problem `{problem.name}`, but it is of `{orbit.problem}`"
        raise InputError(f"Argument `orbit` {message}.")
    orbit.shape.require_one_release()
    values = orbit.values(problem)
    p = np.array(values.vector)
    line_in(problem, p, parameter)
    check_box(problem, parameter, box, float(p[problem.names.index(parameter)]))
    metric = Metric(
        scale=scale_of(problem, orbit), unit=box[1] - box[0], horizon=_PATIENCE * orbit.period
    )
    course = Course(
        values=values,
        parameter=parameter,
        box=box,
        section=ReleaseReturns,
        metric=metric,
        simulation=settings.simulation,
    )
    return Track(problem=problem, course=course)


def root_of(
    problem: Problem,
    orbit: ZenoOrbit,
    parameter: str,
    box: tuple[float, float],
    settings: ContinuationSettings,
) -> Root:
    """Return an orbit's release as where its family begins.

    Raises:
        InputError: If a name or a range does not fit, or the orbit is of another problem.
    """
    return Root(
        track=track_of(problem, orbit, parameter, box, settings),
        x=np.array(problem.state_vector(orbit.release_state)),
        s=float(numbers(problem, orbit)[problem.names.index(parameter)]),
    )


def plane_of(
    problem: Problem,
    orbit: ZenoOrbit,
    names: tuple[str, str],
    boxes: tuple[tuple[float, float], tuple[float, float]],
) -> Plane:
    """Return the plane of two parameters around an orbit's numbers.

    Raises:
        InputError: If a name or the second range does not fit.
    """
    if names[0] == names[1]:
        raise InputError(f"Argument `second` must differ from `in`, but both are `{names[0]}`.")
    p = numbers(problem, orbit)
    for name in names:
        line_in(problem, p, name)
    first, second = (problem.names.index(name) for name in names)
    check_box(problem, names[1], boxes[1], float(p[second]))
    return Plane(
        names=names,
        places=(first, second),
        box=np.array(boxes),
        p=p,
        restitution=problem.names.index("restitution"),
    )


def scale_of(problem: Problem, orbit: ZenoOrbit) -> Vector:
    """Return the size of each state over the events of an orbit, nowhere near zero, ``(n_x,)``."""
    events = [orbit.release_state, orbit.zeno_state, *(i.state_minus for i in orbit.impacts)]
    sizes = np.max(np.abs([problem.state_vector(state) for state in events]), axis=0)
    largest = float(np.max(sizes))
    return np.where(sizes > 1e-9 * largest, sizes, largest)


def line_in(problem: Problem, p: Vector, parameter: str) -> Line:
    """Return the line along which one number changes.

    Raises:
        InputError: If the problem has no such number.
    """
    direction = np.zeros(p.size)
    direction[problem.place(parameter, argument="in")] = 1.0
    return Line(origin=p * (1 - direction), direction=direction)


def check_box(problem: Problem, parameter: str, box: tuple[float, float], value: float) -> None:
    """Refuse a range that is none, that a parameter may not have, or without the start.

    Raises:
        InputError: If it is one of these.
    """
    problem.require_range(parameter, box, argument="in")
    low, high = box
    if not low <= value <= high:
        message = f"must hold the start, {parameter} = {value:g}, but it is {low:g}:{high:g}"
        raise InputError(f"Argument `in` {message}.")
