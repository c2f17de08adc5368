"""Recordings without noise are the best that there are: a settled one is accepted at any rate."""

from __future__ import annotations

from dataclasses import replace

import pytest

from zeno_orbits.experiment import (
    FitParameter,
    Recording,
    Sampling,
    crop_recording,
    fit_parameters,
    sampled,
)
from zeno_orbits.model import Problem, load_problem
from zeno_orbits.simulation import Execution, simulate

SOUGHT = {
    "motor_pendulum": FitParameter(names=("R",), lower=1.5, upper=6.0),
    "forced_oscillator": FitParameter(names=("restitution",), lower=0.2, upper=0.8),
}
SETTLED = {"motor_pendulum": 20.0, "forced_oscillator": 30.0}
"""From then on both repeat to 1e-11."""

Motion = tuple[Problem, Execution]


@pytest.fixture(
    scope="module",
    params=[pytest.param("motor_pendulum", marks=pytest.mark.slow), "forced_oscillator"],
)
def motion(request: pytest.FixtureRequest) -> Motion:
    problem = load_problem(request.param)
    dynamics = problem.dynamics(problem.values())
    until = SETTLED[problem.name] + 20.0
    start = problem.state_vector(problem.starts[0])
    return problem, simulate(dynamics, start, until=until)


def settled(motion: Motion, rate: float, *, velocities: bool) -> Recording:
    problem, execution = motion
    whole = sampled(problem, execution, Sampling(rate=rate))
    n_q = problem.compiled().n_q
    rates = () if velocities else problem.state_names[n_q : 2 * n_q]
    kept = tuple(one for one in whole.signals if one.name not in rates)
    return crop_recording(replace(whole, signals=kept), SETTLED[problem.name], None)


@pytest.mark.parametrize(
    "velocities",
    [pytest.param(True, marks=pytest.mark.slow), False],
    ids=["velocities", "positions"],
)
@pytest.mark.parametrize(
    "rate",
    [
        pytest.param(100.0, marks=pytest.mark.slow),
        250.0,
        pytest.param(500.0, marks=pytest.mark.slow),
        pytest.param(1000.0, marks=pytest.mark.slow),
    ],
)
def test_a_settled_recording_without_noise_gives_the_numbers(
    motion: Motion, rate: float, velocities: bool
) -> None:
    problem = motion[0]
    one = SOUGHT[problem.name]
    recording = settled(motion, rate, velocities=velocities)
    found = fit_parameters(problem, problem.values(), recording, [one])
    (fitted,) = found.fitted
    true = problem.values().number(one.label)
    # Tables of an orbit are exact to 1e-6 of the signals' ranges, and so are the numbers.
    assert fitted.low <= true <= fitted.high
    assert fitted.value == pytest.approx(true, rel=1e-6)
    assert fitted.error < 1e-5 * true
    assert found.after < 1e-6
    # The fit begins at the truth, and closed orbits repeat to 1e-12 of their sizes, some of them.
    assert found.after <= found.before + 2e-11
    assert found.misfit < 1.0
    assert found.remarks == ()
