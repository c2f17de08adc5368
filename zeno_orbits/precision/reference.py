"""The reference of trials: an execution at the tightest tolerance, with its error."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, ZenoOrbitsError
from zeno_orbits.integrators import Automatic, Radau
from zeno_orbits.model import HybridDynamics
from zeno_orbits.precision.accuracy import at_tolerance
from zeno_orbits.precision.landmark import (
    ROUNDING,
    Landmark,
    apart,
    landmarks,
    sizes_of,
)
from zeno_orbits.simulation import SimulationSettings, simulate

_FINEST, _NEXT = 1e-14, 1e-13

_SAMPLES = 64
"""Number of times at which the size of the states is evaluated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """Reference solution with which trials are compared.

    Attributes:
        marks: The landmarks.
        scale: Size of each state, ``(n_x,)``.
        how: Way in which they were computed, as a phrase.
        error: Their estimated error.
    """

    marks: tuple[Landmark, ...]
    scale: Vector
    how: str
    error: float


def true_landmarks(dynamics: HybridDynamics, state: Sequence[float], until: float) -> Truth:
    """Return the landmarks of an execution by Radau's method, with their error.

    The error is the largest difference from a run at a looser tolerance and from a run with the
    default integrator, and at least rounding.

    Args:
        dynamics: The system at fixed parameter values.
        state: Initial state, ``(n_x,)``.
        until: End of the execution [s].

    Raises:
        InputError: If the state is not admissible or the horizon not a positive number.
        ZenoOrbitsError: If the execution lacks events, or cannot be followed.
    """
    if not 0.0 < until < math.inf:
        wanted = "must be a finite, positive number of seconds"
        raise InputError(f"Argument `until` {wanted}, but it is {until}.")
    finest, *others = (
        simulate(dynamics, state, until=until, settings=at_tolerance(tolerance, settings))
        for tolerance, settings in (
            (_FINEST, SimulationSettings(engine=Radau())),
            (_NEXT, SimulationSettings(engine=Radau())),
            (_FINEST, SimulationSettings(engine=Automatic())),
        )
    )
    marks = landmarks(finest)
    if marks[0].kind is None:
        raise ZenoOrbitsError(
            f"There is nothing to compare: no event within {until:g} s. Choose a longer `until`."
        )
    samples = map(finest.state_at, np.linspace(0.0, finest.end_time, _SAMPLES).tolist())
    scale = sizes_of(list(samples), dynamics.own)
    return Truth(
        marks=marks,
        scale=scale,
        how=f"double precision at {_FINEST:.0e} by an implicit method",
        error=max(ROUNDING, *(apart(landmarks(other), marks, scale) for other in others)),
    )
