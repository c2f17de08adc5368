"""Quantities of an orbit from its data alone: a plain simulation and the checks of `verify`."""

from __future__ import annotations

import numpy as np

from zeno_orbits.model import Problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.simulation import Extent, extent_of, signal, signal_names, simulate
from zeno_orbits.verification import claimed_start, multipliers_of, verify


def measured(orbit: Orbit, problem: Problem, name: str) -> Extent:
    """Return the range of a signal, a margin or a number of an orbit over one period."""
    values = orbit.values(problem)
    if name in signal_names(problem.compiled()):
        graph = problem.graph_dynamics(values)
        start = claimed_start(orbit, problem, graph)
        run = simulate(graph, np.asarray(start), until=orbit.period, past=orbit.past_switch)
        return extent_of(signal(problem.compiled(), name).at(values.vector), run.arcs)
    if name == "period":
        value = orbit.period
    elif name == "spectral_radius":
        value = multipliers_of(orbit, problem).spectral_radius
    elif name == "energy":
        value = verify(orbit, problem).energies["input_work"]
    else:
        value = verify(orbit, problem).margins[name]
    return Extent(lowest=value, highest=value, error=0.0)
