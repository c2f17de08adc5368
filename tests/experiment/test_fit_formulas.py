"""The formulas of a fit: what counts of a recording, derivatives, and errors of the result."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import zeno_orbits as zo
from benchmarks import contact_fits
from tests.support.cases import fast
from tests.support.recordings_of import recorded
from tests.support.releases import closed_at_release
from zeno_orbits.experiment import (
    FitParameter,
    OrbitTable,
    Recording,
    compare_recording,
    tabulate_orbit,
)
from zeno_orbits.experiment.comparison.alignment import aligned
from zeno_orbits.experiment.comparison.folding import MOST, Folded, folded
from zeno_orbits.experiment.identification.event_period import event_period, orbit_slope
from zeno_orbits.experiment.identification.identification import ends_clause
from zeno_orbits.experiment.identification.least_squares import Fit, Weighed, fit, weighed
from zeno_orbits.experiment.identification.predictions import Predictions
from zeno_orbits.experiment.identification.prepared import prepared
from zeno_orbits.experiment.identification.stationarity import unsteady
from zeno_orbits.experiment.identification.uncertainty import Spread, spread_of
from zeno_orbits.experiment.identification.unknowns import begin_of, unknowns_of
from zeno_orbits.experiment.orbit_table import measurement
from zeno_orbits.experiment.recordings.periodicity import Periodicity, periodicity
from zeno_orbits.model import Problem
from zeno_orbits.orbits import EventReturn, Orbit, closed_return
from zeno_orbits.search import orbit_by_shooting, settled_return
from zeno_orbits.simulation import SimulationSettings
from zeno_orbits.work import silent

SIGNALS = ("theta1", "theta2", "current")
NAMES = ("R", "restitution")


@pytest.fixture(scope="module")
def table(orbit: Orbit, problem: Problem) -> OrbitTable:
    return tabulate_orbit(orbit, problem, SIGNALS)


@pytest.fixture(scope="module")
def orbits(orbit: Orbit, problem: Problem) -> Predictions:
    values = orbit.values(problem)
    numbers = {name: values.number(name) for name in NAMES}
    sought = [FitParameter(names=(n,), lower=0.5 * v, upper=2.0 * v) for n, v in numbers.items()]
    unknowns = unknowns_of(problem, values, sought)
    near = settled_return(problem, values)
    return Predictions(problem, unknowns, measurement(problem, SIGNALS), near)


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


@pytest.mark.slow
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


def _relay_recording() -> Recording:
    true = {"restitution": 0.28, "ks": 57.5, "R": 47.0}
    period = contact_fits.settled_period(true)
    return contact_fits.recorded(period, 0, noise=0.0, rate=1e5, periods=4)


def _stage(problem: zo.Problem, recording: Recording, names: tuple[str, ...]) -> Weighed:
    """Return the residuals of a fit at its start."""
    values = problem.values()
    sought = [
        FitParameter(names=(name,), lower=0.5 * value, upper=2.0 * value)
        for name in names
        for value in [values.parameters[name]]
    ]
    begin = begin_of(problem, values, sought)
    unknowns = unknowns_of(problem, begin, sought)
    whole = prepared(problem, begin, unknowns, recording, silent)
    data = whole.samples.without_jumps(whole.orbits.table(unknowns.first))
    return weighed(whole.orbits, data, whole.found, unknowns.first, whole.contacts)


@pytest.mark.slow
@pytest.mark.parametrize("names", [("restitution", "ks", "R"), ("d", "omega", "m"), ("U", "N")])
def test_the_derivatives_of_all_residuals_of_events_equal_finite_differences(
    names: tuple[str, ...],
) -> None:
    stage = _stage(zo.load_problem("relay"), _relay_recording(), names)
    x = stage.orbits.unknowns.first + np.linspace(2e-3, -1e-3, len(names) + 1)
    jacobian, n = stage.jacobian(x), stage.data.values.size
    step = 1e-5
    for k in range(len(x)):
        change = step * np.eye(len(x))[k]
        differences = (stage.residuals(x + change) - stage.residuals(x - change)) / (2 * step)
        off, size = np.abs(differences - jacobian[:, k]), np.max(np.abs(jacobian[:, k]))
        # Edges are smooth: what is left are the third derivatives, and rounding of the orbit.
        assert np.max(off[n:]) < 1e-5 * size
        # At kinks of the current the cubic between nodes has an error of its own.
        assert np.quantile(off[:n], 0.99) < 1e-5 * size


def _wrong_recording(problem: Problem) -> Recording:
    """Return what a wrong channel `distance` and a fast clock would have recorded."""
    true = problem.values(parameters={"c": 2.0, "restitution": 0.45})
    table = tabulate_orbit(
        orbit_by_shooting(problem, true).unwrap(), problem, ("distance", "speed")
    )
    exact = recorded(
        table, problem, rate=150.37 / table.period, noise=0.0, start=0.37, n_cycles=15.0
    )
    signals = tuple(
        replace(one, values=1.2 * one.values + 0.4) if one.name == "distance" else one
        for one in exact.signals
    )
    return replace(exact, time=exact.time * (1.0 + 1e-3), signals=signals)


@pytest.mark.slow
def test_the_derivatives_of_all_residuals_equal_finite_differences() -> None:
    problem = zo.load_problem("forced_oscillator")
    ranges = {"c": (1.0, 3.0), "distance.gain": (0.5, 2.0), "distance.offset": (-np.inf, np.inf)}
    ranges |= {"speed.gain": (0.5, 2.0), "clock_rate": (-0.05, 0.05)}
    sought = [FitParameter(names=(n,), lower=low, upper=high) for n, (low, high) in ranges.items()]
    begin = begin_of(problem, problem.values(), sought)
    recording = _wrong_recording(problem)
    begun = unknowns_of(problem, begin, sought)
    whole = prepared(problem, begin, begun, recording, silent)
    first = whole.orbits.unknowns.first
    data = whole.samples.without_jumps(whole.orbits.table(first))
    stage = weighed(whole.orbits, data, whole.found, first)
    x = first + np.linspace(3e-3, -2e-3, len(first))
    jacobian, step = stage.jacobian(x), 1e-5
    for k, change in enumerate(step * np.eye(len(x))):
        differences = (stage.residuals(x + change) - stage.residuals(x - change)) / (2 * step)
        off, size = np.abs(differences - jacobian[:, k]), np.max(np.abs(jacobian[:, k]))
        # Between its nodes the derivative by a parameter is a cubic. Readings are linear.
        linear = 0 < k < len(sought)
        assert np.quantile(off, 0.99) < (1e-7 if linear else 1e-4) * size
        assert off[-1] < 1e-6 * max(abs(jacobian[-1, k]), 1e2)


@pytest.fixture(scope="module")
def other(problem: Problem) -> Orbit:
    """The orbit of a machine that is not quite the problem's."""
    true = {"R": 3.12, "K_torque": 0.0303, "K_emf": 0.0303, "restitution": 0.215}
    return orbit_by_shooting(problem, problem.values(parameters=true)).unwrap()


def test_the_orbits_derivatives_are_those_of_neighbouring_orbits(
    orbit: Orbit, problem: Problem
) -> None:
    names = ("R", "K_torque", "restitution", "J_rotor")
    places = tuple(problem.names.index(name) for name in names)
    p = np.array(orbit.values(problem).vector)
    table = tabulate_orbit(orbit, problem, problem.state_names)
    settings, release = SimulationSettings(), np.array(problem.state_vector(orbit.release_state))

    def closed(values: np.ndarray):
        graph = problem.graph_dynamics(values)
        return closed_at_release(graph, release, period=table.period, settings=settings)

    graph = problem.graph_dynamics(p)
    here = closed_return(
        graph,
        release,
        section="release stop",
        n_returns=1,
        guess=table.period,
        settings=settings,
        parameters=places,
    )
    slope = orbit_slope(event_period(graph, here, measurement(problem, SIGNALS)))
    times = np.array([0.2, 0.5, 0.9, 1.1, 1.26, 1.31, 1.4, 1.7])
    for k, place in enumerate(places):
        step = 1e-5 * p[place]
        ahead, behind = p.copy(), p.copy()
        ahead[place] += step
        behind[place] -= step
        after, before = closed(ahead), closed(behind)
        # Central differences: 1e-10 of truncation and 1e-12 / 1e-5 of rounding, relative.
        by_period = (after.period - before.period) / (2 * step)
        assert slope.period[k] == pytest.approx(by_period, rel=1e-6)
        rows = [_at(after, times) - _at(before, times)]
        differences = rows[0] / (2 * step)
        size = np.max(np.abs(differences), axis=0)
        # Between its nodes a derivative is a cubic, good to some 1e-3.
        assert np.all(np.abs(slope.at(times)[:, :, k] - differences) < 2e-3 * size)


def _at(found: EventReturn, times: np.ndarray) -> np.ndarray:
    arcs = [next(a for a in found.arcs if a.start_time <= t < a.end_time) for t in times]
    return np.array([arc.state_at(time) for arc, time in zip(arcs, times, strict=True)])


@pytest.mark.slow
def test_gathering_many_samples_changes_no_mean(other: Orbit, problem: Problem) -> None:
    table = tabulate_orbit(other, problem, ("theta1",))
    long = recorded(table, problem, n_cycles=20, rate=2000.0)
    where = compare_recording(other, problem, long).where
    assert where is not None
    values = long.signal("theta1").values[None]
    gathered = folded(long.time, values, where)
    assert len(gathered.phases) < len(long.time) / 2
    assert gathered.counts.sum() == len(long.time)
    # A mean over a bin is the value at the mean phase, but for the bend: 20 rad/s^2 (3e-3 s)^2 / 8.
    here = table.at(gathered.phases)
    assert gathered.values == pytest.approx(here, abs=1e-3)


CYCLES, PER_CYCLE = 12, 100
MANY = 300
"""Fits of which errors are counted: their root mean square is sure to a 24th, one in 600."""


def shapes(phases: np.ndarray) -> np.ndarray:
    """Return the derivatives of a signal by two parameters and its shift in phase, ``(n, 3)``."""
    angle = 2 * np.pi * phases
    return np.stack([np.cos(angle), np.cos(2 * angle), np.sin(3 * angle)], axis=1)


def whole_cycles(cycles: int, per_cycle: int) -> Folded:
    """Return samples of whole cycles, their values zero."""
    whole = np.arange(cycles * per_cycle) / per_cycle
    groups = np.floor(whole + 1e-9).astype(np.int64)
    seen = np.ones((len(whole), 1), dtype=bool)
    return Folded(
        phases=np.mod(whole + 1e-9, 1.0),
        values=np.zeros((len(whole), 1)),
        counts=seen.astype(np.float64),
        seen=seen,
        groups=groups,
        turns=groups.astype(np.float64),
    )


def fit_of(data: Folded, values: np.ndarray, period_tells: float = 0.0) -> Fit:
    """Return the least-squares fit of values in units of their noise.

    Args:
        data: Where they were taken.
        values: The values, ``(n,)``; the truth is zero.
        period_tells: What the period tells of the first parameter: one over its standard error.
    """
    jacobian = np.concatenate([-shapes(data.phases), [[-period_tells, 0.0, 0.0]]])
    target = np.append(values, 0.0)
    x = np.linalg.lstsq(jacobian, -target, rcond=None)[0]
    residuals = target + jacobian @ x
    spread: Spread = spread_of(jacobian, residuals, data)
    return Fit(
        x=x,
        data=data,
        jacobian=jacobian,
        residuals=residuals,
        spread=spread,
        before=0.0,
        after=0.0,
        repeating=0.0,
        converged=True,
    )


def white(rng: np.random.Generator, n: int) -> np.ndarray:
    return rng.normal(size=n)


def remembered(rng: np.random.Generator, n: int, samples: int = 8) -> np.ndarray:
    """Return noise of variance one that forgets over some samples."""
    keep = math.exp(-1.0 / samples)
    found = rng.normal(size=n)
    for k in range(1, n):
        found[k] = keep * found[k - 1] + math.sqrt(1 - keep**2) * found[k]
    return found


def test_values_at_an_end_of_their_range_are_named(problem: Problem) -> None:
    numbers = {name: problem.values().number(name) for name in NAMES}
    sought = [FitParameter(names=(n,), lower=0.5 * v, upper=2.0 * v) for n, v in numbers.items()]
    unknowns = unknowns_of(problem, problem.values(), sought)
    inside = unknowns.first
    assert ends_clause(NAMES, unknowns, inside) == ""
    for place, factor in ((0, 0.5), (1, 2.0)):
        x = inside.copy()
        x[place] *= factor
        end = f"`{NAMES[place]}` is at the end {factor * numbers[NAMES[place]]:.6g} of its range"
        assert ends_clause(NAMES, unknowns, x) == f"; {end}: widen it"


def test_an_interval_of_95_percent_is_students() -> None:
    # Too few cycles for their scatter to count; 60 degrees of freedom; tables give 2.000.
    data = whole_cycles(4, PER_CYCLE)
    spread = fit_of(data, white(np.random.default_rng(0), len(data.phases))).spread
    assert spread.half / spread.errors == pytest.approx(2.000298, abs=1e-5)


def test_an_interval_from_the_scatter_of_cycles_is_longer() -> None:
    # What each cycle has of its own is constant over it: 7 cycles have 6 degrees of freedom, 2.447.
    data = whole_cycles(7, PER_CYCLE)
    own = np.random.default_rng(1).normal(size=7)[data.groups]
    spread = fit_of(data, 5.0 * own * shapes(data.phases)[:, 0]).spread
    assert spread.half[0] / spread.errors[0] == pytest.approx(2.446912, abs=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "wide"), fast(1, [(white, 1.25), (remembered, 1.4)]))
def test_standard_errors_are_those_that_are_made(noise: object, wide: float) -> None:
    data, rng = whole_cycles(CYCLES, PER_CYCLE), np.random.default_rng(2)
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
    data, rng = whole_cycles(CYCLES, PER_CYCLE), np.random.default_rng(3)
    spread = fit_of(data, remembered(rng, len(data.phases))).spread
    plain = 1.0 / math.sqrt(len(data.phases) / 2)
    # Sums of noise that forgets over 8 samples scatter sqrt(coth(1/16)) = 4.0 times as much; the
    # first harmonic sees nearly all of it, and estimates are a quarter off.
    assert spread.errors[0] > 2.5 * plain
    assert spread.inflation > 2.5


def test_what_the_period_tells_counts() -> None:
    data, rng = whole_cycles(CYCLES, PER_CYCLE), np.random.default_rng(4)
    noise = white(rng, len(data.phases))
    alone, told = fit_of(data, noise), fit_of(data, noise, period_tells=1e3)
    # The period's error of 1e-3 is a twentieth of that of 1200 samples.
    assert told.spread.errors[0] == pytest.approx(1e-3, rel=0.1)
    assert told.spread.errors[1] == pytest.approx(alone.spread.errors[1], rel=0.1)


def test_a_deviation_that_repeats_is_a_misfit_and_noise_is_none() -> None:
    data, rng = whole_cycles(CYCLES, PER_CYCLE), np.random.default_rng(5)
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
    data = whole_cycles(CYCLES, PER_CYCLE)
    spread = fit_of(data, white(np.random.default_rng(6), len(data.phases))).spread
    # Sines and cosines are at right angles, and the mean of their squares is one half.
    assert spread.information == pytest.approx(len(data.phases) / 2 * np.eye(2), abs=1e-6)
    assert np.diag(spread.correlation) == pytest.approx(1.0)
    assert abs(spread.correlation[0, 1]) < 0.3


# ------------------------------------------------------------------- cycles that are not alike


def told(change: np.ndarray, seed: int = 7, per_cycle: int = PER_CYCLE) -> object:
    """Return what is said of cycles whose first parameter changes by given amounts."""
    data = whole_cycles(CYCLES, per_cycle)
    noise = white(np.random.default_rng(seed), len(data.phases))
    return unsteady(fit_of(data, noise + change[data.groups] * shapes(data.phases)[:, 0]))


@pytest.mark.slow
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
    data = whole_cycles(CYCLES, PER_CYCLE)
    noise = white(np.random.default_rng(8), len(data.phases))
    loud = np.where(data.groups == 0, 2.0, 1.0) * noise
    found = unsteady(fit_of(data, loud))
    assert found is not None
    assert "still settling" in found.reason
    assert found.size == math.inf
