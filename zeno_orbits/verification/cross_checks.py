"""Checks of an orbit by further integrations: truncations, energies, a second model."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.model import GraphDynamics, HybridDynamics, Problem, with_energy_ledger
from zeno_orbits.orbits import Cycle, Orbit, place_on_section
from zeno_orbits.simulation import (
    Arc,
    Impact,
    SimulationSettings,
    Truncation,
    ZenoPassage,
    simulate,
)
from zeno_orbits.verification.certificate import DeltaCut
from zeno_orbits.verification.claim import Claim
from zeno_orbits.verification.integration import distance
from zeno_orbits.verification.residuals import lawful_impact

_FINEST_CUT = 1e-9
"""Smallest threshold of a sweep, relative to the first impact speed."""

_FALL = 2.0
"""Least factor by which the error must decrease for a finer truncation. It is 1000 in theory."""

_LATER = 1.001
"""Factor on the period by which an integration may take longer, because of its error."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Accumulation:
    """Impacts that accumulate, and the contact phase after them.

    Attributes:
        dynamics: The system of their stop, in which closed stops are constraints.
        impacts: The resolved impacts.
        contact: The first arc of the contact phase, which takes time.
    """

    dynamics: HybridDynamics
    impacts: tuple[Impact, ...]
    contact: Arc

    def last_common_impact(self, delta: float) -> Impact:
        """Return the last impact up to which a motion truncated below a speed is equal."""
        slow = (impact for impact in self.impacts if abs(impact.approach_rate) < delta)
        return next(slow, self.impacts[-1])


def delta_sweep(
    machine: HybridDynamics | GraphDynamics,
    accumulations: Sequence[Accumulation],
    scale: Vector,
    cuts: Sequence[float],
    simulation: SimulationSettings,
    enough: float,
) -> tuple[DeltaCut, ...]:
    """Truncate the sequence by the paper's rule at decreasing thresholds.

    Each truncated motion is compared with the completed motion in the contact phase. It is
    integrated from the last impact that both motions have.

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
    machine: HybridDynamics | GraphDynamics,
    one: Accumulation,
    scale: Vector,
    cuts: Sequence[float],
    simulation: SimulationSettings,
    enough: float,
) -> tuple[DeltaCut, ...]:
    fastest = abs(one.impacts[0].approach_rate)
    found = [_cut(machine, one, scale, share * fastest, simulation) for share in cuts]
    while (
        len(found) > 1
        and enough < found[-1].error < found[-2].error / _FALL
        and found[-1].delta > 10.0 * _FINEST_CUT * fastest
    ):
        found.append(_cut(machine, one, scale, found[-1].delta / 10.0, simulation))
    return tuple(found)


def _cut(
    machine: HybridDynamics | GraphDynamics,
    one: Accumulation,
    scale: Vector,
    delta: float,
    simulation: SimulationSettings,
) -> DeltaCut:
    """Return the error in the middle of the contact phase of a motion truncated below a speed."""
    when = (one.contact.start_time + one.contact.end_time) / 2
    before = one.last_common_impact(delta)
    start = one.dynamics.on_stop(before.state_minus)
    start = start + before.approach_rate * one.dynamics.impulse_direction(start)
    rule = replace(simulation, completion=Truncation(delta=delta))
    try:
        run = simulate(machine, start, until=when - before.time, settings=rule)
    except ZenoOrbitsError:
        return DeltaCut(delta=delta, speed=math.nan, error=math.inf)
    last = run.impacts[-1] if run.impacts else before
    error = distance(run.end_state, one.contact.state_at(when), scale)
    return DeltaCut(delta=delta, speed=abs(last.approach_rate), error=error)


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


@dataclass(frozen=True, slots=True, kw_only=True)
class PeriodEnergies:
    """Energies of one period [J].

    Attributes:
        values: Energy by name, as in the certificate.
        largest: The largest kinetic energy, or the integral of the modulus of a power if it is
            larger. Net energies may vanish: a conservative machine loses nothing.
    """

    values: Mapping[str, float]
    largest: float

    @property
    def imbalance(self) -> float:
        """Defect of the energy balance (theory (2.5)), relative to the largest energy."""
        spent = sum(value for name, value in self.values.items() if name != "input_work")
        size = max(self.largest, *map(abs, self.values.values()))
        return abs(self.values["input_work"] - spent) / size if size > 0.0 else 0.0


def largest_kinetic(dynamics: HybridDynamics, arcs: Sequence[Arc]) -> float:
    """Return the largest kinetic energy at the steps of arcs [J].

    It is the part of the energy that vanishes with the velocities.

    Args:
        dynamics: The system.
        arcs: The arcs. Their states begin with the states of the system.
    """
    largest = 0.0
    for arc in arcs:
        for x in arc.flow_states[:, : len(arc.start_state)]:
            still = x.copy()
            still[dynamics.n_q : 2 * dynamics.n_q] = 0.0
            largest = max(largest, dynamics.energy(x) - dynamics.energy(still))
    return largest


def energies_of(
    orbit: Orbit,
    problem: Problem,
    claim: Claim,
    cycle: Cycle,
    simulation: SimulationSettings,
) -> PeriodEnergies:
    """Return the energies of one period, from an integration together with the powers.

    Args:
        orbit: The orbit.
        problem: Its problem.
        claim: The orbit as claimed.
        cycle: The first period.
        simulation: Accuracy.
    """
    values = orbit.values(problem)
    unit = problem.dynamics(values).own.energy
    dynamics = problem.dynamics(values, with_energy_ledger(unit))
    if isinstance(simulation.completion, ZenoPassage):
        # Each impact dissipates its own part. Only a short tail is estimated from the last speed.
        simulation = replace(simulation, completion=simulation.completion.one_by_one)
    start = place_on_section(dynamics, claim.shape, np.concatenate([claim.start, np.zeros(3)]))
    last = None if claim.shape.starts_at_release else len(cycle.impacts)
    # An impact at the end of the period is counted, even if the end time is slightly earlier.
    until = cycle.end.time if last is None else _LATER * cycle.end.time
    run = simulate(dynamics, start, until=until, impacts=last, settings=simulation)
    impact_loss = 0.0
    for impact in run.impacts:
        impact_loss += lawful_impact(dynamics, impact)[1]
        impact_loss -= _stored(dynamics, impact.state_minus, impact.state_plus)
    for zeno in run.zeno_points:
        # The tail dissipates all remaining normal kinetic energy, like a plastic impact.
        impact_loss += dynamics.normal_inertia(zeno.state) * zeno.last_speed**2 / 2
        departing = zeno.state + zeno.last_speed * dynamics.impulse_direction(zeno.state)
        impact_loss -= _stored(dynamics, departing, zeno.state)
    end = run.end_state if last is None else run.impacts[-1].state_plus
    found = {
        "input_work": unit * float(end[-3]),
        "copper_loss": unit * float(end[-2]),
        "other_loss": unit * float(end[-1]),
        "impact_loss": impact_loss,
        "energy_gain": dynamics.energy(end) - dynamics.energy(start),
    }
    n_x = len(start)
    moved = [
        np.abs(np.diff(arc.flow_states[:, n_x - 3 : n_x], axis=0)).sum(axis=0) for arc in run.arcs
    ]
    gross = unit * float(np.max(np.sum(moved, axis=0)))
    return PeriodEnergies(values=found, largest=max(largest_kinetic(dynamics, run.arcs), gross))


def _stored(dynamics: HybridDynamics, before: Vector, after: Vector) -> float:
    """Return the energy added by a change of circuit states and further states [J]."""
    first = 2 * dynamics.n_q
    changed = before.copy()
    changed[first:] = after[first:]
    return dynamics.energy(changed) - dynamics.energy(before)


def second_model(
    by_hand: HybridDynamics, derived: Iterable[tuple[HybridDynamics, Vector]]
) -> float:
    """Return the largest relative difference of two derivations of a model along an orbit.

    Args:
        by_hand: The hand-written model at the values of the orbit.
        derived: The derived model on each branch of its kinks, with states there, ``(n, n_x)``.
    """
    return max(_between(by_hand, model, free) for model, free in derived)


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
