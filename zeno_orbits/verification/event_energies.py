r"""Energies of one period of a machine with several stops or switches.

The powers are integrated along the stored flow of every arc. Impacts and Zeno points lose energy by
Newton's law with the inertia beside the stops that stay closed, and a reset of a switch changes the
energy as its states:

.. math:: \int P_{\mathrm{in}}\,dt = E(T) - E(0) + \int P_{\mathrm{loss}}\,dt
    + \sum \tfrac12 m_n (1 - e^2)\,\dot h^2 + \sum \bigl(E^- - E^+\bigr)_{\mathrm{switches}}
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model import GraphDynamics, HybridDynamics
from zeno_orbits.simulation import Arc, Event, Impact, SwitchEvent, ZenoPoint
from zeno_orbits.verification.cross_checks import PeriodEnergies, largest_kinetic
from zeno_orbits.verification.residuals import lawful_impact

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(6)
"""Gauss's rule on every step of the integrator: its error is far below that of the step."""
_KEEPS = 1e-9
"""Gap rate of a stop beside an impact, relative to the gap rate of the impact, that is rounding."""


def event_energies(
    graph: GraphDynamics, arcs: Sequence[Arc], events: Sequence[Event], start: Vector, end: Vector
) -> PeriodEnergies:
    """Return the energies of one period. ``switch_loss`` exists if there are switches.

    Args:
        graph: The graph of modes.
        arcs: The arcs of the period.
        events: Its events.
        start: State at its start, ``(n_x,)``.
        end: State at its end, ``(n_x,)``.
    """
    impacts = [event for event in events if isinstance(event, Impact)]
    zenos = [event for event in events if isinstance(event, ZenoPoint)]
    worked = np.sum([_work(graph, arc, zenos) for arc in arcs], axis=0)
    switches = [event for event in events if isinstance(event, SwitchEvent)]
    lost = sum(_impact_loss(graph, arcs, impact) for impact in impacts)
    lost += sum(_tail_loss(graph, arcs, zeno) for zeno in zenos)
    net, gross = worked
    found = {
        "input_work": float(net[0]),
        "copper_loss": float(net[1]),
        "other_loss": float(net[2]),
        "impact_loss": float(lost),
        "energy_gain": graph.first.energy(end) - graph.first.energy(start),
    }
    if switches:
        found["switch_loss"] = sum(
            graph.first.energy(one.state_minus) - graph.first.energy(one.state_plus)
            for one in switches
        )
    largest = max(largest_kinetic(graph.first, arcs), float(np.max(gross)))
    return PeriodEnergies(values=found, largest=largest)


def is_balanced(graph: GraphDynamics) -> bool:
    """Return True if all powers are given, so that the energy balance can be checked.

    Args:
        graph: The graph of modes.
    """
    return graph.compiled.system(graph.open_mode, 0).is_balanced


def _work(graph: GraphDynamics, arc: Arc, zenos: Sequence[ZenoPoint]) -> Vector:
    """Return the input work and both losses along an arc, and with moduli of powers, ``(2, 3)``."""
    mode, stop = graph.some_stop(arc.mode_in(graph))
    if arc.trajectory is None:
        struck = min(zenos, key=lambda zeno: abs(zeno.time - arc.end_time)).stop
        stop = graph.stop_names.index(struck)
        # In the tail of an impact sequence the mean of the gap rate is zero.
        rested = graph.view(mode, stop).resting(arc.start_state).state
        states, weights = np.array([rested, arc.end_state]), np.full(2, arc.duration / 2)
    else:
        times = arc.trajectory.times
        halves = np.diff(times)[:, None] / 2
        offsets = (times[:-1, None] + halves * (1 + _NODES)).ravel()
        states = arc.flow_states_at(offsets)[:, : len(arc.start_state)]
        weights = arc.time_unit * (halves * _WEIGHTS).ravel()
    every = graph.compiled.system(mode, stop).powers.map(len(states))
    powers = every(states.T, np.tile(graph.p[:, None], len(states))).full()
    return np.array([powers @ weights, np.abs(powers) @ weights])


def _before(arcs: Sequence[Arc], event: Impact | ZenoPoint) -> Arc:
    """Return the arc that ends at an event."""
    return next((arc for arc in arcs if arc.end_time >= event.time), arcs[-1])


def _impact_loss(graph: GraphDynamics, arcs: Sequence[Arc], impact: Impact) -> float:
    """Return the energy that an impact loses by Newton's law [J]."""
    return lawful_impact(struck_view(graph, arcs, impact), impact)[1]


def kept_stops(graph: GraphDynamics, arcs: Sequence[Arc], impact: Impact) -> list[str]:
    """Return the names of the closed stops that an impact does not open.

    Args:
        graph: The graph of modes.
        arcs: The arcs of the period.
        impact: The impact.
    """
    closed = _before(arcs, impact).closed
    return [one for one in closed if one != impact.stop and not _moves(graph, one, impact)]


def struck_view(graph: GraphDynamics, arcs: Sequence[Arc], impact: Impact) -> HybridDynamics:
    """Return the system of an impact, with the closed stops that the impact does not open.

    Args:
        graph: The graph of modes.
        arcs: The arcs of the period.
        impact: The impact.
    """
    mode = graph.mode_of(kept_stops(graph, arcs, impact), _before(arcs, impact).sides)
    return graph.view(mode, graph.stop_names.index(impact.stop))


def _moves(graph: GraphDynamics, name: str, impact: Impact) -> bool:
    """Return True if a closed stop has a gap rate before or after an impact."""
    view = graph.view(graph.open_mode, graph.stop_names.index(name))
    rates = (view.gap_rate(x) for x in (impact.state_minus, impact.state_plus))
    return max(map(abs, rates)) > _KEEPS * abs(impact.approach_rate)


def _tail_loss(graph: GraphDynamics, arcs: Sequence[Arc], zeno: ZenoPoint) -> float:
    """Return the kinetic energy that the tail of an impact sequence loses [J]."""
    arc = _before(arcs, zeno)
    kept = [name for name in arc.closed if name != zeno.stop]
    view = graph.view(graph.mode_of(kept, arc.sides), graph.stop_names.index(zeno.stop))
    return view.normal_inertia(zeno.state) * zeno.last_speed**2 / 2
