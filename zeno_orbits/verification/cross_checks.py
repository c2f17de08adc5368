"""Checks of an orbit by other means: truncated impact sequences, and a second model."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.model import GraphDynamics, HybridDynamics
from zeno_orbits.orbits import orbit_event_name, phases_of_events
from zeno_orbits.simulation import (
    Arc,
    Impact,
    SimulationSettings,
    Truncation,
    ZenoPoint,
    simulate,
)
from zeno_orbits.verification.certificate import DeltaCut
from zeno_orbits.verification.energies import struck_view
from zeno_orbits.verification.integration import Period, distance

_FINEST_CUT = 1e-9
"""Smallest threshold of a sweep, relative to the first impact speed."""

_FALL = 2.0
"""Least factor by which the error must decrease for a finer truncation. It is 1000 in theory."""

_STATES = 41
"""Times of a period at which two derivations of the model are compared, beside the events."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Accumulation:
    """Impacts that accumulate, and the contact phase after them.

    Attributes:
        dynamics: The system of their stop, in which closed stops are constraints.
        impacts: The resolved impacts.
        contact: The first arc of the contact phase, which takes time.
        sets: Whether states are set at the Zeno point.
    """

    dynamics: HybridDynamics
    impacts: tuple[Impact, ...]
    contact: Arc
    sets: bool

    @property
    def middle(self) -> float:
        """Time of the middle of the contact phase [s]."""
        return (self.contact.start_time + self.contact.end_time) / 2

    def last_common_impact(self, delta: float) -> Impact:
        """Return the last impact up to which a motion truncated below a speed is equal."""
        slow = (impact for impact in self.impacts if abs(impact.approach_rate) < delta)
        return next(slow, self.impacts[-1])


def accumulations_of(
    graph: GraphDynamics, period: Period, arcs: Sequence[Arc]
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
        if held is not None and graph.stop_names.index(zeno.stop) in held.mode_in(graph)[0]:
            view = struck_view(graph, period, impacts[0])
            sets = graph.setter_at(orbit_event_name(zeno)) is not None
            yield Accumulation(dynamics=view, impacts=impacts, contact=held, sets=sets)


def delta_sweep(
    machine: GraphDynamics,
    accumulations: Sequence[Accumulation],
    scale: Vector,
    cuts: Sequence[float],
    simulation: SimulationSettings,
    enough: float,
) -> tuple[DeltaCut, ...]:
    """Truncate the sequence by the paper's rule at decreasing thresholds.

    Each truncated motion is compared with the completed motion in the contact phase. It is
    integrated from the last impact that both motions have.

    A truncation shifts the time of the Zeno point, in first order in the last speed. If states are
    set there, each motion is extrapolated to the speed zero with the truncation before it.

    Args:
        machine: The machine.
        accumulations: The accumulations of a period, completed by the extrapolated limit.
        scale: Size of each state over the period, ``(n_x,)``.
        cuts: Thresholds in units of the first impact speed, decreasing.
        simulation: Accuracy.
        enough: Sufficiently small error. Truncations continue, each at a tenth of the speed, while
            the last error is larger than this and the errors decrease. If the contact phase is
            short, the cubic error is large.

    Returns:
        One entry per threshold, for the accumulation with the largest last error. Empty if impacts
        do not accumulate.
    """
    sweeps = [_sweep_of(machine, one, scale, cuts, simulation, enough) for one in accumulations]
    return max(sweeps, key=lambda sweep: sweep[-1].error, default=())


def _sweep_of(
    machine: GraphDynamics,
    one: Accumulation,
    scale: Vector,
    cuts: Sequence[float],
    simulation: SimulationSettings,
    enough: float,
) -> tuple[DeltaCut, ...]:
    fastest = abs(one.impacts[0].approach_rate)
    found: list[DeltaCut] = []
    ends: list[tuple[float, Vector]] = []
    deltas = [share * fastest for share in cuts]
    while deltas:
        delta = deltas.pop(0)
        speed, end = _cut(machine, one, delta, simulation)
        ends.append((speed, end))
        if one.sets and len(ends) > 1:
            end = _extrapolated(*ends[-2:])
        away = distance(end, one.contact.state_at(one.middle), scale)
        error = away if math.isfinite(away) else math.inf
        found.append(DeltaCut(delta=delta, speed=speed, error=error))
        falls = len(found) > 1 and enough < error < found[-2].error / _FALL
        if not deltas and falls and delta > 10.0 * _FINEST_CUT * fastest:
            deltas = [delta / 10.0]
    return tuple(found)


def _extrapolated(coarse: tuple[float, Vector], fine: tuple[float, Vector]) -> Vector:
    """Return the state at the last speed zero, by a line through two truncations."""
    (fast, far), (slow, near) = coarse, fine
    return near if not slow < fast else near + (near - far) * slow / (fast - slow)


def _cut(
    machine: GraphDynamics,
    one: Accumulation,
    delta: float,
    simulation: SimulationSettings,
) -> tuple[float, Vector]:
    """Return the last speed of a motion truncated below a speed, and its state in the contact."""
    before = one.last_common_impact(delta)
    start = one.dynamics.on_stop(before.state_minus)
    start = start + before.approach_rate * one.dynamics.impulse_direction(start)
    rule = replace(simulation, completion=Truncation(delta=delta))
    try:
        run = simulate(machine, start, until=one.middle - before.time, settings=rule)
    except ZenoOrbitsError:
        return math.nan, np.full(start.size, math.nan)
    last = run.impacts[-1] if run.impacts else before
    return abs(last.approach_rate), run.end_state


def cut_order(sweep: tuple[DeltaCut, ...], noise: float) -> float:
    """Return the order of the error in the speed, over the errors above rounding and noise.

    Args:
        sweep: The truncations.
        noise: Error of the integration.
    """
    floor = max(1e-12, noise)
    usable = [cut for cut in sweep if floor < cut.error < math.inf]
    if len({cut.speed for cut in usable}) < 2:
        return math.nan
    speeds = np.log([cut.speed for cut in usable])
    errors = np.log([cut.error for cut in usable])
    return float(np.polyfit(speeds, errors, 1)[0])


def second_model(by_hand: HybridDynamics, graph: GraphDynamics, period: Period) -> float:
    """Return the largest relative difference of two derivations of a model along an orbit.

    Args:
        by_hand: The hand-written model at the values of the orbit.
        graph: The derived model, which is compared on the branch of every arc.
        period: A period of the orbit.
    """
    times = np.linspace(period.start, period.end, _STATES)
    states: dict[tuple[bool, ...], list[Vector]] = {}
    for arc in period.arcs:
        if arc.trajectory is not None:
            inside = times[(times >= arc.start_time) & (times <= arc.end_time)]
            along = states.setdefault(arc.sides, [])
            along += [arc.end_state[None, :], *([arc.states_at(inside)] if inside.size else [])]
    return max(
        _between(by_hand, graph.view(((), sides), 0), np.concatenate(along))
        for sides, along in states.items()
    )


def _between(by_hand: HybridDynamics, derived: HybridDynamics, free: Vector) -> float:
    rested = np.array([derived.on_stop(x) for x in free])

    def gap_between(quantity: Callable[[HybridDynamics], Vector]) -> float:
        one, other = quantity(by_hand), quantity(derived)
        size = np.max(np.abs(other), axis=0)
        return float(np.max(np.abs(one - other) / np.where(size > 0.0, size, 1.0)))

    return max(
        gap_between(lambda d: d.free.rates(free)),
        gap_between(lambda d: d.locked.rates(rested)),
        gap_between(lambda d: np.array([d.reset_map(x, d.gap_rate(x)) for x in free])),
        gap_between(lambda d: np.array([[d.gap_acceleration(x), d.multiplier(x)] for x in rested])),
        gap_between(lambda d: np.array([[d.energy(x), d.normal_inertia(x)] for x in free])),
    )
