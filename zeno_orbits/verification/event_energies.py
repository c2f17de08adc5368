r"""Energies of one period of a machine with several stops or switches.

The powers are integrated along the stored flow of every arc. Impacts and Zeno points lose energy by
Newton's law with the inertia beside the stops that stay closed, and a reset of a switch changes the
energy as its states:

.. math:: \int P_{\mathrm{in}}\,dt = E(T) - E(0) + \int P_{\mathrm{loss}}\,dt
    + \sum \tfrac12 m_n (1 - e^2)\,\dot h^2 + \sum \bigl(E^- - E^+\bigr)_{\mathrm{switches}}
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.model import GraphDynamics, GraphMode
from zeno_orbits.simulation import Arc, Event, Impact, SwitchEvent, ZenoPoint
from zeno_orbits.verification.residuals import lawful_impact

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(6)
"""Gauss's rule on every step of the integrator: its error is far below that of the step."""


def event_energies(
    graph: GraphDynamics, arcs: Sequence[Arc], events: Sequence[Event], start: Vector, end: Vector
) -> dict[str, float]:
    """Return the energies of one period [J].

    Args:
        graph: The graph of modes.
        arcs: The arcs of the period.
        events: Its events.
        start: State at its start, ``(n_x,)``.
        end: State at its end, ``(n_x,)``.

    Returns:
        Energy by name, as in the certificate. ``switch_loss`` exists if there are switches.
    """
    impacts = [event for event in events if isinstance(event, Impact)]
    zenos = [event for event in events if isinstance(event, ZenoPoint)]
    worked = np.sum([_work(graph, arc, zenos) for arc in arcs], axis=0)
    switches = [event for event in events if isinstance(event, SwitchEvent)]
    lost = sum(_impact_loss(graph, arcs, impact) for impact in impacts)
    lost += sum(_tail_loss(graph, arcs, zeno) for zeno in zenos)
    found = {
        "input_work": float(worked[0]),
        "copper_loss": float(worked[1]),
        "other_loss": float(worked[2]),
        "impact_loss": float(lost),
        "energy_gain": graph.first.energy(end) - graph.first.energy(start),
    }
    if switches:
        found["switch_loss"] = sum(
            graph.first.energy(one.state_minus) - graph.first.energy(one.state_plus)
            for one in switches
        )
    return found


def is_balanced(graph: GraphDynamics) -> bool:
    """Return True if all powers are given, so that the energy balance can be checked.

    Args:
        graph: The graph of modes.
    """
    return graph.compiled.system(graph.open_mode, 0).is_balanced


def _work(graph: GraphDynamics, arc: Arc, zenos: Sequence[ZenoPoint]) -> Vector:
    """Return the input work and both losses along an arc, ``(3,)`` [J]."""
    mode, stop = graph.some_stop(graph.mode_of(arc.closed, arc.sides))
    if arc.trajectory is None:
        struck = min(zenos, key=lambda zeno: abs(zeno.time - arc.end_time)).stop
        stop = graph.stop_names.index(struck)
    powers = graph.compiled.system(mode, stop).powers

    def power(x: Vector) -> Vector:
        return powers(x, graph.p).full().ravel()

    if arc.trajectory is None:
        # In the tail of an impact sequence the mean of the gap rate is zero.
        rested = graph.view(mode, stop).resting(arc.start_state).state
        return (arc.end_time - arc.start_time) / 2 * (power(rested) + power(arc.end_state))
    n_x, total = len(arc.start_state), np.zeros(3)
    for begin, end in pairwise(arc.trajectory.times):
        half = (end - begin) / 2
        for node, weight in zip(_NODES, _WEIGHTS, strict=True):
            x = arc.flow_state_at(float(begin + half * (1 + node)))[:n_x]
            total += arc.time_unit * half * weight * power(x)
    return total


def _kept(graph: GraphDynamics, arcs: Sequence[Arc], event: Impact | ZenoPoint) -> GraphMode:
    """Return the stops that are closed on both sides of an event beside its own, and the kinks."""
    before = next((a for a in arcs if a.end_time >= event.time), arcs[-1])
    after = next((a for a in arcs if a.start_time >= event.time), before)
    names = [name for name in after.closed if name in before.closed and name != event.stop]
    return graph.mode_of(names, after.sides)


def _impact_loss(graph: GraphDynamics, arcs: Sequence[Arc], impact: Impact) -> float:
    """Return the energy that an impact loses by Newton's law [J]."""
    view = graph.view(_kept(graph, arcs, impact), graph.stop_names.index(impact.stop))
    return lawful_impact(view, impact)[1]


def _tail_loss(graph: GraphDynamics, arcs: Sequence[Arc], zeno: ZenoPoint) -> float:
    """Return the kinetic energy that the tail of an impact sequence loses [J]."""
    view = graph.view(_kept(graph, arcs, zeno), graph.stop_names.index(zeno.stop))
    return view.normal_inertia(zeno.state) * zeno.last_speed**2 / 2
