"""Orbits of events: a simulation settles, and Newton's method closes.

The values of gains and parameters are fixed. The motion is simulated until it nearly repeats at
an event, and the return to this event is solved for its fixed point. A known orbit needs no
simulation. `gains` varies values.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, SimulationError, StepLimitError, counted
from zeno_orbits.model import GraphDynamics, ParameterValues, Problem, own_time
from zeno_orbits.orbits import (
    EventReturn,
    Orbit,
    OrbitEvent,
    StepControl,
    closed_return,
    multipliers_of_return,
    near_return,
    orbit_event_name,
    orbit_of_events,
    settles_at,
    shortest_return,
)
from zeno_orbits.search.homotopy.line import LinePoint, follow_line, values_on_line
from zeno_orbits.search.shooting.closing import named
from zeno_orbits.simulation import (
    Execution,
    SimulationSettings,
    simulated_at_most,
    state_before,
)
from zeno_orbits.work import Progress, silent

_FIRST, _LONGEST, _LONGER = 25.0, 400.0, 4.0
"""First and longest simulated time in units of the problem's slowest time, and factor of a longer
one. The longest is longer for a motion whose returns converge."""
_STEPS, _MORE = 20_000, 5
"""Most steps of the first simulation, and factor of the next ones. The slowest time may be far
longer than a period."""

_FROM_ORBIT = StepControl(
    first=1.0, longest=1.0, shortest=1e-3, most=200, growth=2.0, shrinkage=0.5
)
"""Parts of the way from the values of a known orbit to other values."""


def settled_event_orbit(
    problem: Problem,
    values: ParameterValues,
    *,
    near: Orbit | None = None,
    start: Mapping[str, float] | None = None,
    section: str | None = None,
    until: float | None = None,
    simulation: SimulationSettings | None = None,
    on_progress: Progress = silent,
) -> Orbit:
    """Return the orbit to which a motion settles, or that a known orbit becomes, not verified.

    Args:
        problem: The problem. The stop of a machine with one stop is named `stop`.
        values: Its parameter values.
        near: A known orbit. It is followed to the values, and no motion is simulated.
        start: State name to initial value, by default each start of the problem in turn.
        section: Name of the event at which the period starts and ends, such as ``zeno knee``. By
            default it is chosen.
        until: Longest time to settle [s]. The default is 400 of the problem's slowest oscillations,
            or longer for a motion whose returns converge.
        simulation: Accuracy.
        on_progress: Called with the stage.

    Raises:
        SimulationError: If no motion settles, or Newton's method does not converge.
        InputError: If the section does not occur.
    """
    if near is not None:
        require_no_other_start(start, section)
        found = return_near(problem, values, near, simulation=simulation, on_progress=on_progress)
        return event_orbit_of(problem, values, found)
    found = settled_return(
        problem,
        values,
        start=start,
        section=section,
        until=until,
        simulation=simulation,
        on_progress=on_progress,
    )
    return event_orbit_of(problem, values, found)


def require_no_other_start(start: Mapping[str, float] | None, section: str | None) -> None:
    """Refuse a start or a section beside a known orbit, which has its own.

    Args:
        start: State name to initial value, or ``None``.
        section: Name of the event of the section, or ``None``.

    Raises:
        InputError: If one of them is given.
    """
    for argument, given in (("start", start), ("section", section)):
        if given is not None:
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
        InputError: If the orbit does not fit the problem.
        SimulationError: If the orbit does not close, or is lost on the way.
    """
    settings, own = simulation or SimulationSettings(), near.values(problem)
    on_progress("closing the known orbit", None)

    def closed(
        part: float, x: Vector, last: LinePoint[EventReturn] | None
    ) -> LinePoint[EventReturn]:
        found = closed_return(
            problem.graph_dynamics(values_on_line(own, values, part)),
            x,
            section=near.section,
            n_returns=near.n_returns,
            guess=near.period if last is None else last.orbit.period,
            settings=settings,
            mode=last and last.orbit.mode,
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
    start: Mapping[str, float] | None = None,
    section: str | None = None,
    until: float | None = None,
    simulation: SimulationSettings | None = None,
    changing: Sequence[str] = (),
    on_progress: Progress = silent,
) -> EventReturn:
    """Return the periodic return to which a motion settles.

    Args:
        problem: The problem.
        values: Its parameter values.
        start: State name to initial value, by default each start of the problem in turn.
        section: Name of the event at which the period starts and ends. By default it is chosen.
        until: Longest time to settle [s].
        simulation: Accuracy.
        changing: Names of gains and parameters that will change. The default section is then, if
            there is one, an event at a fixed phase of the clock, which every motion has.
        on_progress: Called with the stage.

    Raises:
        SimulationError: If no motion settles, or Newton's method does not converge.
        InputError: If the section does not occur.
    """
    graph, settings = problem.graph_dynamics(values), simulation or SimulationSettings()
    if start is None:
        starts = problem.admissible_starts(values)
    else:
        starts = (problem.state_vector(start, values),)
    trouble: SimulationError | None = None
    for begin in starts:
        on_progress("settling", None)
        for motion, is_cut in _motions(graph, np.array(begin), section, until, settings):
            if isinstance(motion, SimulationError):
                trouble = motion
                break
            chosen = section
            if section is None and changing:
                chosen = _fixed_event(graph, motion, indices_of(values, changing))
            try:
                return _closed(graph, motion, chosen, settings)
            except SimulationError as error:
                trouble = _many_steps(motion, settings) if is_cut else error
            except InputError:
                # The event of the section may follow later.
                if not is_cut:
                    raise
    if trouble is None:
        raise AssertionError("A problem has a start.")
    raise trouble


def _motions(
    graph: GraphDynamics,
    x: Vector,
    section: str | None,
    until: float | None,
    settings: SimulationSettings,
) -> Iterator[tuple[Execution | SimulationError, bool]]:
    """Yield longer and longer motions from a state, and whether the number of steps ended them.

    The last one is the error of a motion that cannot be continued.

    Args:
        graph: The graph of modes.
        x: The state, ``(n_x,)``.
        section: Name of the event of the section, or ``None``.
        until: Longest time [s], or ``None`` for one that follows from the motion.
        settings: Accuracy.
    """
    slowest = own_time(graph.first, x)
    longest = _LONGEST * slowest if until is None else until
    time = _FIRST * slowest if until is None else until
    steps = _STEPS if until is None else settings.most_steps
    while True:
        try:
            motion, is_cut = simulated_at_most(
                graph, x, until=time, most_steps=steps, settings=settings
            )
        except StepLimitError as error:
            # Without an event so far, as before a pole of a formula.
            if steps < settings.most_steps:
                steps = min(_MORE * steps, settings.most_steps)
                continue
            yield error, False
            return
        except SimulationError as error:
            yield error, False
            return
        yield motion, is_cut
        if until is not None or (is_cut and steps >= settings.most_steps):
            return
        settled = settles_at(motion, graph, section) or 0.0
        longest = max(longest, settled)
        if not is_cut and time >= longest:
            return
        if not is_cut:
            time = min(settled if settled > time else _LONGER * time, longest)
        steps = min(_MORE * steps, settings.most_steps)


def _many_steps(motion: Execution, settings: SimulationSettings) -> SimulationError:
    """Return the error of a motion that takes all steps without settling."""
    return SimulationError(
        f"The motion does not settle to an orbit within {counted(settings.most_steps, 'step')}: "
        "simulate for a shorter time (`until`), or start nearer to an orbit (`start`)",
        time=motion.end_time,
        state=tuple(motion.end_state.tolist()),
    )


def indices_of(values: ParameterValues, names: Sequence[str]) -> tuple[int, ...]:
    """Return the places of gains and parameters in the parameter vector.

    Args:
        values: The values.
        names: Names of gains and parameters.
    """
    order = list(values.numbers)
    return tuple(order.index(name) for name in names)


def _fixed_event(graph: GraphDynamics, motion: Execution, chosen: Sequence[int]) -> str | None:
    """Return a switch whose guard depends on the clock alone, and on no chosen parameter."""
    clock = graph.first.clock
    for event in motion.switches:
        switch = graph.switch_names.index(event.name)
        x, sides = np.asarray(event.state_minus), graph.open_mode[1]
        if switch < graph.n_declared and graph.guards(event.state_plus, sides)[2][switch] > 0.0:
            # A motion cannot start where a declared switch is still armed.
            continue
        gradient = graph.guard_gradient(switch, x, chosen, graph.sides_at(x, sides))
        rest = np.delete(gradient, list(clock))
        if clock and gradient.any() and not rest.any():
            return orbit_event_name(event)
    return None


def _closed(
    graph: GraphDynamics, motion: Execution, section: str | None, settings: SimulationSettings
) -> EventReturn:
    """Return the periodic return near the end of a motion."""
    near = near_return(motion, graph, section)
    found = closed_return(
        graph,
        near.state,
        section=near.section,
        n_returns=near.n_returns,
        guess=near.period,
        settings=settings,
        mode=near.mode,
    )
    return shortest_return(graph, found, settings)


def event_orbit_of(problem: Problem, values: ParameterValues, found: EventReturn) -> Orbit:
    """Return the orbit of a periodic return, not verified.

    Args:
        problem: The problem.
        values: Its parameter values.
        found: The return.
    """
    events = [
        OrbitEvent(
            name=orbit_event_name(event),
            time=event.time,
            state=named(problem, state_before(event)),
        )
        for event in found.events
    ]
    start = named(problem, found.start)
    orbit = orbit_of_events(problem, values, period=found.period, start_state=start, events=events)
    multipliers = multipliers_of_return(problem.graph_dynamics(values), found)
    return replace(orbit, floquet_multipliers=multipliers)
