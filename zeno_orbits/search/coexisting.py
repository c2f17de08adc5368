"""Attractors that coexist at the same values, found from a set of initial states.

A search varies gains and parameters. The attractor also depends on the initial state. At the values
of the best orbit, motions are therefore simulated from states all over a box around the orbit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.maps import Attractor, attractors_at
from zeno_orbits.model import HybridDynamics, ParameterValues
from zeno_orbits.orbits import Cycle, ZenoOrbit
from zeno_orbits.search.scan import ACCURACY, PHASE, cycle_at, is_of_shape
from zeno_orbits.search.search_problem import SearchProblem
from zeno_orbits.simulation import simulate

N_STATES = 24
"""Initial states from which motions start."""
_MOST_DRAWN = 8 * N_STATES
_WIDER = 1.0
"""Margin of the box of states on either side, in units of the state's range over the orbit."""
_PARTS = np.linspace(0.0, 1.0, 9)
_SAME = 1e-3
"""Two attractors are the same if their first states differ by less, in units of the box."""


def coexisting_cycles(search: SearchProblem, orbit: ZenoOrbit) -> list[Cycle]:
    """Return a period of each attractor at the values of an orbit, possibly including this orbit.

    Args:
        search: The search, with its problem, shape and time limit.
        orbit: The orbit.

    Returns:
        Periods in the order in which the initial states led to them. Attractors that are not
        periodic orbits of the requested shape are omitted.
    """
    problem, values = search.problem, orbit.values(search.problem)
    dynamics = problem.dynamics(values)
    if dynamics.holonomic(np.array(problem.state_vector(orbit.start_state))).size > bool(
        dynamics.clock
    ):
        # If a mechanism has constraints of its own, its states cannot be sampled from a box.
        return []
    low, high = _box(search, orbit, dynamics)
    found: list[Attractor] = []
    for state in _states(dynamics, low, high, search.settings.seed):
        one = _attractor(search, values, state)
        if one is not None and not any(_alike(search, one, other, high - low) for other in found):
            found.append(one)
    cycles: list[Cycle] = []
    for one in found:
        try:
            cycles.append(cycle_at(search, values, one))
        except ZenoOrbitsError:
            continue
    return cycles


def _attractor(search: SearchProblem, values: ParameterValues, state: Vector) -> Attractor | None:
    """Return the attractor from a state if it is a periodic orbit of the requested shape."""
    start = dict(zip(search.problem.state_names, state.tolist(), strict=True))
    try:
        (one,) = attractors_at(
            search.problem,
            [values],
            start=start,
            until=search.settings.settling.horizon,
            accuracy=ACCURACY,
        )
    except ZenoOrbitsError:
        return None
    if one.fate not in PHASE or not one.state:
        return None
    return one if search.shape is None or is_of_shape(one, search.shape) else None


def _alike(search: SearchProblem, one: Attractor, other: Attractor, widths: Vector) -> bool:
    if (one.fate, one.returns) != (other.fate, other.returns):
        return False
    first, second = (np.array(search.problem.state_vector(a.state)) for a in (one, other))
    return bool(np.all(np.abs(first - second) <= _SAME * widths))


def _box(
    search: SearchProblem, orbit: ZenoOrbit, dynamics: HybridDynamics
) -> tuple[Vector, Vector]:
    """Return the box of states around an orbit, both ends ``(n_x,)``."""
    start = np.array(search.problem.state_vector(orbit.start_state))
    run = simulate(dynamics, start, until=orbit.period)
    states = np.array(
        [
            arc.flow_state_at(float(part) * arc.duration)[: start.size]
            for arc in run.arcs
            if arc.trajectory is not None
            for part in _PARTS
        ]
    )
    low, high = states.min(axis=0), states.max(axis=0)
    wider = _WIDER * (high - low)
    return low - wider, high + wider


def _states(dynamics: HybridDynamics, low: Vector, high: Vector, seed: int) -> Iterator[Vector]:
    """Yield states of a box that are not in contact, with the clock on its unit circle."""
    from scipy.stats import qmc

    n_found = 0
    for place in qmc.Halton(low.size, seed=seed).random(_MOST_DRAWN):
        state = low + place * (high - low)
        if dynamics.clock:
            cosine, sine = dynamics.clock
            angle = 2 * math.pi * place[cosine]
            state[cosine], state[sine] = math.cos(angle), math.sin(angle)
        if dynamics.gap(state) <= 0.0:
            continue
        n_found += 1
        yield state
        if n_found == N_STATES:
            return
