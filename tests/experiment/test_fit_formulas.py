"""What counts of a recording in a fit: samples whose prediction is straight over the interval."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.recordings_of import recorded
from zeno_orbits.experiment import FitParameter, OrbitTable, tabulate_orbit
from zeno_orbits.experiment.comparison.alignment import aligned
from zeno_orbits.experiment.comparison.folding import MOST, Folded, folded
from zeno_orbits.experiment.identification.least_squares import Fit, fit, weighed
from zeno_orbits.experiment.identification.predictions import Predictions
from zeno_orbits.experiment.identification.unknowns import unknowns_of
from zeno_orbits.experiment.orbit_table import measurement
from zeno_orbits.experiment.recordings.periodicity import Periodicity, periodicity
from zeno_orbits.model import Problem
from zeno_orbits.orbits import ZenoOrbit

SIGNALS = ("theta1", "theta2", "current")
NAMES = ("R", "restitution")


@pytest.fixture(scope="module")
def table(orbit: ZenoOrbit, problem: Problem) -> OrbitTable:
    return tabulate_orbit(orbit, problem, SIGNALS)


@pytest.fixture(scope="module")
def orbits(orbit: ZenoOrbit, problem: Problem, table: OrbitTable) -> Predictions:
    values = orbit.values(problem)
    numbers = {name: values.number(name) for name in NAMES}
    sought = [FitParameter(names=(n,), lower=0.5 * v, upper=2.0 * v) for n, v in numbers.items()]
    unknowns = unknowns_of(problem, values, sought)
    return Predictions(problem, unknowns, measurement(problem, SIGNALS), table.cycle)


def samples(
    table: OrbitTable, problem: Problem, cycles: float, rate: float, noise: float
) -> tuple[Folded, Periodicity]:
    recording = recorded(table, problem, n_cycles=cycles, rate=rate, noise=noise, start=0.4)
    values = np.stack([one.values for one in recording.signals])
    period = periodicity(recording.time, values)
    assert period is not None
    where = aligned(table, recording.time, values, period, SIGNALS)
    return folded(recording.time, values, where), period


@pytest.fixture(scope="module")
def whole(table: OrbitTable, problem: Problem) -> tuple[Folded, Periodicity]:
    # Several samples in each layer of width L/R = 0.7 ms.
    return samples(table, problem, 4.2, 2000.0, 5e-3)


@pytest.fixture(scope="module")
def done(orbits: Predictions, whole: tuple[Folded, Periodicity]) -> Fit:
    return fit(orbits, *whole, orbits.unknowns.first, lambda _what, _part: None)


def bend(orbits: Predictions, whole: tuple[Folded, Periodicity], done: Fit) -> np.ndarray:
    """Return by how much residuals are off a straight line three standard errors from the fit."""
    data, period = whole
    stage = replace(weighed(orbits, done.data, period, done.x), data=data)
    here, slopes = stage.residuals(done.x), stage.jacobian(done.x)
    values, vectors = np.linalg.eigh(done.jacobian.T @ done.jacobian)
    off = [
        stage.residuals(done.x + step) - here - slopes @ step
        for value, vector in zip(values, vectors.T, strict=True)
        for step in (3 * vector / np.sqrt(value), -3 * vector / np.sqrt(value))
    ]
    return np.max(np.abs(off), axis=0)[:-1].reshape(data.seen.shape)


def test_what_counts_is_straight_over_the_interval_and_what_does_not_is_not(
    orbits: Predictions, whole: tuple[Folded, Periodicity], done: Fit
) -> None:
    found = bend(orbits, whole, done)
    counted = done.data.seen
    # The limit is 0.3 at the end of the first fit, whose interval is a little longer.
    assert np.max(found[counted]) < 0.35
    # Without it, the current behind impacts counts, off by several times that.
    assert np.max(found[~counted]) > 0.9
    assert np.all(counted[:, :2].mean(axis=0) > 0.99)
    assert 0.9 < counted[:, 2].mean() < 1.0


def test_a_claim_from_inside_a_layer_is_more_than_the_recording_tells(
    orbits: Predictions, whole: tuple[Folded, Periodicity], done: Fit
) -> None:
    data, period = whole
    stage = replace(weighed(orbits, done.data, period, done.x), data=data)
    every = stage.jacobian(done.x)
    claimed = np.sqrt(np.diag(np.linalg.inv(every.T @ every)))
    told = np.sqrt(np.diag(np.linalg.inv(done.jacobian.T @ done.jacobian)))
    assert claimed[1] < 0.8 * told[1]


def test_a_layer_is_left_out_as_a_jump_is(
    table: OrbitTable, whole: tuple[Folded, Periodicity]
) -> None:
    masked = whole[0].without_jumps(table)
    first = table.first_impact / table.period
    behind = (masked.phases > first) & (masked.phases < first + 0.01)
    assert behind.any()
    assert not masked.seen[behind, 2].any()
    assert masked.seen[:, :2].all()


def test_means_over_stretches_are_predicted_as_means(table: OrbitTable, problem: Problem) -> None:
    data, _ = samples(table, problem, 30.2, 2000.0, 0.0)
    assert data.counts.sum() / 3 > MOST
    assert data.span > 0.0
    full = (data.counts > 0.9 * np.median(data.counts)).all(axis=1)
    # Away from kinks, a mean is off its middle by y'' d^2 / 24, and the prediction knows.
    bends = data.bends(table, 0.0) / np.ptp(table.nodes.values, axis=0)
    smooth = full & (np.max(bends, axis=1) < 1e-5)
    assert smooth.mean() > 0.5
    middle = table.at(data.phases)[smooth]
    off = np.abs(data.values[smooth] - middle).max(axis=0)
    known = np.abs(data.values[smooth] - data.predicted(table, 0.0).values[smooth]).max(axis=0)
    assert np.all(known < 0.5 * off)
