"""Recordings of thousands of cycles: their period is found from the signals alone."""

from __future__ import annotations

import numpy as np
import pytest

from zeno_orbits.experiment.recordings.periodicity import periodicity


@pytest.mark.slow
@pytest.mark.parametrize(("rows", "cycles"), [(1_000_000, 10_000), (40_000, 9_973)])
def test_the_period_of_many_cycles_is_found(rows: int, cycles: int) -> None:
    # The period is known: it is the one of the formula. The records have less than four bins of
    # 2^15 per cycle.
    period = 1.7
    time = np.linspace(0.0, cycles * period, rows)
    phase = 2 * np.pi * time / period
    noise = np.random.default_rng(1).normal(scale=0.01, size=(2, rows))
    values = np.array([np.sin(phase) + 0.3 * np.sin(2 * phase), np.cos(phase)]) + noise
    found = periodicity(time, values)
    assert found is not None
    assert found.error < 1e-8
    assert found.period == pytest.approx(period, abs=6 * found.error)
    assert found.n_cycles == pytest.approx(cycles, rel=1e-5)
    assert found.repeats > 0.999
