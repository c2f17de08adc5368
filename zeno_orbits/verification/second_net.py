"""A second check for missed events: bounded steps, with sampled event functions.

The integration of a certificate searches for zero crossings of the gap and of the multiplier. This
check does not search for events. It integrates every arc again, with the automatic integrator and
steps of at most 1/2000 of the period. The gap and the multiplier are sampled at each step. After a
missed event, the gap or the multiplier is negative.
"""

from __future__ import annotations

import math

import numpy as np

from zeno_orbits.errors import ZenoOrbitsError
from zeno_orbits.integrators import Automatic, Radau, RungeKutta, Tolerance
from zeno_orbits.model import HybridDynamics
from zeno_orbits.simulation import Mode, states_after_steps
from zeno_orbits.verification.integration import FirstCycle

SAMPLES = 2000
"""Least number of steps per period."""

_TOLERANCE = Tolerance(relative=1e-11, absolute=1e-12)
"""Local error of a step. It is ten times the usual error, so that accuracy-limited steps differ."""


def sampled_guards(dynamics: HybridDynamics, first: FirstCycle) -> dict[str, float]:
    """Return `penetration` and `adhesion` of a period, from different, bounded steps.

    Args:
        dynamics: The system.
        first: The period and its sizes.

    Returns:
        The deepest gap below zero in flight, in units of the largest gap, and the largest pull on
        the stop, in units of the largest multiplier. Infinite if an arc cannot be integrated.
    """
    deepest, pull = 0.0, 0.0
    longest = first.cycle.end.time / SAMPLES
    engine = Automatic(
        explicit=RungeKutta(largest_step=longest), implicit=Radau(largest_step=longest)
    )
    try:
        for arc in first.cycle.execution.arcs:
            if arc.trajectory is None:
                continue
            flow = dynamics.free if arc.mode is Mode.FREE else dynamics.locked
            states = states_after_steps(
                flow,
                engine,
                arc.start_state,
                _TOLERANCE.times(dynamics.own.least),
                arc.end_time - arc.start_time,
            )
            below = -float(np.min(flow.guards(states), initial=0.0))
            if arc.mode is Mode.FREE:
                deepest = max(deepest, below)
            else:
                pull = max(pull, below)
    except ZenoOrbitsError:
        return {"penetration": math.inf, "adhesion": math.inf}
    return {"penetration": deepest / first.gap, "adhesion": pull / first.force}
