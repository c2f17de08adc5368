"""Orbits at fixed values: a simulation settles, and Newton's method closes.

The motion is simulated until it nearly repeats at an event, and the return to this event is solved
for its fixed point. A known orbit is closed without it. The orbit comes from the simulator, which
the checker also uses: certify it with another engine or the model written by hand, or use
`find_orbit`, which shares only the model with the checker.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError, ZenoOrbitsError
from zeno_orbits.model import ParameterValues, Problem
from zeno_orbits.orbits import (
    EventReturn,
    EventSequence,
    Orbit,
    OrbitEvent,
    PhaseKind,
    StepControl,
    closed_return,
    largest_states,
    orbit_event_name,
    orbit_of_events,
    shape_of_events,
)
from zeno_orbits.search.closing.limits import beyond_limits, named
from zeno_orbits.search.closing.line import LinePoint, follow_line, values_on_line
from zeno_orbits.search.closing.settling import Wanted, settled_from
from zeno_orbits.simulation import SimulationSettings, state_after, state_before
from zeno_orbits.work import Progress, silent

_FROM_ORBIT = StepControl(
    first=1.0, longest=1.0, shortest=1e-3, most=200, growth=2.0, shrinkage=0.5
)
"""Parts of the way from the values of a known orbit to other values."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShootingResult:
    """Outcome of closing an orbit by simulation, successful or not.

    Attributes:
        orbit: The orbit, not verified, or ``None`` after a failure.
        miss: Relative change of the orbit's start over a period. Infinite without an orbit.
        detail: Reason of a failure, as a sentence. Empty after a success.
    """

    orbit: Orbit | None
    miss: float = np.inf
    detail: str = ""

    def unwrap(self) -> Orbit:
        """Return the orbit.

        Raises:
            OrbitNotClosedError: If no orbit was closed. The error contains this result.
        """
        if self.orbit is None:
            raise OrbitNotClosedError(self)
        return self.orbit


class OrbitNotClosedError(ZenoOrbitsError):
    """No simulation was closed to an orbit.

    Attributes:
        result: The outcome.
    """

    def __init__(self, result: ShootingResult) -> None:
        super().__init__(result.detail)
        self.result = result


def orbit_by_shooting(
    problem: Problem,
    values: ParameterValues,
    *,
    near: Orbit | None = None,
    start: Mapping[str, float] | None = None,
    section: str | None = None,
    shape: EventSequence | None = None,
    until: float | None = None,
    simulation: SimulationSettings | None = None,
    on_progress: Progress = silent,
) -> ShootingResult:
    """Return the orbit to which a motion settles, or that a known orbit becomes, if there is one.

    Args:
        problem: The problem.
        values: Values of its gains and parameters.
        near: A known orbit. It is followed to the values, and no motion is simulated.
        start: State name to initial value, by default each start of the problem in turn.
        section: Name of the event at which the period starts and ends, such as ``zeno knee``. By
            default it is chosen.
        shape: Phases of the period of a machine with the stop `stop`. The default is any.
        until: Longest time to settle [s]. The default is 400 of the problem's slowest oscillations,
            or longer for a motion whose returns converge.
        simulation: Engine and accuracy.
        on_progress: Called with the name of each stage at its beginning.

    Raises:
        InputError: If ``near`` belongs to another problem or has a different shape, or if the
            section does not occur.
    """
    try:
        if near is None:
            found = settled_return(
                problem,
                values,
                starts=() if start is None else (start,),
                section=section,
                shape=shape,
                until=until,
                simulation=simulation,
                on_progress=on_progress,
            )
        else:
            require_no_other_start(start, section)
            if shape is not None:
                near.shape.agreed(shape)
            found = return_near(
                problem, values, near, simulation=simulation, on_progress=on_progress
            )
        found = _within_limits(problem, found)
    except SimulationError as error:
        return ShootingResult(orbit=None, detail=f"{error.reason.rstrip('.')}.")
    scale = largest_states(found.execution.arcs, found.differentiation.graph)
    miss = float(np.max(np.abs(found.end - found.start) / scale))
    return ShootingResult(orbit=event_orbit_of(problem, values, found), miss=miss)


def settled_event_orbit(
    problem: Problem,
    values: ParameterValues,
    *,
    start: Mapping[str, float] | None = None,
    on_progress: Progress = silent,
) -> Orbit:
    """Return the orbit to which a motion settles, not verified.

    Args:
        problem: The problem. The stop of a machine with one stop is named `stop`.
        values: Its parameter values.
        start: As for `orbit_by_shooting`.
        on_progress: Called with the stage.

    Raises:
        SimulationError: If no motion settles, or Newton's method does not converge.
    """
    starts = () if start is None else (start,)
    found = settled_return(problem, values, starts=starts, on_progress=on_progress)
    return event_orbit_of(problem, values, _within_limits(problem, found))


def _within_limits(problem: Problem, found: EventReturn) -> EventReturn:
    """Return a periodic return, or raise `SimulationError` if it passes a limit of a state."""
    beyond = beyond_limits(problem, found.arcs)
    if beyond:
        raise SimulationError(beyond, time=found.period, state=tuple(found.start.tolist()))
    return found


def require_no_other_start(
    start: Mapping[str, float] | Sequence[Mapping[str, float]] | None, section: str | None
) -> None:
    """Refuse a start or a section with a known orbit, which has its own.

    Args:
        start: Initial state or states, empty or ``None`` without one.
        section: Name of the event of the section, or ``None``.

    Raises:
        InputError: If one of them is given.
    """
    for argument, given in (("start", start), ("section", section)):
        if given:
            raise InputError(
                f"Argument `{argument}` must be left out of a search from a known orbit, which has "
                "its own."
            )


def return_near(
    problem: Problem,
    values: ParameterValues,
    near: Orbit,
    *,
    simulation: SimulationSettings | None = None,
    on_progress: Progress = silent,
) -> EventReturn:
    """Return the periodic return that a known orbit becomes at other values.

    The values change along a straight line, in steps in which Newton's method converges.

    Args:
        problem: The problem.
        values: The values.
        near: The orbit.
        simulation: Accuracy.
        on_progress: Called with the stage.

    Raises:
        InputError: If the orbit is of another problem.
        SimulationError: If the orbit does not close, or is lost on the way.
    """
    if near.problem != problem.name:
        message = f"must be of problem `{problem.name}`, but it is of `{near.problem}`"
        raise InputError(f"Argument `near` {message}.")
    settings, own = simulation or SimulationSettings(), near.values(problem)
    on_progress("closing the known orbit", None)

    def closed(part: float, x: Vector, last: LinePoint | None) -> LinePoint:
        found = closed_return(
            problem.graph_dynamics(values_on_line(own, values, part)),
            x,
            section=near.section,
            n_returns=near.n_returns,
            guess=near.period if last is None else last.orbit.period,
            settings=settings,
            mode=last and last.orbit.mode,
            by_returns=True,
        )
        return LinePoint(part=part, start=found.start, orbit=found, margins={})

    first = closed(0.0, np.array(problem.state_vector(near.start_state)), None)
    if own.numbers == values.numbers:
        return first.orbit
    path = follow_line(
        first,
        closed,
        own,
        values,
        steps=_FROM_ORBIT,
        losses={},
        tell=lambda stage: on_progress(stage, None),
    )
    last = first.orbit if path.orbit is None else path.orbit
    if not path.arrived:
        raise SimulationError(
            f"The known orbit is lost after {100 * (1 - path.left):.3g} % of the way to the values "
            f"({path.refusal or 'too many steps'})",
            time=last.period,
            state=tuple(last.start.tolist()),
        )
    return last


def settled_return(
    problem: Problem,
    values: ParameterValues,
    *,
    starts: Sequence[Mapping[str, float]] = (),
    section: str | None = None,
    shape: EventSequence | None = None,
    until: float | None = None,
    simulation: SimulationSettings | None = None,
    changing: Sequence[str] = (),
    on_progress: Progress = silent,
) -> EventReturn:
    """Return the periodic return to which a motion settles.

    Args:
        problem: The problem.
        values: Its parameter values.
        starts: Initial states in turn, name to value. The default is the problem's own.
        section: Name of the event at which the period starts and ends. By default it is chosen.
        shape: Phases of the period of a machine with the stop `stop`. The default is any.
        until: Longest time to settle [s].
        simulation: Accuracy.
        changing: Names of gains and parameters that will change. The default section is then, if
            there is one, an event at a fixed phase of the clock, which every motion has.
        on_progress: Called with the stage.

    Raises:
        UnsettledError: If no motion settles.
        SimulationError: If all motions end, or Newton's method does not converge.
        InputError: If the section does not occur.
    """
    graph, settings = problem.graph_dynamics(values), simulation or SimulationSettings()
    given = tuple(problem.state_vector(start, values) for start in starts)
    wanted = Wanted(
        section=section,
        shape=shape,
        changing=indices_of(values, changing),
    )
    troubles: dict[str, SimulationError] = {}
    for begin in given or problem.admissible_starts(values):
        on_progress("settling", None)
        try:
            return settled_from(
                problem, graph, np.array(begin), wanted, until=until, settings=settings
            )
        except SimulationError as error:
            troubles.setdefault(error.reason, error)
    *_, last = troubles.values()
    raise last


def indices_of(values: ParameterValues, names: Sequence[str]) -> tuple[int, ...]:
    """Return the places of gains and parameters in the parameter vector.

    Args:
        values: The values.
        names: Names of gains and parameters.
    """
    order = list(values.numbers)
    return tuple(order.index(name) for name in names)


def event_orbit_of(problem: Problem, values: ParameterValues, found: EventReturn) -> Orbit:
    """Return the orbit of a periodic return, not verified and without its multipliers.

    Args:
        problem: The problem.
        values: Its parameter values.
        found: The return.
    """
    names = [orbit_event_name(event) for event in found.events]
    times = [event.time for event in found.events]
    shape, thrown = None, set[int]()
    if not problem.has_graph:
        is_plastic = problem.dynamics(values).restitution == 0.0
        shape = shape_of_events(found.events, is_plastic=is_plastic)
    if shape is not None and PhaseKind.IMPACT in shape.phases:
        # The next phase starts at the state after an impact that the stop throws off.
        ends = [name == "impact stop" for name in names[:-1]]
        thrown = {k for k, hit in enumerate(ends) if hit and names[k + 1] != "zeno stop"}
    events = [
        OrbitEvent(
            name=names[k],
            time=times[k],
            state=named(problem, state_before(event)),
            after=named(problem, state_after(event)) if k in thrown else None,
        )
        for k, event in enumerate(found.events)
    ]
    start = named(problem, found.start)
    orbit = orbit_of_events(problem, values, period=found.period, start_state=start, events=events)
    return replace(orbit, phases_as=shape)
