r"""Families of periodic orbits in a gain or a parameter, stable or unstable.

From one orbit the family is followed in both directions until it ends. Every point at which its
character changes is located and named. A problem may derive parameters from others, such as the
motor pendulum's calibrated constants. Derived parameters are held at their values at the start, so
the family belongs to one machine of which one parameter changes. Source: [Keller1977]_, theory
(5.5) to (5.8).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from zeno_orbits.continuation.assembly import FollowedFamily, whole_family
from zeno_orbits.continuation.branch import Branch
from zeno_orbits.continuation.corrector import first_point
from zeno_orbits.continuation.families import Continuation, SpecialCurve, SpecialPointKind
from zeno_orbits.continuation.jobs import FollowDirection, FollowDoubling
from zeno_orbits.continuation.parallel import Dispatch, WorkerPool
from zeno_orbits.continuation.setup import (
    ContinuationSettings,
    FamilyStart,
    plane_of,
    start_of_family,
)
from zeno_orbits.continuation.two_parameters.boundary_set import curves_through
from zeno_orbits.errors import InputError, SimulationError
from zeno_orbits.model import ParameterValues, Problem, RecordedFile
from zeno_orbits.orbits import NO_ZENO_ORBIT, ONE_ZENO, Orbit, digest_of
from zeno_orbits.search import orbit_at_gains, orbit_by_shooting, settled_event_orbit
from zeno_orbits.simulation import simulator_in_use
from zeno_orbits.work import Checked, Progress, silent, to_plain, versions


@dataclass(frozen=True, slots=True, kw_only=True)
class SecondParameter(Checked):
    """A second parameter, in which special points are also followed.

    Attributes:
        name: Name of a gain or a parameter.
        box: Its range, lower end first.
        kinds: Kinds of special points to follow.
    """

    name: str
    box: tuple[float, float]
    kinds: tuple[SpecialPointKind, ...]


def family_of_orbit(
    problem: Problem,
    orbit: Orbit,
    parameter: str,
    box: tuple[float, float],
    *,
    second: SecondParameter | None = None,
    settings: ContinuationSettings | None = None,
    on_progress: Progress = silent,
    crew: WorkerPool | None = None,
) -> Continuation:
    """Return the family of an orbit in a gain or a parameter, and its bifurcating branches.

    Args:
        problem: The problem.
        orbit: An orbit of the problem. Its parameter must lie in the box.
        parameter: Name of a gain or a parameter.
        box: Range of the parameter, lower end first.
        second: A second parameter, if special points are to be followed in both.
        settings: Settings of the continuation.
        on_progress: Called with each point.
        crew: Workers. By default this process runs all jobs.

    Raises:
        InputError: If a name or a range does not fit, or the orbit belongs to another problem.
        SimulationError: If the orbit does not close.
        WorkError: If the work cannot be finished.
    """
    settings = settings or ContinuationSettings()
    start = start_of_family(problem, orbit, parameter, box, settings)
    dispatch = Dispatch(problem=problem, settings=settings, on_progress=on_progress, crew=crew)
    return continue_from(start, dispatch, second=second)


def family_of_impacts(
    problem: Problem,
    values: ParameterValues,
    state: tuple[float, ...],
    parameter: str,
    box: tuple[float, float],
    *,
    settings: ContinuationSettings | None = None,
    on_progress: Progress = silent,
    crew: WorkerPool | None = None,
) -> Continuation:
    """Return the family of an attracting orbit without a Zeno point.

    Args:
        problem: The problem.
        values: Its parameter values at the start.
        state: Initial state of a motion that converges to the orbit, ``(n_x,)``.
        parameter: Name of a gain or a parameter.
        box: Range of the parameter, lower end first.
        settings: Settings of the continuation.
        on_progress: Called with each point.
        crew: Workers. By default this process runs all jobs.

    Raises:
        InputError: If a name or a range does not fit.
        SimulationError: If the impacts do not converge.
        WorkError: If the work cannot be finished.
    """
    start = dict(zip(problem.state_names, state, strict=True))
    orbit = settled_event_orbit(problem, values, start=start, on_progress=on_progress)
    if orbit.kind != NO_ZENO_ORBIT:
        sequence = ", ".join(orbit.sequence)
        raise SimulationError(
            f"The motion does not converge to an orbit without a Zeno point: it has `{sequence}`",
            time=orbit.period,
            state=state,
        )
    return family_of_orbit(
        problem, orbit, parameter, box, settings=settings, on_progress=on_progress, crew=crew
    )


def continue_from(
    start: FamilyStart, dispatch: Dispatch, *, second: SecondParameter | None = None
) -> Continuation:
    """Return the family through a state of a section, and its bifurcating branches.

    Args:
        start: The start of the family.
        dispatch: The problem, the settings, and the processes that run the jobs.
        second: A second parameter, if special points are to be followed in both.

    Raises:
        InputError: If the second parameter does not fit, the crew has another problem, or its
            checkpoint belongs to other work.
        SimulationError: If no fixed point lies near the start.
        WorkError: If the work cannot be finished.
    """
    identity = _identity(start, dispatch)
    if second is None:
        return _continuation(dispatch.problem, _families(start, dispatch.claimed(identity)))
    setup = start.setup
    plane = plane_of(dispatch.problem, setup.values, setup, second.name, second.box)
    own = {"second": second.name, "box": list(second.box), "kinds": to_plain(second.kinds)}
    dispatch = dispatch.claimed({**identity, **own})
    families = _families(start, dispatch)
    curves = curves_through(dispatch, plane, families, second.kinds)
    return _continuation(dispatch.problem, families, curves)


def clip_to_box(
    problem: Problem,
    values: ParameterValues,
    boxes: Mapping[str, tuple[float, float]],
    given: Mapping[str, float],
) -> ParameterValues:
    """Return parameter values to start at, inside the ranges of a continuation.

    A value outside its range is replaced by the middle of the range, unless it was given.

    Args:
        problem: The problem.
        values: Its parameter values.
        boxes: Range by name, for each parameter of the continuation.
        given: Value by name, for each parameter that was given. These values are kept.
    """
    moved = {
        name: (low + high) / 2
        for name, (low, high) in boxes.items()
        if name in values.numbers and name not in given and not low <= values.number(name) <= high
    }
    return problem.values(numbers={**given, **moved})


def start_orbit(
    problem: Problem, values: ParameterValues, *, on_progress: Progress = silent
) -> Orbit:
    """Return the attracting orbit at given parameter values.

    The orbit is computed by simulation alone. If it does not close, it is computed by the search.

    Args:
        problem: The problem.
        values: Its parameter values.
        on_progress: Called with each stage.

    Raises:
        OrbitNotFoundError: If the motion does not converge to such an orbit.
    """
    try:
        closing = orbit_by_shooting(problem, values, on_progress=on_progress, shape=ONE_ZENO)
    except InputError:
        # A rough simulation may drift off a holonomic row. The search does not depend on it.
        closing = None
    if closing is not None and closing.orbit is not None:
        return closing.orbit
    return orbit_at_gains(problem, values, shape=ONE_ZENO).unwrap()


def _continuation(
    problem: Problem, families: list[FollowedFamily], boundaries: tuple[SpecialCurve, ...] = ()
) -> Continuation:
    return Continuation(
        families=tuple(one.family for one in families),
        boundaries=boundaries,
        versions=versions(),
        problem_digest=digest_of(problem),
        problem_file=RecordedFile.of(problem),
    )


def _identity(start: FamilyStart, dispatch: Dispatch) -> dict[str, Any]:
    """Return the complete input of a family as plain data."""
    setup = start.setup
    return {
        "problem": dispatch.problem.name,
        "gains": to_plain(setup.values.gains),
        "parameters": to_plain(setup.values.parameters),
        "in": setup.parameter,
        "range": list(setup.box),
        "section": to_plain(setup.section),
        "start": [*start.x.tolist(), start.s],
        "settings": to_plain(dispatch.settings, "settings"),
        "simulator": simulator_in_use(),
        "versions": versions(),
    }


def _families(start: FamilyStart, dispatch: Dispatch) -> list[FollowedFamily]:
    """Return the family through a state, and the families that branch off at flips."""
    found = [_both_directions(start, dispatch)]
    latest = list(found)
    for generation in range(dispatch.settings.doublings):
        flips = [
            (one.setup, located)
            for one in latest
            for located in one.special
            if located.kind is SpecialPointKind.FLIP
        ]
        jobs = [(FollowDoubling(setup=setup, flip=flip.point),) for setup, flip in flips]
        branches = dispatch.results(f"branches-{generation + 1}", "branches", jobs)
        latest = list[FollowedFamily]()
        for (setup, flip), (branch,) in zip(flips, branches, strict=True):
            if branch is not None:
                root = Branch(points=(), special=(), ending=SpecialPointKind.FLIP, end=flip)
                latest.append(whole_family(dispatch.problem, setup.doubled(), root, branch))
        found += latest
    return found


def _both_directions(start: FamilyStart, dispatch: Dispatch) -> FollowedFamily:
    setup = start.setup
    returns = setup.returns(dispatch.problem)
    jobs = tuple(
        FollowDirection(
            setup=setup,
            start=first_point(returns, setup.metric, start.x, start.s, rising=rising),
        )
        for rising in (True, False)
    )
    ((forward, *backward),) = dispatch.results("directions", "directions", [jobs])
    closed = Branch(points=(), special=(), ending=SpecialPointKind.CLOSED)
    return whole_family(dispatch.problem, setup, backward[0] if backward else closed, forward)
