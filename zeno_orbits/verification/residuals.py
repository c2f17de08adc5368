"""What has to vanish along a periodic orbit, and what has to stay positive (theory (19), (46))."""

from __future__ import annotations

import math

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model.numeric.hybrid_dynamics import HybridDynamics
from zeno_orbits.orbits.phases import kinds_of
from zeno_orbits.orbits.shape import OrbitShape
from zeno_orbits.simulation.execution import Impact, Mode
from zeno_orbits.verification.integration import Claim, FirstCycle, Observation, distance


def orbit_residuals(dynamics: HybridDynamics, claim: Claim, seen: Observation) -> dict[str, float]:
    """Return every residual that the integration itself tells, by its name in the certificate."""
    cycle = seen.cycle
    start = "release" if claim.shape.starts_at_release else "start"
    if cycle is None:
        missing = ["first_impact", "impact_sequence", "closure"]
        missing += ["zeno_point"] if claim.shape.starts_at_release else []
        return {start: _off_section(dynamics, claim, None), **dict.fromkeys(missing, math.inf)}
    period = claim.period
    residuals = {
        start: _off_section(dynamics, claim, cycle),
        **_hits(claim, cycle),
        "closure": distance(cycle.end.state, claim.start, cycle.scale),
        "period": abs(cycle.end.time - period) / period,
        "drift": max(distance(r.state, claim.start, cycle.scale) for r in seen.returns),
        "penetration": _penetration(dynamics, cycle),
        "adhesion": _adhesion(dynamics, cycle),
        **_impact_laws(dynamics, cycle.impacts),
    }
    if len(dynamics.holonomic(claim.start)):
        residuals["holonomic"] = max(
            float(np.max(np.abs(dynamics.holonomic(arc.end_state)))) for arc in cycle.arcs
        )
    return residuals


def _hits(claim: Claim, cycle: FirstCycle) -> dict[str, float]:
    """Return how far starts of phases, impacts and Zeno points are from what the orbit says."""
    period = claim.period

    def miss(time: float, x: Vector, said: tuple[float, Vector]) -> float:
        return max(abs(time - said[0]) / period, distance(x, said[1], cycle.scale))

    first, later, zenos, starts = list[float](), [0.0], list[float](), [0.0]
    for said, phase in zip(claim.phases, cycle.phases, strict=True):
        starts.append(miss(phase.start.time, phase.start.state, (said.start_time, said.start)))
        hits = [
            miss(impact.time, impact.state_minus, hit)
            for hit, impact in zip(said.impacts, phase.impacts, strict=False)
        ]
        zeno = phase.zeno
        if zeno is not None:
            # Impacts that the integration left to the tail have to lie inside it.
            unseen = said.impacts[len(phase.impacts) :]
            hits += [max(0.0, abs(t - zeno.time) - zeno.tail) / period for t, _ in unseen]
            zenos.append(math.inf if said.zeno is None else miss(zeno.time, zeno.state, said.zeno))
        first.append(hits[0])
        later += hits[1:]
    found = {"first_impact": max(first), "impact_sequence": max(later)}
    if zenos:
        found["zeno_point"] = max(zenos)
    if len(claim.phases) > 1:
        found["phases"] = max(starts)
    return found


def margins_of(dynamics: HybridDynamics, cycle: FirstCycle | None) -> dict[str, float]:
    """Return the distances from losing the orbit; none without a first period.

    Each is the smallest over the phases.
    """
    if cycle is None:
        return {}
    held = [phase for phase in cycle.phases if phase.zeno is not None]
    struck = [phase for phase in cycle.phases if phase.zeno is None]
    margins: dict[str, float] = {}
    if held:
        zenos = [phase.zeno for phase in held if phase.zeno is not None]
        margins["gap_acceleration"] = min(-dynamics.gap_acceleration(z.state) for z in zenos)
    margins["first_impact_speed"] = min(-p.impacts[0].approach_rate for p in cycle.phases)
    if held:
        margins["release_transversality"] = min(
            -dynamics.multiplier_rate(phase.end.state) for phase in held
        )
        margins["locked_time"] = min(
            phase.end.time - phase.zeno.time for phase in held if phase.zeno is not None
        )
    if struck and dynamics.restitution == 0.0:
        margins["lets_go"] = min(dynamics.gap_acceleration(phase.end.state) for phase in struck)
    apart = _apart(cycle)
    if apart is not None:
        margins["phases_apart"] = apart
    return margins


_SAME = 1e-6
"""Starts of phases that are nearer than this, relative, are the same."""


def _apart(cycle: FirstCycle) -> float | None:
    """Return how far the period is from several of a shorter one; nothing if it cannot be that.

    It is 0 if the starts of two alike phases are no farther apart than an orbit is certain.
    """
    shorter = OrbitShape(phases=kinds_of(cycle.phases)).shorter
    apart = [
        distance(cycle.phases[one.n_phases].start.state, cycle.phases[0].start.state, cycle.scale)
        for one in shorter
    ]
    return min((d if d > _SAME else 0.0 for d in apart), default=None)


def _off_section(dynamics: HybridDynamics, claim: Claim, cycle: FirstCycle | None) -> float:
    """Return how far the claimed start is from its section.

    At a release gap, gap rate and multiplier are zero; just after an impact the gap is, and after a
    plastic one its rate.
    """
    speed = 1.0 if cycle is None else abs(cycle.impacts[0].approach_rate)
    gap = 1.0 if cycle is None else cycle.gap_scale
    force = 1.0 if cycle is None else cycle.force_scale
    off = [abs(dynamics.gap(claim.start)) / gap]
    if claim.shape.starts_at_release or dynamics.restitution == 0.0:
        off.append(abs(dynamics.gap_rate(claim.start)) / speed)
    if claim.shape.starts_at_release:
        off.append(abs(dynamics.multiplier(claim.start)) / force)
    return max(off)


def _penetration(dynamics: HybridDynamics, cycle: FirstCycle) -> float:
    lowest = 0.0
    for arc in cycle.arcs:
        if arc.mode is Mode.FREE and arc.trajectory is not None:
            inside = arc.flow_states[1:-1]
            scaled = inside.shape[1] > len(arc.start_state)
            for y in inside:
                gap = float(y[-2]) * arc.time_unit**2 if scaled else dynamics.gap(y)
                lowest = min(lowest, gap)
            lowest = min(lowest, dynamics.gap(arc.end_state))
    return abs(lowest) / cycle.gap_scale


def _adhesion(dynamics: HybridDynamics, cycle: FirstCycle) -> float:
    forces = [
        dynamics.multiplier(x)
        for phase in cycle.phases
        if phase.locked is not None
        for x in phase.locked.flow_states
    ]
    return max(0.0, -min(forces, default=0.0)) / cycle.force_scale


def _impact_laws(dynamics: HybridDynamics, impacts: tuple[Impact, ...]) -> dict[str, float]:
    """Return how far the resets are from Newton's law and from its energy loss."""
    restitution = dynamics.restitution
    turn, loss = 0.0, 0.0
    fastest = max(abs(impact.approach_rate) for impact in impacts)
    for impact in impacts:
        rate = impact.approach_rate
        inertia = dynamics.normal_inertia(impact.state_minus)
        expected = -(1 - restitution**2) / 2 * inertia * rate**2
        change = dynamics.energy(impact.state_plus) - dynamics.energy(impact.state_minus)
        turn = max(turn, abs(dynamics.gap_rate(impact.state_plus) + restitution * rate) / fastest)
        loss = max(loss, abs(change - expected) / (inertia * fastest**2 / 2))
    return {"restitution": turn, "impact_energy": loss}
