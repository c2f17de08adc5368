"""Errors, intervals and the test of halves, on fits whose errors are known in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.support.cases import fast
from tests.support.linear_fits import fit_of, samples, shapes
from zeno_orbits.experiment.identification.stationarity import unsteady

CYCLES, PER_CYCLE = 12, 100
MANY = 300
"""Fits of which errors are counted: their root mean square is sure to a 24th, one in 600."""


def white(rng: np.random.Generator, n: int) -> np.ndarray:
    return rng.normal(size=n)


def remembered(rng: np.random.Generator, n: int, samples: int = 8) -> np.ndarray:
    """Return noise of variance one that forgets over some samples."""
    keep = math.exp(-1.0 / samples)
    found = rng.normal(size=n)
    for k in range(1, n):
        found[k] = keep * found[k - 1] + math.sqrt(1 - keep**2) * found[k]
    return found


def test_an_interval_of_95_percent_is_students() -> None:
    # Too few cycles for their scatter to count; 60 degrees of freedom; tables give 2.000.
    data = samples(4, PER_CYCLE)
    spread = fit_of(data, white(np.random.default_rng(0), len(data.phases))).spread
    assert spread.half / spread.errors == pytest.approx(2.000298, abs=1e-5)


def test_an_interval_from_the_scatter_of_cycles_is_longer() -> None:
    # What each cycle has of its own is constant over it: 7 cycles have 6 degrees of freedom, 2.447.
    data = samples(7, PER_CYCLE)
    own = np.random.default_rng(1).normal(size=7)[data.groups]
    spread = fit_of(data, 5.0 * own * shapes(data.phases)[:, 0]).spread
    assert spread.half[0] / spread.errors[0] == pytest.approx(2.446912, abs=1e-5)


@pytest.mark.parametrize(("noise", "wide"), fast(1, [(white, 1.25), (remembered, 1.4)]))
def test_standard_errors_are_those_that_are_made(noise: object, wide: float) -> None:
    data, rng = samples(CYCLES, PER_CYCLE), np.random.default_rng(2)
    fits = [fit_of(data, noise(rng, len(data.phases))) for _ in range(MANY)]  # type: ignore[operator]
    made = np.std([fit.x[:2] for fit in fits], axis=0)
    claimed = np.mean([fit.spread.errors for fit in fits], axis=0)
    # The greatest of four estimates: more than what is made, and not by much.
    assert np.all(claimed > 0.95 * made)
    assert np.all(claimed < wide * made)
    inside = np.mean([np.abs(fit.x[:2]) < fit.spread.half for fit in fits])
    # 95 %, less three standard deviations of 600 intervals, each of which is longer than it must.
    assert 0.95 - 3 * math.sqrt(0.95 * 0.05 / (2 * MANY)) < inside < 1.0


def test_noise_that_remembers_is_not_taken_for_white() -> None:
    data, rng = samples(CYCLES, PER_CYCLE), np.random.default_rng(3)
    spread = fit_of(data, remembered(rng, len(data.phases))).spread
    plain = 1.0 / math.sqrt(len(data.phases) / 2)
    # Sums of noise that forgets over 8 samples scatter sqrt(coth(1/16)) = 4.0 times as much; the
    # first harmonic sees nearly all of it, and estimates are a quarter off.
    assert spread.errors[0] > 2.5 * plain
    assert spread.inflation > 2.5


def test_what_the_period_tells_counts() -> None:
    data, rng = samples(CYCLES, PER_CYCLE), np.random.default_rng(4)
    noise = white(rng, len(data.phases))
    alone, told = fit_of(data, noise), fit_of(data, noise, period_tells=1e3)
    # The period's error of 1e-3 is a twentieth of that of 1200 samples.
    assert told.spread.errors[0] == pytest.approx(1e-3, rel=0.1)
    assert told.spread.errors[1] == pytest.approx(alone.spread.errors[1], rel=0.1)


def test_a_deviation_that_repeats_is_a_misfit_and_noise_is_none() -> None:
    data, rng = samples(CYCLES, PER_CYCLE), np.random.default_rng(5)
    noise = white(rng, len(data.phases))
    repeats = np.sin(10 * np.pi * data.phases)
    right, wrong = fit_of(data, noise).spread, fit_of(data, noise + repeats).spread
    # Of 100 bins, variances scatter by sqrt(2 / 100).
    assert right.misfit == pytest.approx(1.0, abs=0.5)
    # In each bin 12 samples repeat a mean square of 1/2 beside noise of 1: 1 + 12 / 2.
    assert wrong.misfit == pytest.approx(7.0, rel=0.3)
    assert wrong.common == pytest.approx(math.sqrt(0.5), rel=0.1)
    assert right.common < 0.2


def test_combinations_are_seen_without_the_shift_in_phase() -> None:
    data = samples(CYCLES, PER_CYCLE)
    spread = fit_of(data, white(np.random.default_rng(6), len(data.phases))).spread
    # Sines and cosines are at right angles, and the mean of their squares is one half.
    assert spread.information == pytest.approx(len(data.phases) / 2 * np.eye(2), abs=1e-6)
    assert np.diag(spread.correlation) == pytest.approx(1.0)
    assert abs(spread.correlation[0, 1]) < 0.3


# ------------------------------------------------------------------- cycles that are not alike


def told(change: np.ndarray, seed: int = 7, per_cycle: int = PER_CYCLE) -> object:
    """Return what is said of cycles whose first parameter changes by given amounts."""
    data = samples(CYCLES, per_cycle)
    noise = white(np.random.default_rng(seed), len(data.phases))
    return unsteady(fit_of(data, noise + change[data.groups] * shapes(data.phases)[:, 0]))


@pytest.mark.parametrize("per_cycle", fast(1, [40, 20, PER_CYCLE]))
def test_cycles_that_are_alike_are_steady(per_cycle: int) -> None:
    # Four comparisons with a chance of 1e-6 each. With 20 samples a cycle the median deviation of
    # the first is more than 1.5 times the others' in 5 of 100 by noise alone.
    assert all(told(np.zeros(CYCLES), seed, per_cycle) is None for seed in range(100))


# A cycle of 100 samples tells a parameter to sqrt(2 / 100) = 0.14, a half of 6 of them to 0.06;
# five standard errors and more of the difference are needed for a chance of 1e-6.
FIRST = np.eye(CYCLES)[0]
HALF = (np.arange(CYCLES) >= CYCLES // 2).astype(float)
ODD = np.arange(CYCLES) % 2.0


@pytest.mark.parametrize(
    ("change", "reason", "skip", "size"),
    [
        (1.3 * FIRST, "first cycle differs from the later cycles", 1, 1.3),
        (0.8 * HALF, "two halves give different parameters", CYCLES // 2, 0.8),
        (0.8 * ODD, "every other cycle gives different parameters", 0, 0.8),
    ],
)
def test_cycles_that_are_not_are_told_how(
    change: np.ndarray, reason: str, skip: int, size: float
) -> None:
    found = told(change)
    assert reason in found.reason  # type: ignore[attr-defined]
    assert found.first == (skip > 0)  # type: ignore[attr-defined]
    assert found.skip == skip  # type: ignore[attr-defined]
    # The noise's own part of the difference: some 0.15 for a cycle, 0.08 for halves.
    assert found.size == pytest.approx(size, abs=0.4)  # type: ignore[attr-defined]


@pytest.mark.parametrize("change", [0.2 * FIRST, 0.1 * HALF, 0.1 * ODD])
def test_a_difference_that_noise_makes_as_well_is_not_told(change: np.ndarray) -> None:
    assert told(change) is None


def test_a_first_cycle_that_is_loud_has_not_settled() -> None:
    data = samples(CYCLES, PER_CYCLE)
    noise = white(np.random.default_rng(8), len(data.phases))
    loud = np.where(data.groups == 0, 2.0, 1.0) * noise
    found = unsteady(fit_of(data, loud))
    assert found is not None
    assert "still settling" in found.reason
    assert found.size == math.inf
