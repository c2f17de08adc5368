"""Parameters from recordings whose truth is known, and what recordings cannot tell."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from tests.support.recordings_of import recorded, recording_of
from zeno_orbits.errors import InputError
from zeno_orbits.experiment import (
    FitParameter,
    Identification,
    Recording,
    UnfittableError,
    fit_parameters,
    tabulate_orbit,
)
from zeno_orbits.model import Problem
from zeno_orbits.orbits import Orbit
from zeno_orbits.search import orbit_by_shooting

SOUGHT = (
    FitParameter(names=("R",), lower=2.0, upper=4.0),
    FitParameter(names=("K_torque", "K_emf"), lower=0.02, upper=0.05),
    FitParameter(names=("restitution",), lower=0.0, upper=0.4),
)
TRUTH = {"R": 3.12, "K_torque": 0.0303, "K_emf": 0.0303, "restitution": 0.215}


@pytest.fixture(scope="module")
def other(problem: Problem) -> Orbit:
    """The orbit of a machine that is not quite the problem's."""
    return orbit_by_shooting(problem, problem.values(parameters=TRUTH)).unwrap()


def record(other: Orbit, problem: Problem, seed: int, noise: float = 5e-3) -> Recording:
    table = tabulate_orbit(other, problem, ("theta1", "theta2", "current"))
    return recorded(table, problem, n_cycles=8, rate=200.0, noise=noise, seed=seed, start=0.4)


@pytest.fixture(scope="module")
def fitted(other: Orbit, problem: Problem) -> Identification:
    return fit_parameters(problem, problem.values(), record(other, problem, 0), SOUGHT)


@pytest.mark.slow
def test_the_true_parameters_are_found(fitted: Identification) -> None:
    for one in fitted.fitted:
        true = TRUTH[one.unknown.names[0]]
        # Five standard errors, and those are small: the recording tells all three to a per cent.
        assert abs(one.value - true) < 5 * one.error < 0.05 * true, one
        assert one.low < one.value < one.high
    assert fitted.unseen == ()
    # Noise of 5e-3 remains, and nothing that repeats beyond it: the variance ratio of 240 bins of
    # three signals scatters by sqrt(2 / 720), so that 1.5 is far beyond.
    assert fitted.after == pytest.approx(5e-3, rel=0.05)
    assert fitted.before > 1.5 * fitted.after
    assert fitted.misfit < 1.5


@pytest.mark.slow
def test_what_is_fitted_can_be_passed_on(fitted: Identification, problem: Problem) -> None:
    data = json.loads(json.dumps(fitted.as_json(), allow_nan=False))
    again = problem.values(gains=data["gains"], parameters=data["parameters"])
    assert again == fitted.values
    assert fitted.orbit.parameters == dict(fitted.values.parameters)
    assert data["parameters"]["K_torque"] == data["parameters"]["K_emf"]


@pytest.mark.weekly
@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say(other: Orbit, problem: Problem) -> None:
    # Of 5 seeds and 3 numbers at 95 %, 10 or fewer inside has a chance below 1e-3.
    inside = 0
    for seed in range(1, 6):
        found = fit_parameters(problem, problem.values(), record(other, problem, seed), SOUGHT)
        inside += sum(one.low <= TRUTH[one.unknown.names[0]] <= one.high for one in found.fitted)
    assert inside >= 11


@pytest.mark.weekly
@pytest.mark.slow
def test_what_a_recording_cannot_tell_is_named(other: Orbit, problem: Problem) -> None:
    # Only the ratio of both inertial terms I2 and m2 lc2^2 enters with lc2 as it does... I1 and
    # J_rotor enter as their sum alone, so a change of one is undone by the other.
    sought = (
        FitParameter(names=("I1",), lower=0.0005, upper=0.002),
        FitParameter(names=("J_rotor",), lower=0.01, upper=0.03),
    )
    found = fit_parameters(
        problem, problem.values(parameters=TRUTH), record(other, problem, 2), sought
    )
    assert len(found.unseen) == 1
    assert set(found.unseen[0].direction) == {"I1", "J_rotor"}
    assert "I1" in found.unseen[0].text
    assert math.isinf(found.fitted[0].error)


@pytest.mark.parametrize(
    ("sought", "reason"),
    [
        ((), "must name a parameter"),
        ((FitParameter(names=("Kp",), lower=1, upper=3),), "names `Kp`; gains are known"),
        ((FitParameter(names=("x",), lower=1, upper=3),), "but it names `x`"),
        ((FitParameter(names=("R", "R"), lower=1, upper=3),), "must name `R` once"),
        ((FitParameter(names=("R",), lower=3, upper=3),), "must have a range LOW:HIGH for `R`"),
    ],
)
def test_a_question_that_cannot_be_is_refused(
    sought: tuple[FitParameter, ...], reason: str, problem: Problem
) -> None:
    time = np.arange(100) * 0.1
    recording = recording_of(problem, ("theta1",), time, np.sin(time)[None])
    with pytest.raises(InputError, match=reason):
        fit_parameters(problem, problem.values(), recording, sought)


def test_a_recording_that_shows_no_such_orbit_gives_no_parameters(
    other: Orbit, problem: Problem
) -> None:
    good = record(other, problem, 0)
    degrees = replace(
        good, signals=tuple(replace(one, values=57.3 * one.values) for one in good.signals)
    )
    with pytest.raises(UnfittableError, match="degrees labelled as radians"):
        fit_parameters(problem, problem.values(), degrees, SOUGHT)


@pytest.mark.slow
def test_a_start_without_an_orbit_is_told(other: Orbit, problem: Problem) -> None:
    nowhere = problem.values(gains={"Kp": 2.5, "Kd": 5.0})
    with pytest.raises(UnfittableError, match="an orbit to fit is missing at the start"):
        fit_parameters(problem, nowhere, record(other, problem, 0), SOUGHT)
