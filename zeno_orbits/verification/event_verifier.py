"""Check an orbit of a machine with several stops or switches by forward integration.

The problem is rebuilt from the orbit's parameters, and the motion is integrated over several
periods from the start state alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import SimulationError, ZenoOrbitsError, finite_number
from zeno_orbits.model import GraphDynamics, HybridDynamics, Problem, load_reference
from zeno_orbits.orbits import (
    EventQuantities,
    EventReturn,
    Multipliers,
    Orbit,
    caused_releases,
    derivative_of_return,
    estimated_errors,
    event_return,
    extrapolated,
    is_one_sided,
    multipliers_of_return,
    orbit_event_name,
    other_equations,
    phases_of_events,
    relaxed_tolerance,
    time_blur,
)
from zeno_orbits.simulation import (
    Arc,
    Execution,
    Impact,
    SimulationSettings,
    ZenoPoint,
    simulate,
    state_after,
    state_before,
)
from zeno_orbits.verification.certificate import DeltaCut, OrbitCertificate
from zeno_orbits.verification.claim import require_values
from zeno_orbits.verification.cross_checks import (
    Accumulation,
    PeriodEnergies,
    cut_order,
    delta_sweep,
    second_model,
)
from zeno_orbits.verification.event_energies import event_energies, is_balanced, struck_view
from zeno_orbits.verification.event_margins import event_margins
from zeno_orbits.verification.event_residuals import (
    Claimed,
    IntegratedPeriod,
    claimed,
    event_impact_laws,
    event_misses,
    guards_along,
    sizes_along,
)
from zeno_orbits.verification.integration import decisive, distance, error_by_repetition
from zeno_orbits.verification.residuals import escapes_of
from zeno_orbits.verification.second_net import sampled_guards
from zeno_orbits.verification.verifier import VerificationSettings
from zeno_orbits.work import Progress, silent

_STATES = 9
"""States of each arc at which two derivations of the model are compared."""
_BEYOND = 1e-3
"""Part of a period by which the integration goes on. The last guard falls by more than rounding."""
_SHORTER_TAIL = 1e-2
"""Factor on the speed to which impacts are resolved. The work in the tail is then as exact as the
flow: its error falls with the square of the speed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Observation:
    """The integrated orbit.

    Attributes:
        start: Claimed start, ``(n_x,)``.
        scale: Size of each state along the first period, ``(n_x,)``, empty without a period.
        periods: The periods, empty if the first one is not finished.
        arcs: All arcs.
        trouble: Reason for an early end, else empty.
        residuals: Residuals that belong to this integration.
        integration_error: Relative difference from an integration at a looser tolerance.
    """

    start: Vector
    scale: Vector
    periods: tuple[IntegratedPeriod, ...]
    arcs: tuple[Arc, ...]
    trouble: str
    residuals: Mapping[str, float]
    integration_error: float = math.inf


def verify_events(
    orbit: Orbit,
    problem: Problem,
    *,
    settings: VerificationSettings | None = None,
    dynamics: GraphDynamics | None = None,
    on_progress: Progress = silent,
) -> OrbitCertificate:
    """Return the certificate of an orbit given by its events.

    Args:
        orbit: The orbit. Its own certificate and multipliers are ignored.
        problem: Its problem.
        settings: Tolerance, number of periods and accuracy.
        dynamics: The machine to integrate. By default it is the problem's machine at the orbit's
            parameter values.
        on_progress: Called with the name of each stage as it begins.

    Raises:
        InputError: If the orbit does not fit the problem, or a time is not finite.
    """
    asked = settings or VerificationSettings()
    finite_number("period", orbit.period)
    require_values(orbit, problem)
    graph = dynamics or problem.graph_dynamics(orbit.values(problem))
    on_progress("integrating the orbit", None)
    said = [claimed(problem, event) for event in orbit.events]

    def observed(simulation: SimulationSettings) -> _Observation:
        return _observe(graph, orbit, problem, said, replace(asked, simulation=simulation))

    seen, simulation = decisive(observed, _worst, asked.simulation, asked.tolerance)
    settings = replace(asked, simulation=simulation)
    again = _CrossChecks()
    clauses = [other_equations(orbit.problem_digest, problem), _elastic(orbit, graph), seen.trouble]
    if seen.periods:
        again = _cross_checks(graph, orbit, problem, seen, settings, on_progress)
        clauses += [phrase for _, phrase in again.escapes.values()]
    on_progress("computing the multipliers", None)
    known = Multipliers.unknown()
    with suppress(ZenoOrbitsError):
        known = multipliers_of_events(orbit, problem, settings=settings, dynamics=graph)
    residuals = {**seen.residuals, **again.residuals}
    if known.spectral_radius >= 1.0:
        # Rounding errors grow along an unstable orbit, so later returns are meaningless.
        residuals.pop("drift", None)
        clauses.remove(seen.trouble)
        clauses += [] if seen.periods else [seen.trouble]
    errors = [one.limit_error for one in _of_kind(seen.periods, ZenoPoint)]
    return OrbitCertificate(
        tolerance=settings.tolerance,
        residuals={name: float(value) for name, value in residuals.items()},
        margins={name: float(value) for name, value in again.margins.items()},
        energies=again.energies,
        multipliers=known.values,
        multiplier_error=known.error,
        delta_sweep=again.sweep,
        delta_order=cut_order(again.sweep, seen.integration_error),
        integration_error=seen.integration_error,
        zeno_error=max(errors, default=0.0),
        period=seen.periods[0].end if seen.periods else math.nan,
        n_periods=settings.n_periods,
        model="derived",
        trouble="; ".join(clause for clause in clauses if clause),
        open_balance=not is_balanced(graph),
        events=orbit.sequence,
        quantities=again.quantities,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _CrossChecks:
    """Results that need the first period: residuals, margins, energies, truncations."""

    residuals: dict[str, float] = field(default_factory=dict[str, float])
    margins: Mapping[str, float] = field(default_factory=dict[str, float])
    energies: Mapping[str, float] = field(default_factory=dict[str, float])
    quantities: Mapping[str, tuple[float, float]] = field(
        default_factory=dict[str, tuple[float, float]]
    )
    sweep: tuple[DeltaCut, ...] = ()
    escapes: Mapping[str, tuple[float, str]] = field(default_factory=dict[str, tuple[float, str]])


def _cross_checks(
    graph: GraphDynamics,
    orbit: Orbit,
    problem: Problem,
    seen: _Observation,
    settings: VerificationSettings,
    on_progress: Progress,
) -> _CrossChecks:
    first, start, simulation = seen.periods[0], seen.start, settings.simulation
    period = first.end - first.start
    on_progress("sampling all guards", None)
    again = sampled_guards(graph, first.arcs, period)
    residuals = {name: max(size, seen.residuals[name]) for name, size in again.items()}
    on_progress("cutting the impact sequences", None)
    accumulations, enough = list(_accumulations(graph, first, seen.arcs)), settings.tolerance / 10.0
    sweep = delta_sweep(graph, accumulations, seen.scale, settings.cuts, simulation, enough)
    if sweep:
        residuals["delta_sweep"] = sweep[-1].error
    on_progress("integrating the powers", None)
    found = _energies(graph, orbit, start, simulation)
    if is_balanced(graph):
        residuals["energy_balance"] = found.imbalance if found else math.inf
    if problem.reference is not None and len(graph.stop_names) == 1:
        on_progress("comparing two derivations of the model", None)
        by_hand = load_reference(problem).dynamics(orbit.values(problem))
        residuals["second_model"] = second_model(by_hand, _on_branches(graph, first))
    states = np.concatenate([arc.flow_states[:, : len(start)] for arc in first.arcs])
    escapes = escapes_of(problem, np.max(np.abs(states), axis=0))
    if problem.escapes:
        residuals["escape"] = max((excess for excess, _ in escapes.values()), default=0.0)
    residuals["integration"] = seen.integration_error
    return _CrossChecks(
        residuals=residuals,
        margins=event_margins(graph, start, first.events, first.arcs, period),
        energies=found.values if found else {},
        quantities=_quantities(graph, first, start),
        sweep=sweep,
        escapes=escapes,
    )


def _accumulations(
    graph: GraphDynamics, period: IntegratedPeriod, arcs: Sequence[Arc]
) -> Iterator[Accumulation]:
    """Yield the impacts of a period that accumulate and are followed by contact.

    Args:
        graph: The graph of modes.
        period: The period.
        arcs: Its arcs and those after it.
    """
    for phase in phases_of_events([orbit_event_name(event) for event in period.events]):
        *before, zeno = (period.events[k] for k in phase)
        impacts = tuple(event for event in before if isinstance(event, Impact))
        if not isinstance(zeno, ZenoPoint) or not impacts or not zeno.last_speed:
            continue
        held = next((arc for arc in arcs if arc.start_time >= zeno.time and arc.duration), None)
        if held is not None and zeno.stop in held.closed:
            view = struck_view(graph, period.arcs, impacts[0])
            yield Accumulation(dynamics=view, impacts=impacts, contact=held)


def _on_branches(
    graph: GraphDynamics, period: IntegratedPeriod
) -> Iterator[tuple[HybridDynamics, Vector]]:
    """Yield the model on the branch of each arc, with states there."""
    for arc in period.arcs:
        if arc.trajectory is not None:
            times = np.linspace(arc.start_time, arc.end_time, _STATES)
            yield graph.view(((), arc.sides), 0), np.array([*arc.states_at(times), arc.end_state])


def _elastic(orbit: Orbit, graph: GraphDynamics) -> str:
    """Return a clause about a Zeno point at a stop whose restitution is 1, or an empty text."""
    for name, view in zip(graph.stop_names, graph.open_views, strict=False):
        if view.restitution == 1.0 and f"zeno {name}" in orbit.sequence:
            return f"elastic impacts have no Zeno point, but the orbit has the event `zeno {name}`"
    return ""


def _observe(
    graph: GraphDynamics,
    orbit: Orbit,
    problem: Problem,
    said: Sequence[Claimed],
    settings: VerificationSettings,
) -> _Observation:
    """Return the periods of an orbit with their residuals, and the error of the integration."""
    start = np.array(problem.state_vector(orbit.start_state))
    periods, arcs, trouble = _periods(graph, orbit, start, settings.simulation, settings.n_periods)
    residuals: dict[str, float] = dict.fromkeys(("events", "closure", "period"), math.inf)
    if not periods:
        nothing = np.zeros(0)
        return _Observation(
            start=start, scale=nothing, periods=(), arcs=(), trouble=trouble, residuals=residuals
        )
    first, scale = periods[0], sizes_along(periods[0], graph, problem)
    blur = time_blur(first.arcs, graph, orbit.period, scale)

    def beyond_rounding(miss: float) -> float:
        return max(0.0, miss - blur)

    residuals |= {
        "events": beyond_rounding(event_misses(graph, orbit, said, first, scale)),
        "closure": beyond_rounding(distance(first.state, start, scale)),
        "period": beyond_rounding(abs(first.end - orbit.period) / orbit.period),
        **event_impact_laws(graph, first),
        **guards_along(graph, first),
    }
    if len(periods) == settings.n_periods > 1:
        drift = max(distance(one.state, start, scale) for one in periods)
        residuals["drift"] = beyond_rounding(drift)

    def difference(looser: SimulationSettings) -> float:
        others, _, _ = _periods(graph, orbit, start, looser, 1)
        if not others:
            return math.inf
        later = abs(others[0].end - first.end) / first.end
        return max(distance(others[0].state, first.state, scale), later)

    error = error_by_repetition(difference, settings.simulation, settings.tolerance)
    return _Observation(
        start=start,
        scale=scale,
        periods=tuple(periods),
        arcs=arcs,
        trouble=trouble,
        residuals=residuals,
        integration_error=error,
    )


def _worst(seen: _Observation) -> float:
    return max(*seen.residuals.values(), seen.integration_error)


def _periods(
    graph: GraphDynamics,
    orbit: Orbit,
    start: Vector,
    settings: SimulationSettings,
    n_periods: int,
) -> tuple[list[IntegratedPeriod], tuple[Arc, ...], str]:
    """Return the integrated periods, all arcs, and the reason for an early end."""
    until = orbit.period * (n_periods + _BEYOND * n_periods)
    try:
        exact = replace(settings, completion=extrapolated(settings))
        execution = simulate(graph, start, until=until, settings=exact)
        trouble = ""
    except SimulationError as error:
        if error.execution is None:
            return [], (), str(error)
        execution, trouble = error.execution, str(error)
    periods = list(_split(execution, orbit.section, orbit.n_returns))
    return periods, execution.arcs, trouble


def _energies(
    graph: GraphDynamics, orbit: Orbit, start: Vector, settings: SimulationSettings
) -> PeriodEnergies | None:
    """Return the energies of one period, ``None`` if it is not finished.

    The powers inside a tail are interpolated. So impacts are resolved to a lower speed.
    """
    rule = extrapolated(settings)
    finer = replace(settings, completion=replace(rule, resolved=_SHORTER_TAIL * rule.resolved))
    periods, _, _ = _periods(graph, orbit, start, finer, 1)
    if not periods:
        return None
    one = periods[0]
    return event_energies(graph, one.arcs, one.events, start, one.state)


def _split(execution: Execution, section: str, n_returns: int) -> Iterator[IntegratedPeriod]:
    """Yield the periods of an execution, each ended by its n-th event of the section."""
    begin, count, first = 0.0, 0, 0
    for place, event in enumerate(execution.events):
        if orbit_event_name(event) != section or event.time <= begin:
            continue
        count += 1
        if count % n_returns == 0:
            yield IntegratedPeriod(
                events=execution.events[first : place + 1],
                opened=(opened := caused_releases(execution.events, place)),
                arcs=tuple(a for a in execution.arcs if begin <= a.start_time < event.time),
                start=begin,
                end=event.time,
                state=state_after(event),
            )
            begin, first = event.time, place + 1 + len(opened)


def _of_kind(periods: Sequence[IntegratedPeriod], kind: type[ZenoPoint]) -> list[ZenoPoint]:
    return [event for one in periods[:1] for event in one.events if isinstance(event, kind)]


def _quantities(
    graph: GraphDynamics, period: IntegratedPeriod, start: Vector
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
    orbit: Orbit,
    problem: Problem,
    *,
    settings: VerificationSettings | None = None,
    dynamics: GraphDynamics | None = None,
) -> Multipliers:
    """Return the multipliers of an orbit as `verify` computes them, without its other checks.

    Args:
        orbit: The orbit. Its own multipliers are ignored.
        problem: Its problem.
        settings: Accuracy.
        dynamics: The machine. By default it is the problem's machine at the orbit's values.

    Raises:
        InputError: If the orbit does not fit the problem.
        SimulationError: If the orbit does not return.
    """
    settings = settings or VerificationSettings()
    graph = dynamics or problem.graph_dynamics(orbit.values(problem))
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
