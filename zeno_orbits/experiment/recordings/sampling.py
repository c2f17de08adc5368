"""Recordings made from a simulated execution: samples of its states with optional noise."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from zeno_orbits.errors import InputError
from zeno_orbits.experiment.recordings.recording import RecordedSignal, Recording, Source
from zeno_orbits.model import Problem
from zeno_orbits.simulation import Execution
from zeno_orbits.work import require_kinds

MOST_SAMPLES = 10_000_000
"""Largest number of samples of a recording. Ten million samples of each state take a gigabyte."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sampling:
    """Rate and noise of a simulated recording.

    Attributes:
        rate: Samples a second [Hz].
        noise: Standard deviation of the noise on each state, in parts of the range of that.
        seed: Random seed of the noise.
    """

    rate: float
    noise: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse rates, noise and seeds that mean nothing."""
        require_kinds(self)
        if not (math.isfinite(self.rate) and self.rate > 0.0):
            wanted = "must be a positive number of Hz"
            raise InputError(f"Argument `rate` {wanted}, but it is {self.rate:g}.")
        require_share(self.noise)
        if self.seed < 0:
            raise InputError(f"Argument `seed` must be at least 0, but it is {self.seed}.")

    def count(self, time: float) -> int:
        """Return the number of samples in a duration.

        Args:
            time: Duration [s].

        Raises:
            InputError: If there are fewer than two, or too many to write.
        """
        samples = self.rate * time * (1 + 1e-12)
        if not 1.0 <= samples < MOST_SAMPLES:
            wanted = f"must give two to {MOST_SAMPLES} samples in {time:g} s"
            raise InputError(f"Argument `rate` {wanted}, but it is {self.rate:g} Hz.")
        return math.floor(samples) + 1


def require_share(noise: float) -> None:
    """Refuse noise as large as the signal, of which nothing would be left.

    Args:
        noise: Standard deviation of the noise, relative to the range of the signal.

    Raises:
        InputError: If the value is not in [0, 1).
    """
    if not 0.0 <= noise < 1.0:
        wanted = "must lie in [0, 1), relative to the range of each signal"
        raise InputError(f"Argument `noise` {wanted}, but it is {noise:g}.")


def sampled(problem: Problem, execution: Execution, sampling: Sampling) -> Recording:
    """Return the states of an execution at evenly spaced times.

    Args:
        problem: The problem.
        execution: The execution to record.
        sampling: Sampling interval and noise.

    Raises:
        InputError: If there are fewer than two samples, or too many.
    """
    time = np.arange(sampling.count(execution.end_time)) / sampling.rate
    time_inside = np.minimum(time, execution.end_time)
    values = execution.states_at(time_inside)[:, : len(problem.state_names)]
    extent = np.ptp(values, axis=0)
    random = np.random.default_rng(sampling.seed)
    values = values + sampling.noise * extent * random.normal(size=values.shape)
    signals = tuple(
        RecordedSignal(name=name, unit=unit, values=values[:, k].copy())
        for k, (name, unit) in enumerate(zip(problem.state_names, problem.state_units, strict=True))
    )
    noisy = {"noise": f"{sampling.noise:g}", "seed": str(sampling.seed)}
    return Recording(
        source=Source.SIMULATED,
        problem=problem.name,
        time=time,
        signals=signals,
        notes=noisy if sampling.noise else {},
    )
