"""Studies over parameters: continuation of an orbit, and maps of attractors."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from zeno_orbits.api.inputs import (
    Axis,
    Named,
    Numbers,
    Span,
    any_orbit,
    as_axis,
    as_span,
    file_of,
    front_door,
    known_problem,
    plan_of,
    problem_of,
    repeating_problem,
)
from zeno_orbits.errors import named_numbers
from zeno_orbits.model import Problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.work import ExecutionPlan, Progress, Workers, silent

if TYPE_CHECKING:
    from zeno_orbits.continuation import (
        Continuation,
        ContinuationSettings,
        SecondParameter,
        SpecialPointKind,
        WorkerPool,
    )
    from zeno_orbits.maps import Attractor, ParameterMap, Plane
    from zeno_orbits.maps import Axis as MapAxis


@front_door
def continue_orbit(
    orbit: Orbit | str | Path,
    parameter: Span,
    *,
    problem: Named | None = None,
    parameter2: Span | SecondParameter | None = None,
    settings: ContinuationSettings | None = None,
    workers: int = 1,
    plan: ExecutionPlan | None = None,
    on_progress: Progress = silent,
) -> Continuation:
    """Return the solution branch of an orbit in a gain or parameter, with its special points.

    Args:
        orbit: The orbit, or its file.
        parameter: Name of the gain or parameter, and its range, ``("Kd", -2.5, 0)``. The range
            contains the value of the orbit. Parameters derived from it keep their values.
        problem: The orbit's problem. The default is the bundled problem of its name.
        parameter2: A second parameter and its range, in which the special points are continued as
            curves. `second_parameter` chooses kinds of points.
        settings: Accuracy and steps.
        workers: Number of processes. Several processes need the name or the file of the problem.
        plan: Executor of the work and folder of finished parts. It overrides ``workers``.
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If a name is unknown or the range does not fit.
        SimulationError: If the orbit does not close.
        WorkError: If the work cannot be finished.
    """
    from zeno_orbits import continuation

    name, box = as_span("parameter", parameter)
    second = parameter2
    if isinstance(second, tuple | list):
        second = second_parameter(*as_span("parameter2", second))
    orbit = any_orbit(orbit)
    known = problem_of(orbit, problem)
    with _crew(known, plan_of(workers, plan), on_progress) as crew:
        known = known if crew is None else crew.problem_file.load()
        return continuation.family_of_orbit(
            known,
            orbit,
            name,
            box,
            second=second,
            settings=settings,
            on_progress=on_progress,
            crew=crew,
        )


@front_door
def continue_impacts(
    problem: Named,
    parameter: Span,
    *,
    start: Numbers,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    settings: ContinuationSettings | None = None,
    workers: int = 1,
    plan: ExecutionPlan | None = None,
    on_progress: Progress = silent,
) -> Continuation:
    """Return the solution branch of the orbit without a Zeno point that a simulation reaches.

    Args:
        problem: The problem, its name or its file.
        parameter: Name of the gain or parameter, and its range. Parameters derived from it keep
            their values.
        start: State name to initial value of the motion, 0 for the others.
        gains: Gains that differ from their defaults.
        parameters: Parameters that differ from their defaults.
        settings: Accuracy and steps.
        workers: Number of processes. Several processes need the name or the file of the problem.
        plan: Executor of the work and folder of finished parts. It overrides ``workers``.
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If a name is unknown or the range does not fit.
        SimulationError: If the impacts do not converge to a periodic motion.
        WorkError: If the work cannot be finished.
    """
    from zeno_orbits import continuation

    with _crew(problem, plan_of(workers, plan), on_progress) as crew:
        known = known_problem(problem) if crew is None else crew.problem_file.load()
        return continuation.family_of_impacts(
            known,
            known.values(gains=gains, parameters=parameters),
            known.state_vector(start),
            *as_span("parameter", parameter),
            settings=settings,
            on_progress=on_progress,
            crew=crew,
        )


def orbit_inside(
    problem: Problem,
    ranges: Mapping[str, tuple[float, float]],
    *,
    numbers: Numbers | None = None,
    on_progress: Progress = silent,
) -> Orbit:
    """Return the orbit that a simulation reaches at values inside some ranges.

    A default outside its range is replaced by the middle of the range.

    Args:
        problem: The problem.
        ranges: Name to range of gains and parameters.
        numbers: Gains and parameters that differ from their defaults. They stay as they are.
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        OrbitNotFoundError: If the simulation does not reach such an orbit.
    """
    from zeno_orbits.continuation import clip_to_box, start_orbit
    from zeno_orbits.search import settled_event_orbit

    given = dict(numbers or {})
    values = clip_to_box(problem, problem.values(numbers=given), ranges, given)
    if problem.has_graph:
        return settled_event_orbit(problem, values, on_progress=on_progress)
    return start_orbit(problem, values, on_progress=on_progress)


def located_point_kinds() -> dict[str, SpecialPointKind]:
    """Return the kinds of special points that can be located, keyed by their words."""
    from zeno_orbits.continuation import SpecialPointKind

    return {kind.name.lower().replace("_", "-"): kind for kind in SpecialPointKind if kind.located}


def second_parameter(
    name: str, box: tuple[float, float], kinds: Sequence[SpecialPointKind] = ()
) -> SecondParameter:
    """Return a second parameter of a continuation.

    Args:
        name: Name of a gain or parameter.
        box: Its range, lower end first.
        kinds: Kinds of special points to continue, all by default.
    """
    from zeno_orbits.continuation import SecondParameter

    chosen = tuple(kinds) or tuple(located_point_kinds().values())
    return SecondParameter(name=name, box=box, kinds=chosen)


def continuation_settings(max_points: int) -> ContinuationSettings:
    """Return the settings of a continuation with a largest number of points.

    Args:
        max_points: Largest number of points in each direction.
    """
    from zeno_orbits.continuation import ContinuationSettings, FamilySteps

    return ContinuationSettings(steps=FamilySteps(most=max_points))


@contextmanager
def _crew(
    problem: Named, plan: ExecutionPlan | None, on_progress: Progress
) -> Generator[WorkerPool | None]:
    """Open the workers of a continuation, if the plan has workers."""
    from zeno_orbits.continuation import WorkerPool
    from zeno_orbits.work import open_pool

    if plan is None:
        yield None
        return
    with open_pool(plan.place) as pool:
        yield WorkerPool(
            problem_file=file_of(problem), plan=plan, pool=pool, on_progress=on_progress
        )


@front_door
def parameter_map(
    problem: Named,
    *,
    x: Axis,
    y: Axis,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    start: Numbers | None = None,
    orbit: Orbit | str | Path | None = None,
    refine: int = 0,
    until: float | None = None,
    workers: int = 1,
    plan: ExecutionPlan | None = None,
    on_progress: Progress = silent,
) -> ParameterMap:
    """Return the attractors over a plane of gains, parameters or initial states.

    Args:
        problem: The problem, its name or its file. Several workers need the name or the file.
        x: The axis across, ``("Kp", 1, 5, 30)``: name, range, number of points.
            An axis may be a gain, a parameter or a state.
        y: The axis upwards.
        gains: Gains that differ from their defaults.
        parameters: Parameters that differ from their defaults.
        start: State name to initial value of every motion. The default is the problem's first
            start.
        orbit: An orbit or its file. Motions start at the start of its period, with its gains and
            parameters. The axes and the other arguments override these values.
        refine: Number of times that cells along boundaries are halved.
        until: Longest time until a motion has settled [s]. The default is 300 periods of the
            problem's clock, or 115 periods of its slowest oscillation. It is longer for a
            restitution above 0.5.
        workers: Number of processes: 1 for this process alone, 0 for one per core.
        plan: Executor of the work and folder of finished parts. It overrides ``workers``.
        on_progress: Called with the stage and the part of it that is done.

    Raises:
        InputError: If a name is unknown, a range does not fit, or there are too many points.
        WorkError: If the work cannot be finished.
    """
    from zeno_orbits import maps

    shared = plan_of(workers, plan)
    plane = map_plane(
        problem,
        x=as_axis("x", x),
        y=as_axis("y", y),
        gains=gains,
        parameters=parameters,
        start=start,
        orbit=orbit,
        until=until,
        in_file=shared is not None,
    )
    chosen = shared or ExecutionPlan(place=Workers(count=1))
    plan = replace(chosen, chunk=maps.chunk_of(plane))
    return maps.map_of_plane(plane, plan, refine=refine, on_progress=on_progress)


def map_plane(
    problem: Named,
    *,
    x: MapAxis,
    y: MapAxis,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    start: Numbers | None = None,
    orbit: Orbit | str | Path | None = None,
    until: float | None = None,
    in_file: bool = True,
) -> Plane:
    """Return the plane of a map.

    Args:
        problem: As in `parameter_map`.
        x: The axis across.
        y: The axis upwards.
        gains: As in `parameter_map`.
        parameters: As in `parameter_map`.
        start: As in `parameter_map`.
        orbit: As in `parameter_map`.
        until: As in `parameter_map`.
        in_file: True if other processes have to load the problem.

    Raises:
        InputError: If a name is unknown, a range does not fit, or the orbit belongs to another
            problem.
    """
    from zeno_orbits import maps

    known = repeating_problem(problem)
    fixed = {"gains": dict(named_numbers("gains", gains))}
    fixed["parameters"] = dict(named_numbers("parameters", parameters))
    begin = known.state_vector(known.starts[0] if start is None else start, known.values(**fixed))
    is_declared = start is None and orbit is None
    if orbit is not None:
        orbit = any_orbit(orbit)
        values = orbit.values(problem_of(orbit, known))
        begin = known.state_vector({**orbit.start_state, **(start or {})})
        chosen = (x.name, y.name, *fixed["parameters"])
        free = (*chosen, *known.derived_from(chosen, values.parameters))
        own = {"gains": values.gains, "parameters": values.parameters}
        for kind, numbers in own.items():
            own_numbers = {name: value for name, value in numbers.items() if name not in free}
            fixed[kind] = {**own_numbers, **fixed[kind]}
    plane = maps.Plane(
        source=file_of(problem) if in_file else known,
        x=x,
        y=y,
        gains=fixed["gains"],
        parameters=fixed["parameters"],
        start=begin,
        is_declared=is_declared,
        until=until,
    )
    maps.require_free_states(plane, start or {})
    return plane


def attractor_of(
    problem: Named,
    *,
    gains: Numbers | None = None,
    parameters: Numbers | None = None,
    start: Numbers | None = None,
) -> Attractor:
    """Return the attractor of one motion, as for a point of a map.

    Args:
        problem: The problem, its name or its file.
        gains: Gains that differ from their defaults.
        parameters: Parameters that differ from their defaults.
        start: State name to initial value, 0 for the others. The default is the problem's first
            start.

    Raises:
        InputError: If a name is unknown or a value is out of range.
    """
    from zeno_orbits.maps import attractors_at

    known = repeating_problem(problem)
    values = known.values(gains=gains, parameters=parameters)
    begin = dict(zip(known.state_names, known.initial_state(start, values), strict=True))
    (found,) = attractors_at(known, [values], start=begin)
    return found
