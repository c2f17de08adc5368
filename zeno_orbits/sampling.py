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
        InputError: If the rate or the noise is not positive, or there are fewer than two samples.
    """
    if not (math.isfinite(rate) and rate > 0.0):
        raise InputError(f"Argument `rate` must be a positive number of Hz, but it is {rate:g}.")
    if not (math.isfinite(noise) and noise >= 0.0):
        raise InputError(f"Argument `noise` must be a number from 0 on, but it is {noise:g}.")
    if not rate * execution.end_time >= 1.0:
        wanted = f"must give two samples or more in {execution.end_time:g} s"
        raise InputError(f"Argument `rate` {wanted}, but it is {rate:g} Hz.")
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
