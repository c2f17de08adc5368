"""Recordings that show no settled orbit of the problem end with the reason, not with numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.recordings_of import recorded, recording_of
from zeno_orbits.experiment import (
    FitParameter,
    Recording,
    Sampling,
    UnfittableError,
    crop_recording,
    fit_parameters,
    sampled,
    tabulate_orbit,
)
from zeno_orbits.model import Problem, load_problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.search import orbit_by_shooting
from zeno_orbits.simulation import simulate

SOUGHT = (
    FitParameter(names=("R",), lower=2.0, upper=4.0),
    FitParameter(names=("restitution",), lower=0.0, upper=0.4),
)
TRUTH = {"R": 3.12, "restitution": 0.215}
SIGNALS = ("theta1", "theta2", "current")


@pytest.fixture(scope="module")
def settling(problem: Problem) -> Recording:
    """A machine from its first start on."""
    values = problem.values(parameters=TRUTH)
    dynamics = problem.dynamics(values)
    motion = simulate(dynamics, problem.state_vector(problem.starts[0]), until=13.0)
    whole = sampled(problem, motion, Sampling(rate=200.0, noise=5e-3))
    return replace(whole, signals=tuple(one for one in whole.signals if one.name in SIGNALS))


@pytest.fixture(scope="module")
def other(problem: Problem) -> Orbit:
    """The orbit that it settles to."""
    return orbit_by_shooting(problem, problem.values(parameters=TRUTH)).unwrap()


@pytest.mark.parametrize(
    ("since", "until"), [(0.0, 5.0), pytest.param(3.6, 11.0, marks=pytest.mark.slow)]
)
@pytest.mark.slow
def test_a_transient_is_told_and_where_it_ends(
    settling: Recording, problem: Problem, since: float, until: float
) -> None:
    with pytest.raises(UnfittableError, match=r"first cycle .* still settling; .* --t-start \d"):
        fit_parameters(problem, problem.values(), crop_recording(settling, since, until), SOUGHT)


@pytest.mark.slow
def test_a_drift_is_told(other: Orbit, problem: Problem) -> None:
    # What is drawn from one current to the other over the cycles passes for no other problem.
    last = orbit_by_shooting(problem, problem.values(parameters={**TRUTH, "R": 3.24})).unwrap()
    tables = [tabulate_orbit(orbit, problem, SIGNALS) for orbit in (other, last)]
    period = other.period
    time = np.arange(int(8 * period * 200.0)) / 200.0
    share = (time / time[-1])[:, None]
    values = sum(
        part * table.at(time / period + 0.4)
        for part, table in zip((1 - share, share), tables, strict=True)
    )
    noise = 2e-3 * np.ptp(values, axis=0) * np.random.default_rng(0).normal(size=values.shape)
    drifting = recording_of(problem, SIGNALS, time, (values + noise).T)
    with pytest.raises(UnfittableError, match="two halves give different parameters"):
        fit_parameters(problem, problem.values(parameters=TRUTH), drifting, SOUGHT)


@pytest.mark.slow
def test_cycles_that_differ_in_turn_are_told(other: Orbit, problem: Problem) -> None:
    second = orbit_by_shooting(problem, problem.values(parameters={**TRUTH, "R": 3.16})).unwrap()
    tables = [tabulate_orbit(orbit, problem, SIGNALS) for orbit in (other, second)]
    time = np.arange(int(8 * other.period * 200.0)) / 200.0
    phases = time / other.period
    odd = (np.floor(phases) % 2 == 1)[:, None]
    values = np.where(odd, tables[1].at(phases), tables[0].at(phases))
    noise = 2e-3 * np.ptp(values, axis=0) * np.random.default_rng(0).normal(size=values.shape)
    doubled = recording_of(problem, SIGNALS, time, (values + noise).T)
    with pytest.raises(UnfittableError, match="the period is doubled"):
        fit_parameters(problem, problem.values(parameters=TRUTH), doubled, SOUGHT)


@pytest.mark.slow
def test_a_settled_machine_is_not_refused(other: Orbit, problem: Problem) -> None:
    table = tabulate_orbit(other, problem, SIGNALS)
    for cycles, start in ((2.3, 0.1), (3.5, 0.9)):
        settled = recorded(table, problem, n_cycles=cycles, rate=200.0, noise=5e-3, start=start)
        found = fit_parameters(problem, problem.values(parameters=TRUTH), settled, SOUGHT)
        assert all(
            abs(one.value - TRUTH[one.unknown.label]) < 5 * one.error for one in found.fitted
        )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("bounds", "rate", "noise"),
    [((1.0, 1.7), 150.5, 1e-3), ((2.4, 3.0), 60.5, 1e-2), ((1.0, 1.7), 150.37, 0.0)],
)
def test_a_range_without_the_truth_makes_no_settled_recording_unsteady(
    bounds: tuple[float, float], rate: float, noise: float
) -> None:
    # Misfits of jumps sum up to other values in cycles that are sampled at other phases.
    oscillator, truth = load_problem("forced_oscillator"), {"c": 2.0, "restitution": 0.45}
    orbit = orbit_by_shooting(oscillator, oscillator.values(parameters=truth)).unwrap()
    table = tabulate_orbit(orbit, oscillator, ("distance", "speed"))
    settled = recorded(
        table, oscillator, rate=rate / orbit.period, noise=noise, start=0.37, n_cycles=6.0
    )
    known = oscillator.values(parameters={**truth, "c": bounds[0]})
    sought = FitParameter(names=("c",), lower=bounds[0], upper=bounds[1])
    found = fit_parameters(oscillator, known, settled, (sought,))
    assert "`c` reached an end of its range" in found.remarks
    assert any("systematic misfit" in one for one in found.remarks)
    assert not any("cycle" in one or "halves" in one for one in found.remarks)


@pytest.mark.parametrize("names", [SIGNALS, ("theta1", "current")])
@pytest.mark.slow
def test_a_stop_that_is_never_touched_gives_no_parameters(
    problem: Problem, names: tuple[str, ...]
) -> None:
    # Arms that swing at the orbit's own period, the second far from its stop.
    orbit = orbit_by_shooting(problem, problem.values()).unwrap()
    time = np.arange(int(9 * orbit.period * 200.0)) / 200.0
    angle = 2 * np.pi * time / orbit.period
    of = {"theta1": 1.4 * np.sin(angle), "theta2": -1.0 - 0.6 * np.cos(angle)}
    of["current"] = 2.0 * np.cos(angle)
    noise = 2e-2 * np.random.default_rng(0).normal(size=(len(names), len(time)))
    free = recording_of(problem, names, time, np.array([of[name] for name in names]) + noise)
    with pytest.raises(UnfittableError, match="No parameters were found"):
        fit_parameters(problem, problem.values(), free, SOUGHT)


@pytest.mark.slow
def test_another_machine_is_told_by_what_repeats(other: Orbit, problem: Problem) -> None:
    table = tabulate_orbit(other, problem, SIGNALS)
    good = recorded(table, problem, n_cycles=8, rate=200.0, noise=5e-3)
    # Its first arm and its current have other shapes: of the same period, locked as long, and
    # like the orbit's enough to be compared with it.
    phase = 2 * np.pi * good.time / table.period
    strange = replace(
        good,
        signals=tuple(
            one
            if one.name == "theta2"
            else replace(one, values=one.values + 0.2 * np.ptp(one.values) * np.sin(3 * phase))
            for one in good.signals
        ),
    )
    with pytest.raises(UnfittableError, match=r"of the signals' ranges off, in every cycle"):
        fit_parameters(problem, problem.values(), strange, SOUGHT)
