"""Motions that settle: a rough simulation until a motion nearly repeats at an event.

The simulation is continued piece by piece, and ends as soon as Newton's method closes the orbit at
full accuracy.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import (
    InputError,
    RunawayError,
    SimulationError,
    StepLimitError,
    UnsettledError,
    counted,
)
from zeno_orbits.integrators import Tolerance
from zeno_orbits.model import GraphDynamics, Problem, own_time
from zeno_orbits.orbits import (
    EventReturn,
    EventSequence,
    SectionMode,
    closed_return,
    events_of_shape,
    largest_states,
    multipliers_of_return,
    near_return,
    on_section,
    orbit_event_name,
    released_at_start,
    settles_at,
    shape_of_events,
    shortest_return,
)
from zeno_orbits.simulation import (
    AttractorKind,
    Execution,
    Impact,
    MotionLog,
    Piece,
    Release,
    SimulationSettings,
    SwitchEvent,
    ZenoExtrapolation,
    bounds_of,
    clock_turn,
    growth_of,
    simulated_at_most,
    state_after,
    watched_motion,
    without_events,
)

_FIRST, _SURE, _LONGEST = 3.125, 25.0, 400.0
"""First simulated time, time from which on any near return counts, and longest time, in units of
the problem's slowest time. The longest is longer for a motion whose returns converge."""
_STEPS, _MORE = 2500, 2
"""Most steps of the first piece, and factor of the next ones. The slowest time may be far longer
than a period."""
_EARLY = 1e-2
"""Relative distance of two states after events, below which a motion nearly repeats early."""
_THERE = 1e-4
"""Relative distance from an orbit at which a motion has arrived."""
_FAST, _HALF = 0.1, 0.5
"""Ratios of two successive such distances, and of the two before, below which an orbit attracts."""
_HELD, _REPEATS, _LOOKS = 2.0, 1e-5, 33
"""Turns of the clock without an event, relative change over a period, and states of a turn that are
looked at, of permanent contact."""
_ROUGH = 1e-8
"""Accuracy of the motion before it repeats."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """The orbit that a motion has to settle to.

    Attributes:
        section: Name of the event at which the period starts and ends, or ``None`` for any.
        shape: Phases of the period of a machine with the stop `stop`, or ``None`` for any.
        changing: Places of gains and parameters that will change. The default section is then, if
            there is one, an event at a fixed phase of the clock, which every motion has.
    """

    section: str | None = None
    shape: EventSequence | None = None
    changing: tuple[int, ...] = ()


def settled_from(
    problem: Problem,
    graph: GraphDynamics,
    start: Vector,
    wanted: Wanted,
    *,
    until: float | None,
    settings: SimulationSettings,
) -> EventReturn:
    """Return the periodic return to which the motion from a state settles.

    Args:
        problem: The problem, with its limits of the states.
        graph: Its graph of modes.
        start: The state, ``(n_x,)``.
        wanted: Section and event sequence of the orbit.
        until: Longest time to settle [s], or ``None`` for one that follows from the motion.
        settings: Accuracy of the orbit.

    Raises:
        UnsettledError: If the motion neither repeats nor ends.
        SimulationError: If the motion comes to rest, decays, or exceeds a limit, or if Newton's
            method does not converge.
        InputError: If the section does not occur.
    """
    passed: EventReturn | None = None
    trouble: SimulationError | None = None
    exact = settings.tolerance.relative
    # Near the border of a basin, a rough motion may miss the orbit to which the exact one leads.
    for error in sorted({max(_ROUGH, exact), exact}, reverse=True):
        try:
            found, attracts = _settled(problem, graph, start, wanted, until, settings, error)
        except UnsettledError as unsettled:
            trouble = unsettled
            continue
        if attracts:
            return found
        passed = passed or found
    if passed is not None:
        # The motion passes an orbit that repels it, and has not found another.
        return passed
    if trouble is None:
        raise AssertionError("A motion is followed at least once.")
    raise trouble


def _settled(
    problem: Problem,
    graph: GraphDynamics,
    start: Vector,
    wanted: Wanted,
    until: float | None,
    settings: SimulationSettings,
    error: float,
) -> tuple[EventReturn, bool]:
    """Return the periodic return near the end of a motion, and whether it attracts the motion.

    Args:
        problem: As for `settled_from`.
        graph: As for `settled_from`.
        start: As for `settled_from`.
        wanted: As for `settled_from`.
        until: As for `settled_from`.
        settings: As for `settled_from`.
        error: Relative local error of the motion.

    Raises:
        SimulationError: As for `settled_from`.
    """
    trouble: SimulationError | None = None
    passed: EventReturn | None = None
    slowest = own_time(graph.first, start)
    sure = _SURE * slowest if until is None else until
    rough = _rough(problem, graph, settings, error)
    for motion, is_cut in _motions(problem, graph, start, wanted, until, slowest, rough):
        is_early = motion.end_time < sure
        try:
            found = _closed(graph, motion, wanted, settings, is_early=is_early)
            if wanted.shape is not None or _comes_nearer(graph, motion, found):
                return found, True
            passed = passed or found
        except SimulationError as reason:
            trouble = _many_steps(motion, settings) if is_cut else reason
        except InputError:
            # The event of the section may follow later.
            if not (is_cut or is_early):
                raise
        _require_flight(problem, graph, motion)
        if _decays(motion):
            raise SimulationError(
                "The motion decays",
                time=motion.end_time,
                state=tuple(motion.end_state.tolist()),
            )
    if passed is not None:
        return passed, False
    if trouble is None:
        raise AssertionError("A motion has a first piece.")
    raise trouble


def _require_flight(problem: Problem, graph: GraphDynamics, motion: Execution) -> None:
    """Refuse a motion that stays in contact: its states repeat at the turns of the clock.

    Args:
        problem: The problem, with the units of its states.
        graph: Its graph of modes.
        motion: The motion so far.

    Raises:
        SimulationError: If no event has occurred for some turns, contact lasts, and states repeat.
    """
    x, arc = motion.end_state, motion.arcs[-1]
    closed, _ = arc.mode_in(graph)
    turn = clock_turn(graph.first, x) if closed else None
    if turn is None or motion.end_time - arc.start_time < _HELD * turn:
        return
    times = np.linspace(motion.end_time - turn, motion.end_time, _LOOKS)
    moving = [k for k in range(len(x)) if k not in graph.first.clock]
    change = np.ptp(arc.states_at(times), axis=0) / graph.own.states(len(x))
    if np.all(change[moving] < _REPEATS):
        # The clock alone moves: the motion comes to rest.
        return
    log = MotionLog(units=problem.state_units, usual=graph.own.states(len(x)))
    try:
        found = without_events(graph, log, x, _REPEATS)
        if found.kind is not AttractorKind.REPEATS:
            return
        period = found.turns * turn
        if any(p.events for p in _pieces(graph, x, period)):
            return
    except SimulationError:
        return
    stops = " and ".join(f"`{graph.stop_names[k]}`" for k in closed)
    raise SimulationError(
        f"The motion stays in contact with {stops}, with the period {period:.6g} s: "
        "the drive never lifts it off",
        time=motion.end_time,
        state=tuple(x.tolist()),
    )


def _pieces(graph: GraphDynamics, x: Vector, until: float) -> Iterator[Piece]:
    """Yield the pieces in which a motion goes on from a state of it."""
    for piece in watched_motion(graph, x, until=until, error=_ROUGH, goes_on=True):
        if isinstance(piece, Piece):
            yield piece


def _motions(
    problem: Problem,
    graph: GraphDynamics,
    x: Vector,
    wanted: Wanted,
    until: float | None,
    slowest: float,
    settings: SimulationSettings,
) -> Iterator[tuple[Execution, bool]]:
    """Yield longer and longer motions from a state, and whether the number of steps ended them.

    Args:
        problem: The problem.
        graph: The graph of modes.
        x: The state, ``(n_x,)``.
        wanted: Section of the orbit.
        until: Longest time [s], or ``None``.
        slowest: The problem's slowest time [s].
        settings: Accuracy of the motion.

    Raises:
        SimulationError: If the motion cannot be continued.
    """
    longest = _LONGEST * slowest if until is None else until
    time, steps = min(_FIRST * slowest, longest), min(_STEPS, settings.most_steps)
    motion: Execution | None = None
    while True:
        try:
            motion, is_cut = _continued(graph, x, motion, time, steps, settings)
        except RunawayError as error:
            raise _escaped(problem, error) from error
        except StepLimitError:
            # Without an event so far, as before a pole of a formula.
            if steps >= settings.most_steps:
                raise
            steps = min(_MORE * steps, settings.most_steps)
            continue
        is_last = is_cut and steps >= settings.most_steps
        yield motion, is_cut
        if is_last or (until is not None and not is_cut and time >= until):
            return
        if not is_cut and time >= longest:
            longest = settles_at(motion, graph, wanted.section) or 0.0
            if longest <= time:
                return
        if not is_cut:
            time = min(_MORE * time, longest)
        steps = min(_MORE * steps, settings.most_steps)


def _rough(
    problem: Problem, graph: GraphDynamics, settings: SimulationSettings, error: float
) -> SimulationSettings:
    """Return the settings of a motion that has not settled, with the limits of its coordinates."""
    limits = {name: escape.beyond for name, escape in problem.escapes.items()}
    far = bounds_of(problem.state_names, problem.state_units, graph.n_q, limits)[: graph.n_q]
    return replace(
        settings,
        tolerance=Tolerance(
            relative=max(settings.tolerance.relative, error),
            absolute=max(settings.tolerance.absolute, error / 10),
        ),
        completion=ZenoExtrapolation(tolerance=error),
        far=tuple(far.tolist()),
    )


def _continued(
    graph: GraphDynamics,
    x: Vector,
    motion: Execution | None,
    until: float,
    steps: int,
    settings: SimulationSettings,
) -> tuple[Execution, bool]:
    """Return a motion up to a time or a number of steps, and whether the steps ended it.

    It goes on from its last event at a time of its own, after which the mode is known.
    """
    place = None if motion is None else _last_alone(motion)
    if motion is not None and place is not None:
        event = motion.events[place]
        mode = SectionMode.after(motion, orbit_event_name(event), event.time)
        if mode is not None:
            try:
                start = on_section(graph, state_after(event), mode)
                later, is_cut = simulated_at_most(
                    graph,
                    start,
                    until=until - event.time,
                    most_steps=steps,
                    settings=settings,
                    past=event.name if isinstance(event, SwitchEvent) else "",
                )
            except RunawayError:
                raise
            except (SimulationError, InputError):
                # A rough state may leave what it has to keep. From the start it does not.
                pass
            else:
                later = released_at_start(later, orbit_event_name(event))
                return _joined(motion, place, later), is_cut
    return simulated_at_most(graph, x, until=until, most_steps=steps, settings=settings)


def _last_alone(motion: Execution) -> int | None:
    """Return the index of the last event but one in a mode of its own, if there is one."""
    times = [event.time for event in motion.events]
    for k in range(len(times) - 1, 0, -1):
        alone = times[k] > times[k - 1] and (k + 1 == len(times) or times[k + 1] > times[k])
        if alone and times[k] < motion.end_time:
            return k
    return None


def _joined(motion: Execution, place: int, later: Execution) -> Execution:
    """Return a motion up to an event, and on by the motion from there."""
    since = motion.events[place].time
    arcs = [
        replace(arc, start_time=arc.start_time + since, end_time=arc.end_time + since)
        for arc in later.arcs
    ]
    events = [replace(event, time=event.time + since) for event in later.events]
    return replace(
        motion,
        arcs=(*(arc for arc in motion.arcs if arc.end_time <= since), *arcs),
        events=(*motion.events[: place + 1], *events),
    )


def _closed(
    graph: GraphDynamics,
    motion: Execution,
    wanted: Wanted,
    settings: SimulationSettings,
    *,
    is_early: bool,
) -> EventReturn:
    """Return the periodic return near the end of a motion."""
    section = wanted.section
    if section is None and wanted.changing:
        section = _fixed_event(graph, motion, wanted.changing)
    limits = {"within": _EARLY} if is_early else {}
    sequence = None if wanted.shape is None else events_of_shape(wanted.shape)
    try:
        near = near_return(motion, graph, section, sequence=sequence, **limits)
    except UnsettledError:
        if wanted.shape is None:
            raise
        _require_shape(
            graph,
            _closed(graph, motion, replace(wanted, shape=None), settings, is_early=is_early),
            wanted.shape,
        )
        raise
    found = closed_return(
        graph,
        near.state,
        section=near.section,
        n_returns=near.n_returns,
        guess=near.period,
        settings=settings,
        mode=near.mode,
        by_returns=True,
    )
    shortest = shortest_return(graph, found, settings)
    if wanted.shape is not None:
        _require_shape(graph, shortest, wanted.shape)
    return shortest


def _require_shape(graph: GraphDynamics, found: EventReturn, wanted: EventSequence) -> None:
    """Refuse an orbit of another shape than requested."""
    shape = shape_of_events(found.events, is_plastic=graph.first.restitution == 0.0)
    if shape is None or events_of_shape(shape) == events_of_shape(wanted):
        return
    reason = f"The motion settles to an orbit of shape `{shape.text}`"
    if shape in wanted.shorter:
        times = wanted.n_phases // shape.n_phases
        reason = f"The orbit of shape `{wanted.text}` is one of shape `{shape.text}`"
        reason += f", traversed {times} times"
    raise SimulationError(reason, time=found.period, state=tuple(found.start.tolist()))


def _comes_nearer(graph: GraphDynamics, motion: Execution, found: EventReturn) -> bool:
    """Return True if a motion is at an orbit, or nearer to it than one and two returns before.

    Beside an orbit that repels it, a motion may come nearer from one return to the next by turns.
    """
    names = [orbit_event_name(event) for event in found.events]
    marks = [event for event in motion.events if orbit_event_name(event) == names[-1]]
    states = np.array([state_after(one) for one in marks[-1 :: -names.count(names[-1])][:3]])
    scale = largest_states(found.execution.arcs, graph)
    away = np.max(np.abs(states - found.start) / scale, axis=1)
    if len(away) < 2 or not away[0] < np.min(away[1:]):
        return bool(away[0] < _THERE)
    if away[0] < _FAST * away[1] and (len(away) < 3 or away[1] < _HALF * away[2]):
        return True
    # Beside a flip, a motion first comes nearer to the orbit that repels it.
    try:
        return all(abs(value) <= 1.0 for value in multipliers_of_return(graph, found))
    except SimulationError:
        # Without a derivative, the approach alone decides.
        return True


def _decays(motion: Execution) -> bool:
    """Return True if the first impacts after releases become slower down to rest, on every stop."""
    speeds: dict[str, list[float]] = {}
    released = set[str]()
    for event in motion.events:
        if isinstance(event, Release):
            released.add(event.stop)
        elif isinstance(event, Impact) and event.stop in released:
            released.remove(event.stop)
            speeds.setdefault(event.stop, []).append(-event.approach_rate)
    return bool(speeds) and all(growth_of(each).dies_out for each in speeds.values())


def _many_steps(motion: Execution, settings: SimulationSettings) -> SimulationError:
    """Return the error of a motion that takes all steps without settling."""
    return UnsettledError(
        f"The motion does not settle to an orbit within {counted(settings.most_steps, 'step')}: "
        "simulate for a shorter time (`until`), or start nearer to an orbit (`start`)",
        time=motion.end_time,
        state=tuple(motion.end_state.tolist()),
    )


def _escaped(problem: Problem, error: RunawayError) -> SimulationError:
    """Return the error of a motion beyond a limit, in the words of the problem."""
    escape = problem.escapes.get(error.coordinate)
    phrase = error.reason if escape is None else escape.phrase
    return SimulationError(f"{phrase[0].upper()}{phrase[1:]}", time=error.time, state=error.state)


def _fixed_event(graph: GraphDynamics, motion: Execution, chosen: Sequence[int]) -> str | None:
    """Return a switch whose guard depends on the clock alone, and on no chosen parameter."""
    clock = graph.first.clock
    for event in motion.switches:
        switch = graph.switch_names.index(event.name)
        x, sides = np.asarray(event.state_minus), graph.open_mode[1]
        if (
            switch < graph.n_declared
            and graph.guards(((), sides), event.state_plus)[2][switch] > 0.0
        ):
            # A motion cannot start where a declared switch is still armed.
            continue
        gradient = graph.guard_gradient(switch, x, chosen, ((), graph.sides_at(x, sides)))
        rest = np.delete(gradient, list(clock))
        if clock and gradient.any() and not rest.any():
            return orbit_event_name(event)
    return None
