"""Comparisons whose channels have an unknown scale and zero, such as tracks in pixels.

The truth is a sampled orbit, or a drop by its closed form, read by known gains and offsets.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import zeno_orbits as zo
from tests.support.commands import ask
from tests.support.recordings_of import recorded
from zeno_orbits.errors import InputError
from zeno_orbits.experiment import RecordedSignal, tabulate_orbit
from zeno_orbits.orbits import Orbit
from zeno_orbits.search import orbit_by_shooting

OSCILLATOR = "forced_oscillator"
BOTH = ("distance.gain", "distance.offset")


@cache
def _orbit() -> Orbit:
    problem = zo.load_problem(OSCILLATOR)
    return orbit_by_shooting(problem, problem.values()).unwrap()


@cache
def _recording(seed: int) -> zo.Recording:
    problem, orbit = zo.load_problem(OSCILLATOR), _orbit()
    table = tabulate_orbit(orbit, problem, ("distance",))
    rate = 150.37 / orbit.period
    return recorded(table, problem, rate=rate, noise=2e-3, n_cycles=12.0, seed=seed)


def _read(recording: zo.Recording, gain: float, offset: float) -> zo.Recording:
    signals = tuple(replace(one, values=gain * one.values + offset) for one in recording.signals)
    return replace(recording, signals=signals)


@pytest.mark.slow
@pytest.mark.parametrize(("gain", "offset"), [(1.3, 0.4), (250.0, -3.0)])
def test_the_scale_of_a_channel_is_found_and_the_orbit_recognized(
    gain: float, offset: float
) -> None:
    off: list[float] = []
    for seed in range(4):
        recording = _read(_recording(seed), gain, offset)
        found = zo.compare(_orbit(), recording, fit=BOTH)
        assert found.verdict.value == "this orbit", found
        scale, zero = (found.instruments[name] for name in BOTH)
        off += [(scale.value - gain) / scale.error, (zero.value - offset) / zero.error]
    assert zo.compare(_orbit(), recording).verdict.value != "this orbit"
    # Eight errors of four recordings: the root mean square is 1, below 2 and above 0.3 surely.
    assert 0.3 < math.sqrt(float(np.mean(np.square(off)))) < 2.0


def test_another_shape_is_no_scale() -> None:
    recording = _recording(0)
    (one,) = recording.signals
    bent = replace(one, values=one.values + 0.2 * one.values**2)
    found = zo.compare(_orbit(), replace(recording, signals=(bent,)), fit=BOTH)
    assert found.verdict.value != "this orbit"


@pytest.mark.slow
def test_an_offset_alone_leaves_the_scale_as_evidence() -> None:
    recording = _read(_recording(0), 1.0, 0.4)
    assert zo.compare(_orbit(), recording, fit=BOTH[1:]).verdict.value == "this orbit"
    recording = _read(_recording(0), 1.1, 0.4)
    assert zo.compare(_orbit(), recording, fit=BOTH[1:]).verdict.value != "this orbit"


def _drop(e: float, gain: float, offset: float) -> zo.Recording:
    """Return a drop from 1 m at 100 samples a second by its flights, in units of a camera."""
    g, n = 9.81, 300
    time = np.arange(n) / 100
    begin, speed = math.sqrt(2.0 / g), math.sqrt(2.0 * g)
    heights = np.where(time < begin, 1.0 - g * time**2 / 2, 0.0)
    while speed > 1e-6:
        speed *= e
        since = time - begin
        inside = (since >= 0.0) & (since < 2 * speed / g)
        heights[inside] = speed * since[inside] - g * since[inside] ** 2 / 2
        begin += 2 * speed / g
    noisy = heights + 2e-3 * np.random.default_rng(3).standard_normal(n)
    signal = RecordedSignal(name="height", unit="m", values=gain * noisy + offset)
    return zo.Recording(source=None, problem="bouncing_ball", time=time, signals=(signal,))


@pytest.mark.slow
def test_a_drop_in_another_scale_agrees_only_after_its_scale_is_fitted() -> None:
    recording, fit = _drop(0.75, 1.3, 0.2), ("height.gain", "height.offset")
    found = zo.compare_transient(
        "bouncing_ball", recording, fit=fit, parameters={"restitution": 0.75}
    )
    assert found.agrees, found.fit.verdict
    for name, true in zip(fit, (1.3, 0.2), strict=True):
        one = found.instruments[name]
        assert abs(one.value - true) < 4 * one.error < 0.02 * max(true, 1.0)
    seen = [one for one in found.impacts if math.isfinite(one.recorded)]
    assert len(seen) > 3
    assert max(abs(one.recorded - one.fitted) for one in seen) < 0.01
    plain = zo.compare_transient("bouncing_ball", recording, parameters={"restitution": 0.75})
    assert not plain.agrees
    wrong = zo.compare_transient(
        "bouncing_ball", recording, fit=fit, parameters={"restitution": 0.7}
    )
    assert not wrong.agrees


@pytest.mark.slow
def test_trials_need_not_share_the_channel_of_an_error() -> None:
    drop = _drop(0.75, 1.3, 0.2)
    (height,) = drop.signals
    impacts = RecordedSignal(name="impact", unit="s", values=_impacts(0.75))
    times = zo.Recording(
        source=None, problem="bouncing_ball", time=impacts.values, signals=(impacts,)
    )
    found = zo.compare_transient(
        "bouncing_ball",
        [replace(drop, signals=(height,)), times],
        fit=("height.gain", "height.offset"),
        parameters={"restitution": 0.75},
        initial=["height"],
    )
    assert found.instruments["height.gain"].value == pytest.approx(1.3, abs=0.01)


def _impacts(e: float) -> np.ndarray:
    first = math.sqrt(2.0 / 9.81)
    flights = 2 * first * e ** np.arange(1, 9)
    return first + np.concatenate([[0.0], np.cumsum(flights)])


@pytest.mark.parametrize(
    ("fit", "reason"),
    [
        (["c"], "must name CHANNEL.gain, CHANNEL.offset or clock_rate, but it has `c`"),
        (["speed.gain"], "channel unknown name `speed`"),
        (["clock_rate"], "may not name `clock_rate`"),
    ],
)
def test_other_names_are_refused(fit: list[str], reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        zo.compare(_orbit(), _recording(0), fit=fit)


@pytest.mark.slow
def test_the_command_prints_the_scale(tmp_path: pytest.TempPathFactory) -> None:
    path = f"{tmp_path}/track.csv"
    zo.write_recording(_drop(0.75, 1.3, 0.2), path)
    words = ("compare", "bouncing_ball", path, "--set", "restitution=0.75")
    answer = ask(*words, "--fit", "height.gain,height.offset")
    assert answer.code == 0
    assert "Note: height.gain = 1.299" in answer.out
    found = json.loads(ask(*words, "--fit", "height.gain,height.offset", "--json").out)
    assert found["instruments"]["height.gain"]["value"] == pytest.approx(1.3, abs=0.01)
