"""What has to vanish along a Zeno periodic orbit, and what has to stay positive (theory (19))."""

from __future__ import annotations

import math

import numpy as np

from zeno_orbits.dynamics import HybridDynamics
from zeno_orbits.execution import Impact, Mode
from zeno_orbits.observation import Claim, FirstCycle, Observation, distance


def orbit_residuals(dynamics: HybridDynamics, claim: Claim, seen: Observation) -> dict[str, float]:
    """Return every residual that the integration itself tells, by its name in the certificate."""
    cycle = seen.cycle
    if cycle is None:
        missing = ("release", "first_impact", "impact_sequence", "zeno_point", "closure")
        return dict.fromkeys(missing, math.inf) | {"release": _off_release(dynamics, claim, None)}
    period = claim.period
    hits = [
        max(abs(impact.time - time) / period, distance(impact.state_minus, x, cycle.scale))
        for (time, x), impact in zip(claim.impacts, cycle.impacts, strict=False)
    ]
    # Impacts that the integration left to the tail have to lie inside it.
    first_unseen = len(cycle.impacts)
    hits += [
        max(0.0, abs(time - cycle.zeno.time) - cycle.zeno.tail) / period
        for time, _ in claim.impacts[first_unseen:]
    ]
    residuals = {
        "release": _off_release(dynamics, claim, cycle),
        "first_impact": hits[0],
        "impact_sequence": max(hits[1:], default=0.0),
        "zeno_point": max(
            abs(cycle.zeno.time - claim.zeno_time) / period,
            distance(cycle.zeno.state, claim.zeno, cycle.scale),
        ),
        "closure": distance(cycle.end.state, claim.release, cycle.scale),
        "period": abs(cycle.end.time - period) / period,
        "drift": max(distance(r.state, claim.release, cycle.scale) for r in seen.returns),
        "penetration": _penetration(dynamics, cycle),
        "adhesion": _adhesion(dynamics, cycle),
        **_impact_laws(dynamics, cycle.impacts),
    }
    if len(dynamics.holonomic(claim.release)):
        residuals["holonomic"] = max(
            float(np.max(np.abs(dynamics.holonomic(arc.end_state)))) for arc in cycle.arcs
        )
    return residuals


def margins_of(dynamics: HybridDynamics, cycle: FirstCycle | None) -> dict[str, float]:
    """Return the distances from losing the orbit; none without a first period."""
    if cycle is None:
        return {}
    return {
        "gap_acceleration": -dynamics.gap_acceleration(cycle.zeno.state),
        "first_impact_speed": -cycle.impacts[0].approach_rate,
        "release_transversality": -dynamics.multiplier_rate(cycle.end.state),
        "locked_time": cycle.end.time - cycle.zeno.time,
    }


def _off_release(dynamics: HybridDynamics, claim: Claim, cycle: FirstCycle | None) -> float:
    """Return how far the claimed release is from gap = gap rate = multiplier = 0."""
    speed = 1.0 if cycle is None else abs(cycle.impacts[0].approach_rate)
    gap = 1.0 if cycle is None else cycle.gap_scale
    force = 1.0 if cycle is None else cycle.force_scale
    return max(
        abs(dynamics.gap(claim.release)) / gap,
        abs(dynamics.gap_rate(claim.release)) / speed,
        abs(dynamics.multiplier(claim.release)) / force,
    )


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
        for arc in cycle.arcs
        if arc.mode is Mode.LOCKED and arc.end_time > cycle.zeno.time
        for x in arc.flow_states
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
