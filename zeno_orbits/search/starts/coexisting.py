"""Attractors that coexist at the same values, found from a set of initial states.

A search varies gains and parameters. The attractor also depends on the initial state. At the values
of the best orbit, motions are therefore simulated from states all over a box around the orbit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.maps import ORBITS, Attractor, attractors_at
from zeno_orbits.model import (
    GraphDynamics,
    ParameterValues,
    Problem,
)
from zeno_orbits.orbits import EventReturn, Orbit
from zeno_orbits.search.closing.closing import settled_return
from zeno_orbits.search.search_problem import SearchProblem
from zeno_orbits.search.starts.scan import ACCURACY
from zeno_orbits.simulation import Execution, simulate

N_STATES = 24
"""Initial states from which motions start."""
_MOST_DRAWN = 8 * N_STATES
_ORBITS_ONLY = replace(ACCURACY, exponents=False)
_WIDER = 1.0
"""Margin of the box of states on either side, in units of the state's range over the orbit."""
_PARTS = np.linspace(0.0, 1.0, 9)
_SAME = 1e-3
"""Two attractors are the same if their first states differ by less, in units of the box."""


def coexisting_orbits(search: SearchProblem, orbit: Orbit) -> list[EventReturn]:
    """Return each attractor at the values of an orbit, possibly including this orbit.

    Args:
        search: The search, with its problem, shape and time limit.
        orbit: The orbit.

    Returns:
        Orbits in the order in which the initial states led to them. Attractors that are not
        periodic orbits of the requested shape are omitted.
    """
    problem, values = search.problem, orbit.values(search.problem)
    found: list[EventReturn] = []
    for one in _attractors(search, values, problem.graph_dynamics(values), orbit):
        try:
            settled = settled_return(
                problem,
                values,
                starts=(one.state,),
                section=search.section,
                shape=search.shape,
                simulation=search.settings.simulation,
            )
        except ZenoOrbitsError:
            # The approximate attractor of a short simulation may be none.
            continue
        found.append(settled)
    return found


def _attractors(
    search: SearchProblem, values: ParameterValues, graph: GraphDynamics, orbit: Orbit
) -> list[Attractor]:
    """Return the periodic attractors at the values of an orbit, in the order of initial states."""
    problem, settings = search.problem, search.settings
    start = np.array(problem.state_vector(orbit.start_state))
    first = graph.first
    if first.holonomic(start).size > bool(first.clock):
        # If a mechanism has constraints of its own, its states cannot be sampled from a box.
        return []
    low, high = _box(simulate(graph, start, until=orbit.period, past=orbit.past_switch), start.size)
    found: list[Attractor] = []
    for state in _states(graph, low, high, settings.seed):
        one = _attractor(problem, values, state, settings.settling.horizon)
        if one is not None and not any(_alike(problem, one, other, high - low) for other in found):
            found.append(one)
    return found


def _attractor(
    problem: Problem, values: ParameterValues, state: Vector, until: float | None
) -> Attractor | None:
    """Return the attractor from a state if it is a periodic orbit."""
    start = dict(zip(problem.state_names, state.tolist(), strict=True))
    try:
        (one,) = attractors_at(problem, [values], start=start, until=until, accuracy=_ORBITS_ONLY)
    except ZenoOrbitsError:
        return None
    return one if one.fate in ORBITS and one.state else None


def _alike(problem: Problem, one: Attractor, other: Attractor, widths: Vector) -> bool:
    if (one.fate, one.returns, one.sequence) != (other.fate, other.returns, other.sequence):
        return False
    first, second = (np.array(problem.state_vector(a.state)) for a in (one, other))
    return bool(np.all(np.abs(first - second) <= _SAME * widths))


def _box(run: Execution, n_x: int) -> tuple[Vector, Vector]:
    """Return the box of states around one period of an orbit, both ends ``(n_x,)``."""
    states = np.array(
        [
            arc.flow_state_at(float(part) * arc.duration)[:n_x]
            for arc in run.arcs
            if arc.trajectory is not None
            for part in _PARTS
        ]
    )
    low, high = states.min(axis=0), states.max(axis=0)
    wider = _WIDER * (high - low)
    return low - wider, high + wider


def _is_off_the_stops(graph: GraphDynamics, state: Vector) -> bool:
    return all(view.gap(state) > 0.0 for view in graph.open_views)


def _states(graph: GraphDynamics, low: Vector, high: Vector, seed: int) -> Iterator[Vector]:
    """Yield states of a box that are not in contact, with the clock on its unit circle."""
    from scipy.stats import qmc

    clock = graph.first.clock
    n_found = 0
    for place in qmc.Halton(low.size, seed=seed).random(_MOST_DRAWN):
        state = low + place * (high - low)
        if clock:
            cosine, sine = clock
            angle = 2 * math.pi * place[cosine]
            state[cosine], state[sine] = math.cos(angle), math.sin(angle)
        if not _is_off_the_stops(graph, state):
            continue
        n_found += 1
        yield state
        if n_found == N_STATES:
            return
