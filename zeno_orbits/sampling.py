"""An execution as instruments would record it: samples of its states, with noise if wanted."""

from __future__ import annotations

import math

import numpy as np

from zeno_orbits.cycle_tables import state_nodes
from zeno_orbits.dynamics import HybridDynamics
from zeno_orbits.errors import InputError
from zeno_orbits.execution import Execution
from zeno_orbits.problem import Problem
from zeno_orbits.recordings import Recording, Signal, Source

MOST_SAMPLES = 10_000_000
"""Samples of a recording at most; ten of each state take a gigabyte."""

_MOST_NOISE = 1e6
"""Noise in parts of a state's range beyond which nothing is left of the state."""


def require_samples(duration: float, rate: float, noise: float) -> None:
    """Refuse a recording that cannot be made, before any work is done for it.

    Args:
        duration: How long it lasts [s].
        rate: Samples a second [Hz].
        noise: In parts of the range of each state.

    Raises:
        InputError: If the rate is not positive or gives fewer than two samples, or too many, or the
            noise is negative or out of bounds.
    """
    if not (math.isfinite(rate) and rate > 0.0):
        raise InputError(f"Argument `rate` must be a positive number of Hz, but it is {rate:g}.")
    if not 0.0 <= noise <= _MOST_NOISE:
        wanted = f"must be a number from 0 on, up to {_MOST_NOISE:g}"
        raise InputError(f"Argument `noise` {wanted}, but it is {noise:g}.")
    if not rate * duration >= 1.0:
        wanted = f"must give two samples or more in {duration:g} s"
        raise InputError(f"Argument `rate` {wanted}, but it is {rate:g} Hz.")
    if rate * duration > MOST_SAMPLES:
        wanted = f"must give {MOST_SAMPLES} samples or fewer in {duration:g} s"
        raise InputError(f"Argument `rate` {wanted}, but it is {rate:g} Hz.")


def sampled(
    problem: Problem,
    dynamics: HybridDynamics,
    execution: Execution,
    *,
    rate: float,
    noise: float = 0.0,
    seed: int = 0,
) -> Recording:
    """Return the states of an execution at even times.

    Args:
        problem: The scene.
        dynamics: The system that was simulated.
        execution: What to record.
        rate: Samples a second [Hz].
        noise: Standard deviation of the noise on each state, in parts of the range of that.
        seed: Of the noise.

    Raises:
        InputError: As `require_samples` does.
    """
    require_samples(execution.end_time, rate, noise)
    time = np.arange(math.floor(rate * execution.end_time * (1 + 1e-12)) + 1) / rate
    values = state_nodes(dynamics, execution.arcs).at(np.minimum(time, execution.end_time))
    values = values[:, : len(problem.state_names)]
    extent = np.ptp(values, axis=0)
    values = values + noise * extent * np.random.default_rng(seed).normal(size=values.shape)
    signals = tuple(
        Signal(name=name, unit=unit, values=values[:, k].copy())
        for k, (name, unit) in enumerate(zip(problem.state_names, problem.state_units, strict=True))
    )
    return Recording(
        source=Source.SIMULATED,
        scene=problem.name,
        time=time,
        signals=signals,
        notes={"noise": f"{noise:g}", "seed": str(seed)} if noise else {},
    )
