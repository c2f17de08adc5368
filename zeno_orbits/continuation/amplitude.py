"""The amplitude of an orbit of a family, in the state that its problem names."""

from __future__ import annotations

import math

import numpy as np

from zeno_orbits.continuation.families import Family, FamilyPoint
from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.model import Problem
from zeno_orbits.simulation import extent_of, simulate

_SHORT = 1e-3
"""Part of the period below which the extremes of an arc are taken from its neighbours."""


def orbit_amplitude(problem: Problem, family: Family, point: FamilyPoint) -> float:
    """Return half the range of a problem's `amplitude_of` state over a period of an orbit.

    The orbit is simulated for one period from its state on the section.

    Args:
        problem: The problem.
        family: A family of the problem.
        point: A point of the family. At an end, it is the limit of the orbits.

    Returns:
        The amplitude in the unit of the state. It is NaN if the orbit cannot be simulated, which
        may happen at an end.
    """
    values = problem.values(gains=family.gains, parameters=family.parameters)
    numbers = values.replaced({family.parameter: point.value})
    try:
        run = simulate(
            problem.system(numbers), np.array(problem.state_vector(point.state)), until=point.period
        )
    except ZenoOrbitsError:
        return math.nan
    index = problem.state_names.index(problem.amplitude_of)
    arcs = [arc for arc in run.arcs if arc.duration > _SHORT * point.period]
    extent = extent_of(lambda x: float(x[index]), arcs)
    return (extent.highest - extent.lowest) / 2
