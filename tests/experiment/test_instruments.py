"""Gain and offset of channels, and the clock rate, as unknowns of a fit.

The truth is a sampled orbit whose channels and times are changed by known errors.
"""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.cases import often
from tests.support.commands import ask
from tests.support.recordings_of import recorded
from zeno_orbits.experiment import Identification, Recording, tabulate_orbit
from zeno_orbits.search import orbit_by_shooting

OSCILLATOR, TRUTH = "forced_oscillator", {"c": 2.0, "restitution": 0.45}
ERRORS = ["distance.gain", "distance.offset", "clock_rate"]


@cache
def _exact(noise: float = 0.0, *names: str) -> Recording:
    problem = zo.load_problem(OSCILLATOR)
    orbit = orbit_by_shooting(problem, problem.values(parameters=TRUTH)).unwrap()
    table = tabulate_orbit(orbit, problem, names or ("distance", "speed"))
    rate = 150.37 / orbit.period
    return recorded(table, problem, rate=rate, noise=noise, start=0.37, n_cycles=6.0)


def _wrong(recording: Recording, *, gain: float, offset: float, rate: float) -> Recording:
    """Return what a wrong channel `distance` and a fast clock would have recorded."""
    signals = tuple(
        replace(one, values=gain * one.values + offset) if one.name == "distance" else one
        for one in recording.signals
    )
    return replace(recording, time=recording.time * (1.0 + rate), signals=signals)


def _values(found: Identification) -> dict[str, float]:
    return {one.unknown.label: one.value for one in found.fitted}


@pytest.mark.weekly
@pytest.mark.slow
def test_exact_recordings_of_wrong_instruments_give_the_true_values() -> None:
    recording = _wrong(_exact(), gain=1.05, offset=-0.7, rate=-3e-4)
    found = zo.identify(OSCILLATOR, recording, [*TRUTH, *ERRORS])
    assert found.converged
    true = TRUTH | dict(zip(ERRORS, (1.05, -0.7, -3e-4), strict=True))
    for one in found.fitted:
        assert one.low < true[one.unknown.label] < one.high
        assert one.value == pytest.approx(true[one.unknown.label], rel=2e-5, abs=2e-7)
    assert not set(ERRORS) & set(found.values.parameters)


@pytest.mark.slow
@pytest.mark.parametrize("offset", often(1, [30.0, 0.05]))
def test_a_changed_instrument_changes_its_own_errors_alone(offset: float) -> None:
    fit = [*TRUTH, *ERRORS]
    plain = zo.identify(OSCILLATOR, _exact(0.01), fit)
    changed = zo.identify(OSCILLATOR, _wrong(_exact(0.01), gain=0.8, offset=offset, rate=2e-4), fit)
    one, other = _values(plain), _values(changed)
    for name in TRUTH:
        assert other[name] == pytest.approx(one[name], rel=1e-5)
    assert other["distance.gain"] == pytest.approx(0.8 * one["distance.gain"], rel=1e-5)
    moved = 0.8 * one["distance.offset"] + offset
    assert other["distance.offset"] == pytest.approx(moved, abs=1e-6)
    faster = (1.0 + one["clock_rate"]) * 1.0002
    assert other["clock_rate"] == pytest.approx(faster - 1.0, abs=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "gain", "rate"), often(1, [("current.gain", 1.02, 0.0), ("clock_rate", 1.0, 1e-4)])
)
def test_an_error_of_an_instrument_biases_values_unless_it_is_fitted(
    name: str, gain: float, rate: float
) -> None:
    problem, truth = zo.load_problem("motor_pendulum"), {"R": 3.06, "restitution": 0.207}
    orbit = orbit_by_shooting(problem, problem.values(parameters=truth)).unwrap()
    table = tabulate_orbit(orbit, problem, ("theta1", "theta2", "current"))
    right = recorded(table, problem, rate=1000.0, noise=0.01, n_cycles=20.0, seed=1)
    signals = tuple(
        replace(one, values=gain * one.values) if one.name == "current" else one
        for one in right.signals
    )
    wrong = replace(right, time=right.time * (1.0 + rate), signals=signals)
    sure = zo.identify(problem, wrong, [*truth, name])
    true = truth | {name: gain if gain != 1.0 else rate}
    for one in sure.fitted:
        assert abs(one.value - true[one.unknown.label]) < 4.0 * one.error
    biased = zo.identify(problem, wrong, list(truth))
    deviations = [abs(one.value - truth[one.unknown.label]) for one in biased.fitted]
    assert max(d / one.error for d, one in zip(deviations, sure.fitted[:2], strict=True)) > 8.0


@pytest.mark.slow
def test_a_gain_is_not_told_from_the_size_of_the_motion() -> None:
    # Lengths A, stop and distance scale together: the oscillator is linear between impacts.
    fit = ["A", "stop", "distance.gain"]
    found = zo.identify(OSCILLATOR, _exact(0.01, "distance"), fit)
    (unseen,) = found.unseen
    assert set(unseen.direction) == set(fit)
    assert all(not np.isfinite(one.error) for one in found.fitted)
    # Changes have signs: the stop at -0.8 m moves away from 0 as the amplitude grows.
    assert unseen.direction["A"] * unseen.direction["stop"] > 0.0
    assert unseen.direction["A"] * unseen.direction["distance.gain"] < 0.0


@pytest.mark.slow
def test_instruments_alone_are_calibrated_with_known_parameters() -> None:
    recording = _wrong(_exact(0.01), gain=1.1, offset=0.0, rate=1e-3)
    found = zo.identify(OSCILLATOR, recording, ["distance.gain", "clock_rate"], parameters=TRUTH)
    for one, true in zip(found.fitted, (1.1, 1e-3), strict=True):
        assert abs(one.value - true) < 4.0 * one.error


@pytest.mark.parametrize(
    ("fit", "reason"),
    [
        ({"c": None, "angle.gain": None}, "a recorded channel (distance, speed), but it names `an"),
        ({"c": None, "distance.slope": None}, "but it names `distance.slope`"),
        ({"c": None, "contact.gain": None}, "`contact.gain`: a contact channel lacks gain and"),
        (["c", "c"], "must name `c` once, not twice"),
        ({"c+distance.gain": None}, "ties `c+distance.gain`"),
        ({"distance.gain+speed.offset": None}, "ties `distance.gain+speed.offset`"),
        ({"c": None, "distance.gain": (-1.0, 1.0)}, "must have a range above 0"),
        ({"c": None, "clock_rate": (0.1, 0.0)}, "clock_rate"),
    ],
)
def test_unknowns_that_are_none_are_refused(
    fit: dict[str, tuple[float, float] | None] | list[str], reason: str
) -> None:
    with pytest.raises(zo.InputError) as caught:
        zo.identify(OSCILLATOR, _exact(), fit)
    assert reason in str(caught.value)


@pytest.mark.slow
def test_the_command_prints_errors_of_instruments_beside_parameters(tmp_path: Path) -> None:
    zo.write_recording(_wrong(_exact(0.01), gain=1.05, offset=0.0, rate=0.0), tmp_path / "run.csv")
    fit = "c,restitution,distance.gain=0.9:1.2,clock_rate"
    said = ask("identify", OSCILLATOR, tmp_path / "run.csv", "--fit", fit, "--json")
    answer = json.loads(said.out)
    assert set(answer["fitted"]) == {"c", "restitution", "distance.gain", "clock_rate"}
    assert answer["fitted"]["distance.gain"]["value"] == pytest.approx(1.05, rel=0.01)
    assert set(answer["parameters"]) == set(zo.load_problem(OSCILLATOR).values().parameters)


@pytest.mark.slow
def test_a_range_without_the_true_gain_is_named() -> None:
    # Trial steps of such a fit leave the states at which a motion can start.
    recording = _wrong(_exact(2e-3, "distance"), gain=1.5, offset=0.0, rate=0.0)
    found = zo.identify(OSCILLATOR, recording, {"distance.gain": (0.5, 1.2), "A": None})
    assert any("`distance.gain` reached an end of its range" in one for one in found.remarks)


@pytest.mark.slow
def test_a_parameter_that_is_not_seen_leaves_the_others_their_intervals() -> None:
    # All forces of the oscillator are per mass, if mass, damping and spring change together.
    fit = ["m", "c", "k", "A", "restitution", "distance.gain"]
    found = zo.identify(OSCILLATOR, _exact(0.01), fit, parameters={"restitution": 0.45, "c": 2.0})
    assert found.converged
    assert len(found.unseen) == 1
    (restitution,) = (one for one in found.fitted if one.unknown.label == "restitution")
    assert restitution.low < 0.45 < restitution.high
