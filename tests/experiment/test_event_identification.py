"""`identify` on machines with several stops: recordings of known orbits, and bad input.

The contact channels are closed for a time after each impact of the orbit, so the orbit with hard
stops is the exact truth.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import zeno_orbits as zo
from benchmarks.contact_fits import (
    SOUGHT,
    channel,
    random_values,
    recorded,
    scores_of,
    settled_period,
)
from tests.support.commands import ask
from zeno_orbits.experiment import RecordedSignal, Recording, UnfittableError, measurable

TRUTH = {"restitution": 0.28, "ks": 57.5, "R": 47.0}
"""Parameters that are 4.5 to 7 % away from the start."""


@cache
def _recording(noise: float = 0.0, rate: float = 1e5) -> Recording:
    return recorded(settled_period(TRUTH), 0, noise=noise, rate=rate, periods=4)


def _only(recording: Recording, *names: str) -> Recording:
    return replace(recording, signals=tuple(map(recording.signal, names)))


# Derivatives and exact recordings.


@pytest.mark.weekly
@pytest.mark.slow
def test_a_recording_without_noise_gives_the_true_values() -> None:
    found = zo.identify("relay", _recording(), list(TRUTH))
    assert found.converged
    assert not found.orbit.has_phases
    for one in found.fitted:
        true = TRUTH[one.unknown.label]
        assert abs(one.value / true - 1.0) < 1e-6
        assert one.low < true < one.high
    assert found.edges == 9
    assert found.edge_misfit < 1.5


@pytest.mark.slow
def test_channels_alone_give_intervals_that_hold() -> None:
    # At 100 kHz all cycles of 40 ms have the same errors of sampling.
    recording = _only(_recording(rate=99137.0), "contact.closed", "contact.open")
    start = {"ks": TRUTH["ks"], "R": TRUTH["R"]}
    found = zo.identify("relay", recording, ["restitution"], parameters=start)
    (one,) = found.fitted
    assert one.low < TRUTH["restitution"] < one.high
    # The bounces of 100 and 280 us are known to some us, and vary like the restitution.
    assert one.error < 0.02 * one.value
    assert found.after == 0.0


@pytest.mark.weekly
@pytest.mark.slow
def test_channels_narrow_the_interval_of_the_restitution() -> None:
    start = {"ks": TRUTH["ks"], "R": TRUTH["R"]}
    both = _recording(noise=0.05)
    errors = [
        zo.identify("relay", recording, ["restitution"], parameters=start).fitted[0].error
        for recording in (both, _only(both, "current"))
    ]
    assert errors[0] < 0.5 * errors[1]


@pytest.mark.weekly
@pytest.mark.slow
def test_intervals_of_recordings_with_noise_hold() -> None:
    scores = [
        score
        for seed in (1000, 1001)
        for truth in [random_values(seed)]
        for score in scores_of(
            zo.identify("relay", recorded(settled_period(truth), seed), SOUGHT), truth
        ).values()
    ]
    # With a share of 95 %, fewer than 6 of 8 hold once in 170 tests.
    assert sum(one.holds for one in scores) >= 6
    assert max(one.half for one in scores) < 0.01


@pytest.mark.slow
def test_what_channels_alone_do_not_determine_is_named() -> None:
    # With U, N and R times c, c and c^2 the flux, and so the motion, is the same.
    recording = _only(_recording(), "contact.closed", "contact.open")
    found = zo.identify("relay", recording, ["U", "R", "N"], parameters=TRUTH)
    (unseen,) = found.unseen
    direction = np.array([unseen.direction[name] for name in ("U", "R", "N")])
    aim = np.array([1.0, 2.0, 1.0]) / np.sqrt(6.0)
    # The fit may move along it: the changes are relative to the fitted values.
    assert abs(direction @ aim) == pytest.approx(1.0, abs=1e-9)
    assert all(not np.isfinite(one.error) for one in found.fitted)


@pytest.mark.slow
def test_a_wrong_model_is_reported_by_its_contacts() -> None:
    recording = _only(_recording(), "contact.closed", "contact.open")
    found = zo.identify("relay", recording, ["restitution"])
    assert any("systematic misfit of the contacts" in remark for remark in found.remarks)
    assert found.edge_misfit > 3.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "truth", "signals", "most"),
    [
        # Two stops; one stop with resets, whose period is not that of a drive; and one impact.
        ("clapper", {"restitution": 0.33, "c": 0.11}, ("place",), 0.05),
        pytest.param(
            *("kneed_walker", {"restitution": 0.22, "slope": 0.049}, ("q1", "q2", "q3"), 1e-3),
            marks=pytest.mark.weekly,
        ),
        ("hopper", {"restitution": 0.53, "a": 21.0}, ("height",), 3e-3),
    ],
)
def test_intervals_of_other_machines_hold(
    name: str, truth: dict[str, float], signals: tuple[str, ...], most: float
) -> None:
    orbit = settled_period(truth, signals, name=name, section=None)
    step = orbit.period / 4000
    recording = recorded(orbit, 3, rate=1.00137 / step, periods=5, contacts=(4 * step, 4 * step))
    scores = scores_of(zo.identify(name, recording, list(truth)), truth)
    assert all(one.holds and one.half < most for one in scores.values())


# Bad input.


@pytest.mark.parametrize(
    ("names", "error", "words"),
    [
        ((), zo.InputError, "must have a signal or a contact channel of the problem"),
        (("contact.closed", "contact.open"), UnfittableError, "no period is seen in 0.2 s"),
    ],
)
def test_a_recording_that_shows_nothing_is_refused(
    names: tuple[str, ...], error: type[Exception], words: str
) -> None:
    time = np.linspace(0.0, 0.2, 1001)
    zeros = [
        RecordedSignal(name=name, unit="1", values=np.zeros(1001)) for name in (*names, "flow")
    ]
    recording = Recording(source=None, problem="", time=time, signals=tuple(zeros))
    with pytest.raises(error, match=words) as refused:
        zo.identify("relay", recording, ["R"])
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("rate", [4e3, 3e4])
def test_contacts_that_the_sampling_does_not_resolve_are_refused(rate: float) -> None:
    with pytest.raises(UnfittableError, match="bounces cannot be decided") as refused:
        zo.identify("relay", _recording(rate=rate), ["R"])
    assert "\n" not in str(refused.value)


def test_a_start_that_does_not_close_is_refused() -> None:
    with pytest.raises(UnfittableError, match="`closed` closes, and the orbit does not"):
        zo.identify("relay", _recording(), ["R"], parameters={"U": 2.0})


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(zo.InputError, match="must name parameters"):
        zo.identify("relay", _recording(), ["Q"])


# The command.


@pytest.mark.slow
def test_the_command_writes_results_and_orbit(tmp_path: Path) -> None:
    zo.write_recording(_recording(noise=0.01), tmp_path / "data.csv")
    words = ["identify", "relay", tmp_path / "data.csv", "--fit", "restitution=0.2:0.4"]
    words += ["--set", f"ks={TRUTH['ks']}", "--set", f"R={TRUTH['R']}"]
    done = ask(*words, "--orbit", tmp_path / "orbit.json")
    assert done.code == 0, done.err
    assert "9 edges of contacts" in done.out
    orbit = zo.read_orbit(tmp_path / "orbit.json")
    assert abs(orbit.parameters["restitution"] / TRUTH["restitution"] - 1.0) < 0.02


def test_the_signals_of_several_stops_are_states_and_outputs() -> None:
    units = measurable(zo.load_problem("relay"))
    assert units["current"] == "A"
    assert list(units) == ["z", "dz", "flux", "cosine", "sine", "current", "voltage"]


def test_a_channel_is_closed_from_the_zeno_point_to_the_release() -> None:
    orbit = settled_period(TRUTH)
    times = np.linspace(0.0, orbit.period, 4001)[:-1]
    closed = channel(orbit, "closed", times, 3e-5)
    assert 0.4 < float(np.mean(closed)) < 0.7
