r"""Check an orbit of a machine with several stops or switches by forward integration.

The problem is rebuilt from the orbit's parameters, and the motion is integrated over several
periods from the start state alone. Laws are stated here again, by other formulas than those of the
simulator: the impulses of an impact follow from the changes of all gap rates,

.. math:: G\,p = \dot h^+ - \dot h^-, \qquad G = J W J^\top,

and the guards are sampled between the events.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError, ZenoOrbitsError, finite_number
from zeno_orbits.model import GraphDynamics, Problem
from zeno_orbits.orbits import (
    EventOrbit,
    EventQuantities,
    EventReturn,
    Multipliers,
    OrbitEvent,
    caused_releases,
    derivative_of_return,
    estimated_errors,
    event_return,
    events_as_listed,
    extrapolated,
    is_one_sided,
    largest_states,
    lasting_events,
    multipliers_of_return,
    orbit_event_name,
    other_equations,
    relaxed_tolerance,
    sequence_of,
    time_blur,
)
from zeno_orbits.simulation import (
    Arc,
    Event,
    Execution,
    Impact,
    Release,
    SimulationSettings,
    ZenoPoint,
    simulate,
    state_after,
    state_before,
)
from zeno_orbits.verification.certificate import OrbitCertificate
from zeno_orbits.verification.cross_checks import PeriodEnergies
from zeno_orbits.verification.event_energies import (
    event_energies,
    is_balanced,
    kept_stops,
    struck_view,
)
from zeno_orbits.verification.event_margins import event_margins
from zeno_orbits.verification.integration import decisive, error_by_repetition
from zeno_orbits.verification.verifier import VerificationSettings
from zeno_orbits.work import Progress, silent

_SAMPLES = 24
"""Samples of every arc, in addition to the steps of the integrator."""
_BEYOND = 1e-3
"""Part of a period by which the integration goes on. The last guard falls by more than rounding."""
_NO_SWEEP = math.nan
_SHORTER_TAIL = 1e-2
"""Factor on the speed to which impacts are resolved. The work in the tail is then as exact as the
flow: its error falls with the square of the speed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Period:
    """One integrated period.

    Attributes:
        events: Its events.
        opened: Releases that its last event causes, at the start of the next period.
        arcs: Its arcs.
        start: When it starts [s].
        end: When it ends [s].
        state: State just after its last event, ``(n_x,)``.
    """

    events: tuple[Event, ...]
    opened: tuple[Release, ...]
    arcs: tuple[Arc, ...]
    start: float
    end: float
    state: Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class _Observation:
    """The integrated orbit.

    Attributes:
        periods: The periods, empty if the first one is not finished.
        trouble: Reason for an early end, else empty.
        residuals: Residuals that belong to this integration.
        integration_error: Relative difference from an integration at a looser tolerance.
    """

    periods: tuple[_Period, ...]
    trouble: str
    residuals: Mapping[str, float]
    integration_error: float = math.inf


def verify_events(
    orbit: EventOrbit,
    problem: Problem,
    *,
    settings: VerificationSettings | None = None,
    on_progress: Progress = silent,
) -> OrbitCertificate:
    """Return the certificate of an orbit given by its events.

    Args:
        orbit: The orbit. Its own certificate and multipliers are ignored.
        problem: Its problem.
        settings: Tolerance, number of periods and accuracy.
        on_progress: Called with the name of each stage as it begins.

    Raises:
        InputError: If the orbit does not fit the problem, or a time is not finite.
    """
    settings = settings or VerificationSettings()
    finite_number("period", orbit.period)
    graph = problem.graph_dynamics(orbit.values(problem))
    start = np.array(problem.state_vector(orbit.start_state))
    on_progress("integrating the orbit", None)
    said = [_said(problem, event) for event in orbit.events]

    def observed(simulation: SimulationSettings) -> _Observation:
        return _observe(graph, orbit, start, said, replace(settings, simulation=simulation))

    seen, simulation = decisive(observed, _worst, settings.simulation, settings.tolerance)
    periods, trouble, residuals = seen.periods, seen.trouble, dict(seen.residuals)
    margins: dict[str, float] = {}
    quantities: dict[str, tuple[float, float]] = {}
    energies: Mapping[str, float] = {}
    if periods:
        first = periods[0]
        margins = event_margins(graph, start, first.events, first.arcs, first.end - first.start)
        quantities = _quantities(graph, first, start)
        on_progress("integrating the powers", None)
        found = _energies(graph, orbit, start, simulation)
        energies = found.values if found else {}
        if is_balanced(graph):
            residuals["energy_balance"] = found.imbalance if found else math.inf
        residuals["integration"] = seen.integration_error
    on_progress("computing the multipliers", None)
    known = Multipliers.unknown()
    with suppress(ZenoOrbitsError):
        known = multipliers_of_events(orbit, problem, settings=settings)
    if known.spectral_radius >= 1.0:
        residuals.pop("drift", None)
        trouble = "" if periods else trouble
    trouble = other_equations(orbit.problem_digest, problem) or _elastic(orbit, graph) or trouble
    errors = [one.limit_error for one in _of_kind(periods, ZenoPoint)]
    return OrbitCertificate(
        tolerance=settings.tolerance,
        residuals={name: float(value) for name, value in residuals.items()},
        margins={name: float(value) for name, value in margins.items()},
        energies=energies,
        multipliers=known.values,
        multiplier_error=known.error,
        delta_sweep=(),
        delta_order=_NO_SWEEP,
        integration_error=seen.integration_error,
        zeno_error=max(errors, default=0.0),
        period=periods[0].end if periods else math.nan,
        n_periods=settings.n_periods,
        model="derived",
        trouble=trouble,
        open_balance=not is_balanced(graph),
        events=orbit.sequence,
        quantities=quantities,
    )


def _elastic(orbit: EventOrbit, graph: GraphDynamics) -> str:
    """Return a clause about a Zeno point at a stop whose restitution is 1, or an empty text."""
    for name, view in zip(graph.stop_names, graph.open_views, strict=False):
        if view.restitution == 1.0 and f"zeno {name}" in orbit.sequence:
            return f"elastic impacts have no Zeno point, but the orbit has the event `zeno {name}`"
    return ""


def _observe(
    graph: GraphDynamics,
    orbit: EventOrbit,
    start: Vector,
    said: Sequence[tuple[str, float, Vector]],
    settings: VerificationSettings,
) -> _Observation:
    """Return the periods of an orbit with their residuals, and the error of the integration."""
    periods, trouble = _periods(graph, orbit, start, settings.simulation, settings.n_periods)
    residuals: dict[str, float] = dict.fromkeys(("events", "closure", "period"), math.inf)
    if not periods:
        return _Observation(periods=(), trouble=trouble, residuals=residuals)
    first, scale = periods[0], largest_states(periods[0].arcs, graph)
    blur = time_blur(first.arcs, graph, orbit.period)

    def beyond_rounding(miss: float) -> float:
        return max(0.0, miss - blur)

    residuals |= {
        "events": beyond_rounding(_miss(orbit, said, first, scale)),
        "closure": beyond_rounding(_distance(first.state, start, scale)),
        "period": beyond_rounding(abs(first.end - orbit.period) / orbit.period),
        **_impact_laws(graph, first),
        **_sampled(graph, first),
    }
    if len(periods) == settings.n_periods > 1:
        drift = max(_distance(one.state, start, scale) for one in periods)
        residuals["drift"] = beyond_rounding(drift)

    def difference(looser: SimulationSettings) -> float:
        others, _ = _periods(graph, orbit, start, looser, 1)
        if not others:
            return math.inf
        later = abs(others[0].end - first.end) / first.end
        return max(_distance(others[0].state, first.state, scale), later)

    error = error_by_repetition(difference, settings.simulation, settings.tolerance)
    return _Observation(
        periods=tuple(periods), trouble=trouble, residuals=residuals, integration_error=error
    )


def _worst(seen: _Observation) -> float:
    return max(*seen.residuals.values(), seen.integration_error)


def _periods(
    graph: GraphDynamics,
    orbit: EventOrbit,
    start: Vector,
    settings: SimulationSettings,
    n_periods: int,
) -> tuple[list[_Period], str]:
    """Return the integrated periods, and the reason for an early end."""
    until = orbit.period * (n_periods + _BEYOND * n_periods)
    try:
        exact = replace(settings, completion=extrapolated(settings))
        execution = simulate(graph, start, until=until, settings=exact)
        trouble = ""
    except SimulationError as error:
        if error.execution is None:
            return [], str(error)
        execution, trouble = error.execution, str(error)
    return list(_split(execution, orbit.section, orbit.n_returns)), trouble


def _energies(
    graph: GraphDynamics, orbit: EventOrbit, start: Vector, settings: SimulationSettings
) -> PeriodEnergies | None:
    """Return the energies of one period, ``None`` if it is not finished.

    The powers inside a tail are interpolated. So impacts are resolved to a lower speed.
    """
    rule = extrapolated(settings)
    finer = replace(settings, completion=replace(rule, resolved=_SHORTER_TAIL * rule.resolved))
    periods, _ = _periods(graph, orbit, start, finer, 1)
    if not periods:
        return None
    one = periods[0]
    return event_energies(graph, one.arcs, one.events, start, one.state)


def _split(execution: Execution, section: str, n_returns: int) -> Iterator[_Period]:
    """Yield the periods of an execution, each ended by its n-th event of the section."""
    begin, count, first = 0.0, 0, 0
    for place, event in enumerate(execution.events):
        if orbit_event_name(event) != section or event.time <= begin:
            continue
        count += 1
        if count % n_returns == 0:
            yield _Period(
                events=execution.events[first : place + 1],
                opened=(opened := caused_releases(execution.events, place)),
                arcs=tuple(a for a in execution.arcs if begin <= a.start_time < event.time),
                start=begin,
                end=event.time,
                state=state_after(event),
            )
            begin, first = event.time, place + 1 + len(opened)


def _said(problem: Problem, event: OrbitEvent) -> tuple[str, float, Vector]:
    state = np.array(problem.state_vector(event.state))
    return event.name, finite_number("time", event.time), state


def _miss(
    orbit: EventOrbit,
    said: Sequence[tuple[str, float, Vector]],
    first: _Period,
    scale: Vector,
) -> float:
    """Return the largest deviation of an event, infinite if the event sequence differs.

    Kinks in the flights of impacts that accumulate do not belong to the event sequence.
    """
    seen = [
        (orbit_event_name(event), event.time - first.start, np.asarray(state_before(event)))
        for event in events_as_listed(first.events, orbit.sequence)
    ]
    kept, listed = (
        [events[k] for k in lasting_events([name for name, _, _ in events])]
        for events in (seen, said)
    )
    if sequence_of([name for name, _, _ in seen]) != orbit.sequence or len(kept) != len(listed):
        return math.inf
    return max(
        max(abs(time - t) / orbit.period, _distance(x, y, scale)) if name == other else math.inf
        for (name, time, x), (other, t, y) in zip(kept, listed, strict=True)
    )


def _distance(x: Vector, y: Vector, scale: Vector) -> float:
    return float(np.max(np.abs(x - y) / scale))


def _of_kind(periods: Sequence[_Period], kind: type[ZenoPoint]) -> list[ZenoPoint]:
    return [event for one in periods[:1] for event in one.events if isinstance(event, kind)]


def _impact_laws(graph: GraphDynamics, period: _Period) -> dict[str, float]:
    """Return the deviations of impacts from Newton's law, and the largest pull of a stop."""
    impacts = [event for event in period.events if isinstance(event, Impact)]
    if not impacts:
        return {}
    fastest = max(abs(impact.approach_rate) for impact in impacts)
    turn = pull = 0.0
    n = len(graph.stop_names)
    for impact in impacts:
        stop = graph.stop_names.index(impact.stop)
        e = struck_view(graph, period.arcs, impact).restitution
        before, after = (
            np.array([graph.view(graph.open_mode, k).gap_rate(x) for k in range(n)])
            for x in (impact.state_minus, impact.state_plus)
        )
        turn = max(turn, abs(after[stop] + e * impact.approach_rate) / fastest)
        impulses = _impulses(graph, period, impact, after - before)
        largest = float(np.max(np.abs(impulses)))
        if largest > 0.0 and np.linalg.matrix_rank(graph.delassus(impact.state_minus)) == n:
            pull = max(pull, float(np.max(-impulses)) * abs(impact.approach_rate) / largest)
    return {"restitution": turn, "impulses": pull / fastest}


def _impulses(graph: GraphDynamics, period: _Period, impact: Impact, change: Vector) -> Vector:
    """Return the impulses of all stops that change the gap rates as an impact does.

    The current layer of a corrected drive lasts too long to open a stop that a force holds closed.
    A stop that stays closed then has its impulse by the masses alone.
    """
    x, k = impact.state_minus, graph.stop_names.index(impact.stop)
    impulses: Vector = np.linalg.lstsq(graph.delassus(x), change, rcond=1e-9)[0].astype(np.float64)
    if graph.has_current_layers:
        kept, _ = graph.mode_of(kept_stops(graph, period.arcs, impact), ())
        coupling = graph.coupling(x)
        share = np.linalg.solve(coupling[np.ix_(kept, kept)], coupling[list(kept), k])
        impulses[list(kept)] = -share * impulses[k]
    return impulses


def _sampled(graph: GraphDynamics, period: _Period) -> dict[str, float]:
    """Return the largest violation of gaps, multipliers and switches between the events."""
    lowest = adhesion = crossed = constraints = 0.0
    depth, force = 1e-300, 1e-300
    for arc in period.arcs:
        if arc.trajectory is None:
            continue
        closed, sides = graph.mode_of(arc.closed, arc.sides)
        n_x, span = len(arc.start_state), arc.end_time - arc.start_time
        times = np.linspace(0.0, span, _SAMPLES + 2)[1:-1]
        states = [*arc.flow_states[1:-1, :n_x], *arc.states_at(arc.start_time + times)]
        for x in states:
            for k in range(len(graph.stop_names)):
                if k not in closed:
                    gap = graph.view(graph.open_mode, k).gap(x)
                    lowest, depth = min(lowest, gap), max(depth, gap)
                else:
                    pressed = graph.holding((closed, sides), k).multiplier(x)
                    adhesion, force = min(adhesion, pressed), max(force, pressed)
            crossed = max(crossed, _wrong_side(graph, arc, x))
        held = graph.first.holonomic(arc.end_state)
        constraints = max([constraints, *np.abs(held).tolist()])
    found = {"penetration": abs(lowest) / depth, "adhesion": abs(adhesion) / force}
    if graph.switch_names:
        found["switches"] = crossed
    if len(graph.first.holonomic(period.state)):
        found["holonomic"] = constraints
    return found


def _wrong_side(graph: GraphDynamics, arc: Arc, x: Vector) -> float:
    """Return by how much a state of an arc is on the wrong side of a kink, in its size."""
    guards, rounding, _ = graph.guards(x, arc.sides)
    n = graph.n_declared
    wrong = [
        abs(float(guards[n + k])) / max(float(rounding[n + k]) * 1e12, 1e-300)
        for k, side in enumerate(arc.sides)
        if (guards[n + k] > 0.0) != side
    ]
    return max(wrong, default=0.0)


def _quantities(
    graph: GraphDynamics, period: _Period, start: Vector
) -> dict[str, tuple[float, float]]:
    """Return the range of each quantity of the events of the first period."""
    found = EventQuantities(
        graph=graph,
        start=start,
        period=period.end - period.start,
        events=(*period.events, *period.opened),
    )
    return {name: (one.lowest, one.highest) for name, one in found.table().items()}


_LEAST = 1e-12
"""Least error of a multiplier, because two computations may agree by chance."""


def multipliers_of_events(
    orbit: EventOrbit, problem: Problem, *, settings: VerificationSettings | None = None
) -> Multipliers:
    """Return the multipliers of an orbit as `verify` computes them, without its other checks.

    Args:
        orbit: The orbit. Its own multipliers are ignored.
        problem: Its problem.
        settings: Accuracy.

    Raises:
        InputError: If the orbit does not fit the problem.
        SimulationError: If the orbit does not return.
    """
    settings = settings or VerificationSettings()
    graph = problem.graph_dynamics(orbit.values(problem))
    start = np.array(problem.state_vector(orbit.start_state))

    def returned(state: Vector, accuracy: SimulationSettings) -> EventReturn:
        return event_return(
            graph,
            state,
            section=orbit.section,
            n_returns=orbit.n_returns,
            guess=orbit.period,
            settings=accuracy,
        )

    found, next_one = returned(start, settings.simulation), None
    with suppress(ZenoOrbitsError):
        next_one = returned(found.end, relaxed_tolerance(settings.simulation))
    values = multipliers_of_return(graph, found)
    others = () if next_one is None else multipliers_of_return(graph, next_one)
    event, section, jacobian = derivative_of_return(graph, found)
    errors = estimated_errors(values, others, _LEAST)
    if is_one_sided(graph, found) or _meets_a_root(graph, found):
        errors = (math.inf,) * max(1, len(values))
    return Multipliers(
        values=values,
        errors=errors,
        jacobian=jacobian,
        section=section,
        event=event,
    )


def _meets_a_root(graph: GraphDynamics, found: EventReturn) -> bool:
    """Return True if a root of a formula has an infinite derivative at an event."""
    states = (x for event in found.events for x in (state_before(event), state_after(event)))
    return any(map(graph.has_infinite_slope, states))
