"""Residuals and margins of a periodic orbit (theory (3.4), (3.7)).

Residuals are zero and margins are positive along an orbit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model import HybridDynamics, Problem, constraint_sizes
from zeno_orbits.simulation import Impact, Mode, ZenoPoint
from zeno_orbits.verification.claim import Claim
from zeno_orbits.verification.integration import FirstCycle, Observation, distance


def orbit_residuals(
    dynamics: HybridDynamics, problem: Problem, claim: Claim, seen: Observation
) -> dict[str, float]:
    """Return every residual of the integration itself, by its name in the certificate.

    Args:
        dynamics: The system.
        problem: Its problem.
        claim: The orbit as claimed.
        seen: The integration.
    """
    first = seen.first
    start = "release" if claim.shape.starts_at_release else "start"
    if first is None:
        missing = ["first_impact", "impact_sequence", "closure"]
        missing += ["zeno_point"] if claim.shape.starts_at_release else []
        return {start: _off_section(dynamics, claim, None), **dict.fromkeys(missing, math.inf)}
    cycle, period = first.cycle, claim.period
    residuals = {
        start: _off_section(dynamics, claim, first),
        **_hits(dynamics, claim, first),
        "closure": _closure(claim, first),
        "period": abs(cycle.end.time - period) / period,
        "drift": max(distance(r.state, claim.start, first.scale) for r in seen.returns),
        "penetration": _penetration(dynamics, first),
        "adhesion": _adhesion(dynamics, first),
        **impact_laws([(dynamics, impact) for impact in cycle.impacts]),
    }
    if len(dynamics.holonomic(claim.start)):
        residuals["holonomic"] = _holonomic(dynamics, first)
    if problem.escapes:
        beyond = escapes_of(problem, first.largest).values()
        residuals["escape"] = max((excess for excess, _ in beyond), default=0.0)
    return residuals


def _closure(claim: Claim, first: FirstCycle) -> float:
    """Return the distance of the end of the period from its start, and from the last event."""
    end, (time, state) = first.cycle.end, claim.end
    apart = distance(end.state, claim.start, first.scale)
    if not claim.shape.starts_at_release:
        # The last event is an impact, which is compared with the other impacts.
        return apart
    return max(apart, distance(end.state, state, first.scale), abs(end.time - time) / claim.period)


def _holonomic(dynamics: HybridDynamics, first: FirstCycle) -> float:
    """Return the largest value of a constraint, relative to its change over the states' sizes."""
    ends = [arc.end_state for arc in first.cycle.execution.arcs]
    return max(
        float(np.max(np.abs(dynamics.holonomic(x)) / constraint_sizes(dynamics, x))) for x in ends
    )


def escapes_of(problem: Problem, largest: Vector) -> dict[str, tuple[float, str]]:
    """Return the coordinates that exceed the escape limits of a problem.

    Args:
        problem: The problem.
        largest: Largest size of each state over the period, ``(n_x,)``.

    Returns:
        For each such coordinate, its excess in units of the limit, and a description of the limit.
    """
    found: dict[str, tuple[float, str]] = {}
    for name, size in zip(problem.state_names, largest, strict=True):
        escape = problem.escapes.get(name)
        if escape is not None and size > escape.beyond:
            found[name] = (float(size) / escape.beyond - 1.0, escape.phrase)
    return found


def _hits(dynamics: HybridDynamics, claim: Claim, first: FirstCycle) -> dict[str, float]:
    """Return the deviations of starts of phases, impacts and Zeno points from the claimed orbit."""
    period, cycle = claim.period, first.cycle

    def miss(time: float, x: Vector, said: tuple[float, Vector]) -> float:
        return max(abs(time - said[0]) / period, distance(x, said[1], first.scale))

    earliest, later, zenos, starts = list[float](), [0.0], list[float](), [0.0]
    for said, phase in zip(claim.phases, cycle.phases, strict=True):
        starts.append(miss(phase.start.time, phase.start.state, (said.start_time, said.start)))
        hits = [
            miss(impact.time, impact.state_minus, hit)
            for hit, impact in zip(said.impacts, phase.impacts, strict=False)
        ]
        zeno = phase.zeno
        if zeno is not None:
            unseen = said.impacts[len(phase.impacts) :]
            hits += unseen_misses(
                dynamics.restitution, phase.impacts, zeno, unseen, period, first.scale
            )
            zenos.append(math.inf if said.zeno is None else miss(zeno.time, zeno.state, said.zeno))
        earliest.append(hits[0])
        later += hits[1:]
    found = {"first_impact": max(earliest), "impact_sequence": max(later)}
    if zenos:
        found["zeno_point"] = max(zenos)
    if len(claim.phases) > 1:
        found["phases"] = max(starts)
    return found


def unseen_misses(
    restitution: float,
    impacts: Sequence[Impact],
    zeno: ZenoPoint,
    said: Sequence[tuple[float, Vector]],
    period: float,
    scale: Vector,
) -> list[float]:
    r"""Return the deviations of claimed impacts after the last that the integration resolves.

    With :math:`z = (t / T, x)`, the impacts approach the Zeno point as
    :math:`z_k - z_\infty = a e^k + b e^{2k} + \dots`. The last two resolved impacts give :math:`a`,
    and the size of :math:`b`, up to twice which a claim may deviate.

    Args:
        restitution: The coefficient of restitution.
        impacts: The resolved impacts, at least one.
        zeno: Their Zeno point.
        said: Time [s] and state of each claimed impact after them.
        period: The period [s].
        scale: Size of each state, ``(n_x,)``.
    """
    ways = [
        np.append((impact.time - zeno.time) / period, (impact.state_minus - zeno.state) / scale)
        for impact in impacts[-2:]
    ]
    last = ways[-1]
    bend = np.abs(last)
    if len(ways) > 1 and restitution > 0.0:
        bend = np.abs(last - restitution * ways[0]) * restitution / (1 - restitution)
    missed = list[float]()
    for j, (time, x) in enumerate(said, 1):
        way = np.append((time - zeno.time) / period, (x - zeno.state) / scale)
        off = np.abs(way - restitution**j * last) - 2 * restitution**j * bend
        missed.append(float(np.max(np.maximum(off, 0.0))))
    return missed


def margins_of(dynamics: HybridDynamics, first: FirstCycle | None) -> dict[str, float]:
    """Return the distances to loss of existence, the smallest over the phases.

    Without a first period the result is empty. ``phases_apart`` is 0 if the starts of two phases of
    one kind are equal to the accuracy of an orbit. The period then consists of several shorter
    periods.
    """
    if first is None:
        return {}
    cycle = first.cycle
    held = [phase for phase in cycle.phases if phase.zeno is not None]
    struck = [phase for phase in cycle.phases if phase.zeno is None]
    margins: dict[str, float] = {}
    if held:
        states = [point.state for point in cycle.zeno_points]
        margins["gap_acceleration"] = min(-dynamics.gap_acceleration(x) for x in states)
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
    apart = cycle.shorter_periods(first.scale)
    if apart:
        margins["phases_apart"] = min(apart.values())
    return margins


def _off_section(dynamics: HybridDynamics, claim: Claim, first: FirstCycle | None) -> float:
    """Return the distance of the claimed start from its section.

    At a release the gap, the gap rate and the multiplier are zero. Just after an impact the gap is
    zero. After a plastic impact the gap rate is also zero.
    """
    speed = 1.0 if first is None else abs(first.cycle.impacts[0].approach_rate)
    gap = 1.0 if first is None else first.gap
    force = 1.0 if first is None else first.force
    off = [abs(dynamics.gap(claim.start)) / gap]
    if claim.shape.starts_at_release or dynamics.restitution == 0.0:
        off.append(abs(dynamics.gap_rate(claim.start)) / speed)
    if claim.shape.starts_at_release:
        off.append(abs(dynamics.multiplier(claim.start)) / force)
    return max(off)


def _penetration(dynamics: HybridDynamics, first: FirstCycle) -> float:
    lowest = 0.0
    for arc in first.cycle.execution.arcs:
        if arc.mode is Mode.FREE and arc.trajectory is not None:
            inside = arc.flow_states[1:-1]
            scaled = inside.shape[1] > len(arc.start_state)
            for y in inside:
                gap = float(y[-2]) * arc.time_unit**2 if scaled else dynamics.gap(y)
                lowest = min(lowest, gap)
            lowest = min(lowest, dynamics.gap(arc.end_state))
    return abs(lowest) / first.gap


def _adhesion(dynamics: HybridDynamics, first: FirstCycle) -> float:
    pulls = [
        max(0.0, -dynamics.multiplier(x))
        for phase in first.cycle.phases
        if phase.locked is not None
        for x in phase.locked.flow_states
    ]
    return max(pulls, default=0.0) / first.force


def lawful_impact(dynamics: HybridDynamics, impact: Impact) -> tuple[float, float]:
    """Return the gap rate after an impact by Newton's law, and the energy loss.

    The law is implemented here again, because a check must not call the checked code.

    Args:
        dynamics: The system, for its restitution and its effective inertia at an impact.
        impact: The impact.
    """
    e, rate = dynamics.restitution, impact.approach_rate
    inertia = dynamics.normal_inertia(impact.state_minus)
    return -e * rate, (1 - e**2) / 2 * inertia * rate**2


def impact_laws(struck: Sequence[tuple[HybridDynamics, Impact]]) -> dict[str, float]:
    """Return the deviations of the resets from Newton's law and from its energy loss.

    Args:
        struck: Each impact with the system of its stop, in which closed stops are constraints.
    """
    turn, loss, fastest = 0.0, 0.0, max(abs(impact.approach_rate) for _, impact in struck)
    for dynamics, impact in struck:
        inertia = dynamics.normal_inertia(impact.state_minus)
        speed, cost = lawful_impact(dynamics, impact)
        change = _energy_change(dynamics, impact)
        turn = max(turn, abs(dynamics.gap_rate(impact.state_plus) - speed) / fastest)
        loss = max(loss, abs(change + cost) / (inertia * fastest**2 / 2))
    return {"restitution": turn, "impact_energy": loss}


_FAST = 2.0**60
"""Factor on velocities at which potential energies vanish relative to the kinetic energy."""


def _energy_change(dynamics: HybridDynamics, impact: Impact) -> float:
    r"""Return the energy after an impact minus the energy before it [J].

    If the velocities have the mean :math:`a` and half the jump :math:`b`, their part of it is
    :math:`2 a^\top M b`. It is computed from energies at the velocities :math:`c (a \pm s b)`,
    with arbitrary factors:

    .. math:: 2 a^\top M b = \frac{E(c (a + s b)) - E(c (a - s b))}{c^2 s}

    A large :math:`c` eliminates potential energies. The choice :math:`s = |a| / |b|` avoids a
    difference of large kinetic energies, whose rounding error would exceed the energy of a slow
    impact. Apart from the velocities, only further states may change, by their own law. Their
    change of energy is added.
    """
    moving = slice(dynamics.n_q, 2 * dynamics.n_q)
    still = [impact.state_plus.copy(), impact.state_minus.copy()]
    direction = dynamics.impulse_direction(impact.state_minus)[2 * dynamics.n_q :]
    still[1][2 * dynamics.n_q :] -= (1 + dynamics.restitution) * impact.approach_rate * direction
    for x in still:
        x[moving] = 0.0
    other = dynamics.energy(still[0]) - dynamics.energy(still[1])
    after, before = impact.state_plus[moving], impact.state_minus[moving]
    mean, half = (after + before) / 2, (after - before) / 2
    sizes = float(np.max(np.abs(mean))), float(np.max(np.abs(half)))
    if sizes[1] == 0.0:
        return other
    share = sizes[0] / sizes[1] or 1.0
    energies: list[float] = []
    for sign in (1.0, -1.0):
        x = impact.state_minus.copy()
        x[moving] = _FAST * (mean + sign * share * half)
        energies.append(dynamics.energy(x))
    return other + (energies[0] - energies[1]) / (_FAST**2 * share)
