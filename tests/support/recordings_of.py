"""Recordings of orbits that are known, as instruments would make them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from zeno_orbits.experiment import OrbitTable, RecordedSignal, Recording, Source
from zeno_orbits.model import Problem


def recorded(
    table: OrbitTable,
    problem: Problem,
    *,
    n_cycles: float = 12.0,
    rate: float = 400.0,
    noise: float = 0.0,
    start: float = 0.3,
    stretch: float = 1.0,
    jitter: float = 0.0,
    seed: int = 0,
) -> Recording:
    """Return samples of an orbit.

    Args:
        table: The orbit; all of its signals are recorded.
        problem: Its problem.
        n_cycles: How long, in periods.
        rate: Samples a second.
        noise: Standard deviation in parts of the range of each signal.
        start: Phase of the first sample.
        stretch: Factor of the time.
        jitter: How uneven the samples are, 1 for a whole step.
        seed: Of noise and jitter.
    """
    rng = np.random.default_rng(seed)
    n = int(n_cycles * table.period * stretch * rate)
    time = (np.arange(n) + jitter * rng.uniform(-0.5, 0.5, n)) / rate
    values = table.at(time / (stretch * table.period) + start)
    values = values + noise * np.ptp(values, axis=0) * rng.normal(size=values.shape)
    return recording_of(problem, table.measured.names, time, values.T)


def recording_of(
    problem: Problem, names: Sequence[str], time: np.ndarray, values: np.ndarray
) -> Recording:
    """Return a simulated recording of states."""
    units = dict(zip(problem.state_names, problem.state_units, strict=True))
    signals = tuple(
        RecordedSignal(name=name, unit=units[name], values=row)
        for name, row in zip(names, values, strict=True)
    )
    return Recording(source=Source.SIMULATED, problem=problem.name, time=time, signals=signals)
