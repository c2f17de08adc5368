"""Checks of an orbit that integrate it again, in another way: cuts, energies, a second model."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.model import HybridDynamics, Problem, audited_in, load_reference
from zeno_orbits.orbits import Cycle, Phase, PhaseKind, ZenoOrbit, placed
from zeno_orbits.simulation import Impact, SimulationSettings, Truncation, ZenoPassage, simulate
from zeno_orbits.verification.certificate import DeltaCut
from zeno_orbits.verification.claim import Claim
from zeno_orbits.verification.integration import FirstCycle, distance
from zeno_orbits.verification.residuals import lawful_impact

_FINEST_CUT = 1e-9
"""Of the first impact speed: the slowest impact that a sweep cuts at."""

_FALL = 2.0
"""Fall of a cut's error, at least, for which a finer one is worth while; theory says 1000."""

_LATER = 1.001
"""Part of a period that an integration may take longer, by its error."""


def delta_sweep(
    dynamics: HybridDynamics,
    first: FirstCycle,
    cuts: Sequence[float],
    simulation: SimulationSettings,
    enough: float,
) -> tuple[DeltaCut, ...]:
    """Cut the sequence by the paper's rule at falling thresholds, and compare on the locked arc.

    Each cut motion is integrated from its last impact that the completed motion has, too.

    Args:
        dynamics: The system.
        first: The first period, completed by the extrapolated limit.
        cuts: Thresholds in units of the first impact speed, falling.
        simulation: Accuracy.
        enough: Cuts go on, a tenth as fast each, while the last one is farther off than this and
            nearer than the one before: where the locked arc is short, the cubic error is large.

    Returns:
        One entry a threshold, of the accumulation that its last cut tells worst; none where impacts
        do not accumulate.
    """
    sweeps = [
        _sweep_of(dynamics, first, phase, cuts, simulation, enough)
        for phase in first.cycle.phases
        if phase.kind is PhaseKind.ZENO
    ]
    return max(sweeps, key=lambda sweep: sweep[-1].error, default=())


def _sweep_of(
    dynamics: HybridDynamics,
    first: FirstCycle,
    phase: Phase,
    cuts: Sequence[float],
    simulation: SimulationSettings,
    enough: float,
) -> tuple[DeltaCut, ...]:
    fastest = abs(phase.impacts[0].approach_rate)
    found = [_cut(dynamics, first, phase, share * fastest, simulation) for share in cuts]
    while (
        len(found) > 1
        and enough < found[-1].error < found[-2].error / _FALL
        and found[-1].delta > 10.0 * _FINEST_CUT * fastest
    ):
        found.append(_cut(dynamics, first, phase, found[-1].delta / 10.0, simulation))
    return tuple(found)


def _cut(
    dynamics: HybridDynamics,
    first: FirstCycle,
    phase: Phase,
    delta: float,
    simulation: SimulationSettings,
) -> DeltaCut:
    """Return how far a motion is off in the middle of the locked arc that is cut below a speed."""
    zeno = phase.end.time if phase.zeno is None else phase.zeno.time
    when = (zeno + phase.end.time) / 2
    before = _last_common_impact(phase, delta)
    start = dynamics.on_stop(before.state_minus)
    start = start + before.approach_rate * dynamics.impulse_direction(start)
    rule = replace(simulation, completion=Truncation(delta=delta))
    try:
        run = simulate(dynamics, start, until=when - before.time, settings=rule)
    except ZenoOrbitsError:
        return DeltaCut(delta=delta, speed=math.nan, error=math.inf)
    last = run.impacts[-1] if run.impacts else before
    error = distance(run.end_state, first.cycle.execution.state_at(when), first.scale)
    return DeltaCut(delta=delta, speed=abs(last.approach_rate), error=error)


def _last_common_impact(phase: Phase, delta: float) -> Impact:
    """Return the last impact up to which a cut and the completed motion are the same."""
    slow = (impact for impact in phase.impacts if abs(impact.approach_rate) < delta)
    return next(slow, phase.impacts[-1])


def cut_order(sweep: tuple[DeltaCut, ...], noise: float) -> float:
    """Return the slope of error against speed, over the cuts that are above rounding and noise.

    Args:
        sweep: The cuts.
        noise: Error of the integration.
    """
    floor = max(1e-12, noise)
    usable = [cut for cut in sweep if floor < cut.error < math.inf]
    if len({cut.speed for cut in usable}) < 2:
        return math.nan
    speeds = np.log([cut.speed for cut in usable])
    errors = np.log([cut.error for cut in usable])
    return float(np.polyfit(speeds, errors, 1)[0])


def energies_of(
    orbit: ZenoOrbit,
    problem: Problem,
    claim: Claim,
    cycle: Cycle,
    simulation: SimulationSettings,
) -> dict[str, float]:
    """Return the energies of one period [J], from an integration that carries the ledger along.

    Args:
        orbit: The orbit.
        problem: Its problem.
        claim: The orbit as claimed.
        cycle: The first period.
        simulation: Accuracy.

    Returns:
        Name of an energy, as in the certificate, to its size.
    """
    values = orbit.values(problem)
    unit = problem.dynamics(values).own.energy
    dynamics = problem.dynamics(values, audited_in(unit))
    if isinstance(simulation.completion, ZenoPassage):
        # Each impact loses its part; only a short tail loses what the last speed says.
        simulation = replace(simulation, completion=simulation.completion.one_by_one)
    start = placed(dynamics, claim.shape, np.concatenate([claim.start, np.zeros(3)]))
    last = None if claim.shape.starts_at_release else len(cycle.impacts)
    # Where an impact ends the period, it is counted: the time of the end may come before it.
    until = cycle.end.time if last is None else _LATER * cycle.end.time
    run = simulate(dynamics, start, until=until, impacts=last, settings=simulation)
    impact_loss = 0.0
    for impact in run.impacts:
        impact_loss += lawful_impact(dynamics, impact)[1]
    for zeno in run.zeno_points:
        # The tail loses the whole normal kinetic energy that is left.
        impact_loss += dynamics.normal_inertia(zeno.state) * zeno.last_speed**2 / 2
    end = run.end_state if last is None else run.impacts[-1].state_plus
    return {
        "input_work": unit * float(end[-3]),
        "copper_loss": unit * float(end[-2]),
        "other_loss": unit * float(end[-1]),
        "impact_loss": impact_loss,
        "energy_gain": dynamics.energy(end) - dynamics.energy(start),
    }


def imbalance(energies: Mapping[str, float]) -> float:
    """Return the part of the largest energy that the balance (theory (13)) leaves unexplained."""
    spent = sum(value for name, value in energies.items() if name != "input_work")
    size = max(abs(value) for value in energies.values())
    return abs(energies["input_work"] - spent) / size if size > 0.0 else 0.0


def second_model(orbit: ZenoOrbit, problem: Problem, cycle: Cycle) -> float:
    """Return the largest relative difference of the two derivations along the orbit.

    Args:
        orbit: The orbit.
        problem: Its problem; it has a hand-written model.
        cycle: The first period.
    """
    values = orbit.values(problem)
    by_hand: HybridDynamics = load_reference(problem).dynamics(values)
    derived = problem.dynamics(values)
    times = np.linspace(0.0, cycle.end.time, 41)
    free = [cycle.execution.state_at(float(t)) for t in times]
    free += [impact.state_minus for impact in cycle.impacts]
    rested = [derived.on_stop(x) for x in free]

    def gap_between(
        quantity: Callable[[HybridDynamics, Vector], Vector], at: list[Vector]
    ) -> float:
        pairs = [(quantity(by_hand, x), quantity(derived, x)) for x in at]
        size = np.max([np.abs(b) for _, b in pairs], axis=0)
        size = np.where(size > 0.0, size, 1.0)
        return max(float(np.max(np.abs(a - b) / size)) for a, b in pairs)

    return max(
        gap_between(lambda d, x: d.free.rate(x), free),
        gap_between(lambda d, x: d.locked.rate(x), rested),
        gap_between(lambda d, x: d.reset_map(x, d.gap_rate(x)), free),
        gap_between(lambda d, x: np.array([d.gap_acceleration(x), d.multiplier(x)]), rested),
        gap_between(lambda d, x: np.array([d.energy(x), d.normal_inertia(x)]), free),
    )
