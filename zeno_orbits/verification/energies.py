r"""Energies of one period.

The powers are integrated along the stored flow of every arc. Impacts and Zeno points lose energy by
Newton's law with the inertia beside the stops that stay closed, and a reset of a switch changes the
energy as its states:

.. math:: \int P_{\mathrm{in}}\,dt = E(T) - E(0) + \int P_{\mathrm{loss}}\,dt
    + \sum \tfrac12 m_n (1 - e^2)\,\dot h^2 + \sum \bigl(E^- - E^+\bigr)_{\mathrm{switches}}
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model import GraphDynamics, GraphMode, HybridDynamics
from zeno_orbits.simulation import Arc, Impact, SwitchEvent, ZenoPoint
from zeno_orbits.verification.integration import Period

QUICK, EXACT = (
    (np.sqrt(1 / 5) * np.array([-1.0, 1.0]), np.array([1.0, 5.0, 5.0, 1.0]) / 6),
    (np.sqrt(3 / 7) * np.array([-1.0, 0.0, 1.0]), np.array([9.0, 49.0, 64.0, 49.0, 9.0]) / 90),
)
"""Lobatto's rules of order 6 and 8 on every step, whose ends are known: inner nodes, weights."""

Rule = tuple[Vector, Vector]
_KEEPS = 1e-9
"""Gap rate of a stop beside an impact, relative to the gap rate of the impact, that is rounding."""


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


def energies_of(graph: GraphDynamics, period: Period, rule: Rule = EXACT) -> PeriodEnergies:
    """Return the energies of one period. ``switch_loss`` exists if there are switches.

    Args:
        graph: The graph of modes of the problem, with its powers and energies.
        period: The period.
        rule: The rule by which powers are integrated.
    """
    first = graph.first
    switches = [event for event in period.events if isinstance(event, SwitchEvent)]
    lost = sum(_impact_loss(graph, period, impact) for impact in period.impacts)
    lost += sum(_tail_loss(graph, period, zeno) for zeno in period.zeno_points)
    net, gross = _works(graph, period, rule)
    # What contact adds in the mean of a tail, its impacts add.
    added = sum(_added_in(graph, period, arc) for arc in period.arcs if arc.trajectory is None)
    found = {
        "input_work": float(net[0]),
        "copper_loss": float(net[1]),
        "other_loss": float(net[2] + added),
        "impact_loss": float(lost - added),
        "energy_gain": first.energy(period.state) - first.energy(period.begin),
    }
    if switches:
        found["switch_loss"] = sum(
            first.energy(one.state_minus) - first.energy(one.state_plus) for one in switches
        )
    largest = max(_largest_kinetic(first, period.arcs), float(np.max(gross)))
    return PeriodEnergies(values=found, largest=largest)


def _works(graph: GraphDynamics, period: Period, rule: Rule) -> tuple[Vector, Vector]:
    """Return the input work and both losses of a period, and with moduli of powers, ``(3,)``."""
    nodes: dict[GraphMode, list[tuple[Vector, Vector]]] = {}
    for arc in period.arcs:
        mode, states, weights = _nodes(graph, period, arc, rule)
        nodes.setdefault(mode, []).append((states, weights))
    net, gross = np.zeros(3), np.zeros(3)
    for mode, found in nodes.items():
        states, weights = (np.concatenate(one) for one in zip(*found, strict=True))
        powers = graph.powers(mode, states)
        net += weights @ powers
        gross += weights @ np.abs(powers)
    return net, gross


def _nodes(
    graph: GraphDynamics, period: Period, arc: Arc, rule: Rule
) -> tuple[GraphMode, Vector, Vector]:
    """Return the mode, states along an arc, ``(n, n_x)``, and their weights in an integral [s]."""
    mode = closed, sides = arc.mode_in(graph)
    if arc.trajectory is None:
        # In the mean, the tail of an impact sequence is contact.
        zeno = min(period.zeno_points, key=lambda zeno: abs(zeno.time - arc.end_time))
        stop = graph.stop_names.index(zeno.stop)
        rested = graph.view(mode, stop).resting(arc.start_state).state
        held = tuple(sorted((*closed, stop))), sides
        return held, np.array([rested, arc.end_state]), np.full(2, arc.duration / 2)
    n_x, times = len(arc.start_state), arc.trajectory.times
    inner, weights = rule
    halves = np.diff(times)[:, None] / 2
    offsets = (times[:-1, None] + halves * (1 + inner)).ravel()
    inside = arc.flow_states_at(offsets)[:, :n_x].reshape(-1, len(inner), n_x)
    ends = arc.flow_states[:, None, :n_x]
    states = np.concatenate([ends[:-1], inside, ends[1:]], axis=1)
    return mode, states.reshape(-1, n_x), arc.time_unit * (halves * weights).ravel()


def _added_in(graph: GraphDynamics, period: Period, tail: Arc) -> float:
    """Return the energy that contact adds to further states in the mean of a tail [J]."""
    held, states, weights = _nodes(graph, period, tail, EXACT)
    losses = [graph.powers(mode, states)[:, 2] for mode in (tail.mode_in(graph), held)]
    return float(weights @ (losses[0] - losses[1]))


def _largest_kinetic(dynamics: HybridDynamics, arcs: Sequence[Arc]) -> float:
    """Return the largest kinetic energy at the ends and the fastest steps of arcs [J].

    It is the part of the energy that vanishes with the velocities.
    """
    largest, n_q = 0.0, dynamics.n_q
    for arc in arcs:
        states = arc.flow_states[:, : len(arc.start_state)]
        speeds = states[:, n_q : 2 * n_q] / dynamics.own.states(states.shape[1])[n_q : 2 * n_q]
        fastest = states[int(np.argmax(np.sum(speeds**2, axis=1)))]
        for x in (arc.start_state, fastest, arc.end_state):
            still = x.copy()
            still[n_q : 2 * n_q] = 0.0
            largest = max(largest, dynamics.energy(x) - dynamics.energy(still))
    return largest


def _impact_loss(graph: GraphDynamics, period: Period, impact: Impact) -> float:
    """Return the energy that an impact loses by Newton's law [J]."""
    view = struck_view(graph, period, impact)
    inertia = view.normal_inertia(impact.state_minus)
    rate = impact.approach_rate
    lost = (1 - view.restitution_of(-rate) ** 2) / 2 * inertia * rate**2
    return lost - _stored(view, impact.state_minus, impact.state_plus)


def _tail_loss(graph: GraphDynamics, period: Period, zeno: ZenoPoint) -> float:
    """Return the energy that the tail of an impact sequence loses, like a plastic impact [J]."""
    arc = period.arc_before(zeno)
    kept = [name for name in arc.closed if name != zeno.stop]
    view = graph.view(graph.mode_of(kept, arc.sides), graph.stop_names.index(zeno.stop))
    departing = zeno.state + zeno.last_speed * view.impulse_direction(zeno.state)
    lost = view.normal_inertia(zeno.state) * zeno.last_speed**2 / 2
    return lost - _stored(view, departing, zeno.state)


def _stored(dynamics: HybridDynamics, before: Vector, after: Vector) -> float:
    """Return the energy added by a change of circuit states and further states [J]."""
    changed = before.copy()
    changed[2 * dynamics.n_q :] = after[2 * dynamics.n_q :]
    return dynamics.energy(changed) - dynamics.energy(before)


def kept_stops(graph: GraphDynamics, period: Period, impact: Impact) -> list[str]:
    """Return the names of the closed stops that an impact does not open.

    Args:
        graph: The graph of modes.
        period: The period.
        impact: The impact.
    """
    closed = period.arc_before(impact).closed
    return [one for one in closed if one != impact.stop and not _moves(graph, one, impact)]


def struck_view(graph: GraphDynamics, period: Period, impact: Impact) -> HybridDynamics:
    """Return the system of an impact, with the closed stops that the impact does not open.

    Args:
        graph: The graph of modes.
        period: The period.
        impact: The impact.
    """
    sides = period.arc_before(impact).sides
    mode = graph.mode_of(kept_stops(graph, period, impact), sides)
    return graph.view(mode, graph.stop_names.index(impact.stop))


def _moves(graph: GraphDynamics, name: str, impact: Impact) -> bool:
    """Return True if a closed stop has a gap rate before or after an impact."""
    view = graph.view(graph.open_mode, graph.stop_names.index(name))
    rates = (view.gap_rate(x) for x in (impact.state_minus, impact.state_plus))
    return max(map(abs, rates)) > _KEEPS * abs(impact.approach_rate)
