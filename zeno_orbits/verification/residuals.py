r"""Residuals of a period: the orbit's data, the laws of impact, and the guards between events.

Laws are stated here again, by other formulas than those of the simulator: the impulses of an impact
follow from the changes of all gap rates,

.. math:: G\,p = \dot h^+ - \dot h^-, \qquad G = J W J^\top,

its loss from kinetic energies, and the guards are sampled between the events (theory (3.4), (3.9)).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model import GraphDynamics, HybridDynamics, Problem, constraint_sizes
from zeno_orbits.orbits import (
    events_as_listed,
    lasting_events,
    orbit_event_name,
    phases_of_events,
    sequence_of,
)
from zeno_orbits.simulation import Impact, Release, SwitchEvent, ZenoPoint, scale_of, state_before
from zeno_orbits.verification.claim import Case, Claim, ClaimedEvent
from zeno_orbits.verification.energies import kept_stops, struck_view
from zeno_orbits.verification.integration import Period, distance
from zeno_orbits.verification.second_net import GuardRanges


def sizes_along(period: Period, graph: GraphDynamics, problem: Problem) -> Vector:
    """Return the size of each state along a period, ``(n_x,)``.

    A state that nearly vanishes has a part of the size of the others of its unit.

    Args:
        period: The period.
        graph: The graph of modes.
        problem: The problem, for the units of the states.
    """
    return scale_of(
        [largest_along(period)], problem.state_units, graph.own.states(period.state.size)
    )


def largest_along(period: Period) -> Vector:
    """Return the largest size of each state along a period, ``(n_x,)``."""
    n_x = period.state.size
    return np.max([np.max(np.abs(one.flow_states[:, :n_x]), axis=0) for one in period.arcs], axis=0)


# The orbit's data.


def nothing_returns(claim: Claim) -> dict[str, float]:
    """Return the residuals of an orbit whose period is not over: infinite.

    Args:
        claim: The orbit as claimed.
    """
    return dict.fromkeys([*_kinds(claim), "closure", "period"], math.inf)


def _kinds(claim: Claim) -> list[str]:
    """Return the residuals that compare the events of an orbit, apart from its last event."""
    kinds = ["events"]
    if claim.count("impact"):
        kinds += ["first_impact", "impact_sequence"]
    if claim.count("zeno"):
        kinds.append("zeno_point")
    if any(one.name.startswith("release ") or one.after is not None for one in claim.events[:-1]):
        kinds.append("phases")
    return kinds


class _Misses:
    """The deviations of the events of a period from the claimed events, by residual."""

    def __init__(self, claim: Claim, first: Period, scale: Vector) -> None:
        self._claim, self._first, self._scale = claim, first, scale
        self.found = dict.fromkeys([*_kinds(claim), "closure"], 0.0)

    def keep(self, name: str, miss: float) -> None:
        """Take a deviation into account."""
        self.found[name] = max(self.found.get(name, 0.0), miss)

    def compare(
        self, name: str, event: Impact | ZenoPoint | Release | SwitchEvent, said: ClaimedEvent
    ) -> None:
        """Compare an event with a claimed event."""
        late = abs(event.time - self._first.start - said.time) / self._claim.period
        away = distance(np.asarray(state_before(event)), said.state, self._scale)
        self.keep(name, math.inf if said.name != orbit_event_name(event) else max(late, away))
        if said.after is not None:
            self.keep("phases", distance(np.asarray(event.after), said.after, self._scale))


def event_misses(
    graph: GraphDynamics, claim: Claim, first: Period, scale: Vector
) -> dict[str, float]:
    """Return the deviations of the events of a period and of its end, by residual.

    They are infinite from the first event on that differs. Kinks in the flights of impacts that
    accumulate do not belong to the event sequence. Claimed impacts after the last that is resolved
    obey the law of the tail.

    Args:
        graph: The graph of modes.
        claim: The orbit as claimed.
        first: The first integrated period.
        scale: Size of each state, ``(n_x,)``.
    """
    misses = _Misses(claim, first, scale)
    misses.keep("closure", distance(first.state, claim.start, scale))
    events = events_as_listed(first.events, claim.sequence)
    if sequence_of([orbit_event_name(event) for event in events]) != claim.sequence:
        return {**misses.found, **dict.fromkeys(_kinds(claim), math.inf)}
    claims = _lasting_phases([one.name for one in claim.events])
    phases = _lasting_phases([orbit_event_name(event) for event in events])
    for seen, listed in zip(phases, claims, strict=True):
        *before, end = (events[k] for k in seen)
        *claimed_before, last = (claim.events[k] for k in listed)
        # All events before a Zeno point are impacts on its stop.
        impacts = [event for event in before if isinstance(event, Impact)]
        if bool(impacts) != bool(claimed_before):
            misses.keep("first_impact", math.inf)
        for k, (event, said) in enumerate(zip(impacts, claimed_before, strict=False)):
            misses.compare("impact_sequence" if k else "first_impact", event, said)
        misses.compare(_residual_of(end, last is claim.events[-1]), end, last)
        if isinstance(end, ZenoPoint) and impacts:
            e = graph.open_views[graph.stop_names.index(end.stop)].restitution
            unseen = [(one.time + first.start, one.state) for one in claimed_before[len(impacts) :]]
            for miss in unseen_misses(e, impacts, end, unseen, claim.period, scale):
                misses.keep("impact_sequence", miss)
    return misses.found


def unlisted_impacts(claim: Claim, first: Period) -> int:
    """Return the number of resolved impacts before Zeno points that an orbit does not list.

    Args:
        claim: The orbit as claimed.
        first: The first integrated period.
    """
    names = [orbit_event_name(event) for event in events_as_listed(first.events, claim.sequence)]
    if sequence_of(names) != claim.sequence:
        return 0
    claims = _lasting_phases([one.name for one in claim.events])
    pairs = zip(_lasting_phases(names), claims, strict=True)
    return sum(
        max(0, _impacts_among(names, seen) - (len(listed) - 1))
        for seen, listed in pairs
        if names[seen[-1]].startswith("zeno ")
    )


def _impacts_among(names: Sequence[str], phase: Sequence[int]) -> int:
    return sum(names[k].startswith("impact ") for k in phase)


def _residual_of(event: Impact | ZenoPoint | Release | SwitchEvent, is_last: bool) -> str:
    """Return the residual that compares the last event of a phase."""
    if isinstance(event, Impact):
        return "first_impact"
    if isinstance(event, ZenoPoint):
        return "zeno_point"
    if is_last:
        return "closure"
    return "phases" if isinstance(event, Release) else "events"


def _lasting_phases(names: Sequence[str]) -> list[list[int]]:
    """Return the indices of the lasting events of each phase."""
    lasting = {*lasting_events(names)}
    return [[k for k in phase if k in lasting] for phase in phases_of_events(names)]


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


def off_section(
    one: Case, ranges: GuardRanges, first: Period | None, scale: Vector
) -> dict[str, float]:
    """Return the distance of the claimed start from the states just after the event of its section.

    Gap and gap rate of the stops that stay closed are zero, and the gap of a stop that the event
    leaves. At a release the multiplier is zero as well. A switch has the claimed state after it.

    Args:
        one: The orbit.
        ranges: The ranges of gaps and multipliers over the period.
        first: The first integrated period, if there is one.
        scale: Size of each state, ``(n_x,)``.

    Returns:
        The residual ``release`` or ``start``.
    """
    graph, claim, x, off = one.graph, one.claim, one.claim.start, [0.0]
    speeds = [] if first is None else [abs(impact.approach_rate) for impact in first.impacts]
    for at in one.contacts:
        off.append(abs(at.view.gap(x)) / ranges.largest_gap(at.stop))
        if at.rests:
            fastest = max(speeds, default=0.0) or at.view.own.gap_rate
            off.append(abs(at.view.gap_rate(x)) / fastest)
        if at.released:
            off.append(abs(at.view.multiplier(x)) / ranges.largest_force(at.stop))
    kind, _, name = claim.section.partition(" ")
    if kind == "switch" and scale.size and name in graph.switch_names[: graph.n_declared]:
        before = claim.events[-1].state
        after = graph.after_switch(graph.switch_names.index(name), before)
        off.append(distance(after, x, scale))
    return {"release" if any(at.released for at in one.contacts) else "start": max(off)}


# The laws.


def lawful_impact(dynamics: HybridDynamics, impact: Impact) -> tuple[float, float]:
    """Return the gap rate after an impact by Newton's law, and the energy loss.

    The law is implemented here again, because a check must not call the checked code.

    Args:
        dynamics: The system, for its restitution and its effective inertia at an impact.
        impact: The impact.
    """
    rate = impact.approach_rate
    e = dynamics.restitution_of(-rate)
    inertia = dynamics.normal_inertia(impact.state_minus)
    return -e * rate, (1 - e**2) / 2 * inertia * rate**2


def impact_laws(graph: GraphDynamics, period: Period) -> dict[str, float]:
    """Return the deviations of impacts from Newton's law and its loss, and the largest pull.

    Args:
        graph: The graph of modes.
        period: The period.
    """
    impacts = period.impacts
    if not impacts:
        return {}
    turn, loss, fastest = 0.0, 0.0, max(abs(impact.approach_rate) for impact in impacts)
    for impact in impacts:
        view = struck_view(graph, period, impact)
        speed, cost = lawful_impact(view, impact)
        change, inertia = _energy_change(view, impact), view.normal_inertia(impact.state_minus)
        turn = max(turn, abs(view.gap_rate(impact.state_plus) - speed) / fastest)
        loss = max(loss, abs(change + cost) / (inertia * fastest**2 / 2))
    found = {"restitution": turn, "impact_energy": loss}
    if len(graph.stop_names) > 1:
        found["impulses"] = max(_pull(graph, period, impact) for impact in impacts) / fastest
    return found


def _pull(graph: GraphDynamics, period: Period, impact: Impact) -> float:
    """Return the largest pull of a stop in an impact, as a share of the approach rate."""
    before, after = (
        np.array([view.gap_rate(x) for view in graph.open_views])
        for x in (impact.state_minus, impact.state_plus)
    )
    impulses = _impulses(graph, period, impact, after - before)
    largest, n = float(np.max(np.abs(impulses))), len(graph.stop_names)
    if largest == 0.0 or np.linalg.matrix_rank(graph.delassus(impact.state_minus)) < n:
        return 0.0
    return max(0.0, float(np.max(-impulses))) * abs(impact.approach_rate) / largest


def _impulses(graph: GraphDynamics, period: Period, impact: Impact, change: Vector) -> Vector:
    """Return the impulses of all stops that change the gap rates as an impact does.

    The current layer of a corrected drive lasts too long to open a stop that a force holds closed.
    A stop that stays closed then has its impulse by the masses alone.
    """
    x, k = impact.state_minus, graph.stop_names.index(impact.stop)
    impulses: Vector = np.linalg.lstsq(graph.delassus(x), change, rcond=1e-9)[0].astype(np.float64)
    if graph.has_current_layers:
        kept, _ = graph.mode_of(kept_stops(graph, period, impact), ())
        coupling = graph.coupling(x)
        share = np.linalg.solve(coupling[np.ix_(kept, kept)], coupling[list(kept), k])
        impulses[list(kept)] = -share * impulses[k]
    return impulses


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
    rate = impact.approach_rate
    still[1][2 * dynamics.n_q :] -= (1 + dynamics.restitution_of(-rate)) * rate * direction
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


def constraints_along(graph: GraphDynamics, period: Period) -> dict[str, float]:
    """Return the largest value of a constraint at the ends of arcs, if there are any.

    It is relative to the change of the constraint over the sizes of the states.

    Args:
        graph: The graph of modes.
        period: The period.
    """
    view = graph.first
    if not view.holonomic(period.state).size:
        return {}
    ends = [arc.end_state for arc in period.arcs]
    return {
        "holonomic": max(
            float(np.max(np.abs(view.holonomic(x)) / constraint_sizes(view, x))) for x in ends
        )
    }


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
