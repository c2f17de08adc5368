"""The reference of trials: an execution in many digits, with its error."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from zeno_orbits.arrays import Vector
from zeno_orbits.errors import InputError, TranslationError, ZenoOrbitsError
from zeno_orbits.integrators import Radau
from zeno_orbits.model import HybridDynamics, ParameterValues, Problem
from zeno_orbits.precision.accuracy import at_tolerance
from zeno_orbits.precision.landmark import (
    ROUNDING,
    Kind,
    Landmark,
    apart,
    landmarks,
    sizes,
    sizes_of,
)
from zeno_orbits.simulation import SimulationSettings, simulate

if TYPE_CHECKING:
    from zeno_orbits.precision.extended import ExtendedExecution

TRUTH_DIGITS = 20

_SAMPLES = 64
"""Times at which the truth is looked at for the size of its states."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """Reference that trials are compared with.

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


def true_landmarks(
    problem: Problem,
    values: ParameterValues,
    dynamics: HybridDynamics,
    state: Sequence[float],
    until: float,
) -> Truth:
    """Return the truth in extended precision, or in doubles where that cannot be had.

    Args:
        problem: The problem.
        values: Its numbers.
        dynamics: The system at these numbers.
        state: Initial state, ``(n_x,)``.
        until: When to stop [s].

    Raises:
        InputError: If the state is not admissible or the horizon not a positive number.
        ZenoOrbitsError: If nothing happens that a motion could be judged by, or it cannot be
            followed.
    """
    if not 0.0 < until < math.inf:
        message = f"Argument `until` must be a positive number of seconds, but it is {until}."
        raise InputError(message)
    if find_spec("flint") is None:
        return _truth_in_doubles(dynamics, state, until, "install the extra `proof` for a better")
    from zeno_orbits.precision.extended import extended_execution

    try:
        exact = extended_execution(
            problem,
            values,
            state,
            until=until,
            times=np.linspace(0.0, until, _SAMPLES).tolist(),
            digits=TRUTH_DIGITS,
        )
    except TranslationError:
        return _truth_in_doubles(
            dynamics, state, until, "not all of the problem is analytic, for a better"
        )
    return Truth(
        marks=_exact_landmarks(exact),
        scale=sizes_of([list(map(float, sample.state)) for sample in exact.samples], dynamics.own),
        how="extended precision",
        error=exact.error,
    )


def _truth_in_doubles(
    dynamics: HybridDynamics, state: Sequence[float], until: float, why: str
) -> Truth:
    """Return the truth of the tightest tolerances, of an engine that the default one is not."""
    implicit = SimulationSettings(engine=Radau())
    finest, next_finest = (
        simulate(dynamics, state, until=until, settings=at_tolerance(tolerance, implicit))
        for tolerance in (1e-14, 1e-13)
    )
    marks, scale = landmarks(finest), sizes(finest, dynamics.own)
    return Truth(
        marks=marks,
        scale=scale,
        how=f"double precision at 1e-14 ({why} truth)",
        error=max(apart(landmarks(next_finest), marks, scale), ROUNDING),
    )


def _exact_landmarks(exact: ExtendedExecution) -> tuple[Landmark, ...]:
    points = exact.releases or exact.zeno_points
    if not points:
        raise ZenoOrbitsError(
            "There is nothing to compare: no release and no Zeno point in this time."
        )
    kind = Kind.RELEASE if exact.releases else Kind.ZENO
    return tuple(
        Landmark(kind=kind, time=float(p.time), state=np.array([float(v) for v in p.state]))
        for p in points
    )
