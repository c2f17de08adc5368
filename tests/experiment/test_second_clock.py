"""A second file of one motion on another clock, whose offset and rate are known to the test.

The motion is that of a ball by its flights, and that of an orbit at other times.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.commands import ask
from zeno_orbits.errors import InputError
from zeno_orbits.experiment import RecordedSignal, UnfittableError, tabulate_orbit
from zeno_orbits.search import orbit_by_shooting

G, E, HEIGHT = 9.81, 0.7, 0.8
BEGIN, RATE = 1.7, 2e-3


def heights(times: np.ndarray) -> np.ndarray:
    """Return the heights of a ball, which waits before the time 0."""
    begin, speed = math.sqrt(2 * HEIGHT / G), math.sqrt(2 * G * HEIGHT)
    found = np.where(times < begin, HEIGHT - G * np.maximum(times, 0.0) ** 2 / 2, 0.0)
    while speed > 1e-6:
        speed *= E
        since = times - begin
        inside = (since >= 0.0) & (since < 2 * speed / G)
        found[inside] = speed * since[inside] - G * since[inside] ** 2 / 2
        begin += 2 * speed / G
    return found


def impacts(n: int) -> np.ndarray:
    first = math.sqrt(2 * HEIGHT / G)
    flights = 2 * first * E ** np.arange(1, n)
    return first + np.concatenate([[0.0], np.cumsum(flights)])


def recording(name: str, times: np.ndarray, values: np.ndarray, unit: str = "m") -> zo.Recording:
    signal = RecordedSignal(name=name, unit=unit, values=values)
    return zo.Recording(source=None, problem="bouncing_ball", time=times, signals=(signal,))


@cache
def _first() -> zo.Recording:
    times = np.arange(0.0, 2.0, 0.01)
    noise = 2e-3 * np.random.default_rng(1).standard_normal(len(times))
    return recording("height", times, heights(times) + noise)


@cache
def _second(begin: float = BEGIN, rate: float = RATE) -> zo.Recording:
    shown = np.arange(0.0, 4.0, 1 / 60)
    noise = 3e-3 * np.random.default_rng(2).standard_normal(len(shown))
    return recording("height", shown, heights(shown / (1 + rate) - begin) + noise)


def _clock(remarks: tuple[str, ...]) -> tuple[float, float, float, float]:
    """Return what the notes say: the time at the beginning and its error, the rate and its own."""
    begins = next(word for word in remarks if "its clock shows" in word).split()
    rate = next(word for word in remarks if "faster by the part" in word).split()
    at = begins.index("shows")
    part = rate.index("part")
    return (
        float(begins[at + 1]),
        float(begins[at + 3]),
        float(rate[part + 1]),
        float(rate[part + 3]),
    )


@pytest.mark.slow
@pytest.mark.parametrize(("begin", "rate"), [(BEGIN, RATE), (-0.3, -0.01)])
def test_the_clock_of_a_second_file_is_found_with_the_parameters(begin: float, rate: float) -> None:
    found = zo.identify(
        "bouncing_ball", _first(), ["restitution"], second_file=_second(begin, rate), transient=True
    )
    shown, error, faster, unsure = _clock(found.remarks)
    assert abs(shown - (1 + rate) * begin) < 4 * error < 4e-3
    assert abs(faster - rate) < 4 * unsure < 8e-3
    (one,) = found.fitted
    assert one.low < E < one.high
    assert found.transient is not None
    assert not found.transient.tests.has_structure
    alone = zo.identify("bouncing_ball", _first(), ["restitution"], transient=True).fitted[0]
    assert one.error < alone.error


@pytest.mark.slow
def test_times_of_a_microphone_are_laid_over_a_video() -> None:
    times = (1 + RATE) * (impacts(8) + BEGIN)
    times += 1e-4 * np.random.default_rng(4).standard_normal(8)
    heard = recording("impact", times, times, "s")
    found = zo.identify("bouncing_ball", _first(), ["restitution"], second_file=heard)
    shown, error, faster, unsure = _clock(found.remarks)
    assert abs(shown - (1 + RATE) * BEGIN) < 4 * error + 1e-3
    assert abs(faster - RATE) < 4 * unsure < 0.02
    (one,) = found.fitted
    assert one.low < E < one.high


@pytest.mark.slow
def test_a_comparison_takes_a_second_file_too() -> None:
    found = zo.compare_transient(
        "bouncing_ball", _first(), second_file=_second(), parameters={"restitution": E}
    )
    assert found.agrees, found.fit.verdict
    shown, error, _, _ = _clock(found.remarks)
    assert abs(shown - (1 + RATE) * BEGIN) < 4 * error
    assert {one.trial for one in found.impacts} == {"trial 1", "second file"}
    # Samples before the release shift the first recorded impact.
    seen = [one for one in found.impacts if one.number in (2, 3)]
    assert len(seen) == 4
    assert max(abs(one.recorded - one.fitted) for one in seen) < 0.01


@pytest.mark.slow
def test_a_rate_that_a_short_file_does_not_determine_is_named() -> None:
    shown = np.arange(0.0, 0.18, 1 / 60)
    noise = 5e-3 * np.random.default_rng(2).standard_normal(len(shown))
    short = recording("height", shown, heights(shown + 0.65) + noise)
    found = zo.compare_transient(
        "bouncing_ball", _first(), second_file=short, parameters={"restitution": E}
    )
    assert any("the rate of its clock is not determined" in word for word in found.remarks)


def test_a_file_of_another_motion_is_refused() -> None:
    times = np.arange(0.0, 2.0, 0.01)
    other = recording("height", times, np.random.default_rng(5).uniform(0.0, 1.0, 200))
    with pytest.raises(UnfittableError, match="second file does not show the motion of trial 1"):
        zo.compare_transient(
            "bouncing_ball", _first(), second_file=other, parameters={"restitution": E}
        )


def test_a_second_file_belongs_to_one_transient(tmp_path: object) -> None:
    with pytest.raises(InputError, match="Argument `second_file` belongs to a single trial"):
        zo.identify("bouncing_ball", [_first(), _first()], ["restitution"], second_file=_second())
    with pytest.raises(InputError, match="`second_file` holds the first recording again: give"):
        zo.identify("bouncing_ball", _first(), ["restitution"], second_file=_first())
    path = f"{tmp_path}/drop.csv"
    zo.write_recording(_first(), path)
    words = ("identify", "bouncing_ball", path, "--fit", "restitution", "--second-file", path)
    answer = ask(*words, "--law", "constant,linear")
    assert answer.code == 2
    assert "--second-file" in answer.err
    assert "--law" in answer.err


@cache
def _orbit_files(k: float = 1.03) -> tuple[zo.Orbit, zo.Recording, zo.Recording]:
    """Return an orbit with `k`, and the distance and the speed of that with 1.03 on two clocks."""
    problem = zo.load_problem("forced_oscillator")
    orbits = [
        orbit_by_shooting(
            problem, problem.values(parameters={"k": own, "restitution": 0.49})
        ).unwrap()
        for own in dict.fromkeys((1.03, k))
    ]
    table = tabulate_orbit(orbits[0], problem, ["distance", "speed"])
    period, random = orbits[0].period, np.random.default_rng(5)

    def file(times: np.ndarray, shown: np.ndarray, k: int) -> zo.Recording:
        clean = table.at(times / period + 0.3)[:, k]
        noisy = clean + 0.01 * np.ptp(clean) * random.standard_normal(len(clean))
        name, unit = (("distance", "m"), ("speed", "m/s"))[k]
        signal = RecordedSignal(name=name, unit=unit, values=noisy)
        return zo.Recording(source=None, problem=problem.name, time=shown, signals=(signal,))

    first_times = np.arange(0.0, 8.2 * period, period / 61.3)
    shown = 40.0 + np.arange(0.0, 11.4 * period, period / 87.1)
    first = file(first_times, first_times, 0)
    return orbits[-1], first, file(shown / (1 + RATE) - BEGIN, shown, 1)


def _is_the_clock(remarks: tuple[str, ...], period: float) -> None:
    """Check the notes on the second clock against the true one."""
    at, error, faster, unsure = _clock(remarks)
    whole = (at - (1 + RATE) * BEGIN) / ((1 + RATE) * period)
    assert abs(whole - round(whole)) * period < 4 * error < 0.02 * period
    assert abs(faster - RATE) < 4 * unsure < RATE


@pytest.mark.slow
def test_two_files_of_an_orbit_give_parameters_and_the_clock_up_to_periods() -> None:
    orbit, first, second = _orbit_files()
    problem, true = orbit.problem, {"k": 1.03, "restitution": 0.49}
    found = zo.identify(problem, first, ["k", "restitution"], second_file=second, transient=False)
    assert {one.unknown.label for one in found.fitted} == set(true)
    for one in found.fitted:
        assert abs(one.value - true[one.unknown.label]) < 4 * one.error
    assert found.correlation.shape == (2, 2)
    _is_the_clock(found.remarks, orbit.period)
    alone = zo.identify(problem, first, ["k", "restitution"], transient=False)
    assert all(a.error < b.error for a, b in zip(found.fitted, alone.fitted, strict=True))


@pytest.mark.slow
def test_compare_takes_a_second_file_of_an_orbit(tmp_path: Path) -> None:
    orbit, first, second = _orbit_files()
    found = zo.compare(orbit, first, second_file=second)
    assert found.agrees
    assert found.second_file is not None
    assert found.second_file.signals == ("speed",)
    # Its period counts by the first clock.
    period = found.second_file.metric("period")
    assert abs(period.data - orbit.period) < 4 * period.error
    _is_the_clock(found.remarks, orbit.period)
    paths = [str(tmp_path / name) for name in ("orbit.json", "first.csv", "second.csv")]
    zo.write_orbit(orbit, paths[0])
    for path, one in zip(paths[1:], (first, second), strict=True):
        zo.write_recording(one, path)
    answer = ask("compare", *paths[:2], "--second-file", paths[2])
    assert answer.code == 0
    assert "second.csv: its clock is faster by the part 0.00" in answer.out.replace("\n", " ")
    assert "Second file:" in answer.out
    assert found.as_json()["second_file"]["signals"] == ["speed"]


@pytest.mark.slow
def test_a_second_file_of_another_motion_is_told() -> None:
    orbit, first, second = _orbit_files()
    speed = second.signal("speed")
    sawtooth = (second.time % orbit.period) ** 2
    for other, told in (
        # No two clocks differ by 20 %.
        (replace(second, time=1.2 * second.time), "no two clocks differ by so much"),
        (recording("speed", second.time, sawtooth, "m/s"), "it runs backward"),
    ):
        found = zo.compare(orbit, first, second_file=other)
        assert not found.agrees
        assert any(one.startswith("second file: ") and told in one for one in found.reasons)
    for other, told in (
        (first, "holds the first recording again"),
        (recording("height", second.time, speed.values), "must have a signal or a contact channel"),
    ):
        with pytest.raises(InputError, match=f"Argument `second_file` {told}"):
            zo.compare(orbit, first, second_file=other)
    late = replace(first, time=first.time + 1.0)
    with pytest.raises(InputError, match="`fit` must name a channel of one file, but both files"):
        zo.compare(orbit, first, second_file=late, fit=["distance.gain"])


@pytest.mark.parametrize(
    "option", ["--set g=3", "--start height=1", "--initial speed", "--trial d"]
)
def test_options_of_transients_need_a_problem_in_place_of_an_orbit(option: str) -> None:
    answer = ask("compare", "orbit.json", "data.csv", *option.split())
    assert answer.code == 2
    assert f"{option.split()[0]}: needs a problem in place of `orbit.json`." in answer.err


def test_a_second_file_of_an_orbit_has_signals_and_its_own_channels() -> None:
    times = np.arange(0.0, 60.0, 0.1)
    wave = recording("distance", times, np.sin(times))
    contact = recording("contact.stop", times, np.sin(times) > 0.9, "1")
    for fit, second, told in (
        ("k", contact, "`second_file` has the contact channel `contact.stop`: give the file with"),
        ("distance.gain", recording("distance", times, np.cos(times)), "`fit` must name a channel"),
    ):
        with pytest.raises(InputError, match=f"Argument {told}"):
            zo.identify("forced_oscillator", wave, [fit], second_file=second, transient=False)


def test_read_shows_a_second_file_and_its_clock_by_shared_signals(tmp_path: Path) -> None:
    paths = [str(tmp_path / f"{k}.csv") for k in range(5)]
    shown = np.arange(0.0, 30.0, 0.05)
    other = recording("speed", shown, np.sin(shown), "m/s")
    wave = recording("height", shown, np.sin(shown))
    noise = recording("height", shown, np.random.default_rng(6).uniform(0.0, 1.0, len(shown)))
    for path, one in zip(paths, (_first(), _second(), other, wave, noise), strict=True):
        zo.write_recording(one, path)
    answer = ask("read", paths[0], "--second-file", paths[1], "--json")
    assert answer.code == 0
    told = json.loads(answer.out)["second_file"]["clock"].split()
    assert abs(float(told[told.index("shows") + 1]) - (1 + RATE) * BEGIN) < 2 / 60
    for pair, word in (
        ((paths[0], paths[2]), "share no signal"),
        ((paths[3], paths[3]), "offsets that are 6.3 s apart"),
        ((paths[3], paths[4]), "do not show one motion"),
    ):
        assert word in ask("read", pair[0], "--second-file", pair[1]).out.replace("\n", " ")
