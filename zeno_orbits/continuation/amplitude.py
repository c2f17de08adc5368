"""The amplitude of an orbit of a family, of the state that its problem names."""

from __future__ import annotations

import math

import numpy as np

from zeno_orbits.continuation.families import Family, FamilyPoint
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.model import Problem
from zeno_orbits.simulation import extent_of, simulate

_SHORT = 1e-3
"""Part of the period below which an arc has no extremes but those of its neighbours."""


def orbit_amplitude(problem: Problem, family: Family, point: FamilyPoint) -> float:
    """Return half the travel of a problem's `amplitude_of` state over a period of an orbit.

    The orbit is simulated for one period from its state on the section.

    Args:
        problem: The problem.
        family: A family of it.
        point: A point of the family; at an end, the limit of its orbits.

    Returns:
        The amplitude in the unit of the state; NaN if the orbit cannot be simulated, which may
        happen at the limit of an end.
    """
    values = problem.values(gains=family.gains, parameters=family.parameters)
    dynamics = problem.dynamics(values.replaced({family.parameter: point.value}))
    try:
        run = simulate(dynamics, np.array(problem.state_vector(point.state)), until=point.period)
    except ZenoOrbitsError:
        return math.nan
    index = problem.state_names.index(problem.amplitude_of)
    arcs = [arc for arc in run.arcs if arc.duration > _SHORT * point.period]
    extent = extent_of(lambda x: float(x[index]), arcs)
    return (extent.highest - extent.lowest) / 2
